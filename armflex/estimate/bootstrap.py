"""How much a calibration depends on the poses that happened to be measured: fitted again to poses drawn from them."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import FileError, InputError, Place, naming
from armflex.estimate.calibrate import FEWEST_ROWS, fitted_to, loads_seen
from armflex.laws.learned import Seen
from armflex.measured.data_flags import check_joint_units
from armflex.measured.measurements import Measurements, as_measurements
from armflex.measured.table import Tabular
from armflex.parallel import in_order
from armflex.parameters import ParameterKind
from armflex.progress import Progress
from armflex.result import Result
from armflex.storage.array_file import Layout
from armflex.storage.digest import digest
from armflex.storage.schema import Numbers
from armflex.storage.store import PieceForm, open_store
from armflex.version import __version__

Fitted = tuple[tuple[str, ...], Array]
"""Names of the parameters, and their (P,) values."""

FORM: PieceForm[Fitted] = PieceForm(
    Layout(
        "a fit of a bootstrap",
        "armflex-bootstrap-fit-2",
        {"values": Numbers(("parameters",))},
        {"names": tuple[str, ...]},
        lambda about: {"parameters": (len(about["names"]),)},
    ),
    lambda fit: ({"names": list(fit[0])}, {"values": fit[1]}),
    lambda about, arrays: (about["names"], arrays["values"]),
)
"""A finished fit as a file."""


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
    store: str | Path | None = None,
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
        store: Folder that keeps finished fits. With it an interrupted bootstrap goes on from where it was, and one of
            more draws from one of fewer.

    Raises:
        InputError: Fewer than two draws, or as `calibrate`.
        FileError: The store belongs to another bootstrap or cannot be used.
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
        partial(_fitted, arm, measurements, poses, seen, number, own)
        for number, own in enumerate(np.random.SeedSequence(seed).spawn(draws))
    ]
    kept = None
    if store is not None:  # named by everything that a fit depends on
        asked = {"format": "armflex-bootstrap-2", "arm": digest(arm), "measurements": digest(measurements)}
        versions = {"armflex": __version__, "numpy": np.__version__}
        kept = open_store(Path(store), {**asked, "seed": seed, **versions}, FORM)
    names = [f"fit-{i:07d}" for i in range(draws)]
    fits: list[Fitted] = []
    with closing(
        kept.resumed(names, partial(compress, tasks), jobs) if kept is not None else in_order(tasks, jobs)
    ) as found:
        for fit in found:
            if kept is not None and fit[0] != (fits or [fit])[0][0]:
                raise FileError(Place(kept.folder), "holds fits of different parameters: name another folder")
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
        found = fitted_to(arm, measurements, np.concatenate([poses[i] for i in chosen]), seen=seen)
    kept = [parameter for parameter in found.parameters if parameter.kind is not ParameterKind.INSTRUMENT]
    return tuple(parameter.name for parameter in kept), np.array([parameter.value for parameter in kept])
