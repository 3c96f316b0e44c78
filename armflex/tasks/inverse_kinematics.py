"""The smallest change of the joints that cancels an error of the tip: the solver behind one row of `compensate`.

The tip's error is a smooth function of the joints, nearly linear over a correction. The solver jumps to the smallest
change that solves the linearised problem inside the limits, again and again; this settles in a few jumps almost
always. Where it does not, it first brings the error down and then walks to smaller changes without giving it up.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from armflex.conventions import Array
from armflex.errors import ConvergenceError, SmallDisplacementError, UnstableEquilibriumError

T = TypeVar("T")

TOLERANCE = 1e-10
"""Remaining error [m, rad] at which a row counts as reached."""

NEAR_SINGULAR = 0.02
"""Smallest singular value of the tip's Jacobian [m per m or rad] below which steps are damped and rows flagged."""

AIMED_AT = 0.01 * TOLERANCE
SETTLED = 1e-9
STUCK = 1e-13
PROVEN = 1e-7
LARGE_ERROR = 0.01
MAX_CALLS = 300
LEAST_DAMPING = 1e-7
REGULARISATION = 1e-4
NO_EQUILIBRIUM = (ConvergenceError, UnstableEquilibriumError, SmallDisplacementError)


@dataclass(frozen=True)
class Trial:
    """A change (nq,) of the joints, the (6,) error it leaves and the Jacobian (3 or 6, nq) of the part that counts.

    `axes` is the Jacobian's singular value decomposition.
    """

    change: Array
    error: Array
    jacobian: Array
    axes: tuple[Array, Array, Array]

    @classmethod
    def of(cls, change: Array, error: Array, jacobian: Array) -> list[Trial]:
        """Return the trials of (M, nq) changes, with (M, 6) errors and (M, 3 or 6, nq) Jacobians."""
        axes = zip(*np.linalg.svd(jacobian, full_matrices=False), strict=True)
        return [cls(*trial) for trial in zip(change, error, jacobian, axes, strict=True)]

    @property
    def matched(self) -> Array:
        """The part of the error that counts."""
        return self.error[: len(self.jacobian)]

    @cached_property
    def left(self) -> float:
        """Largest component of it."""
        return float(np.abs(self.matched).max())

    @property
    def sigma_min(self) -> float:
        """Smallest singular value of the Jacobian."""
        return float(self.axes[1][-1])


Search = Generator[Array, Trial | str, T]
"""Yields changes (nq,) that it asks about, is sent what each leaves or why no equilibrium is found, returns its find.

Many rows are searched side by side so, and what all of them ask at a time is answered together.
"""


@dataclass
class Corrector:
    """Finds the smallest change inside a box.

    Attributes:
        low, high: (nq,) box of the change.
        scale: (nq,) the change's size is that of change / scale.
        calls: How many changes were asked about.
        trouble: The equilibrium that was not found at the last change looked at, '' if it was.
    """

    low: Array
    high: Array
    scale: Array
    calls: int = 0
    trouble: str = ""

    def find(self, start: Array, none: Trial | None = None) -> Search[tuple[Trial | None, bool]]:
        """Return the best change found and whether it is shown to be the smallest near by; None without equilibrium.

        `none` is what no change leaves, where that is known and inside the box.
        """
        first = none if none and not start.any() else (yield from self.at(start))
        first = first or none or (yield from self.at(np.zeros_like(start)))
        if first is None:
            return None, False
        point, converged = yield from self.jump(first)
        if not converged:
            point = yield from self.restore(point, 40)
            if point.left <= AIMED_AT:
                point, converged = yield from self.shrink(point)
        return point, converged and point.left <= TOLERANCE

    def at(self, change: Array) -> Search[Trial | None]:
        """Return what a change leaves, None where the arm finds no equilibrium."""
        self.calls += 1
        answer = yield np.clip(change, self.low, self.high)
        self.trouble = answer if isinstance(answer, str) else ""
        return None if isinstance(answer, str) else answer

    def jump(self, point: Trial) -> Search[tuple[Trial, bool]]:
        """Jump from linearised solution to linearised solution while errors or jumps keep shrinking."""
        best, last = point, np.inf
        for _ in range(12):  # jumps
            aim = self.aim(point)
            length = float(np.abs(aim - point.change).max())
            if length < (SETTLED if point.left <= AIMED_AT else STUCK):
                return point, True
            landed = yield from self.at(aim)
            if landed is None or (landed.left > max(0.5 * point.left, AIMED_AT) and length > 0.5 * last):
                break
            point, last = landed, length
            best = min(best, point, key=lambda trial: trial.left)
        return best, False

    def restore(self, point: Trial, most: int) -> Search[Trial]:
        """Bring the error down with the shortest steps that do, until it is gone or no step helps."""
        for _ in range(most):
            if point.left <= AIMED_AT:
                break
            lower = yield from self.descend(point, self.step(point))
            if lower is None:
                break
            stalled = np.linalg.norm(lower.matched) > (1.0 - 1e-6) * np.linalg.norm(point.matched)
            point = lower
            if stalled:
                break
        return point

    def descend(self, point: Trial, step: Array) -> Search[Trial | None]:
        """Return the first of ever shorter steps that lowers the error."""
        size, share = np.linalg.norm(point.matched), 1.0
        while share > 1e-3 and self.calls < MAX_CALLS:
            trial = yield from self.at(point.change + share * step)
            if trial is not None and np.linalg.norm(trial.matched) < (1.0 - 1e-4 * share) * size:
                return trial
            share *= 0.5
        return None

    def shrink(self, point: Trial) -> Search[tuple[Trial, bool]]:
        """Walk to smaller changes that leave no error either; True once none is near, or the gain is rounding."""
        share = 1.0
        while self.calls < MAX_CALLS and share > 1e-4:
            move = self.aim(point) - point.change
            if np.abs(move).max() < PROVEN:
                return point, True
            landed = yield from self.at(point.change + share * move)
            trial = None if landed is None else (yield from self.restore(landed, 8))
            # The aim is the point nearest to no change at all, so along the move the cost falls by its square at least.
            enough = self.cost(point) - 0.1 * share * self.size(move)
            if trial is not None and trial.left <= AIMED_AT and self.cost(trial) < enough:
                point, share = trial, min(1.0, 2.0 * share)
            else:
                share *= 0.5
        # How large a change is without any error is known only as well as the error that is left has to be small.
        step = float(np.max(AIMED_AT / self.scale)) / max(point.sigma_min, NEAR_SINGULAR)
        rounding = 2.0 * step * float(np.sqrt(self.size(point.change)))
        return point, self.size(self.aim(point) - point.change) <= rounding

    def size(self, change: Array) -> float:
        """Return the squared size of a change."""
        return float(np.sum((change / self.scale) ** 2))

    def cost(self, point: Trial) -> float:
        """Return the squared size of a change once the last of its error is gone; that last would drown the gain."""
        return self.size(point.change + self.step(point))

    def aim(self, point: Trial) -> Array:
        """Return the smallest change that solves the linearised problem as well as can be."""
        return self.smallest(point, point.change + self.step(point))

    def step(self, point: Trial) -> Array:
        """Return the bounded least-squares step against the error, damped where near singular.

        The damping fades with the error: Newton's fast end is kept while large errors make no huge steps.
        """
        near = max(0.0, 1.0 - (point.sigma_min / NEAR_SINGULAR) ** 2)
        damping = NEAR_SINGULAR * np.sqrt(near * min(1.0, point.left / LARGE_ERROR))
        low, high, damping = self.low - point.change, self.high - point.change, max(damping, LEAST_DAMPING)
        left, values, right = point.axes
        free = right.T @ (values / (values**2 + damping**2) * (left.T @ -point.matched))
        if ((free >= low) & (free <= high)).all():
            return free
        return _damped(point.jacobian, -point.matched, damping, low, high)

    def smallest(self, point: Trial, change: Array) -> Array:
        """Return the smallest change inside the box that moves the linearised tip as much as `change` does."""
        scaled, start = point.jacobian * self.scale, change / self.scale
        even = bool((self.scale == 1.0).all())
        _, values, right = point.axes if even else np.linalg.svd(scaled, full_matrices=False)
        rows = right[values > 1e-12 * values[0]]
        short = self.scale * (rows.T @ (rows @ start))
        if ((short >= self.low) & (short <= self.high)).all():
            return short
        low, high, wanted = self.low / self.scale, self.high / self.scale, scaled @ start
        # A little regularisation determines which joints belong at their limits; the rest is then exact.
        short = _damped(scaled, wanted, REGULARISATION, low, high)
        free = (short > low) & (short < high)
        rest = wanted - scaled[:, ~free] @ short[~free]
        short[free] = np.linalg.lstsq(scaled[:, free], rest, rcond=1e-9)[0]
        return np.clip(self.scale * short, self.low, self.high)


def _damped(matrix: Array, wanted: Array, damping: float, low: Array, high: Array) -> Array:
    """Return the x in a box with the least `|matrix x - wanted|^2 + damping^2 |x|^2`."""
    count = matrix.shape[1]
    stacked = np.vstack([matrix, damping * np.eye(count)])
    return bounded_least_squares(stacked, np.concatenate([wanted, np.zeros(count)]), low, high)


def bounded_least_squares(matrix: Array, wanted: Array, low: Array, high: Array) -> Array:
    """Return the x in [low, high] with the least `|matrix x - wanted|`; the columns are independent.

    Active set: entries are held where they meet the box and released where the slope would take them back inside. That
    of SciPy (`lsq_linear`, bvls) takes as long but ends where the sum of squares hardly falls: near a singular
    position, whose directions are hardly damped, that is before the change is the smallest.
    """
    x = np.clip(np.zeros(len(low)), low, high)
    held = np.zeros(len(low), dtype=bool)
    for _ in range(20 * len(low)):
        best = x.copy()
        rest = wanted - matrix[:, held] @ x[held]
        best[~held] = np.linalg.lstsq(matrix[:, ~held], rest, rcond=None)[0]
        # The entry that first meets the box on the way there.
        step = best - x
        shares = np.divide(np.where(step > 0.0, high - x, low - x), step, out=np.full(len(x), np.inf),
                           where=(np.abs(step) > 1e-300) & ((best < low) | (best > high)))  # fmt: skip
        blocked = int(shares.argmin())
        share = float(np.clip(shares[blocked], 0.0, 1.0))
        x = np.clip(x + share * step, low, high)
        if share < 1.0:
            x[blocked] = low[blocked] if best[blocked] < x[blocked] else high[blocked]
            held[blocked] = True
            continue
        slope = matrix.T @ (matrix @ x - wanted)
        inward = np.where(held & (low < high), np.where(x <= low, -slope, slope), 0.0)
        if inward.max() <= 1e-14:
            break
        held[int(inward.argmax())] = False
    return x
