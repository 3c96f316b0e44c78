"""Joint positions that put the loaded, deflected tip where the rigid arm would have been.

For each row the smallest change of the joints is found (in the norm given by `weights`) that cancels the tip's error,
inside the limits: Newton's method with the Jacobian of the deflected arm and, where joints meet their limits, an
active set. What cannot be reached is said, with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from armflex.arm import Arm
from armflex.conventions import Array, as_pose
from armflex.deflection import Deflection
from armflex.errors import (
    ArmflexError,
    ConvergenceError,
    Flag,
    InputError,
    SmallDisplacementError,
    UnreachableError,
    UnstableEquilibriumError,
)
from armflex.trajectory import Trajectory

MAX_ITERATIONS = 60
MAX_INSERTIONS = 8
TOLERANCE = 1e-10
"""Remaining error [m, rad] at which a row counts as reached."""

NEAR_SINGULAR = 0.02
"""Smallest singular value of the tip's Jacobian [m per m or rad] below which it is flagged."""

SINGULAR = 1e-6
LARGEST_CHANGE = 0.5
"""A correction of more than this [rad or m] is no correction of a deflection."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class CompensatedRow:
    """What came out for one row.

    Attributes:
        time: [s].
        via: Name of the via-point, or ''.
        before: (6,) error of the tip without compensation, deflected minus rigid, base axes [m, rad].
        after: (6,) error that remains in the same form.
        change: (nq,) change of the joint positions [rad or m].
        reached: Whether the matched components are within `TOLERANCE`.
        reason: Why not: "limit", "singular", "equilibrium" or "tolerance", and what exactly; '' when reached.
        sigma_min: Smallest singular value of the matched Jacobian.
    """

    time: float
    via: str
    before: Array
    after: Array
    change: Array
    reached: bool
    reason: str
    sigma_min: float


@dataclass(frozen=True)
class Compensation:
    """A compensated trajectory and what remains.

    Attributes:
        trajectory: The same rows with new joint positions.
        rows: What came out for each.
        match: "position" or "pose".
        between_m: Largest error of the tip halfway between rows of one payload, the path being straight in joint
            space there [m]; None with targets of one's own.
        flags: Doubts: near singular rows, joints asked to move faster than their limit, payloads that change.
    """

    trajectory: Trajectory
    rows: tuple[CompensatedRow, ...]
    match: str
    between_m: float | None
    flags: tuple[Flag, ...]

    @property
    def ok(self) -> bool:
        """Whether every row was reached."""
        return all(row.reached for row in self.rows)


def compensate(
    arm: Arm,
    trajectory: Trajectory,
    match: str = "position",
    targets: Sequence[object] | None = None,
    weights: Array | None = None,
    best_effort: bool = False,
    between: float | None = None,
    progress: Progress | None = None,
) -> Compensation:
    """Return the trajectory whose deflected tip is where the rigid arm's would have been.

    Args:
        arm: The arm.
        trajectory: Commanded path, payloads included.
        match: "position" holds the tip's origin, "pose" its orientation too (six joints or more).
        targets: Poses to hold instead, one per row: `pin.SE3`, (4, 4) or (7,) position and quaternion xyzw.
        weights: (nq,) cost of moving each joint; 1 per rad and 1 per m when not given.
        best_effort: Return the best feasible rows where others cannot be reached, instead of raising.
        between: Insert rows until the error halfway between rows is at most this [m]; None keeps the given rows.
        progress: Called with (rows done, rows in all).

    Raises:
        UnreachableError: Some row cannot be reached; its `report` is the `Compensation`.
        InputError: Bad targets, weights or positions.
    """
    if match not in ("position", "pose"):
        raise InputError(f"match is {match!r}, expected 'position' or 'pose'")
    if between is not None and not between > 0.0:
        raise InputError(f"between must be positive, got {between} m")
    scale = _scale(arm, weights)
    poses = _targets(arm, trajectory, targets)
    rows, moved = _solve_rows(_Solver(arm, trajectory, match, scale), poses, progress)
    gaps = _gaps(arm, trajectory, moved) if targets is None else None
    for _ in range(MAX_INSERTIONS if between and gaps is not None else 0):
        if not (gaps > between).any():
            break
        trajectory = trajectory.with_midpoints(gaps > between)
        poses = _targets(arm, trajectory, None)
        rows, moved = _solve_rows(_Solver(arm, trajectory, match, scale), poses, progress)
        gaps = _gaps(arm, trajectory, moved)
    widest = None if gaps is None else float(gaps.max(initial=0.0))
    flags = (*_flags(arm, moved, rows), *_too_wide(widest, between))
    result = Compensation(moved, rows, match, widest, flags)
    if not (result.ok or best_effort):
        raise UnreachableError(_summary(result), result)
    return result


def _solve_rows(
    solver: _Solver, poses: list[pin.SE3], progress: Progress | None
) -> tuple[tuple[CompensatedRow, ...], Trajectory]:
    rows: list[CompensatedRow] = []
    for i, pose in enumerate(poses):
        rows.append(solver.row(i, pose, rows[-1].change if rows else np.zeros_like(solver.scale)))
        if progress:
            progress(i + 1, len(poses))
    changes = np.array([row.change for row in rows])
    return tuple(rows), replace(solver.trajectory, q=solver.trajectory.q + changes)


def _targets(arm: Arm, trajectory: Trajectory, targets: Sequence[object] | None) -> list[pin.SE3]:
    if targets is None:
        return [_rigid_pose(arm, trajectory, i) for i in range(len(trajectory))]
    if len(targets) != len(trajectory):
        raise InputError(f"targets: expected {len(trajectory)} poses, one per row, got {len(targets)}")
    return [as_pose(target, f"target {i}") for i, target in enumerate(targets)]


def _rigid_pose(arm: Arm, trajectory: Trajectory, i: int) -> pin.SE3:
    with _naming(trajectory, i):
        return arm.rigid_pose(trajectory.q[i])


@contextmanager
def _naming(trajectory: Trajectory, i: int) -> Iterator[None]:
    """Raise errors again with the row and its time."""
    try:
        yield
    except ArmflexError as error:
        error.args = (f"row {i} at {trajectory.time[i]:g} s: {error.args[0]}", *error.args[1:])
        raise


def _scale(arm: Arm, weights: Array | None) -> Array:
    scale = np.ones(len(arm.joint_names)) if weights is None else np.asarray(weights, dtype=float)
    if scale.shape != (len(arm.joint_names),) or not (scale > 0.0).all() or not np.isfinite(scale).all():
        raise InputError(f"weights: expected {len(arm.joint_names)} positive numbers")
    return 1.0 / np.sqrt(scale)


@dataclass(frozen=True)
class _Solver:
    arm: Arm
    trajectory: Trajectory
    match: str
    scale: Array

    @property
    def size(self) -> int:
        return 3 if self.match == "position" else 6

    def ask(self, i: int, q: Array) -> Deflection:
        """Return the deflection of row i's load at joint positions q."""
        t = self.trajectory
        motion = {key: None if x is None else x[i] for key, x in (("v", t.v), ("a", t.a))}
        return self.arm.deflection(q, t.payload[i], enforce_limits=False, **motion)

    def row(self, i: int, target: pin.SE3, start: Array) -> CompensatedRow:
        """Solve one row, starting from the previous row's change."""
        t = self.trajectory
        with _naming(t, i):
            before = _error(self.ask(i, t.q[i]).pose, target)
        change, after, jacobian, reason = self.solve(i, target, start)
        reached = bool(np.abs(after[: self.size]).max() <= TOLERANCE)
        sigma = float(np.linalg.svd(jacobian * self.scale, compute_uv=False)[min(jacobian.shape) - 1])
        if not reached and not reason:
            reason = self.explain(i, change, sigma)
        time, via = float(t.time[i]), t.via[i]
        return CompensatedRow(time, via, before, after, change, reached, "" if reached else reason, sigma)

    def solve(self, i: int, target: pin.SE3, start: Array) -> tuple[Array, Array, Array, str]:
        """Return the change, the (6,) remaining error, the matched Jacobian and why it stopped early."""
        q, change = self.trajectory.q[i], self.inside(i, start)
        best: tuple[float, Array, Array, Array] | None = None
        reason = ""
        for _ in range(MAX_ITERATIONS):
            try:
                found = self.ask(i, q + change)
            except (ConvergenceError, UnstableEquilibriumError, SmallDisplacementError) as error:
                reason = f"equilibrium: {error}"
                break
            error, jacobian = _error(found.pose, target), found.total_jacobian[: self.size]
            left = float(np.abs(error[: self.size]).max())
            if best is None or left < best[0]:
                best = (left, change, error, jacobian)
            step = self.smallest(i, jacobian, jacobian @ change - error[: self.size])
            if left <= 0.01 * TOLERANCE and np.abs(step - change).max() < 1e-9:
                break
            change = step
        if best is None:
            raise InputError(f"row {i} at {self.trajectory.time[i]:g} s: {reason}")
        return (*best[1:], reason)

    def inside(self, i: int, change: Array) -> Array:
        """Return a change cut so that row i stays inside the limits."""
        q, robot = self.trajectory.q[i], self.arm.robot
        return np.clip(q + change, robot.lower, robot.upper) - q

    def smallest(self, i: int, jacobian: Array, wanted: Array) -> Array:
        """Return the smallest change with `jacobian @ change = wanted` inside the limits, damped where singular.

        Joints that would leave their limits are held there one by one, the furthest out first.
        """
        free = np.ones(len(self.scale), dtype=bool)
        change = np.zeros(len(self.scale))
        while free.any():
            rest = wanted - jacobian[:, ~free] @ change[~free]
            change[free] = self.scale[free] * _damped(jacobian[:, free] * self.scale[free], rest)
            change = np.clip(change, -LARGEST_CHANGE, LARGEST_CHANGE)
            overshoot = np.where(free, np.abs(change - self.inside(i, change)), 0.0)
            if overshoot.max() <= 1e-12:
                break
            out = int(overshoot.argmax())
            change[out] = self.inside(i, change)[out]
            free[out] = False
        return self.inside(i, change)

    def explain(self, i: int, change: Array, sigma: float) -> str:
        """Return why row i was not reached."""
        robot, q = self.arm.robot, self.trajectory.q[i] + change
        stuck = (q <= robot.lower + 1e-9) | (q >= robot.upper - 1e-9)
        if stuck.any():
            names = [name for name, at_limit in zip(robot.joint_names, stuck, strict=True) if at_limit]
            return f"limit: {', '.join(names)}"
        if sigma < NEAR_SINGULAR:
            return f"singular: smallest singular value {sigma:.1e}"
        return "tolerance: the iteration stalled"


def _error(pose: pin.SE3, target: pin.SE3) -> Array:
    turn = pin.log3(pose.rotation @ target.rotation.T)
    return np.concatenate([pose.translation - target.translation, turn])


def _damped(jacobian: Array, wanted: Array) -> Array:
    """Return the least-norm solution, damped only in directions that are all but lost."""
    left, values, right = np.linalg.svd(jacobian, full_matrices=False)
    gains = values / np.maximum(values**2, SINGULAR**2)
    return right.T @ (np.where(values > SINGULAR, gains, 0.0) * (left.T @ wanted))


def _gaps(arm: Arm, commanded: Trajectory, moved: Trajectory) -> Array:
    """Return the (N - 1,) tip error halfway between rows [m], 0 where the payload changes between them."""
    gaps = np.zeros(len(commanded) - 1)
    for segment in range(len(gaps)):
        if commanded.payload[segment] == commanded.payload[segment + 1]:
            target = arm.rigid_pose(commanded.at(segment, np.array([0.5])).q[0])
            middle = moved.at(segment, np.array([0.5]))
            motion = {key: None if x is None else x[0] for key, x in (("v", middle.v), ("a", middle.a))}
            pose = arm.deflection(middle.q[0], middle.payload[0], **motion).pose
            gaps[segment] = np.linalg.norm(pose.translation - target.translation)
    return gaps


def _flags(arm: Arm, moved: Trajectory, rows: Sequence[CompensatedRow]) -> tuple[Flag, ...]:
    flags = []
    near = min(rows, key=lambda row: row.sigma_min)
    if near.sigma_min < NEAR_SINGULAR:
        text = f"at {near.time:g} s the smallest singular value is {near.sigma_min:.2g}: joints move far for little"
        flags.append(Flag("near_singular", text))
    for i in range(1, len(moved)):
        if moved.payload[i] != moved.payload[i - 1]:
            jump = np.linalg.norm(rows[i].before[:3] - rows[i - 1].before[:3])
            change = f"from {moved.payload[i - 1]} to {moved.payload[i]} at {moved.time[i]:g} s"
            text = f"{change} the tip springs by {jump:.3g} m"
            flags.append(Flag("payload_change", text))
    return (*flags, *_too_fast(arm, moved))


def _too_wide(widest: float | None, between: float | None) -> tuple[Flag, ...]:
    if between is None or (widest is not None and widest <= between):
        return ()
    left = "is not looked at with targets of one's own" if widest is None else f"is still {widest:.3g} m"
    return (Flag("between", f"the error halfway between rows {left}; at most {between:g} m was asked"),)


def _too_fast(arm: Arm, moved: Trajectory) -> tuple[Flag, ...]:
    if len(moved) < 2:
        return ()
    speed = np.abs(np.diff(moved.q, axis=0)) / np.diff(moved.time)[:, None]
    share = speed / np.array([joint.velocity for joint in arm.robot.moving])
    segment, joint = np.unravel_index(int(np.argmax(share)), share.shape)
    if share[segment, joint] <= 1.0:
        return ()
    name, time = arm.joint_names[joint], moved.time[segment]
    return (Flag("too_fast", f"{name} would move at {share[segment, joint]:.2g} of its limit at {time:g} s"),)


def _summary(result: Compensation) -> str:
    lost = [row for row in result.rows if not row.reached]
    worst = max(lost, key=lambda row: float(np.linalg.norm(row.after[:3])))
    left = float(np.linalg.norm(worst.after[:3]))
    what = f"{len(lost)} of {len(result.rows)} rows cannot be reached"
    return f"{what}; worst at {worst.time:g} s {worst.via}: {left * 1e3:.3g} mm remain, {worst.reason}"
