"""Second thoughts: is every effect still worth its number beside the others, and what else would do as well?"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from armflex.errors import ArmflexError
from armflex.estimate.effect_block import EffectBlock
from armflex.estimate.robust import robust_limit
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.unnamed import shaped_places
from armflex.trace.candidates import Candidate, bank, best_per_spot, candidates_of, screen, sift
from armflex.trace.polish import Polished, polish
from armflex.trace.projection import Projection, evidence, projected, ridge_for
from armflex.trace.state import State, add, information, moved_to, stands, without

SAME = 14.0
"""Evidence within which two candidates are not told apart."""

SWAPPED = 3
"""Most effects that are tried in each other's places: each trial refits everything twice."""

COMPARED = 12
"""Best rivals whose inner parameters are refined."""


@dataclass(frozen=True, eq=False)
class Exchanged:
    """Effects after second thoughts.

    Attributes:
        state: The state with them.
        steps: For each, the number of the step in which it, or what it stands for, was added.
        fresh: Places of those that took another's place.
    """

    state: State
    steps: tuple[int, ...]
    fresh: frozenset[int] = frozenset()


def worth_of(state: State, index: int) -> float:
    """Return the evidence of one effect beside the others."""
    return _beside_others(state, index)[1]


def leave_out(state: State, *indices: int) -> tuple[Projection, np.ndarray]:
    """Return the projection of the fit with some effects' columns and values taken out, and those columns' places."""
    fit = state.fit
    places = [fit.places(state.effects[index]) for index in indices]
    own = np.concatenate(places)
    rest = np.setdiff1d(np.arange(len(fit.values)), own)
    terms = (len(state.effects[index].effect.location.terms) for index in indices)
    amplitudes = np.concatenate([place[:count] for place, count in zip(places, terms, strict=True)])
    # The readings as they would be without the effect: linear in its amplitudes, so exact for them.
    data = fit.residual + fit.columns[:, amplitudes] @ fit.values[amplitudes] + fit.columns[:, rest] @ fit.values[rest]
    return projected(fit.columns[:, rest], fit.precision[rest], data, ridge_for(fit), fit.view.count), own


def rivals_of(state: State, *indices: int) -> tuple[float, tuple[Polished, ...]]:
    """Return the evidence of some effects beside the others, and the best candidates that could take their place."""
    themselves = [_candidate(state, state.effects[index]) for index in indices]
    projection, worth = _beside_others(state, *indices)
    others = [one for one in themselves if one.law.shape]
    # What the search has looked at is looked at again, all but shapes without a name.
    tried = bank(_alternatives(others, state), state.fit, state.scene, state.tell) if others else state.physical
    screened = screen(sift(tried, projection))
    if not others:
        nameless = [bool(one.law.shape) for one in tried.candidates]
        screened = replace(screened, evidence=np.where(nameless, -np.inf, screened.evidence))
    rivals = []
    for number, i in enumerate(best_per_spot(screened, COMPARED + 1)):
        candidate = screened.bank.candidates[i]
        state.tell(f"refining {candidate.name}", number, COMPARED + 1)
        if not any(_same_place(candidate, one) for one in themselves):
            rivals.append(polish(candidate, state.fit, state.scene, projection))
    return worth, tuple(sorted(rivals, key=lambda one: -one.evidence))


def _beside_others(state: State, *indices: int) -> tuple[Projection, float]:
    """Return the projection without some effects, and their evidence there.

    They are charged for all that the search chose, like their rivals: also a moment or a number of waves, which no fit
    moves.
    """
    projection, own = leave_out(state, *indices)
    gain = projection.gain(state.fit.columns[:, own])[0]
    parameters = sum(_candidate(state, state.effects[index]).parameters for index in indices)
    return projection, float(evidence(gain, projection.objective, projection.count, parameters))


def _candidate(state: State, block: EffectBlock) -> Candidate:
    return Candidate(block.effect.law, block.effect.location, block.at(state.values_of(block)).inner)


def _alternatives(themselves: Sequence[Candidate], state: State) -> Iterator[Candidate]:
    """Yield the catalogue, and for a shape without a name the same shape at every other place."""
    yield from candidates_of(CATALOGUE.values(), state.scene)
    for one in themselves:
        for site, axis in shaped_places(state.scene.records):
            yield replace(one, location=replace(one.location, site=site, axis=axis))


def _same_place(one: Candidate, other: Candidate) -> bool:
    return (one.law.name, one.location.site, one.location.axis, one.location.partner) == (
        other.law.name,
        other.location.site,
        other.location.axis,
        other.location.partner,
    )


def equivalents(state: State, index: int) -> tuple[float, tuple[tuple[Effect, float], ...]]:
    """Return an effect's evidence beside the others, and every other candidate within `SAME` of it, once per place."""
    worth, rivals = rivals_of(state, index)
    found: dict[str, tuple[Effect, float]] = {}
    for one in rivals:
        effect = one.candidate.effect(one.amplitudes)
        if one.gain > 0.0 and one.evidence > worth - SAME:
            found.setdefault(effect.title, (effect, worth - one.evidence))
    return worth, tuple(found.values())


def exchanged(state: State, say: Callable[[str], None]) -> Exchanged:
    """Return the effects without those that are no longer worth `SAME`.

    Where several were added one by one, the first were chosen while the others were missing: what now stands clearly
    better in an effect's place takes it, and one that does as well as two takes theirs.
    """
    now = _pruned(state, say)
    if not 1 < len(now.state.effects) <= SWAPPED:
        return now
    for index in range(len(now.state.effects)):
        now = _swapped(now, index, say)
    for pair in combinations(range(len(now.state.effects)), 2):
        merged = _merged(now, *pair, say)
        if merged is not None:
            return merged
    return now


def _swapped(now: Exchanged, index: int, say: Callable[[str], None]) -> Exchanged:
    """Return the effects with a clearly better candidate in place of one, as they are where there is none."""
    state = now.state
    worth, rivals = rivals_of(state, index)
    was_plain = state.effects[index].effect.law.plain
    better = [one for one in rivals if one.evidence > worth + SAME and was_plain <= one.candidate.law.plain]
    trial = _trial(state, (index,), better, say)
    if trial is None or _information(trial, state) > _information(state, state) - SAME:
        return now
    return Exchanged(trial, now.steps, now.fresh | {index})


def _merged(now: Exchanged, first: int, second: int, say: Callable[[str], None]) -> Exchanged | None:
    """Return the effects with one in place of two, None where none does as well."""
    state = now.state
    worth, rivals = rivals_of(state, first, second)
    trial = _trial(state, (first, second), [one for one in rivals if one.evidence > worth], say)
    if trial is None or _information(trial, state) > _information(state, state):
        return None
    steps = tuple(step for i, step in enumerate(now.steps) if i != second)
    return Exchanged(trial, steps, frozenset(i - (i > second) for i in now.fresh if i != second) | {first})


def _trial(
    state: State, indices: Sequence[int], better: Sequence[Polished], say: Callable[[str], None]
) -> State | None:
    """Return the state with the first of some candidates in place of effects, None where it cannot stand there."""
    if not better:
        return None
    names = " and ".join(state.effects[index].effect.name for index in indices)
    say(f"trying {better[0].candidate.effect(better[0].amplitudes).name} for {names}")
    kept = state
    for index in sorted(indices, reverse=True):
        kept = without(kept, index)
    try:
        trial = moved_to(add(kept, better[0]), indices[0])
    except ArmflexError:
        return None
    return trial if stands(trial) and len(trial.effects) == len(state.effects) - len(indices) + 1 else None


def _information(trial: State, state: State) -> float:
    return information(trial, robust_limit(state.fit.view))


def _pruned(state: State, say: Callable[[str], None]) -> Exchanged:
    steps = list(range(len(state.effects)))
    while state.effects:
        worths = [worth_of(state, i) for i in range(len(state.effects))]
        weakest = int(np.argmin(worths))
        if worths[weakest] >= SAME:
            break
        trial = without(state, weakest)
        # The linear estimate misses how much the rest must bend.
        if _information(trial, state) > _information(state, state) + SAME:
            break
        say(f"dropping {state.effects[weakest].effect.name}")
        steps.pop(weakest)
        state = trial
    return Exchanged(state, tuple(steps))
