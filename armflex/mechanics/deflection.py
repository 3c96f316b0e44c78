"""What an arm does at one configuration or at many: where it rests, and all that follows from it.

The engine says where an arm that stands still rests; where it moves Pinocchio does, which also says all that follows of
one row. What arrays have no quick way for is asked of a batch's `row`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.arguments import checked_kinds
from armflex.conventions import LARGEST_POSITION, TWIST_NAMES, WRENCH_NAMES, Array, finite_array, real_array
from armflex.errors import ExtrapolationError, Flag, ShapeError, UnsupportedError, naming, worst_of
from armflex.laws import Row
from armflex.laws.effects.in_arm import beyond_seen
from armflex.laws.row import MASS
from armflex.mechanics.certificate import NEAR
from armflex.mechanics.engine.tables import Frames
from armflex.mechanics.equilibrium import Equilibrium, find_equilibrium, load_factor
from armflex.mechanics.loaded import LoadedArm, Names, Payload, Structure
from armflex.mechanics.loop_rows import rigid_tips, solver_of
from armflex.mechanics.many_rows import (
    AT_ONCE,
    NO_CHANGES,
    Pushes,
    RowSolver,
    Solution,
    by_payload,
    chunks,
    displaced_from,
    responded,
    rotations,
    tips_of,
    within,
)
from armflex.mechanics.mechanism import Linear, Mechanism, Rest
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.mechanics.response import respond
from armflex.parallel import in_order, in_pieces
from armflex.result import Result
from armflex.robot.urdf import drive_of
from armflex.rows.wrench import check_rows

PIECE = 16384
"""Configurations that a process or thread is given at a time."""

SLACK = 1e-3
"""How far beyond its limits [rad or m] a joint without a drive may stand: flexures move it, too."""

CHUNK = 512
"""Rows whose covariances are found together."""


class Asked(NamedTuple):
    """How a question is to be answered; see `Arm.deflection`."""

    method: str = "exact"
    enforce_limits: bool = True
    allow_large: bool = False
    strict: bool = False

    def together(self, arm: Structure, case: LoadCase) -> bool:
        """Return whether the engine is asked about many rows at once, which follow from nothing but themselves."""
        return not (arm.loaded(None).tied or case.moves) and self.method == "exact"


Length = TypeVar("Length", float, Array)


class _Result(Result, Generic[Length]):
    """What follows alike for one configuration and for N; `...` is nothing for one.

    Attributes:
        arm, case: The arm, where its joints are, and what acts.
        displacement: (..., 6) flexed minus rigid, base axes [m, rad].
        contributions: (..., n_flexures, 6) first-order share of each flexure in it [m, rad].
        corrected: (..., 6) share of what calibration corrected [m, rad].
        covariance: (..., 6, 6) of the displacement [m, rad and mixed], None where no law carries one.
        drive_loads: (..., nq) load on every drive along or about its axis [N, Nm].
        wrenches, twists: (..., n_flexures, 6) load on [N, Nm] and deflection of [m, rad] every flexure, local axes.
    """

    FIELDS = ("q", "displacement", "covariance", "contributions", "wrenches", "twists")
    ROWS = "table"

    arm: Structure
    case: LoadCase
    displacement: Array
    contributions: Array
    corrected: Array
    covariance: Array | None
    drive_loads: Array
    wrenches: Array
    twists: Array

    @property
    def q(self) -> Array:
        """(..., nq) joint positions [rad or m]."""
        return self.case.q

    @property
    def names(self) -> Names:
        """Joints, flexures, base and tip."""
        return self.arm.names

    @property
    def table(self) -> dict[str, Any]:
        """Load [N, Nm] and deflection [m, rad] of every flexure by column; of many rows q and displacement of each."""
        if self.q.ndim > 1:
            q = {f"q_{name}": values for name, values in zip(self.names.joints, self.q.T, strict=True)}
            return q | dict(zip(TWIST_NAMES, self.displacement.T, strict=True))
        columns = dict(zip(WRENCH_NAMES, self.wrenches.T, strict=True)) | dict(
            zip(TWIST_NAMES, self.twists.T, strict=True)
        )
        return {"flexure": self.names.flexures, **columns}

    @property
    def drive_shares(self) -> Array:
        """(..., nq) load on every drive as a share of its effort limit, dimensionless, 0 where none is given."""
        return np.abs(self.drive_loads) / [joint.effort for joint in self.arm.robot.moving]

    @property
    def remainder(self) -> Array:
        """(..., 6) displacement less `corrected` and the `contributions`: what first order leaves out [m, rad]."""
        return self.displacement - self.corrected - self.contributions.sum(axis=-2)

    @checked_kinds
    def shares(self, part: slice = slice(0, 3)) -> Array:
        """Return (..., n_flexures) of each flexure along the tip's shift (0:3) [m] or turn (3:6) [rad]."""
        along = self.displacement[..., part, None]
        length = np.linalg.norm(along, axis=-2)
        return (self.contributions[..., part] @ along)[..., 0] / np.where(length > 0.0, length, 1.0)

    @checked_kinds
    def sigma(self, part: slice = slice(0, 3)) -> Length | None:
        """Return the standard uncertainty of the length of the tip's shift or turn, None where no law carries one."""
        if self.covariance is None:
            return None
        return length_sigma(self.displacement[..., part], self.covariance[..., part, part])  # pyright: ignore[reportReturnType]


def length_sigma(vectors: Array, covariance: Array, short: bool = False) -> Array:
    """Return the (...) standard uncertainty of the lengths of (..., 3) vectors with a (..., 3, 3) covariance.

    It is to first order; of no length it is that of all three coordinates. A vector shorter than its uncertainty has no
    direction that first order could depend on. `short` says that vectors may be so: then it is the root mean square of
    what the length may be off, from the mean and variance of its square, which for normal deviations are exact; of a
    long vector that is first order's, of none that of all three coordinates.

    Args:
        vectors: (..., 3).
        covariance: (..., 3, 3), infinite on the diagonal where a coordinate may be anything: then is the length's, too.
        short: Whether vectors may be shorter than their uncertainty.
    """
    endless = np.asarray(np.isinf(np.diagonal(covariance, axis1=-2, axis2=-1)).any(axis=-1))
    covariance = np.where(endless[..., None, None], 0.0, covariance)
    length, total = np.linalg.norm(vectors, axis=-1), np.trace(covariance, axis1=-2, axis2=-1)
    along = vectors / np.where(length > 0.0, length, 1.0)[..., None]
    # As a sum over rows at once the last digit would depend on how many there are.
    variance = (along[..., None, :] @ covariance @ along[..., None])[..., 0, 0]
    if short:
        mean = length**2 + total  # of the square, whose variance is four times its mean times the length's
        scatter = 2.0 * length**2 * variance + np.square(covariance).sum(axis=(-2, -1))
        scatter /= np.where(mean > 0.0, 2.0 * mean, 1.0)
        longer = (total - scatter) / np.where(length > 0.0, np.sqrt(np.maximum(mean - scatter, 0.0)) + length, 1.0)
        variance = total - 2.0 * length * longer
    variance = np.where(length > 0.0, np.maximum(variance, 0.0), total)
    return np.where(endless, np.inf, np.sqrt(variance))


@dataclass(frozen=True, init=False, repr=False, eq=False)
class Deflection(_Result[float]):
    """The arm at one configuration under one load.

    Derivatives and covariance of the rotation are those of a further small rotation in base axes, which differ from
    those of the rotation vector itself by half its length (1 % at 22 mrad).

    The equilibrium is found, and refused where there is none, before there is a `Deflection`; what follows from it is
    computed when it is asked for, and kept.

    Attributes:
        solved: The equilibrium.
        asked_flags: Flags of the question.
    """

    FIELDS = (*_Result.FIELDS, "load_factor", "passive", "loop_loads", "cylinder_states", "spring_states")

    solved: Equilibrium
    asked_flags: tuple[Flag, ...] = ()

    def __init__(self, solved: Equilibrium, asked_flags: tuple[Flag, ...] = ()) -> None:
        # What a frozen dataclass makes itself takes as long as a third of a step to the equilibrium.
        self.__dict__["solved"], self.__dict__["asked_flags"] = solved, asked_flags

    def __repr__(self) -> str:
        """Two lines: how far the tip moves, and what is doubtful."""
        shift, turn = (float(np.linalg.norm(part)) for part in (self.displacement[:3], self.displacement[3:]))
        flags = ", ".join(flag.code for flag in self.flags) or "none"
        moves = f"{self.names.tip} moves {shift * 1e3:.4g} mm and turns {turn * 1e3:.3g} mrad"
        return f"<Deflection: {moves} under {self.payload.mass:g} kg; flags: {flags}>"

    @property
    def arm(self) -> Structure:
        """The arm."""
        return self.solved.loaded.arm

    @property
    def case(self) -> LoadCase:
        """Where its joints are and what acts."""
        return self.solved.case

    @property
    def payload(self) -> Payload:
        """What is carried."""
        return self.solved.loaded.payload

    @cached_property
    def displacement(self) -> Array:
        """(6,) flexed minus rigid: shift of the tip origin [m] and rotation vector [rad], base axes."""
        found = self.solved.rest.displacement
        found.flags.writeable = False
        return found

    @cached_property
    def pose(self) -> pin.SE3:
        """Tip pose of the flexed arm in the base frame."""
        return self._mechanics.frame_pose(self._configuration, self._mechanics.flex.tip)

    @cached_property
    def rigid_pose(self) -> pin.SE3:
        """Tip pose of the rigid arm."""
        return self._mechanics.rigid_tip_pose(self.q)

    @cached_property
    def flags(self) -> tuple[Flag, ...]:
        """Flags about this result."""
        loaded, robot = self.solved.loaded, self.arm.robot
        flags = (*self.asked_flags, *loaded.sag_flags(self.displacement), *self.unseen)
        return (*flags, *self._flags_of_loops()) if robot.linkage else flags

    def _flags_of_loops(self) -> Iterator[Flag]:
        """Yield flags about passive joints beyond their limits, and loads in loops that nothing determines."""
        at = np.array([list(self.passive.values())])
        yield from (flag for _, flag in beyond_limits(self.arm, at))
        idle = self._mechanics.idle(self.case, self._row)
        if idle.shape[1]:
            name, _ = self._mechanics.tied.apart(int(np.abs(idle).max(axis=1).argmax()))
            text = f"nothing determines loads in loop {name!r} across its plane: they are left out, and move nothing"
            yield Flag("undetermined_loads", text)

    @cached_property
    def wrenches(self) -> Array:
        """(n_flexures, 6) loads on the flexures, local axes [N, Nm]."""
        return self.solved.rest.loads

    @cached_property
    def twists(self) -> Array:
        """(n_flexures, 6) local deflections [m, rad]."""
        return self.solved.rest.twists

    @property
    def method(self) -> str:
        """How the equilibrium was found."""
        return self.solved.method

    @property
    def residuals(self) -> tuple[float, ...]:
        """Largest residual of the equilibrium before each step of Newton's method [m or rad]; the engine has none."""
        return tuple(self.solved.history)

    @cached_property
    def joint_loads(self) -> Array:
        """(nq, 6) wrench on the structure at every joint, in its child frame [N, Nm]; of a cylinder tension along x."""
        return self._mechanics.joint_loads(self.solved.placed)

    @property
    def drive_loads(self) -> Array:
        """(nq,) load on every drive about or along its joint's axis [Nm or N]; of a cylinder its tension.

        What follows a drive by a gear loads it, too.
        """
        linkage, tensions = self.arm.robot.linkage, self._forces[len(self.arm.robot.linkage.loops) :, 0]
        torque = self._mechanics.held(self.solved.placed)
        return np.append(-torque[self._mechanics.flex.v_index], tensions[: len(linkage.cylinders)])

    @property
    def overload(self) -> tuple[Flag, ...]:
        """A flag where a drive carries more than its effort limit."""
        worst = int(np.argmax(shares := self.drive_shares))
        text = f"drive of {self.names.joints[worst]!r} carries {shares[worst]:.0%} of its limit"
        return (Flag("beyond_effort", text, size=float(shares[worst])),) if shares[worst] > 1.0 else ()

    @property
    def passive(self) -> dict[str, float]:
        """Positions [rad or m] of the joints without a drive, by name; those that follow others are among them."""
        places = self._mechanics.flex.free_q
        return dict(zip(self.arm.robot.linkage.free, self._configuration[places].tolist(), strict=True))

    @property
    def loop_loads(self) -> dict[str, Array]:
        """(6,) what `to` exerts on `link` at the pin of every loop, in axes of `link` [N, Nm], by the loop's name."""
        return {loop.name: self._forces[k] for k, loop in enumerate(self.arm.robot.linkage.loops)}

    @property
    def cylinder_states(self) -> dict[str, Array]:
        """(2,) length between the pins [m] and tension [N] of every cylinder, by name."""
        linkage, lengths = self.arm.robot.linkage, self._mechanics.lengths(self._configuration)
        tensions = self._forces[len(linkage.loops) :, 0]
        pairs = zip(linkage.cylinders, lengths, tensions, strict=False)
        return {one.name: np.array([length, tension]) for one, length, tension in pairs}

    @cached_property
    def spring_states(self) -> Array:
        """(n_springs, 2) length [m] and tension [N] of every spring, in the order of `Arm.springs`."""
        return self._mechanics.spring_states(self._configuration)

    @property
    def tangent(self) -> Array:
        """(6 n, 6 n) tangent `I + C dτ/dtwist` at the solution, in units of the twists.

        Raises:
            UnsupportedError: The flexures of an arm with loops are not free of each other.
        """
        if self.arm.robot.linkage:
            raise UnsupportedError("an arm with loops has no tangent of its flexures alone: ask for load_factor")
        return self.solved.tangent

    @cached_property
    def load_factor(self) -> float:
        """How many times as large its loads could be until the arm buckles; see `armflex.mechanics.equilibrium`."""
        return load_factor(self.solved.tangent)

    @cached_property
    def flexure_jacobian(self) -> Array:
        """(6, 6 n) change of the tip (origin, rotation; base axes) [m, rad] per change of the flexures' twists.

        Loops stay closed, by the joints without a drive as far as they can.
        """
        linear, flex = self._linear, self._mechanics.flex
        tree = flex.flexure_v < self._mechanics.model.nv
        found = np.empty((6, len(tree)))
        found[:, tree] = self._held[:, flex.flexure_v[tree]] @ linear.bodily
        found[:, ~tree] = self._by_gap @ linear.rows[:, flex.flexure_v[~tree] - self._mechanics.model.nv]
        return found

    @cached_property
    def joint_jacobian(self) -> Array:
        """(6, nq) change of the tip (origin, rotation; base axes) [m, rad] per joint, flexures held as they are."""
        return np.concatenate([self._held[:, self._mechanics.flex.v_index], self._by_gap[:, self._linear.lengths]], 1)

    @cached_property
    def total_jacobian(self) -> Array:
        """(6, nq) change of the tip (origin, rotation; base axes) [m, rad] per joint, flexures following loads."""
        linear, tip = self._linear, self._tip
        moved = tip @ linear.by_motion[:, self._mechanics.flex.v_index]
        change = self.arm.stack.change_with_position(self.wrenches.ravel(), self._row)
        return np.concatenate([moved, tip @ linear.by_gap[:, linear.lengths]], axis=1) + self._gain @ change

    @cached_property
    def contributions(self) -> Array:
        """(n_flexures, 6) of the displacement due to each flexure [m, rad], first order; see `remainder`."""
        columns = self.flexure_jacobian.reshape(6, -1, 6)
        return np.einsum("ink,nk->ni", columns, self.twists)

    @cached_property
    def corrected(self) -> Array:
        """(6,) of the displacement due to `Arm.corrections`: the arm as it was calibrated, before it gives [m, rad]."""
        known = self.arm.corrections
        if not (known.joint_offset or known.geometry):
            return np.zeros(6)
        return self._mechanics.displacement(self.solved.placed.rigid, self.q)

    @cached_property
    def compliance(self) -> Array:
        """(6, 6) displacement of the tip per wrench at the tip origin, base axes, about the solution [m/N, ...]."""
        return self._tip @ self._linear.by_load @ self._tip.T

    @cached_property
    def covariance(self) -> Array | None:
        """(6, 6) covariance of the displacement [m, rad], None where no law carries an uncertainty.

        It is of the laws alone: what a calibration or a trace fitted is left out; see `Arm.total_covariance`.
        """
        laws = self.arm.stack.covariance(self.wrenches.ravel(), self._row)
        return None if laws is None else self._gain @ laws @ self._gain.T

    @property
    def _gain(self) -> Array:
        """(6, 6 n) change of the tip per change of the flexures' laws."""
        return self._tip @ self._linear.by_law

    @property
    def _mechanics(self) -> Mechanism:
        return self.solved.loaded.mechanics

    @cached_property
    def _configuration(self) -> Array:
        return self.solved.placed.configuration

    @property
    def _forces(self) -> Array:
        """(K, 6) forces in what closes."""
        return -self.solved.placed.torque[self._mechanics.model.nv :].reshape(-1, 6)

    @cached_property
    def _row(self) -> Row:
        return self.solved.row

    @cached_property
    def _linear(self) -> Linear:
        return self._mechanics.linear(self.solved.placed)

    @cached_property
    def _tip(self) -> Array:
        return self._mechanics.tip_jacobian(self._configuration)

    @cached_property
    def _by_gap(self) -> Array:
        """(6, m) motion of the tip per length of what closes, by the joints without a drive alone."""
        free = self._mechanics.flex.free_v
        return self._tip[:, free] @ np.linalg.pinv(self._linear.ways[:, free])

    @cached_property
    def _held(self) -> Array:
        """(6, nv) motion of the tip per body motion of everything else, the loops closed."""
        return self._tip - self._by_gap @ self._linear.ways

    def check_seen(self) -> None:
        """Raise `ExtrapolationError` where a trained law was asked beyond the loads that it has seen."""
        if self.unseen:
            raise ExtrapolationError("; ".join(flag.text for flag in self.unseen))

    @cached_property
    def unseen(self) -> tuple[Flag, ...]:
        """Flags about loads beyond those that a trained law has seen, and columns beyond those of an effect."""
        stack = self.arm.stack
        laws = stack.flags(self.wrenches.ravel(), self._row) if stack.trained else ()
        return (*laws, *beyond_seen(self.arm.effects, self._row).get(0, ()))

    @checked_kinds
    def link_poses(self, magnification: float = 1.0, further: Array | None = None) -> dict[str, Array]:
        """Return the (4, 4) pose [m] of every link with the flexures' twists magnified; 0 gives the rigid arm.

        Args:
            magnification: Factor on the twists.
            further: (n_flexures, 6) motion of the flexures beside them, as of a mode [m, rad].
        """
        mechanics, at = self._mechanics, self.solved.placed
        motion = magnification * at.motion
        if further is not None:
            shape = (len(self.names.flexures), 6)
            motion[mechanics.flex.flexure_v] += finite_array(further, "further", shape).ravel()
        found = mechanics.link_poses(mechanics.flexed(at.rigid, motion))
        for one in self.case.wrenches:
            found |= one.links(found[one.frame])
        return found


def deflect(
    loaded: LoadedArm, case: LoadCase, flags: tuple[Flag, ...], method: str, allow_large: bool = False
) -> Deflection:
    """Return what the arm does in a case; `flags` are the known about its joint positions.

    Raises:
        As `find_equilibrium`.
    """
    check_rows(case.wrenches, None)
    known, found = loaded.flags_under(case.wrenches, case.moves), find_equilibrium(loaded, case, method, allow_large)
    if found.load_factor < NEAR:
        flags = (*flags, *near_buckling(found.load_factor))
    return Deflection(found, (*known, *flags) if flags else known)


def near_buckling(factor: float) -> tuple[Flag, ...]:
    """Return a flag where loads less than `NEAR` times as large would make the arm buckle."""
    if not factor < NEAR:
        return ()
    more = factor / (factor - 1.0)
    times = f"{more:.2g}" if more < 100.0 else f"{more:,.0f}"
    text = f"the arm would buckle under {factor:.4g} times its loads, and gives some {times} times"
    return (Flag("near_buckling", f"{text} what it would if the loads did not move with it", size=more),)


def beyond_limits(arm: Structure, at: Array) -> Iterator[tuple[int, Flag]]:
    """Yield the furthest row, and a flag about it, of each joint without a drive beyond its limits.

    Args:
        arm: The arm.
        at: (N, p) positions of its joints without a drive [rad or m].
    """
    joints = {joint.name: joint for joint in arm.robot.jointed}
    for name, column in zip(arm.robot.linkage.free, at.T, strict=True):
        joint = joints[name]
        further = np.maximum(joint.lower - column, column - joint.upper)
        if len(further) and further.max() > SLACK:
            row = int(further.argmax())
            text = f"joint {name!r} has no drive and stands at {column[row]:.6g}, outside its limits "
            text += f"[{joint.lower:g}, {joint.upper:g}]"
            yield row, Flag("passive_limits", text, about=name, size=float(further[row]))


@dataclass(frozen=True, repr=False, eq=False)
class DeflectionBatch(_Result[Array]):
    """The arm at N configurations; the arrays of `Deflection` with a leading N.

    Equilibria are found before there is a batch; what follows from them is computed when it is asked for, and kept.

    Attributes:
        arm: The arm.
        payloads: What is carried: one for all rows, or one for each.
        case: Where the joints are in the rows, and what acts.
        asked: How the question was answered.
        displacement: (N, 6) flexed minus rigid, base axes [m, rad].
        twists: (N, n_flexures, 6) local deflections [m, rad].
        found_wrenches: (N, n_flexures, 6) `wrenches` [N, Nm] where they were found with the twists, else of no rows.
        found_factors: (N,) `load_factor` where it is less than `NEAR`; infinite elsewhere.
        closed, flexed: (N, p) positions of joints without a drive, nothing giving, and at rest [rad or m].
        forces: (N, m) in what closes [N, Nm].
    """

    arm: Structure
    payloads: tuple[str | Payload | None, ...]
    case: LoadCase
    asked: Asked
    displacement: Array
    found_wrenches: Array
    twists: Array
    found_factors: Array
    closed: Array
    flexed: Array
    forces: Array

    def __repr__(self) -> str:
        """One line: how many rows and the largest shift."""
        most = float(np.linalg.norm(self.displacement[:, :3], axis=1).max(initial=0.0))
        return f"<DeflectionBatch: {len(self.q)} rows, {self.names.tip} moves up to {most * 1e3:.4g} mm>"

    def payload(self, i: int) -> str | Payload | None:
        """Return what is carried in a row."""
        return self.payloads[0 if len(self.payloads) == 1 else i]

    def row(self, i: int) -> Deflection:
        """Return one of the rows by itself."""
        loaded, case = self.arm.loaded(self.payload(i)), self.case.some(i)
        checked, flags = self.arm.check_position(case.q, enforce_limits=False)
        at = self.displacement[i].copy(), self.twists[i], self.wrenches[i]
        rest = Rest(*at, True, self.closed[i], self.flexed[i], self.forces[i])
        factor, case = float(self.found_factors[i]), case._replace(q=checked)
        found = Equilibrium(loaded, case, rest, self.asked.method, load_factor=factor)
        return Deflection(found, (*self._flags_of(loaded), *flags, *near_buckling(factor)))

    @property
    def load_factor(self) -> Array:
        """(N,) `Deflection.load_factor`; a row takes a tenth of a millisecond or more."""
        return np.array([self.row(i).load_factor for i in range(len(self.q))])

    @cached_property
    def total_jacobian(self) -> Array:
        """(N, 6, nq) `Deflection.total_jacobian` [m, rad] per joint; a row takes a tenth of a millisecond or more."""
        return np.array([self.row(i).total_jacobian for i in range(len(self.q))]).reshape(-1, 6, self.q.shape[1])

    @cached_property
    def rigid_pose(self) -> Array:
        """(N, 4, 4) tip poses of the rigid arm in the base frame [m]."""
        return rigid_tips(self.arm.loaded(None), self.q)

    @cached_property
    def pose(self) -> Array:
        """(N, 4, 4) tip poses of the flexed arm in the base frame [m]."""
        found = self.rigid_pose.copy()
        found[:, :3, 3] += self.displacement[:, :3]
        found[:, :3, :3] = rotations(self.displacement[:, 3:]) @ found[:, :3, :3]
        return found

    @cached_property
    def wrenches(self) -> Array:
        """(N, n_flexures, 6) loads on the flexures, local axes [N, Nm]."""
        if not self.asked.together(self.arm, self.case):
            return self.found_wrenches
        found = np.empty_like(self.twists)
        for some, loads in self._asked("loads", lambda loaded: loaded.flexure_frames):
            found[some] = loads[:, :-1]
        return found

    @cached_property
    def contributions(self) -> Array:
        """(N, n_flexures, 6) first-order share of each flexure in the displacement [m, rad]."""
        found = np.empty_like(self.twists)
        for rows, poses in self._asked("poses", lambda loaded: loaded.flexure_frames):
            # To go on along a twist is to move by it: exp6's derivative leaves it as it is.
            turns, origins, tip = poses[:, :-1, :3, :3], poses[:, :-1, :3, 3], poses[:, -1:, :3, 3]
            shift, turn = ((turns @ part[..., None])[..., 0] for part in np.split(self.twists[rows], 2, axis=2))
            found[rows] = np.concatenate([shift + np.cross(turn, tip - origins), turn], axis=2)
        for i in self._others:
            found[i] = self.row(i).contributions
        return found

    @cached_property
    def drive_loads(self) -> Array:
        """(N, nq) load on every drive about or along its joint's axis [Nm or N]."""
        moving, found = self.arm.robot.moving, np.empty_like(self.q)
        axes = np.array([drive_of(joint) for joint in moving])

        def links(loaded: LoadedArm) -> Frames:
            return loaded.sites.some([loaded.sites.names.index(f"link:{joint.name}") for joint in moving])

        for rows, loads in self._asked("loads", links):
            found[rows] = np.einsum("nja,ja->nj", loads, axes)
        for i in self._others:
            found[i] = self.row(i).drive_loads
        return found

    @cached_property
    def corrected(self) -> Array:
        """(N, 6) of the displacement due to `Arm.corrections` [m, rad]."""
        nowhere, loaded = np.zeros((len(self.q), 6)), self.arm.loaded(None)
        if not self.arm.corrections.move:
            return nowhere
        if not self.asked.together(self.arm, self.case):
            return np.array([self.row(i).corrected for i in self._others]).reshape(-1, 6)
        return displaced_from(nowhere, tips_of(loaded.tree, self.q), self.rigid_pose)

    @cached_property
    def covariance(self) -> Array | None:
        """(N, 6, 6) of the laws alone [m, rad], None where none is uncertain; see `Arm.total_covariance`."""
        found, left, known = np.zeros((len(self.q), 6, 6)), np.ones(len(self.q), dtype=bool), False
        quick = self.asked.method == "exact" and not self.case.moves
        for loaded, carrying in by_payload(self.arm, self.payloads, len(self.q)) if quick else ():
            for rows in in_pieces(carrying, CHUNK):
                case, wrenches = self.case.some(rows), self.wrenches[rows]
                row = loaded.row(case.q, case.covariates)
                parts = [law.covariance(wrenches[:, i], row) for i, law in enumerate(self.arm.stack.laws)]
                left[rows] = False
                if all(part is None for part in parts):
                    continue
                known = True
                carried = (loaded.payload,) * len(rows)
                gains = respond(self.arm, case.q, carried, case.covariates, True, case.wrenches).laws
                for i, part in enumerate(parts):
                    if part is not None:
                        found[rows] += gains[:, :, i] @ part @ np.swapaxes(gains[:, :, i], 1, 2)
        for i in np.flatnonzero(left).tolist():
            one = self.row(i).covariance
            known, found[i] = known or one is not None, 0.0 if one is None else one
        return found if known else None

    @cached_property
    def flags(self) -> tuple[Flag, ...]:
        """Flags, each with the worst row it concerns; those about laws with the first row that has any."""
        unseen = [] if self.first_unseen is None else [(self.first_unseen[0], flag) for flag in self.first_unseen[1]]
        met = sorted((*self.flags_by_row, *unseen), key=lambda pair: pair[0])
        return tuple(worst_of(replace(flag, text=f"row {number}: {flag.text}") for number, flag in met).values())

    @property
    def flags_by_row(self) -> list[tuple[int, Flag]]:
        """The flags about arm, loads, limits and sag, each with a row; `unseen` has those of laws."""
        arm, found = self.arm, []
        for loaded, rows in by_payload(arm, self.payloads, len(self.q)):
            found += [(int(rows[0]), flag) for flag in self._flags_of(loaded)] if len(rows) else []
        for i in np.flatnonzero(~within(self.q, arm.robot.lower, arm.robot.upper)):
            found += [(int(i), flag) for flag in arm.check_position(self.q[i], enforce_limits=False)[1]]
        for i in [int(np.argmin(self.found_factors))] if len(self.q) else ():
            found += [(i, flag) for flag in near_buckling(float(self.found_factors[i]))]
        for i in [int(np.argmax(np.linalg.norm(self.displacement[:, :3], axis=1)))] if len(self.q) else ():
            found += [(i, flag) for flag in arm.loaded(None).sag_flags(self.displacement[i])]
        return [*found, *(beyond_limits(arm, self.flexed) if arm.robot.linkage else ())]

    def flags_at(self, time: Array) -> Iterator[Flag]:
        """Yield all flags, those of laws and drives too, the first rows first, with the (N,) times [s] of rows."""
        met = [*self.flags_by_row, *((i, flag) for i, flags in self.unseen() for flag in flags)]
        shares = self.drive_shares.max(axis=1, initial=0.0)
        for i in [int(np.argmax(shares))] if shares.max(initial=0.0) > 1.0 else ():
            met += [(i, flag) for flag in self.row(i).overload]
        for i, flag in sorted(met, key=lambda pair: pair[0]):
            yield flag if flag in self.arm.flags else replace(flag, text=f"at {time[i]:g} s: {flag.text}")

    @cached_property
    def first_unseen(self) -> tuple[int, tuple[Flag, ...]] | None:
        """The first row beyond what a trained law or an effect has seen, and the flags about it."""
        return next(self.unseen(), None)

    def unseen(self) -> Iterator[tuple[int, tuple[Flag, ...]]]:
        """Yield the rows beyond what a trained law or an effect has seen, and the flags about them."""
        stack, wrenches = self.arm.stack, self.wrenches.reshape(len(self.q), -1)
        known = {MASS: np.empty(len(self.q)), **self.case.covariates}
        for loaded, rows in by_payload(self.arm, self.payloads, len(self.q)):
            known[MASS][rows] = loaded.payload.mass
        effects = beyond_seen(self.arm.effects, Row(self.q, self.arm.joint_index, known))
        for i in range(len(self.q)) if stack.trained else sorted(effects):
            flags = tuple(effects.get(i, ()))
            if stack.trained:
                row = self.arm.loaded(self.payload(i)).row(self.q[i], self.case.some(i).covariates)
                flags = (*stack.flags(wrenches[i], row), *flags)
            if flags:
                yield i, flags

    def _asked(self, what: str, of: Callable[[LoadedArm], Frames]) -> Iterator[tuple[np.ndarray, Array]]:
        """Yield rows and what the engine says of frames of the arm there, where arrays have a quick way."""
        for loaded, carrying in () if self._others else by_payload(self.arm, self.payloads, len(self.q)):
            for rows in in_pieces(carrying, PIECE):
                pushes, frames = Pushes(loaded, self.case.some(rows).wrenches), of(loaded)
                at = self.q[rows], self.twists[rows]
                pushed = (pushes.links, pushes.wrenches(*at), NO_CHANGES)
                yield rows, responded(loaded.tree, (what,), *at, sites=frames, bodies=frames, pushed=pushed)[what]

    @property
    def _others(self) -> range:
        """Rows that are asked one by one."""
        return range(0 if self.asked.together(self.arm, self.case) else len(self.q))

    def _flags_of(self, loaded: LoadedArm) -> tuple[Flag, ...]:
        return loaded.flags_under(self.case.wrenches, self.case.moves)


def deflect_batch(
    arm: Structure,
    payload: str | Payload | Sequence[str | Payload | None] | None,
    case: LoadCase,
    asked: Asked,
    jobs: int | None = None,
) -> DeflectionBatch:
    """Return what the arm does in N rows, whose positions and motion are not yet checked; see `Arm.deflection`."""
    q = check_positions(arm, case.q, asked.enforce_limits)
    payloads: tuple[str | Payload | None, ...]
    if payload is None or isinstance(payload, str | Payload):
        payloads = (payload,)
    elif len(payloads := tuple(payload)) != len(q):
        raise ShapeError(f"payload: expected one name or {len(q)}, got {len(payloads)}")
    v, a = _motion(arm, case.v, "v", q), _motion(arm, case.a, "a", q)
    check_rows(case.wrenches, len(q))
    case = LoadCase(q, v, a, case.wrenches, case.covariates)
    arm.loaded(None).flags_under(case.wrenches, moves=False)  # raises where a link is not the arm's
    here, alone = asked.together(arm, case), jobs in (None, 1) or arm.loaded(None).tied
    answers = Solution.empty(arm.loaded(None).tree, len(q), loads=not here)
    pieces = [slice(start, start + PIECE) for start in range(0, len(q), PIECE)]
    rooms = [answers.some(rows) for rows in pieces]
    tasks = []
    for rows, room in zip(pieces, rooms, strict=True):
        carried = payloads if len(payloads) == 1 else payloads[rows]
        into = room if alone or here else None  # compiled code runs side by side in threads, Pinocchio does not
        tasks.append(partial(_answer, arm, carried, case.some(rows), asked, rows.start, into))
    done = (task() for task in tasks) if alone else in_order(tasks, jobs, threads=here)
    for room, part in zip(rooms, done, strict=True):
        for into, values in zip(room, part, strict=True):
            if values is not into:
                into[:] = values
    found = DeflectionBatch(arm, payloads, case, asked, *answers)
    if asked.strict and found.first_unseen is not None:
        number, flags = found.first_unseen
        raise ExtrapolationError(f"row {number}: " + "; ".join(flag.text for flag in flags))
    return found


@np.errstate(over="ignore", invalid="ignore")  # a row that runs away is not fine, and is asked alone
def _answer(
    arm: Structure, payloads: tuple, case: LoadCase, asked: Asked, first: int, room: Solution | None
) -> Solution:
    """Return the answers in some rows, from row `first` on; in a room for them where there is one."""
    count, tied, left = len(case.q), arm.loaded(None).tied, np.ones(len(case.q), dtype=bool)
    found = room or Solution.empty(arm.loaded(None).tree, count, loads=not asked.together(arm, case))

    def alone(i: int) -> Rest:
        with naming(f"row {first + i}"):
            checked, flags = arm.check_position(case.q[i], asked.enforce_limits)
            loaded = arm.loaded(payloads[0 if len(payloads) == 1 else i])
            solved = deflect(loaded, case.some(i)._replace(q=checked), flags, asked.method, asked.allow_large).solved
        found.put(i, solved.rest)
        found.load_factor[i] = solved.load_factor
        return solved.rest

    quick = asked.method == "exact" and not case.moves
    for loaded, rows in by_payload(arm, payloads, count) if quick else ():
        for some in chunks(rows, AT_ONCE):
            part, into, numbers = case.some(some), found.some(some), np.arange(count)[some]
            row = loaded.row(part.q, part.covariates)
            if tied:
                solver = solver_of(loaded, part.wrenches)
                fine = solver.rest(part.q, row, into, lambda i, numbers=numbers: alone(int(numbers[i]))).fine
            else:
                fine = RowSolver(loaded, part.wrenches).rest(row, into)
            left[some] = ~fine
            for values, own in () if isinstance(some, slice) else zip(found, into, strict=True):
                if len(values):
                    values[some] = own
    for i in np.flatnonzero(left).tolist():
        alone(i)
    return found


def check_positions(arm: Structure, q: Array, enforce_limits: bool) -> Array:
    """Return a copy of (N, nq) positions; raise as `Arm.check_position` does, naming the first row that is wrong."""
    lower, upper = np.maximum(arm.robot.lower, -LARGEST_POSITION), np.minimum(arm.robot.upper, LARGEST_POSITION)
    fits = q.shape[1] == len(lower)
    inside = within(q, lower, upper) if fits else np.zeros(len(q), dtype=bool)
    for i in np.flatnonzero(~inside):
        with naming(f"row {i}"):
            arm.check_position(q[i], enforce_limits)
    if not fits and not len(q):
        raise ShapeError(f"q: expected shape (N, {len(lower)}), got {q.shape}")
    return q.copy()


def _motion(arm: Structure, values: ArrayLike | None, name: str, q: Array) -> Array | None:
    """Return a copy of (N, nq) velocities or accelerations; raise naming the first row that is wrong."""
    if values is None:
        return None
    array = real_array(values, name)
    if array.shape != q.shape:
        raise ShapeError(f"{name}: expected shape {q.shape}, got {array.shape}")
    for i in np.flatnonzero(~(np.abs(array) <= LARGEST_POSITION).all(axis=1)):
        with naming(f"row {i}"):
            arm.checked(array[i], name)
    return array.copy()
