"""Points exported as text by a metrology program such as SpatialAnalyzer, and the rows of a campaign they belong to.

There is no one layout. A line is a name of one to three parts (collection, group, point, apart or joined by `::`) and
x y z, separated by commas, tabs or blanks, with further cells such as a time stamp behind. Lines starting with `//` or
`#` are comments; unit and frame are taken from them (`// Units: mm`, `// Frame: A::WORLD`) or given by the caller, and
nothing is assumed. A header line with `X Y Z` says where the coordinates are, for files where names are numbers.
"""

from __future__ import annotations

import csv
import hashlib
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path

import numpy as np

from armflex.arguments import checked_kinds
from armflex.conventions import NUMBER, UNITS, Array
from armflex.errors import Flag, Place, TableError, did_you_mean, listing
from armflex.measured.table import Column, Table, text_lines

_INCH = 0.0254
LENGTHS = UNITS["length"] | {
    **dict.fromkeys(("meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres"), 1e-3),
    **dict.fromkeys(("centimeter", "centimeters", "centimetre", "centimetres"), 1e-2),
    **dict.fromkeys(("micrometer", "micrometers", "micron", "microns"), 1e-6),
    **dict.fromkeys(("in", "inch", "inches"), _INCH),
    **dict.fromkeys(("ft", "foot", "feet"), 12.0 * _INCH),
}
"""Names of length units as programs write them -> factor to m."""

AXES = ("x", "y", "z")

_COMMENT = re.compile(r"\s*(?://|#)\s*(.*)")
_UNIT = re.compile(r"\bunits?\b[^:=]*[:=](.*[^\W\d_].*)", re.IGNORECASE)
_NO_LENGTH = re.compile(r"\b(?:ang|temp|press|humid|time|weight|mass)", re.IGNORECASE)
_FRAME = re.compile(r"\bframe(?:\s+name)?\s*(?:[:=](?!:)\s*(\S.*?)|\s(\S*::\S+))\s*$", re.IGNORECASE)
CURVED = re.compile(r"\b(?:cylindric\w*|spherical|polar)\b", re.IGNORECASE)
_BRACKETED = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]")
_STAMP = re.compile(r"(\d{4}-\d\d-\d\d) (\d\d:\d\d:\d\d)")
_ISO = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d.*")

Rows = Sequence[tuple[int, list[str]]]
"""Line and cells of each row."""


@dataclass(frozen=True, eq=False)
class PointExport:
    """Named points as exported.

    Attributes:
        path: The file.
        unit, frame: As stated in it, or by the caller.
        names: Collection, group and point of each, as far as given.
        lines: Line of each.
        position: (N, 3) [m].
        extras: Further cells of each line, by column.
        sha256: Of the file's text.
    """

    path: Path
    unit: str
    frame: str
    names: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    position: Array
    extras: Mapping[str, tuple[str, ...]]
    sha256: str

    def full_name(self, i: int) -> str:
        """Return the whole name of point i."""
        return "::".join(self.names[i])


@checked_kinds
def read_points(path: str | Path, unit: str | None = None, frame: str | None = None) -> PointExport:
    """Read an ASCII export of points.

    Args:
        path: The file, UTF-8.
        unit: Unit of its coordinates, where the file does not state it.
        frame: Name of the frame they are in, where the file does not state it.

    Raises:
        TableError: Unit or frame are stated nowhere, or differently in two places; a line is no point; coordinates
            are not Cartesian; names cannot be distinguished from numbers.
    """
    path = Path(path)
    text = "".join(text_lines(path))
    sha256 = hashlib.sha256(text.encode()).hexdigest()
    numbered = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip()]
    comments = [(i, match[1]) for i, line in numbered if (match := _COMMENT.fullmatch(line))]
    rows = [(i, _cells(line)) for i, line in numbered if not _COMMENT.fullmatch(line)]
    for line, said in comments:
        if match := CURVED.search(said):
            raise TableError(Place(path, line), f"{match[0]!r}: export the points in Cartesian coordinates, x y z")
    # A header, a comment or the first line, says how many cells are names, what stands behind the coordinates, and
    # their unit.
    named, behind, units = 0, (), []
    headers = [(i, said) for i, said in comments if said] + [(i, ", ".join(cells)) for i, cells in rows[:1]]
    for line, said in headers:
        cells = _cells(_BRACKETED.sub(r"_\1", said))
        if (at := _axes(cells)) is not None:
            units += [(line, cell.partition("_")[2]) for cell in cells[at : at + 3] if "_" in cell]
            # An axis comment without names, `// X Y Z`, says nothing about where they stand in a line.
            named, behind = (at, tuple(cells[at + 3 :])) if at else (named, behind)
    rows = rows[1:] if rows and _axes(rows[0][1]) is not None else rows
    if not rows:
        raise TableError(Place(path), "holds no points, expected lines such as: Group Point X Y Z")
    units += [(i, word) for i, said in comments if (word := _unit_in(said))]
    units = [(line, _known_unit(path, line, word)) for line, word in units]
    frames = [(i, frame_of(said)) for i, said in comments if _FRAME.search(said)]
    given = None if unit is None else _known_unit(path, 0, unit)
    unit = _stated(path, "unit", units, given, "mm", LENGTHS.__getitem__)
    frame = _stated(path, "frame", frames, frame, "World", str.lower)
    named = named or _guess(path, rows)
    for line, cells in rows:
        if not _is_point(cells, named):
            problem = f"expected {named} cells of name and x y z, found {listing(map(repr, cells), 8)}"
            raise TableError(Place(path, line), problem)
    names = tuple(tuple(part for cell in cells[:named] for part in cell.split("::") if part) for _, cells in rows)
    position = np.array([[float(cell) for cell in cells[named : named + 3]] for _, cells in rows]) * LENGTHS[unit]
    # Cells behind the coordinates go by the header's names where it has one for each, else by number.
    further = [cells[named + 3 :] for _, cells in rows]
    columns = list(zip_longest(*further, fillvalue=""))
    called = behind if len(set(behind)) == len(behind) >= len(columns) else map(str, range(1, len(columns) + 1))
    extras = {f"export_{name}": cells for name, cells in zip(called, columns, strict=False)}
    return PointExport(path, unit, frame, names, tuple(line for line, _ in rows), position, extras, sha256)


def _cells(line: str) -> list[str]:
    """Return the cells of a line, separated by tabs, else commas, else blanks; a date and its time stay together."""
    text = _STAMP.sub(r"\1T\2", line.strip())
    separator = next((mark for mark in "\t,;" if mark in text), " ")
    return [cell.strip() for cell in next(csv.reader([text], delimiter=separator, skipinitialspace=True))]


def _axes(cells: Sequence[str]) -> int | None:
    """Return where x, y, z stand in a header, None where it is none; units may be attached."""
    bases = [re.split(r"[_\s\[(]", cell.lower())[0] for cell in cells]
    return next((i for i in range(len(bases) - 2) if bases[i : i + 3] == ["x", "y", "z"]), None)


def _unit_in(text: str) -> str | None:
    """Return the length unit that a comment states, or whatever it calls a unit; None where it states none."""
    match = _UNIT.search(text)
    if match is None or _NO_LENGTH.search(text[: match.start(1)]):
        return None
    words = re.findall(r"[^\W\d_]+", match[1])
    return next((word for word in words if word.lower() in LENGTHS), words[0])


def _known_unit(path: Path, line: int, said: str) -> str:
    word = said.lower()
    if word not in LENGTHS:
        raise TableError(Place(path, line), f"unit {said!r} is no length{did_you_mean(word, LENGTHS)}")
    return word


def frame_of(comment: str) -> str:
    """Return the frame that a comment says places to be in, '' where it says none."""
    match = _FRAME.search(comment)
    return (match[1] or match[2]) if match else ""


def _stated(
    path: Path,
    what: str,
    statements: Sequence[tuple[int, str]],
    given: str | None,
    example: str,
    meaning: Callable[[str], object],
) -> str:
    """Return what lines of the file and the caller state about its unit or frame; raise where meanings differ."""
    if given is None and not statements:
        hint = f"a comment such as '// {what.capitalize()}: {example}', or name it when reading"
        raise TableError(Place(path), f"states no {what}: add {hint}")
    if not statements:
        return str(given)
    first, value = statements[0]
    for line, other in statements[1:]:
        if meaning(other) != meaning(value):
            raise TableError(Place(path, line), f"{what} {other!r}, but {value!r} on line {first}")
    if given is not None and meaning(given) != meaning(value):
        raise TableError(Place(path, first), f"{what} {value!r}, but {given!r} was asked for")
    return value


def _guess(path: Path, rows: Rows) -> int:
    """Return how many cells of all lines are names; raise naming the first line where none will do, or two will.

    Names are no decimals, and x, y, z are all written alike: all or none of them are whole numbers throughout.
    """

    def may_be(cells: Sequence[str], k: int) -> bool:
        named = all(cell and not (NUMBER.fullmatch(cell) and not cell.isdigit()) for cell in cells[:k])
        joined = any("::" in cell for cell in cells[:k])
        return named and (k == 1 or not joined) and _is_point(cells, k)

    def alike(k: int) -> bool:
        return len({all(cells[i].lstrip("+-").isdigit() for _, cells in rows) for i in range(k, k + 3)}) == 1

    possible = [[may_be(cells, k) for _, cells in rows] for k in (1, 2, 3)]
    fitting = [k for k, fits in enumerate(possible, 1) if all(fits)]
    written_alike = [k for k in fitting if alike(k)]
    if len(written_alike) == 1:
        return written_alike[0]
    if fitting:
        text = "names cannot be distinguished from numbers: add a header line such as '// Group Point X Y Z'"
        raise TableError(Place(path, rows[0][0]), text)
    line, cells = rows[max(possible, key=sum).index(False)]
    text = f"expected a name of one to three parts and x y z, found {listing(map(repr, cells), 8)}"
    raise TableError(Place(path, line), text)


def _is_point(cells: Sequence[str], k: int) -> bool:
    coordinates = cells[k : k + 3]
    return len(coordinates) == 3 and all(NUMBER.fullmatch(c) and np.isfinite(float(c)) for c in coordinates)


def with_points(table: Table, points: PointExport) -> tuple[Table, tuple[Flag, ...]]:
    """Return a campaign's table with columns x, y, z and whatever else was exported, and flags about the match.

    A row's point is named by its column `point`, or its `pose` where there is none: as `Point`, `Group::Point` or
    `Collection::Group::Point`. Rows of one name take its points in order. Where groups share a name, the group is the
    row's session. Rows without a point stay, not measured.

    Raises:
        TableError: The rows have positions already or no names; a name's points are fewer or more than its rows; no
            name matches at all.
    """
    for name in AXES:
        if name in table.columns:
            text = f"has a column {table.columns[name].header!r}, and points come from {points.path} as well"
            raise table.fail(text)
    column = "point" if "point" in table.columns else "pose"
    table.require([column])
    wanted, flags = table.texts(column), []
    point_of = _match(table, wanted, points)
    blind = [row for row, point in enumerate(point_of) if point is None]
    if blind:
        rows = listing((f"{wanted[row] or 'unnamed'} (line {table.lines[row]})" for row in blind), 5)
        text = f"{len(blind)} of {len(table)} rows have no point in {points.path} and count as not measured: {rows}"
        flags.append(Flag("unmeasured_rows", text))
    spare = sorted(set(range(len(points.names))) - set(point_of))
    if spare:
        names = listing((f"{points.full_name(i)} (line {points.lines[i]})" for i in spare), 5)
        flags.append(Flag("surplus_points", f"{len(spare)} points of {points.path} belong to no row: {names}"))
    exported: dict[str, Sequence[str]] = {
        axis: [repr(float(v)) for v in points.position[:, i]] for i, axis in enumerate(AXES)
    }
    exported |= points.extras
    # ISO 8601 stamps are seconds since the first; other formats leave month and day open and stay text.
    stamps = next((name for name, cells in points.extras.items() if all(map(_ISO.fullmatch, cells))), None)
    if stamps and "time" not in table.columns and None not in point_of:
        exported["time"] = exported.pop(stamps)
    kept = {name: cells for name, cells in table.columns.items() if name != "point"}
    for name, cells in exported.items():
        given = tuple("" if i is None else cells[i] for i in point_of)
        kept[name] = Column(f"{name} in {points.path}", "", 1.0, given)
    return replace(table, columns=kept), tuple(flags)


def _match(table: Table, wanted: Sequence[str], points: PointExport) -> list[int | None]:
    """Return the point of every row, by its name with or without group and collection."""
    index, rows_of = defaultdict(list), defaultdict(list)
    for i, parts in enumerate(points.names):
        for start in range(len(parts)):
            index["::".join(parts[start:])].append(i)
    for row, name in enumerate(wanted):
        rows_of[name].append(row)
    sessions = table.texts("session") if "session" in table.columns else ("",) * len(table)
    point_of: dict[int, int] = {}
    for name, rows in rows_of.items():
        points_named, parts = index[name], []
        if len({points.names[i][:-1] for i in points_named}) > 1:  # several groups use the name: they may be sessions
            for here in dict.fromkeys(sessions[row] for row in rows):
                within = [i for i in points_named if here in points.names[i][:-1]]
                parts.append(([row for row in rows if sessions[row] == here], within))
        # Groups that are no session may still mean these rows: then nobody knows which, and `_check_order` says so.
        for mine, within in parts if any(within for _, within in parts) else [(rows, points_named)]:
            if within:
                _check_order(table, name, mine, within, points)
                point_of |= zip(mine, within, strict=True)
    if len(table) and not point_of:
        text = f"no row's name is that of a point in {points.path} (rows: {listing(dict.fromkeys(wanted), 5)}; points: "
        raise table.fail(text + f"{listing(map(points.full_name, range(len(points.names))), 5)})")
    return [point_of.get(row) for row in range(len(table))]


def _check_order(table: Table, name: str, rows: Sequence[int], matched: Sequence[int], points: PointExport) -> None:
    """Raise `TableError` where rows of one name do not take its points one by one."""
    groups = dict.fromkeys("::".join(points.names[i][:-1]) for i in matched)
    if len(rows) != len(matched) or len(groups) > 1:
        read = f"{len(matched)} points (lines {listing((str(points.lines[i]) for i in matched), 5)})"
        asked = f"{len(rows)} rows of {table.path} (lines {listing((str(table.lines[row]) for row in rows), 5)})"
        which = f" in groups {listing(map(repr, groups), 5)}" if len(groups) > 1 else ""
        hint = "name each row's point in a column 'point', empty where nothing was read"
        text = f"{name!r}: {read}{which} for {asked}: {hint}"
        raise TableError(Place(points.path, points.lines[matched[0]]), text)
