"""A file of rows into columns: separators, decimal commas, comments, titles, missing headers, one axis a line.

What a program recorded by itself (a bag, a motion capture, a controller's trace) is read by `recordings`.
"""

import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias, TypeVar

import numpy as np

from armflex.conventions import NUMBER, UNITS, Array
from armflex.errors import FEW, Place, TableError, listing, shown
from armflex.measured.points import LENGTHS
from armflex.measured.spreadsheet import SUFFIXES, sheet_rows
from armflex.measured.table import text_lines

COMMENT = re.compile(r"\s*(?://|#|%|!)\s*(.*)")
COMMA = re.compile(r"[+-]?(?:\d+|\d{1,3}(?:\.\d{3})+),\d+(?:[eE][+-]?\d+)?")
"""A number with a decimal comma, points between its thousands or none."""

GROUPED = re.compile(r"[+-]?\d{1,3},\d{3}")
"""One that may as well be a whole number with a comma between its thousands."""

AXIS = re.compile(r"(?:.*[ ._\-])?([xyz])", re.IGNORECASE)
MEASURED = re.compile(r"(?:.*\W)?(?:meas|act|ist|(?:ge)?mess|mesur|value|wert)\w*.*", re.IGNORECASE)
"""Header of the column with what was measured, where a line has one coordinate: beside nominal and deviation."""

NAMED = re.compile(r"(?:q_.+|[xyz]|(?:jt?|a|q|joint|axis|achse)[ _.]?\d)(?:[\W_].*)?", re.IGNORECASE)
"""A cell of a header, and of no title: a coordinate or a joint."""

PROGRAM = re.compile(r".*[{}\[\]=;].*")
"""A cell of a program or of nested data, `{A1 10.5`, `movej([0.1`, `"q":[1`: its numbers are not those of a table."""

UNIT = re.compile(r"[\[(][^\])]{0,8}[\])]")
"""A cell below a name that is a unit, whatever it is of."""

LISTED = re.compile(r"[\[(]\s*(.*?)\s*,?\s*[\])]")
BETWEEN = re.compile(r"\s*,\s*|\s+")
"""A cell that holds a list, and what stands between its parts."""

NO_READING = re.compile(
    r"|[-–—.*?]+|[-+]?(?:1\.#)?(?:nan|ind|inf(?:inity)?|qnan|snan)(?:\(.*\))?|none|null|nil|#?n/?a|#value!|#num!|empty|lost"
    r"|missing|invalid|occluded|not (?:visible|found|tracked|valid|measured)|no (?:reading|target|data)|#+|beam broken"
    r"|nicht (?:gemessen|sichtbar|gefunden)|non (?:mesuré|visible|trouvé)|ung[üu]ltig|verdeckt|perdue?|verloren",
    re.IGNORECASE,
)
"""A cell in place of a coordinate that was not read."""

LISTS = re.compile(
    r"(?:\w+\.)*?(?:(?P<message>name|position)|(?P<base>q|posj|jpos|joints?))(?P<unit>[_ ]?[\[(]?[a-z°]*[\])]?)",
    re.IGNORECASE,
)
"""Header of a column whose cells may be the names or positions of all joints."""

THOUSANDS = re.compile(
    r"([+-]?\d{1,3}(?:(['’ \u00a0\u202f])\d{3})(?:\2\d{3})*)([.,]\d+)?|([+-]?\d{1,3}(?:,\d{3})+\.\d+)"
)
"""A number with apostrophes or blanks between its thousands, or commas where a point follows."""

FORTRAN = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))[dD]([+-]?\d{1,3})")
"""A number as Fortran writes one, 0.1D+03."""

MEASURE = re.compile(r"(.*\d[.,]?)\s*(mm|cm|m|in|inch|°|deg)")
"""A number with its unit in the cell."""

UNITS_COLUMN = re.compile(r"(?:length[ _]?)?(?:units?|einheit(?:en)?|unit[ée]s?)", re.IGNORECASE)
"""Header of a column that states the unit of each row."""

PART_OF_DEGREE = r"[0-5]?\d(?:\.\d*)?"
DEGREES = re.compile(
    rf"([-+]?)(\d{{1,3}})\s*(?:[°º]|d(?:eg)?\s*)\s*({PART_OF_DEGREE})\s*(?:['′’]|m(?:in)?)"
    rf"(?:\s*({PART_OF_DEGREE})\s*(?:[\"″”]|''|′′|s(?:ec)?))?",
    re.IGNORECASE,
)
"""Degrees, minutes and seconds with their marks, 12°34'56"."""

PARTED = re.compile(rf"([-+]?)(\d{{1,3}})(?:[ :]([0-5]?\d))[ :]({PART_OF_DEGREE})")
"""The same without marks, 12 34 56 and 12:34:56, which is no time where the header says that degrees stand there."""

IN_DEGREES = re.compile(r".*(?:[\[(]\s*(?:°|deg(?:rees?)?|dms)\s*[\])]|_(?:deg|dms))", re.IGNORECASE)
"""Header that says so."""

STAMP = re.compile(r"(?:\d{1,4}[./-]\d{1,2}[./-]\d{1,4}|\d{1,2}:\d\d)[\dTZ:.,+ -]*")
"""A cell with a date, a clock's time or both."""

Cells: TypeAlias = Sequence[str] | Array
"""(N,) cells of a column as text, or the numbers of a recording."""


@dataclass(frozen=True, eq=False)
class SourceTable:
    """One file, or a part of one, nothing of it understood yet.

    Attributes:
        path: The file.
        header: Name of each column as written; where the file has none, `name` and `x`, `y`, `z` by their places.
        lines: (N,) line of each row.
        columns: (N,) cells of each column, stripped, numbers with decimal points.
        comments: Texts of comment lines, and of titles before the header.
        part: Topic, body or marker that a recording has this of.
        spans: (N, 2) first and last time [s] of each row that is the mean over a dwell, None where rows are as read.
        notes: What was left out of the file, and why.
        unread: What of the file may be places and is of no type that is read, '' where there are others or none.
        doubts: By column, why its values cannot be used.
    """

    path: Path
    header: tuple[str, ...]
    lines: tuple[int, ...]
    columns: tuple[Cells, ...]
    comments: tuple[str, ...] = ()
    part: str = ""
    spans: Array | None = None
    notes: tuple[str, ...] = ()
    unread: str = ""
    doubts: Mapping[str, str] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """The file's name and the part of it."""
        return f"{self.path.name} {self.part}".strip()


Source = TypeVar("Source", bound=SourceTable)
"""A source table, or one that is understood."""


def numbers(cells: Cells) -> Array:
    """Return (N,) numbers of a column, nan where a cell is none."""
    if isinstance(cells, np.ndarray):
        return cells
    return np.array([float(cell) if NUMBER.fullmatch(cell) else np.nan for cell in cells])


def recorded(path: Path, part: str, columns: Mapping[str, Array], notes: tuple[str, ...] = ()) -> SourceTable:
    """Return a part of a recording, whose rows are counted from 1."""
    size = len(next(iter(columns.values())))
    return SourceTable(path, tuple(columns), tuple(range(1, size + 1)), tuple(columns.values()), part=part, notes=notes)


def read_table_source(path: Path) -> SourceTable:
    """Read a text file (UTF-8, UTF-16, Windows-1252) or a workbook of one sheet.

    The separator is the one of semicolon, tab, comma and blanks that parts most lines into the same number of cells. A
    header may be a comment, and may have its units in a line of their own. Where each line has one coordinate of a
    point, as programs for inspection report them, the lines of a point become a row.

    Raises:
        TableError: The file cannot be read, holds no rows of numbers, or a row has another number of cells.
    """
    comments, mark = list[str](), ""
    if path.suffix.lower() in SUFFIXES:
        rows = [(line, [cell.strip() for cell in cells]) for line, cells in sheet_rows(path) if any(cells)]
    else:
        kept: list[tuple[int, str]] = []
        for number, line in enumerate(text_lines(path), 1):
            match = COMMENT.fullmatch(line.rstrip("\r\n"))
            if match:
                comments.append(match[1])
            elif line.strip() and not line.lower().startswith("sep="):
                kept.append((number, line.rstrip("\r\n")))
        rows, mark = _split(kept)
    rows = [(line, [_plain_number(cell) for cell in cells]) for line, cells in rows]
    numeric = [_numeric(row) for _, row in rows]
    widths = Counter(len(cells) for (_, cells), full in zip(rows, numeric, strict=True) if full and len(cells) > 1)
    if not widths:
        raise TableError(Place(path), "holds no rows of numbers: expected a table with a header, or lines: name x y z")
    width = widths.most_common(1)[0][0]
    first = next(i for i, (_, cells) in enumerate(rows) if numeric[i] and len(cells) == width)
    first, heads = _heads(rows, first, width)
    if mark and not heads:
        in_comments = [_parted([text], mark)[0] for text in comments]
        heads = [cells for cells in reversed(in_comments) if len(cells) == width and not any(map(_number, cells))]
    for line, cells in [] if heads else rows[:first]:
        if sum(bool(NAMED.fullmatch(cell)) for cell in cells) > 1:
            raise TableError(Place(path, line), f"has {len(cells)} names of columns where most rows have {width} cells")
    line, cells = rows[first]
    if not heads and (odd := next((cell for cell in cells if not _number(cell) and PROGRAM.fullmatch(cell)), None)):
        text = f"is no row of a table, with {said(odd)}: log the joints, or write a table with a header and a row each"
        raise TableError(Place(path, line), text)
    head, used = heads[0] if heads else None, heads[:1]
    if len(heads) > 1 and head and _are_units(head):  # below the names
        units, used = (cell.strip("[]()- ") for cell in head), heads[:2]
        head = [f"{name} [{unit}]" if unit else name for name, unit in zip(heads[1], units, strict=True)]
    comments += [" ".join(cells) for _, cells in rows[:first] if not any(cells is row for row in used)]
    body = rows[first:]
    for line, cells in body:
        if len(cells) != width:
            raise TableError(Place(path, line), f"has {len(cells)} cells where most rows have {width}")
    columns = [tuple(column) for column in zip(*(cells for _, cells in body), strict=True)]
    head, columns = _without_units(head or _names(columns), columns)
    _one_mark(path, body, columns)
    texts = (
        tuple(cell.replace(".", "").replace(",", ".") if COMMA.fullmatch(cell) else cell for cell in column)
        for column in columns
    )
    source = SourceTable(path, tuple(head), tuple(line for line, _ in body), tuple(texts), tuple(comments))
    source = replace(source, comments=(*source.comments, *_units_of(source)))
    return _named_joints(_by_point(source))


def _units_of(source: SourceTable) -> list[str]:
    """Return what a column with the unit of each row says, as a comment does; raise where they differ."""
    at = next((i for i, name in enumerate(source.header) if UNITS_COLUMN.fullmatch(name.strip())), None)
    cells = [] if at is None else [str(cell) for cell in source.columns[at]]
    given = dict.fromkeys(filter(None, (cell.strip(" []()").lower() for cell in cells)))
    if at is None or not given or not {*given} <= {*LENGTHS, *UNITS["angle"]}:
        return []
    if len(given) > 1:
        row = next(i for i, cell in enumerate(cells) if cell and cell != cells[0])
        text = f"{source.header[at]!r} is {said(cells[row])} here and {said(cells[0])} before: export one unit"
        raise TableError(Place(source.path, source.lines[row]), text)
    return [f"Units: {unit}" for unit in given]


def _heads(rows: Sequence[tuple[int, list[str]]], first: int, width: int) -> tuple[int, list[list[str]]]:
    """Return the first row of numbers of those below a header, and the lines of that, the nearest first."""
    above = [i for i, (_, cells) in enumerate(rows[:first]) if len(cells) == width]
    named = [i for i in above if _are_units(rows[i][1]) or not any(map(_number, rows[i][1]))]
    if named:  # a row of numbers with a text is none
        first = named[-1] + 1 if named[-1] < above[-1] else first
    return first, [rows[i][1] for i in reversed(named or above)]


def _plain_number(cell: str) -> str:
    """Return a cell without what stands between thousands, and with a sign and an exponent as computers read them."""
    if NUMBER.fullmatch(cell):
        return cell
    cell = f"-{cell[1:]}" if cell.startswith("−") else cell
    if match := DEGREES.fullmatch(cell):
        return f"{_decimal(match)}°"
    if match := THOUSANDS.fullmatch(cell):
        return match[4].replace(",", "") if match[4] else match[1].replace(match[2], "") + (match[3] or "")
    return f"{match[1]}e{match[2]}" if (match := FORTRAN.fullmatch(cell)) else cell


def _decimal(match: re.Match[str]) -> str:
    """Return degrees, minutes and seconds as one number."""
    sign, *parts = match.groups()
    return f"{sign}{sum(float(part or 0.0) / 60.0**n for n, part in enumerate(parts)):.12g}"


def _without_units(
    head: Sequence[str], columns: Sequence[tuple[str, ...]]
) -> tuple[Sequence[str], list[tuple[str, ...]]]:
    """Return a header and columns of which those have their unit in the header whose every number has the same.

    Where the header says that degrees stand there, their minutes and seconds are of one number with them.
    """
    names, stripped = list(head), list(columns)
    for i, column in enumerate(columns):
        if IN_DEGREES.fullmatch(names[i]):
            bare = [cell.removesuffix("°").rstrip() for cell in column]
            stripped[i] = tuple(_decimal(match) if (match := PARTED.fullmatch(cell)) else cell for cell in bare)
            if stripped[i] != column:  # of dms written as one number, 12.3456, the unit is not known
                names[i] = re.sub("dms", "deg", names[i], flags=re.IGNORECASE)
            continue
        if not any(map(MEASURE.fullmatch, column[:FEW])):
            continue
        matches = [MEASURE.fullmatch(cell) for cell in column if not NO_READING.fullmatch(cell)]
        units = {match[2] for match in matches if match and _number(match[1])}
        if len(units) == 1 and all(matches) and not UNIT.search(names[i]):
            names[i] = f"{names[i]} [{units.pop()}]"
            stripped[i] = tuple(match[1].strip() if (match := MEASURE.fullmatch(cell)) else cell for cell in column)
    return names, stripped


def _one_mark(path: Path, body: Sequence[tuple[int, list[str]]], columns: Sequence[Sequence[str]]) -> None:
    """Raise where a column has commas that may part thousands, and another has decimal points."""
    pointed = next((column[0] for column in columns[1:] if all(NUMBER.fullmatch(cell) for cell in column)
                    and any("." in cell for cell in column)), None)  # fmt: skip
    for column in columns if pointed is not None else ():
        with_comma = [i for i, cell in enumerate(column) if COMMA.fullmatch(cell)]
        if with_comma and all(GROUPED.fullmatch(column[i]) for i in with_comma):
            cell = column[with_comma[0]]
            text = f"{cell!r} is {cell.replace(',', '.')} or {cell.replace(',', '')}, beside {pointed!r} with a point"
            raise TableError(Place(path, body[with_comma[0]][0]), f"{text}: export it without commas in numbers")


def _are_units(cells: Sequence[str]) -> bool:
    """Return whether all cells of a row are units, or none."""
    words = {*LENGTHS, *UNITS["angle"], *UNITS["time"], "°", "1", "-", ""}
    return all(UNIT.fullmatch(cell) or cell.lower() in words for cell in cells) and not all(map(_number, cells))


def _parted(texts: Sequence[str], mark: str) -> list[list[str]]:
    if mark == " ":
        return [line.split() for line in texts]
    return [[cell.strip() for cell in cells] for cells in csv.reader(texts, delimiter=mark)]


def _split(lines: Sequence[tuple[int, str]]) -> tuple[list[tuple[int, list[str]]], str]:
    """Return the cells of every line by the separator that parts most lines alike, and that separator."""
    best, most, by = [[line] for _, line in lines], 0.0, ""
    for mark in (";", "\t", ",", " "):
        cells = _parted([line for _, line in lines], mark)
        width, count = Counter(map(len, cells)).most_common(1)[0] if cells else (1, 0)
        if width > 1 and count > 1.2 * most and len(cells) == len(lines):
            best, most, by = cells, float(count), mark
    width = Counter(map(len, best)).most_common(1)[0][0] if best else 0
    if width > 1 and not any(cells[-1] for cells in best if len(cells) == width):  # lines that end in a separator
        best = [cells[:-1] if len(cells) == width else cells for cells in best]
    return [(number, cells) for (number, _), cells in zip(lines, best, strict=True)], by


def _by_point(source: SourceTable) -> SourceTable:
    """Return a table with a row for each point, where lines have one coordinate each: name, axis, nominal, measured."""
    of_column = [
        [match[1].lower() if (match := AXIS.fullmatch(str(cell))) else "" for cell in cells] for cells in source.columns
    ]
    lines = [i for i, axes in enumerate(of_column) if 0 < axes.count("x") == axes.count("y") == axes.count("z")]
    value = next((i for i, name in enumerate(source.header) if i not in lines and MEASURED.fullmatch(name)), None)
    texts = [i for i, cells in enumerate(source.columns) if not all(_number(str(cell)) for cell in cells if cell)]
    named = next((i for i in texts if i not in lines), None)
    if not lines or value is None or named is None:
        return source
    axes = of_column[lines[0]]
    points: list[tuple[int, str, dict[str, str]]] = []
    name = ""
    for line, axis, cell, label in zip(source.lines, axes, source.columns[value], source.columns[named], strict=True):
        new = bool(label) and label != name
        name = str(label or name)
        if axis:
            if new or not points or axis in points[-1][2]:
                points.append((line, name, {}))
            points[-1][2][axis] = str(cell)
    unit = source.header[value].partition("[")[2].strip("] ")
    head = ("name", *(f"{axis} [{unit}]" if unit else axis for axis in "xyz"))
    columns = (
        [label for _, label, _ in points],
        *([of_point.get(axis, "") for _, _, of_point in points] for axis in "xyz"),
    )
    return replace(source, header=head, lines=tuple(line for line, *_ in points), columns=tuple(map(tuple, columns)))


def _named_joints(source: SourceTable) -> SourceTable:
    """Return a table whose columns say which joint they are of where a message of joint states has that in its cells.

    Tools for bags write `name_0 .. position_0 ..`, `field.name0 .. field.position0 ..`, or the lists as they are:
    `['a', 'b']`, `(0.1, 0.2)`.
    """
    header, columns = list(source.header), list(source.columns)
    for at, name in reversed([*enumerate(header)]):
        listed = LISTS.fullmatch(name.strip())
        matches = [LISTED.fullmatch(str(cell)) for cell in columns[at]] if listed else []
        rows = [[part.strip("'\" ") for part in BETWEEN.split(match[1])] for match in matches if match]
        if listed and rows and len(rows) == len(matches) and len({len(row) for row in rows}) == 1:
            base, unit = listed["message"] or listed["base"], listed["unit"]
            mark = "_{}" if listed["message"] else "[{}]"
            header[at : at + 1] = [f"{base}{mark.format(i)}{unit}" for i in range(len(rows[0]))]
            columns[at : at + 1] = list(zip(*rows, strict=True))
    of = {
        base: {
            match[1]: i for i, name in enumerate(header) if (match := re.fullmatch(rf"(?:\w+\.)*{base}_?(\d+)", name))
        }
        for base in ("name", "position")
    }
    pairs = [(of["name"][number], at) for number, at in of["position"].items() if number in of["name"]]
    rows = [[columns[name][row] for name, _ in pairs] for row in range(len(source.lines))]
    if bad := next((i for i, names in enumerate(rows) if {*names} != {*rows[0]} or len({*names}) != len(names)), None):
        text = f"has joints {listing(rows[bad])}, and the rows before it {listing(rows[0])}"
        raise TableError(Place(source.path, source.lines[bad]), f"{text}: export a topic with the same joints in each")
    for k, (_, at) in enumerate(pairs):  # in whichever order a message has them
        header[at] = f"position.{rows[0][k]}"
    if any(names != rows[0] for names in rows):
        cells = [dict(zip(names, (columns[at][i] for _, at in pairs), strict=True)) for i, names in enumerate(rows)]
        for k, (_, at) in enumerate(pairs):
            columns[at] = tuple(cell[rows[0][k]] for cell in cells)
    return replace(source, header=tuple(header), columns=tuple(columns))


def _number(cell: str) -> bool:
    """Return whether a cell is a number, or a list of them."""
    if match := LISTED.fullmatch(cell):
        return all(map(NUMBER.fullmatch, BETWEEN.split(match[1])))
    if match := MEASURE.fullmatch(cell):
        cell = match[1]
    return bool(NUMBER.fullmatch(cell) or COMMA.fullmatch(cell))


def _numeric(cells: Sequence[str]) -> bool:
    """Return whether a row is one of numbers, and no title or header."""
    plain, parted = (sum(map(bool, map(of, cells))) for of in (_number, PARTED.fullmatch))
    least = min(max(len(cells), 2) / 2, 2)
    return plain >= least or (parted > 0 and plain + parted >= 2) or _no_reading(cells)


def _no_reading(cells: Sequence[str]) -> bool:
    """Return whether a row has a number, else stamps and what is written where nothing was read."""
    odd = [cell for cell in cells if not _number(cell)]
    return len(odd) < len(cells) and all(NO_READING.fullmatch(cell) or STAMP.fullmatch(cell) for cell in odd)


def _names(columns: Sequence[Sequence[str]]) -> list[str]:
    """Return the names of columns that have none: a name, then x y z where the first three numbers are."""
    numeric = [all(map(_number, column)) for column in columns]
    start = next((i for i in range(len(columns)) if not numeric[i] or (i == 0 and len(columns) == 4)), None)
    at = next((i for i in range(len(columns) - 2) if all(numeric[i : i + 3]) and i != start), None)
    named = {} if at is None else dict(zip(range(at, at + 3), "xyz", strict=True))
    named |= {} if start is None or start in named else {start: "name"}
    return [named.get(i, f"column {i + 1}") for i in range(len(columns))]


def said(cell: str) -> str:
    """Return a cell as a message has it."""
    return shown(cell, 40)
