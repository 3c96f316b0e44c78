"""Tables from CSV or Parquet: read whole or refused with file, line and column; units are converted once."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from armflex.conventions import LARGEST, NUMBER, UNITS, Array
from armflex.errors import Place, TableError, UnknownNameError, did_you_mean, listing, shown
from armflex.measured.parquet import is_parquet, parquet_rows
from armflex.printable import unprintable
from armflex.storage.whole_file import write_whole

if TYPE_CHECKING:
    from armflex.arm import Arm

MAX_BYTES = 200_000_000
BEYOND = f"beyond {LARGEST:g}"
"""What is said of a number that is larger than any."""


@dataclass(frozen=True)
class Column:
    """A column's text as written, the unit its header names ('' for none), and the factor to SI."""

    header: str
    unit: str
    factor: float
    cells: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A table: columns by name without unit suffix, and the line of each row (of a Parquet file: as if it were CSV)."""

    path: Path
    columns: Mapping[str, Column]
    lines: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.lines)

    def numbers(self, name: str, beyond: str = BEYOND) -> Array:
        """Return a column in SI; raise `TableError` naming the first cell that is no finite number up to `LARGEST`.

        `beyond` is what is said of a larger one.
        """
        column = self.columns[name]
        for line, cell in zip(self.lines, column.cells, strict=True):
            number = float(cell) if NUMBER.fullmatch(cell.strip()) else np.nan
            if not abs(number) <= LARGEST:
                kind = beyond if np.isfinite(number) else "not a finite number"
                what = f"is {shown(cell)}, {kind}" if cell.strip() else "is empty"
                raise TableError(Place(self.path, line), f"column {column.header!r} {what}")
        return np.array([float(cell) for cell in column.cells]) * column.factor

    def numbers_where(self, name: str, rows: np.ndarray) -> Array:
        """Return a column in SI at the rows of a (N,) mask, zero elsewhere; the other cells are not looked at."""
        column = self.columns[name]
        kept = tuple(cell if row else "0" for cell, row in zip(column.cells, rows, strict=True))
        return replace(self, columns={name: replace(column, cells=kept)}).numbers(name)

    def matrix(self, names: Sequence[str], beyond: str = BEYOND) -> Array:
        """Return several columns as (N, len(names)) in SI; see `numbers`."""
        return np.column_stack([self.numbers(name, beyond) for name in names]) if names else np.zeros((len(self), 0))

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a column's cells stripped of blanks."""
        return tuple(cell.strip() for cell in self.columns[name].cells)

    def require(self, names: Iterable[str]) -> None:
        """Raise `TableError` listing what is missing, what was expected and found, and the nearest name."""
        expected = list(names)
        missing = [name for name in expected if name not in self.columns]
        if missing:
            hint = did_you_mean(missing[0], self.columns)
            seen = f"expected: {listing(expected)}; found: {listing(self.columns)}"
            raise TableError(Place(self.path, 1), f"has no column {listing(map(repr, missing))}{hint} ({seen})")


def read_table(path: str | Path, kinds: Mapping[str, str]) -> Table:
    """Read a CSV file with a header row, or a Parquet file (`.parquet`), whose nulls are empty cells.

    Args:
        path: The file; CSV is UTF-8, comma separated.
        kinds: Kind of quantity ('length', 'angle', ...; see `UNITS`) of each column that may carry a unit suffix.

    Raises:
        TableError: Missing, empty, too large, not UTF-8, not comma separated, without header, a duplicate column, a
            row of the wrong length, a unit of the wrong kind, or Parquet where pyarrow is not installed.
    """
    path = Path(path)
    rows = parquet_rows(path) if is_parquet(path) else _rows(path)
    if not rows:
        raise TableError(Place(path), f"is empty, expected a header row with columns such as {listing(kinds)}")
    (_, header), body = rows[0], rows[1:]
    _check_header(path, header, kinds)
    for line, cells in body:
        if len(cells) != len(header):
            raise TableError(Place(path, line), f"has {len(cells)} cells, the header has {len(header)}")
    columns: dict[str, Column] = {}
    for index, name in enumerate(header):
        base, unit, factor = _split_unit(path, name, kinds)
        if base in columns:
            raise TableError(Place(path, 1), f"two columns mean {base!r}: {columns[base].header!r} and {name!r}")
        columns[base] = Column(name, unit, factor, tuple(cells[index] for _, cells in body))
    return Table(path, columns, tuple(line for line, _ in body))


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise TableError(Place(path), f"is larger than the {MAX_BYTES} bytes allowed")
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise TableError(Place(path), f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise TableError(Place(path), "is not UTF-8 text") from None
    if found := unprintable(text):
        raise TableError(Place(path, text.count("\n", 0, found[0]) + 1), found[1])
    reader = csv.reader(io.StringIO(text), strict=True)
    try:
        return [(reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells)]
    except csv.Error as error:
        raise TableError(Place(path, reader.line_num), f"is not CSV: {error}") from None


def _check_header(path: Path, header: list[str], expected: Iterable[str]) -> None:
    wanted = f"expected columns such as {listing(expected)}; found: {listing(header)}"
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and mark in header[0]:
            raise TableError(Place(path, 1), f"is separated by {name}, not by commas ({wanted})")
    numbers = sum(bool(NUMBER.fullmatch(cell.strip())) for cell in header)
    if 2 * numbers >= len(header):
        raise TableError(Place(path, 1), f"has no header row: {numbers} cells of the first row are numbers ({wanted})")
    blank = [str(index + 1) for index, cell in enumerate(header) if not cell.strip()]
    if blank:
        raise TableError(Place(path, 1), f"column {', '.join(blank)} has no name")


def _split_unit(path: Path, header: str, kinds: Mapping[str, str]) -> tuple[str, str, float]:
    name = header.strip()
    if name in kinds:
        return name, "", 1.0
    base, _, unit = name.rpartition("_")
    if base not in kinds:
        return name, "", 1.0
    units = UNITS[kinds[base]]
    if unit not in units:
        hint = f"{did_you_mean(unit, units)} ({', '.join(units)})"
        raise TableError(Place(path, 1), f"column {name!r}: {unit!r} is no unit of {kinds[base]}{hint}")
    return base, unit, units[unit]


def write_table(path: str | Path, columns: Mapping[str, Sequence[object]]) -> Path:
    """Write columns as CSV, whole or not at all; floats keep every digit."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for cells in zip(*columns.values(), strict=True):
        writer.writerow([repr(float(cell)) if isinstance(cell, float) else cell for cell in cells])
    return write_whole(Path(path), text.getvalue().encode())


def joint_kinds(arm: Arm, prefixes: str) -> dict[str, str]:
    """Return the kind of quantity of each joint's columns, such as q_A1 and v_A1 for prefixes "qv"."""
    return {
        f"{prefix}_{joint.name}": "length" if joint.kind == "prismatic" else "angle"
        for joint in arm.robot.moving
        for prefix in prefixes
    }


def check_payloads(table: Table, payload: tuple[str, ...], arm: Arm) -> None:
    """Raise `TableError` naming the first row whose payload the arm does not know; an empty cell is none."""
    for line, name in zip(table.lines, payload, strict=True):
        try:
            arm.payload(name or "none")
        except UnknownNameError as error:
            raise TableError(Place(table.path, line), str(error)) from None
