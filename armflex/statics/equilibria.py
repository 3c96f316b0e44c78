"""Where a loaded arm comes to rest in many rows at once: Newton in lockstep, every law asked once a step for all rows.

A law costs as much to ask for a thousand rows as for ten, Pinocchio as much as it does one by one. Rows that the plain
steps do not settle are left to `find_equilibrium`, which damps them or says why there is no answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.statics.equilibrium import MAX_ROTATION, POLISHED, LawStack, check_small, find_equilibrium
from armflex.statics.mechanics import LoadCase, Mechanics

STEPS = 8
"""Steps in lockstep; a row that needs more needs damping."""


@dataclass(frozen=True)
class Equilibria:
    """An arm solved in N rows.

    Attributes:
        twists: (N, 6 n) exponential coordinates of the flexures [m, rad].
        wrenches: (N, 6 n) loads on the flexures, local axes [N, Nm].
    """

    twists: Array
    wrenches: Array


def find_equilibria(
    mechanics: Sequence[Mechanics],
    stack: LawStack,
    cases: Sequence[LoadCase],
    row: Row,
    start: Array | None = None,
    tolerance: float = 1e-12,
) -> Equilibria:
    """Return where the arm comes to rest in every row.

    Args:
        mechanics: (N) models of the arm with each row's payload; they differ in nothing else.
        stack: Laws of its flexures.
        cases: (N) joint positions, motion and external wrenches.
        row: What the laws may know of all rows.
        start: (N, 6 n) twists to begin with; zero when not given.
        tolerance: Largest residual of any flexure coordinate [m, rad].

    Raises:
        ConvergenceError, UnstableEquilibriumError, SmallDisplacementError: As `find_equilibrium`, for some row.
    """
    size = 6 * len(stack.laws)
    found = Equilibria(np.zeros((len(cases), size)), np.zeros((len(cases), size)))
    if start is not None:
        found.twists[:] = start
    straight = [one.straight(case) for one, case in zip(mechanics, cases, strict=True)]
    settled = _Lockstep(mechanics, stack, cases, row, straight).run(found, tolerance)
    for i in np.flatnonzero(~settled):
        one = find_equilibrium(mechanics[i], stack, cases[i], row.some(i), tolerance=tolerance)
        found.twists[i], found.wrenches[i] = one.twists, one.wrenches
    for twists in found.twists:
        check_small(twists, stack.names)
    return found


@dataclass(frozen=True)
class _Lockstep:
    mechanics: Sequence[Mechanics]
    stack: LawStack
    cases: Sequence[LoadCase]
    row: Row
    straight: Sequence[Array]

    def run(self, found: Equilibria, tolerance: float) -> np.ndarray:
        """Move the twists to rest and set the wrenches; return (N,) whether a row settled."""
        count = len(self.cases)
        settled, within = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        tangents = np.zeros((count, *2 * (found.twists.shape[1],)))
        active = np.arange(count)
        for step in range(STEPS):
            residual, size = self._residual(active, found)
            # The last step's tangent shows whether the arm would stay, so one step is always made.
            polished = (within[active] | (size <= POLISHED * tolerance)) & (step > 0)
            arrived = (size <= tolerance) & polished & _stays(tangents[active])
            settled[active[arrived]] = True
            within[active] = size <= tolerance
            active, residual = active[~arrived], residual[~arrived]
            if not len(active):
                break
            tangents[active] = self._tangents(active, found)
            active = self._move(active, residual, tangents[active], found)
            if not len(active):
                break
        return settled

    def _residual(self, active: np.ndarray, found: Equilibria) -> tuple[Array, Array]:
        """Set the wrenches of some rows; return their residuals and the largest of each."""
        for i in active:
            one = self.mechanics[i]
            found.wrenches[i] = one.loads(one.bent(self.straight[i], found.twists[i]), self.cases[i])
        residual = found.twists[active] - self.stack.twists(found.wrenches[active], self.row.some(active))
        return residual, np.abs(residual).max(axis=1, initial=0.0)

    def _tangents(self, active: np.ndarray, found: Equilibria) -> Array:
        laws = self.stack.tangent(found.wrenches[active], self.row.some(active))
        turned = np.empty_like(laws)
        for k, i in enumerate(active):
            one, twists = self.mechanics[i], found.twists[i]
            turned[k] = one.turning(self.straight[i], one.bent(self.straight[i], twists), twists, self.cases[i])
        return np.eye(laws.shape[-1]) + laws @ turned

    def _move(self, active: np.ndarray, residual: Array, tangents: Array, found: Equilibria) -> np.ndarray:
        """Make a step in some rows; return those where it was a small one."""
        try:
            steps = np.linalg.solve(tangents, residual[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:
            return active[:0]
        small = np.abs(steps).max(axis=1, initial=0.0) < MAX_ROTATION
        found.twists[active[small]] -= steps[small]
        return active[small]


def _stays(tangents: Array) -> Array:
    """Return (N,) whether it is plain from (N, 6 n, 6 n) tangents that the arm stays; see `check_stable`."""
    return np.linalg.norm(tangents - np.eye(tangents.shape[-1]), axis=(1, 2)) < 1.0
