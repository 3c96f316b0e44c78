"""What a plan is linear in: every parameter that is free, what is known of each, and how offered rows answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import Flag, InputError, listing
from armflex.estimate import calibrate
from armflex.estimate.block import Block, parameters_of, places_of
from armflex.estimate.blocks import blocks_of, declared_blocks, frame_block
from armflex.estimate.effect_block import EffectBlock, amplitude_prior, effect_columns
from armflex.estimate.fit import Fit, prior_of
from armflex.estimate.law_block import LawBlock, law_block, learned_laws, with_laws
from armflex.estimate.robust import whitened_columns
from armflex.estimate.spread import OTHER_PARAMETERS, scene_of
from armflex.estimate.view import View, look
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.scene import Scene
from armflex.laws.learned import LearnedLaw
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.measurements import Measurements
from armflex.parameters import FRAMES, ArmParameter, Group, Kind, numbers_of
from armflex.plan.offer import Offer
from armflex.readings.instrument import Instrument
from armflex.setup import Setup

NOWHERE = -1
"""Place of an effect that the arm has not among its own."""

ANYWHERE, ANYHOW = 100.0, 3.0
"""Standard deviations [m, rad] of where an instrument stands of which nothing is known."""


@dataclass(frozen=True, eq=False)
class Before:
    """The arm as it is known before the rows that are planned.

    Attributes:
        setup: Arm and instrument, calibrated where there is something to do it with.
        campaign: What was measured, None where nothing was.
        view: All of its rows.
        scene: The same as effects see them.
        weights: (M,) what every row counts beside the others, 0 where nothing was read.
        fit: The campaign's fit.
        noise: Standard deviation of the readings over the stated one, 1 or more.
        flags: Doubts about the campaign.
    """

    setup: Setup
    campaign: Measurements | None = None
    view: View | None = None
    scene: Scene | None = None
    weights: Array | None = None
    fit: Fit | None = None
    noise: float = 1.0
    flags: tuple[Flag, ...] = ()

    def seen_by(self, setup: Setup) -> Before:
        """Return the same as another arm or instrument has it."""
        if self.campaign is None:
            return replace(self, setup=setup)
        view = look(setup, self.campaign, np.arange(len(self.campaign)))
        return replace(self, setup=setup, view=view, scene=scene_of(view, self.campaign))


def known_before(arm: Arm, after: Measurements | None, as_stated: bool) -> Before:
    """Return an arm as it is known, calibrated with a campaign where there is one.

    Of an arm that is calibrated already only the instrument is placed anew. An effect in question may be what makes
    readings scatter: then they are weighed `as_stated`.

    Raises:
        ArmflexError: The campaign cannot be that of this arm, see `calibrate`.
    """
    if after is None:
        return Before(Setup(arm, arm.instrument or Instrument()))
    found = calibrate(arm, after, keep=arm.certainty is not None, as_stated=as_stated)
    fitted = found.fit
    view = look(fitted.setup, after, np.arange(len(after)))
    weights = np.zeros(len(after))
    weights[fitted.view.rows] = fitted.weights
    scene, noise = scene_of(view, after), max(found.scatter, 1.0)
    return Before(fitted.setup, after, view, scene, weights, fitted, noise, found.flags)


@dataclass(frozen=True, eq=False)
class Suspect(EffectBlock):
    """An effect that is in question: free about its own values, whether or not the arm has it (`ordinal` NOWHERE)."""

    def columns(self, view: View) -> Array:
        """Return (M, d, k) changes of the readings."""
        return effect_columns(self.effect, self.free, view, self.scene)


@dataclass(frozen=True, eq=False)
class Model:
    """Parameters in units of their standard deviations `scale`, and what is known of them.

    Attributes:
        blocks: All that is free, suspects last.
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
        return answers(self.blocks, offer.view, offer.scene) * self.scale

    def std(self, known: LinearGaussian) -> Array:
        """Return the (P,) standard deviations of all parameters in their units."""
        return self.scale * known.std


def learning(before: Before, offer: Offer) -> tuple[Before, Offer]:
    """Return both with the laws that are still to be learned free about what was declared, under the offered loads."""
    arm = before.setup.arm
    known, block = learned_laws(arm), law_block(before.setup, offer.view)
    named = () if block is None else zip(block.flexures, block.laws, strict=True)
    new = {name: law for name, law in named if name not in known}
    if not new:
        return before, offer
    setup = replace(before.setup, arm=with_laws(arm, new))
    return before.seen_by(setup), offer.seen_by(setup)


def answers(blocks: Sequence[Block], view: View, scene: Scene) -> Array:
    """Return (M, d, P) whitened changes of the readings of some rows per parameter of blocks made for others."""
    here = [block.of_rows(scene) for block in blocks]
    return whitened_columns(here, view, np.ones(len(view.rows))).reshape(*view.residual.shape, -1)


def model_of(before: Before, offer: Offer, suspects: Sequence[Suspect]) -> Model:
    """Return the model of what is known before, and of rows like those offered."""
    arm = before.setup.arm
    if before.campaign is None and arm.certainty is not None:
        return _stored(before.setup, offer, suspects)
    blocks = (*_declared(before, offer, suspects), *suspects)
    scale = _finite(blocks)
    known = LinearGaussian(np.eye(len(scale)))
    if before.campaign is not None:
        columns = answers(blocks, before.view, before.scene) * scale / before.noise
        known = known.with_rows(columns * np.sqrt(before.weights)[:, None, None])
    return Model(blocks, scale, known, scale)


def _declared(before: Before, offer: Offer, suspects: Sequence[Suspect]) -> tuple[Block, ...]:
    """Return the blocks of [prior], of learned laws and of effects, the planned session beside the campaign's."""
    known, planned = before.campaign, offer.rows.session[0]
    if known is None:
        rows = Measurements.of(offer.rows, offer.view.readings)
    else:
        rows = replace(known, session=(*known.session, planned))
    arm, laws = before.setup.arm, learned_laws(before.setup.arm)
    learned = (LawBlock(tuple(laws), tuple(laws.values())),) if laws else ()
    return (*declared_blocks(before.setup, rows), *learned, *_effect_blocks(arm, offer, suspects))


def _effect_blocks(arm: Arm, offer: Offer, suspects: Sequence[Suspect]) -> list[Block]:
    """Return the blocks of the arm's effects that one row tells something of, without those in question."""
    asked = {suspect.ordinal for suspect in suspects}
    blocks: list[Block] = []
    for ordinal, (effect, number) in enumerate(zip(arm.effects, numbers_of(arm.effects), strict=True)):
        if ordinal not in asked and not effect.remembers:
            free = free_inner(effect)
            prior = amplitude_prior(effect, free, offer.view, offer.scene)
            blocks.append(EffectBlock(effect, free, offer.scene, ordinal, prior, number=number))
    return blocks


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


def _stored(setup: Setup, offer: Offer, suspects: Sequence[Suspect]) -> Model:
    """Return the model of a calibrated arm: frames anew, because another instrument may come.

    A law that is to be learned since is as uncertain as it was declared, whatever was known of its compliance.

    Raises:
        InputError: The covariance is of other parameters, or of some of the laws that are learned.
    """
    arm, new = setup.arm, _new_laws(setup.arm)
    asked = {suspect.parameters[0].group for suspect in suspects if suspect.ordinal != NOWHERE}
    asked |= {Group(Kind.COMPLIANCE, name) for name in new}
    parameters = arm.certainty.parameters
    if blocks_of(parameters, setup) is None:
        raise InputError(OTHER_PARAMETERS.text)
    frames = [frame_block(setup)] if arm.measurement.frame == "unknown" else []
    places = [i for i, one in enumerate(parameters) if one.group.kind not in FRAMES and one.group not in asked]
    known = arm.certainty.part(places)
    kept = blocks_of(known.parameters, setup, scene=offer.scene)
    covariance = known.covariance
    fresh = (*((LawBlock(tuple(new), tuple(new.values())),) if new else ()), *suspects)
    blocks = (*frames, *kept, *fresh)
    std = np.sqrt(np.diag(covariance))
    scale = np.concatenate([_finite(frames), std, _finite(fresh)])
    normal, first = np.eye(len(scale)), len(scale) - len(std) - len(_finite(fresh))
    inside = slice(first, first + len(std))
    normal[inside, inside] = np.linalg.inv(covariance / np.outer(std, std))
    return Model(blocks, scale, LinearGaussian(normal), np.concatenate([_told(block, arm) for block in blocks]))


def _new_laws(arm: Arm) -> dict[str, LearnedLaw]:
    """Return the learned laws by flexure that a calibrated arm's covariance says nothing of: all, or none."""
    laws, fitted = learned_laws(arm), arm.certainty.groups
    new = {name: law for name, law in laws.items() if Group(Kind.LAW, name) not in fitted}
    if new and len(new) < len(laws):
        old = listing(laws.keys() - new.keys())
        text = f"{listing(new)} is to be learned, but the arm was calibrated with the learned laws of {old} alone"
        raise InputError(f"{text}: plan after its campaign, or calibrate anew")
    return new


def _told(block: Block, arm: Arm) -> Array:
    """Return the standard deviations of a block's parameters before anything was measured."""
    if block.kind is Kind.LAW:
        return block.prior
    return np.full(len(block.parameters), getattr(arm.prior, block.kind, 0.0) or np.inf)
