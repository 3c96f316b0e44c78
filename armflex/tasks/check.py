"""Does a loaded arm keep its tolerance: at every via-point, and on the path between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import Flag, InputError, JointLimitError, SmallDisplacementError, naming
from armflex.estimate.spread import without_declared_doubt
from armflex.estimate.tip_uncertainty import AT_REST, length_sigma, tip_covariance
from armflex.mechanics.deflection import Deflection
from armflex.trajectory import Trajectory

COVERAGE = 2.0
"""A margin inside this many standard uncertainties is neither ok nor fail."""

LARGEST_STEP = 0.1
"""Joints move no further [rad or m] between the first samples of a stretch."""

FEWEST_STEPS, MAX_HALVINGS = 4, 10
MOST_STEPS = 1024
"""Into which a stretch is cut at first: joints that move by more than 100 rad or m from one row to the next are not a
path. A stretch is not halved beyond the steps that the shortest one may be halved into."""

TOGETHER = 64
"""Stretches that are judged together: what fitted parameters do is found for many samples at once."""

CLOSEST = 1e-6
"""Fraction of the tolerance below which a peak between samples no longer counts."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Point:
    """One configuration held against the tolerance.

    Attributes:
        name: The via-point's name, '' on the path between.
        time: [s].
        displacement_m: Length of the tip's shift [m].
        rotation_rad: Angle of its rotation [rad].
        sigma_m: Standard uncertainty of `displacement_m`, of the laws and of what was fitted; None where there is none.
        margin_m: Tolerance minus displacement [m].
        margin_rad: Angle tolerance minus rotation, None where no angle is asked for.
        verdict: "ok", "fail" or "uncertain".
        cause: The flexure that contributes most, None for a rigid arm.
        payload: What is carried.
        reason: Why it fails whatever the tolerance: a joint limit, or a flexure turning too far; '' otherwise.
    """

    name: str
    time: float
    displacement_m: float
    rotation_rad: float
    sigma_m: float | None
    margin_m: float
    margin_rad: float | None
    verdict: str
    cause: str | None
    payload: str
    reason: str = ""

    @property
    def badness(self) -> tuple[int, float]:
        """Sorts worst first: verdict, then the margin of the worse of displacement and rotation, relative."""
        margins = [self.margin_m / (self.margin_m + self.displacement_m)]
        if self.margin_rad is not None:
            margins.append(self.margin_rad / (self.margin_rad + self.rotation_rad))
        return (-["ok", "uncertain", "fail"].index(self.verdict), min(margins))


@dataclass(frozen=True)
class CheckReport:
    """The verdict on a trajectory.

    Attributes:
        ok: Every via-point and every point of the path is ok; uncertain is not ok.
        tolerance_m, angle_rad: What was asked; `angle_rad` may be None.
        via_points: Worst first.
        segments: Worst point of each stretch between rows, in order.
        path_worst: Worst point anywhere on the path.
        samples: Number of configurations evaluated.
        flags: Doubts met on the way.
        rows: Every row, in order, via-points among them.
    """

    ok: bool
    tolerance_m: float
    angle_rad: float | None
    via_points: tuple[Point, ...]
    segments: tuple[Point, ...]
    path_worst: Point
    samples: int
    flags: tuple[Flag, ...]
    rows: tuple[Point, ...] = ()


def check(
    arm: Arm,
    trajectory: Trajectory,
    tolerance: float,
    angle: float | None = None,
    method: str = "exact",
    progress: Progress | None = None,
    covariates: Mapping[str, float] | None = None,
) -> CheckReport:
    """Hold the tip's displacement along a trajectory against a tolerance.

    Between rows the path is sampled, and the step halved until no peak that the samples' curvature leaves room for
    would change the verdict, or the worst displacement by more than a hundredth.

    Args:
        arm: The arm.
        trajectory: Via-points and the rows between them.
        tolerance: Largest allowed displacement of the tip's origin [m].
        angle: Largest allowed rotation [rad], None to ask for none.
        method: See `Arm.deflection`.
        progress: Called with (rows done, rows in all).
        covariates: What the arm's effects depend on and no column gives, the same in every row.

    Raises:
        InputError: A tolerance is not positive, a covariate is one that no effect depends on, or a row cannot be used
            or is further from the one before than any path goes; the row and time are named, and its place in a file.
        MissingCovariateError: An effect depends on something that was not given.
    """
    if not tolerance > 0.0 or (angle is not None and not angle > 0.0):
        raise InputError(f"tolerance must be positive, got {tolerance} m" + (f", {angle} rad" if angle else ""))
    trajectory = trajectory.with_constants(arm, covariates or {})
    derived, trajectory = trajectory.derived_directions(arm), trajectory.prepared(arm)
    _check_steps(arm, trajectory)
    judge = _Judge(without_declared_doubt(arm), tolerance, angle, method)
    rows = [sample.point for sample in judge.samples_of([trajectory])[0]]
    segments: list[Point] = []
    for first in range(0, len(trajectory) - 1, TOGETHER):
        some = range(first, min(first + TOGETHER, len(trajectory) - 1))
        segments += _worst_between(judge, trajectory, some)
        if progress:
            progress(len(segments), len(trajectory) - 1)
    vias = sorted((row for row in rows if row.name), key=lambda point: point.badness)
    everything = [*rows, *segments]
    worst = min(everything, key=lambda point: point.badness)
    ok = all(point.verdict == "ok" for point in everything)
    flags = (*derived, *judge.flags.values())
    return CheckReport(ok, tolerance, angle, tuple(vias), tuple(segments), worst, judge.samples, flags, tuple(rows))


@dataclass(frozen=True)
class _Sample:
    """A point with its (3,) scores: displacement, and the most and least that it may be, as fractions allowed."""

    point: Point
    scores: Array


class _Judge:
    """Evaluates points and collects what was met on the way."""

    def __init__(self, arm: Arm, tolerance: float, angle: float | None, method: str) -> None:
        self.arm, self.tolerance, self.angle, self.method = arm, tolerance, angle, method
        self.samples = 0
        self.flags: dict[str, Flag] = {}

    def samples_at(self, trajectory: Trajectory, fractions: Mapping[int, Array]) -> dict[int, list[_Sample]]:
        """Return the verdicts on stretches: at fractions (M,) of the way from each row to the next."""
        found = self.samples_of([trajectory.at(segment, some) for segment, some in fractions.items()])
        return dict(zip(fractions, found, strict=True))

    def samples_of(self, parts: Sequence[Trajectory]) -> list[list[_Sample]]:
        """Return the verdicts on all rows of each part; errors are raised again with the row and its time."""
        asked = [[self.named(part, i) for i in range(len(part))] for part in parts]
        self.samples += sum(map(len, asked))
        covariances = iter(self.covariances(parts, [one for some in asked for one in some]))
        return [
            [
                self.judge(found, next(covariances), part.via[i], float(part.time[i]), part.payload[i], reason)
                for i, (found, reason) in enumerate(some)
            ]
            for part, some in zip(parts, asked, strict=True)
        ]

    def named(self, trajectory: Trajectory, i: int) -> tuple[Deflection, str]:
        """Return what `ask` does, and keep the doubts."""
        time, via = float(trajectory.time[i]), trajectory.via[i]
        with naming(f"row {i}" + (f" ({via})" if via else "") + f" at {time:g} s"):
            found, reason = self.ask(trajectory, i)
        for flag in (*found.flags, *overload(self.arm, found)):
            said = flag if flag in self.arm.flags else Flag(flag.code, f"at {time:g} s: {flag.text}")
            self.flags.setdefault(flag.code, said)
        return found, reason

    def covariances(self, parts: Sequence[Trajectory], asked: Sequence[tuple[Deflection, str]]) -> list[Array | None]:
        """Return the (6, 6) covariance of the displacement in every row of all parts, None where nobody states one."""
        laws = [found.covariance for found, _ in asked]
        fine = np.array([i for i, (_, reason) in enumerate(asked) if not reason], dtype=int)  # others fail anyhow
        if self.arm.certainty is None or not len(fine):
            return laws
        columns = [{"time": part.time, **part.covariates} for part in parts]
        known = {name: np.concatenate([one[name] for one in columns])[fine] for name in columns[0]}
        q, payloads = (
            np.concatenate([part.q for part in parts])[fine],
            [name for part in parts for name in part.payload],
        )
        own = None if laws[fine[0]] is None else np.array([laws[i] for i in fine])
        found, flags = tip_covariance(self.arm, q, [payloads[i] for i in fine], known, own)
        moves = parts[0].v is not None or parts[0].a is not None
        for flag in (*flags, *((AT_REST,) if moves else ())):
            self.flags.setdefault(flag.code, flag)
        of_row = dict(zip(fine.tolist(), () if found is None else found, strict=False))
        return [of_row.get(i, own_one) for i, own_one in enumerate(laws)]

    def ask(self, trajectory: Trajectory, i: int) -> tuple[Deflection, str]:
        """Return row i's deflection and why it cannot be allowed, if so: one bad row must not hide the others."""
        asked = {"method": self.method, **trajectory.asked(i)}
        q, payload = trajectory.q[i], trajectory.payload[i]
        try:
            return self.arm.deflection(q, payload, **asked), ""
        except (JointLimitError, SmallDisplacementError) as error:
            found = self.arm.deflection(q, payload, enforce_limits=False, allow_large=True, **asked)
            return found, str(error)

    def judge(
        self, found: Deflection, covariance: Array | None, name: str, time: float, payload: str, reason: str
    ) -> _Sample:
        """Return the verdict on one configuration, whose displacement has a (6, 6) covariance."""
        shift, turn = (float(np.linalg.norm(part)) for part in (found.displacement[:3], found.displacement[3:]))
        sigmas = [_sigma(found.displacement, covariance, part) for part in (slice(0, 3), slice(3, 6))]
        margin = self.tolerance - shift
        margin_rad = None if self.angle is None else self.angle - turn
        verdicts = [_verdict(margin, sigmas[0])]
        if margin_rad is not None:
            verdicts.append(_verdict(margin_rad, sigmas[1]))
        verdict = next(word for word in ("fail", "uncertain", "ok") if word in verdicts or (reason and word == "fail"))
        turns_worse = margin_rad is not None and margin_rad / self.angle < margin / self.tolerance
        cause = blame(found, slice(3, 6) if turns_worse else slice(0, 3))
        point = Point(name, time, shift, turn, sigmas[0], margin, margin_rad, verdict, cause, payload, reason)
        scores = self.scores((shift, turn), sigmas)
        return _Sample(point, np.maximum(scores, [0.0, 2.0, 2.0]) if reason else scores)

    def scores(self, sizes: tuple[float, float], sigmas: list[float | None]) -> Array:
        """Return the (3,) scores of a shift and a turn with their uncertainties."""
        limits = (self.tolerance,) if self.angle is None else (self.tolerance, self.angle)
        doubts = [COVERAGE * (sigma or 0.0) for sigma in sigmas]
        parts = list(zip(sizes, doubts, limits, strict=False))
        most, least = (max((size + sign * doubt) / limit for size, doubt, limit in parts) for sign in (1.0, -1.0))
        return np.array([sizes[0] / self.tolerance, most, least])


def overload(arm: Arm, found: Deflection) -> tuple[Flag, ...]:
    """Return a flag where a drive carries more than its effort limit."""
    shares = arm.drive_shares(found)
    worst = int(np.argmax(shares))
    if shares[worst] <= 1.0:
        return ()
    return (Flag("beyond_effort", f"drive of {arm.joint_names[worst]!r} carries {shares[worst]:.0%} of its limit"),)


def _sigma(displacement: Array, covariance: Array | None, part: slice) -> float | None:
    """Return the standard uncertainty of the length of the tip's shift (0:3) or turn (3:6)."""
    if covariance is None:
        return None
    return float(length_sigma(displacement[None, part], covariance[None, part, part])[0])


def _verdict(margin: float, sigma: float | None) -> str:
    doubt = COVERAGE * (sigma or 0.0)
    if abs(margin) < doubt:
        return "uncertain"
    return "ok" if margin >= 0.0 else "fail"


def blame(found: Deflection, part: slice) -> str | None:
    """Return the flexure that contributes most along the tip's shift (0:3) or turn (3:6), None for a rigid arm."""
    if not found.names.flexures:
        return None
    return found.names.flexures[int(np.argmax(found.shares(part)))]


def _worst_between(judge: _Judge, trajectory: Trajectory, segments: Sequence[int]) -> list[Point]:
    """Return the worst point of each stretch from a row to the next, both (with its payload) included."""
    samples = judge.samples_at(trajectory, {i: np.linspace(0.0, 1.0, _steps(trajectory, i) + 1) for i in segments})
    for _ in range(MAX_HALVINGS):
        open_ones = [i for i in segments if not _settled(np.array([sample.scores for sample in samples[i]]))]
        open_ones = [i for i in open_ones if len(samples[i]) - 1 <= FEWEST_STEPS << (MAX_HALVINGS - 1)]
        if not open_ones:
            break
        steps = {i: len(samples[i]) - 1 for i in open_ones}
        halfway = judge.samples_at(trajectory, {i: (np.arange(count) + 0.5) / count for i, count in steps.items()})
        for i, found in halfway.items():
            samples[i] = [sample for pair in zip(samples[i], found, strict=False) for sample in pair] + samples[i][-1:]
    return [min((sample.point for sample in samples[i]), key=lambda point: point.badness) for i in segments]


def _check_steps(arm: Arm, trajectory: Trajectory) -> None:
    """Raise `InputError` where a stretch would take more than `MOST_STEPS`, naming its end and the joint."""
    too_far = np.argwhere(np.abs(np.diff(trajectory.q, axis=0)) > MOST_STEPS * LARGEST_STEP)
    if not len(too_far):  # also where a position is not finite, which its row's own error says
        return
    row, joint = (int(index) for index in too_far[0])
    moving, value = arm.robot.moving[joint], trajectory.q[row + 1, joint]
    unit = "m" if moving.kind == "prismatic" else "rad"
    limits = f"limits [{moving.lower:.6g}, {moving.upper:.6g}] {unit}"
    text = (
        f"joint {moving.name!r} goes from {trajectory.q[row, joint]:.6g} to {value:.6g} {unit} in one step, more than"
    )
    where = f"{trajectory.places[row + 1]}: " if trajectory.places else ""
    where += f"row {row + 1} at {trajectory.time[row + 1]:g} s"
    raise InputError(f"{where}: {text} {MOST_STEPS * LARGEST_STEP:g} {unit}; {limits}: is the unit right?")


def _steps(trajectory: Trajectory, segment: int) -> int:
    """Return into how many steps a stretch is cut at first."""
    far = np.abs(trajectory.q[segment + 1] - trajectory.q[segment]).max(initial=0.0)
    return max(FEWEST_STEPS, int(np.ceil(far / LARGEST_STEP)))


def _settled(scores: Array) -> bool:
    """Return whether more samples than these (M, 3) scores would change neither verdict nor worst displacement."""
    highest = scores.max(axis=0)
    hidden = _hidden_peak(scores) - highest
    same_verdict = (highest > 1.0) | (highest + hidden <= 1.0) | (hidden < CLOSEST)
    return bool(same_verdict[1:].all() and hidden[0] <= 0.01 * max(highest[0], 1.0))


def _hidden_peak(scores: Array) -> Array:
    """Return (3,) how high the scores may get between (M, 3) evenly spaced samples, twice as curved as they look."""
    bend = np.abs(np.diff(scores, n=2, axis=0))
    bend = 2.0 * np.maximum(np.vstack([bend[:1], bend]), np.vstack([bend, bend[-1:]])) + 1e-300
    rise = np.maximum(0.5 * bend - np.abs(np.diff(scores, axis=0)), 0.0) ** 2 / (2.0 * bend)
    return (np.maximum(scores[1:], scores[:-1]) + rise).max(axis=0)
