"""Does a loaded arm keep its tolerance: at every via-point, and on the path between them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm, warn
from armflex.configurations import furthest
from armflex.conventions import Array, number
from armflex.errors import ArmflexError, Flag, InputError, JointLimitError, SmallDisplacementError, naming, worst_of
from armflex.estimate.posterior import without_declared_uncertainty
from armflex.estimate.tip_uncertainty import AT_REST, flagged_covariance, tip_covariance
from armflex.laws.effects.in_arm import about_time
from armflex.measured.table import Tabular
from armflex.mechanics.deflection import DeflectionBatch, length_sigma
from armflex.mechanics.equilibrium import MAX_ROTATION
from armflex.mechanics.loop_rows import rigid_tips
from armflex.mechanics.many_rows import displaced_from
from armflex.parallel import in_pieces, in_threads
from armflex.progress import Progress
from armflex.result import Result
from armflex.rows.wrench import wrenches_in
from armflex.trajectory import Points, Trajectory, as_trajectory

COVERAGE = 2.0
"""A margin inside this many standard uncertainties is neither ok nor fail."""

LARGEST_STEP = 0.1
"""Joints move no further [rad or m] between the first samples of a stretch."""

FEWEST_STEPS, MAX_HALVINGS = 4, 10
MOST_STEPS = 1024
"""Into which a stretch is cut at first: joints that move by more than 100 rad or m from one row to the next are not a
path. A stretch is not halved beyond the steps that the shortest one may be halved into."""

TOGETHER = 512
"""Rows and stretches that are judged together: memory does not grow with the samples."""


VERDICTS = ("fail", "uncertain", "ok")
"""The worst first."""

FAIL, UNCERTAIN, OK = range(len(VERDICTS))
HALVES = slice(0, 3), slice(3, 6)
"""The shift of a displacement, and its turn."""


ROUNDING = 1e-9
"""Fraction of the tolerance within which points are equally bad: a row is named, not the end of a stretch."""


@dataclass(frozen=True)
class Point:
    """One configuration compared with the tolerance.

    Attributes:
        name: The via-point's name, '' on the path between.
        time: [s].
        displacement_m: Length of the tip's shift [m]; against a desired path, of the way from where it is meant.
        rotation_rad: Angle of its rotation [rad], likewise.
        sigma_m: Standard uncertainty of `displacement_m`, of the laws and of what was fitted; infinite where it depends
            on what neither a campaign nor a prior determined, None where nobody states one.
        tolerance_m: Of its row [m]; between rows it is linear.
        margin_m: Tolerance minus displacement [m].
        margin_rad: Angle tolerance minus rotation, None where no angle is asked for.
        verdict: "ok", "fail" or "uncertain".
        cause: The flexure that contributes most to the shift (or rotation) from the rigid arm, None for such an arm.
        payload: What is carried.
        reason: Why it fails whatever the tolerance: a joint limit, or a flexure turning too far; '' otherwise.
    """

    name: str
    time: float
    displacement_m: float
    rotation_rad: float
    sigma_m: float | None
    tolerance_m: float
    margin_m: float
    margin_rad: float | None
    verdict: str
    cause: str | None
    payload: str
    reason: str = ""

    @property
    def badness(self) -> tuple[int, float]:
        """Sorts worst first: verdict, then the margin of the worse of displacement and rotation, relative."""
        margins = [self.margin_m / self.tolerance_m]
        if self.margin_rad is not None:
            margins.append(self.margin_rad / (self.margin_rad + self.rotation_rad))
        return (VERDICTS.index(self.verdict), min(margins))


@dataclass(frozen=True, repr=False)
class CheckReport(Result):
    """The verdict on a trajectory.

    Attributes:
        ok: Every via-point and every point of the path is ok; uncertain is not ok.
        tolerance_m: Of rows that have none of their own [m]; where nobody gave one the least of the rows'.
        angle_rad: What was asked, None where nothing was.
        via_points: Worst first.
        segments: Worst point of each stretch between rows, in order.
        path_worst: Worst point anywhere on the path.
        samples: Number of configurations evaluated.
        relative_sigma_m: Largest standard uncertainty of the position at the via-points, at all rows if none is named,
            without what only says where base and target stand, see `total_covariance`; None of an arm that was not
            fitted.
        load_factor: Least of `Deflection.load_factor` met where it is below 2, else infinite.
        flags: Flags met on the way.
        rows: Every row, in order, via-points among them.
    """

    FIELDS = ("ok", "tolerance_m", "angle_rad", "samples", "load_factor", "via_points", "path_worst", "flags")
    ROWS = "via_points"

    ok: bool
    tolerance_m: float
    angle_rad: float | None
    via_points: tuple[Point, ...]
    segments: tuple[Point, ...]
    path_worst: Point
    samples: int
    flags: tuple[Flag, ...]
    rows: tuple[Point, ...] = ()
    load_factor: float = np.inf
    relative_sigma_m: float | None = None

    @property
    def by_row(self) -> bool:
        """Whether rows have tolerances that differ."""
        return len({point.tolerance_m for point in self.rows}) > 1

    @property
    def asked(self) -> str:
        """The tolerances that the path is compared with, for people."""
        every = [point.tolerance_m for point in self.rows] or [self.tolerance_m]
        lengths = (
            f"{min(every) * 1e3:g} to {max(every) * 1e3:g} mm, by row" if self.by_row else f"{every[0] * 1e3:g} mm"
        )
        return lengths + ("" if self.angle_rad is None else f" and {self.angle_rad * 1e3:g} mrad")


@checked_kinds
def check(
    arm: Arm,
    trajectory: Trajectory | Tabular,
    tolerance: float | None = None,
    angle: float | None = None,
    method: str = "exact",
    progress: Progress | None = None,
    covariates: Mapping[str, float] | None = None,
    against: Trajectory | Tabular | None = None,
) -> CheckReport:
    """Hold the tip's displacement along a trajectory against a tolerance.

    Between rows the path is sampled, and the step halved until no peak that the samples' curvature leaves room for
    would change the verdict, or the worst displacement by more than a hundredth.

    Args:
        arm: The arm.
        trajectory: Via-points and the rows between them.
        tolerance: Largest allowed displacement of the tip's origin [m] in rows that have none of their own, see
            `Trajectory.tolerance`. Between rows it is linear.
        angle: Largest allowed rotation [rad], None to ask for none.
        method: See `Arm.deflection`.
        progress: Called with (rows done, rows in all).
        covariates: What the arm's effects depend on and no column gives, the same in every row.
        against: A path of the same rows: the flexed tip on `trajectory` is compared with where the rigid arm has it on
            this one, at the rows and between them. So a compensated path is checked.

    Raises:
        InputError: A tolerance is not positive, a row has none and none is given, a covariate is one that no effect
            depends on, or a row cannot be used
            or is further from the one before than any path goes; the row and time are named, and its place in a file.
            The rows of `against` are others: in number, time or via-point.
        MissingCovariateError: An effect depends on something that was not given.
    """
    if (tolerance is not None and not tolerance > 0.0) or (angle is not None and not angle > 0.0):
        raise InputError(f"tolerance must be positive, got {tolerance} m" + (f", {angle} rad" if angle else ""))
    reach = furthest(arm, *np.array(arm.bounds))
    trajectory = as_trajectory(trajectory, arm)
    against = None if against is None else as_trajectory(against, arm)
    allowed = _tolerances(trajectory, tolerance)
    trajectory, tolerance = replace(trajectory, tolerance=allowed), tolerance or float(allowed.min())
    doubts = doubtful_tolerance(float(allowed.max()), reach, angle)
    warn(doubts)
    trajectory = trajectory.with_constants(arm, covariates or {})
    trajectory, held = _with_target(arm, trajectory, against)
    derived = (*trajectory.derived_directions(arm), *about_time(arm, trajectory.known, trajectory.time))
    trajectory = trajectory.prepared(arm)
    _check_steps(arm, trajectory)
    certain, count = without_declared_uncertainty(arm), len(trajectory)

    def judged(piece: tuple[bool, np.ndarray]) -> tuple[list[Point], _Judge]:
        (between, rows), judge = piece, _Judge(certain, trajectory, angle, method)
        if between:
            return _worst_between(judge, rows), judge
        samples = judge.at(trajectory.points.some(rows), [judge.trajectory.where(i) for i in rows.tolist()])
        return [judge.point(samples, i, trajectory.via[row]) for i, row in enumerate(rows)], judge

    both = ((False, np.arange(count)), (True, np.arange(count - 1)))
    pieces = [(between, rows) for between, every in both for rows in in_pieces(every, TOGETHER)]
    points: list[Point] = []
    met: list[Flag] = []
    samples, factor, turns = 0, np.inf, np.zeros(2)
    for points_found, judge in in_threads(judged, pieces):
        points += points_found
        met += judge.flags.values()
        samples, factor = samples + judge.samples, min(factor, judge.load_factor)
        turns = np.maximum(turns, judge.turns)
        if progress and len(points) > count:
            progress(len(points) - count, count - 1)
    rows, segments = points[:count], points[count:]
    vias = sorted((row for row in rows if row.name), key=lambda point: point.badness)
    worst = min(points, key=lambda point: point.badness)
    verdict, least = worst.badness
    worst = next((point for point in points if point.badness <= (verdict, least + ROUNDING)), worst)
    ok = all(point.verdict == "ok" for point in points)
    held_only = trajectory.target is not None and angle is None and len(arm.joint_names) >= 6  # a pose takes six
    turned = turned_further(*turns.tolist()) if held_only else ()
    sprung = _payload_changes(trajectory, segments)
    flags = (*doubts, *held, *derived, *worst_of(met).values(), *turned, *sprung, *_too_fast(arm, trajectory))
    named = [i for i, row in enumerate(rows) if row.name and not row.reason]
    possible = named or [i for i, row in enumerate(rows) if not row.reason]
    relative = _relative(certain, trajectory, np.array(possible, dtype=int), method) if arm.certainty else None
    shown = tuple(vias), tuple(segments)
    return CheckReport(ok, tolerance, angle, *shown, worst, samples, flags, tuple(rows), factor, relative)


def _tolerances(trajectory: Trajectory, tolerance: float | None) -> Array:
    """Return the (N,) tolerances of a path's rows [m]; raise where a row has none and none is given."""
    given = np.full(len(trajectory), np.nan) if trajectory.tolerance is None else trajectory.tolerance
    values = np.where(np.isnan(given), np.nan if tolerance is None else tolerance, given)
    if (without := np.flatnonzero(np.isnan(values))).size:
        text = "has no tolerance: give one for such rows (--tolerance 5mm, tolerance=0.005) or a column tolerance"
        raise InputError(f"{trajectory.where(int(without[0]))} {text}")
    if (wrong := np.flatnonzero(values <= 0.0)).size:
        raise InputError(f"{trajectory.where(int(wrong[0]))}: tolerance must be positive, got {values[wrong[0]]} m")
    return values


def _payload_changes(trajectory: Trajectory, segments: Sequence[Point]) -> Iterator[Flag]:
    """Yield a flag where a stretch is not ok only at its end, with what is carried until there."""
    for i, (before, after) in enumerate(pairwise(trajectory.payload)):
        point, time = segments[i], float(trajectory.time[i + 1])
        if before != after and point.verdict != "ok" and point.time == time:
            carried, off = before or "none", number(point.displacement_m * 1e3, 4)
            text = f"at {time:g} s the payload changes from {carried} to {after or 'none'}; until there the path has"
            text += f" {carried}, with which it is {off} mm off there"
            yield Flag("payload_change", text)


def _too_fast(arm: Arm, trajectory: Trajectory) -> Iterator[Flag]:
    """Yield a flag where joints are faster than their limits by the times of the rows, which no verdict is about."""
    shares = trajectory.speed_shares(arm)
    if not (fast := np.flatnonzero((shares > 1.0 + ROUNDING).any(axis=1))).size:
        return
    row, joint = (int(index) for index in np.unravel_index(int(np.argmax(shares)), shares.shape))
    moving, (start, end) = arm.robot.moving[joint], trajectory.time[row : row + 2].tolist()
    limit = f"its speed limit of {moving.velocity:.4g} {'m' if moving.kind == 'prismatic' else 'rad'}/s"
    text = f"from {start:.6g} to {end:.6g} s {moving.name} moves at {shares[row, joint]:.3g} times {limit}"
    more = f", and joints are too fast in {len(fast)} of {len(shares)} stretches" if len(fast) > 1 else ""
    yield Flag("speed_limit", f"{text}{more}: the arm would be later than the path has it")


def _with_target(arm: Arm, trajectory: Trajectory, against: Trajectory | None) -> tuple[Trajectory, tuple[Flag, ...]]:
    """Return the path with the tip that is wanted, and a flag where that is not the rigid one of its own joints."""
    if against is None:
        if not trajectory.is_moved:
            return trajectory, ()
        trajectory.check_targets(arm)
        text = "the tip is compared with the rigid tip at the joints of the target_ columns"
        return trajectory, (Flag("target", text),)
    towards = trajectory.towards(against)
    towards.check_targets(arm, against.places or [f"row {i} of the desired path" for i in range(len(against))])
    text = "the joints of the desired path differ from its target_ columns, as after a compensation; its joints"
    flag = Flag("desired_moved", f"{text} count here: are the two paths exchanged?")
    return towards, (flag,) if against.is_moved else ()


def _relative(certain: Arm, trajectory: Trajectory, rows: np.ndarray, method: str) -> float | None:
    """Return the largest standard uncertainty [m] at some rows without what only says where base and target stand."""
    if not len(rows):
        return None
    # Rows that `relative_sigma_m` is looked for in.
    points = trajectory.points.some(rows[np.unique(np.linspace(0, len(rows) - 1, 200).astype(int))])
    deflection = certain.deflection(points.q, points.payload, enforce_limits=False, method=method, **points.asked)
    covariance, _ = flagged_covariance(deflection, relative=True)
    if covariance is None:
        return None
    return float(np.sqrt(np.trace(covariance[:, :3, :3], axis1=1, axis2=2)).max())


def doubtful_tolerance(tolerance: float, reach: float, angle: float | None = None) -> tuple[Flag, ...]:
    """Return whether a tolerance [m] may be in millimetres, where it is a tenth of the reach [m] or more.

    And whether an angle [rad] may be in degrees, from a tenth on: a tip that moves or turns so far has flexures that
    turn by more than what they are computed for.
    """
    asked = []
    if tolerance >= MAX_ROTATION * reach:
        text = f"a tolerance of {tolerance:g} m for an arm of {reach:.3g} m: lengths are metres, {tolerance:g} mm are"
        asked.append(Flag("tolerance", f"{text} {tolerance * 1e-3:g}"))
    if angle is not None and angle >= MAX_ROTATION:
        text = f"a tolerance of {angle:g} rad for how far the tip turns: angles are radians, {angle:g} degrees are"
        asked.append(Flag("tolerance_angle", f"{text} {np.deg2rad(angle):.4g}"))
    return tuple(asked)


def turned_further(bent: float, turned: float) -> tuple[Flag, ...]:
    """Return a flag where a position is held at the cost of how the tip is turned.

    It is `turned` from where it is meant, and `bent` by bending alone, at most [rad].
    """
    # Times as far as bending alone turns the tip, from which on it is said that a path holds its position alone
    if not turned > 2.0 * bent:
        return ()
    sizes = (
        f"by up to {number(turned * 1e3, 3)} mrad from where it is meant, by {number(bent * 1e3, 3)} from bending alone"
    )
    advice = "only its position is held, `compensate --match pose` (match='pose') holds both"
    return (Flag("turned", f"the tip is turned {sizes}: {advice}"),)


class _Samples(NamedTuple):
    """(M, ...) points compared with the tolerance.

    time: [s]. sizes: (M, 2) of the tip's shift [m] and turn [rad]. sigmas: (M, 2) of these, NaN where there is none.
    verdict: (M,) place in `VERDICTS`. cause: (M,) number of a flexure. scores: (M, 3) displacement, and the most and
    least that it may be, as fractions allowed. badness: (M,) smaller where it is worse, among those of one verdict.
    payload, reason, tolerance: As of `Point`.
    """

    time: Array
    sizes: Array
    sigmas: Array
    verdict: np.ndarray
    cause: np.ndarray
    scores: Array
    badness: Array
    payload: np.ndarray
    reason: np.ndarray
    tolerance: Array


class _Judge:
    """Evaluates some points and collects what was met on the way; one thread's own."""

    def __init__(self, arm: Arm, trajectory: Trajectory, angle: float | None, method: str) -> None:
        self.arm, self.trajectory, self.angle, self.method = arm, trajectory, angle, method
        self.samples, self.load_factor, self.turns = 0, np.inf, (0.0, 0.0)
        self.flags: dict[tuple[str, str], Flag] = {}

    def between(self, segments: np.ndarray, fractions: Array) -> _Samples:
        """Return the verdicts at (M,) fractions of the way from (M,) rows to the next.

        Many a point is met twice, as the end of a stretch and the beginning of another: it is asked about once.
        """
        points = self.trajectory.between(segments, fractions)
        names = {name: float(i) for i, name in enumerate(dict.fromkeys(points.payload))}
        parts = [points.time, points.q, [names[name] for name in points.payload], points.v, points.a, points.target]
        parts += [*points.covariates.values()]
        parts += [part for load in points.wrenches if load.rows is not None for part in (load.force, load.moment)]
        table = np.column_stack([part for part in parts if part is not None])
        _, first, back = np.unique(table, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(first)  # as they come, so that a flag is about the first of them
        place, first = np.argsort(order)[back.ravel()], first[order]
        asked = points.some(first)
        every, starts = np.arange(len(segments)), np.flatnonzero(np.diff(segments, prepend=-1))
        number = (every - starts[np.searchsorted(starts, every, side="right") - 1])[first]
        samples = self.at(asked, [f"row {i} at {time:g} s" for i, time in zip(number, asked.time, strict=True)])
        self.samples += len(segments) - len(first)
        return _Samples(*(part[place] for part in samples))

    def at(self, points: Points, names: Sequence[str]) -> _Samples:
        """Return the verdicts at some points; errors are raised again with the point's name."""
        self.samples += len(points.time)
        asked = {**points.asked, "method": self.method}
        reason = np.full(len(points.time), "", dtype=object)
        try:
            deflection = self.arm.deflection(points.q, points.payload, **asked)
        except ArmflexError:  # one bad row must not hide the others
            reason[:] = [self.trouble(points, i, name) for i, name in enumerate(names)]
            deflection = self.arm.deflection(points.q, points.payload, enforce_limits=False, allow_large=True, **asked)
        self.flags = worst_of([*self.flags.values(), *deflection.flags_at(points.time)])
        self.load_factor = min(self.load_factor, float(deflection.found_factors.min(initial=np.inf)))
        return self.judge(deflection, self.covariance(deflection, points, reason == ""), points, reason)

    def trouble(self, points: Points, i: int, name: str) -> str:
        """Return why a point cannot be allowed, '' where it can; raise where it has no answer at all."""
        columns = {key: values[i] for key, values in points.covariates.items()}
        moved = {key: None if values is None else values[i] for key, values in (("v", points.v), ("a", points.a))}
        asked = {"method": self.method, "covariates": {"time": points.time[i], **columns}, **moved}
        asked["wrenches"] = wrenches_in(points.wrenches, i)
        with naming(name):
            try:
                self.arm.deflection(points.q[i], points.payload[i], **asked)
            except (JointLimitError, SmallDisplacementError) as error:
                self.arm.deflection(points.q[i], points.payload[i], enforce_limits=False, allow_large=True, **asked)
                return str(error)
        return ""

    def covariance(self, deflection: DeflectionBatch, points: Points, fine: np.ndarray) -> Array | None:
        """Return the (M, 6, 6) covariance of the displacement, None where nobody states one; others fail anyhow."""
        laws = deflection.covariance
        if self.arm.certainty is None or not fine.any():
            return laws
        stated = np.flatnonzero(fine)
        given = {name: values[stated] for name, values in points.asked["covariates"].items()}
        of_laws = None if laws is None else laws[stated]
        carried, pulled = [points.payload[i] for i in stated.tolist()], wrenches_in(points.wrenches, stated)
        fitted, flags = tip_covariance(self.arm, points.q[stated], carried, given, of_laws, pulled)
        for flag in (*flags, *((AT_REST,) if points.v is not None or points.a is not None else ())):
            self.flags.setdefault(flag.kind, flag)
        if fitted is None:
            return laws
        total = np.full((len(fine), 6, 6), np.nan) if laws is None else laws.copy()
        total[stated] = fitted
        return total

    def judge(
        self, deflection: DeflectionBatch, covariance: Array | None, points: Points, reason: np.ndarray
    ) -> _Samples:
        """Return the verdicts on points whose displacements have a (M, 6, 6) covariance."""
        error, near = deflection.displacement, points.target is not None
        if points.target is not None:
            rigid = self.arm.loaded(None)
            error = displaced_from(error, deflection.rigid_pose, rigid_tips(rigid, points.target))
        sizes = np.stack([np.linalg.norm(error[:, half], axis=1) for half in HALVES], axis=1)
        bent = np.linalg.norm(deflection.displacement[:, 3:], axis=1)
        self.turns = tuple(
            float(np.max(part, initial=most)) for part, most in zip((bent, sizes[:, 1]), self.turns, strict=True)
        )
        sigmas = np.full(sizes.shape, np.nan)
        if covariance is not None:
            each = [length_sigma(error[:, half], covariance[:, half, half], near) for half in HALVES]
            sigmas = np.stack(each, axis=1)
        # Of the turn only where an angle is asked for; what has no uncertainty is as it is.
        tolerance = np.asarray(points.tolerance)
        limits = np.column_stack(
            [tolerance] if self.angle is None else [tolerance, np.full(len(tolerance), self.angle)]
        )
        judged = limits.shape[1]
        size, sigma = sizes[:, :judged], np.nan_to_num(sigmas[:, :judged], posinf=np.inf)
        # Tolerances that an infinite uncertainty counts as
        half_width = np.minimum(COVERAGE * sigma, 1e9 * limits)
        margins, possible = limits - size, reason == ""
        verdicts = np.where(np.abs(margins) < half_width, UNCERTAIN, np.where(margins >= 0.0, OK, FAIL))
        verdict = np.where(possible, verdicts.min(axis=1), FAIL)
        most, least = ((size + sign * half_width) / limits for sign in (1.0, -1.0))
        scores = np.stack([sizes[:, 0] / tolerance, most.max(axis=1), least.max(axis=1)], axis=1)
        scores[~possible, 1:] = np.maximum(scores[~possible, 1:], 2.0)
        cause = np.zeros(len(sizes), dtype=int)
        if self.arm.flexure_names:
            shares = np.stack([deflection.shares(half) for half in HALVES], axis=1)
            worse = np.argmin(margins / limits, axis=1)
            cause = shares[np.arange(len(shares)), worse].argmax(axis=1)
        badness = (margins / limits).min(axis=1)
        payload = np.array(points.payload, dtype=object)
        return _Samples(points.time, sizes, sigmas, verdict, cause, scores, badness, payload, reason, tolerance)

    def point(self, samples: _Samples, i: int, name: str = "") -> Point:
        """Return one of some points by itself."""
        (shift, turn), sigma = samples.sizes[i].tolist(), float(samples.sigmas[i, 0])
        names, tolerance = self.arm.flexure_names, float(samples.tolerance[i])
        return Point(
            name,
            float(samples.time[i]),
            shift,
            turn,
            None if np.isnan(sigma) else sigma,
            tolerance,
            tolerance - shift,
            None if self.angle is None else self.angle - turn,
            VERDICTS[samples.verdict[i]],
            names[samples.cause[i]] if names else None,
            samples.payload[i],
            samples.reason[i],
        )


def _worst_between(judge: _Judge, segments: np.ndarray) -> list[Point]:
    """Return the worst point of each stretch from a row to the next, both (with its payload) included."""
    q, worst = judge.trajectory.q, {}
    far = np.abs(q[segments + 1] - q[segments]).max(axis=1, initial=0.0)
    steps = np.maximum(FEWEST_STEPS, np.ceil(far / LARGEST_STEP).astype(int))
    for count in np.unique(steps):
        open_segments, here = segments[steps == count], int(count)
        fractions = np.linspace(0.0, 1.0, here + 1)
        samples = judge.between(np.repeat(open_segments, here + 1), np.tile(fractions, len(open_segments)))
        for halving in range(MAX_HALVINGS + 1):
            scores = samples.scores.reshape(len(open_segments), here + 1, 3)
            left = ~_settled(scores) if halving < MAX_HALVINGS and here <= FEWEST_STEPS << (MAX_HALVINGS - 1) else None
            done = np.arange(len(open_segments)) if left is None else np.flatnonzero(~left)
            for j in done.tolist():
                rows = slice(j * (here + 1), (j + 1) * (here + 1))
                i = rows.start + int(np.lexsort((samples.badness[rows], samples.verdict[rows]))[0])
                worst[int(open_segments[j])] = judge.point(samples, i)
            if left is None or not left.any():
                break
            kept = np.flatnonzero(np.repeat(left, here + 1))
            open_segments = open_segments[left]
            halfway = judge.between(
                np.repeat(open_segments, here), np.tile((np.arange(here) + 0.5) / here, len(open_segments))
            )
            at = np.empty((len(open_segments), 2 * here + 1), dtype=int)  # in turn, as they come along the stretch
            at[:, 0::2] = kept.reshape(len(open_segments), here + 1)
            at[:, 1::2] = len(samples.time) + np.arange(len(open_segments) * here).reshape(len(open_segments), here)
            pairs = zip(samples, halfway, strict=True)
            samples, here = _Samples(*(np.concatenate(pair)[at.ravel()] for pair in pairs)), 2 * here
    return [worst[int(segment)] for segment in segments]


def _check_steps(arm: Arm, trajectory: Trajectory) -> None:
    """Raise `InputError` where a stretch would take more than `MOST_STEPS`, naming its end and the joint."""
    too_far = np.argwhere(np.abs(np.diff(trajectory.q, axis=0)) > MOST_STEPS * LARGEST_STEP)
    if not len(too_far):  # also where a position is not finite, which its row's own error says
        return
    row, joint = (int(index) for index in too_far[0])
    moving, value = arm.robot.moving[joint], trajectory.q[row + 1, joint]
    unit = "m" if moving.kind == "prismatic" else "rad"
    limits = f"limits [{moving.lower:.6g}, {moving.upper:.6g}] {unit}"
    text = f"joint {moving.name!r} goes from {trajectory.q[row, joint]:.6g} to {value:.6g} {unit} in one step"
    most = f"more than {MOST_STEPS * LARGEST_STEP:g} {unit}"
    raise InputError(f"{trajectory.where(row + 1)}: {text}, {most}; {limits}: is the unit right?")


def _settled(scores: Array) -> np.ndarray:
    """Return (S,) whether more samples than these (S, M, 3) scores would change neither verdict nor worst shift."""
    # How high they may get between samples, twice as curved as they look.
    highest, bend = scores.max(axis=1), np.abs(np.diff(scores, n=2, axis=1))
    before, after = np.concatenate([bend[:, :1], bend], axis=1), np.concatenate([bend, bend[:, -1:]], axis=1)
    bend = 2.0 * np.maximum(before, after) + 1e-300
    rise = np.maximum(0.5 * bend - np.abs(np.diff(scores, axis=1)), 0.0) ** 2 / (2.0 * bend)
    hidden = (np.maximum(scores[:, 1:], scores[:, :-1]) + rise).max(axis=1) - highest
    # Fraction of the tolerance below which a peak between samples no longer counts.
    same_verdict = (highest > 1.0) | (highest + hidden <= 1.0) | (hidden < 1e-6)
    return same_verdict[:, 1:].all(axis=1) & (hidden[:, 0] <= 0.01 * np.maximum(highest[:, 0], 1.0))
