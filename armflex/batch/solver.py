"""Where an arm under its own weight comes to rest at many configurations: `Solver` in arrays."""

from __future__ import annotations

from functools import partial

import numpy as np

from armflex.batch import bending
from armflex.batch.chain import Straight
from armflex.batch.laws import BatchLaws
from armflex.compiled_code import compiled_code
from armflex.conventions import Array
from armflex.laws import Row
from armflex.statics.loaded import LoadedArm
from armflex.statics.softening import Softening
from armflex.statics.solver import ENOUGH, NEXT, SLOWEST, SMALL, STEPS

MANY = 4096
"""Questions for which compiled code is worth its import."""

CHUNK, COMPILED_CHUNK = 4096, 8192
"""Rows that are asked about together, by numpy and by compiled code."""


Found = tuple[Array, Array, Array]
"""(N, 6) displacements of the tip, base axes, and (N, n, 6) wrenches and twists of the flexures, local axes."""

Start = tuple[Straight, Array]
"""The rigid arm, and (n, 6, N) loads to begin with."""


class BatchSolver:
    """Answers of one arm with one payload, some rows at a time; `total` is how many are to come."""

    def __init__(self, loaded: LoadedArm, exact: bool, total: int) -> None:
        self._chain, self._nominal, self._exact = loaded.chain, loaded.nominal, exact
        self._compiled = compiled() if total >= MANY else None
        bounds = loaded.arm.bounds
        self._lower, self._upper = np.array(bounds[0]), np.array(bounds[1])

    @property
    def chunk(self) -> int:
        """Rows to ask about at a time: their arrays stay near the processor, and memory does not grow with N."""
        return CHUNK if self._compiled is None else COMPILED_CHUNK

    def straighten(self, q: Array) -> Start:
        """Return the rigid arm at (N, nq) positions, and the loads on its flexures."""
        straight = bending.straighten(self._chain, np.ascontiguousarray(q.T))
        return straight, bending.weigh(self._chain, straight)

    def near(self, row: Row, laws: BatchLaws, softening: Softening | None) -> Start | Array:
        """Return where to begin for laws that are near some laws: in compiled code, rooms that are ready."""
        found, numbers = room_for(len(row.q), self._chain.flexures), self._numbers(laws)
        if numbers is not None:
            lanes = self._compiled.LANES
            rooms = self._compiled.room_for(self._chain.flexures, lanes, len(row.q[::lanes]))
            self._by_compiled(row.q, numbers, found, rooms, ready=False)
            return rooms
        straight, wrenches = self.straighten(row.q)
        if self._exact:
            self.settle(row, laws, softening, found, (straight, wrenches))
            wrenches = np.moveaxis(found[1], 0, -1)
        return straight, wrenches

    def _numbers(self, laws: BatchLaws) -> tuple[Array, ...] | None:
        return None if self._compiled is None else laws.numbers

    @np.errstate(over="ignore", invalid="ignore")  # a row that runs away is not fine, and is asked alone
    def settle(
        self, row: Row, laws: BatchLaws, softening: Softening | None, found: Found, start: Start | Array | None = None
    ) -> np.ndarray:
        """Put into `found` where laws let the arm rest in some rows; to first order, under the loads of `start`.

        Returns (N,) whether it is an answer: the rest must be asked one by one.
        """
        placed, numbers = isinstance(start, tuple), self._numbers(laws)
        if numbers is None or placed:
            fine = self._by_numpy(laws, *(start if placed else self.straighten(row.q)), found)
        elif start is None:
            room = self._compiled.room_for(self._chain.flexures, self._compiled.LANES)
            fine = self._by_compiled(row.q, numbers, found, room, ready=False)
        else:
            fine = self._by_compiled(row.q, numbers, found, start, ready=True)
        if self._nominal is not None:
            found[0][:] = bending.from_elsewhere(
                found[0], bending.tip_poses(self._chain, row.q), bending.tip_poses(self._nominal, row.q)
            )
        return fine & self._stays(row, laws, found[1], softening) if self._exact else fine

    def _by_compiled(self, q: Array, numbers: tuple[Array, ...], found: Found, rooms: Array, ready: bool) -> np.ndarray:
        fine = np.empty(len(q), dtype=bool)
        known = (*self._chain.numbers, *numbers, rooms, ready, np.ascontiguousarray(q), self._exact)
        self._compiled.answer_many(*known, *found, fine)
        return fine

    def _by_numpy(self, laws: BatchLaws, straight: Straight, wrenches: Array, found: Found) -> np.ndarray:
        twists = laws(wrenches)
        fine = _squares(twists) < SMALL
        if self._exact:
            # What is too large is asked alone: here it would only make numbers that overflow.
            twists[..., ~fine] = 0.0
            twists, drawn = self._rest(laws, straight, twists)
            wrenches = bending.weigh(self._chain, straight, twists)
            fine &= drawn & (_squares(twists) < SMALL)
        for into, part in zip(found, (bending.displace(self._chain, straight, twists), wrenches, twists), strict=True):
            into[:] = np.moveaxis(part, -1, 0)
        return fine

    def _rest(self, laws: BatchLaws, straight: Straight, twists: Array) -> tuple[Array, np.ndarray]:
        """Return twists at rest, and (N,) whether the fixed point was drawn there; see `Solver.settle`."""
        drawn, largest, before = np.zeros(twists.shape[-1], dtype=bool), np.inf, _squares(twists)
        for _ in STEPS:
            moved = laws(bending.weigh(self._chain, straight, twists))
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
        return inside & softening.stays(wrenches.reshape(len(inside), -1), laws.tangent)


def _squares(twists: Array) -> Array:
    """Return the (N,) sums of the squares of (n, 6, N) twists."""
    flat = twists.reshape(-1, twists.shape[-1])
    return (flat * flat).sum(axis=0)


def room_for(count: int, n: int) -> Found:
    """Return room for the answers in some rows of an arm with n flexures."""
    return np.empty((count, 6)), np.empty((count, n, 6)), np.empty((count, n, 6))


compiled = partial(compiled_code, "armflex.batch.compiled")
"""Returns the compiled functions, None where there are none."""
