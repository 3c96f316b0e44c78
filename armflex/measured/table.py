"""Tables from CSV or Parquet: read whole or refused with file, line and column; units are converted once."""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from armflex.conventions import LARGEST, NUMBER, UNITS, Array, unprintable
from armflex.errors import Frame, Place, TableError, UnknownNameError, did_you_mean, listing, shown
from armflex.measured.parquet import SUFFIXES, parquet_rows
from armflex.storage.whole_file import writing

if TYPE_CHECKING:
    from pandas import DataFrame

    from armflex.arm import Arm

Tabular: TypeAlias = "str | Path | DataFrame"
"""Where a table is: the name of a file, CSV or Parquet, or a pandas data frame of the same columns."""

MAX_BYTES = 200_000_000
BLOCK = 1 << 20
"""Letters of a file that are looked at together."""

IN_BRACKETS = re.compile(r"(.*\S)\s*[\[(]\s*([^\[\]()]+?)\s*[\])]")
"""A header that gives its unit as others do: `L [mm]`."""

PLAIN = "0123456789+-.eE "
"""Letters of which all that `float()` takes is a `NUMBER` as well, but for blanks about it."""

BEYOND = f"beyond {LARGEST:g}"
"""What is said of a number that is larger than any."""

NOTHING = ("nan", "na", "n/a", "null", "none", "-", "--")
"""What others write into a cell where there is nothing."""


@dataclass(frozen=True)
class Column:
    """A column's text as written, the unit its header names ('' for none), and the factor to SI."""

    header: str
    unit: str
    factor: float
    cells: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A table: columns by name without unit suffix, and the line of each row (of all but CSV: as if it were CSV)."""

    path: Path | Frame
    columns: Mapping[str, Column]
    lines: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.lines)

    @property
    def sha256(self) -> str:
        """Of the file, or of what the data frame holds."""
        if isinstance(self.path, Frame):
            return self.path.sha256
        return hashlib.sha256(self.path.read_bytes()).hexdigest()

    def numbers(self, name: str, beyond: str = BEYOND, hint: str = "") -> Array:
        """Return a column in SI; raise `TableError` naming the first cell that is no finite number up to `LARGEST`.

        `beyond` is what is said of a larger one, `hint` what is added of a word for nothing, such as nan.
        """
        column, plain = self.columns[name], self.plain(name)
        if plain is not None:
            return plain
        for line, cell in zip(self.lines, column.cells, strict=True):
            number = float(cell) if NUMBER.fullmatch(cell.strip()) else np.nan
            if not abs(number) <= LARGEST:
                kind = beyond if np.isfinite(number) else "not a finite number"
                what = f"is {shown(cell)}, {kind}" if cell.strip() else "is empty"
                what += hint if cell.strip().lower() in NOTHING else ""
                raise TableError(Place(self.path, line), f"column {column.header!r} {what}")
        return np.array([float(cell) for cell in column.cells]) * column.factor

    def plain(self, name: str) -> Array | None:
        """Return a column in SI where every cell is a plain number, all of them at once; None where one may not be."""
        column = self.columns[name]
        try:
            values = np.array([*map(float, column.cells)])
        except ValueError:
            return None
        fine = not "".join(column.cells).strip(PLAIN) and (np.abs(values) <= LARGEST).all()
        return values * column.factor if fine else None

    def numbers_where(self, name: str, rows: np.ndarray, hint: str = "") -> Array:
        """Return a column in SI at the rows of a (N,) mask, zero elsewhere; the other cells are not looked at.

        `hint` is as for `numbers`.
        """
        column = self.columns[name]
        kept = tuple(cell if row else "0" for cell, row in zip(column.cells, rows, strict=True))
        return replace(self, columns={name: replace(column, cells=kept)}).numbers(name, hint=hint)

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
            hint = did_you_mean(missing[0], [name for name in self.columns if name not in expected])
            seen = f"expected: {listing(expected)}; found: {listing(self.columns)}"
            raise TableError(Place(self.path, 1), f"has no column {listing(map(repr, missing))}{hint} ({seen})")


def read_table(path: Tabular, kinds: Mapping[str, str]) -> Table:
    """Read a CSV file with a header row, a Parquet file (`.parquet`) or a data frame, whose nulls are empty cells.

    Args:
        path: The file, CSV is UTF-8, comma separated; or a pandas data frame, whose columns are named as the file's.
        kinds: Kind of quantity ('length', 'angle', ...; see `UNITS`) of each column that may carry a unit suffix.

    Raises:
        TableError: Missing, empty, too large, not UTF-8, not comma separated, without header, a duplicate column, a
            row of the wrong length, a unit of the wrong kind, or Parquet where pyarrow is not installed.
    """
    if not isinstance(path, str | Path):
        frame, found = _frame_rows(path)
        return next(_tables(frame, kinds, found, None))
    return next(_tables(Path(path), kinds, iter(list(_rows(Path(path), None))), None))


def read_pieces(path: str | Path, kinds: Mapping[str, str], rows: int) -> Iterator[Table]:
    """Yield a table some rows at a time, as `read_table` reads it whole; one without rows where the file has none."""
    yield from _tables(Path(path), kinds, _rows(Path(path), rows), rows)


def _frame_rows(table: DataFrame) -> tuple[Frame, Iterator[tuple[int, list[str]]]]:
    """Return a data frame as a source, and its rows of text, header first, as `_rows` gives those of a file."""
    if hasattr(table, "to_pandas"):
        raise TableError(Place(Frame((), "")), "expected a data frame of pandas: to_pandas() makes one of others")
    if not hasattr(table, "iloc"):
        raise TypeError(f"expected the path of a table or a data frame, got {table!r}")
    header, columns = [str(name) for name in table.columns], []
    for i, name in enumerate(header):
        missing = table.iloc[:, i].isna()
        columns.append(["" if no else _cell(name, value) for no, value in zip(missing, table.iloc[:, i], strict=True)])
    rows = [header, *(list(cells) for cells in zip(*columns, strict=True))]
    text = "\n".join("\0".join(cells) for cells in rows)
    frame = Frame(tuple(table.index), hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest())
    for line, cells in enumerate(rows, 1):
        if found := next(filter(None, map(unprintable, cells)), None):
            raise TableError(Place(frame, line), found[1])
    return frame, ((line, cells) for line, cells in enumerate(rows, 1) if any(map(str.strip, cells)))


def _cell(column: str, value: object) -> str:
    """Return a value of a data frame as a file has it, no digit lost."""
    if isinstance(value, float | np.floating):
        return repr(float(value))
    if isinstance(value, bool | int | str | np.integer | np.bool_) or hasattr(value, "isoformat"):
        return value.isoformat() if hasattr(value, "isoformat") else str(value)  # pyright: ignore
    what = f"column {column!r} holds {shown(value, 60)}, expected numbers and texts"
    raise TableError(Place(Frame((), "")), what)


def _tables(
    path: Path | Frame, kinds: Mapping[str, str], rows: Iterator[tuple[int, list[str]]], most: int | None
) -> Iterator[Table]:
    _, header = next(rows, (0, None))
    if header is None:
        raise TableError(Place(path), f"is empty, expected a header row with columns such as {listing(kinds)}")
    _check_header(path, header, kinds)
    body = list(islice(rows, most))
    while True:
        for line, cells in body:
            if len(cells) != len(header):
                raise TableError(Place(path, line), f"has {len(cells)} cells, the header has {len(header)}")
        columns: dict[str, Column] = {}
        texts = list(zip(*(cells for _, cells in body), strict=True)) or [()] * len(header)
        for name, cells in zip(header, texts, strict=True):
            base, unit, factor = _split_unit(path, name, kinds)
            if base in columns:
                raise TableError(Place(path, 1), f"two columns mean {base!r}: {columns[base].header!r} and {name!r}")
            columns[base] = Column(name, unit, factor, cells)
        yield Table(path, columns, tuple(line for line, _ in body))
        body = list(islice(rows, most))
        if not body:
            return


def _rows(path: Path, most: int | None) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the cells of every row that is not blank, header first."""
    if path.suffix.lower() in SUFFIXES:
        yield from parquet_rows(path, most)
        return
    reader = csv.reader(text_lines(path), strict=True)
    try:
        for cells in reader:
            if any(map(str.strip, cells)):
                yield reader.line_num, cells
    except csv.Error as error:
        raise TableError(Place(path, reader.line_num), f"is not CSV: {error}") from None


def text_lines(path: Path) -> Iterator[str]:
    """Yield the lines of a file, the end of each included; raise where it is no text that can be shown."""
    line = 1
    try:
        if path.stat().st_size > MAX_BYTES:
            raise TableError(Place(path), f"is larger than the {MAX_BYTES} bytes allowed")
        with open(path, encoding="utf-8-sig", newline="\n") as file:
            while some := file.readlines(BLOCK):
                if found := unprintable(text := "".join(some)):
                    raise TableError(Place(path, line + text.count("\n", 0, found[0])), found[1])
                line += len(some)
                yield from some
    except OSError as error:
        raise TableError(Place(path), f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise TableError(Place(path), "is not UTF-8 text") from None


def _check_header(path: Path | Frame, header: list[str], expected: Iterable[str]) -> None:
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


def _split_unit(path: Path | Frame, header: str, kinds: Mapping[str, str]) -> tuple[str, str, float]:
    name = header.strip()
    if name in kinds:
        return name, "", 1.0
    bracketed = IN_BRACKETS.fullmatch(name)
    base, unit = bracketed.groups() if bracketed else (name.rpartition("_")[0], name.rpartition("_")[2])
    if base not in kinds:
        return name, "", 1.0
    units = UNITS[kinds[base]]
    if unit not in units:
        hint = f"{did_you_mean(unit, units)} ({', '.join(units)})"
        raise TableError(Place(path, 1), f"column {name!r}: {unit!r} is no unit of {kinds[base]}{hint}")
    return base, unit, units[unit]


def write_table(path: str | Path, columns: Mapping[str, Sequence[object]]) -> Path:
    """Write columns as CSV, whole or not at all; floats keep every digit."""
    with writing_table(path) as write:
        write(columns)
    return Path(path)


@contextmanager
def writing_table(path: str | Path) -> Iterator[Callable[[Mapping[str, Sequence[object]]], None]]:
    """Yield a function that adds rows, by columns, to a CSV file; the first ones name them.

    The file is there once the block ends well; see `writing`.
    """
    with writing(Path(path)) as file:
        named = False

        def write(columns: Mapping[str, Sequence[object]]) -> None:
            nonlocal named
            text = io.StringIO()
            writer = csv.writer(text, lineterminator="\n")
            writer.writerows([] if named else [columns])
            named = True
            rows = zip(*columns.values(), strict=True)
            writer.writerows([float(cell) if isinstance(cell, float) else cell for cell in row] for row in rows)
            file.write(text.getvalue().encode())

        yield write


def joint_kinds(arm: Arm, prefixes: str) -> dict[str, str]:
    """Return the kind of quantity of each joint's columns, such as q_A1 and v_A1 for prefixes "qv".

    Joints off the chain have positions alone.
    """
    beside = [(arm.robot.urdf.joints[name], "q") for name in arm.robot.locked if "q" in prefixes]
    return {
        f"{prefix}_{joint.name}": "length" if joint.kind == "prismatic" else "angle"
        for joint, some in (*((joint, prefixes) for joint in arm.robot.moving), *beside)
        for prefix in some
    }


def check_payloads(table: Table, payload: tuple[str, ...], arm: Arm) -> None:
    """Raise `TableError` naming the first row whose payload the arm does not know; an empty cell is none."""
    first = dict(zip(reversed(payload), reversed(table.lines), strict=True))
    for name in dict.fromkeys(payload):
        try:
            arm.payload(name or "none")
        except UnknownNameError as error:
            raise TableError(Place(table.path, first[name]), str(error)) from None
