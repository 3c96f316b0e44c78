"""The tip's pose for every row of a table, as the instrument would read it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from armflex.arm import Arm
from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import Flag, InputError, Place, naming
from armflex.estimate.spread import fitted_variance, without_declared_doubt
from armflex.estimate.view import untold_shifts
from armflex.laws.effects.remember import check_covariates, derived_directions, known_rows
from armflex.measured.measurements import Measurements
from armflex.measured.table import write_table
from armflex.mechanics.deflection import Deflection
from armflex.readings import Position, unread
from armflex.readings.instrument import Instrument
from armflex.setup import Setup
from armflex.trajectory import check_approaches

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Prediction:
    """Where the tip will be: in the instrument's frame where it is known, else in the base frame.

    Attributes:
        rows: What was asked.
        position: (N, 3) the target as it would be read [m].
        rotation: (N, 3) rotation vector of the target's orientation, as it would be read [rad]; the tip's own where
            no orientations were calibrated.
        sigma: (N, 3) standard uncertainty of the position from the laws and from fitted parameters [m], None where
            neither has one; what the instrument's noise adds is not in it. Infinite, and flagged, where it depends on
            what neither a campaign nor a prior determined.
        displacement: (N, 6) flexed minus rigid, base axes [m, rad].
        flags: Doubts, each with the first row it concerns; those about a law with the worst, and how many there are.
    """

    rows: Measurements
    position: Array
    rotation: Array
    sigma: Array | None
    displacement: Array
    flags: tuple[Flag, ...]


def predict(
    arm: Arm, rows: Measurements, progress: Progress | None = None, covariates: Mapping[str, float] | None = None
) -> Prediction:
    """Return the tip's pose and displacement for every row.

    Args:
        arm: The arm; when calibrated, its instrument and session frames are used.
        rows: Joint positions, payloads and sessions; see `read_measurements` with `inputs_only`.
        progress: Called with (rows done, rows in all).
        covariates: What the arm's effects depend on and no column gives, the same in every row.

    Raises:
        InputError: A covariate is a column already, or one that no effect depends on.
        MissingCovariateError: An effect depends on what the rows do not give: a column, a time, the direction that a
            joint came from where no row before tells, unless it was found in such rows (`Effect.derived`): then the
            joint is taken as halfway, and `sigma` holds that it came from either side.
        ArmflexError: A row cannot be computed; its file and line are named.
    """
    rows = _with_constants(arm, rows, covariates or {})
    found: list[Deflection] = []
    derived = derived_directions(arm, rows, np.arange(len(rows)))
    with naming(Place(rows.places[0].file, 1) if rows.places else "rows"):
        known = known_rows(arm, rows)
    certain = without_declared_doubt(arm)
    for i, q in enumerate(rows.q):
        with naming(rows.places[i]):
            given = {name: values[i] for name, values in known.items()}
            found.append(certain.deflection(q, rows.payload[i], covariates=given))
        if progress:
            progress(i + 1, len(rows))
    instrument = arm.instrument or Instrument()
    tip = np.array([one.pose.homogeneous for one in found])
    fitted, doubts = fitted_variance(arm, rows)
    untold = (untold_shifts(Setup(arm, instrument), rows, unread(len(rows), Position)) ** 2).sum(axis=0)
    return Prediction(
        rows,
        instrument.readings(tip, rows.session),
        np.array([pin.log3(rotation) for rotation in instrument.rotations(tip, rows.session)]),
        _sigma(found, instrument, fitted, untold),
        np.array([one.displacement for one in found]),
        (*derived, *_flags(arm, rows, found), *doubts),
    )


def _with_constants(arm: Arm, rows: Measurements, constants: Mapping[str, float]) -> Measurements:
    """Return the rows with further columns that are the same in each; raise as `Trajectory.with_constants` does."""
    if not constants:
        return rows
    check_approaches(constants, arm.joint_names)
    given = rows.known.keys() - set(rows.derived)
    for name in constants:
        if name in given:
            raise InputError(f"covariate {name!r} is a column of the rows already")
    check_covariates(arm, constants)
    columns = {name: np.full(len(rows), float(value)) for name, value in constants.items()}
    own = {"time": columns.pop("time", rows.time), "hold": columns.pop("hold", rows.hold)}
    approach = [columns.pop(f"approach_{joint}", rows.approach[:, i]) for i, joint in enumerate(rows.joint_names)]
    derived = tuple(name for name in rows.derived if name not in constants)
    known = {**rows.covariates, **columns}
    return replace(rows, **own, approach=np.column_stack(approach), covariates=known, derived=derived)


def _sigma(found: list[Deflection], instrument: Instrument, fitted: Array | None, untold: Array) -> Array | None:
    """Return (N, 3) standard uncertainties of the target's position: the laws' own, of what was fitted, and `untold`.

    None where neither a law nor a fit has one: what directions leave open would be taken for all of it.
    """
    if fitted is None and all(one.covariance is None for one in found):
        return None
    rows = []
    for one in found:
        lever = pin.skew(one.pose.rotation @ instrument.target)
        seen = instrument.pose.rotation @ np.hstack([np.eye(3), -lever])
        covariance = np.zeros((6, 6)) if one.covariance is None else one.covariance
        rows.append(np.diag(seen @ covariance @ seen.T))
    return np.sqrt(np.array(rows) + (0.0 if fitted is None else fitted) + untold)


def _flags(arm: Arm, rows: Measurements, found: list[Deflection]) -> tuple[Flag, ...]:
    flags: dict[str, Flag] = {}
    if arm.instrument is None and arm.measurement.frame == "unknown":
        text = f"the instrument's place is not known, so positions are in the base frame {arm.robot.base!r}"
        flags["base_frame"] = Flag("base_frame", text)
    strange = set(rows.session) - set(arm.instrument.sessions) if arm.instrument and arm.instrument.sessions else set()
    if strange:
        text = f"{', '.join(sorted(strange))}: not among the calibrated sessions, so taken without a shift of their own"
        flags["new_session"] = Flag("new_session", text)
    met = [(number, flag) for number, one in enumerate(found) for flag in one.flags]
    for number, flag in met:
        if not flag.about:
            said = flag if flag in arm.flags else Flag(flag.code, f"row {number}: {flag.text}")
            flags.setdefault(flag.code, said)
    return (*flags.values(), *_worst([(number, flag) for number, flag in met if flag.about]))


def _worst(met: list[tuple[int, Flag]]) -> Iterator[Flag]:
    """Yield one doubt for each kind and law, in the worst of its rows."""
    for code, about in dict.fromkeys((flag.code, flag.about) for _, flag in met):
        own = [pair for pair in met if (pair[1].code, pair[1].about) == (code, about)]
        rows, (number, flag) = len({number for number, _ in own}), max(own, key=lambda pair: pair[1].size)
        more = f" (the worst of {rows} rows)" if rows > 1 else ""
        yield replace(flag, text=f"row {number}: {flag.text}{more}")


def write_predictions(prediction: Prediction, path: str | Path) -> Path:
    """Write x y z, sigma_*, the orientation pose_r*, and the displacement dx to rz; whole or not at all."""
    rows, sigma = prediction.rows, prediction.sigma
    columns: dict[str, list] = {"pose": list(rows.pose), "session": list(rows.session)}
    columns |= {"time": rows.time.tolist(), "payload": list(rows.payload)}
    columns |= {axis: prediction.position[:, i].tolist() for i, axis in enumerate("xyz")}
    columns |= {f"pose_r{axis}": prediction.rotation[:, i].tolist() for i, axis in enumerate("xyz")}
    blank = [""] * len(rows)
    columns |= {f"sigma_{axis}": blank if sigma is None else sigma[:, i].tolist() for i, axis in enumerate("xyz")}
    columns |= {name: prediction.displacement[:, i].tolist() for i, name in enumerate(TWIST_NAMES)}
    return write_table(path, columns)
