"""Does a loaded arm keep its tolerance: at every via-point, and on the path between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.deflection import Deflection
from armflex.errors import ArmflexError, Flag, InputError
from armflex.trajectory import Trajectory

COVERAGE = 2.0
"""A margin inside this many standard uncertainties is neither ok nor fail."""

MAX_HALVINGS = 10
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Point:
    """One configuration held against the tolerance.

    Attributes:
        name: The via-point's name, '' on the path between.
        time: [s].
        displacement_m: Length of the tip's shift [m].
        rotation_rad: Angle of its rotation [rad].
        sigma_m: Standard uncertainty of `displacement_m`, None where no law carries one.
        margin_m: Tolerance minus displacement [m].
        margin_rad: Angle tolerance minus rotation, None where no angle is asked for.
        verdict: "ok", "fail" or "uncertain".
        cause: The flexure that contributes most, None for a rigid arm.
        payload: What is carried.
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

    @property
    def badness(self) -> tuple[int, float]:
        """Sorts worst first: verdict, then margin."""
        return (-["ok", "uncertain", "fail"].index(self.verdict), self.margin_m)


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
    """

    ok: bool
    tolerance_m: float
    angle_rad: float | None
    via_points: tuple[Point, ...]
    segments: tuple[Point, ...]
    path_worst: Point
    samples: int
    flags: tuple[Flag, ...]


def check(
    arm: Arm,
    trajectory: Trajectory,
    tolerance: float,
    angle: float | None = None,
    method: str = "newton",
    progress: Progress | None = None,
) -> CheckReport:
    """Hold the tip's displacement along a trajectory against a tolerance.

    Between rows the path is sampled, and the step halved until it changes neither verdict nor worst displacement by
    more than a hundredth of the tolerance (or a quarter of the margin).

    Args:
        arm: The arm.
        trajectory: Via-points and the rows between them.
        tolerance: Largest allowed displacement of the tip's origin [m].
        angle: Largest allowed rotation [rad], None to ask for none.
        method: See `Arm.deflection`.
        progress: Called with (rows done, rows in all).

    Raises:
        InputError: A tolerance is not positive, or a row cannot be used; the row and time are named.
    """
    if not tolerance > 0.0 or (angle is not None and not angle > 0.0):
        raise InputError(f"tolerance must be positive, got {tolerance} m and {angle} rad")
    judge = _Judge(arm, tolerance, angle, method)
    rows = [judge.row(trajectory, i) for i in range(len(trajectory))]
    segments = []
    for segment in range(len(trajectory) - 1):
        segments.append(_worst_between(judge, trajectory, segment))
        if progress:
            progress(segment + 1, len(trajectory) - 1)
    vias = sorted((row for row in rows if row.name), key=lambda point: point.badness)
    everything = [*rows, *segments]
    worst = min(everything, key=lambda point: point.badness)
    ok = all(point.verdict == "ok" for point in everything)
    flags = tuple(judge.flags.values())
    return CheckReport(ok, tolerance, angle, tuple(vias), tuple(segments), worst, judge.samples, flags)


class _Judge:
    """Evaluates points and collects what was met on the way."""

    def __init__(self, arm: Arm, tolerance: float, angle: float | None, method: str) -> None:
        self.arm, self.tolerance, self.angle, self.method = arm, tolerance, angle, method
        self.samples = 0
        self.flags: dict[str, Flag] = {}

    def row(self, trajectory: Trajectory, i: int) -> Point:
        """Return the verdict on one row; errors are raised again with the row and its time."""
        time, via = float(trajectory.time[i]), trajectory.via[i]
        motion = {key: None if x is None else x[i] for key, x in (("v", trajectory.v), ("a", trajectory.a))}
        try:
            found = self.arm.deflection(trajectory.q[i], trajectory.payload[i], method=self.method, **motion)
        except ArmflexError as error:
            where = f"row {i}" + (f" ({via})" if via else "") + f" at {time:g} s"
            error.args = (f"{where}: {error.args[0]}", *error.args[1:])
            raise
        self.samples += 1
        for flag in found.flags:
            self.flags.setdefault(flag.code, Flag(flag.code, f"at {time:g} s: {flag.text}"))
        return self.point(found, via, time, trajectory.payload[i])

    def point(self, found: Deflection, name: str, time: float, payload: str) -> Point:
        shift, turn = (float(np.linalg.norm(part)) for part in (found.displacement[:3], found.displacement[3:]))
        sigmas = [_sigma(found, part) for part in (slice(0, 3), slice(3, 6))]
        margin = self.tolerance - shift
        margin_rad = None if self.angle is None else self.angle - turn
        verdicts = [_verdict(margin, sigmas[0])]
        if margin_rad is not None:
            verdicts.append(_verdict(margin_rad, sigmas[1]))
        verdict = next(word for word in ("fail", "uncertain", "ok") if word in verdicts)
        return Point(name, time, shift, turn, sigmas[0], margin, margin_rad, verdict, blame(found), payload)


def _sigma(found: Deflection, part: slice) -> float | None:
    """Return the standard uncertainty of the length of a part of the displacement."""
    if found.covariance is None:
        return None
    vector = found.displacement[part]
    length = float(np.linalg.norm(vector))
    covariance = found.covariance[part, part]
    if length == 0.0:
        return float(np.sqrt(np.trace(covariance)))
    return float(np.sqrt(vector @ covariance @ vector)) / length


def _verdict(margin: float, sigma: float | None) -> str:
    doubt = COVERAGE * (sigma or 0.0)
    if abs(margin) < doubt:
        return "uncertain"
    return "ok" if margin >= 0.0 else "fail"


def blame(found: Deflection) -> str | None:
    """Return the flexure that moves the tip furthest along its displacement, None for a rigid arm."""
    if not found.names.flexures:
        return None
    along = found.contributions[:, :3] @ found.displacement[:3]
    return found.names.flexures[int(np.argmax(along))]


def _worst_between(judge: _Judge, trajectory: Trajectory, segment: int) -> Point:
    """Return the worst point between two rows, the ends (with this stretch's payload) included."""
    worst = _worst(judge, trajectory, segment, np.array([0.0, 0.5, 1.0]))
    for halving in range(1, MAX_HALVINGS + 1):
        steps = 2**halving
        finer = _worst(judge, trajectory, segment, np.arange(1, 2 * steps, 2) / (2 * steps))
        change = abs(min(worst.margin_m, finer.margin_m) - worst.margin_m)
        before, worst = worst, min(worst, finer, key=lambda point: point.badness)
        near = max(0.01 * judge.tolerance, 0.25 * abs(worst.margin_m))
        if worst.verdict == before.verdict and change <= near:
            return worst
    return worst


def _worst(judge: _Judge, trajectory: Trajectory, segment: int, fractions: Array) -> Point:
    points = trajectory.at(segment, fractions)
    return min((judge.row(points, i) for i in range(len(points))), key=lambda point: point.badness)
