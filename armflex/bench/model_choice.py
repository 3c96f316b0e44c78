"""Which model a joint needs: all compared on the same held-out rows, the plainest within one standard error taken.

The choice itself is part of what is held out: `assess` chooses anew inside every fold, so that the error it reports is
that of "let armflex choose", not that of the winner on the rows that made it win.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armflex.bench.cross_validation import HeldOut, Step, hold_out, random_folds
from armflex.bench.fitted import Fitted, Learner
from armflex.conventions import Array
from armflex.errors import InputError
from armflex.measured.joint_data import JointData

NEGLIGIBLE = 1e-6
"""Part of what a deflection moves that no bench can tell from nothing."""

FOLDS, REPEATS = 10, 2
OUTER = 10
INNER = 5


@dataclass(frozen=True)
class Rival:
    """A model that may be chosen, by a `name` that tells its options; rivals are listed the plainest first."""

    name: str
    model: str
    learner: Learner


@dataclass(frozen=True)
class Compared:
    """A rival and its held-out errors.

    Attributes:
        name, model: Of the rival.
        squares: (N, k) mean squared error of every number over the repeats; infinite where it could not be fitted.
        reason: Why it could not, or that it was left because it could not be chosen any more.
        seconds: How long it took.
    """

    name: str
    model: str
    squares: Array
    reason: str = ""
    seconds: float = 0.0

    @property
    def rms(self) -> Array:
        """(k,) RMS of each column [m, rad]."""
        return np.sqrt(self.squares.mean(axis=0))


def compare(
    rivals: Sequence[Rival],
    data: JointData,
    seed: int = 0,
    folds: int = FOLDS,
    repeats: int = REPEATS,
    step: Callable[[], None] | None = None,
) -> tuple[Compared, ...]:
    """Return every rival's errors on the same random folds; `step` is called after every fit."""
    found: list[Compared] = []
    for rival in rivals:
        found.append(_compared(rival, data, seed, (folds, repeats), lambda residual: step and step()))
    return tuple(found)


def _compared(rival: Rival, data: JointData, seed: int, times: tuple[int, int], step: Step) -> Compared:
    """Return a rival's errors over the repeats of the folds, or why it has none."""
    began, reason = time.perf_counter(), ""
    folds, repeats = times
    try:
        drawn = [(random_folds(len(data), folds, seed + repeat), seed + repeat) for repeat in range(repeats)]
        parts = [hold_out(rival.learner, data, fold, own, step).residual ** 2 for fold, own in drawn]
        squares = np.mean(parts, axis=0)
        if np.isnan(squares).any():
            squares, reason = np.full_like(squares, np.inf), "it could not be chosen any more"
    except InputError as error:  # too few rows for this model: it is no rival
        squares, reason = np.full_like(data.deflections, np.inf), str(error)
    return Compared(rival.name, rival.model, squares, reason, time.perf_counter() - began)


def race(rivals: Sequence[Rival], data: JointData, seed: int, folds: int, least: Array) -> int:
    """Return what `chosen` makes of `compare`, without fits that no longer matter.

    The last rival, which takes longest, is chosen only where its mean loss is the smallest of all. Its squares can but
    add up: once those of the rows that it has seen, with nothing for the others, are as large in every column as the
    best rival's over all rows, and its loss above the best one's, it cannot be, and the scale of no column is its own.
    """
    found = list(compare(rivals[:-1], data, seed, folds, 1))
    means = np.array([one.squares.mean(axis=0) for one in found])
    scale = np.maximum(means.min(axis=0), np.square(least))
    best = float((means / scale).mean(axis=1).min()) if np.isfinite(scale).all() else np.inf

    def step(residual: Array) -> bool:
        at_least = np.nansum(residual**2, axis=0) / len(residual)
        return bool((at_least < means.min(axis=0)).any() or (at_least / scale).mean() <= best)

    return chosen([*found, _compared(rivals[-1], data, seed, (folds, 1), step)], least)


def negligible(deflections: Array) -> Array:
    """Return the (k,) RMS errors below which models of (N, k) deflections are equally good."""
    moved = np.sqrt((deflections**2).mean(axis=0))
    return NEGLIGIBLE * np.where(moved > 0.0, moved, moved.max())


def chosen(compared: Sequence[Compared], least: Array | float = 0.0) -> int:
    """Return the number of the plainest rival within one standard error of the best.

    Columns count alike: each is measured by the smallest held-out error that any rival reaches on it, or by the (k,)
    `least` error that counts.

    Raises:
        InputError: None of them could be fitted.
    """
    scale = np.maximum(np.min([one.squares.mean(axis=0) for one in compared], axis=0), np.square(least))
    if not np.isfinite(scale).all():
        raise InputError(f"no model could be fitted, not even {compared[0].name!r}: {compared[0].reason}")
    losses = [(one.squares / scale).mean(axis=1) for one in compared]
    means = [float(loss.mean()) for loss in losses]
    best = int(np.argmin(means))
    limit = means[best] + float(losses[best].std(ddof=1)) / np.sqrt(len(losses[best]))
    return next(i for i, mean in enumerate(means) if mean <= limit)


def assess(
    rivals: Sequence[Rival], data: JointData, seed: int = 0, step: Callable[[], None] | None = None
) -> tuple[HeldOut, dict[str, int]]:
    """Return the errors of choosing among rivals, and how often each was chosen: anew in each fold.

    `step` is called after every fold.
    """
    fold = random_folds(len(data), OUTER, seed)
    count: dict[str, int] = {}

    def learner(loads: Array, deflections: Array, inner_seed: int) -> Fitted:
        part = replace(data, loads=loads, deflections=deflections)
        rival = rivals[race(rivals, part, inner_seed, INNER, negligible(deflections))]
        count[rival.name] = count.get(rival.name, 0) + 1
        return rival.learner(loads, deflections, inner_seed)

    held = hold_out(learner, data, fold, seed, lambda residual: step and step())
    return replace(held, how=f"{held.how}, choice inside"), count
