"""What would be read in every row of a table: the target's pose of a calibrated arm, the tip's of any other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm, Setup, other_unit
from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import ArmflexError, Flag, InputError, Place, enough_memory, naming, worst_of
from armflex.estimate.posterior import fitted_variance, without_declared_uncertainty
from armflex.estimate.view import gravity_in, look, unclear_shifts
from armflex.laws.effects.effect import Act
from armflex.laws.effects.in_arm import (
    OF_TIME,
    about_time,
    check_approaches,
    check_covariates,
    derived_direction,
    derived_directions,
    directions,
    remembers,
)
from armflex.measured.campaign_clock import runs_by_clock
from armflex.measured.forces import UNLOADED, Unnamed, read_force_table
from armflex.measured.measurements import Measurements, as_measurements, read_measurements, stream_inputs
from armflex.measured.table import Tabular, writing_table
from armflex.mechanics.deflection import DeflectionBatch
from armflex.mechanics.history import known_rows
from armflex.parallel import in_threads
from armflex.readings import Kind, Orientation, Position, Postures, Readings
from armflex.readings.instrument import Instrument
from armflex.result import Result
from armflex.rows.rows import LEVEL_OF, TIME, numbered
from armflex.rows.wrench import wrenches_in
from armflex.trajectory import Trajectory

TOGETHER = 2048
"""Rows that are predicted together, and of a file are in memory at a time: each takes some ten kilobytes."""

Progress = Callable[[int, int | None], None]


@dataclass(frozen=True, repr=False)
class Prediction(Result):
    """What will be read: the target in the instrument's frame where the arm is calibrated, else the tip in the base's.

    Attributes:
        rows: What was asked.
        position: (N, 3) the target as it would be read [m].
        rotation: (N, 3) rotation vector of the target's orientation, as it would be read [rad]; the tip's own where
            no orientations were calibrated.
        sensors: What every other instrument of the arm would read, each with its (N, d) standard uncertainty in its own
            unit; None as `sigma`.
        sigma: (N, 3) standard uncertainty of the position from the laws and from fitted parameters [m], None where
            neither has one; what the instrument's noise adds is not in it. Infinite, and flagged, where it depends on
            what neither a campaign nor a prior determined.
        displacement: (N, 6) of the tip, flexed minus rigid, base axes [m, rad].
        flags: Flags, each with the first row it concerns; those about a law with the worst, and how many there are.
        outside: For every row flags about what is beyond the range in which a law or an effect was found, with that
            range; empty where the arm has nothing that was found in one.
    """

    FIELDS = ("position", "rotation", "sigma", "displacement", "flags")
    ROWS = "table"

    rows: Measurements
    position: Array
    rotation: Array
    sigma: Array | None
    displacement: Array
    flags: tuple[Flag, ...]
    sensors: tuple[tuple[Kind, Array | None], ...] = ()
    outside: tuple[tuple[Flag, ...], ...] = ()

    @property
    def table(self) -> dict[str, Array]:
        """The (N,) columns that `armflex predict` writes of every row, by name [m, rad]."""
        columns = dict(zip("xyz", self.position.T, strict=True))
        columns |= {} if self.sigma is None else dict(zip(("sigma_x", "sigma_y", "sigma_z"), self.sigma.T, strict=True))
        columns |= dict(zip(("pose_rx", "pose_ry", "pose_rz"), self.rotation.T, strict=True))
        return columns | dict(zip(TWIST_NAMES, self.displacement.T, strict=True))


@checked_kinds
def predict(
    arm: Arm,
    rows: Measurements | Tabular,
    progress: Progress | None = None,
    covariates: Mapping[str, float] | None = None,
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
            joint came from where no row before says so, unless it was found in such rows (`Effect.derived`): then the
            joint is taken as halfway, and `sigma` holds that it came from either side.
        ArmflexError: A row cannot be computed; its file and line are named.
    """
    rows = as_measurements(rows, arm, inputs_only=True)
    met, predictions = _Flags(arm), []
    named = replace(rows, sha256=rows.clock[0].sha256) if rows.clock and not rows.periods else rows  # as its parts are
    pieces, run = [named], _Runs(arm, covariates or {})
    if not remembers(arm):
        levelled, cuts = named.levelled(), range(TOGETHER, len(rows), TOGETHER)
        pieces = (levelled.some(piece_rows) for piece_rows in np.split(np.arange(len(rows)), cuts))
    for piece in (piece for every in pieces for piece in run.of(every)):
        prediction, batch, fitted = run.predicted(piece)
        met.add(prediction, batch, fitted)
        predictions.append(prediction)
        if progress:
            progress(met.rows, len(rows))
    parts = ([getattr(answer, name) for answer in predictions] for name in ("position", "rotation", "displacement"))
    position, rotation, displacement = (np.concatenate(part) for part in parts)
    stds = [prediction.sigma for prediction in predictions if prediction.sigma is not None]  # of all pieces, or of none
    sigma = np.concatenate(stds) if stds else None
    sensors = []
    for number in range(len(predictions[0].sensors)):
        of_sensor = [prediction.sensors[number] for prediction in predictions]
        kind, values = of_sensor[0][0], np.concatenate([reading.values for reading, _ in of_sensor])
        stds = [std for _, std in of_sensor if std is not None]
        std = np.concatenate(stds) if stds else None
        noise = np.concatenate([reading.sigma for reading, _ in of_sensor])
        sensors.append((replace(kind, values=values, sigma=noise), std))
    asked = _with_constants(arm, rows, covariates or {})
    outside = tuple(flags for prediction in predictions for flags in prediction.outside)
    return Prediction(asked, position, rotation, sigma, displacement, met.flags, tuple(sensors), outside)


def predict_file(
    arm: Arm,
    path: str | Path,
    output: str | Path,
    progress: Progress | None = None,
    covariates: Mapping[str, float] | None = None,
    unnamed: Unnamed = UNLOADED,
    table_path: str | Path | None = None,
) -> tuple[int, tuple[Flag, ...]]:
    """Write what `predict` says of the rows of a table, some thousand of them in memory at a time.

    Many are predicted in as many threads as this process may use cores: most of their time is compiled code. What an
    arm's effects remember depends on all the rows before: for an arm that has such, and where a load depends on how far
    along the path a row is, all are held in memory.

    Args:
        arm, progress, covariates: As of `predict`.
        path: The rows; see `stream_inputs`.
        output: Written whole or not at all: the rows' `via`, x y z, sigma_*, the orientation pose_r*, the displacement
            dx to rz, and of an arm with trained laws or traced effects `outside`, what of a row is beyond what they
            were found in.
        unnamed: What loads rows that name no payload, or no force.
        table_path: Loads by the length of path [m] that the rigid tip has gone from row to row; see `read_force_table`.

    Returns:
        The number of rows, and flags.

    Raises:
        TableError: As `read_measurements`.
        OutOfMemoryError: Where memory runs out; the rows are named.
        ArmflexError: As `predict`.
    """
    met, run = _Flags(arm), _Runs(arm, covariates or {})
    about: tuple[Flag, ...] = ()
    if table_path is None and not remembers(arm):
        pieces = stream_inputs(path, arm, TOGETHER, unnamed)
    else:
        rows = read_measurements(path, arm, inputs_only=True, unnamed=unnamed)
        if table_path is not None:
            steps, blank = np.arange(len(rows), dtype=float), ("",) * len(rows)
            moved = Trajectory(rows.joint_names, steps, rows.q, rows.payload, blank, wrenches=rows.wrenches)
            moved, about = moved.under(read_force_table(table_path, arm), arm)
            rows = replace(rows, wrenches=moved.wrenches).levelled()
        cuts = [] if remembers(arm) else range(TOGETHER, len(rows), TOGETHER)
        pieces = (rows.some(piece_rows) for piece_rows in np.split(np.arange(len(rows)), cuts))

    answers = in_threads(run.predicted, (piece for every in pieces for piece in run.of(every)))
    with writing_table(output) as write, closing(answers):
        while True:
            with enough_memory(f"rows from {met.rows} on"):
                answer = next(answers, None)
                if answer is None:
                    return met.rows, (*about, *met.flags)
                prediction, batch, fitted = answer
                met.add(prediction, batch, fitted)
                write(_columns(prediction))
            if progress:
                progress(met.rows, None)


Piece = tuple[float | None, float, Measurements]
"""Rows in which the arm is the same, and on which clock they are; see `runs_by_clock`."""


class _Runs:
    """Rows in pieces in which the arm is the same, and what is predicted of them."""

    def __init__(self, arm: Arm, constants: Mapping[str, float]) -> None:
        self._arm, self._constants = arm, constants
        self._arms: dict[tuple[float | None, float], tuple[Arm, Arm]] = {}

    def of(self, rows: Measurements) -> Iterator[Piece]:
        """Yield the pieces in the order of the rows."""
        rows = _with_constants(self._arm, rows, self._constants)
        for part in _in_one_base(self._arm, rows):
            yield from runs_by_clock(self._arm, part)

    def predicted(self, piece: Piece) -> tuple[Prediction, DeflectionBatch, tuple[Flag, ...]]:
        """Return what `_predicted` does of a piece, and what is to be said of its clock."""
        after, later, rows = piece
        if (after, later) not in self._arms:
            arm = self._arm.on_clock(later) if after is None else self._arm.left(after)
            self._arms[after, later] = arm, without_declared_uncertainty(arm)
        arm, certain = self._arms[after, later]
        recorded = rows.known.keys() - set(rows.derived)
        dated = all(clock and clock[0].begins for clock in (rows.clock, arm.clock))
        flags = about_time(arm, recorded, rows.time if TIME in recorded else None, dated)
        prediction, batch, fitted = _predicted(arm, certain, rows)
        return prediction, batch, (*fitted, *flags)


def _in_one_base(arm: Arm, rows: Measurements) -> Iterator[Measurements]:
    """Yield rows in their order as far as their sessions are of one campaign, between which the base was moved."""
    if arm.instrument is None or gravity_in(Setup(arm, arm.instrument), rows.session) is None:
        yield rows
        return
    campaigns = numbered(map(arm.instrument.campaign, rows.session))
    for in_campaign in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(campaigns)) + 1):
        yield rows.some(in_campaign)


def _predicted(arm: Arm, certain: Arm, rows: Measurements) -> tuple[Prediction, DeflectionBatch, tuple[Flag, ...]]:
    """Return what is predicted of some rows, how the arm stands in them, and flags about what was fitted.

    `certain` is the arm `without_declared_uncertainty`; the rows are `_in_one_base`.
    """
    every = np.arange(len(rows))
    derived_directions(arm, rows, every)  # raises where one is needed that is not known
    instrument = arm.instrument or Instrument()
    gravity = gravity_in(Setup(arm, instrument), rows.session)
    with naming(Place(rows.places[0].file, 1) if rows.places else "rows"):
        columns = known_rows(arm, rows, gravity)
    if gravity is not None:
        certain = replace(certain, robot=replace(certain.robot, gravity=gravity[0]))
    # Rows may be those of a campaign: what stood beyond a limit stood there, unless it is rather in another unit.
    beyond = np.argwhere((rows.q < arm.robot.lower) | (rows.q > arm.robot.upper)).tolist()
    asked: dict[str, Any] = {
        "enforce_limits": any(other_unit(arm.robot.moving[j], float(rows.q[i, j])) for i, j in beyond)
    }
    deflection = _deflected(certain, rows, columns, asked)
    # The tip's position comes first; see `Readings`.
    read = [sensor for sensor in arm.sensors.values() if sensor.foreseen]
    wanted = [Position.unread(len(rows)), *(sensor.unread(len(rows)) for sensor in read)]
    readings = Readings(len(rows), tuple(wanted))
    tip = readings.foremost
    fitted, about = fitted_variance(arm, rows, readings)
    unclear = (unclear_shifts(Setup(arm, instrument), rows, readings) ** 2).sum(axis=0)
    # What directions leave open is stated beside what a law or a fit has: alone it would be read as all of it.
    variance = None if fitted is None and deflection.covariance is None else unclear
    if variance is not None and fitted is not None:
        variance = fitted + variance
    at, sensors = Postures(lambda _: deflection.pose, rows.session, instrument), []
    if variance is not None and deflection.covariance is not None:
        seen = wanted[0].jacobian(at)[None]
        variance[:, tip] += np.einsum("nij,njk,nik->ni", seen, deflection.covariance, seen, optimize=True)
    bent = any(effect.law.act is Act.SIGHT for effect in arm.effects)
    view = look(Setup(arm, instrument), rows, every, readings=readings) if read or bent else None
    at = view.at if view is not None and bent else at
    position, rotation = (kind.predicted(at) for kind in (wanted[0], Orientation.unread(len(rows))))
    if view is not None and read:
        for i, law in enumerate(certain.stack.laws if variance is not None else ()):
            part = law.covariance(deflection.wrenches[:, i], view.line.row)
            if part is not None and variance is not None:
                seen = view.answer(lambda line, i=i: line.laws[:, :, i])[:, tip.stop :]
                variance[:, tip.stop :] += ((seen @ part) * seen).sum(axis=2)
        for kind, place in view.readings.placed[1:]:
            predicted_kind = replace(kind, values=kind.predicted(view.at))
            sensors.append((predicted_kind, None if variance is None else np.sqrt(variance[:, place])))
    sigma = None if variance is None else np.sqrt(variance[:, tip])
    ranged = arm.stack.trained or any(effect.ranges for effect in arm.effects)
    unseen = dict(deflection.unseen()) if ranged else {}
    outside = tuple(unseen.get(i, ()) for i in every.tolist()) if ranged else ()
    prediction = Prediction(rows, position, rotation, sigma, deflection.displacement, (), tuple(sensors), outside)
    return prediction, deflection, about


def _deflected(arm: Arm, rows: Measurements, columns: Mapping[str, Array], asked: Mapping[str, Any]) -> DeflectionBatch:
    """Return how an arm stands in rows; an error names the first of them that it is of."""
    try:
        return arm.deflection(rows.q, rows.payload, covariates=columns, wrenches=rows.wrenches, **asked)
    except ArmflexError:
        for i, place in enumerate(rows.places):
            with naming(place):
                given = {name: values[i] for name, values in columns.items()}
                pulled = wrenches_in(rows.wrenches, i)
                arm.deflection(rows.q[i], rows.payload[i], covariates=given, wrenches=pulled, **asked)
        raise


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
    times = {"time": columns.pop("time", rows.time), "hold": columns.pop("hold", rows.hold)}
    approach = [columns.pop(f"approach_{joint}", rows.approach[:, i]) for i, joint in enumerate(rows.joint_names)]
    derived = tuple(name for name in rows.derived if name not in constants)
    recorded = {**rows.covariates, **columns}
    return replace(rows, **times, approach=np.column_stack(approach), covariates=recorded, derived=derived)


class _Flags:
    """The flags about so many rows that come in pieces: each with the worst row it concerns, and how many there are."""

    def __init__(self, arm: Arm) -> None:
        self._arm, self.rows = arm, 0
        self._beyond = 0
        self._unclear: dict[str, int] = {}
        self._sessions: set[str] = set()
        self._met: dict[tuple[str, str], Flag] = {}
        self._payloads = Counter[str]()
        self._worst: dict[tuple[str, str], tuple[int, int, Flag]] = {}
        self._fitted: dict[Flag, None] = {}
        self._timed: dict[str, Flag] = {}

    def add(self, predicted: Prediction, deflection: DeflectionBatch, fitted: tuple[Flag, ...]) -> None:
        """Add what is doubtful about the next rows."""
        arm, rows = self._arm, predicted.rows
        unclear = {name: int(unknown.sum()) for name, _, unknown in directions(arm.effects, rows)}
        self._unclear |= {name: self._unclear.get(name, 0) + count for name, count in unclear.items()}
        frames = {*arm.instrument.sessions, *arm.instrument.targets} if arm.instrument else ()
        if frames:
            self._sessions |= set(rows.session) - set(frames)
        self._payloads.update(rows.payload)
        for number, flag in sorted(deflection.flags_by_row, key=lambda pair: pair[0]):
            limited = flag.code == "outside_limits"
            self._beyond += limited
            at = rows.places[number] if limited and rows.places else f"row {self.rows + number}"
            said = flag if flag in arm.flags else replace(flag, text=f"{at}: {flag.text}")
            self._met = worst_of([*self._met.values(), said])
        for number, flags in enumerate(predicted.outside):
            for key in dict.fromkeys(flag.kind for flag in flags):
                largest = max((flag for flag in flags if flag.kind == key), key=lambda flag: flag.size)
                count, row, worst = self._worst.get(key, (0, self.rows + number, largest))
                row, worst = (self.rows + number, largest) if largest.size > worst.size else (row, worst)
                self._worst[key] = (count + 1, row, worst)
        for flag in fitted:  # of what is not the same in all pieces the most
            if flag.code not in OF_TIME:
                self._fitted[flag] = None
            elif len(flag.text) > len(self._timed[flag.code].text if flag.code in self._timed else ""):
                self._timed[flag.code] = flag
        self.rows += len(rows)

    @property
    def flags(self) -> tuple[Flag, ...]:
        """What is to be said."""
        arm, about = self._arm, list[Flag]()
        if arm.instrument is None and arm.measurement.frame == "unknown":
            text = f"the instrument's place is not known, so positions are in the base frame {arm.robot.base!r}"
            about.append(Flag("base_frame", text))
        if self._sessions:
            names = ", ".join(sorted(name or "rows without a session" for name in self._sessions))
            text = f"{names}: not among the calibrated sessions, so taken without a shift of their own"
            about.append(Flag("new_session", text))
        derived = [derived_direction(name, unclear) for name, unclear in self._unclear.items()]
        counts = {("new_payload", name): f"{count} rows in all" for name, count in self._payloads.items() if count > 1}
        if self._beyond > 1:
            counts["outside_limits", ""] = f"the worst of {self._beyond} rows"
        met = [
            replace(flag, text=f"{flag.text} ({counts[kind]})") if kind in counts else flag
            for kind, flag in self._met.items()
        ]
        worst = []
        for rows, number, flag in self._worst.values():
            more = f" (the worst of {rows} rows, {rows / self.rows:.0%} of all)" if rows > 1 else ""
            worst.append(replace(flag, text=f"row {number}: {flag.text}{more}"))
        return (*derived, *met, *about, *worst, *self._fitted, *self._timed.values())


def _via(rows: Measurements) -> dict[str, list]:
    """Return the column of names of via-points where the rows have one, which may be split by its levels."""
    if (given := rows.covariates.get("via")) is not None:
        return {"via": [name if isinstance(name, str) else "" if np.isnan(name) else f"{name:g}" for name in given]}
    begins = f"via{LEVEL_OF}"
    levels = {name.removeprefix(begins): rows.covariates[name] for name in rows.covariates if name.startswith(begins)}
    names = [next((name for name, there in levels.items() if there[i]), "") for i in range(len(rows))]
    return {"via": names} if levels else {}


def _columns(prediction: Prediction) -> dict[str, list]:
    """Return the columns of a table of predictions."""
    rows = prediction.rows

    def named(names: Sequence[str], values: Array | None) -> dict[str, list]:
        """Return (N, k) values by column, blank where there are none."""
        columns = [[""] * len(rows)] * len(names) if values is None else values.T.tolist()
        return dict(zip(names, columns, strict=True))

    columns: dict[str, list] = {"pose": list(rows.pose), "session": list(rows.session)}
    columns |= {"time": rows.time.tolist(), "payload": list(rows.payload)} | _via(rows)
    columns |= named("xyz", prediction.position) | named(["pose_rx", "pose_ry", "pose_rz"], prediction.rotation)
    columns |= named(["sigma_x", "sigma_y", "sigma_z"], prediction.sigma)
    for kind, std in prediction.sensors:
        names = kind.headers
        columns |= named(names, kind.values) | named([f"sigma_{name}" for name in names], std)
    columns |= named(TWIST_NAMES, prediction.displacement)
    outside = ["; ".join(flag.text for flag in flags) for flags in prediction.outside]
    return columns | ({"outside": outside} if outside else {})
