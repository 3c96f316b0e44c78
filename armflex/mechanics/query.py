"""The deflection of an arm inside a control loop: everything that can be made beforehand is."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.conventions import Array, covariate_array
from armflex.laws import Row
from armflex.laws.effects.context import MASS
from armflex.mechanics.certificate import SHARE
from armflex.mechanics.deflection import deflect
from armflex.mechanics.engine.binding import Engine, OneRow
from armflex.mechanics.engine.tables import NO_CHANGES
from armflex.mechanics.equilibrium import check_method
from armflex.mechanics.laws import RowLaws
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.loop_rows import LoopSolver
from armflex.mechanics.many_rows import NO_FRAMES, ROUNDS, SETTLED, RowSolver, responded, turned
from armflex.mechanics.pinocchio_model import LoadCase, build_model
from armflex.rows.wrench import Wrench, check_rows

FLOAT = np.dtype(float)

Answer = tuple[Array, Array, Array]
"""(nq,) joint positions, (n, 6) twists, (6,) displacement."""

Quick = Callable[[Any, dict[str, float]], Answer | None]
"""From (nq,) positions and covariates; None where the reference must be asked, or what is wrong said."""


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
        joints, flexures = len(loaded.arm.joint_names), len(loaded.arm.sites)
        self._answer: Answer = (np.zeros(joints), np.zeros((flexures, 6)), np.zeros(6))
        self._known: Mapping[str, Any] = {}
        self._free = [self._workspace()] if method == "exact" else []

    def __call__(self, q: ArrayLike, **covariates: float) -> Array:
        """Return the (6,) displacement of the tip [m, rad], base axes, at (nq,) joint positions [rad or m].

        Args:
            q: Joint positions in the order of `joint_names`; quickest as an array of 64-bit floats.
            covariates: What the arm's effects depend on, by name.

        Raises:
            As `Arm.deflection`; the last answer is then still that of the call before.
        """
        if self._method == "exact":
            free = self._free
            try:
                quick = free.pop()  # at once: no other thread can have it
            except IndexError:
                quick = self._workspace()
            try:
                found = quick(q, covariates)
            except (AttributeError, TypeError):  # no array, or not of numbers
                found = None
            finally:
                free.append(quick)
            if found is not None:
                self._answer, self._known = found, covariates
                return found[2]
        return self._ask(q, covariates)

    def _workspace(self) -> Quick:
        if not self._loaded.arm.chain:
            return _quick_loops(self._loaded, self._wrenches)
        return _quick(self._loaded, self._wrenches)

    @property
    def q(self) -> Array:
        """(nq,) joint positions of the last answer [rad or m]."""
        return self._answer[0].copy()

    @property
    def wrenches(self) -> Array:
        """(n_flexures, 6) loads on the flexures at the last answer, local axes [N, Nm]."""
        if self._loaded.arm.robot.linkage:
            case = LoadCase(self._answer[0], wrenches=self._wrenches, covariates=self._known)
            return deflect(self._loaded, case, (), self._method).wrenches
        mechanics = self._loaded.mechanics
        motion = np.zeros(mechanics.model.nv)
        motion[mechanics.flex.flexure_v] = self._answer[1].ravel()
        configuration = mechanics.flexed(mechanics.rigid_configuration(self._answer[0]), motion)
        torque = mechanics.load(LoadCase(self._answer[0], wrenches=self._wrenches))(configuration)
        return -torque[mechanics.flex.flexure_v].reshape(-1, 6)

    @property
    def twists(self) -> Array:
        """(n_flexures, 6) what the flexures do at the last answer, local axes [m, rad]."""
        return self._answer[1].copy()

    def _ask(self, q: ArrayLike, covariates: dict[str, float]) -> Array:
        """Return the displacement as `deflection` finds it, which also says what is wrong."""
        checked, flags = self._loaded.arm.check_position(q, self._enforced)
        known = {name: covariate_array(value, name, 0) for name, value in covariates.items()}
        case = LoadCase(checked, wrenches=self._wrenches, covariates=known)
        found = deflect(self._loaded, case, flags, self._method)
        displacement = found.displacement.copy()
        self._answer, self._known = (checked, found.twists.copy(), displacement), known
        return displacement


def _quick(loaded: LoadedArm, wrenches: Sequence[Wrench]) -> Quick:
    """Return the question to the engine.

    Everything it needs is a local name: to look up attributes takes as long as the mechanics.
    """
    arm, stack, n = loaded.arm, loaded.arm.stack, len(loaded.arm.sites)
    bounds, shape = np.array(arm.bounds), (len(arm.joint_names),)
    solver, middle = RowSolver(loaded, wrenches), bounds.mean(axis=0)
    laws, pushes, bound, chain = RowLaws(stack), solver.pushes, solver.bound, loaded.chain
    settled, proven = not pushes.posed, bound is not None and bound.proven
    columns = {f"q_{name}": place for name, place in arm.joint_index.items()}
    factors = stack.factors(columns | {MASS: len(columns)}) if proven and settled else None
    names = factors.names if factors is not None else ()
    known = np.append(loaded.payload.mass, np.zeros(len(names)))
    solve = OneRow(chain, laws.numbers, bounds, factors, known)
    pushed = pushes.wrenches(middle[None]).copy()
    solve.set_loads(pushes.links, pushed)

    def plainly(q: Array, covariates: dict[str, float]) -> Answer | None:
        if q.shape != shape or q.dtype != FLOAT or len(covariates) != len(names):
            return None
        for place, name in enumerate(names, 1):
            if name not in covariates:
                return None
            known[place] = covariate_array(covariates[name], name, 0)
        found = solve(q)
        return found and (q.copy(), *found)

    def in_rounds(q: Array, covariates: dict[str, float]) -> Answer | None:
        """See `many_rows`."""
        if q.shape != shape or q.dtype != FLOAT or not arm.within_limits(q.tolist()):
            return None
        here, found = q[None].copy(), (np.empty((1, 6)), np.empty((1, n, 6)), np.empty((1, n, 6)))
        row = loaded.row(here[0], {name: covariate_array(value, name, 0) for name, value in covariates.items()})
        laws.know(row)
        fine = rest(here, *found) if settled and not laws.curved else settle(row, here, *found)
        displacement, loads, twists = found
        if not fine or not (proven or stays(row, here, loads, twists)):
            return None
        return here[0], twists[0], displacement[0]

    engine, well = Engine(chain), np.empty(1, dtype=bool)

    def rest(here: Array, displacement: Array, loads: Array, twists: Array, exact: bool = True) -> bool:
        engine.set_laws(laws.numbers, 1)
        engine.set_loads(pushes.links, pushed, NO_CHANGES, 1)
        engine.rest_chain(here, exact, displacement, loads, twists, well)
        return bool(well[0])

    def settle(row: Row, here: Array, displacement: Array, loads: Array, twists: Array) -> bool:
        """Renew what the curved laws give and the posed loads until both are as assumed.

        One configuration needs a round or two more without the laws' tangents, which are as dear as those rounds.
        """
        pushed[:] = pushes.wrenches(here)
        if not rest(here, displacement, loads, twists, exact=False):
            return False
        offset = laws.offset[0]
        affine, moved, turning = offset.copy(), np.inf, np.inf
        for _ in range(ROUNDS):
            given = offset.copy()
            np.copyto(offset, affine)
            for i, law in laws.curved:
                offset[i] += law.twist(loads[0, i].copy(), row)
            moved = np.abs(offset - given).max(initial=0.0)
            if moved <= SETTLED and turning <= SETTLED:
                return True
            if not rest(here, displacement, loads, twists):
                return False
            before = pushed.copy()
            pushed[:] = pushes.wrenches(here, twists)
            turning = turned(before, pushed)[0]
        return False

    def stays(row: Row, here: Array, loads: Array, twists: Array) -> bool:
        """Return whether the arm is proven to stay and is not near buckling, by the bound or by the tangent itself."""
        if bound is not None and bound.stays(loads.ravel(), laws.tangent):
            return True
        for i, law in laws.curved:
            laws.compliance[0, i] += law.tangent(loads[0, i].copy(), row)
        distance = np.empty(1)
        tangents = laws.tangents(loads)
        responded(chain, "laws", NO_FRAMES, here, twists, pushes.at(here, twists), tangents, distance=distance)
        return bool(distance[0] <= SHARE)

    quick = plainly if proven and settled and (factors is not None or not stack.rows_differ) else in_rounds
    return quick if loaded.nominal is None else _from_nominal(loaded, quick)


def _quick_loops(loaded: LoadedArm, wrenches: tuple[Wrench, ...]) -> Quick:
    """Return the same question about an arm with loops or springs; each has a workspace of its own."""
    loaded = replace(loaded, _local=threading.local())
    solver, shape, within = LoopSolver(loaded, wrenches), (len(loaded.arm.joint_names),), loaded.arm.within_limits

    def quick(q: Array, covariates: dict[str, float]) -> Answer | None:
        if q.shape != shape or q.dtype != FLOAT or not within(q.tolist()):
            return None
        known = {name: covariate_array(value, name, 0) for name, value in covariates.items()}
        here = q.copy()
        found = solver.one(loaded.row(here, known))
        return found and (here, found.twists[0].copy(), found.displacement[0].copy())

    return quick


def _from_nominal(loaded: LoadedArm, quick: Quick) -> Quick:
    """Return the question whose displacements are from where the controller has the rigid arm, not from where it is."""
    true, nominal = build_model(loaded.arm.robot, (), None, loaded.arm.corrections), loaded.rigid
    datas = (true.model.createData(), nominal.model.createData())
    here, there = datas[0].oMf[true.tip], datas[1].oMf[nominal.tip]
    origin, turn, nominal_origin, back = here.translation, here.rotation, there.translation, there.rotation.T

    def moved(q: Array, covariates: dict[str, float]) -> Answer | None:
        found = quick(q, covariates)
        if found is None:
            return None
        displacement = found[2]
        pin.framesForwardKinematics(true.model, datas[0], found[0])
        pin.framesForwardKinematics(nominal.model, datas[1], found[0])
        displacement[:3] += origin - nominal_origin
        displacement[3:] = pin.log3(pin.exp3(displacement[3:]).dot(turn).dot(back))
        return found

    return moved
