"""Which model a joint needs: all compared on the same held-out rows, the plainest within one standard error taken.

The choice itself is part of what is held out: `assess` chooses anew inside every fold, so that the error it reports is
that of "let armflex choose", not that of the winner on the rows that made it win.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armflex.conventions import Array
from armflex.errors import InputError
from armflex.learning.held_out import HeldOut, hold_out, random_folds
from armflex.learning.model import Fitted, Learner
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
        reason: Why it could not.
    """

    name: str
    model: str
    squares: Array
    reason: str = ""

    @property
    def rms(self) -> Array:
        """(k,) RMS of each column [m, rad]."""
        return np.sqrt(self.squares.mean(axis=0))


def compare(
    rivals: Sequence[Rival], data: JointData, seed: int = 0, folds: int = FOLDS, repeats: int = REPEATS
) -> tuple[Compared, ...]:
    """Return every rival's errors on the same random folds."""
    found = []
    for rival in rivals:
        try:
            squares = [_squares(rival.learner, data, folds, seed + repeat) for repeat in range(repeats)]
            found.append(Compared(rival.name, rival.model, np.mean(squares, axis=0)))
        except InputError as error:  # too few rows for this model: it is no rival
            found.append(Compared(rival.name, rival.model, np.full_like(data.deflections, np.inf), str(error)))
    return tuple(found)


def _squares(learner: Learner, data: JointData, folds: int, seed: int) -> Array:
    return hold_out(learner, data, random_folds(len(data), folds, seed), seed).residual ** 2


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


def assess(rivals: Sequence[Rival], data: JointData, seed: int = 0) -> tuple[HeldOut, dict[str, int]]:
    """Return the errors of choosing among rivals, and how often each was chosen: anew in each fold."""
    fold = random_folds(len(data), OUTER, seed)
    count: dict[str, int] = {}

    def learner(loads: Array, deflections: Array, inner_seed: int) -> Fitted:
        part = replace(data, loads=loads, deflections=deflections)
        rival = rivals[chosen(compare(rivals, part, inner_seed, INNER, 1), negligible(deflections))]
        count[rival.name] = count.get(rival.name, 0) + 1
        return rival.learner(loads, deflections, inner_seed)

    held = hold_out(learner, data, fold, seed)
    return replace(held, how=f"{held.how}, choice inside"), count
