"""The deflection of an arm inside a control loop: everything that can be made beforehand is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import Array, covariate_array
from armflex.statics.deflect import SMALL, Asked, deflect
from armflex.statics.equilibrium import check_method
from armflex.statics.loaded import LoadedArm
from armflex.statics.solver import Solver

QUICK = ("exact", "first_order")
"""Methods that a `Solver` has."""

Answer = tuple[Array, Array, Array]
"""(nv,) motion of the flexures, configuration, (6,) displacement."""


class Prepared:
    """`loop = arm.prepared("p300")`, then `loop(q)` at every tick: the tip's displacement, nothing else computed.

    The answers and the errors are those of `arm.deflection(q, "p300")`; doubts that are no errors are not looked for.
    It has its own workspace and remembers its last answer: one object for each thread.
    """

    def __init__(self, loaded: LoadedArm, method: str = "exact", enforce_limits: bool = True) -> None:
        check_method(method)
        self._loaded, self._asked = loaded, Asked(method, enforce_limits)
        self._solver = Solver(loaded.mechanics, loaded.laws)
        self._first_order, self._needs_row = method == "first_order", bool(loaded.laws.others)
        self._q = np.zeros(len(loaded.mechanics.flex.q_index))
        flex = loaded.mechanics.flex
        self._answer: Answer = (np.zeros(flex.model.nv), flex.neutral.copy(), np.zeros(6))
        proven = self._first_order or (loaded.softening is not None and loaded.softening.proven)
        self._quick = None
        if method in QUICK and proven and not loaded.arm.pulls and not self._needs_row:
            self._quick = _quick(loaded, self._solver, self._q, exact=not self._first_order)

    def __call__(self, q: ArrayLike, **covariates: float) -> Array:
        """Return the (6,) displacement of the tip [m, rad], base axes, at (nq,) joint positions [rad or m].

        Args:
            q: Joint positions in the order of `joint_names`; quickest as an array of 64-bit floats.
            covariates: What the arm's effects depend on, by name.

        Raises:
            As `Arm.deflection`; the last answer is then still that of the call before.
        """
        if self._quick is not None:
            try:
                found = self._quick(q)
            except (AttributeError, TypeError):  # no array, or not of numbers
                found = None
            if found is not None:
                self._answer = found
                return found[2]
        return self._ask(q, covariates)

    @property
    def q(self) -> Array:
        """(nq,) joint positions of the last answer [rad or m]."""
        return self._q.copy()

    @property
    def wrenches(self) -> Array:
        """(n_flexures, 6) loads on the flexures at the last answer, local axes [N, Nm]."""
        loaded, at = self._loaded, self._solver.straight(self._q) if self._first_order else self._answer[1]
        return loaded.mechanics.loads(at, loaded.case(self._q)).reshape(-1, 6)

    @property
    def twists(self) -> Array:
        """(n_flexures, 6) what the flexures do at the last answer, local axes [m, rad]."""
        return self._answer[0][self._loaded.mechanics.flex.flexure_v].reshape(-1, 6)

    def _ask(self, q: ArrayLike, covariates: dict[str, float]) -> Array:
        """Return the displacement as `deflection` finds it, which also says what is wrong."""
        checked, flags = self._loaded.arm.check_position(q, self._asked.enforce_limits)
        known = {name: covariate_array(value, name, 0) for name, value in covariates.items()}
        found = deflect(self._loaded, checked, flags, known, self._asked, self._solver)
        displacement = found.displacement.copy()
        self._q[:], motion = checked, found.solved.motion
        self._answer = (motion, self._solver.bent(found.solved.straight, motion), displacement)
        return displacement


def _quick(loaded: LoadedArm, solver: Solver, at: Array, exact: bool) -> Callable[[Array], Answer | None]:
    """Return a function of (nq,) positions; it gives None where the general way must be gone, or what is wrong said.

    Everything it needs is a local name: to look up attributes takes as long as the mechanics.
    """
    flex, (lower, upper) = loaded.mechanics.flex, loaded.arm.bounds
    straight, index, count = flex.neutral.copy(), flex.q_index, len(lower)
    settle, first_order, bent, displacement = solver.settle, solver.first_order, solver.bent, solver.displacement

    def quick(q: Array) -> Answer | None:
        values = q.tolist()
        if len(values) != count:
            return None
        for least, value, most in zip(lower, values, upper):  # noqa: B905 - as fast as can be
            if not least <= value <= most:
                return None
        straight[index] = q
        found = settle(straight) if exact else first_order(straight)
        if found is None or not found[0].dot(found[0]) < SMALL:
            return None
        at[:] = q
        configuration = bent(straight, found[0])
        return found[0], configuration, displacement(configuration, at)

    return quick
