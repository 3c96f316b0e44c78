"""Effects to be distinguished, as one writes them: LAW:SITE[:AXIS[:PARTNER]][#NUMBER], such as backlash:A2:ry.

The parts are `effect`, `site`, `axis` and `partner` of `armflex trace --json` and of [[effect]] in an arm.toml; an
axis or a partner may be left out where there is only one. The second effect of the arm that would be written like the
first ends in #2: gear_harmonic:A2:rz#2.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import InputError, UnknownNameError, UnsupportedError
from armflex.estimate.block import EffectBlock, amplitude_prior
from armflex.estimate.fit import ROUGH, Fit, fit
from armflex.files.effect_file import TEMPERATURE as USUAL_TEMPERATURE
from armflex.files.effect_file import locations_on, names_of
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.context import TEMPERATURE, Context
from armflex.laws.effects.effect import Afterwards, Effect, Inner
from armflex.laws.effects.location import Location
from armflex.parameters import numbered, numbers_of
from armflex.plan.design_model import NOWHERE, Before, CandidateBlock, answers, free_inner
from armflex.plan.offer import Offer

SHOWS = 5.0
"""RMS of what an effect of unknown size is taken to move the readings by, in their standard deviations."""


def spelled(effect: Effect, number: int = 1) -> str:
    """Return how an effect is written on the command line; `number` is that of `numbers_of`."""
    name = _spelled(".".join(part for part in names_of(effect.law) if part), effect.location)
    return name + numbered(number).lstrip()


def _spelled(name: str, location: Location) -> str:
    return ":".join((name, location.place, location.axis or "", location.partner)).rstrip(":")


def named_effect(text: str, arm: Arm, columns: Sequence[str]) -> Effect:
    """Return an effect of the arm, or one that it might have with all its amplitudes at zero, by how it is written.

    It has as many terms as may act at its place. A law that depends on a temperature takes the one of the `columns`
    whose name is that of one. Refused are laws and places that there are not, several places, and what depends on the
    rows before or on a session that has been.
    """
    effects = dict(zip(map(spelled, arm.effects, numbers_of(arm.effects)), arm.effects, strict=True))
    title = _meant(text, effects)
    if title is not None:
        return effects[title]
    name = text.partition(":")[0].strip()
    if name not in CATALOGUE:
        raise UnknownNameError("effect", name, [*CATALOGUE, *effects])
    law = CATALOGUE[name]
    if law.afterwards is Afterwards.OVER:
        raise UnsupportedError(f"{name} is of a session that has been: {law.afterwards.value}")
    locations = {}
    for location in sorted(locations_on(law, arm, recorded=columns), key=lambda location: len(location.terms)):
        locations[_spelled(law.name, location)] = location
    if not locations:
        raise InputError(f"{name} is at no place: a column that it depends on is not given (--after or --covariates)")
    place = _meant(text, locations)
    if place is None:
        raise UnknownNameError(f"place of {law.name}", text, locations)
    location = locations[place]
    warm = [column for column in columns if TEMPERATURE.search(column)]
    if location.covariates == (USUAL_TEMPERATURE,) and len(warm) == 1:
        location = replace(location, covariates=(warm[0],))
    return Effect(law, location, (0.0,) * (len(law.amplitudes) + len(law.inner)))


def _meant(text: str, names: Collection[str]) -> str | None:
    """Return which of some names a text says, as far as it goes; raise `InputError` where it may be several."""
    text = text.strip()
    titles = [text] if text in names else [name for name in names if f"{name}:".startswith(f"{text.rstrip(':')}:")]
    if len(titles) > 1:
        raise InputError(f"{text!r} may be {' or '.join(titles[:6])}: say which")
    return titles[0] if titles else None


@dataclass(frozen=True, eq=False)
class EffectInQuestion:
    """An effect in question.

    Attributes:
        candidate: Its columns.
        size: (k,) values of its free parameters for which rows are planned, inner ones 0.
        source: Where the size is from.
    """

    candidate: CandidateBlock
    size: Array
    source: str

    @property
    def name(self) -> str:
        """How it is written."""
        return spelled(self.candidate.effect, self.candidate.number)


def candidate_of(effect: Effect, arm: Arm, offer: Offer) -> CandidateBlock:
    """Return an effect in question, with inner parameters amid those that a search would begin with.

    What depends on the rows before is refused.
    """
    ordinal = arm.effects.index(effect) if effect in arm.effects else NOWHERE
    number = 1 if ordinal == NOWHERE else numbers_of(arm.effects)[ordinal]
    sized = any(effect.amplitudes)
    if not sized:
        inner = tuple(_usual(inner, effect, offer.view.context) for inner in effect.law.inner)
        effect = replace(effect, values=(*effect.amplitudes, *inner))
    if effect.remembers:
        text = f"{effect.title} depends on the rows before"
        text += ": no choice of single rows distinguishes it from another effect"
        raise UnsupportedError(text)
    free = free_inner(effect) if sized else ()
    prior = amplitude_prior(effect, free, offer.view, offer.view.context)
    return CandidateBlock(effect, free, offer.view.context, ordinal, prior, number=number)


def _usual(inner: Inner, effect: Effect, context: Context) -> float:
    """Return what an inner parameter is taken to be while nobody has searched for it: nothing lags."""
    if effect.law.memory is not None and inner.name == effect.law.memory.lag:
        return 0.0
    if inner.usual is not None:
        return inner.usual
    values = sorted(float(value) for value in inner.grid(effect.location, context))
    return values[len(values) // 2] if values else inner.default or 0.0


def refitted(candidate: CandidateBlock, before: Before) -> Fit | None:
    """Return the campaign's fit with a candidate added, None where there is no campaign or the arm has it already."""
    measured, arm = before.measured, before.setup.arm
    if measured is None or candidate.ordinal != NOWHERE:
        return None
    prior, earlier = amplitude_prior(candidate.effect, (), measured.view, measured.view.context), measured.fit
    block = EffectBlock(candidate.effect, (), measured.view.context, len(arm.effects), prior)
    start = np.concatenate([earlier.values, np.zeros(len(prior))])
    return fit(earlier.declared, (*earlier.blocks, block), measured.campaign, earlier.view.rows, start, effort=ROUGH)


def hypothesis_of(candidate: CandidateBlock, fitted: Fit | None, offer: Offer) -> EffectInQuestion:
    """Return the hypothesis with its size: that of the arm, that of a refit if it is clear, or one that shows.

    What shows moves the readings by `SHOWS`, every term as much as the others.
    """
    effect, terms = candidate.effect, len(candidate.effect.location.terms)
    inner = np.zeros(len(candidate.labels) - terms)
    if any(effect.amplitudes):
        return EffectInQuestion(candidate, np.append(effect.acting, inner), "of the arm")
    if fitted is not None:
        values, std = fitted.values[-terms:], np.sqrt(np.diag(fitted.posterior.covariance))[-terms:]
        # Standard deviations from zero at which an estimate counts as an effect's size.
        if np.linalg.norm(values / std) > 2.0 * np.sqrt(terms):
            return EffectInQuestion(candidate, np.append(values, inner), "estimated from what was measured")
    jacobian = answers([candidate], offer.view)[:, :, :terms]
    moved = np.sqrt((jacobian**2).mean(axis=(0, 1)))
    moving = moved > 0.0
    if not moving.any():
        raise InputError(f"{effect.title} moves the tip in none of the rows that can be measured")
    shown = np.where(moving, SHOWS / np.where(moving, moved, 1.0), 0.0) / np.sqrt(moving.sum())
    source = f"taken so large that it moves readings by {SHOWS:g} standard deviations"
    return EffectInQuestion(candidate, np.append(shown, inner), source)
