"""Where an arm under its own weight comes to rest at many configurations: `Solver` in arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import ModuleType

import numpy as np

from armflex.batch import bending
from armflex.batch.chain import Straight
from armflex.batch.laws import BatchLaws
from armflex.conventions import Array
from armflex.laws import Row
from armflex.statics.deflect import SMALL
from armflex.statics.loaded import LoadedArm
from armflex.statics.softening import Softening
from armflex.statics.solver import ENOUGH, NEXT, SLOWEST, STEPS

MANY = 4096
"""Questions for which compiled code is worth its import."""


@dataclass(frozen=True, eq=False)
class Answers:
    """What was found at N configurations.

    Attributes:
        fine: (N,) whether it is an answer: the rest must be asked one by one.
        displacement: (6, N) of the tip [m, rad], base axes.
        wrenches, twists: (n, 6, N) of the flexures, local axes.
    """

    fine: np.ndarray
    displacement: Array
    wrenches: Array
    twists: Array


class BatchSolver:
    """Answers of one arm with one payload, some rows at a time; `total` is how many are to come."""

    def __init__(self, loaded: LoadedArm, exact: bool, total: int) -> None:
        self._chain, self._exact = loaded.chain, exact
        self._way = compiled() if total >= MANY else bending
        bounds = loaded.arm.bounds
        self._lower, self._upper = np.array(bounds[0]), np.array(bounds[1])

    def straighten(self, q: Array) -> tuple[Straight, Array]:
        """Return the rigid arm at (N, nq) positions, and the loads on its flexures."""
        straight = self._way.straighten(self._chain, np.ascontiguousarray(q.T))
        return straight, self._way.weigh(self._chain, straight)

    @np.errstate(over="ignore", invalid="ignore")  # a row that runs away is not fine, and is asked alone
    def settle(
        self, row: Row, laws: BatchLaws, straight: Straight, wrenches: Array, softening: Softening | None
    ) -> Answers:
        """Return where laws let the arm rest in some rows, from loads that are near, or for first order those."""
        twists = laws(wrenches)
        fine = _squares(twists) < SMALL
        if self._exact:
            # What is too large is asked alone: here it would only make numbers that overflow.
            twists[..., ~fine] = 0.0
            twists, drawn = self._rest(laws, straight, twists)
            wrenches = self._way.weigh(self._chain, straight, twists)
            fine &= drawn & (_squares(twists) < SMALL) & self._stays(row, laws, wrenches, softening)
        return Answers(fine, self._way.displace(self._chain, straight, twists), wrenches, twists)

    def _rest(self, laws: BatchLaws, straight: Straight, twists: Array) -> tuple[Array, np.ndarray]:
        """Return twists at rest, and (N,) whether the fixed point was drawn there; see `Solver.settle`."""
        drawn, largest, before = np.zeros(twists.shape[-1], dtype=bool), np.inf, _squares(twists)
        for _ in STEPS:
            moved = laws(self._way.weigh(self._chain, straight, twists))
            step = np.subtract(moved, twists, out=moved)
            if drawn.any():  # what has come to rest is left there, so that no row depends on those beside it
                step *= ~drawn
            size = _squares(step)
            twists += step
            drawn |= (size <= ENOUGH) & (size * size <= NEXT * before)
            last, largest, before = largest, float(size.max(initial=0.0)), size
            if drawn.all() or not largest < SLOWEST * last:
                break
        return twists, drawn

    def _stays(self, row: Row, laws: BatchLaws, wrenches: Array, softening: Softening | None) -> np.ndarray:
        """Return (N,) whether it is proven that the arm stays."""
        inside = ((row.q >= self._lower) & (row.q <= self._upper)).all(axis=1)
        if softening is None:
            return np.zeros(len(inside), dtype=bool)
        if softening.proven:
            return inside
        return inside & softening.stays(wrenches.reshape(-1, len(inside)).T, laws.tangent)


def _squares(twists: Array) -> Array:
    """Return the (N,) sums of the squares of (n, 6, N) twists."""
    flat = twists.reshape(-1, twists.shape[-1])
    return (flat * flat).sum(axis=0)


@cache
def compiled() -> ModuleType:
    """Return the compiled functions where numba is installed, those of numpy otherwise."""
    try:
        from armflex.batch import compiled
    except ImportError:
        return bending
    return compiled
