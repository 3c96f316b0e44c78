"""Second thoughts: is every effect still worth its number beside the others, and what else would do as well?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, islice

import numpy as np

from armflex.errors import ArmflexError
from armflex.estimate.robust import robust_limit
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.unnamed import shaped_places
from armflex.trace.candidates import Candidate, bank, best_per_spot, candidates_of, sift
from armflex.trace.polish import Polished, polish
from armflex.trace.projection import Projection, evidence, projected, ridge_for
from armflex.trace.state import State, add, candidate_of, information, moved_to, stands, without

SAME = 14.0
"""Evidence within which two candidates are not told apart."""

SWAPPED = 3
"""Most effects that are tried in each other's places: each trial refits everything twice."""

COMPARED = 12
"""Best hypotheses whose inner parameters are refined."""


def leave_out(state: State, *indices: int) -> tuple[Projection, np.ndarray]:
    """Return the projection of the fit with some effects' columns and values taken out, and those columns' places."""
    fit = state.fit
    places = [fit.places(state.effects[index]) for index in indices]
    own = np.concatenate(places)
    rest = np.setdiff1d(np.arange(len(fit.values)), own)
    terms = (len(state.effects[index].effect.location.terms) for index in indices)
    amplitudes = np.concatenate([place[:count] for place, count in zip(places, terms, strict=True)])
    # The readings as they would be without the effect: linear in its amplitudes, so exact for them.
    data = (
        fit.residual
        + fit.regressors[:, amplitudes] @ fit.values[amplitudes]
        + fit.regressors[:, rest] @ fit.values[rest]
    )
    return projected(fit.regressors[:, rest], fit.precision[rest], data, ridge_for(fit), fit.view.count), own


def worth_of(state: State, *indices: int) -> tuple[float, Projection]:
    """Return the evidence of some effects beside the others, and the projection without them.

    They are charged for all that the search chose, like the other hypotheses: also a moment or a number of waves, which
    no fit moves.
    """
    projection, own = leave_out(state, *indices)
    gain = projection.gain(state.fit.regressors[:, own])[0]
    parameters = sum(candidate_of(state.fitted[index]).parameters for index in indices)
    return float(evidence(gain, projection.objective, projection.count, parameters)), projection


def hypotheses_of(state: State, *indices: int) -> tuple[float, tuple[Polished, ...]]:
    """Return the evidence of some effects beside the others, and the best candidates that could take their place.

    Those are of the catalogue, and for a shape without a name the same shape at every other place.
    """
    themselves = [candidate_of(state.fitted[index]) for index in indices]
    worth, projection = worth_of(state, *indices)
    shapes = [one for one in themselves if one.law.shape]

    def tried() -> Iterator[Candidate]:
        yield from candidates_of(CATALOGUE.values(), state.context)
        for one in shapes:
            for site, axis in shaped_places(state.context.records):
                yield replace(one, location=replace(one.location, site=site, axis=axis))

    def spot(one: Candidate) -> tuple[str, str, str | None, str]:
        return one.law.name, one.location.site, one.location.axis, one.location.partner

    # What the search has looked at is looked at again, all but shapes without a name.
    sifted = sift(bank(tried(), state.fit, state.context, state.tell) if shapes else state.physical, projection)
    found = (sifted.bank.candidates[i] for i in best_per_spot(sifted, len(sifted.bank.candidates)))
    taken, hypotheses = {spot(one) for one in themselves}, []
    for number, candidate in enumerate(islice((one for one in found if shapes or not one.law.shape), COMPARED + 1)):
        state.tell(f"refining {candidate.name}", number, COMPARED + 1)
        if spot(candidate) not in taken:
            hypotheses.append(polish(candidate, state.fit, state.context, projection))
    return worth, tuple(sorted(hypotheses, key=lambda one: -one.evidence))


def equivalents(state: State, index: int) -> tuple[float, tuple[tuple[Effect, float], ...]]:
    """Return an effect's evidence beside the others, and every other candidate within `SAME` of it, once per place."""
    worth, hypotheses = hypotheses_of(state, index)
    found: dict[str, tuple[Effect, float]] = {}
    for one in hypotheses:
        if one.gain > 0.0 and one.evidence > worth - SAME:
            found.setdefault(one.effect.title, (one.effect, worth - one.evidence))
    return worth, tuple(found.values())


def exchanged(state: State) -> State:
    """Return the state without effects that are no longer worth `SAME`.

    Where several were added one by one, the first were chosen while the others were missing: what now stands clearly
    better in an effect's place takes it, and one that does as well as two takes theirs.
    """
    state = _pruned(state)
    alone = [unit[0] for unit in state.units if len(unit) == 1]
    if not 1 < len(alone) <= SWAPPED:
        return state
    for index in alone:
        worth, hypotheses = hypotheses_of(state, index)
        plain = state.effects[index].effect.law.plain
        better = [one for one in hypotheses if one.evidence > worth + SAME and plain <= one.candidate.law.plain]
        state = in_place(state, (index,), better, SAME) or state
    for pair in combinations(alone, 2):
        worth, hypotheses = hypotheses_of(state, *pair)
        merged = in_place(state, pair, [one for one in hypotheses if one.evidence > worth], 0.0)
        if merged is not None:
            return merged
    return state


def in_place(state: State, indices: Sequence[int], better: Sequence[Polished], margin: float) -> State | None:
    """Return the state with the first of some candidates in place of effects.

    None where it cannot stand there, or where the information criterion falls by less than a margin.
    """
    if not better:
        return None
    first, names = indices[0], " and ".join(state.effects[index].effect.name for index in indices)
    state.say(f"trying {better[0].effect.name} for {names}")
    try:
        trial = moved_to(add(without(state, *indices), better[0]), first)
    except ArmflexError:
        return None
    if not stands(trial) or len(trial.effects) != len(state.effects) - len(indices) + 1:
        return None
    if _information(trial, state) > _information(state, state) - margin:
        return None
    step = state.steps[first]
    assert step is not None
    return replace(trial, steps=(*trial.steps[:first], replace(step, exchanged=True), *trial.steps[first + 1 :]))


def _information(trial: State, state: State) -> float:
    return information(trial, robust_limit(state.fit.view))


def _pruned(state: State) -> State:
    while alone := [unit[0] for unit in state.units if len(unit) == 1]:
        worths = [worth_of(state, i)[0] for i in alone]
        weakest = alone[int(np.argmin(worths))]
        if min(worths) >= SAME:
            break
        trial = without(state, weakest)
        # The linear estimate misses how much the rest must bend.
        if _information(trial, state) > _information(state, state) + SAME:
            break
        state.say(f"dropping {state.effects[weakest].effect.name}")
        state = trial
    return state
