"""The deflection of an arm inside a control loop: everything that can be made beforehand is."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy import ndarray
from numpy.typing import ArrayLike

from armflex.conventions import Array, covariate_array
from armflex.mechanics.deflection import deflect
from armflex.mechanics.equilibrium import Quick, check_method
from armflex.mechanics.history import known_alone, remembering
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.loop_rows import LoopSolver
from armflex.mechanics.many_rows import OneChain
from armflex.mechanics.mechanism import Rest
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.rows.wrench import Wrench, check_rows

FLOAT = np.dtype(float)
NOTHING: Mapping[str, Array] = {}

Ask = tuple[Callable[..., int], object, Callable[[], Array]]
"""See `OneRow.quick`."""

Knows = Callable[[Mapping[str, Array]], bool] | None
"""What takes covariates over, None where there are none to know."""

NEVER: Ask = (lambda _, __: 0), 0, np.zeros(6).copy


class Prepared:
    """`loop = arm.prepared("p300")`, then `loop(q)` at every tick: the tip's displacement, nothing else computed.

    The answers and the errors are those of `arm.deflection(q, "p300")`, to 1e-13 m and rad; flags that are no errors
    are not looked for. No answer depends on those before it. Laws that are affine in the load, networks, and wrenches
    in base or link axes are the quickest; other laws and loads take some rounds each. Threads may share it: calls at
    the same time have a workspace each. Its last answer is then that of any of them.
    """

    def __init__(
        self,
        loaded: LoadedArm,
        method: str = "exact",
        enforce_limits: bool = True,
        wrenches: Sequence[Wrench] = (),
    ) -> None:
        check_method(method)
        check_rows(wrenches, None)
        loaded.flags_under(wrenches, moves=False)  # raises where a link is not the arm's
        self._loaded, self._method, self._enforced, self._wrenches = loaded, method, enforce_limits, tuple(wrenches)
        self._remembers = bool(remembering(loaded.arm, ()))
        self._exact, self._shape = method == "exact", (len(loaded.arm.joint_names),)
        self._last: tuple[Array | bytes, Mapping[str, Array], Rest | None] | None = None
        self._free = [self._workspace()] if self._exact else []

    def __call__(self, q: ArrayLike, **covariates: float) -> Array:
        """Return the (6,) displacement of the tip [m, rad], base axes, at (nq,) joint positions [rad or m].

        Args:
            q: Joint positions in the order of `joint_names`; quickest as an array of 64-bit floats.
            covariates: What the arm's effects depend on, by name: `loop(q, temperature=24.0)`.

        Raises:
            As `Arm.deflection`; the last answer is then still that of the call before.
        """
        given: Mapping[str, Array] = NOTHING
        if covariates or self._remembers:
            given = {name: covariate_array(value, name, 0) for name, value in covariates.items()}
            if self._remembers:
                q, _ = self._loaded.arm.check_position(q, self._enforced)
                case = LoadCase(q, wrenches=self._wrenches, covariates=given)
                given = known_alone(self._loaded.arm, self._loaded.payload, case)
        if type(q) is ndarray and q.shape == self._shape and q.dtype == FLOAT and self._exact:
            try:
                room = self._free.pop()  # which no other thread has meanwhile
            except IndexError:
                room = self._workspace()
            (ask, where, displacement), knows, quick = room
            try:
                if (knows is None or knows(given)) and ask(where, numbers := q.tobytes()):
                    self._last = numbers, given, None
                    return displacement()
                rest = quick(q, given, None)
            finally:
                self._free.append(room)
            if rest is not None and rest.proven:
                self._last = q.copy(), given, rest
                return rest.displacement
        checked, flags = self._loaded.arm.check_position(q, self._enforced)
        case = LoadCase(checked, wrenches=self._wrenches, covariates=given)
        found = deflect(self._loaded, case, flags, self._method)
        self._last = checked, given, found.solved.rest
        return found.displacement.copy()

    def _workspace(self) -> tuple[Ask, Knows, Quick]:
        """Return the engine with memory of its own, and, of an arm with loops, with its own way along their rows."""
        if self._loaded.tied:
            return NEVER, None, LoopSolver(replace(self._loaded, kept=threading.local()), self._wrenches)
        chain = OneChain(self._loaded).under(self._wrenches)
        return chain.quick or NEVER, chain.knows if chain.names else None, chain

    @property
    def _rest(self) -> Rest:
        if self._last is None:
            n = len(self._loaded.arm.sites)
            return Rest(np.zeros(6), np.zeros((n, 6)), np.zeros((n, 6)))
        q, given, rest = self._last
        if rest is None:  # nothing but where the tip is
            rest = self._workspace()[-1](self.q, given, None)
            assert rest is not None
            self._last = q, given, rest
        return rest

    @property
    def q(self) -> Array:
        """(nq,) joint positions of the last answer [rad or m]."""
        return np.zeros(self._shape) if self._last is None else np.array(np.frombuffer(self._last[0]))

    @property
    def wrenches(self) -> Array:
        """(n_flexures, 6) loads on the flexures at the last answer, local axes [N, Nm]."""
        return self._rest.loads.copy()

    @property
    def twists(self) -> Array:
        """(n_flexures, 6) what the flexures do at the last answer, local axes [m, rad]."""
        return self._rest.twists.copy()
