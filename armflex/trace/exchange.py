"""Second thoughts: is every effect still worth its number beside the others, and what else would do as well?"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from armflex.effects.catalogue import LAWS
from armflex.effects.law import Effect
from armflex.trace.candidates import Candidate, bank, best_per_spot, candidates_of, screen, sift
from armflex.trace.polish import polish
from armflex.trace.projection import Projection, evidence, project, projected
from armflex.trace.state import State, without

SAME = 14.0
"""Evidence within which two candidates are not told apart."""

COMPARED = 12
"""Best rivals whose inner parameters are refined."""


def leave_out(state: State, index: int) -> tuple[Projection, np.ndarray]:
    """Return the projection of the fit with one effect's columns and values taken out, and those columns' places."""
    fit, block = state.fit, state.effects[index]
    start = sum(len(other.labels) for other in fit.blocks[: fit.blocks.index(block)])
    own = np.arange(start, start + len(block.labels))
    rest = np.setdiff1d(np.arange(len(fit.values)), own)
    amplitudes = own[: len(block.effect.spot.terms)]
    # The readings as they would be without the effect: linear in its amplitudes, so exact for them.
    data = fit.residual + fit.columns[:, amplitudes] @ fit.values[amplitudes] + fit.columns[:, rest] @ fit.values[rest]
    return projected(fit.columns[:, rest], fit.prior[rest] ** -2.0, data, project(fit).shy), own


def equivalents(state: State, index: int) -> tuple[float, tuple[tuple[Effect, float], ...]]:
    """Return an effect's evidence beside the others, and every other candidate within `SAME` of it."""
    projection, own = leave_out(state, index)
    gain = projection.gain(state.fit.columns[:, own])[0]
    block = state.effects[index]
    own_candidate = Candidate(block.effect.law, block.effect.spot, block.effect.inner)
    worth = float(evidence(gain, projection.objective, projection.count, own_candidate.parameters))
    screened = screen(sift(bank(candidates_of(LAWS, state.scene), state.fit, state.scene), projection))
    rivals = []
    for i in best_per_spot(screened, COMPARED + 1):
        candidate = screened.bank.candidates[i]
        if (candidate.law.name, candidate.spot) == (block.effect.law.name, block.effect.spot):
            continue
        refined = polish(candidate, state.fit, state.scene, projection)
        if refined.evidence > worth - SAME:
            rivals.append((refined.candidate.effect(refined.amplitudes), worth - refined.evidence))
    return worth, tuple(sorted(rivals, key=lambda rival: rival[1]))


def exchanged(state: State, say: Callable[[str], None]) -> tuple[State, list[int]]:
    """Return the state without effects that are no longer worth `SAME`, and which those were."""
    dropped: list[int] = []
    places = list(range(len(state.effects)))
    for _ in range(len(places)):
        worths = [_worth(state, i) for i in range(len(state.effects))]
        if not worths or min(worths) >= SAME:
            break
        weakest = int(np.argmin(worths))
        say(f"dropping {state.effects[weakest].effect.name}")
        dropped.append(places.pop(weakest))
        state = without(state, weakest)
    return state, dropped


def _worth(state: State, index: int) -> float:
    projection, own = leave_out(state, index)
    gain = projection.gain(state.fit.columns[:, own])[0]
    return float(evidence(gain, projection.objective, projection.count, len(own)))
