"""Tables from CSV, Excel or Parquet: read whole or refused with file, line and column; units are converted once.

CSV comes as programs of all countries write it: with commas, semicolons or tabs, decimal commas where the cells are not
separated by commas, in UTF-8, UTF-16 or Windows-1252. It is written with commas and points, in UTF-8, and so that a
spreadsheet takes no text for a formula.
"""

from __future__ import annotations

import codecs
import csv
import difflib
import hashlib
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from armflex.arm import warn
from armflex.conventions import LARGEST, NUMBER, UNITS, Array, no_unit, unprintable
from armflex.errors import Flag, Frame, Place, TableError, UnknownNameError, did_you_mean, listing, shown
from armflex.laws.effects.in_arm import depended_on
from armflex.measured import parquet, spreadsheet
from armflex.rows.rows import APPROACH, LEVEL_OF
from armflex.storage.read_file import read_file, reading
from armflex.storage.whole_file import writing

if TYPE_CHECKING:
    from pandas import DataFrame

    from armflex.arm import Arm

Tabular: TypeAlias = "str | Path | DataFrame | Table"
"""Where a table is: the name of a file, CSV or Parquet, a pandas data frame of the same columns, or a table as read."""

MAX_BYTES = 200_000_000
BLOCK = 1 << 20
"""Letters of a file that are looked at together."""

IN_BRACKETS = re.compile(r"(.*\S)\s*[\[(]\s*([^\[\]()]+?)\s*[\])]")
"""A header that states its unit as others do: `L [mm]`."""

DECIMAL_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+(?:[eE][-+]?[0-9]+)?")
"""A number as it is written where cells are not separated by commas."""

FORMULA = re.compile("'*[-=+@\t\r]")
"""What a text begins with that a spreadsheet may take for a formula, and run; an apostrophe before it says that it is a
text."""

DIGITS = re.compile("[0-9]+")
"""What parts the names of columns of one kind."""

SHORTEST = 4
"""Letters from which on a word of a covariate's name is misspelt rather than another word."""

PLAIN = "0123456789+-.eE "
"""Letters of which all that `float()` takes is a `NUMBER` as well, but for blanks about it."""

CLOCKS = ("hms", "dms")
"""Units whose cells are hours or degrees, minutes and seconds: `-01:23:45.6`, with colons or blanks."""

SEXAGESIMAL = re.compile(r"([-+]?)([0-9]{1,3})[:\s]+([0-5]?[0-9])(?:[:\s]+([0-5]?[0-9](?:\.[0-9]*)?))?")

TITLES = 20
"""Lines among which the header is."""

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
    """A table: columns by name without unit suffix, and the line of each row (of all but CSV: as if it were CSV).

    `digest` is of what it was made from, where that is not the file alone.
    """

    path: Path | Frame
    columns: Mapping[str, Column]
    lines: tuple[int, ...]
    digest: str = ""

    def __len__(self) -> int:
        return len(self.lines)

    @property
    def units(self) -> dict[str, str]:
        """The unit of each column whose header states one, by its name."""
        return {name: column.unit for name, column in self.columns.items() if column.unit}

    @property
    def sha256(self) -> str:
        """Of the file, or of what the data frame or the stream holds."""
        if self.digest:
            return self.digest
        if isinstance(self.path, Frame):
            return self.path.sha256
        if not self.path.is_file():  # a stream, which is read once
            cells = [(name, column.unit, column.cells) for name, column in self.columns.items()]
            return hashlib.sha256(repr(cells).encode()).hexdigest()
        return hashlib.sha256(read_file(self.path, MAX_BYTES)).hexdigest()

    def fail(self, problem: str, row: int | np.integer | None = None) -> TableError:
        """Return the error that says what is wrong with a row, or with the header where none is named."""
        return TableError(Place(self.path, 1 if row is None else self.lines[row]), problem)

    def given(self, names: Sequence[str], hint: str = "") -> np.ndarray:
        """Return (N,) in which rows the cells of some columns are all given; raise `TableError` where only some are."""
        cells = np.array([[bool(cell) for cell in self.texts(name)] for name in names]).T
        there = np.all(cells, axis=1)
        for row in np.flatnonzero(np.any(cells, axis=1) & ~there)[:1]:
            raise self.fail(f"only some of {', '.join(names)} are given{hint}", row)
        return there

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
                what += ": a decimal comma? Numbers have points" if DECIMAL_COMMA.fullmatch(cell.strip()) else ""
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
            joints = {name.removeprefix("q_"): name for name in missing if name.startswith("q_")}
            plain = [name for name in self.columns if re.split(r"[_ \[]", name)[0] in joints]
            of_arm = {"", *(name.removeprefix("q_") for name in expected)}
            parts = {name: re.split(r"\s*[-+*/]\s*", name.replace("q_", "")) for name in self.columns}
            parts = {name: {re.split(r"[_ \[]", text)[0] for text in texts} for name, texts in parts.items()}
            computed = [
                name
                for name, words in parts.items()
                if words & joints.keys()
                and re.search(r"[-+*/]", name)
                and all(w in of_arm or w.isdigit() for w in words)
            ]
            if computed:
                hint = f": {computed[0]!r} is computed of joints, and each has a column by itself"
            elif plain:  # a table of a controller or of a spreadsheet
                joint = re.split(r"[_ \[]", plain[0])[0]
                hint = f": {plain[0]!r} is to be called {plain[0].replace(joint, joints[joint], 1)!r}, and so on"
            seen = f"expected: {listing(expected)}; found: {listing(self.columns)}"
            raise TableError(Place(self.path, 1), f"has no column {listing(map(repr, missing))}{hint} ({seen})")


def read_table(path: Tabular, kinds: Mapping[str, str], any_case: bool = False) -> Table:
    """Read a CSV file with a header row, one of Parquet or Excel, or a data frame, whose nulls are empty cells.

    Args:
        path: The file; or a pandas data frame, whose columns are named as the file's.
        kinds: Kind of quantity ('length', 'angle', ...; see `UNITS`) of each column that may carry a unit suffix.
        any_case: Whether a header may have these names, which are small, and units in capitals or small.

    Raises:
        TableError: Missing, empty, too large, no text, without header, a duplicate column, a row of the wrong length, a
            unit of the wrong kind, or Parquet or Excel where pyarrow or openpyxl is not installed.
    """
    if isinstance(path, Table):
        return path
    if not isinstance(path, str | Path):
        frame, rows = _frame_rows(path)
        return next(_tables(frame, kinds, rows, None, any_case))
    return next(_tables(Path(path), kinds, iter(list(_rows(Path(path), None, kinds))), None, any_case))


def read_pieces(path: str | Path, kinds: Mapping[str, str], rows: int) -> Iterator[Table]:
    """Yield a table some rows at a time, as `read_table` reads it whole; one without rows where the file has none."""
    yield from _tables(Path(path), kinds, _rows(Path(path), rows, kinds), rows)


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
        if bad := next(filter(None, map(unprintable, cells)), None):
            raise TableError(Place(frame, line), bad[1])
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
    path: Path | Frame,
    kinds: Mapping[str, str],
    rows: Iterator[tuple[int, list[str]]],
    most: int | None,
    any_case: bool = False,
) -> Iterator[Table]:
    _, header = next(rows, (0, None))
    if header is None:
        raise TableError(Place(path), f"is empty, expected a header row with columns such as {listing(kinds)}")
    numbers = sum(bool(NUMBER.fullmatch(cell.strip())) for cell in header)
    if 2 * numbers >= len(header):
        wanted = f"expected columns such as {listing(kinds)}; found: {listing(header)}"
        raise TableError(Place(path, 1), f"has no header row: {numbers} cells of the first row are numbers ({wanted})")
    blank = [str(index + 1) for index, cell in enumerate(header) if not cell.strip()]
    if blank:
        raise TableError(Place(path, 1), f"column {', '.join(blank)} has no name")
    body = list(islice(rows, most))
    while True:
        for line, cells in body:
            if len(cells) != len(header):
                raise TableError(Place(path, line), f"has {len(cells)} cells, the header has {len(header)}")
        columns: dict[str, Column] = {}
        texts = list(zip(*(cells for _, cells in body), strict=True)) or [()] * len(header)
        for name, cells in zip(header, texts, strict=True):
            base, unit, factor = _split_unit(path, name, kinds, any_case)
            if base in columns:
                raise TableError(Place(path, 1), f"two columns mean {base!r}: {columns[base].header!r} and {name!r}")
            columns[base] = Column(name, unit, factor, tuple(map(in_decimals, cells)) if unit in CLOCKS else cells)
        yield Table(path, columns, tuple(line for line, _ in body))
        body = list(islice(rows, most))
        if not body:
            return


def _rows(path: Path, most: int | None, kinds: Mapping[str, str]) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the cells of every row that is not blank, header first; titles before it are left out."""
    if path.suffix.lower() in parquet.SUFFIXES:
        yield from parquet.parquet_rows(path, most)
        return
    if path.suffix.lower() in spreadsheet.SUFFIXES:
        sheet = spreadsheet.sheet_rows(path)
        begin = list(islice(sheet, TITLES))
        yield from chain(begin[_titles(path, [cells for _, cells in begin], kinds) :], sheet)
        return
    source, marked = text_lines(path), False
    begin = list(islice(source, TITLES))
    before = _titles(path, [re.split("[,;\t]", line) for line in begin], kinds)
    lines, first = chain(begin[before:], source), ""
    while not first.strip() and (line := next(lines, None)) is not None:
        first, before = line, before + 1
        if first.strip().lower() in ("sep=,", "sep=;"):  # what Excel says to itself
            first = ""
    head = [first]
    quotes = first.count('"')
    while quotes % 2 and len(head) < 100 and (line := next(lines, None)) is not None:
        head.append(line)  # a name goes on in the next line
        quotes += line.count('"')
    second = next(lines, "")
    # A name may have another mark in it, and numbers a decimal comma: what separates is in both rows.
    both = ("".join(head), second if second.strip() else first) if quotes % 2 == 0 else (first, first)
    header, row = (re.sub(r'"[^"]*"', "", text) for text in both)
    separator = max(",;\t", key=lambda mark: min(header.count(mark), row.count(mark)))

    def watched() -> Iterator[str]:
        nonlocal marked
        for line in chain(head, (second,), lines):
            marked = marked or "'" in line
            yield line

    reader, mark = csv.reader(watched(), strict=True, delimiter=separator), ""
    try:
        for cells in reader:
            if not any(map(str.strip, cells)):
                continue
            line = reader.line_num + before - 1
            if marked:
                cells = [cell[1:] if cell[:1] == "'" and FORMULA.match(cell) else cell for cell in cells]
                marked = False
            if separator != ",":
                cells, mark = _with_points(path, line, cells, mark)
            yield line, cells
    except csv.Error as error:
        raise TableError(Place(path, reader.line_num + before - 1), f"is not CSV: {error}") from None


def _titles(path: Path, rows: Sequence[Sequence[str]], kinds: Mapping[str, str]) -> int:
    """Return how many rows a file begins with before its header: the first that names two columns, none before any."""
    names = [[cell.strip().strip('"') for cell in cells] for cells in rows]
    columns = {name.lower() for name in kinds}
    counts = [sum(bool({name.lower(), split_header(name)[0].lower()} & columns) for name in row) for row in names]
    header = next((row for row, count in enumerate(counts) if count > 1), 0)
    if any(counts[:header]):
        return 0
    if title := next(filter(None, map(" ".join, names[:header])), ""):
        warn([Flag("title", f"{Place(path, 1)}: not read, a title before the header: {shown(title, 40)}")])
    return header


def _with_points(path: Path, line: int, cells: list[str], mark: str) -> tuple[list[str], str]:
    """Return cells with decimal points, and the mark of the file: that before, or theirs; raise where both are used."""
    for i, cell in enumerate(cells):
        comma = bool(DECIMAL_COMMA.fullmatch(cell.strip()))
        point = "," if comma else "." if "." in cell and NUMBER.fullmatch(cell.strip()) else mark
        if mark and point != mark:
            kinds = ("comma", "point") if comma else ("point", "comma")
            text = "holds {} with a decimal {} where numbers before it have a {}".format(shown(cell, 40), *kinds)
            raise TableError(Place(path, line), text)
        cells[i], mark = (cell.replace(",", ".") if comma else cell), point
    return cells, mark


PACKED = {
    b"\x1f\x8b": "packed with gzip (unpack it: gunzip)",
    b"PK\x03\x04": "a ZIP archive or a workbook (unpack it, or call it .xlsx)",
    b"\x28\xb5\x2f\xfd": "packed with Zstandard (unpack it: unzstd)",
    b"BZh": "packed with bzip2 (unpack it: bunzip2)",
    b"\xd0\xcf\x11\xe0": "an old workbook, .xls (save it as .xlsx or CSV)",
    b"%PDF": "a PDF file (export CSV)",
}
"""How files begin that people take for tables, and what to do with them."""


def text_lines(path: Path) -> Iterator[str]:
    """Yield the lines of a file, the end of each included; raise where it is no text that can be shown."""
    line, encoding, wide = 1, "utf-8-sig", False
    try:
        with reading(path, MAX_BYTES) as file:
            source: Any = file
            if packed := next((kind for start, kind in PACKED.items() if file.peek(8).startswith(start)), ""):
                raise TableError(Place(path), f"is {packed}, and no text")
            if file.peek(2)[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
                source = io.TextIOWrapper(file, encoding="utf-16", newline="\n")
            while lines := source.readlines(BLOCK):
                if source is file:
                    block = b"".join(lines)
                    letters = block.decode("utf-8", "ignore")
                    if encoding != "cp1252" and len(letters.encode()) < len(block):
                        if wide or not letters.isascii():
                            raise TableError(Place(path), "is UTF-8 text in part only: save it anew as UTF-8")
                        encoding = "cp1252"
                        block.decode(encoding)
                        warn([Flag("encoding", f"{path} is not UTF-8: its letters are taken as those of Windows-1252")])
                    wide = wide or not letters.isascii()
                    lines = [raw.decode(encoding) for raw in lines]
                    encoding = "utf-8" if encoding == "utf-8-sig" else encoding
                if bad := unprintable(text := "".join(lines)):
                    raise TableError(Place(path, line + text.count("\n", 0, bad[0])), bad[1])
                line += len(lines)
                old = len(lines) == 1 and "\r" in lines[0].rstrip("\r\n")  # ends of lines as a Mac once wrote them
                yield from re.findall(r"[^\r]*\r?\n?", lines[0])[:-1] if old else lines
    except OSError as error:
        raise TableError(Place(path), f"cannot be read: {error.strerror}") from None
    except UnicodeError:
        raise TableError(Place(path), "is not UTF-8 text, nor UTF-16 or Windows-1252") from None


def split_header(name: str) -> tuple[str, str]:
    """Return what of a header may be a name, and what its unit: `L_mm`, `L [mm]`."""
    bracketed = IN_BRACKETS.fullmatch(name)
    base, unit = bracketed.groups() if bracketed else (name.rpartition("_")[0], name.rpartition("_")[2])
    return base, unit


def _without_unit(name: str) -> str:
    """Return a column's name without the unit of any kind that it ends with."""
    base, unit = split_header(name)
    return base if base and any(unit in units for units in UNITS.values()) else name


def in_decimals(cell: str) -> str:
    """Return hours or degrees of a cell with their minutes and seconds; any other cell as it is."""
    match = SEXAGESIMAL.fullmatch(cell.strip())
    if match is None:
        return cell
    sign, whole, minutes, seconds = match.groups()
    return f"{sign}{(float(whole) + float(minutes) / 60.0 + float(seconds or 0.0) / 3600.0)!r}"


def _split_unit(path: Path | Frame, header: str, kinds: Mapping[str, str], any_case: bool) -> tuple[str, str, float]:
    name = header.strip()
    whole, (base, unit) = name, split_header(name)
    if any_case:
        whole, base = name.lower(), base.lower()
    if whole in kinds:
        return whole, "", 1.0
    if base not in kinds:
        return name, "", 1.0
    units = UNITS[kinds[base]]
    if any_case and unit not in units:
        unit = next((other for other in units if other.lower() == unit.lower()), unit)
    if unit not in units:
        raise TableError(Place(path, 1), f"column {name!r}: {no_unit(unit, kinds[base])}")
    return base, unit, units[unit]


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV. Floats keep every digit; a text that a spreadsheet could run has an apostrophe before it."""
    lines = _Lines()
    plain = csv.writer(lines, lineterminator="\r\n")
    for row in map(list, rows):
        runs = [isinstance(cell, str) and FORMULA.match(cell) and not NUMBER.fullmatch(cell.strip()) for cell in row]
        pairs = zip(row, runs, strict=True)
        plain.writerow([f"'{cell}" if run else float(cell) if isinstance(cell, float) else cell for cell, run in pairs])
    return "".join(lines)


class _Lines(list[str]):
    """Lines that end as ours do. The module quotes only what its own line ends hold, and a text may hold either."""

    def write(self, line: str) -> None:
        self.append(f"{line[:-2]}\n")


def write_table(path: str | Path, columns: Mapping[str, Sequence[object]]) -> Path:
    """Write columns as CSV, whole or not at all; see `csv_text`."""
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
            rows = zip(*columns.values(), strict=True)
            file.write(csv_text(rows if named else [[*columns], *rows]).encode())
            named = True

        yield write


def joint_kinds(arm: Arm, prefixes: str) -> dict[str, str]:
    """Return the kind of quantity of each joint's columns, such as q_A1 and v_A1 for prefixes "qv".

    Joints off the chain have positions alone.
    """
    beside = [(arm.robot.urdf.joints[name], "q") for name in arm.robot.locked if "q" in prefixes]
    return {
        f"{prefix}_{joint.name}": "length" if joint.kind == "prismatic" else "angle"
        for joint, letters in (*((joint, prefixes) for joint in arm.robot.moving), *beside)
        for prefix in letters
    }


def check_same_arm(table: Table, arm: Arm) -> None:
    """Raise `TableError` where over half of the joints have no column, and as many columns are of unknown joints.

    Names that differ in capitals, with a unit or without, and single ones, are misspelt rather than another arm's.
    """
    joints = arm.joint_names
    meant_by = {name: {name.lower(), split_header(name)[0].lower()} for name in table.columns if name.startswith("q_")}
    expected = {f"q_{name}".lower() for name in (*joints, *arm.robot.locked)}
    foreign = [name for name, meant in meant_by.items() if expected.isdisjoint(meant)]
    there = set().union(*meant_by.values())
    missing = [name for name in joints if f"q_{name}".lower() not in there]
    if min(len(missing), len(foreign)) > max(len(joints) / 2.0, 1.0):
        text = f"seems to be of another arm: it has {listing(foreign)}"
        raise table.fail(f"{text}, and the joints of {arm.robot.urdf.name!r} are called {listing(joints)}")


def misspelt(name: str, names: Iterable[str], likeness: float = 0.75) -> bool:
    """Return whether a column's name is so near to one with a meaning that it counts as a mistake.

    That is where their likeness as of `difflib` is as large, or two neighbouring letters are exchanged.
    """
    name, lowered = name.lower(), [known_name.lower() for known_name in names]
    exchanged = {name[:i] + name[i + 1] + name[i] + name[i + 2 :] for i in range(len(name) - 1)}
    return bool(difflib.get_close_matches(name, lowered, n=1, cutoff=likeness)) or not exchanged.isdisjoint(lowered)


def check_unknown(
    table: Table, names: Iterable[str], recognised: Sequence[str], joints: Sequence[str], recorded: bool = False
) -> None:
    """Raise `TableError` at a column without a meaning whose name is one of the `recognised` ones misspelt.

    What was `recorded` may have positions of joints that the arm does not have, and any further column beside
    readings may be a cause; a path may not, and has no use for a column that is cut short or misspelt before its unit.
    A joint in the name of a column is no likeness: `speed_elbow` is recorded beside `q_elbow`. Of such a name the word
    before the joint counts, and the joint only where that word is one of the known columns'.
    """
    of_joints = {name: joint for name in recognised for joint in joints if name.endswith(f"_{joint}")}
    before = {name.removesuffix(f"_{joint}") for name, joint in of_joints.items()}
    long = [word for word in before if len(word) >= SHORTEST]
    plain, squeezed = [name for name in recognised if name not in of_joints], {_squeezed(name) for name in recognised}
    words = [name for name in plain if "_" not in name and len(name) > 2]
    digitless = {DIGITS.sub("", joint.lower()) for joint in joints}
    for name in names:
        word, _, rest = name.partition("_")
        meant = word.lower() in before or misspelt(word, long)
        meant = meant and (misspelt(rest, joints) or DIGITS.sub("", rest.lower()) in digitless)
        other = name.startswith("q_") and not recorded
        meant = meant or other or _squeezed(name) in squeezed
        base = name if recorded else _without_unit(name)
        meant = meant or (base != name and base in plain) or any(is_nearly(base, other_name) for other_name in plain)
        meant = meant or (not recorded and len(base) > 2 and any(other_name.startswith(base) for other_name in words))
        if meant or (not DIGITS.search(name) and misspelt(base, words, 0.85)):
            hint = did_you_mean(base, recognised) or (f": the arm's joints are {listing(joints)}" if other else "")
            raise table.fail(f"unknown column {table.columns[name].header!r}{hint}")


def other_joints(table: Table, arm: Arm) -> list[str]:
    """Return columns of positions of joints that the arm does not have, such as those of a gripper in the same log."""
    columns_of_arm = {f"q_{joint}" for joint in (*arm.joint_names, *arm.robot.locked)}
    return [name for name in table.columns if name.startswith("q_") and name not in columns_of_arm]


def _squeezed(name: str) -> str:
    """Return the letters and digits of a name, small."""
    return re.sub(r"[\W_]", "", name).lower()


def asked_columns(arm: Arm) -> tuple[str, ...]:
    """Return the columns that an arm's effects depend on, those of its joints left out; of a level its column."""
    return tuple(dict.fromkeys(name.partition(LEVEL_OF)[0] for name in depended_on(arm)))


def check_asked(table: Table, arm: Arm, others: Sequence[str]) -> None:
    """Raise `TableError` where a column that effects depend on is not there, and one of the `others` is that misspelt.

    `others` have no meaning of their own. One that has the name in it, or other digits, is a column by itself, such as
    temperature_2 beside temperature, and a direction has a joint's name.
    """
    named, present = [name for name in others if not name.startswith(APPROACH)], set(table.columns)
    for asked in asked_columns(arm):
        for name in named if asked not in present else ():
            if is_nearly(name, asked):
                text = f"column {table.columns[name].header!r}, did you mean {asked!r}? The arm's effects depend on it"
                raise table.fail(text)


def is_nearly(name: str, other: str) -> bool:
    """Return whether a name of a covariate is another one misspelt: in capitals, in its `_`, or in one of its words.

    A short word is another one rather than misspelt, as in pressure_a beside pressure_b. So is one that is lengthened,
    but for a plural, or has other digits.
    """
    name, other = name.lower(), other.lower()
    if name.replace("_", "") == other.replace("_", ""):
        return DIGITS.findall(name) == DIGITS.findall(other)
    words, others = name.split("_"), other.split("_")
    differing = [pair for pair in zip(words, others, strict=False) if pair[0] != pair[1]]
    if len(words) != len(others) or len(differing) != 1:
        return False
    word, meant = differing[0]
    longer = meant in word and word != f"{meant}s"
    if len(meant) < SHORTEST or longer or DIGITS.sub("", word) == DIGITS.sub("", meant):
        return False
    return misspelt(word, [meant], 0.85)


def check_payloads(table: Table, payload: tuple[str, ...], arm: Arm) -> None:
    """Raise `TableError` naming the first row whose payload the arm does not know; an empty cell is none."""
    first = dict(zip(reversed(payload), reversed(table.lines), strict=True))
    for name in dict.fromkeys(payload):
        try:
            arm.payload(name or "none")
        except UnknownNameError as error:
            remedy = f"declare it in the arm file, [payload.{name}] with its mass and com, or leave the cell empty"
            raise TableError(Place(table.path, first[name]), f"{error}: {remedy}") from None
