"""The quick way from a reading to its columns: one equilibrium and one geometric stiffness, as Pinocchio has them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import isfinite
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from armflex.arm import Arm
from armflex.calibrate.arm_blocks import ComplianceBlock, OffsetBlock
from armflex.calibrate.blocks import Block
from armflex.calibrate.instrument_blocks import MOUNTING, FrameBlock, TargetBlock
from armflex.calibrate.law_block import LawBlock
from armflex.calibrate.view import Setup
from armflex.conventions import Array, real_array
from armflex.errors import InputError
from armflex.laws import Law, Row
from armflex.laws.learned import LearnedLaw
from armflex.statics.deflect import SMALL, settle
from armflex.statics.law_stack import constant_compliance
from armflex.statics.loaded import LoadedArm
from armflex.statics.solver import Solver
from armflex.tracking.estimate import Seen, compiled, unit_matrix
from armflex.tracking.reading import Reading, spread_of

ENOUGH = 1e-2
"""Length of the last term taken of the loads' redistribution, relative to the columns.

The terms shrink like the sag over the arm's length, so that one or two are enough and what is left out is some 1e-4.
Half of the angle by which a flexure turns (exp6's derivative) is left out as well."""

NEAR = 1e-6
"""Squared length of the last step to rest [m^2, rad^2]: the next ones, taken together by the tangent, leave its square,
some 1e-8 m."""

TERMS = 30
"""Of a series, at most: where it takes more, the careful way is gone."""

NONE = np.zeros((3, 3))


class _Bent(NamedTuple):
    """An arm close to rest under one payload.

    Attributes:
        motion: (nv,) of the flexures.
        given: (nv,) what their laws give there.
        torque: (nv,) on them.
        compliance: (nv,) or (nv, nv) of all flexures.
        geometric: (nv, nv) change of the torque per motion.
        jacobian: (6, nv) of the target, base axes.
    """

    motion: Array
    given: Array
    torque: Array
    compliance: Array
    geometric: Array
    jacobian: Array


class _Rest(NamedTuple):
    """How a reading answers to an arm at rest.

    Attributes:
        point: (3,) target in the instrument's frame.
        axes: (3, 3) axes of the tip there.
        answer: (3, nv) answer of the target to joints and to changes of the flexures' laws, loads redistributing.
        bent: The arm.
    """

    point: Array
    axes: Array
    answer: Array
    bent: _Bent


Columns = Callable[[_Rest], Array]
See = Callable[[_Bent, Array, float | Array], Seen | None]


class Quick:
    """The quick way for one payload.

    It takes milliseconds to make; the first on a machine some seconds, as it compiles, and what it compiled is kept.
    """

    def __init__(self, setup: Setup, blocks: Sequence[Block], payload: str, beside: float) -> None:
        self._arm, instrument = setup.arm, setup.instrument
        self._loaded = self._arm.loaded(payload)
        self._solver = Solver(self._loaded.mechanics, self._loaded.laws)
        self._turn, self._shift = instrument.pose.rotation.copy(), instrument.pose.translation.copy()
        self._stretch, self._beside = 1.0 + instrument.scale, beside
        tip = self._solver.model.frames[self._loaded.mechanics.flex.tip]
        self._joint, self._placement = tip.parentJoint, tip.placement * pin.SE3(np.eye(3), instrument.target)
        self._local, self._tip_axes = self._placement.translation.copy(), tip.placement.rotation.copy()
        # Views into Pinocchio's own memory; see `Solver`.
        carrier = self._solver.data.oMi[self._joint]
        self._carrier_axes, self._carrier_origin = carrier.rotation, carrier.translation
        matrix = -self._loaded.laws.matrix
        diagonal = np.count_nonzero(matrix) == np.count_nonzero(np.diag(matrix))
        self._varying = self._loaded.laws.others
        self._compliance = np.diag(matrix).copy() if diagonal and not self._varying else matrix
        ends = np.cumsum([0, *(len(block.labels) for block in blocks)]).tolist()
        self._count = ends[-1]
        places = [slice(*pair) for pair in pairwise(ends)]
        self._parts = [(place, _columns_of(block, self._loaded)) for place, block in zip(places, blocks, strict=True)]
        self._see = _compiled(self, blocks)

    def __call__(self, reading: Reading) -> Seen | None:
        """Return what is seen, None where the arm is not proven to stay."""
        q, sigma = self._arm.check_position(reading.q)[0], spread_of(reading)
        position = real_array(reading.position, "position")
        if position.shape != (3,):
            raise InputError(f"position: expected (3,) [m], got {position.shape}")
        bent = self._bent(q)
        if bent is None:
            return None
        if self._beside:
            sigma = (sigma**2 + self._beside**2) ** 0.5
        seen = (self._see or self._plain)(bent, position, sigma)
        if seen is not None and not isfinite(seen.residual.dot(seen.residual)):
            raise InputError(f"position: expected three finite numbers [m], got {position}")
        return seen

    def _plain(self, bent: _Bent, position: Array, sigma: float | Array) -> Seen | None:
        """Return what is seen by numpy."""
        rest = self._rest(bent)
        if rest is None:
            return None
        columns = np.empty((3, self._count))
        for place, part in self._parts:
            columns[:, place] = part(rest)
        columns /= sigma if isinstance(sigma, float) else sigma[..., None]
        return Seen((position - rest.point) / sigma, columns)

    def _bent(self, q: Array) -> _Bent | None:
        """Return the arm close to rest, None where it is far away or not proven that it stays."""
        solver, model, data = self._solver, self._solver.model, self._solver.data
        straight, compliance = solver.straight(q), self._known(q)
        motion = self._near(straight)
        if motion is None:
            return None
        geometric = pin.computeGeneralizedGravityDerivatives(model, data, solver.bent(straight, motion))
        jacobian = pin.getFrameJacobian(model, data, self._joint, self._placement, pin.LOCAL_WORLD_ALIGNED)
        return _Bent(motion, solver.motion(data.g), data.g, compliance, geometric, jacobian)

    def _rest(self, bent: _Bent) -> _Rest | None:
        turn = self._turn
        answer = _redistributed(turn.dot(bent.jacobian[:3]), bent.compliance, bent.geometric)
        if answer is None:
            return None
        # The tangent goes the rest of the way to where the arm rests: what is left is its square.
        place = self._carrier_axes.dot(self._local) + self._carrier_origin
        point = turn.dot(place) + self._shift + answer.dot(bent.given - bent.motion)
        axes = turn.dot(self._carrier_axes).dot(self._tip_axes)
        return _Rest(self._stretch * point, axes, answer, bent)

    def _known(self, q: Array) -> Array:
        """Return the compliance at (nq,) positions, a vector where it is diagonal; the solver then knows it, too."""
        if not self._varying:
            return self._compliance
        row, compliance = self._loaded.row(q, {}), self._compliance.copy()
        self._solver.know(row)
        for _, here, law in self._varying:
            compliance[here, here] += law.tangent(np.zeros(6), row)
        return compliance

    def _near(self, straight: Array) -> Array | None:
        """Return the (nv,) motion close to rest, None where it is far away or not proven that the arm stays."""
        softening, solver = self._loaded.softening, self._solver
        if softening is None or not softening.proven:
            found = settle(self._loaded, solver, straight)
            return None if found is None else found[0]
        law, torque = solver.motion, solver.torque
        motion = law(torque(straight))
        for _ in range(TERMS):
            moved = law(torque(solver.bent(straight, motion)))
            step, motion = moved - motion, moved
            if step.dot(step) < NEAR:
                return motion if motion.dot(motion) < SMALL else None
        return None


def _redistributed(answer: Array, compliance: Array, geometric: Array) -> Array | None:
    """Return answer (I + C G)^-1 as a series, C diagonal as a vector; None where it does not end.

    C is zero at the joints, where this is answer - B C G.
    """
    total = term = answer
    enough = ENOUGH**2 * np.vdot(answer, answer)
    for _ in range(TERMS):
        term = -_times(term, compliance).dot(geometric)
        total = total + term
        if np.vdot(term, term) <= enough:
            return total
    return None


def _times(rows: Array, compliance: Array) -> Array:
    return rows * compliance if compliance.ndim == 1 else rows.dot(compliance)


def _columns_of(block: Block, loaded: LoadedArm) -> Columns:
    """Return the function that gives a block's (3, k) columns of an arm at rest."""
    if isinstance(block, FrameBlock):
        return lambda rest: np.hstack([unit_matrix(3), -pin.skew(rest.point)])
    if isinstance(block, TargetBlock):
        return lambda rest: rest.axes
    if isinstance(block, OffsetBlock):
        places = loaded.mechanics.flex.v_index
        return lambda rest: rest.answer.take(places, axis=1)
    if isinstance(block, ComplianceBlock):
        return _compliance_columns(block, loaded)
    if isinstance(block, LawBlock):
        return _law_columns(block, loaded)
    assert block.name == MOUNTING
    return lambda rest: NONE


def _compliance_columns(block: ComplianceBlock, loaded: LoadedArm) -> Columns:
    """Return the columns of half of (E C + C E) w, w being minus the torque."""
    own = _axes_of(block, loaded)

    def columns(rest: _Rest) -> Array:
        motion, given, torque, compliance, *_ = rest.bent
        if compliance.ndim == 1:
            return rest.answer.take(own, axis=1) * (0.5 * (motion + given)).take(own)
        both = rest.answer * motion - rest.answer.dot(compliance) * torque
        return (0.5 * both).take(own, axis=1)

    return columns


def _axes_of(block: ComplianceBlock, loaded: LoadedArm) -> np.ndarray:
    """Return the (k,) places of a block's axes among the generalized velocities."""
    places = _places(block.flexures, loaded)
    return np.concatenate([here[list(axes)] for here, axes in zip(places, block.axes, strict=True)])


def _law_columns(block: LawBlock, loaded: LoadedArm) -> Columns:
    """Return the columns of compliances that are learned: each parameter's is a matrix, made once."""
    arm, places = loaded.arm, _places(block.flexures, loaded)
    units = [_by_load(law, arm).reshape(-1, 36) for law in _laws_of(block, arm)]
    most, count = max(map(len, units)), len(units)
    matrices = np.array([np.vstack([unit, np.zeros((most - len(unit), 36))]) for unit in units])
    kept = np.flatnonzero(np.concatenate([np.arange(most) < len(unit) for unit in units]))

    def columns(rest: _Rest) -> Array:
        answers, loads = rest.answer[:, places].transpose(1, 2, 0), -rest.bent.torque[places]
        pairs = (answers[:, :, None, :] * loads[:, None, :, None]).reshape(count, 36, 3)
        return np.matmul(matrices, pairs).reshape(-1, 3)[kept].T

    return columns


def _by_load(law: Law, arm: Arm) -> Array:
    """Return the (k, 6, 6) derivative of a learned compliance by its values."""
    assert isinstance(law, LearnedLaw) and constant_compliance(law) is not None
    row = middle_of(arm)
    return np.array([law.by_values(load, row) for load in np.eye(6)]).transpose(2, 1, 0)


def _compiled(quick: Quick, blocks: Sequence[Block]) -> See | None:
    """Return how a bent arm is seen by machine code, None where there is none."""
    functions = compiled()
    if functions is None:
        return None
    own, solver = quick._loaded.mechanics.flex.flexure_v.reshape(-1, 6), quick._solver
    carrier = quick._carrier_axes, quick._carrier_origin
    about = quick._turn, quick._shift, quick._local, quick._tip_axes, quick._stretch, own
    kinds, see, pairs = _kinds(functions, blocks, quick._loaded), functions.see, (own[:, :, None], own[:, None, :])
    constant = None if quick._varying else _square(quick._compliance)[pairs]

    def seen(bent: _Bent, position: Array, sigma: float | Array) -> Seen | None:
        motion, given, torque, compliance, geometric, jacobian = bent
        soft = _square(compliance)[pairs] if constant is None else constant
        place = tuple(position.tolist())
        noise = (sigma,) * 3 if isinstance(sigma, float) else tuple(sigma.tolist())
        state = jacobian, geometric, *carrier, motion, given, torque, place, noise
        ended, residual, columns = see(*state, *about, soft, *kinds, ENOUGH**2, TERMS)
        return Seen(residual, columns) if ended else None

    nothing, size = np.zeros(solver.model.nv), solver.model.nv
    still = _Bent(nothing, nothing, solver.data.g, quick._compliance, np.zeros((size, size)), np.zeros((6, size)))
    seen(still, np.zeros(3), 1.0)  # compiled now, not in the loop
    return seen


def _square(compliance: Array) -> Array:
    return np.diag(compliance) if compliance.ndim == 1 else compliance


def _kinds(functions: ModuleType, blocks: Sequence[Block], loaded: LoadedArm) -> tuple[np.ndarray, ...]:
    """Return the kinds of all parameters as `compiled.see` knows them, and which of a kind each is."""
    every: list[tuple[int, Sequence[int]]] = []
    places, units = [np.zeros((0, 6), dtype=int)], [np.zeros((0, 6, 6))]
    for block in blocks:
        if isinstance(block, FrameBlock):
            every += [(functions.SHIFT, range(3)), (functions.TURN, range(3))]
        elif isinstance(block, TargetBlock):
            every.append((functions.TARGET, range(3)))
        elif isinstance(block, OffsetBlock):
            every.append((functions.JOINT, loaded.mechanics.flex.v_index))
        elif isinstance(block, ComplianceBlock):
            every.append((functions.COMPLIANCE, _axes_of(block, loaded)))
        elif isinstance(block, LawBlock):
            own = [_by_load(law, loaded.arm) for law in _laws_of(block, loaded.arm)]
            places += [
                np.tile(here, (len(one), 1)) for here, one in zip(_places(block.flexures, loaded), own, strict=True)
            ]
            units += own
            every.append((functions.LAW, range(sum(map(len, own)))))
        else:
            every.append((functions.NOTHING, range(len(block.labels))))
    kinds = np.concatenate([np.full(len(which), kind) for kind, which in every])
    which = np.concatenate([np.asarray(which, dtype=int) for _, which in every])
    return kinds, which, np.vstack(places), np.ascontiguousarray(np.vstack(units))


def _laws_of(block: LawBlock, arm: Arm) -> list[Law]:
    laws = {flexure.name: flexure.law for flexure in arm.flexures}
    return [laws[name] for name in block.flexures]


def _places(names: Sequence[str], loaded: LoadedArm) -> np.ndarray:
    """Return the (n, 6) places of flexures among the generalized velocities."""
    every = loaded.mechanics.flex.flexure_v.reshape(-1, 6)
    return every[[loaded.arm.flexure_names.index(name) for name in names]]


def middle_of(arm: Arm) -> Row:
    """Return a row in the middle of the joints' ranges, for laws that are the same in every row."""
    middle = 0.5 * (arm.robot.lower + arm.robot.upper)
    return Row(np.where(np.isfinite(middle), middle, 0.0), arm.joint_index, {"payload_mass": np.zeros(())})
