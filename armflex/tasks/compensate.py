"""Joint positions that put the loaded, deflected tip where the rigid arm would have been.

For each row the smallest change of the joints is found (in the norm given by `weights`) that cancels the tip's error
inside the limits, with the Jacobian of the deflected arm. What cannot be reached is said, with the reason.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pinocchio as pin

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import Array, as_pose, number, real_array
from armflex.errors import Flag, InputError, UnreachableError, naming, worst_of
from armflex.estimate.posterior import without_declared_uncertainty
from armflex.estimate.tip_uncertainty import flagged_covariance
from armflex.laws.effects.in_arm import about_time
from armflex.measured.table import Tabular
from armflex.mechanics.deflection import Deflection, length_sigma
from armflex.mechanics.loop_rows import rigid_tips
from armflex.mechanics.response import respond
from armflex.parallel import in_pieces, in_threads
from armflex.progress import Progress
from armflex.result import Result
from armflex.rows.wrench import wrenches_in
from armflex.tasks.check import turned_further
from armflex.tasks.inverse_kinematics import NEAR_SINGULAR, NO_EQUILIBRIUM, TOLERANCE, Corrector, Search, Trial
from armflex.trajectory import TARGET, Trajectory, as_trajectory

TOGETHER = 1024
"""Rows that are solved together."""

LARGEST_CHANGE = 0.5
"""A correction of more than this [rad or m] is no correction of a deflection."""


@dataclass(frozen=True)
class CompensatedRow:
    """What came out for one row.

    Attributes:
        time: [s].
        via: Name of the via-point, or ''.
        before: (6,) error of the tip without compensation, deflected minus rigid, base axes [m, rad].
        after: (6,) error that remains in the same form [m, rad].
        change: (nq,) change of the joint positions [rad or m].
        reached: Whether the matched components are within `TOLERANCE`.
        reason: Why not: "limit", "too far", "singular", "joints", "equilibrium", "history" or "tolerance", and what
            exactly; '' when reached.
        sigma_min: Smallest singular value of the matched Jacobian [m per m or rad].
        smallest: Whether no smaller change near by reaches it, as far as could be shown; False where not reached.
        sigma_m, sigma_rad: Standard uncertainties of what remains, of the shift's length and of the turn's [m, rad]:
            `after` is what the arm as declared and fitted does, the machine is so far from it. Of the laws and of all
            that was fitted; infinite where it depends on what neither a campaign nor a prior determined, None where
            nobody states one.
        relative_sigma_m: `sigma_m` of the target that the arm was calibrated with, before its instrument: without what
            only says where base and target stand, which is the same for all rows.
    """

    time: float
    via: str
    before: Array
    after: Array
    change: Array
    reached: bool
    reason: str
    sigma_min: float
    smallest: bool = True
    sigma_m: float | None = None
    sigma_rad: float | None = None
    relative_sigma_m: float | None = None


@dataclass(frozen=True, repr=False)
class Compensation(Result):
    """A compensated trajectory and what remains.

    Attributes:
        trajectory: The same rows with new joint positions.
        rows: What came out for each.
        match: "position" or "pose".
        between_m: Largest error of the tip halfway between rows of one payload, the path being straight in joint
            space there [m]; None with given targets.
        flags: Flags: near singular rows, joints asked to move faster than their limit, payloads that change,
            changes that may not be the smallest; no uncertainty that anybody states.
    """

    FIELDS = ("ok", "match", "between_m", "rows", "flags")
    ROWS = "rows"

    trajectory: Trajectory
    rows: tuple[CompensatedRow, ...]
    match: str
    between_m: float | None
    flags: tuple[Flag, ...]

    @property
    def ok(self) -> bool:
        """Whether every row was reached."""
        return all(row.reached for row in self.rows)

    @property
    def remains_m(self) -> tuple[float, float | None]:
        """What remains at most in a row, and the largest standard uncertainty of that in any [m]; see `sigma_m`."""
        most = max(float(np.linalg.norm(row.after[:3])) for row in self.rows)
        return most, max((row.sigma_m for row in self.rows if row.sigma_m is not None), default=None)

    @property
    def relative_sigma_m(self) -> float | None:
        """The largest `relative_sigma_m` of any row [m]."""
        sigmas = (row.relative_sigma_m for row in self.rows)
        return max((sigma for sigma in sigmas if sigma is not None), default=None)

    @property
    def turns_rad(self) -> tuple[float, float]:
        """How far the tip is turned at most in a row before, and after [rad]."""
        before, after = ([np.linalg.norm(getattr(row, name)[3:]) for row in self.rows] for name in ("before", "after"))
        return float(max(before)), float(max(after))


@checked_kinds
def compensate(
    arm: Arm,
    trajectory: Trajectory | Tabular,
    match: str = "position",
    targets: Sequence[object] | None = None,
    weights: Array | None = None,
    best_effort: bool = False,
    between: float | None = None,
    progress: Progress | None = None,
    covariates: Mapping[str, float] | None = None,
) -> Compensation:
    """Return the trajectory whose deflected tip is where the rigid arm's would have been.

    It says in its `target` where that is, unless `targets` are given: compensated again it stays what it is, and
    `check` holds it against that. Where the arm's effects depend on the rows before, on the side that a joint came from
    or on play, it is those of the compensated rows that count.

    Args:
        arm: The arm.
        trajectory: Commanded path, payloads included.
        match: "position" holds the tip's origin, "pose" its orientation too (six joints or more).
        targets: Poses to hold instead, one per row: `pin.SE3`, (4, 4) or (7,) position and quaternion xyzw.
        weights: (nq,) cost of moving each joint; 1 per rad and 1 per m when not given.
        best_effort: Return the best feasible rows where others cannot be reached, instead of raising.
        between: Insert rows until the error halfway between rows is at most this [m]; None keeps the given rows.
        progress: Called with (rows done, rows in all).
        covariates: What the arm's effects depend on and no column gives, the same in every row.

    Raises:
        MissingCovariateError: An effect depends on something that was not given.
        UnreachableError: Some row cannot be reached; its `report` is the `Compensation`.
        InputError: Bad targets, weights or positions, or a covariate that no effect depends on.
    """
    trajectory = as_trajectory(trajectory, arm)
    if match not in ("position", "pose"):
        raise InputError(f"match is {match!r}, expected 'position' or 'pose'")
    if between is not None and not between > 0.0:
        raise InputError(f"between must be positive, got {between} m")
    trajectory = trajectory.with_constants(arm, covariates or {})
    again: tuple[Flag, ...] = ()
    if targets is None and trajectory.is_moved:
        trajectory.check_targets(arm)
        away = int((trajectory.meant != trajectory.q).any(axis=1).sum())
        text = f"{away} of {len(trajectory)} rows have joints elsewhere than their {TARGET}_ columns: this path was"
        text = f"{text} compensated before; its target is the rigid tip at those columns"
        again = (Flag("compensated", text),)
    trajectory = replace(trajectory, target=trajectory.meant if targets is None else None)
    costs = np.ones(len(arm.joint_names)) if weights is None else real_array(weights, "weights")
    if costs.shape != (len(arm.joint_names),) or not (costs > 0.0).all() or not np.isfinite(costs).all():
        raise InputError(f"weights: expected {len(arm.joint_names)} positive numbers")
    scale = np.sqrt(costs.min() / costs)
    poses = _targets(arm, trajectory, targets)
    rows, moved = _solve_rows(_Solver(arm, trajectory, match, scale), poses, progress)
    gaps = _gaps(arm, moved) if targets is None else None
    for _ in range(8):  # of rows that are put between
        if between is None or gaps is None or not (gaps > between).any():
            break
        trajectory = trajectory.with_midpoints(gaps > between)
        poses = _targets(arm, trajectory, None)
        rows, moved = _solve_rows(_Solver(arm, trajectory, match, scale), poses, progress)
        gaps = _gaps(arm, moved)
    widest = None if gaps is None else float(gaps.max(initial=0.0))
    rows, uncertain = _with_sigmas(arm, moved, rows)
    timed = about_time(arm, trajectory.known, trajectory.time)
    flags = [*again, *moved.derived_directions(arm), *timed, *_flags_about(arm, trajectory, moved, rows), *uncertain]
    turned = Compensation(moved, rows, match, widest, ()).turns_rad
    if match == "position" and len(arm.joint_names) >= 6:
        flags += turned_further(*turned)
    if between is not None and (widest is None or widest > between):
        left = "is not computed for user-defined targets" if widest is None else f"is still {widest:.3g} m"
        text = f"the error halfway between rows {left}; at most {between:g} m was asked"
        flags.append(Flag("between", text))
    result = Compensation(moved, rows, match, widest, tuple(flags))
    if not (result.ok or best_effort):
        lost = [row for row in rows if not row.reached]
        worst = max(lost, key=lambda row: float(np.linalg.norm(row.after[:3])))
        left = number(float(np.linalg.norm(worst.after[:3])) * 1e3, 3)
        place = f"{worst.time:g} s {worst.via}".rstrip()
        text = f"{len(lost)} of {len(rows)} rows cannot be reached; worst at {place}: {left} mm remain, {worst.reason}"
        raise UnreachableError(text, result)
    return result


def _flags_about(arm: Arm, commanded: Trajectory, moved: Trajectory, rows: Sequence[CompensatedRow]) -> Iterator[Flag]:
    """Yield where joints move far for little or too fast, changes may not be the smallest, and payloads change."""
    near = min(rows, key=lambda row: row.sigma_min)
    if near.sigma_min < NEAR_SINGULAR:
        text = f"at {near.time:g} s the smallest singular value is {near.sigma_min:.2g}: joints move far for little"
        yield Flag("near_singular", text)
    flagged = [row for row in rows if row.reached and not row.smallest]
    if flagged:
        text = f"{len(flagged)} rows, the first at {flagged[0].time:g} s, are reached; smaller changes may do as well"
        yield Flag("not_smallest", text)
    changes = [i for i in range(1, len(moved)) if moved.payload[i] != moved.payload[i - 1]]
    if changes:
        here = moved.prepared(arm).points.some(np.repeat(changes, 2))
        both = [moved.payload[row] for i in changes for row in (i - 1, i)]
        try:
            shifts = arm.deflection(here.q, both, enforce_limits=False, **here.asked).displacement[:, :3]
            jumps = [f"{jump * 1e3:.3g} mm" for jump in np.linalg.norm(shifts[1::2] - shifts[::2], axis=1)]
        except NO_EQUILIBRIUM:  # far from the row before, its payload may be more than the arm can hold
            jumps = ["an unknown amount, as what was carried cannot be held there"] * len(changes)
        for i, jump in zip(changes, jumps, strict=True):
            change = f"from {moved.payload[i - 1]} to {moved.payload[i]} at {moved.time[i]:g} s"
            between = f"between the rows at {moved.time[i - 1]:g} s and {moved.time[i]:g} s"
            text = f"{change} the tip springs by {jump}; {between} it is off by up to as much"
            yield Flag("payload_change", f"{text}, which the error halfway between rows leaves out")
    if len(moved) > 1:
        given, share = commanded.speed_shares(arm), moved.speed_shares(arm)
        # A path that was too fast before is not held against the compensation.
        worse = np.where(share > 1.001 * np.maximum(given, 1.0), share, 0.0)
        segment, joint = np.unravel_index(int(np.argmax(worse)), worse.shape)
        if worse.any():
            where = f"{arm.joint_names[joint]} would move at {share[segment, joint]:.2g} times its speed limit"
            times = f"at {moved.time[segment]:g} s (commanded path: {given[segment, joint]:.2g} times)"
            yield Flag("too_fast", f"{where} {times}")


def _with_sigmas(
    arm: Arm, moved: Trajectory, rows: Sequence[CompensatedRow]
) -> tuple[tuple[CompensatedRow, ...], tuple[Flag, ...]]:
    """Return the rows with the uncertainty of what remains in each, and flags about it."""
    points, certain = moved.prepared(arm).points, without_declared_uncertainty(arm)
    errors, met = np.array([row.after for row in rows]), list[Flag]()

    def uncertain(rows: np.ndarray) -> tuple[list[dict[str, float]], tuple[Flag, ...]]:
        here = points.some(rows)
        deflection = certain.deflection(here.q, here.payload, enforce_limits=False, **here.asked)
        covariance, fitted = flagged_covariance(deflection)
        flags = (*deflection.flags_at(here.time), *fitted)
        if covariance is None:
            return [{}] * len(rows), flags
        relative = flagged_covariance(deflection, relative=True)[0] if arm.certainty else covariance
        asked = (("sigma_m", covariance, 0), ("sigma_rad", covariance, 3), ("relative_sigma_m", relative, 0))
        sigmas = {
            name: length_sigma(errors[rows, at : at + 3], matrix[:, at : at + 3, at : at + 3], short=True).tolist()
            for name, matrix, at in asked
            if matrix is not None
        }
        return [dict(zip(sigmas, row, strict=True)) for row in zip(*sigmas.values(), strict=True)], flags

    stated: list[CompensatedRow] = []
    for sigmas, flags in in_threads(uncertain, in_pieces(np.arange(len(rows)), TOGETHER)):
        met += flags
        stated += [replace(rows[len(stated) + i], **sigma_by_name) for i, sigma_by_name in enumerate(sigmas)]
    if arm.flexure_names and any(row.sigma_m is None for row in stated):
        text = "neither the laws nor a fit of this arm states an uncertainty: what remains is the declared arm's"
        met.append(Flag("no_uncertainty", text))
    return tuple(stated), tuple(worst_of(met).values())


def _solve_rows(
    solver: _Solver, poses: list[pin.SE3], progress: Progress | None
) -> tuple[tuple[CompensatedRow, ...], Trajectory]:
    """Return every row and the moved trajectory, solved again while the rows' history is not that of the moved ones."""
    arm, bare = solver.arm, solver.trajectory
    moved = bare
    for _ in range(6):  # histories, each from the rows of the last
        history = moved.prepared(arm).covariates
        solver = replace(solver, trajectory=replace(bare, covariates=history))
        rows, moved = _solve_each(solver, poses, progress)
        moved = replace(moved, covariates=bare.covariates)
        after = moved.prepared(arm).covariates
        # Relative change of a remembered state, such as play, below which rows need not be solved again.
        if all(np.allclose(history[name], after[name], rtol=1e-9, atol=0.0) for name in history):
            return rows, moved
    return _as_driven(solver, rows, moved, poses), moved


def _solve_each(
    solver: _Solver, poses: list[pin.SE3], progress: Progress | None
) -> tuple[tuple[CompensatedRow, ...], Trajectory]:
    """Return every row and the moved trajectory: all from no change, what is not reached so from the row before."""
    rows: list[CompensatedRow] = []
    pieces = in_pieces(np.arange(len(poses)), TOGETHER)
    none = np.zeros_like(solver.scale)
    for solved in in_threads(lambda piece: solver.solve({i: (poses[i], none) for i in piece.tolist()}), pieces):
        for i, row in solved.items():
            start = rows[-1].change if rows else none
            if not row.reached and start.any():
                both = row, solver.solve({i: (poses[i], start)})[i]
                row = min(both, key=lambda tried: np.abs(tried.after[: solver.size]).max())
            rows.append(row)
        if progress:
            progress(len(rows), len(poses))
    moved = np.array([solver.inside(i, row.change) for i, row in enumerate(rows)])
    return tuple(rows), replace(solver.trajectory, q=moved)


def _as_driven(
    solver: _Solver, rows: Sequence[CompensatedRow], moved: Trajectory, poses: list[pin.SE3]
) -> tuple[CompensatedRow, ...]:
    """Return the rows with what remains when they are driven: the sides that joints come from never settled."""
    driven = replace(solver, trajectory=moved.prepared(solver.arm))
    rows_driven = []
    for i, (row, pose) in enumerate(zip(rows, poses, strict=True)):
        after = _error(driven.ask(i, moved.q[i]).pose, pose)
        left = float(np.abs(after[: solver.size]).max())
        lost = row.reached and left > TOLERANCE
        reason = "history: the change of the joints turns the side that one of them comes from" if lost else row.reason
        rows_driven.append(replace(row, after=after, reached=row.reached and not lost, reason=reason))
    return tuple(rows_driven)


def _targets(arm: Arm, trajectory: Trajectory, targets: Sequence[object] | None) -> list[pin.SE3]:
    if targets is None:
        poses = []
        for i, q in enumerate(trajectory.meant):
            with naming(trajectory.where(i)):
                poses.append(arm.rigid_pose(q))
        return poses
    if len(targets) != len(trajectory):
        raise InputError(f"targets: expected {len(trajectory)} poses, one per row, got {len(targets)}")
    return [as_pose(target, f"target {i}") for i, target in enumerate(targets)]


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
        return self.arm.deflection(q, self.trajectory.payload[i], enforce_limits=False, **self.trajectory.asked(i))

    def solve(self, asked: Mapping[int, tuple[pin.SE3, Array]]) -> dict[int, CompensatedRow]:
        """Return rows by number, each for a target and from a change; what all ask at a time is answered together."""
        searches = {i: self.search(i, start) for i, (_, start) in asked.items()}
        changes, solved = {i: next(search) for i, search in searches.items()}, dict.fromkeys(asked)
        while changes:
            rows = np.array(list(changes))
            answers = self.answers(rows, np.array(list(changes.values())), [asked[i][0] for i in changes])
            changes = {}
            for i, answer in zip(rows.tolist(), answers, strict=True):
                try:
                    changes[i] = searches[i].send(answer)
                except StopIteration as done:
                    solved[i] = done.value
        return {i: row for i, row in solved.items() if row is not None}

    def answers(self, rows: np.ndarray, changes: Array, targets: Sequence[pin.SE3]) -> list[Trial | str]:
        """Return what (M, nq) changes of rows leave, or why the arm finds no equilibrium there."""
        t, half = self.trajectory, len(rows) // 2
        if t.v is None and t.a is None and half:
            try:
                return list[Trial | str](Trial.of(changes, *self.linearised(rows, changes, targets)))
            except NO_EQUILIBRIUM:  # which of them it is
                parts = (slice(half), slice(half, None))
                return [one for part in parts for one in self.answers(rows[part], changes[part], targets[part])]
        alone = list[Trial | str]()
        for i, change, target in zip(rows.tolist(), changes, targets, strict=True):
            try:
                trial = self.ask(i, t.q[i] + change)
                error, jacobian = _error(trial.pose, target), trial.total_jacobian[: self.size]
                alone += Trial.of(change[None], error[None], jacobian[None])
            except NO_EQUILIBRIUM as error:
                alone.append(f"equilibrium: {error}")
        return alone

    def linearised(self, rows: np.ndarray, change: Array, targets: Sequence[pin.SE3]) -> tuple[Array, Array]:
        """Return the (M, 6) error of rows after (M, nq) changes, and its matched Jacobian."""
        t, arm = self.trajectory, self.arm
        columns = {"time": t.time[rows], **{name: values[rows] for name, values in t.covariates.items()}}
        pulled = wrenches_in(t.wrenches, rows)
        line = respond(arm, t.q[rows] + change, [t.payload[i] for i in rows.tolist()], columns, wrenches=pulled)
        given = arm.stack.change_with_position(line.flexure_wrenches.reshape(len(rows), -1), line.row)
        jacobian = line.joints + line.laws.reshape(len(rows), 6, -1) @ given
        error = [_error(pin.SE3(pose), target) for pose, target in zip(line.tip, targets, strict=True)]
        return np.array(error).reshape(-1, 6), jacobian[:, : self.size]

    def search(self, i: int, start: Array) -> Search[CompensatedRow]:
        """Return row i with the best change found from a start, or from none where that leads astray."""
        t = self.trajectory
        before = yield np.zeros_like(start)
        if isinstance(before, str):  # as the arm says it
            with naming(t.where(i)):
                self.ask(i, t.q[i])
            raise InputError(f"{t.where(i)}: {before}")
        low, high = self.box(i)
        corrector, inside = Corrector(low, high, self.scale), bool(((low <= 0.0) & (high >= 0.0)).all())
        point, smallest = yield from corrector.find(start, before if inside else None)
        if point is None:
            raise InputError(f"{t.where(i)}: {corrector.trouble}")
        reached = point.left <= TOLERANCE
        reason = "" if reached else corrector.trouble or self.explain(i, point)
        row_values = (before.error, point.error, point.change, reached, reason, point.sigma_min, smallest)
        return CompensatedRow(float(t.time[i]), t.via[i], *row_values)

    def box(self, i: int) -> tuple[Array, Array]:
        """Return the smallest and largest change of row i: inside the limits, and no more than `LARGEST_CHANGE`."""
        low, high = (limit - self.trajectory.q[i] for limit in (self.arm.robot.lower, self.arm.robot.upper))
        return np.clip(-LARGEST_CHANGE, low, high), np.clip(LARGEST_CHANGE, low, high)

    def inside(self, i: int, change: Array) -> Array:
        """Return row i's joint positions after a change; rounding takes none past its limit."""
        return np.clip(self.trajectory.q[i] + change, self.arm.robot.lower, self.arm.robot.upper)

    def explain(self, i: int, point: Trial) -> str:
        """Return why row i was not reached."""
        count, sigma = len(point.change), point.sigma_min
        if count < self.size == 6:
            return f"joints: a pose takes six, this arm has {count}"
        if blamed := self.blocked(i, point):
            return blamed
        if sigma < NEAR_SINGULAR:
            return f"singular: smallest singular value {sigma:.1e}"
        if count < self.size:
            return f"joints: a position takes three, this arm has {count}"
        return "tolerance: the iteration stalled"

    def blocked(self, i: int, point: Trial) -> str:
        """Return which joints could lower the error if they were let further, and what holds them; '' if none."""
        (low, high), change = self.box(i), point.change
        pull = point.jacobian.T @ point.matched
        size = np.linalg.norm(point.jacobian, axis=0) * np.linalg.norm(point.matched)
        # Joints are blamed whose way out of their limits has at least this part in the way the error would have to go
        down, up = (sign * pull > 1e-3 * size for sign in (1.0, -1.0))
        stuck = ((change <= low + 1e-9) & down) | ((change >= high - 1e-9) & up)
        far = np.abs(change) >= LARGEST_CHANGE - 1e-9
        names = np.array(self.arm.joint_names)
        parts = []
        if (stuck & ~far).any():
            parts.append(f"limit: {', '.join(names[stuck & ~far])}")
        if (stuck & far).any():
            parts.append(f"too far: {', '.join(names[stuck & far])} by more than {LARGEST_CHANGE:g} rad or m")
        return "; ".join(parts)


def _error(pose: pin.SE3, target: pin.SE3) -> Array:
    turn = pin.log3(pose.rotation @ target.rotation.T)
    return np.concatenate([pose.translation - target.translation, turn])


def _gaps(arm: Arm, moved: Trajectory) -> Array:
    """Return the (N - 1,) tip error halfway between rows [m], 0 where the payload changes between them."""
    gaps, prepared = np.zeros(len(moved) - 1), moved.prepared(arm)
    same = [payload == other for payload, other in pairwise(moved.payload)]
    rigid = arm.loaded(None)
    for segments in in_pieces(np.flatnonzero(same), TOGETHER):
        half = np.full(len(segments), 0.5)
        middle = prepared.between(segments, half)
        target = rigid_tips(rigid, middle.meant)
        deflection = arm.deflection(middle.q, middle.payload, **middle.asked)
        gaps[segments] = np.linalg.norm(deflection.pose[:, :3, 3] - target[:, :3, 3], axis=1)
    return gaps
