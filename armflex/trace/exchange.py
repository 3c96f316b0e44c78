"""Second thoughts: is every effect still worth its number beside the others, and what else would do as well?"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from armflex.calibrate.fit import robust_limit
from armflex.effects.catalogue import LAWS
from armflex.effects.law import Effect
from armflex.effects.unnamed import SHAPES, shaped_places
from armflex.errors import ArmflexError
from armflex.trace.candidates import Candidate, bank, best_per_spot, candidates_of, screen, sift
from armflex.trace.polish import Polished, polish
from armflex.trace.projection import Projection, evidence, projected, shyness
from armflex.trace.search import PLAIN
from armflex.trace.state import State, add, information, moved_to, stands, without

SAME = 14.0
"""Evidence within which two candidates are not told apart."""

SWAPPED = 3
"""Most effects that are tried in each other's places: each trial refits everything twice."""

COMPARED = 12
"""Best rivals whose inner parameters are refined."""


def leave_out(state: State, index: int) -> tuple[Projection, np.ndarray]:
    """Return the projection of the fit with one effect's columns and values taken out, and those columns' places."""
    fit, block = state.fit, state.effects[index]
    own = fit.places(block)
    rest = np.setdiff1d(np.arange(len(fit.values)), own)
    amplitudes = own[: len(block.effect.spot.terms)]
    # The readings as they would be without the effect: linear in its amplitudes, so exact for them.
    data = fit.residual + fit.columns[:, amplitudes] @ fit.values[amplitudes] + fit.columns[:, rest] @ fit.values[rest]
    return projected(fit.columns[:, rest], fit.prior[rest] ** -2.0, data, shyness(fit)), own


def rivals_of(state: State, index: int) -> tuple[float, tuple[Polished, ...]]:
    """Return an effect's evidence beside the others, and the best candidates that could stand in its place."""
    projection, own = leave_out(state, index)
    gain = projection.gain(state.fit.columns[:, own])[0]
    block = state.effects[index]
    itself = Candidate(block.effect.law, block.effect.spot, block.at(state.values_of(block)).inner)
    worth = float(evidence(gain, projection.objective, projection.count, itself.parameters))
    screened = screen(sift(bank(_alternatives(itself, state), state.fit, state.scene), projection))
    rivals = []
    for i in best_per_spot(screened, COMPARED + 1):
        candidate = screened.bank.candidates[i]
        if not _same_place(candidate, itself):
            rivals.append(polish(candidate, state.fit, state.scene, projection))
    return worth, tuple(sorted(rivals, key=lambda one: -one.evidence))


def _alternatives(itself: Candidate, state: State) -> Iterator[Candidate]:
    """Yield the catalogue, and for a shape without a name the same shape at every other place."""
    yield from candidates_of(LAWS, state.scene)
    if itself.law.name in SHAPES:
        for site, axis in shaped_places(state.scene):
            yield replace(itself, spot=replace(itself.spot, site=site, axis=axis))


def _same_place(one: Candidate, other: Candidate) -> bool:
    return (one.law.name, one.spot.site, one.spot.axis, one.spot.partner) == (
        other.law.name,
        other.spot.site,
        other.spot.axis,
        other.spot.partner,
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


def exchanged(state: State, say: Callable[[str], None]) -> tuple[State, list[int]]:
    """Return the state without effects that are no longer worth `SAME`, and which those were.

    Where several were added one by one, the first were chosen while the others were missing: what now stands clearly
    better in an effect's place takes it.
    """
    state, dropped = _pruned(state, say)
    if 1 < len(state.effects) <= SWAPPED:
        for index in range(len(state.effects)):
            state = _swapped(state, index, say)
    return state, dropped


def _swapped(state: State, index: int, say: Callable[[str], None]) -> State:
    """Return the state with a clearly better candidate in place of one effect, as it is where there is none."""
    worth, rivals = rivals_of(state, index)
    was_plain = state.effects[index].effect.law.name in PLAIN
    better = [one for one in rivals if one.evidence > worth + SAME and was_plain <= (one.candidate.law.name in PLAIN)]
    if not better:
        return state
    say(f"trying {better[0].candidate.effect(better[0].amplitudes).name} for {state.effects[index].effect.name}")
    try:
        trial = moved_to(add(without(state, index), better[0]), index)
    except ArmflexError:
        return state
    limit = robust_limit(state.fit.view)
    is_better = stands(trial) and information(trial, limit) < information(state, limit) - SAME
    return trial if is_better else state


def _pruned(state: State, say: Callable[[str], None]) -> tuple[State, list[int]]:
    dropped: list[int] = []
    places = list(range(len(state.effects)))
    for _ in range(len(places)):
        worths = [_worth(state, i) for i in range(len(state.effects))]
        if not worths or min(worths) >= SAME:
            break
        weakest = int(np.argmin(worths))
        trial = without(state, weakest)
        limit = robust_limit(state.fit.view)
        if (
            information(trial, limit) > information(state, limit) + SAME
        ):  # the linear estimate misses how much the rest must bend
            break
        say(f"dropping {state.effects[weakest].effect.name}")
        dropped.append(places.pop(weakest))
        state = trial
    return state, dropped


def _worth(state: State, index: int) -> float:
    projection, own = leave_out(state, index)
    gain = projection.gain(state.fit.columns[:, own])[0]
    return float(evidence(gain, projection.objective, projection.count, len(own)))
