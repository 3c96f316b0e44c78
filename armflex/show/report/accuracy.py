"""How large the error is: on rows that no fit has seen, by session and by pose, beside the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.estimate.held_out import held_out, pose_folds
from armflex.measured.repeats import Scatter, repeats
from armflex.trace.findings import Trace


@dataclass(frozen=True, eq=False)
class Errors:
    """Squared 3-D errors (M,) [m^2], and the number of each row's pose: errors of one pose are not independent."""

    squares: Array
    groups: np.ndarray

    @property
    def rms(self) -> float:
        """RMS of the 3-D error [m], nan of no rows."""
        return float(np.sqrt(self.squares.mean())) if len(self.squares) else float("nan")

    @property
    def std(self) -> float:
        """Standard uncertainty of the RMS [m], poses taken as independent; nan of fewer than two poses."""
        poses = np.unique(self.groups, return_inverse=True)[1]
        if len(self.squares) < 2 or poses.max() < 1:
            return float("nan")
        sums = np.bincount(poses, self.squares - self.squares.mean())
        spread = np.sqrt((sums**2).sum() * len(sums) / (len(sums) - 1.0)) / len(self.squares)
        return float(spread / (2.0 * self.rms))

    def of(self, mask: np.ndarray) -> Errors:
        """Return the errors of some rows."""
        return Errors(self.squares[mask], self.groups[mask])


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Errors on poses that were held out, before and after, and what noise leaves.

    Attributes:
        before, after: Of the rows that every error is over.
        sessions: Session of each of those rows.
        poses: Pose of each of them.
        fitted: RMS of the same rows where they were fitted, before and after [m].
        stated: RMS of the stated noise in 3-D [m].
        again: Scatter of repeated readings, None where nothing was repeated.
    """

    before: Errors
    after: Errors
    sessions: tuple[str, ...]
    poses: tuple[str, ...]
    fitted: tuple[float, float]
    stated: float
    again: Scatter | None

    def by(self, names: Sequence[str]) -> list[tuple[str, Errors, Errors]]:
        """Return name, errors before and errors after for every name, in order of first appearance."""
        array = np.array(names)
        return [(name, self.before.of(array == name), self.after.of(array == name)) for name in dict.fromkeys(names)]


def accuracy(trace: Trace) -> Accuracy:
    """Return a trace's errors on held-out poses, row by row."""
    state, measurements = trace.state, trace.state.measurements
    folds, used, rows = pose_folds(state.groups), trace.judged_rows, trace.rows
    before, after = (
        Errors(held_out(fit, folds, judged=trace.state.judged).squares[used], state.groups[used])
        for fit in (trace.before, state.fit)
    )
    repeated = repeats(measurements)
    # Of those approached from the same side where there are enough.
    again = repeated and (repeated.same_approach if repeated.same_approach is not None else repeated.same_session)
    return Accuracy(
        before,
        after,
        tuple(measurements.session[row] for row in rows),
        tuple(measurements.pose[row] for row in rows),
        (trace.calibrated_rms, trace.rms),
        trace.noise_rms,
        again,
    )


def scatter_rms(scatter: Scatter) -> tuple[float, float]:
    """Return the 3-D noise that repeats show and its standard uncertainty [m]."""
    size = float(np.sqrt((scatter.sigma**2).sum()))
    return size, size * scatter.uncertainty / float(np.sqrt(3.0))
