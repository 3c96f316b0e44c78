"""One machine over several calibrations: what changed, when, and whether at once or little by little.

Each parameter has a value and an uncertainty at every date. It stays, drifts (a straight line over the dates) or jumps
once (one value before, another after). A change counts where it lowers the sum of squares by more than chance does in
one of a thousand histories, counting all parameters and all moments at which one may jump (Bonferroni). Where drift and
jump are as likely but for `DOUBT`, both are named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import InputError
from armflex.estimate.fleet import said
from armflex.estimate.robust import BY_CHANCE, chi_squared, outlier_limit
from armflex.parameters import DOUBT, ArmParameter


@dataclass(frozen=True, eq=False)
class Course:
    """One parameter over the dates.

    Attributes:
        parameter: Which it is.
        value, std: (N,) at each date, in its unit.
        change: "", "jump", "drift", or "jump or drift".
        since: Number of the first date after a jump; 0 where there is none.
        size: Height of the jump, or drift from the first date to the last, in its unit.
        size_std: Its standard uncertainty.
    """

    parameter: ArmParameter
    value: Array
    std: Array
    change: str = ""
    since: int = 0
    size: float = 0.0
    size_std: float = 0.0


@dataclass(frozen=True, eq=False)
class History:
    """A machine over several calibrations.

    Attributes:
        names: Of the calibrations, in order of their dates.
        dates: (N,) in any unit.
        courses: Every parameter that the campaigns determine, those that changed first.
    """

    names: tuple[str, ...]
    dates: Array
    courses: tuple[Course, ...]

    @property
    def changed(self) -> tuple[Course, ...]:
        """Parameters that changed."""
        return tuple(one for one in self.courses if one.change)

    def between(self, i: int, j: int) -> list[tuple[Course, float, float]]:
        """Return what differs between two dates by more than chance makes of one: by how much, and its std."""
        found = [(one, one.value[j] - one.value[i], float(np.hypot(one.std[i], one.std[j]))) for one in self.courses]
        return [(one, float(step), std) for one, step, std in found if abs(step) > outlier_limit(1) * std]


def history(arms: Mapping[str, Arm], dates: Sequence[float]) -> History:
    """Return how the parameters of one machine went over its calibrations.

    Args:
        arms: The calibrated arms by name, declared alike, each fitted to a campaign of its own.
        dates: Of each, ascending.

    Raises:
        InputError: Fewer than two arms; dates that do not ascend; as `fleet.said`.
    """
    time = np.array(dates, dtype=float)
    if len(arms) < 2:
        raise InputError(f"expected two calibrations or more to compare, got {len(arms)}")
    if len(time) != len(arms) or not (np.diff(time) > 0.0).all():
        raise InputError(f"expected dates that ascend, one for each of {len(arms)} calibrations, got {list(dates)}")
    parameters, scale, sisters, _ = said(arms)
    covariances = [np.linalg.inv(one.information + np.eye(len(scale))) for one in sisters]
    values = np.array([known @ one.pull for known, one in zip(covariances, sisters, strict=True)]) * scale
    stds = np.sqrt([np.diag(known) for known in covariances]) * scale
    tried = len(parameters) * len(time)
    courses = [_course(one, values[:, i], stds[:, i], time, tried) for i, one in enumerate(parameters)]
    courses.sort(key=lambda one: -abs(one.size) / one.size_std if one.change else 0.0)
    return History(tuple(arms), time, tuple(courses))


def _course(parameter: ArmParameter, value: Array, std: Array, time: Array, tried: int) -> Course:
    count = len(time)
    stays, _, _ = _fit(np.ones((count, 1)), value, std)
    later = [np.column_stack([np.ones(count), (np.arange(count) >= at).astype(np.float64)]) for at in range(1, count)]
    jumps = [_fit(columns, value, std) for columns in later]
    best = int(np.argmin([one[0] for one in jumps]))
    over = (time - time[0]) / (time[-1] - time[0])
    drift = _fit(np.column_stack([np.ones(count), over]), value, std)
    limit = chi_squared(1, BY_CHANCE / tried)
    if stays - min(jumps[best][0], drift[0]) < limit:
        return Course(parameter, value, std)
    kind, found = ("jump", jumps[best]) if jumps[best][0] <= drift[0] else ("drift", drift)
    if count > 2 and abs(jumps[best][0] - drift[0]) < -2.0 * np.log(DOUBT):
        kind = "jump or drift"
    since = 0 if kind == "drift" else best + 1
    return Course(parameter, value, std, kind, since, float(found[1][1]), float(found[2][1]))


def _fit(columns: Array, value: Array, std: Array) -> tuple[float, Array, Array]:
    """Return the weighted sum of squares that is left, the coefficients and their standard uncertainties."""
    scaled, known = columns / std[:, None], value / std
    covariance = np.linalg.inv(scaled.T @ scaled)
    found = covariance @ (scaled.T @ known)
    return float(((known - scaled @ found) ** 2).sum()), found, np.sqrt(np.diag(covariance))
