"""The account of a search: what every effect is worth, what else would do, what could not be told, and what is left."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import fdtrc

from armflex.conventions import TWIST_NAMES
from armflex.estimate.held_out import believed, held_out, pose_folds
from armflex.estimate.learn import with_posteriors
from armflex.estimate.posterior import certainty_of
from armflex.estimate.view import look
from armflex.laws.effects.effect import Effect
from armflex.measured.repeats import repeats
from armflex.parameters import ArmParameter
from armflex.trace.accept import ENOUGH, MARGIN, null_maximum, prove, sessions_held_out
from armflex.trace.exchange import equivalents, pruned, worth_of
from armflex.trace.findings import (
    Family,
    Found,
    Smallest,
    Trace,
    Undecided,
    Unexplained,
    Unidentifiable,
    predictable_residual,
)
from armflex.trace.next_measurement import lacking, next_rows
from armflex.trace.projection import project
from armflex.trace.search import Round
from armflex.trace.state import State, lost_rows, sorted_out, without
from armflex.trace.unrecorded import NOTICED, RandomTwist, as_likely, localise
from armflex.trace.withdraw import Compared, never_worse

ALMOST = 1e-4
"""Share of a column's square below which what is left of it cannot be seen at any plausible size."""

SHOWN = 23.0
"""Gain at which an effect would have been accepted among thousands of candidates."""

STILL = 1e-12
"""Share of what an amplitude of 1 does to the readings at the place where it does most, below which it is rounding."""

UNLIKELY = 1e-4
"""Probability below which a residual larger than the repeats' scatter is no chance."""

LARGER = 2.0
"""Variance over that of repeats from which a residual without a place is told at all."""


def so_far(state: State, places: tuple[RandomTwist, ...]) -> Trace:
    """Return the account of a search that goes on: what was accepted, with what is known without comparing it.

    `places` are the likeliest of what was left at first.
    """
    left = unexplained(state, localise(state.fit, state.context, project(state.fit), state.groups))
    found = tuple(_found(state, index, worth, ()) for index, worth in _by_themselves(state))
    return _summed_up(state, places, found, left, unfinished=True)


def conclude(state: State, places: tuple[RandomTwist, ...]) -> Trace:
    """Return the account of a search that has come to its end, after second thoughts about what it added."""
    state.say("weighing every effect beside the others")
    *_, state = (state, *pruned(state))
    state, withdrawn, compared = never_worse(sorted_out(state))
    state.say(f"searching what {len(state.rows)} rows still show")
    looked = state.looked  # which costs nothing where nothing changed
    state.say("comparing what else would do")
    found = tuple(_found(state, i, *equivalents(state, i), compared) for i, _ in _by_themselves(state))
    left = unexplained(state, looked.places)
    together = np.setdiff1d(state.asked[~(lost_rows(state, heed=True) | state.untold)], state.rows)
    if left is None and len(together):  # rows left out although their neighbours are far off, too
        view = look(state.fit.setup, state.measurements, together)
        errors = view.residual[:, view.foremost]
        left = Unexplained(None, None, None, None, float(np.sqrt((errors**2).sum() / len(state.asked))))
    state.say("looking what could not be told, and what to measure next")
    undecided = None if state.effects or left is not None or withdrawn else _undecided(state, looked)
    others = {one.index: [hypothesis for hypothesis, _ in one.equivalent] for one in found}
    hypotheses = [others.get(index, []) for index in range(len(state.effects))]
    return _summed_up(
        state,
        places,
        found,
        left,
        undecided=undecided,
        not_identifiable=not_identifiable(looked, state),
        smallest=smallest(looked, state),
        next_measurement=(*next_rows(state, hypotheses), *lacking(state.measurements)),
        compared=compared,
        withdrawn=withdrawn,
    )


def _summed_up(
    state: State, places: tuple[RandomTwist, ...], found: tuple[Found, ...], left: Unexplained | None, **more: Any
) -> Trace:
    """Return the account, with what more there is to tell."""
    fit, calibration = state.fit, state.calibration
    folds, judged = pose_folds(state.groups), believed(state.calibrated, fit)
    # A random twist stays behind, because nobody can foresee it.
    effects = (*calibration.arm.effects, *state.fitted)
    arm, instrument = with_posteriors(fit.setup.arm, fit), fit.setup.instrument
    return Trace(
        arm=replace(arm, effects=effects, instrument=instrument, certainty=certainty_of(fit)),
        calibration=calibration,
        before=state.calibrated,
        state=state,
        found=found,
        families=_families(state),
        unexplained=left,
        places=places,
        noise=fit.noise,
        held_out_before=held_out(state.calibrated, folds, judged=judged).rms,
        held_out_after=held_out(fit, folds, judged=judged).rms,
        held_out_sessions=sessions_held_out(state.calibrated, fit, state.effects, state.sessions),
        **more,
    )


def _undecided(state: State, looked: Round) -> Undecided | None:
    """Return what is left where it is much and the best candidate is no better than chance, None elsewhere."""
    fit, best = state.fit, looked.ranking[0].evidence
    if fit.noise**2 < LARGER:
        return None
    chance = max(float(null_maximum(sifted, state.groups).max()) for sifted in looked.sifted)
    if best >= chance + MARGIN:
        return None  # what was found was refused for other reasons than chance
    poses, stated = int(state.groups.max()) + 1, fit.view.rms(fit.view.sigma)
    return Undecided(fit.rms, stated, poses, best, chance)


def _by_themselves(state: State) -> Iterator[tuple[int, float]]:
    """Yield place and evidence of every effect that was added alone, and of members of families that show alone."""
    for unit in sorted(state.units):
        for index in unit:
            worth = worth_of(state, index)[0]
            if len(unit) == 1 or worth >= ENOUGH:
                yield index, worth


def _families(state: State) -> tuple[Family, ...]:
    found = []
    for unit in state.units:
        step = state.steps[unit[0]]
        if step is not None and step.kin is not None:
            blocks = [state.effects[i] for i in unit]
            stds = [block.std(state.values_of(block), state.stds_of(block)) for block in blocks]
            found.append(Family(step.kin, tuple(zip((state.fitted[i] for i in unit), stds, strict=True)), step.proof))
    return tuple(found)


def _found(
    state: State, index: int, worth: float, others: tuple[tuple[Effect, float], ...], compared: Compared | None = None
) -> Found:
    block, step = state.effects[index], state.steps[index]
    assert step is not None
    proof = step.proof
    if step.exchanged:
        proof = prove(without(state, index), state, proof.null, [block])
    std = block.std(state.values_of(block), state.stds_of(block))
    effect, family = state.fitted[index], None if step.kin is None else step.kin.number
    names = compared.names[index] if compared is not None else ()
    survives = names.count(effect.name) / len(names) if names else None
    return Found(effect, std, worth, proof, others, step.ranking, step.witness, index, family, survives)


def not_identifiable(looked: Round, state: State) -> tuple[Unidentifiable, ...]:
    """Return laws and sites of which fitted parameters take over all but nothing, with the parameter that does most."""
    bank, regressors = looked.sifted[0].bank, looked.projection.regressors
    whole, inside = _left_over(looked)
    sizes = np.maximum(np.sqrt((regressors**2).sum(axis=0)), 1e-300)
    found: dict[tuple[str, str], Unidentifiable] = {}
    added = {(effect.law.name, effect.location) for effect in state.fitted}
    for index, candidate in enumerate(bank.candidates):
        key = (candidate.law.name, candidate.location.place)
        if key in found or bank.sizes[index] != 1 or (candidate.law.name, candidate.location) in added:
            continue
        if whole[index] > 0.0 and inside[index] > ALMOST * whole[index]:
            continue
        partner: ArmParameter | None = None
        if whole[index] > 0.0:  # the parameter whose column is most like its own
            own = bank.group(index)[:, 0]
            likeness = np.abs(regressors.T @ own) / (sizes * float(np.linalg.norm(own)))
            partner = state.fit.parameters[int(likeness.argmax())]
        found[key] = Unidentifiable(*key, partner)
    return tuple(found.values())


def smallest(looked: Round, state: State) -> tuple[Smallest, ...]:
    """Return for every law the range over its places of the tip motion (RMS) that would just have been accepted."""
    bank, fit, where = looked.sifted[0].bank, state.fit, state.fit.view.foremost
    noise = max(1.0, looked.projection.objective / looked.projection.count)
    # (G,) RMS of the 3-D motion of the target per unit of each group's first amplitude [m].
    sigma, raw = fit.view.sigma[:, where], np.zeros(len(bank.candidates))
    scale = np.where(np.isfinite(sigma), sigma, 0.0) / np.sqrt(fit.weights[:, where])
    for part in bank.parts:
        first = np.isin(part.places, bank.starts[:-1])
        regressors = part.regressors[:, first].reshape(*fit.view.sigma.shape, -1)[:, where] * scale[:, :, None]
        raw[part.groups] = np.sqrt((regressors**2).sum(axis=1).mean(axis=0))
    found: dict[str, list[float]] = {}
    whole, inside = _left_over(looked)
    for index in np.flatnonzero((bank.sizes == 1) & (inside > ALMOST * whole)):
        size = float(np.sqrt(SHOWN * noise / inside[index]) * raw[index])
        found.setdefault(bank.candidates[index].law.name, []).append(size)
    return tuple(Smallest(name, min(sizes), max(sizes)) for name, sizes in found.items())


def _left_over(looked: Round) -> tuple[np.ndarray, np.ndarray]:
    """Return the (G,) squares of the first column of every named candidate, and what the fit leaves of them.

    Both are zero where a column is only rounding: an axis through the target moves it by 1e-17, not by nothing.
    """
    named = looked.sifted[0]
    whole, most = np.zeros(len(named.bank.candidates)), {}
    for groups, squares in named.squares:
        whole[groups] = squares[:, 0, 0]
    alike = [(one.law.name, one.location.turns, one.location.terms) for one in named.bank.candidates]  # of a unit
    for kind, square in zip(alike, whole.tolist(), strict=True):
        most[kind] = max(square, most.get(kind, 0.0))
    moves = whole > STILL**2 * np.array([most[kind] for kind in alike])
    inside = whole - (named.seen[named.bank.starts[:-1]] ** 2).sum(axis=1)
    return np.where(moves, whole, 0.0), np.where(moves, inside, 0.0)


def unexplained(state: State, places: tuple[RandomTwist, ...]) -> Unexplained | None:
    """Return what is left above the noise without a cause, None when nothing is.

    Args:
        state: The final fit.
        places: Where a random twist would explain its residual, the likeliest first.
    """
    if state.random is not None:
        random = state.random
        rms = state.fit.view.rms(predictable_residual(state) - state.fit.view.residual)
        return Unexplained(random.site, random.axis, random.std, random.units[0], rms, random.alike)
    place = places[0]
    if place.ratio >= NOTICED:
        rms = place.std * state.fit.view.rms(state.fit.view.to_twist(place.site)[:, :, TWIST_NAMES.index(place.axis)])
        return Unexplained(place.site, place.axis, place.std, place.unit, rms, as_likely(places))
    # Without a place, where it is larger than what repeats show, by an F test.
    known = repeats(state.measurements)
    if known is None:
        return None
    scatter, fit = known.same_session, state.fit
    noise = float((scatter.sigma**2).mean())
    squares = (
        fit.view.residual[:, fit.view.foremost][(fit.weights >= 1.0)[:, fit.view.foremost]] ** 2
    )  # tails make a mean of squares anything
    freedom = max(squares.size - (fit.view.count - fit.freedom), 1.0)
    left = float(squares.sum()) / freedom
    if left < LARGER * noise or fdtrc(freedom, 3 * scatter.freedom, left / noise) > UNLIKELY:
        return None
    return Unexplained(None, None, None, None, float(np.sqrt(3.0 * (left - noise))))
