"""A campaign: where the tip was measured, over configurations, payloads and sessions.

Units are converted once, row order is kept because some effects have a memory, and no row is dropped: rows where the
arm went but nothing was read stay, masked. Every column without a meaning of its own is a candidate covariate.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from armflex.arguments import checked_init, checked_kinds
from armflex.arm import Arm, warn
from armflex.conventions import LARGEST, NUMBER, SMALLEST_STD, UNITS, Array
from armflex.errors import Flag, InputError, Place, TableError, did_you_mean, listing, shown
from armflex.measured.data_flags import (
    branch_flags,
    check_joint_units,
    check_not_lost,
    check_one_unit,
    force_flags,
    in_other_units,
    table_flags,
    turned_back,
    unit_flags,
    unread_orientation,
)
from armflex.measured.forces import (
    FORCE_KINDS,
    FORCE_TEXTS,
    UNLOADED,
    Unnamed,
    check_load_names,
    force_columns,
    read_loads,
)
from armflex.measured.pictures import read_pictures, without_board
from armflex.measured.points import PointExport, read_points, with_points
from armflex.measured.table import (
    Table,
    Tabular,
    check_asked,
    check_payloads,
    check_same_arm,
    check_unknown,
    joint_kinds,
    other_joints,
    read_pieces,
    read_table,
)
from armflex.readings import Camera, Kind, Orientation, Position, Readings, TouchingSensor, touched
from armflex.result import Result
from armflex.rows import Rows
from armflex.rows.period import Period
from armflex.rows.rows import APPROACH, MOST_LEVELS, last_motion, level_columns

POSITION, ROTATION, EACH = ("x", "y", "z"), ("rx", "ry", "rz"), ("sigma_x", "sigma_y", "sigma_z")
KINDS = {
    **dict.fromkeys(POSITION, "length"),
    **dict.fromkeys(ROTATION, "angle"),
    **dict.fromkeys(("sigma", *EACH), "length"),
    "sigma_r": "angle",
    "time": "time",
    "hold": "time",
    **FORCE_KINDS,
}
NO_NUMBERS = ("nan", "inf", "infinity")
"""What programs write, but for its sign, for a number that they could not compute: an error in a covariate of numbers,
in which another word for nothing is a gap."""

ALONE = ': one coordinate alone is read as an [instrument.NAME], such as one of kind = "height" in the column NAME'
"""What is said where only some coordinates of a point are there."""

FEW_ROWS = 0.25
"""Tolerance: share of a column's rows below which those far beyond its limits are in another unit than the others."""

TEXTS = ("pose", "session", "payload", *FORCE_TEXTS)


@checked_init
@dataclass(frozen=True, eq=False, kw_only=True)
class Measurements(Rows, Result):
    """A campaign: rows in the order taken, and what was read there.

    Positions and orientations can be given, and replaced, by themselves: `position` with `sigma`, `rotation` with
    `sigma_r`, as the attributes below have them.

    Attributes:
        readings: What was read in each row, of every kind.
        sha256: Of the file, and of the points' file where there is one.
        flags: Flags about the table.
        frame: Name of the frame that the positions are in, '' where the files do not say.
        units: Units that the file has its columns in, by column; those in SI are left out.
        begins: The date at which `time` is 0, ISO 8601, '' where it has no dates.
        periods: When each of several campaigns was that were joined.
    """

    readings: Readings
    sha256: str = ""
    flags: tuple[Flag, ...] = ()
    frame: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    begins: str = ""
    periods: tuple[Period, ...] = ()

    FIELDS = ("table", "sha256", "frame", "flags")
    ROWS = "table"

    @property
    def table(self) -> dict[str, Any]:
        """The columns of a measurements.csv in SI, (N,) each; None where nothing was read.

        What follows from the order of the rows is left out: time by the number of the row, and the last motion of a
        joint.

        Raises:
            InputError: As `force_columns`.
        """
        columns: dict[str, Any] = {"pose": self.pose, "session": self.session, "payload": self.payload}
        columns |= {f"q_{name}": self.q[:, i] for i, name in enumerate(self.joint_names)}
        columns |= {} if "time" in self.derived else {"time": self.time}
        columns |= {} if self.hold is None else {"hold": self.hold}
        moved = last_motion(self.q)
        for i, name in enumerate(f"{APPROACH}{joint}" for joint in self.joint_names):
            if name not in self.derived or (self.approach[:, i] != moved[:, i]).any():
                columns[name] = self.approach[:, i]
        columns |= force_columns(self.wrenches, len(self))
        for kind in self.readings.kinds:
            if kind.texts is not None:
                columns |= {kind.name: kind.texts} if kind.texts else {}
                continue
            named = {Position: (POSITION, EACH), Orientation: (ROTATION, ("sigma_r",))}
            headers_of = kind.headers, (f"sigma_{kind.name}",)
            names, stds = headers_of if kind.name else named.get(type(kind), headers_of)
            sigma = kind.sigma.min(axis=1, keepdims=True) if kind.apart else kind.sigma
            read = np.where(np.isfinite(kind.sigma) & self.measured[:, None], kind.values, np.nan)
            columns |= dict(zip(names, read.T, strict=True))
            columns |= dict(zip(stds, np.where(np.isfinite(sigma), sigma, np.nan).T, strict=False))
            beside = {f"{kind.name}_{key}": getattr(kind, key) for key in kind.beside}
            columns |= {key: np.where(part > 0, part, np.nan) for key, part in beside.items() if part is not None}
        return columns | dict(self.covariates)

    def __repr__(self) -> str:
        """One line: a campaign is too much to print."""
        read = ", ".join(kind.title for kind in self.readings.kinds) or "nothing"
        return f"<Measurements: {len(self)} rows, {int(self.measured.sum())} measured, {read}>"

    def __init__(
        self,
        *,
        readings: Readings | None = None,
        sha256: str = "",
        flags: tuple[Flag, ...] = (),
        frame: str = "",
        units: Mapping[str, str] | None = None,
        begins: str = "",
        periods: tuple[Period, ...] = (),
        **rows: Any,
    ) -> None:
        """Take the attributes of `Rows`, and readings as they are or by number.

        Raises:
            InputError: Orientations without a standard deviation, or the other way about.
        """
        loose = {name: rows.pop(name) for name in ("position", "sigma", "rotation", "sigma_r") if name in rows}
        super().__init__(**rows)
        more: dict[str, Any] = {"readings": _with(len(self), readings or Readings(len(self)), loose), "sha256": sha256}
        more |= {"flags": flags, "frame": frame, "units": dict(units or {}), "begins": begins, "periods": periods}
        for name, value in more.items():
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, rows: Rows, readings: Readings) -> Measurements:
        """Return rows and what was read there as a campaign."""
        return cls(readings=readings, **{field.name: getattr(rows, field.name) for field in fields(Rows)})

    @property
    def clock(self) -> tuple[Period, ...]:
        """When it was, or each of its campaigns; empty where it has no column `time`."""
        if self.periods or "time" in self.derived or not len(self):
            return self.periods
        file = self.places[0].file if self.places else ""
        name = file.name if isinstance(file, Path) else ""
        sha256 = self.sha256 or hashlib.sha256(self.time.tobytes() + self.q.tobytes()).hexdigest()
        return (Period(name, sha256, float(self.time.min()), float(self.time.max()), self.begins),)

    @property
    def dates(self) -> tuple[str, ...]:
        """The first and the last date of `time`, ISO 8601, empty where it has none."""
        ends = sorted(period.at(end) for period in self.clock if period.begins for end in (period.first, period.last))
        return (ends[0], ends[-1]) if ends else ()

    @property
    def position(self) -> Array:
        """(N, 3) measured target position [m]; zero where not measured."""
        return self._positions.values

    @property
    def sigma(self) -> Array:
        """(N, 3) one standard deviation of the position [m]."""
        return self._positions.sigma

    @property
    def positioned(self) -> np.ndarray:
        """(N,) where a position was read."""
        position = self.readings.of(Position)
        return self.measured & (np.isfinite(position.sigma).all(axis=1) if position else False)

    @property
    def rotation(self) -> Array | None:
        """(N, 3) measured rotation vector [rad]; zero where not measured, None where no row has one."""
        turned = self.readings.of(Orientation)
        return None if turned is None else turned.values

    @property
    def sigma_r(self) -> Array | None:
        """(N,) one standard deviation of the rotation [rad]; infinite where not measured, None with `rotation`."""
        turned = self.readings.of(Orientation)
        return None if turned is None else turned.sigma[:, 0]

    @property
    def _positions(self) -> Position:
        position = self.readings.of(Position)
        if position is None:
            read = listing(type(kind).__name__.lower() for kind in self.readings.kinds)
            raise InputError(f"the campaign has no positions (its readings: {read})")
        return position

    def _some(self, rows: np.ndarray) -> dict[str, Any]:
        return {**super()._some(rows), "readings": self.readings.some(rows)}


LOOSE: dict[type[Kind], tuple[str, str]] = {Position: ("position", "sigma"), Orientation: ("rotation", "sigma_r")}
"""How the values and standard deviations of a kind are given where it is not given as a whole."""


def _with(count: int, readings: Readings, given: Mapping[str, Array | None]) -> Readings:
    """Return the readings of `count` rows with those replaced that are given by themselves, None for no such kind."""
    kinds: list[Kind] = [kind for kind in readings.kinds if type(kind) not in LOOSE or kind.name]
    for i, (kind, names) in enumerate(LOOSE.items()):
        before = readings.of(kind)
        values_of = {} if before is None else dict(zip(names, (before.values, before.sigma), strict=True))
        values, sigma = ({**values_of, **given}.get(name) for name in names)
        if (values is None) != (sigma is None):
            raise InputError(f"{names[0]} and {names[1]} go together: how well are the {kind.__name__.lower()}s known?")
        if values is not None and sigma is not None:
            each = np.broadcast_to(sigma.reshape(len(sigma), -1), (len(sigma), kind.dimension))
            kinds.insert(i, kind(values, each))
    return Readings(count, tuple(kinds))


@checked_kinds
def read_measurements(
    path: Tabular,
    arm: Arm,
    inputs_only: bool = False,
    points: str | Path | PointExport | None = None,
    unnamed: Unnamed = UNLOADED,
) -> Measurements:
    """Read a campaign for an arm, from CSV, Parquet or a pandas data frame.

    Args:
        path: The rows, a file or a data frame; see the column table of the file format.
        arm: The arm it was taken on.
        inputs_only: Accept a table without measured positions, such as rows to be predicted.
        points: The positions, where the instrument's program exported them apart: the file, or what `read_points`
            made of it. A row's point is named by its column `point`, else by its `pose`.
        unnamed: What loads rows that name no payload, or no force.

    Raises:
        TableError: A column is missing, misspelt or of the wrong unit; a cell is not a number; a position or a force is
            given in part; some rows are in another unit; a payload or link is unknown; points do not match the rows.
    """
    export = points if isinstance(points, PointExport) or points is None else read_points(points)
    table = read_table(path, column_kinds(arm))
    recognised, flags = _known_columns(table, arm, inputs_only, export), ()
    if export:
        table, flags = with_points(table, export)
    measurements, turned = _measurements(table, arm, unnamed)
    covariates: dict[str, Array | tuple[str, ...]] = {}
    for name in (name for name in table.columns if name not in recognised):
        column = _Covariate(name)
        column.add(table)
        column.check()
        covariates[name] = table.numbers(name) if column.numeric else table.texts(name)
    sha256, frame = table.sha256, ""
    measurements = replace(measurements, covariates=covariates)
    odd = float(in_other_units(measurements.q, arm).mean(axis=0).max(initial=0.0))
    # Of a whole column readings decide what unit it is in, when the arm is fitted.
    if inputs_only or not measurements.positioned.any() or odd < FEW_ROWS:
        check_joint_units(measurements.q, arm, measurements.places, units=table.units)
    for kind in measurements.readings.kinds:
        if kind.unit == "m":
            read = np.flatnonzero(np.isfinite(kind.sigma).all(axis=1) & measurements.measured)
            if isinstance(kind, Position):
                check_not_lost(kind.values, measurements.q, read, measurements.places)
            check_one_unit(kind.values, read, measurements.places, kind.columns(kind.name) if kind.name else POSITION)
    flags += () if turned is None else (replace(turned, text=f"{Place(table.path, 1)}: {turned.text}"),)
    flags += (
        *table_flags(table, measurements, arm),
        *_sensor_flags(measurements, arm, table),
        *force_flags(measurements, arm),
    )
    flags += branch_flags(table, arm)
    if not measurements.measured.any():  # else readings decide, when the arm is fitted
        flags += unit_flags(table, arm)
    if export is not None:
        sha256, frame = hashlib.sha256((sha256 + export.sha256).encode()).hexdigest(), export.frame
        base = arm.robot.base
        if arm.measurement.frame == "base" and frame.split("::")[-1].lower() not in (base.lower(), "base"):
            text = f"points are in frame {frame!r}; the arm file says that measurements are in its base {base!r}"
            flags += (Flag("points_frame", text),)
    return replace(measurements, flags=flags, sha256=sha256, frame=frame, units=table.units)


def as_measurements(measurements: Measurements | Tabular, arm: Arm, inputs_only: bool = False) -> Measurements:
    """Return a campaign as it is, or what `read_measurements` makes of a file or a data frame."""
    return measurements if isinstance(measurements, Measurements) else read_measurements(measurements, arm, inputs_only)


def stream_inputs(path: str | Path, arm: Arm, most: int, unnamed: Unnamed = UNLOADED) -> Iterator[Measurements]:
    """Yield the rows of a table of inputs, so many at most at a time, as `read_measurements` gives them all.

    The table is read twice: all of it is looked at before its first rows are given. What is kept meanwhile does not
    grow with it, but for measured positions. Text columns are given by their levels, see `Rows.levelled`, and flags
    about the table are left out. What is no file, but a pipe, is given in one piece.

    Raises:
        TableError: As `read_measurements`, of the first such rows.
    """
    path, kinds = Path(path), column_kinds(arm)
    if not path.is_file():
        yield read_measurements(path, arm, inputs_only=True, unnamed=unnamed).levelled()
        return
    far, positions = [np.zeros((0, len(arm.joint_names)))], [np.zeros((0, 3))]
    earliest: list[datetime] = []
    far_places: list[Place] = []
    places: list[Place] = []
    seen: dict[str, _Covariate] = {}
    asked: list[tuple[Flag, ...]] = []
    units: dict[str, str] = {}
    for table in read_pieces(path, kinds, most):
        units = table.units
        recognised, (measurements, turned) = _known_columns(table, arm, True, None), _measurements(table, arm, unnamed)
        warn(() if turned is None else (turned,))
        asked.append(unit_flags(table, arm))
        earliest += [datetime.fromisoformat(measurements.begins)] if measurements.begins else []
        for name in (name for name in table.columns if name not in recognised):
            seen.setdefault(name, _Covariate(name)).add(table)
        odd = np.flatnonzero(in_other_units(measurements.q, arm).any(axis=1))
        there = np.flatnonzero(measurements.positioned)
        far.append(measurements.q[odd])
        if measurements.readings.of(Position):
            positions.append(measurements.position[there])
        far_places += [measurements.places[row] for row in odd]
        places += [measurements.places[row] for row in there]
    for column in seen.values():
        column.check()
    check_joint_units(np.vstack(far), arm, far_places, units=units)
    check_one_unit(np.vstack(positions), np.arange(len(places)), places)
    warn(asked[0] if all(asked) and not places else ())
    before: tuple[Array, Array] | None = None
    first, sha256 = 0, ""
    if arm.clock:
        with path.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    for table in read_pieces(path, kinds, most):
        measurements, _ = _measurements(table, arm, unnamed, first, before, min(earliest, default=None))
        columns = {name: table.numbers(name) for name, column in seen.items() if column.numeric}
        for name, column in seen.items():
            if not column.numeric:
                columns |= level_columns(name, table.texts(name), column.levels)
        first, before = first + len(table), (measurements.q[-1], last_motion(measurements.q, before)[-1])
        yield replace(measurements, covariates=columns, sha256=sha256)


class _Covariate:
    """What a column without a meaning holds, as far as it was read: `numeric` where every cell is a number."""

    def __init__(self, name: str) -> None:
        self.name, self.count, self.numbers, self.numeric = name, 0, 0, True
        self._nan: tuple[Place, str] | None = None
        self._texts: set[str] = set()

    def add(self, table: Table) -> None:
        """Look at some more of its rows."""
        cells = table.texts(self.name)
        self.count += len(cells)
        if len(self._texts) <= MOST_LEVELS:
            self._texts.update(cells)
        if table.plain(self.name) is not None:
            self.numbers += len(cells)
            return
        fine = [bool(NUMBER.fullmatch(cell)) for cell in cells]
        self.numbers += sum(fine)
        self.numeric &= all(fine) and all(abs(float(cell)) <= LARGEST for cell in cells)
        pairs = zip(table.lines, cells, strict=True)
        odd = ((Place(table.path, line), cell) for line, cell in pairs if cell.lower().lstrip("+-") in NO_NUMBERS)
        self._nan = self._nan or next(odd, None)

    def check(self) -> None:
        """Raise `TableError` where nan or inf stands among its numbers."""
        if self._nan and self.numbers:
            raise TableError(self._nan[0], f"column {self.name!r} is {self._nan[1]!r}, not a finite number")

    @property
    def levels(self) -> tuple[str, ...]:
        """Its levels, as it is text."""
        return () if len(self._texts) > MOST_LEVELS or 2 * self.numbers > self.count else tuple(sorted(self._texts))


def _known_columns(table: Table, arm: Arm, inputs_only: bool, points: PointExport | None) -> list[str]:
    """Return the columns that have a meaning, after checking that all needed are there and none is misspelt."""
    recognised = [*column_kinds(arm), *TEXTS, *(f"{APPROACH}{joint}" for joint in arm.joint_names)]
    needed, sensed = [f"q_{joint}" for joint in arm.joint_names], set(table.columns) & set(_sensor_kinds(arm))
    check_same_arm(table, arm)
    missing = [name for name in POSITION if name not in table.columns]
    alike = {name[:1].lower() for name in table.columns if name[:1] in "XYZ"}
    if not points and 0 < len(missing) < len(POSITION) and alike.isdisjoint(missing):
        raise table.fail(f"has no column {listing(map(repr, missing))}{ALONE}")
    table.require([*needed, *(() if inputs_only or points or sensed else POSITION)])
    for name, column in table.columns.items():
        if name not in recognised and (sensor := _undeclared(name, arm)):
            text = f"column {column.header!r}: the arm file declares no [instrument.{sensor}]"
            raise table.fail(f"{text}{did_you_mean(sensor, arm.sensors)}")
    meant = [*recognised, *(("point",) if points else ())]
    unknown = [name for name in table.columns if name not in meant]
    check_load_names(table, arm, unknown)
    check_asked(table, arm, unknown)
    for name in (name for name in unknown if name.startswith(APPROACH)):
        raise table.fail(f"unknown column {table.columns[name].header!r}{did_you_mean(name, meant)}")
    check_unknown(table, unknown, meant, [*arm.joint_names, *arm.robot.locked], recorded=True)
    if not len(table):
        raise TableError(Place(table.path), "has a header but no rows")
    return recognised + other_joints(table, arm)


def _undeclared(name: str, arm: Arm) -> str:
    """Return the sensor that a column which has no meaning is of by its name, '' where it is of none.

    Where the arm has a sensor `dial1`, `dial3` and `dial3_x` are of `dial3`; where it has any, `sigma_NAME` is of NAME.
    """
    base, digits = name.removeprefix("sigma_"), "0123456789"
    series = {sensor.rstrip(digits) for sensor in arm.sensors}
    for part in (base, base.rsplit("_", 2)[0], base.rpartition("_")[0]):
        if (stem := part.rstrip(digits)) != part and stem in series:
            return part
    return base if name != base and arm.sensors else ""


DATE = re.compile(r"\d{4}-\d\d-\d\d(?:[T ].*)?")
"""How a cell begins that is a date, and no number of seconds."""


def _dates(table: Table) -> list[datetime] | None:
    """Return when each row was, None without dates; raise where a cell is none, or only some are of UTC."""
    cells = table.texts("time") if "time" in table.columns else ()
    if not cells or table.columns["time"].unit or not DATE.fullmatch(cells[0]):
        return None
    dates = list[datetime]()
    for row, cell in enumerate(cells):
        try:
            date = datetime.fromisoformat(cell) if DATE.fullmatch(cell) else None
        except ValueError:
            date = None
        if date is None:
            raise table.fail(f"column 'time' is {shown(cell)}, expected a date as in the first row (ISO 8601)", row)
        if dates and (date.tzinfo is None) != (dates[0].tzinfo is None):
            raise table.fail(f"column 'time' is {shown(cell)}, and only some rows say how far they are from UTC", row)
        dates.append(date)
    return dates


def _measurements(
    table: Table,
    arm: Arm,
    unnamed: Unnamed,
    first: int = 0,
    before: tuple[Array, Array] | None = None,
    start: datetime | None = None,
) -> tuple[Measurements, Flag | None]:
    """Return the rows of a table without covariates, and the flag of `turned_back`.

    `first` is the first row's number, `before` as of `last_motion`. Dates are [s] from `start`, the earliest where it
    is not given.
    """
    dates = _dates(table)
    if dates is not None:
        start = start or min(dates)
        time = np.array([(date - start).total_seconds() for date in dates])
    else:
        count = np.arange(first, first + len(table), dtype=float)
        time = table.numbers("time") if "time" in table.columns else count
    q, turned_flag = turned_back(table.matrix([f"q_{joint}" for joint in arm.joint_names]), arm)
    measured, position = _vectors(table, POSITION)
    turned, rotation = _vectors(table, ROTATION)
    readings = Readings(len(table), _sensed(table, arm))
    alone = turned & ~measured
    if alone.any():
        raise table.fail("has rx ry rz but no x y z: an orientation alone is not used", alone.argmax())

    def named(column: str, default: str | None) -> tuple[str, ...]:
        cells = table.texts(column) if column in table.columns else ("",) * len(table)
        return tuple(cell or (str(i) if default is None else default) for i, cell in enumerate(cells, first))

    payload = named("payload", unnamed.payload)
    check_payloads(table, payload, arm)
    # Recorded directions; where a joint has none, that of its last change of position.
    approach, directions = last_motion(q, before), [f"approach_{joint}" for joint in arm.joint_names]
    for kind in readings.kinds:  # an arm that is guided by hand into a socket comes from no known side
        touches = np.array([bool(text) for text in kind.texts or [""] * len(table)])
        approach = np.where(touches[:, None], 0.0, approach)
    for index, name in enumerate(directions):
        if name in table.columns:
            approach[:, index] = table.numbers(name)
            for row in np.flatnonzero(~np.isin(approach[:, index], (-1.0, 0.0, 1.0)))[:1]:
                raise table.fail(f"{name} is {approach[row, index]:g}, not -1, 0 or 1", row)
    hold = table.numbers("hold") if "hold" in table.columns else None
    if hold is not None and (hold < 0.0).any():
        row = int((hold < 0.0).argmax())
        raise table.fail(f"hold is {hold[row]:g} s: the load has stood for 0 s at least", row)
    tracked: dict[str, Any] = {}
    if POSITION[0] in table.columns or not readings.kinds:
        names = EACH if any(name in table.columns for name in EACH) else ("sigma",)
        if names == EACH and "sigma" in table.columns:
            raise table.fail(
                f"has sigma beside {listing(name for name in EACH if name in table.columns)}: leave one out"
            )
        unread = np.inf if readings.kinds else 1.0
        tracked |= {"position": position, "sigma": _deviations(table, names, measured, "the positions", "m", unread)}
    if turned.any():
        sigma_r = _deviations(table, ("sigma_r",), turned, "they", "rad", np.inf)[:, 0]
        tracked |= {"rotation": rotation, "sigma_r": sigma_r}
    rows = Measurements(
        joint_names=arm.joint_names,
        pose=named("pose", None),
        session=named("session", "session"),
        payload=payload,
        time=time,
        q=q,
        approach=approach,
        measured=measured | readings.read,
        readings=readings,
        **tracked,
        hold=hold,
        places=tuple(Place(table.path, line) for line in table.lines),
        derived=tuple(name for name in ("time", *directions) if name not in table.columns),
        wrenches=read_loads(table, arm, unnamed.force),
        begins="" if start is None or dates is None else start.isoformat(),
    )
    return rows, turned_flag


def _sensor_kinds(arm: Arm) -> dict[str, str]:
    """Return the kind of quantity of each column of the arm's sensors, and of their standard deviations."""
    kinds = {}
    for name, sensor in arm.sensors.items():
        kinds |= dict.fromkeys((*sensor.columns, f"sigma_{name}"), sensor.kind.quantity)
        others = (*(f"{name}_{key}" for key in sensor.kind.beside), *sensor.kind.instead(name))
        kinds |= dict.fromkeys(others, "count")
    return kinds


def column_kinds(arm: Arm) -> dict[str, str]:
    """Return the kind of quantity of each column of a campaign that may carry a unit."""
    joints = joint_kinds(arm, "q")
    # A row that was driven from a compensated path may say where it was meant to be: no cause of anything.
    meant = {f"target_{name.removeprefix('q_')}": kind for name, kind in joints.items()}
    return KINDS | joints | meant | _sensor_kinds(arm)


def _sensed(table: Table, arm: Arm) -> tuple[Kind, ...]:
    """Return what the sensors read, of those that a column is of."""
    kinds: list[Kind] = []
    for name, sensor in arm.sensors.items():
        columns, instead = sensor.columns, sensor.kind.instead(name)
        if any(column in table.columns for column in instead):
            if any(column in table.columns for column in columns):
                raise table.fail(f"has {listing(columns)}, and {listing(instead)} as well: give one of them")
            columns = instead
        if not any(column in table.columns for column in columns):
            if f"sigma_{name}" in table.columns:
                raise table.fail(f"has sigma_{name}, but no {listing(columns)}")
            continue
        sigma = np.full((len(table), 1), sensor.sigma)
        if isinstance(sensor, TouchingSensor):
            texts = table.texts(name)
            if f"sigma_{name}" in table.columns:
                there = np.array([bool(text) for text in texts])
                sigma = _deviations(table, (f"sigma_{name}",), there, name, "m", np.inf)
            kinds += touched(name, texts, sigma, sensor.sockets)
            continue
        if isinstance(sensor.about, Camera):  # of a board it may see some corners
            values = read_pictures(table, sensor)
            each = np.isfinite(values)
            read = np.any(each, axis=1)
        else:
            read, values = _vectors(table, columns)
            if columns is instead:
                values, fine = sensor.kind.of_instead(values, sensor.about)
                for row in np.flatnonzero(read & ~fine)[:1]:
                    raise table.fail(f"{listing(columns)} are no unit vector", row)
            for column, most, reading in zip(columns, sensor.kind.most, values.T, strict=False):
                for row in np.flatnonzero(read & (np.abs(reading) > most))[:1]:
                    text = f"{column} is {reading[row]:.6g} {sensor.kind.unit}, beyond {most:.4g}"
                    raise table.fail(f"{text}: in degrees, call the column {column}_deg", row)
            each = np.broadcast_to(read[:, None], values.shape)
        if f"sigma_{name}" in table.columns:
            sigma = _deviations(table, (f"sigma_{name}",), read, name, sensor.kind.unit, np.inf)
        low = read & ~(values > 0.0).all(axis=1)
        if sensor.kind.positive and low.any():
            text = f"{name} is {values[low][0, 0]:g} {sensor.kind.unit}, expected more than 0"
            raise table.fail(text, low.argmax())
        beside = {}
        for key in (option for option in sensor.kind.beside if f"{name}_{option}" in table.columns):
            there = table.given([column := f"{name}_{key}"])
            counts = table.numbers_where(column, there)
            for row in np.flatnonzero(there & ((counts != np.round(counts)) | (counts < 1.0)))[:1]:
                raise table.fail(f"{column} is {counts[row]:g}, expected a whole number from 1 on", row)
            beside[key] = np.where(there, counts, 0.0).astype(int)
        kinds.append(sensor.kind(np.where(each, values, 0.0), np.where(each, sigma, np.inf), name, **beside))
    return tuple(kinds)


READ_IN = tuple(unit for kind in ("length", "angle") for unit in UNITS[kind] if len(unit) > 1)
"""Units at the end of a header that an instrument would read in; a single letter may be anything."""

TEMPERATURES = ("t_", "temp")
"""How columns of temperatures begin: deg is no angle there."""


def _sensor_flags(measurements: Measurements, arm: Arm, table: Table) -> Iterator[Flag]:
    """Yield flags about instruments that nothing was read of, and about columns that look like one's."""
    read = {kind.name: bool(np.isfinite(kind.sigma).any()) for kind in measurements.readings.kinds}
    for name, sensor in arm.sensors.items():
        columns = sensor.kind.columns(name)
        if isinstance(sensor.about, Camera) and name in read and name in table.columns:
            yield from without_board(measurements, table, name)
        if name in read and not read[name]:
            text = f"[instrument.{name}] is declared, and its columns are empty in every row"
            yield Flag("instrument_unread", f"{text} ({listing(columns)})")
        elif name not in read:
            # A column that nothing knows, in this kind's units, may be meant.
            units, headers = UNITS[sensor.kind.quantity], [table.columns[name] for name in measurements.covariates]
            ends = [(column.header, {column.unit, column.header.rpartition("_")[2]}) for column in headers]
            like = [header for header, end in ends if not end.isdisjoint(units)]
            hint = f", did you mean {like[0]!r}?" if len(columns) == 1 and len(like) == 1 else ""
            text = f"[instrument.{name}] is declared, and no column reads it ({listing(columns)})"
            yield Flag("instrument_unread", text + hint)
    readings = measurements.readings
    asked = readings.of(Position) and not readings.of(Orientation)
    if turn := unread_orientation(measurements.covariates) if asked else []:
        text = (
            f"columns {listing(turn)} are read as covariates: an orientation is rx, ry, rz (a rotation vector, in rad"
        )
        text += " or rx_deg ..) with sigma_r; `armflex intake` writes it of qw, qx, qy, qz and of roll, pitch, yaw"
        yield Flag("orientation_unread", text)
    others = {name: values for name, values in measurements.covariates.items() if name not in turn}
    for name in others:
        base, _, axis = name.rpartition("_")
        if axis == "x" and base and f"{base}_y" in others:
            text = f"columns {name} and {base}_y are covariates: if an instrument reads them, declare"
            yield Flag("instrument_undeclared", f"{text} [instrument.{base}]")
    needed = {column for effect in arm.effects for column in effect.location.covariates}
    alike: dict[str, list[str]] = {}
    for name, values in others.items():
        base, _, unit = name.rpartition("_")
        stem = base[:-2] if base.endswith(("_x", "_y", "_z")) else base
        is_read = base and unit in READ_IN and not stem.lower().startswith(TEMPERATURES)
        if isinstance(values, np.ndarray) and name not in needed and is_read:
            alike.setdefault(stem, []).append(name)
    for stem, names in alike.items():
        what = f"column {names[0]} is" if len(names) == 1 else f"columns {listing(names)} are"
        text = f"{what} read as {'a covariate' if len(names) == 1 else 'covariates'}"
        yield Flag("instrument_undeclared", f"{text}; [instrument.{stem}] would have it read the arm")


def _vectors(table: Table, names: tuple[str, ...]) -> tuple[np.ndarray, Array]:
    """Return which rows have all n numbers of columns that may be left out, and these with zeros elsewhere."""
    if not any(name in table.columns for name in names):
        return np.zeros(len(table), dtype=bool), np.zeros((len(table), len(names)))
    table.require(names)
    there = table.given(names, ALONE if names == POSITION else "")
    empty = ": leave the cell empty where nothing was read"
    return there, np.column_stack([table.numbers_where(name, there, empty) for name in names])


def _deviations(
    table: Table, names: tuple[str, ...], read: np.ndarray, what: str, unit: str, elsewhere: float
) -> Array:
    """Return (N, 1 or 3) standard deviations of what was read in the rows of a mask, and a number elsewhere."""
    if names[0] not in table.columns and len(names) == 1:
        if not read.any():
            return np.full((len(table), 1), elsewhere)
        also = "" if what == "the positions" else "rx ry rz but "
        raise table.fail(f"has {also}no column {names[0]!r}: how well are {what} known?")
    table.require(names)
    sigma = np.column_stack([table.numbers_where(name, read) for name in names])
    bad = read & ~(sigma >= SMALLEST_STD).all(axis=1)
    if bad.any():
        problem = f"{names[0].removesuffix('_x')} must be positive, {SMALLEST_STD:g} {unit} at least"
        raise table.fail(problem, bad.argmax())
    return np.where(read[:, None], sigma, elsewhere)
