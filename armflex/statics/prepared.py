"""The deflection of an arm inside a control loop: everything that can be made beforehand is."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import Array, covariate_array
from armflex.statics.compiled_question import Answer, Quick, compiled_question
from armflex.statics.deflect import Asked, deflect, settle
from armflex.statics.equilibrium import check_method
from armflex.statics.loaded import LoadedArm
from armflex.statics.solver import SMALL, Solver

QUICK = ("exact", "first_order")
"""Methods that a `Solver` has."""


class Prepared:
    """`loop = arm.prepared("p300")`, then `loop(q)` at every tick: the tip's displacement, nothing else computed.

    The answers and the errors are those of `arm.deflection(q, "p300")`, to 1e-13 m and rad; doubts that are no errors
    are not looked for. No answer depends on those before it. Where numba is installed (`armflex[fast]`), arms are
    answered by compiled code whose laws are compliances and networks, or affine in the load where the joints are and
    with the covariates given. It has its own workspace and remembers its last
    answer: one object for each thread.
    """

    def __init__(self, loaded: LoadedArm, method: str = "exact", enforce_limits: bool = True) -> None:
        check_method(method)
        self._loaded, self._asked = loaded, Asked(method, enforce_limits)
        self._solver = Solver(loaded.mechanics, loaded.laws)
        self._first_order = method == "first_order"
        joints, flexures = len(loaded.mechanics.flex.q_index), len(loaded.flexure_joints)
        self._answer: Answer = (np.zeros(joints), np.zeros((flexures, 6)), np.zeros(6))
        self._quick: Quick | None = None
        if method in QUICK and not loaded.arm.pulls:
            exact = method == "exact"
            self._quick = compiled_question(loaded, exact) or _plain(loaded, self._solver, exact)

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
                found = self._quick(q, covariates)
            except (AttributeError, TypeError):  # no array, or not of numbers
                found = None
            if found is not None:
                self._answer = found
                return found[2]
        return self._ask(q, covariates)

    @property
    def q(self) -> Array:
        """(nq,) joint positions of the last answer [rad or m]."""
        return self._answer[0].copy()

    @property
    def wrenches(self) -> Array:
        """(n_flexures, 6) loads on the flexures at the last answer, local axes [N, Nm]."""
        mechanics, case = self._loaded.mechanics, self._loaded.case(self._answer[0])
        straight = mechanics.straight(case)
        at = straight if self._first_order else mechanics.bent(straight, self.twists.ravel())
        return mechanics.loads(at, case).reshape(-1, 6)

    @property
    def twists(self) -> Array:
        """(n_flexures, 6) what the flexures do at the last answer, local axes [m, rad]."""
        found = self._answer[1]
        return found.copy() if found.ndim == 2 else found[self._loaded.mechanics.flex.flexure_v].reshape(-1, 6)

    def _ask(self, q: ArrayLike, covariates: dict[str, float]) -> Array:
        """Return the displacement as `deflection` finds it, which also says what is wrong."""
        checked, flags = self._loaded.arm.check_position(q, self._asked.enforce_limits)
        known = {name: covariate_array(value, name, 0) for name, value in covariates.items()}
        found = deflect(self._loaded, checked, flags, known, self._asked, self._solver)
        displacement = found.displacement.copy()
        self._answer = (checked, found.solved.motion, displacement)
        return displacement


def _plain(loaded: LoadedArm, solver: Solver, exact: bool) -> Quick:
    """Return the question to Pinocchio and numpy.

    Everything it needs is a local name: to look up attributes takes as long as the mechanics.
    """
    flex, (lower, upper) = loaded.mechanics.flex, loaded.arm.bounds
    straight, index, count, rows = flex.neutral.copy(), flex.q_index, len(lower), bool(loaded.laws.others)
    rest = partial(settle, loaded, solver) if exact else solver.first_order
    bent, displacement = solver.bent, solver.displacement

    def quick(q: Array, covariates: dict[str, float]) -> Answer | None:
        values = q.tolist()
        if len(values) != count:
            return None
        for least, value, most in zip(lower, values, upper):  # noqa: B905 - as fast as can be
            if not least <= value <= most:
                return None
        straight[index] = here = q.astype(float)
        if rows or covariates:
            known = {name: covariate_array(value, name, 0) for name, value in covariates.items()}
            solver.know(loaded.row(here, known))
        found = rest(straight)
        if found is None or not found[0].dot(found[0]) < SMALL:
            return None
        return here, found[0], displacement(bent(straight, found[0]), here)

    return quick
