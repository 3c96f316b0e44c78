"""How much a calibration depends on the poses that happened to be measured: fitted again to poses drawn from them."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import InputError, naming
from armflex.estimate.calibrate import FEWEST_ROWS, fitted_to, loads_seen
from armflex.laws.learned import Seen
from armflex.measured.data_flags import check_joint_units
from armflex.measured.measurements import Measurements, as_measurements
from armflex.measured.table import Tabular
from armflex.parallel import in_order
from armflex.parameters import ParameterKind
from armflex.progress import Progress
from armflex.result import Result

Fitted = tuple[tuple[str, ...], Array]
"""Names of the parameters, and their (P,) values."""


@dataclass(frozen=True, repr=False, eq=False)
class Bootstrap(Result):
    """Fits to resampled campaigns.

    Attributes:
        names: Block and label of each parameter, those of the instrument's frame left out: it has no value that
            campaigns share.
        values: (n, P) what each of n fits found, in the parameters' units.
    """

    FIELDS = ("names", "std")
    ROWS = "table"

    names: tuple[str, ...]
    values: Array

    @property
    def table(self) -> dict[str, Any]:
        """Name and standard deviation of every parameter, by column."""
        return {"name": self.names, "std": self.std}

    @property
    def std(self) -> Array:
        """(P,) standard deviation over the fits, in the units; what only its prior determines hardly moves."""
        return self.values.std(axis=0, ddof=1)

    def interval(self, coverage: float = 0.95) -> Array:
        """Return the (2, P) percentile interval of every parameter, in its unit.

        Raises:
            InputError: The coverage is not between 0 and 1.
        """
        if not 0.0 < coverage < 1.0:
            raise InputError(f"coverage is {coverage}, expected a number between 0 and 1")
        return np.quantile(self.values, [0.5 - 0.5 * coverage, 0.5 + 0.5 * coverage], axis=0)


@checked_kinds
def bootstrap(
    arm: Arm,
    measurements: Measurements | Tabular,
    draws: int = 200,
    seed: int = 0,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> Bootstrap:
    """Calibrate an arm to campaigns whose poses are drawn, with replacement, from those of one.

    The spread of the fits asks nothing of the stated noise, nor of rows of one pose being independent of each other;
    the fit's own covariance does. Where the two differ, the statement is wrong. Efron (1979), Bootstrap methods.

    Args:
        arm: The arm as declared; see `calibrate`.
        measurements: Where the tip was seen.
        draws: Number of campaigns.
        seed: The same seed gives the same campaigns, whatever the number of processes.
        jobs: Processes, -1 for all cores; None for what `joblib.parallel_config` says, else one.
        progress: Called with (fits done, in all).

    Raises:
        InputError: Fewer than two draws, or as `calibrate`.
        ConvergenceError: A fit did not settle; its number is named.
    """
    measurements = as_measurements(measurements, arm)
    check_joint_units(measurements.q, arm, measurements.places, units=measurements.units)
    if draws < 2:
        raise InputError(f"{draws} draws: expected 2 or more")
    used = np.flatnonzero(measurements.measured)
    if len(used) < FEWEST_ROWS:
        raise InputError(f"{len(used)} measured rows, expected {FEWEST_ROWS} or more")
    groups = measurements.pose_number[used]
    poses = [used[groups == group] for group in np.unique(groups)]
    seen = loads_seen(arm, measurements)  # what a draw leaves out was seen all the same
    tasks = [
        partial(_fitted, arm, measurements, poses, seen, number, sequence)
        for number, sequence in enumerate(np.random.SeedSequence(seed).spawn(draws))
    ]
    fits: list[Fitted] = []
    with closing(in_order(tasks, jobs)) as fitted:
        for fit in fitted:
            fits.append(fit)
            if progress:
                progress(len(fits), draws)
    return Bootstrap(fits[0][0], np.array([values for _, values in fits]))


def _fitted(
    arm: Arm,
    measurements: Measurements,
    poses: list[np.ndarray],
    seen: dict[str, Seen],
    number: int,
    seed: np.random.SeedSequence,
) -> Fitted:
    """Return the names and values of what a fit to one resampled campaign found."""
    chosen = np.random.default_rng(seed).integers(len(poses), size=len(poses))
    with naming(f"resampled campaign {number}"):
        resampled = fitted_to(arm, measurements, np.concatenate([poses[i] for i in chosen]), seen=seen)
    kept = [parameter for parameter in resampled.parameters if parameter.kind is not ParameterKind.INSTRUMENT]
    return tuple(parameter.name for parameter in kept), np.array([parameter.value for parameter in kept])
