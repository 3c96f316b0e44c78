"""Rows of a log with the places, orientations and pictures that belong to them: the columns of a campaign."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from armflex.conventions import Array, in_mm
from armflex.errors import FEW, Place, TableError, listing
from armflex.intake.clock import times, unread
from armflex.intake.lost import emptied
from armflex.intake.meanings import SINCE_1970
from armflex.intake.pairing import Match, matched
from armflex.intake.record import Record, ranked
from armflex.intake.settled import in_words
from armflex.intake.sources import numbers, said
from armflex.intake.streams import repeated
from armflex.measured.data_flags import check_one_unit
from armflex.measured.table import Column, Table, csv_text

HARDLY = 5e-3
"""Tolerance: no target moves over less [m] while most joints turn by `MUCH` [rad] and more."""
MUCH = 0.3

ONE_TARGET = 5e-3
"""Tolerance: places of one name in two exports that are nearer [m] are of one target: a sphere of one is wider."""


@dataclass(frozen=True, eq=False)
class Intake:
    """Files as one campaign.

    Attributes:
        columns: Of the campaign, text and numbers by header, every one of as many rows.
        taken: (file, column, what it is, unit, why) of every column.
        joined: How rows were brought together, in words.
        declare: What the arm file needs for it: a further target's [instrument.NAME].
        notes: What was left out, and why; what was found of clocks.
        lines: (N,) line of the log that each row is of.
        path: The log.
        arm: Text of an arm file, where one of the files describes the arm.
        without_point: Name and line of the log of each row that no target was read in, where any was at all.
    """

    columns: Mapping[str, Sequence[Any]]
    taken: tuple[tuple[str, str, str, str, str], ...]
    joined: str
    declare: str
    notes: tuple[str, ...]
    lines: tuple[int, ...]
    path: Path
    arm: str | None = None
    without_point: tuple[tuple[str, int], ...] = ()

    @property
    def table(self) -> Table:
        """The campaign as a table in SI, as if read from the log."""
        cells = {
            name: tuple(repr(cell) if isinstance(cell, float) else str(cell) for cell in values)
            for name, values in self.columns.items()
        }
        text = csv_text([cells, *zip(*cells.values(), strict=True)])
        columns = {name: Column(name, "", 1.0, texts) for name, texts in cells.items()}
        return Table(self.path, columns, self.lines, hashlib.sha256(text.encode()).hexdigest())


@dataclass
class _Placed:
    """What was read in (N,) rows, export after export.

    Attributes:
        targets: (N, 3) places [m] of each target by label, nan where none was read.
        turned: (N, 4) quaternions x y z w of the first target, of no rows where none has any.
    """

    names: list[str]
    targets: dict[str, Array] = field(default_factory=dict)
    turned: Array = field(default_factory=lambda: np.zeros((0, 4)))
    matches: list[tuple[Record, Match]] = field(default_factory=list)
    hows: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, export: Record, match: Match, joints: Array, alone: bool) -> None:
        """Add an export whose rows belong to those of a log with (N, n) positions `joints`."""
        export, more = _unheld(export, match.row_of, joints)
        self.hows, self.notes = [*self.hows, match.how], [*self.notes, *match.notes, *more]
        self.names, whole = match.names, export.role == "log" or export.part or len(match.row_of) > 1
        self.matches += [(export, match)] if export.role == "export" else []
        for target, rows in match.row_of.items():
            there = (rows >= 0)[:, None]
            places = np.where(there, export.places[rows], np.nan)
            _check_moves(export, places, joints)
            lines = [Place(export.path, export.lines[k]) for k in rows]
            check_one_unit(places, np.flatnonzero(np.isfinite(places).all(axis=1)), lines)
            before = None if whole else self._read_before(places, export)
            four = export.turned() if not self.targets or before == next(iter(self.targets)) else None
            if four is not None:
                others = self.turned if len(self.turned) else np.full((len(rows), 4), np.nan)
                self.turned = np.where(there, four[rows], others)
            if before is not None:
                places = np.where(np.isfinite(places), places, self.targets[before])
                empty = [name for name, place in zip(self.names, places, strict=True) if not np.isfinite(place).all()]
                self.notes = [note for note in self.notes if not note.endswith("rows stay empty")]
                self.notes.append(f"{export.path.name} goes on with the target of the export before it")
                text = f"{listing(empty, 5)} without a point: {len(empty)} of {len(rows)} rows stay empty"
                self.notes += [text] if empty else []
            label = before if before is not None else target if alone else str(len(self.targets) + 1)
            self.targets[label] = places

    def _read_before(self, places: Array, export: Record) -> str | None:
        """Return the target that an export reads on, with no other place in any row; refuse one that it reads again."""
        for target, before in self.targets.items():
            apart = np.linalg.norm(places - before, axis=1)
            both = np.isfinite(apart)
            if not apart[both].any():
                return target
            if apart[both].max() < ONE_TARGET:
                row = int(np.nanargmax(apart))
                text = (
                    f"has {self.names[row]!r}, which another export has {in_mm(apart[row])} from there: leave one out"
                )
                raise TableError(Place(export.path), text)
        return None

    def columns(self, sigma: float | None, sigma_r: float | None) -> dict[str, Sequence[Any]]:
        """Return the columns of places, and of orientations where `sigma_r` [rad] says how well one is measured."""
        columns, count = dict[str, Sequence[Any]](), len(self.names)
        for number, (target, xyz) in enumerate(self.targets.items()):
            head = "" if number == 0 else f"target{target}_"
            columns |= {f"{head}{axis}": _or_empty(values) for axis, values in zip("xyz", _whole(xyz).T, strict=True)}
            columns |= {"sigma": [sigma] * count} if number == 0 else {}
        if len(self.turned) and sigma_r is not None:
            four = _whole(self.turned)
            read = np.isfinite(four)
            vectors = Rotation.from_quat(np.where(read, four, [0.0, 0.0, 0.0, 1.0])).as_rotvec()
            turns = zip(("rx", "ry", "rz"), np.where(read[:, :3], vectors, np.nan).T, strict=True)
            columns |= {axis: _or_empty(values) for axis, values in turns} | {"sigma_r": [sigma_r] * count}
        return columns


def campaign(
    records: Sequence[Record], sigmas: tuple[float | None, float | None], beside: Path, notes: Sequence[str]
) -> Intake:
    """Return the rows of the log with the places, orientations and pictures that belong to them.

    Args:
        records: One log, and exports and pictures of it.
        sigmas: One standard deviation of a coordinate [m], and of an orientation [rad].
        beside: Folder of the campaign.
        notes: What was found of clocks and files.

    Raises:
        TableError: Nothing says which rows are of one another, or a joint has no position.
    """
    log, points = ranked(records)[0], [record for record in ranked(records) if record.has("coordinate")]
    pictures = [record for record in records if record is not log and record.has("picture")]
    joints = log.si("joint")
    for name, values in joints.items():
        for i in np.flatnonzero(~np.isfinite(values))[:1]:
            raise TableError(Place(log.path, log.lines[i]), f"joint {name!r} has no position while the arm stands here")
    cells = log.cells("name")
    names = range(1, len(log.lines) + 1) if cells is None else cells
    placed = _Placed(list(map(str, names)), notes=list(notes))
    for export in points:
        own = Match({"": np.arange(len(placed.names))}, placed.names, "one file: row by row")
        match = own if export is log else matched(log, placed.names, export)
        placed.add(export, match, np.column_stack([*joints.values()]), len(points) < 2)
    path = not points and not pictures and not log.has("picture")
    columns: dict[str, Sequence[Any]] = {"via" if path else "pose": placed.names}
    columns |= {meaning.name: list(map(str, cells)) for meaning, cells in log.of("kept")}
    time, about = _time(log, path)
    columns |= time | {f"q_{name}": values.tolist() for name, values in joints.items()}
    columns |= placed.columns(*sigmas)
    placed.notes += about
    if len(placed.turned) and sigmas[1] is None:
        placed.notes.append("orientations of the target are not used: --sigma-r 0.5mrad says how well one is measured")
    columns |= {meaning.name: list(map(str, cells)) for meaning, cells in log.of("picture")}
    for record in pictures:
        match = matched(log, placed.names, record)
        placed.hows.append(f"pictures {match.how}")
        placed.notes += match.notes
        meaning, cells = next(record.of("picture"))
        folder = Path(os.path.relpath(record.path, beside)) if record.path.is_dir() else Path()
        columns[meaning.name] = [(folder / str(cells[k])).as_posix() if k >= 0 else "" for k in match.row_of[""]]
    for meaning, cells in log.of("covariate"):
        if meaning.name not in columns:  # a socket, a height that was read in some rows
            whole = isinstance(cells, np.ndarray) or np.isfinite(numbers(cells)).all()
            columns[meaning.name] = _or_empty(numbers(cells)) if whole else list(map(str, cells))
    for export, match in placed.matches:
        placed.notes += _add_beside(columns, export, next(iter(match.row_of.values())))
    how = listing(dict.fromkeys(placed.hows)) if placed.hows else "to nothing: each is a via-point"
    declare = "\n".join(
        f'[instrument.target{target}]\nkind = "position"\nlink = "TIP"          # the link that it is on\n'
        f"point = [0.0, 0.0, 0.0]\npoint_std = 0.3       # its place is found\nsigma = {sigmas[0]:g}"
        for target in list(placed.targets)[1:]
    )
    read = [np.isfinite(xyz).all(axis=1) for xyz in placed.targets.values()]
    unread_rows = np.flatnonzero(~np.any(read, axis=0)).tolist() if read else []
    without = tuple((placed.names[i], log.lines[i]) for i in unread_rows)
    notes = tuple(placed.notes)
    return Intake(columns, _taken(records), how, declare, notes, log.lines, log.path, without_point=without)


def _whole(rows: Array) -> Array:
    """Return (N, k) rows, nan in all of those that are not finite."""
    return np.where(np.isfinite(rows).all(axis=1, keepdims=True), rows, np.nan)


def _or_empty(values: Array) -> list[Any]:
    return ["" if np.isnan(value) else value for value in values.tolist()]


def _time(log: Record, path: bool) -> tuple[dict[str, Sequence[Any]], list[str]]:
    """Return the column of times of a log, and what was found of them; a path's begin at 0."""
    time, notes = times(log), list(filter(None, [unread(log)]))
    if time is not None and not (there := np.isfinite(time)).all():
        notes.append(f"times are left out: line {log.lines[int(there.argmin())]} of {log.path.name} has none")
        time = None
    if time is not None and path:
        notes += [f"time 0 is {_clock(log, time)[int(time.argmin())]}"] if time.min() > SINCE_1970 else []
        return {"time": (time - time.min()).tolist()}, notes
    if time is not None:
        return {"time": _clock(log, time)}, notes
    if not path:
        return {}, notes
    notes.append("the log has no times: each row is a second after the one before")
    return {"time": np.arange(len(log.lines), dtype=float).tolist()}, notes


def _clock(record: Record, time: Array) -> list[Any]:
    """Return times [s] as a campaign has them: dates where the clock has them (ISO 8601), else from the first."""
    if not time.min() > SINCE_1970:
        return (time - time.min()).tolist()
    cells = record.cells("time")
    counted = cells is not None and np.isfinite(numbers(cells)).any()  # of Unix: in UTC
    dates = [datetime.fromtimestamp(float(second), UTC) for second in time]
    return [(date if counted else date.replace(tzinfo=None)).isoformat() for date in dates]


def _taken(records: Sequence[Record]) -> tuple[tuple[str, str, str, str, str], ...]:
    used = [record for record in records if record.role or not record.part]
    return tuple(
        (record.title, one.column, in_words(one), one.unit or "", one.why) for record in used for one in record.meant
    )


def _check_moves(export: Record, places: Array, joints: Array) -> None:
    """Raise where (N, 3) places [m] hardly move though most of the joints, (N, n), turn: they are in another unit."""
    read, asked = np.isfinite(places).all(axis=1), any(axis.why == "as asked" for axis, _ in export.of("coordinate"))
    if asked or np.count_nonzero(read) < 2 * FEW:
        return
    moves, turning = float(np.ptp(places[read], axis=0).max()), np.ptp(joints[read], axis=0) > MUCH
    if 0.0 < moves < HARDLY and np.count_nonzero(turning) >= max(FEW, joints.shape[1] / 2):
        axis, _ = next(export.of("coordinate"))
        text = f"{axis.column!r} and the others in {axis.unit} move over {in_mm(moves)} while"
        text += f" {np.count_nonzero(turning)} joints turn by more than {MUCH:g} rad: are they in m?"
        text += f" --take '{axis.column}={axis.name}_m' and so on,"
        raise TableError(Place(export.path), f"{text} or ={axis.name}_{axis.unit} if not")


def _unheld(export: Record, row_of: Mapping[str, np.ndarray], joints: Array) -> tuple[Record, Sequence[str]]:
    """Return an export that is empty where an instrument holds its last place, see `repeated`, and a note of it."""
    places = export.places
    gone = np.zeros(len(places), dtype=bool)
    for rows in row_of.values():
        of_log = np.argsort(rows, kind="stable")[np.count_nonzero(rows < 0) :]
        gone[rows[of_log]] |= repeated(places[rows[of_log]], joints[of_log])
    if not gone.any():
        return export, ()
    export = emptied(export, export.meant, gone, "is exactly where it was before, though joints moved")
    return export, export.notes[-1:]


def _add_beside(columns: dict[str, Sequence[Any]], export: Record, rows: np.ndarray) -> list[str]:
    """Add what an export has beside its readings to a campaign, in (N,) rows of it; return what is left out of it."""
    for meaning, cells in export.of("covariate", "kept"):
        if meaning.name not in columns:
            values, there = numbers(cells)[rows], rows >= 0
            texts = [str(cells[k]) if k >= 0 else "" for k in rows]
            columns[meaning.name] = values.tolist() if (np.isfinite(values) & there).all() else texts
    if "time" not in columns and (rows >= 0).all() and (time := times(export)) is not None:
        clock = _clock(export, time) if np.isfinite(time).all() else None
        columns |= {} if clock is None else {"time": [clock[k] for k in rows]}
    left = [
        f"{meaning.column!r} ({listing(map(said, states), FEW)})" if 1 < len(states) <= FEW else repr(meaning.column)
        for meaning, cells in export.of("unused")
        if meaning.why == "of the instrument"
        for states in [sorted({*map(str, cells)} - {""})]
    ]
    text = f"{listing(left, 8)} of {export.title} left out, as of the instrument: --take 'COLUMN=NAME' keeps one"
    return [text] if left else []
