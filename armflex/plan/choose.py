"""Which of many rows to measure: the best one after the other, then exchanged until none is better (Fedorov 1972)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armflex.conventions import Array
from armflex.linear_gaussian import LinearGaussian
from armflex.plan.information import Goal

WORTH = 1e-6
"""Share of what is reached by which an exchange must raise it: less is rounding."""


def greedy(goal: Goal, known: LinearGaussian, rows: Array, count: int) -> list[int]:
    """Return the numbers of `count` of (N, d, P) rows, each the best after those before it; none twice."""
    chosen: list[int] = []
    for _ in range(min(count, len(rows))):
        chosen.append(_best(goal, known.with_rows(rows[chosen]), rows, chosen)[0])
    return chosen


def exchanged(goal: Goal, known: LinearGaussian, rows: Array, chosen: Sequence[int], rounds: int) -> list[int]:
    """Return the choice after each row was given up for the best there is in its place, at most `rounds` times each."""
    chosen = list(chosen)
    for _ in range(rounds):
        before = list(chosen)
        for place in range(len(chosen)):
            others = chosen[:place] + chosen[place + 1 :]
            without = known.with_rows(rows[others])
            best, gains = _best(goal, without, rows, others)
            if gains[best] > gains[chosen[place]] + WORTH * abs(gains[chosen[place]]):
                chosen[place] = best
        if chosen == before:
            break
    return chosen


def _best(goal: Goal, known: LinearGaussian, rows: Array, taken: Sequence[int]) -> tuple[int, Array]:
    gains = goal.gains(known, rows)
    free = gains.copy()
    free[list(taken)] = -np.inf
    return int(free.argmax()), gains


def path(goal: Goal, known: LinearGaussian, rows: Array) -> Array:
    """Return (n + 1,) what is reached after none, one, two ... of (n, d, P) rows in their order."""
    reached = [goal.value(known)]
    for row in rows:
        known = known.with_rows(row)
        reached.append(goal.value(known))
    return np.array(reached)
