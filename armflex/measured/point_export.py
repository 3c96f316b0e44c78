"""Points exported as text by a metrology program such as SpatialAnalyzer.

There is no one layout. A line is a name of one to three parts (collection, group, point, apart or joined by `::`) and
x y z, separated by commas, tabs or blanks, with further cells such as a time stamp behind. Lines starting with `//` or
`#` are comments; unit and frame are taken from them (`// Units: mm`, `// Frame: A::WORLD`) or given by the caller, and
nothing is assumed. A header line with `X Y Z` says where the coordinates are, for files where names are numbers.
"""

from __future__ import annotations

import csv
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from armflex.conventions import NUMBER, UNITS, Array
from armflex.errors import Place, TableError, did_you_mean, listing
from armflex.printable import unprintable

MAX_BYTES = 200_000_000
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

_COMMENT = re.compile(r"\s*(?://|#)\s*(.*)")
_UNIT = re.compile(r"\bunits?\b[^:=]*[:=](.*[^\W\d_].*)", re.IGNORECASE)
_NO_LENGTH = re.compile(r"\b(?:ang|temp|press|humid|time|weight|mass)", re.IGNORECASE)
_FRAME = re.compile(r"\bframe(?:\s+name)?\s*(?:[:=](?!:)\s*(\S.*?)|\s(\S*::\S+))\s*$", re.IGNORECASE)
_CURVED = re.compile(r"\b(?:cylindric\w*|spherical|polar)\b", re.IGNORECASE)
_BRACKETED = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]")
_STAMP = re.compile(r"(\d{4}-\d\d-\d\d) (\d\d:\d\d:\d\d)")


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
        sha256: Of the file.
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


@dataclass(frozen=True)
class _Layout:
    """How many cells the name takes, and what the cells behind the coordinates are called."""

    names: int
    extras: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Said:
    """What comments or a header state, and on which line."""

    line: int
    value: str


def read_points(path: str | Path, unit: str | None = None, frame: str | None = None) -> PointExport:
    """Read an ASCII export of points.

    Args:
        path: The file, UTF-8.
        unit: Unit of its coordinates, where the file does not state it.
        frame: Name of the frame they are in, where the file does not state it.

    Raises:
        TableError: Unit or frame are stated nowhere, or differently in two places; a line is no point; coordinates
            are not Cartesian; names cannot be told from numbers.
    """
    path = Path(path)
    content = _bytes(path)
    numbered = [(i, line) for i, line in enumerate(_text(path, content).splitlines(), 1) if line.strip()]
    comments = [(i, match[1]) for i, line in numbered if (match := _COMMENT.fullmatch(line))]
    rows = [(i, _cells(line)) for i, line in numbered if not _COMMENT.fullmatch(line)]
    _refuse_curved(path, comments)
    layout, units = _header(path, comments, rows)
    rows = rows[1:] if rows and _axes(rows[0][1]) is not None else rows
    if not rows:
        raise TableError(Place(path), "holds no points, expected lines such as: Group Point X Y Z")
    units += [_Said(i, word) for i, text in comments if (word := _unit_in(text))]
    frames = [_Said(i, match[1] or match[2]) for i, text in comments if (match := _FRAME.search(text))]
    stated = _stated(path, "unit", [_Said(said.line, _known_unit(path, said)) for said in units], unit, "mm")
    where = _stated(path, "frame", frames, frame, "World")
    return _points(path, rows, layout or _guess(path, rows), stated, where, hashlib.sha256(content).hexdigest())


def _bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise TableError(Place(path), f"is larger than the {MAX_BYTES} bytes allowed")
        return path.read_bytes()
    except OSError as error:
        raise TableError(Place(path), f"cannot be read: {error.strerror}") from None


def _text(path: Path, content: bytes) -> str:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise TableError(Place(path), "is not UTF-8 text") from None
    if found := unprintable(text):
        raise TableError(Place(path, text.count("\n", 0, found[0]) + 1), found[1])
    return text


def _cells(line: str) -> list[str]:
    """Return the cells of a line, separated by tabs, else commas, else blanks; a date and its time stay together."""
    text = _STAMP.sub(r"\1T\2", line.strip())
    separator = next((mark for mark in "\t,;" if mark in text), " ")
    return [cell.strip() for cell in next(csv.reader([text], delimiter=separator, skipinitialspace=True))]


def _refuse_curved(path: Path, comments: Sequence[tuple[int, str]]) -> None:
    for line, text in comments:
        if match := _CURVED.search(text):
            raise TableError(Place(path, line), f"{match[0]!r}: export the points in Cartesian coordinates, x y z")


def _unit_in(text: str) -> str | None:
    """Return the length unit that a comment states, or whatever it calls a unit; None where it states none."""
    match = _UNIT.search(text)
    if match is None or _NO_LENGTH.search(text[: match.start(1)]):
        return None
    words = re.findall(r"[^\W\d_]+", match[1])
    return next((word for word in words if word.lower() in LENGTHS), words[0])


def _known_unit(path: Path, said: _Said) -> str:
    word = said.value.lower()
    if word not in LENGTHS:
        raise TableError(Place(path, said.line), f"unit {said.value!r} is no length{did_you_mean(word, LENGTHS)}")
    return word


def _stated(path: Path, what: str, found: Sequence[_Said], given: str | None, example: str) -> str:
    """Return what the file and the caller state about its unit or frame; raise where they differ or nobody does."""
    if what == "unit" and given is not None:
        given = _known_unit(path, _Said(0, given))
    for said in found[1:]:
        if not _alike(what, said.value, found[0].value):
            text = f"{what} {said.value!r}, but {found[0].value!r} on line {found[0].line}"
            raise TableError(Place(path, said.line), text)
    if given is None and not found:
        hint = f"a comment such as '// {what.capitalize()}: {example}', or name it when reading"
        raise TableError(Place(path), f"states no {what}: add {hint}")
    if given is not None and found and not _alike(what, given, found[0].value):
        raise TableError(Place(path, found[0].line), f"{what} {found[0].value!r}, but {given!r} was asked for")
    return found[0].value if found else str(given)


def _alike(what: str, a: str, b: str) -> bool:
    return LENGTHS[a] == LENGTHS[b] if what == "unit" else a.lower() == b.lower()


def _header(
    path: Path, comments: Sequence[tuple[int, str]], rows: Sequence[tuple[int, list[str]]]
) -> tuple[_Layout | None, list[_Said]]:
    """Return the layout that a header gives, a comment or the first line, and the units named with its axes."""
    layout, units = None, []
    for line, cells in [*((i, _cells(_BRACKETED.sub(r"_\1", text))) for i, text in comments if text), *rows[:1]]:
        cells = _cells(_BRACKETED.sub(r"_\1", ", ".join(cells)))
        at = _axes(cells)
        if at is None:
            continue
        units += [_Said(line, cell.partition("_")[2]) for cell in cells[at : at + 3] if "_" in cell]
        # An axis comment without names, `// X Y Z`, says nothing about where they stand in a line.
        layout = _Layout(at, tuple(cells[at + 3 :])) if at else layout
    return layout, units


def _axes(cells: Sequence[str]) -> int | None:
    """Return where x, y, z stand in a header, None where it is none; units may be attached."""
    bases = [re.split(r"[_\s\[(]", cell.lower())[0] for cell in cells]
    return next((i for i in range(len(bases) - 2) if bases[i : i + 3] == ["x", "y", "z"]), None)


def _guess(path: Path, rows: Sequence[tuple[int, list[str]]]) -> _Layout:
    """Return the one layout that all lines have; raise naming the first line that has none, or where two are possible.

    Names are no decimals, and x, y, z are all written alike.
    """
    possible = [[_may_be(cells, k) for _, cells in rows] for k in (1, 2, 3)]
    fitting = [k for k, fits in enumerate(possible, 1) if all(fits) and _written_alike(rows, k)]
    if len(fitting) == 1:
        return _Layout(fitting[0])
    if fitting:
        text = "names cannot be told from numbers: add a header line such as '// Group Point X Y Z'"
        raise TableError(Place(path, rows[0][0]), text)
    line, cells = rows[max(possible, key=sum).index(False)] if not all(map(all, possible)) else rows[0]
    text = f"expected a name of one to three parts and x y z, found {listing(map(repr, cells), 8)}"
    raise TableError(Place(path, line), text)


def _may_be(cells: Sequence[str], k: int) -> bool:
    named = all(cell and not (NUMBER.fullmatch(cell) and not cell.isdigit()) for cell in cells[:k])
    joined = any("::" in cell for cell in cells[:k])
    return named and (k == 1 or not joined) and _is_point(cells, k)


def _is_point(cells: Sequence[str], k: int) -> bool:
    coordinates = cells[k : k + 3]
    return len(coordinates) == 3 and all(NUMBER.fullmatch(c) and np.isfinite(float(c)) for c in coordinates)


def _written_alike(rows: Sequence[tuple[int, list[str]]], k: int) -> bool:
    """Return whether all or none of x, y, z are whole numbers throughout: otherwise one of them is a name."""
    return len({all(cells[i].lstrip("+-").isdigit() for _, cells in rows) for i in range(k, k + 3)}) == 1


def _points(
    path: Path, rows: Sequence[tuple[int, list[str]]], layout: _Layout, unit: str, frame: str, sha256: str
) -> PointExport:
    k = layout.names
    for line, cells in rows:
        if not _is_point(cells, k):
            text = f"expected {k} cells of name and x y z, found {listing(map(repr, cells), 8)}"
            raise TableError(Place(path, line), text)
    names = tuple(tuple(part for cell in cells[:k] for part in cell.split("::") if part) for _, cells in rows)
    position = np.array([[float(cell) for cell in cells[k : k + 3]] for _, cells in rows]) * LENGTHS[unit]
    lines = tuple(line for line, _ in rows)
    return PointExport(path, unit, frame, names, lines, position, _extras(rows, layout), sha256)


def _extras(rows: Sequence[tuple[int, list[str]]], layout: _Layout) -> dict[str, tuple[str, ...]]:
    """Return the cells behind the coordinates, by the header's names where it has one for each, else by number."""
    behind = [cells[layout.names + 3 :] for _, cells in rows]
    count = max(map(len, behind))
    named = len(layout.extras) >= count and len(set(layout.extras)) == len(layout.extras)
    names = layout.extras if named else [str(i + 1) for i in range(count)]
    padded = [[*cells, *[""] * (count - len(cells))] for cells in behind]
    return {f"export_{names[i]}": tuple(cells[i] for cells in padded) for i in range(count)}
