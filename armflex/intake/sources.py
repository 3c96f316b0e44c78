"""A file of rows into columns of text: separators, decimal commas, comments, titles and missing headers."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from armflex.conventions import NUMBER
from armflex.errors import Place, TableError, shown
from armflex.measured.spreadsheet import SUFFIXES, sheet_rows
from armflex.measured.table import text_lines

COMMENT = re.compile(r"\s*(?://|#|%|!)\s*(.*)")
COMMA = re.compile(r"[+-]?(?:\d+|\d{1,3}(?:\.\d{3})+),\d+(?:[eE][+-]?\d+)?")
"""A number with a decimal comma, points between its thousands or none."""


@dataclass(frozen=True, eq=False)
class Source:
    """One file, nothing of it understood yet.

    Attributes:
        path: The file.
        header: Name of each column as written; where the file has none, `name` and `x`, `y`, `z` by their places.
        lines: (N,) line of each row.
        columns: (N,) cells of each column, stripped, numbers with decimal points.
        comments: Texts of comment lines, and of titles before the header.
        headed: Whether the file has a header.
    """

    path: Path
    header: tuple[str, ...]
    lines: tuple[int, ...]
    columns: tuple[tuple[str, ...], ...]
    comments: tuple[str, ...]
    headed: bool


def read_source(path: str | Path) -> Source:
    """Read a text file (UTF-8, UTF-16, Windows-1252) or a workbook of one sheet.

    The separator is the one of semicolon, tab, comma and blanks that parts most lines into the same number of cells.

    Raises:
        TableError: The file cannot be read, holds no rows of numbers, or a row has another number of cells.
    """
    path, comments = Path(path), list[str]()
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
        rows = _split(kept)
    numeric = [2 * sum(map(_number, cells)) >= max(len(cells), 2) for _, cells in rows]
    widths = Counter(len(cells) for (_, cells), full in zip(rows, numeric, strict=True) if full and len(cells) > 1)
    if not widths:
        raise TableError(Place(path), "holds no rows of numbers: expected a table with a header, or lines: name x y z")
    width = widths.most_common(1)[0][0]
    first = next(i for i, (_, cells) in enumerate(rows) if numeric[i] and len(cells) == width)
    head = next((cells for _, cells in reversed(rows[:first]) if len(cells) == width), None)
    comments += [" ".join(cells) for _, cells in rows[:first] if cells is not head]
    body = rows[first:]
    for line, cells in body:
        if len(cells) != width:
            raise TableError(Place(path, line), f"has {len(cells)} cells where most rows have {width}")
    columns = [tuple(column) for column in zip(*(cells for _, cells in body), strict=True)]
    return Source(
        path,
        tuple(head or _names(columns)),
        tuple(line for line, _ in body),
        tuple(
            tuple(cell.replace(".", "").replace(",", ".") if COMMA.fullmatch(cell) else cell for cell in one)
            for one in columns
        ),
        tuple(comments),
        head is not None,
    )


def _split(lines: Sequence[tuple[int, str]]) -> list[tuple[int, list[str]]]:
    """Return the cells of every line, by the separator that parts most lines alike."""

    def parted(mark: str) -> list[list[str]]:
        texts = [line for _, line in lines]
        if mark == " ":
            return [line.split() for line in texts]
        return [[cell.strip() for cell in cells] for cells in csv.reader(texts, delimiter=mark)]

    best, most = [[line] for _, line in lines], 0.0
    for mark in (";", "\t", ",", " "):
        cells = parted(mark)
        width, count = Counter(map(len, cells)).most_common(1)[0] if cells else (1, 0)
        if width > 1 and count > 1.2 * most and len(cells) == len(lines):
            best, most = cells, float(count)
    numbers = (number for number, _ in lines)
    return [
        (number, one[:-1] if len(one) > 1 and not one[-1] else one) for number, one in zip(numbers, best, strict=True)
    ]


def _number(cell: str) -> bool:
    return bool(NUMBER.fullmatch(cell) or COMMA.fullmatch(cell))


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
