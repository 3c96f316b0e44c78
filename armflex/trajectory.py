"""Trajectories: joint positions over time, some of them via-points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from armflex.arguments import checked_init, checked_kinds
from armflex.arm import Arm, warn, without_drive
from armflex.conventions import Array, real_array
from armflex.errors import Flag, InputError, Place, ShapeError, TableError, listing, naming
from armflex.laws.effects.in_arm import check_approaches, check_covariates, derived_direction
from armflex.laws.row import MASS
from armflex.measured.data_flags import check_joint_units, unit_flags
from armflex.measured.forces import (
    FORCE_KINDS,
    FORCE_TEXTS,
    UNLOADED,
    ForceTable,
    Unnamed,
    check_load_names,
    force_columns,
    read_loads,
)
from armflex.measured.table import (
    NOTHING,
    Table,
    Tabular,
    asked_columns,
    check_asked,
    check_payloads,
    check_same_arm,
    check_unknown,
    joint_kinds,
    read_table,
    write_table,
)
from armflex.mechanics.history import known_rows
from armflex.mechanics.loop_rows import rigid_tips
from armflex.result import Result
from armflex.rows.rows import APPROACH, last_motion
from armflex.rows.wrench import Wrench, wrenches_in

SHORTEST = 1e-9
"""No controller's rows follow each other sooner [s]; speeds over less may be beyond all numbers."""

TARGET = "target"
"""Begins the name of a column that says where a joint puts the rigid tip where the flexed one is to be."""

TOLERANCE = "tolerance"
"""Name of the column of the largest displacement of the tip in each row."""

ARC = 8
"""Chords that the way of the tip from row to row is measured by; even."""

TOGETHER = 4096
"""Stretches whose length is measured together."""


class Points(NamedTuple):
    """Points of a path in any order.

    Attributes:
        time: (M,) [s].
        q: (M, nq) joint positions [rad or m].
        payload: Name of each one's payload.
        v, a: (M, nq) joint velocities [rad/s or m/s] and accelerations, None where the path is slow.
        covariates: Further columns by name, (M,) each in its own unit.
        target: (M, nq) [rad or m] as of `Trajectory`.
        wrenches: Known loads from outside, the same at all points or one for each.
        tolerance: (M,) largest displacement of the tip [m], NaN where a point has none of its own; None where all do.
    """

    time: Array
    q: Array
    payload: Sequence[str]
    v: Array | None
    a: Array | None
    covariates: Mapping[str, Array]
    target: Array | None
    wrenches: tuple[Wrench, ...]
    tolerance: Array | None = None

    @property
    def meant(self) -> Array:
        """(M, nq) joint positions that put the rigid tip where the flexed one is to be [rad or m]."""
        return self.q if self.target is None else self.target

    def some(self, rows: np.ndarray) -> Points:
        """Return the points of (M,) numbers."""
        payload = [self.payload[int(i)] for i in rows]
        return self.each(payload, wrenches_in(self.wrenches, rows), lambda values: values[rows])

    def each(
        self,
        payload: Sequence[str],
        wrenches: tuple[Wrench, ...],
        of: Callable[[Array], Array],
        of_side: Callable[[Array], Array] | None = None,
    ) -> Points:
        """Return points with other loads, and what `of` makes of each column of numbers, (M, ...) in its unit.

        Of the sides that joints come from `of_side` is asked, where it is given.
        """
        v, a, target, tolerance = (
            None if values is None else of(values) for values in (self.v, self.a, self.target, self.tolerance)
        )
        columns = {
            name: (of_side if of_side and name.startswith(APPROACH) else of)(values)
            for name, values in self.covariates.items()
        }
        return Points(of(self.time), of(self.q), payload, v, a, columns, target, wrenches, tolerance)

    @property
    def asked(self) -> dict[str, Any]:
        """Motion, loads and what else is known of the points, as `Arm.deflection` takes them."""
        columns = {"time": self.time, **self.covariates}
        return {"v": self.v, "a": self.a, "covariates": columns, "wrenches": self.wrenches}


@checked_init
@dataclass(frozen=True, repr=False, eq=False)
class Trajectory(Result):
    """A path through joint space; between rows it is straight.

    Attributes:
        joint_names: Order of the columns of q.
        time: (N,) [s], increasing.
        q: (N, nq) joint positions [rad or m].
        payload: Name of what is carried from each row on.
        via: Name of the row where it is a via-point, else ''.
        v, a: (N, nq) joint velocities [rad/s or m/s] and accelerations where inertial loads count, else None.
        covariates: Further columns, (N,) each in its own unit; `approach_<joint>` is the direction of the way there.
        places: Where each row stands in a file, none where rows are not those of one.
        wrenches: Known loads from outside, the same in all rows or one for each of the N.
        target: (N, nq) joint positions that put the rigid tip where the flexed one is to be [rad or m], None where
            those are q.
        tolerance: (N,) largest displacement of the tip in each row [m], NaN where a row has none of its own; None where
            no row has one.
    """

    FIELDS = ("joint_names", "time", "q", "target", "payload", "via", "v", "a", "covariates")
    ROWS = "table"

    joint_names: tuple[str, ...]
    time: Array
    q: Array
    payload: tuple[str, ...]
    via: tuple[str, ...]
    v: Array | None = None
    a: Array | None = None
    covariates: Mapping[str, Array] = field(default_factory=dict)
    places: tuple[Place, ...] = ()
    wrenches: tuple[Wrench, ...] = ()
    target: Array | None = None
    tolerance: Array | None = None

    def __post_init__(self) -> None:
        for name in ("time", "q", "v", "a", "target", "tolerance"):
            given: Any = getattr(self, name)
            if given is not None or name in ("time", "q"):  # a list of rows is taken, too
                object.__setattr__(self, name, real_array(given, f"trajectory {name}"))  # pyright: ignore[reportArgumentType]
        if self.time.ndim != 1:
            raise ShapeError(f"trajectory time: expected (N,), got {self.time.shape}")
        count = len(self.time)
        if count == 0 or self.q.shape != (count, len(self.joint_names)):
            raise ShapeError(f"trajectory q: expected ({count}, {len(self.joint_names)}), got {self.q.shape}")
        for name in ("v", "a", "target"):
            given = getattr(self, name)
            if given is not None and given.shape != self.q.shape:
                raise ShapeError(f"trajectory {name}: expected {self.q.shape}, got {given.shape}")
        if self.tolerance is not None and self.tolerance.shape != (count,):
            raise ShapeError(f"trajectory tolerance: expected ({count},), got {self.tolerance.shape}")
        if len(self.payload) != count or len(self.via) != count:
            raise ShapeError(f"trajectory: expected {count} payload and via names")
        if count > 1 and not (np.diff(self.time) > 0.0).all():
            row = int(np.argmin(np.diff(self.time) > 0.0)) + 1
            raise InputError(f"trajectory: time does not increase at row {row} ({self.time[row]:g} s)")

    def __len__(self) -> int:
        return len(self.time)

    @property
    def meant(self) -> Array:
        """(N, nq) joint positions that put the rigid tip where the flexed one is to be [rad or m]."""
        return self.q if self.target is None else self.target

    @property
    def is_moved(self) -> bool:
        """Whether any row is elsewhere than the path is meant to be, as in a path that was compensated."""
        return self.target is not None and bool((self.target != self.q).any())

    def __repr__(self) -> str:
        """One line: a path is too much to print."""
        named = sum(map(bool, self.via))
        return f"<Trajectory: {len(self)} rows, {named} via-points, {self.time[0]:g} to {self.time[-1]:g} s>"

    @property
    def table(self) -> dict[str, Any]:
        """The columns of a trajectory.csv, (N,) each.

        Raises:
            InputError: As `force_columns`.
        """
        columns: dict[str, Any] = {"time": self.time}
        for prefix, values in (("q", self.q), ("v", self.v), ("a", self.a), (TARGET, self.target)):
            if values is not None:
                columns |= {f"{prefix}_{name}": values[:, i] for i, name in enumerate(self.joint_names)}
        columns |= {"payload": self.payload, "via": self.via, **force_columns(self.wrenches, len(self))}
        columns |= {} if self.tolerance is None else {TOLERANCE: self.tolerance}
        return columns | dict(self.covariates)

    def between(self, segments: np.ndarray, fractions: Array) -> Points:
        """Return points at (M,) fractions, dimensionless, of the way from (M,) rows to the next, payloads as there."""

        def part(values: Array) -> Array:
            steps, there = fractions.reshape(-1, *[1] * (values.ndim - 1)), values[segments + 1]
            # At its end a stretch is at the next row to the last digit.
            return np.where(steps == 1.0, there, values[segments] + steps * (there - values[segments]))

        payload = [self.payload[i] for i in segments.tolist()]
        pulled = tuple(wrench.each(part) for wrench in self.wrenches)
        # On the way to a row the joints move as they do when they get there.
        return self.points.each(payload, pulled, part, lambda values: values[segments + 1])

    @property
    def points(self) -> Points:
        """The rows."""
        moved = (self.v, self.a, self.covariates, self.target)
        return Points(self.time, self.q, self.payload, *moved, self.wrenches, self.tolerance)

    def lengths(self, arm: Arm) -> Array:
        """Return the (N,) length of path [m] that the rigid arm's tip has gone to each row, where it is meant to be."""
        nominal, steps = arm.loaded(None), np.linspace(0.0, 1.0, ARC + 1)
        q, gone = self.for_arm(arm).meant, [np.zeros(1)]
        for first in range(0, len(q) - 1, TOGETHER):
            here, there = q[first : first + TOGETHER][: len(q) - 1 - first], q[first + 1 : first + 1 + TOGETHER]
            along = here[:, None] + steps[:, None] * (there - here)[:, None]
            tips = rigid_tips(nominal, along.reshape(-1, q.shape[1]))[:, :3, 3].reshape(-1, ARC + 1, 3)
            fine, coarse = (np.linalg.norm(np.diff(t, axis=1), axis=2).sum(axis=1) for t in (tips, tips[:, ::2]))
            gone.append(fine + (fine - coarse) / 3.0)  # an arc is longer than its chords by a share of their square
        return np.cumsum(np.concatenate(gone))

    def speed_shares(self, arm: Arm) -> Array:
        """Return (N - 1, nq) speeds from row to row, by their times or as rows state them, over the joints' limits."""
        speeds = np.abs(np.diff(self.q, axis=0)) / np.diff(self.time)[:, None]
        if self.v is not None:
            speeds = np.max([speeds, np.abs(self.v[:-1]), np.abs(self.v[1:])], axis=0)
        return speeds / np.array([joint.velocity for joint in arm.robot.moving])

    def where(self, i: int) -> str:
        """Return what row i is called in an error, after its place in a file."""
        place, via = f"{self.places[i]}: " if self.places else "", f" ({self.via[i]})" if self.via[i] else ""
        return f"{place}row {i}{via} at {self.time[i]:g} s"

    def check_targets(self, arm: Arm, places: Sequence[object] = ()) -> None:
        """Raise where no rigid arm has its tip at a row's target, naming the row or its place in `places`."""
        for i, q in enumerate(self.for_arm(arm).meant):
            with naming(str(places[i]) if places else f"{self.where(i)}, {TARGET}"):
                arm.check_position(q)

    @checked_kinds
    def under(self, table: ForceTable, arm: Arm) -> tuple[Trajectory, tuple[Flag, ...]]:
        """Return the trajectory under loads that depend on how far along the rigid tip's path a row is, and flags.

        Raises:
            InputError: Rows have loads already, or are beyond the table.
        """
        hung = tuple(wrench for wrench in self.wrenches if wrench.hangs)
        if len(hung) < len(self.wrenches):
            raise InputError(f"rows name forces already, which those of {table.path} would be beside")
        lengths = self.lengths(arm)
        lost, flags = table.missed(lengths), ()
        whole, used = float(np.ptp(table.s)), float(lengths[-1])
        # Share of a table of forces below which a path that goes no further is asked about: a factor of 1000 is a unit
        if table.varies and 0.0 < used < 0.05 * whole:
            text = f"the path is {used:.3g} m long, {table.path} goes over {whole:.3g} m"
            flags = (Flag("force_table", f"{text}: is its s in mm? Then call the column s_mm"),)
        # Share of a table's largest force that loads linear between rows may leave out without a word
        if lost > 1e-3 * max((wrench.sizes[0] for wrench in table.wrenches), default=0.0):
            text = f"loads are linear between rows, which leaves out up to {lost:.3g} N of {table.path}: give more rows"
            flags = (*flags, Flag("force_table", text))
        return replace(self, wrenches=(*hung, *table.at(lengths))), flags

    @checked_kinds
    def towards(self, desired: Trajectory) -> Trajectory:
        """Return the trajectory, as `for_arm` orders it, whose flexed tip is meant where `desired` has the rigid tip.

        Raises:
            InputError: The joints are not the same, or the rows: in number, time or via-point.
        """
        if len(desired) != len(self):
            more = " (`compensate --between` inserts rows)" if len(self) > len(desired) else ""
            raise InputError(f"the desired path has {len(desired)} rows, this one has {len(self)}{more}")
        if sorted(desired.joint_names) != sorted(self.joint_names):
            theirs = f"the desired path is of joints {', '.join(desired.joint_names)}"
            raise InputError(f"{theirs}, this one of {', '.join(self.joint_names)}")
        late = np.abs(desired.time - self.time) > SHORTEST * np.maximum(1.0, np.abs(self.time))
        for i, (via, wanted) in enumerate(zip(self.via, desired.via, strict=True)):
            place = f"{desired.places[i]}: " if desired.places else ""
            if late[i]:
                raise InputError(f"{place}row {i} of the desired path is at {desired.time[i]:.9g} s, "
                                 f"this one's at {self.time[i]:.9g} s")  # fmt: skip
            if via != wanted:
                raise InputError(f"{place}row {i} of the desired path is via-point {wanted!r}, this one's is {via!r}")
        return replace(self, target=desired.q[:, [desired.joint_names.index(name) for name in self.joint_names]])

    @property
    def known(self) -> dict[str, Array]:
        """Time [s], every further column, and the joints' last motion where no column gives it, (N,) each by name."""
        moved = last_motion(self.q)
        approach = {f"{APPROACH}{joint}": moved[:, i] for i, joint in enumerate(self.joint_names)}
        return {"time": self.time, **approach, **self.covariates}

    def asked(self, i: int) -> dict[str, Any]:
        """Return row i's motion, loads and what else is known of it as `Arm.deflection` takes them."""
        columns = {name: values[i] for name, values in self.covariates.items()}
        pulled = wrenches_in(self.wrenches, i)
        return {**self.motion(i), "covariates": {"time": self.time[i], **columns}, "wrenches": pulled}

    @checked_kinds
    def with_constants(self, arm: Arm, constants: Mapping[str, float]) -> Trajectory:
        """Return the trajectory in the arm's order of joints with further columns that are the same in every row.

        Raises:
            InputError: One is a column already, or no effect of the arm depends on it, or an `approach_` is not -1, 0
                or 1; or the joints are not the arm's.
        """
        check_approaches(constants, self.joint_names)
        for name in constants:
            if name in self.covariates or name == "time":
                raise InputError(f"covariate {name!r} is a column of the trajectory already")
        check_covariates(arm, constants)
        added = {name: np.full(len(self), float(value)) for name, value in constants.items()}
        return replace(self.for_arm(arm), covariates={**self.covariates, **added})

    def prepared(self, arm: Arm) -> Trajectory:
        """Return the trajectory in the arm's order of joints with everything that the arm's effects ask for.

        What depends on the rows before is worked out over the rows: the side from which a joint came, lagged
        temperatures, play.

        Raises:
            InputError: The joints are not the arm's.
            MissingCovariateError: A state needs a column that is not there.
        """
        ordered = self.for_arm(arm)
        if not arm.effects:
            return ordered
        columns = known_rows(arm, ordered)
        # A payload's mass goes with the payload, and time with the rows.
        kept = {name: values for name, values in columns.items() if name not in (MASS, "time")}
        return replace(ordered, covariates=kept)

    def derived_directions(self, arm: Arm) -> tuple[Flag, ...]:
        """Return a flag for every direction that the arm's effects depend on and no column gives."""
        moved = self.known
        asked = dict.fromkeys(name for effect in arm.effects for name in effect.location.covariates)
        names = [name for name in asked if name.startswith(APPROACH) and name not in self.covariates]
        return tuple(derived_direction(name, int((moved[name] == 0.0).sum())) for name in names)

    def motion(self, i: int) -> dict[str, Array | None]:
        """Return row i's (nq,) velocities [rad/s or m/s] and accelerations as `Arm.deflection` takes them."""
        return {"v": None if self.v is None else self.v[i], "a": None if self.a is None else self.a[i]}

    @checked_kinds
    def for_arm(self, arm: Arm) -> Trajectory:
        """Return the trajectory with its columns in the arm's order of joints.

        Raises:
            InputError: The joints are not the arm's.
        """
        if self.joint_names == arm.joint_names:
            return self
        if sorted(self.joint_names) != sorted(arm.joint_names):
            ours, theirs = ", ".join(self.joint_names), ", ".join(arm.joint_names)
            raise InputError(f"trajectory of joints {ours}, the arm has {theirs}")
        order = [self.joint_names.index(name) for name in arm.joint_names]
        given = {"v": self.v, "a": self.a, "target": self.target}
        moved = {name: None if values is None else values[:, order] for name, values in given.items()}
        return replace(self, joint_names=arm.joint_names, q=self.q[:, order], **moved)

    def with_midpoints(self, segments: np.ndarray) -> Trajectory:
        """Return the trajectory with a row inserted halfway along each segment marked in a (N - 1,) mask."""
        after = np.flatnonzero(segments) + 1

        def insert(values: Array) -> Array:
            return np.insert(values, after, 0.5 * (values[after - 1] + values[after]), axis=0)

        payload = tuple(np.insert(np.array(self.payload, dtype=object), after, [self.payload[i - 1] for i in after]))
        via = tuple(np.insert(np.array(self.via, dtype=object), after, ""))
        pulled = tuple(wrench.each(insert) for wrench in self.wrenches)
        points = self.points.each(
            payload, pulled, insert, lambda values: np.insert(values, after, values[after], axis=0)
        )
        return replace(self, **points._asdict(), via=via, places=())


def as_trajectory(path: Trajectory | Tabular, arm: Arm) -> Trajectory:
    """Return a path as it is, or what `read_trajectory` makes of a file or a data frame."""
    return path if isinstance(path, Trajectory) else read_trajectory(path, arm)


@checked_kinds
def read_trajectory(path: Tabular, arm: Arm, unnamed: Unnamed = UNLOADED) -> Trajectory:
    """Read a trajectory.csv for an arm, or a data frame of the same columns.

    Args:
        path: The file, or a pandas data frame.
        arm: The arm.
        unnamed: What loads rows that name no payload, or no force.

    Raises:
        TableError: A column is missing, misspelt, called as a load or not numeric; time does not increase; a payload is
            unknown; a force is given in part, or at no link; joints are far beyond their limits, as degrees are that
            should be radians.
    """
    names = {prefix: [f"{prefix}_{joint}" for joint in arm.joint_names] for prefix in ("q", "v", "a", TARGET)}
    kinds = {"time": "time", TOLERANCE: "length"} | joint_kinds(arm, "qva") | FORCE_KINDS
    kinds |= {name: kinds[driven] for name, driven in zip(names[TARGET], names["q"], strict=True)}
    table = read_table(path, kinds)
    check_same_arm(table, arm)
    _refuse_passive(table, arm)
    table.require(["time", *names["q"]])
    columns = [*kinds, *FORCE_TEXTS, "payload", "via"]
    others = [name for name in table.columns if name not in columns]
    check_load_names(table, arm, others)
    check_asked(table, arm, others)
    asked = asked_columns(arm)
    check_unknown(table, [name for name in others if name not in asked], columns, [*arm.joint_names, *arm.robot.locked])
    remarks = [name for name in others if are_remarks(table.texts(name))]
    if unused := [name for name in others if name not in asked and not name.startswith(APPROACH)]:
        headers = listing(repr(table.columns[name].header) for name in unused)
        text = f"{headers}: no effect of this arm depends on {'it' if len(unused) == 1 else 'them'}"
        warn([Flag("unused_column", f"{Place(table.path, 1)}: a path has no use for {text}")])
    covariates = _covariates(table, [name for name in others if name not in remarks], arm)
    if not len(table):
        raise TableError(Place(table.path), "has a header but no rows")
    payload = table.texts("payload") if "payload" in table.columns else ("",) * len(table)
    payload = tuple(name or unnamed.payload for name in payload)
    check_payloads(table, payload, arm)
    q, places = table.matrix(names["q"]), tuple(Place(table.path, line) for line in table.lines)
    check_joint_units(q, arm, places, units=table.units)
    warn(unit_flags(table, arm))
    time = table.numbers("time")
    slow = np.diff(time) >= SHORTEST
    if not slow.all():
        raise table.fail(f"time does not increase, by {SHORTEST:g} s at least", np.argmin(slow) + 1)
    given = [prefix for prefix in ("v", "a", TARGET) if any(name in table.columns for name in names[prefix])]
    table.require([name for prefix in given for name in names[prefix]])
    moved = {prefix: table.matrix(names[prefix]) if prefix in given else None for prefix in ("v", "a", TARGET)}
    if (target := moved[TARGET]) is not None:
        check_joint_units(target, arm, places, TARGET, table.units)
    return Trajectory(
        arm.joint_names,
        time,
        q,
        payload,
        table.texts("via") if "via" in table.columns else ("",) * len(table),
        moved["v"],
        moved["a"],
        covariates=covariates,
        places=places,
        wrenches=read_loads(table, arm, unnamed.force),
        target=moved[TARGET],
        tolerance=_tolerance(table),
    )


def _refuse_passive(table: Table, arm: Arm) -> None:
    """Raise `TableError` at a column of the position of a joint without a drive, naming the drives it follows from."""
    passive, driven = arm.robot.linkage.free, {f"q_{joint}" for joint in arm.joint_names}
    for name in [name for name in table.columns if name not in driven]:
        joint = next((joint for joint in passive if f"q_{joint}" in (name, name.rpartition("_")[0])), None)
        if joint is None:
            continue
        raise table.fail(f"column {table.columns[name].header!r}: {without_drive(arm.robot, joint, 'q_')}")


def _tolerance(table: Table) -> Array | None:
    """Return the (N,) tolerances [m] of a table's rows, NaN where the cell is empty; None where all are."""
    if TOLERANCE not in table.columns:
        return None
    stated = np.array([bool(cell) and cell.lower() not in NOTHING for cell in table.texts(TOLERANCE)])
    values = np.where(stated, table.numbers_where(TOLERANCE, stated), np.nan)
    if (wrong := np.flatnonzero(values <= 0.0)).size:
        raise table.fail(f"tolerance is {values[wrong[0]]:g} m, expected more than 0", int(wrong[0]))
    return values if stated.any() else None


def _covariates(table: Table, names: Sequence[str], arm: Arm) -> dict[str, Array]:
    """Return the (N,) numbers of further columns."""
    try:
        covariates = {name: table.numbers(name) for name in names}
    except TableError as error:
        if not {"x", "y", "z"} <= set(names):
            raise
        text = "a path has no readings x y z: is this a campaign? `predict` and `calibrate` read one"
        raise TableError(error.place, f"{error.problem}; {text}") from None
    try:
        for name, values in covariates.items():
            for value in dict.fromkeys(values.tolist()):
                check_approaches({name: value}, arm.joint_names)
    except InputError as error:
        raise table.fail(str(error)) from None
    return covariates


def are_remarks(cells: Sequence[str]) -> bool:
    """Return whether the cells of a column that are not empty are words, none of them meant as a number."""
    words = list(filter(None, cells))
    return bool(words) and all(word[0].isalpha() and word.lower() not in (*NOTHING, "inf") for word in words)


@checked_kinds
def write_trajectory(trajectory: Trajectory, path: str | Path) -> Path:
    """Write a trajectory.csv, whole or not at all.

    Raises:
        InputError: As `force_columns`.
    """
    columns = {name: np.asarray(values).tolist() for name, values in trajectory.table.items()}
    if TOLERANCE in columns:
        columns[TOLERANCE] = ["" if np.isnan(value) else value for value in columns[TOLERANCE]]
    return write_table(path, columns)
