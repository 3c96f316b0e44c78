"""What a plan is linear in: every parameter that is free, what is known of each, and how offered rows answer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from armflex.arm import Arm, Setup
from armflex.conventions import Array
from armflex.errors import Flag, InputError, listing
from armflex.estimate.block import (
    Block,
    EffectBlock,
    LawBlock,
    amplitude_prior,
    effect_jacobian,
    law_block,
    learned_laws,
    parameters_of,
    places_of,
    with_laws,
)
from armflex.estimate.blocks import blocks_of, declared_blocks, frame_block, sensor_block, sensor_keys
from armflex.estimate.calibrate import fit_campaign
from armflex.estimate.fit import Fit, prior_of
from armflex.estimate.posterior import OTHER_PARAMETERS
from armflex.estimate.robust import whitened_regressors
from armflex.estimate.view import View, look
from armflex.laws.effects.effect import Effect
from armflex.laws.learned import LearnedLaw
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.measurements import Measurements
from armflex.parameters import FRAMES, ArmParameter, Certainty, ParameterGroup, ParameterKind, numbers_of
from armflex.plan.offer import Offer
from armflex.readings import Position, Readings, TouchingSensor
from armflex.readings.instrument import Instrument

NOWHERE = -1
"""Place of an effect that the arm has not among its own."""

ANYWHERE, ANYHOW = 100.0, 3.0
"""Standard deviations [m, rad] of where an instrument stands of which nothing is known."""


@dataclass(frozen=True, eq=False)
class Measured:
    """The information of a campaign.

    Attributes:
        campaign: What was measured.
        view: All of its rows.
        weights: (M,) what every row counts beside the others, 0 where nothing was read.
        fit: The campaign's fit.
    """

    campaign: Measurements
    view: View
    weights: Array
    fit: Fit

    @staticmethod
    def of(fitted: Fit, campaign: Measurements, certainty: Certainty, setup: Setup) -> Measured:
        """Return what a campaign says of an arm as a fit left it; readings that repeat one another count less."""
        weights = np.zeros((len(campaign), fitted.view.readings.size))
        weights[fitted.view.rows] = fitted.weights / certainty.design_effect
        return Measured(campaign, look(setup, campaign), weights, fitted)


@dataclass(frozen=True, eq=False)
class Before:
    """The arm as it is known before the rows that are planned.

    Attributes:
        setup: Arm and instrument, calibrated where there is something to do it with.
        measured: The information of a campaign, None where nothing was measured.
        noises: By instrument, '' the one at the tip, the standard deviation of what it reads over the stated one, 1 or
            more; one that is not in it reads as well as it states.
        flags: Flags about the campaign.
    """

    setup: Setup
    measured: Measured | None = None
    noises: Mapping[str, float] = field(default_factory=dict)
    flags: tuple[Flag, ...] = ()

    @property
    def campaign(self) -> Measurements | None:
        """What was measured, None where nothing was."""
        return None if self.measured is None else self.measured.campaign

    @property
    def sigmas(self) -> dict[str, Array]:
        """By instrument (n,) a usual standard deviation of the numbers that it read, in their units, as it scatters."""
        if self.measured is None:
            return {}
        sigmas: dict[str, Array] = {}
        for kind in self.measured.campaign.readings.kinds:
            sigma = kind.sigma[self.measured.campaign.measured]
            read = np.isfinite(sigma)
            if read.any() and (kind.name or isinstance(kind, Position)):  # of a corner in no picture as of the others
                usual = np.where(read.any(axis=0), sigma, np.median(sigma[read]))
                usual = np.ma.median(np.ma.masked_invalid(usual), axis=0).filled()
                sigmas.setdefault(kind.name, self.noises.get(kind.name, 1.0) * usual)
        return sigmas

    def seen_by(self, setup: Setup) -> Before:
        """Return the same as another arm or instrument has it."""
        if self.measured is None:
            return replace(self, setup=setup)
        return replace(self, setup=setup, measured=replace(self.measured, view=look(setup, self.measured.campaign)))


def known_before(arm: Arm, after: Measurements | None, as_stated: bool) -> Before:
    """Return an arm as it is known, calibrated with a campaign where there is one; errors are those of `calibrate`.

    Of an arm that is calibrated already only the instrument is placed anew. An effect in question may be what makes
    readings scatter: then they are weighed `as_stated`.
    """
    if after is None:
        return Before(Setup(arm, arm.instrument or Instrument()))
    calibration = fit_campaign(arm, after, keep=arm.certainty is not None, as_stated=as_stated)
    fitted = calibration.fit
    assert calibration.arm.certainty is not None
    measured = Measured.of(fitted, after, calibration.arm.certainty, fitted.setup)
    return Before(fitted.setup, measured, noises_of(fitted), calibration.flags)


def noises_of(fitted: Fit) -> dict[str, float]:
    """Return by instrument how far its readings scatter over what they state, 1 or more."""
    return {name: max(scatter, 1.0) for name, scatter in zip(fitted.view.readings.names, fitted.scatters, strict=True)}


@dataclass(frozen=True, eq=False)
class CandidateBlock(EffectBlock):
    """An effect that is in question: free about its own values, whether or not the arm has it (`ordinal` NOWHERE)."""

    def at_setup(self, setup: Setup) -> CandidateBlock:
        return self

    def stepped(self, setup: Setup, step: Array) -> Setup:
        if self.ordinal != NOWHERE:
            return super().stepped(setup, step)
        return setup.with_effect(self.at(self.start + step))

    def columns(self, view: View) -> Array:
        """Return (M, d, k) changes of the readings."""
        assert self.context is not None
        return effect_jacobian(self.effect, self.free, view, self.context)


@dataclass(frozen=True, eq=False)
class DesignModel:
    """Parameters in units of their standard deviations `scale`, and what is known of them.

    Attributes:
        blocks: All that is free, candidates last.
        scale: (P,) prior standard deviations; those of a calibrated arm as its campaign left them.
        known: What is known before the rows that are planned, in units of `scale`.
        prior: (P,) standard deviations before anything was measured; infinite where nobody says.
    """

    blocks: tuple[Block, ...]
    scale: Array
    known: LinearGaussian
    prior: Array

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """What is free, in its order."""
        return parameters_of(self.blocks)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Label of every parameter."""
        return tuple(parameter.label for parameter in self.parameters)

    @cached_property
    def moving(self) -> np.ndarray:
        """(P,) whether a parameter moves the tip, rather than what is read of it."""
        return np.array([parameter.group.moves for parameter in self.parameters], dtype=bool)

    def place(self, block: Block) -> np.ndarray:
        """Return the places of one block's parameters."""
        return places_of(block, self.blocks)

    def rows(self, offer: Offer) -> Array:
        """Return (N, 3, P) changes of offered readings, in standard deviations of the readings."""
        return answers(self.blocks, offer.view) * self.scale

    def std(self, gram: LinearGaussian) -> Array:
        """Return the (P,) standard deviations of all parameters in their units."""
        return self.scale * gram.std


def learning(before: Before, offer: Offer) -> tuple[Before, Offer]:
    """Return both with the laws that are still to be learned free about what was declared, under the offered loads."""
    arm, block = before.setup.arm, law_block(before.setup, offer.view)
    laws, named = learned_laws(arm), () if block is None else zip(block.flexures, block.laws, strict=True)
    new = {name: law for name, law in named if name not in laws}
    if not new:
        return before, offer
    setup = replace(before.setup, arm=with_laws(arm, new))
    return before.seen_by(setup), offer.seen_by(setup)


def answers(blocks: Sequence[Block], view: View) -> Array:
    """Return (M, d, P) whitened changes of the readings of some rows per parameter of blocks made for others."""
    here = [block.of_rows(view.context) for block in blocks]
    return whitened_regressors(here, view, np.ones(view.residual.shape)).reshape(*view.residual.shape, -1)


def model_of(before: Before, offer: Offer, candidates: Sequence[CandidateBlock]) -> DesignModel:
    """Return the model of what is known before, and of rows like those offered.

    Free is what [prior] frees, for the planned session beside the campaign's, learned laws, and the effects of the arm
    that one row informs on; those in question come last.

    Raises:
        InputError: The covariance of a calibrated arm is of other parameters, or of some of the laws that are learned.
    """
    setup, measured = before.setup, before.measured
    arm, laws = setup.arm, learned_laws(setup.arm)
    if measured is None and arm.certainty is not None:
        return _stored(setup, arm.certainty, offer, candidates)
    if measured is None:
        rows = Measurements.of(offer.rows, offer.view.readings)
    else:
        kinds = {
            (type(kind), kind.name): kind for kind in (*offer.view.readings.kinds, *measured.campaign.readings.kinds)
        }
        both = Readings(len(measured.campaign), tuple(kinds.values()))  # of which only the kinds are looked at
        rows = replace(measured.campaign, session=(*measured.campaign.session, offer.rows.session[0]), readings=both)
    blocks = [*declared_blocks(setup, rows), *_law_blocks(laws)]
    asked = {candidate.ordinal for candidate in candidates}
    for ordinal, (effect, number) in enumerate(zip(arm.effects, numbers_of(arm.effects), strict=True)):
        if ordinal not in asked and not effect.remembers:
            free = free_inner(effect)
            prior = amplitude_prior(effect, free, offer.view, offer.view.context)
            blocks.append(EffectBlock(effect, free, offer.view.context, ordinal, prior, number=number))
    blocks += candidates
    scale = _finite(blocks)
    information = LinearGaussian(np.eye(len(scale)))
    if measured is not None:
        kinds = measured.view.readings.kinds
        noise = np.concatenate([np.full(kind.dimension, before.noises.get(kind.name, 1.0)) for kind in kinds])
        information = information.with_rows(
            answers(blocks, measured.view) * scale * (np.sqrt(measured.weights) / noise)[:, :, None]
        )
    return DesignModel(tuple(blocks), scale, information, scale)


def _law_blocks(laws: Mapping[str, LearnedLaw]) -> list[Block]:
    return [LawBlock(tuple(laws), tuple(laws.values()))] if laws else []


def free_inner(effect: Effect) -> tuple[int, ...]:
    """Return which inner parameters a refit would move: those with a scale of their own that the law is smooth in."""
    pairs = zip(effect.law.inner, effect.inner, strict=True)
    return tuple(
        i for i, (inner, value) in enumerate(pairs) if inner.polished and inner.smooth and inner.positive and value > 0
    )


def _finite(blocks: Sequence[Block]) -> Array:
    """Return (P,) prior standard deviations, wide ones for frames of which nothing is known."""
    prior = prior_of(blocks)
    units = np.array([unit for block in blocks for unit in block.units])
    return np.where(np.isfinite(prior), prior, np.where(units == "m", ANYWHERE, ANYHOW))


def _stored(setup: Setup, certainty: Certainty, offer: Offer, candidates: Sequence[CandidateBlock]) -> DesignModel:
    """Return the model of a calibrated arm: frames anew, because another instrument may come.

    A law that is to be learned since is as uncertain as it was declared, whatever was known of its compliance: all
    learned laws, or none.
    """
    arm, laws = setup.arm, learned_laws(setup.arm)
    new = {name: law for name, law in laws.items() if ParameterGroup(ParameterKind.LAW, name) not in certainty.groups}
    if new and len(new) < len(laws):
        old = listing(laws.keys() - new.keys())
        text = f"{listing(new)} is to be learned, but the arm was calibrated with the learned laws of {old} alone"
        raise InputError(f"{text}: plan after its campaign, or calibrate anew")
    parameters = certainty.parameters
    if blocks_of(parameters, setup) is None:
        raise InputError(OTHER_PARAMETERS.text)
    anew = {candidate.parameters[0].group for candidate in candidates if candidate.ordinal != NOWHERE}
    anew |= {ParameterGroup(ParameterKind.COMPLIANCE, name) for name in new}
    certainty_kept = certainty.part(
        [
            i
            for i, parameter in enumerate(parameters)
            if parameter.group.kind not in FRAMES and parameter.group not in anew
        ]
    )
    frames = [frame_block(setup)] if arm.measurement.frame == "unknown" else []
    kept = blocks_of(certainty_kept.parameters, setup, context=offer.view.context)
    assert kept is not None  # some of what is there as a whole
    sensors = [(name, sensor) for name, sensor in arm.sensors.items() if name in offer.view.readings.names]
    keys = {name: sensor_keys(sensor, ("",), offer.view.readings.kinds) for name, sensor in sensors}
    unknown = [
        sensor_block(setup, name, keys[name])
        for name, sensor in sensors
        if keys[name] and (isinstance(sensor, TouchingSensor) or not sensor.found)
    ]
    fresh = [*unknown, *_law_blocks(new), *candidates]
    blocks, std, wide = (*frames, *kept, *fresh), np.sqrt(np.diag(certainty_kept.covariance)), _finite(frames)
    scale = np.concatenate([wide, std, _finite(fresh)])
    normal, inside = np.eye(len(scale)), slice(len(wide), len(wide) + len(std))
    normal[inside, inside] = np.linalg.inv(certainty_kept.covariance / np.outer(std, std))
    prior = [
        block.prior
        if block.kind is ParameterKind.LAW
        else np.full(len(block.parameters), getattr(arm.prior, block.kind, 0.0) or np.inf)
        for block in blocks
    ]
    return DesignModel(blocks, scale, LinearGaussian(normal), np.concatenate(prior))
