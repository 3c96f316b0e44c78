"""Rows of a campaign without positions, joined with the points that an instrument's program exported."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

import numpy as np

from armflex.errors import Flag, Place, TableError, listing
from armflex.measured.point_export import PointExport
from armflex.measured.table import Column, Table

AXES = ("x", "y", "z")
_ISO = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d.*")


def with_points(table: Table, points: PointExport) -> tuple[Table, tuple[Flag, ...]]:
    """Return a campaign's table with columns x, y, z and whatever else was exported, and doubts about the match.

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
            raise TableError(Place(table.path, 1), text)
    column = "point" if "point" in table.columns else "pose"
    table.require([column])
    point_of = _match(table, table.texts(column), points)
    flags = _flags(table, table.texts(column), points, point_of)
    kept = {name: cells for name, cells in table.columns.items() if name != "point"}
    return replace(table, columns=kept | _columns(table, points, point_of)), flags


def _match(table: Table, wanted: Sequence[str], points: PointExport) -> list[int | None]:
    """Return the point of every row."""
    index, rows_of = _by_name(points), defaultdict(list)
    for row, name in enumerate(wanted):
        rows_of[name].append(row)
    sessions = table.texts("session") if "session" in table.columns else ("",) * len(table)
    point_of: list[int | None] = [None] * len(table)
    for name, rows in rows_of.items():
        for own, found in _by_session(rows, index.get(name, []), sessions, points):
            for row, point in zip(own, _in_order(table, name, own, found, points), strict=True):
                point_of[row] = point
    if len(table) and all(point is None for point in point_of):
        text = f"no row's name is that of a point in {points.path} (rows: {listing(dict.fromkeys(wanted), 5)}; points: "
        raise TableError(Place(table.path, 1), text + f"{listing(map(points.full_name, range(len(points.names))), 5)})")
    return point_of


def _by_name(points: PointExport) -> dict[str, list[int]]:
    """Return the points under each of their names, with and without group and collection."""
    index = defaultdict(list)
    for i, parts in enumerate(points.names):
        for start in range(len(parts)):
            index["::".join(parts[start:])].append(i)
    return index


def _by_session(
    rows: Sequence[int], found: Sequence[int], sessions: Sequence[str], points: PointExport
) -> list[tuple[list[int], list[int]]]:
    """Return rows and points that belong together: all of them, or by session where several groups use the name."""
    if len({points.names[i][:-1] for i in found}) < 2:
        return [(list(rows), list(found))]
    here = dict.fromkeys(sessions[row] for row in rows)
    parts = [
        ([row for row in rows if sessions[row] == name], [i for i in found if name in points.names[i][:-1]])
        for name in here
    ]
    # Groups that are no session may still mean these rows: then nobody knows which, and `_in_order` says so.
    return parts if any(own for _, own in parts) else [(list(rows), list(found))]


def _in_order(
    table: Table, name: str, rows: Sequence[int], found: Sequence[int], points: PointExport
) -> Sequence[int | None]:
    if not found:
        return [None] * len(rows)
    groups = dict.fromkeys("::".join(points.names[i][:-1]) for i in found)
    if len(rows) != len(found) or len(groups) > 1:
        read = f"{len(found)} points (lines {listing((str(points.lines[i]) for i in found), 5)})"
        asked = f"{len(rows)} rows of {table.path} (lines {listing((str(table.lines[row]) for row in rows), 5)})"
        which = f" in groups {listing(map(repr, groups), 5)}" if len(groups) > 1 else ""
        hint = "name each row's point in a column 'point', empty where nothing was read"
        text = f"{name!r}: {read}{which} for {asked}: {hint}"
        raise TableError(Place(points.path, points.lines[found[0]]), text)
    return found


def _flags(
    table: Table, wanted: Sequence[str], points: PointExport, point_of: Sequence[int | None]
) -> tuple[Flag, ...]:
    flags = []
    blind = [row for row, point in enumerate(point_of) if point is None]
    if blind:
        rows = listing((f"{wanted[row] or 'unnamed'} (line {table.lines[row]})" for row in blind), 5)
        text = f"{len(blind)} of {len(table)} rows have no point in {points.path} and count as not measured: {rows}"
        flags.append(Flag("unmeasured_rows", text))
    spare = sorted(set(range(len(points.names))) - set(point_of))
    if spare:
        names = listing((f"{points.full_name(i)} (line {points.lines[i]})" for i in spare), 5)
        flags.append(Flag("surplus_points", f"{len(spare)} points of {points.path} belong to no row: {names}"))
    return tuple(flags)


def _columns(table: Table, points: PointExport, point_of: Sequence[int | None]) -> dict[str, Column]:
    """Return the exported columns row by row, empty where a row has no point."""

    def column(name: str, cells: Sequence[str]) -> Column:
        return Column(f"{name} in {points.path}", "", 1.0, tuple("" if i is None else cells[i] for i in point_of))

    position = {axis: [repr(float(v)) for v in points.position[:, i]] for i, axis in enumerate(AXES)}
    columns = {name: column(name, cells) for name, cells in (position | dict(points.extras)).items()}
    stamps = next((name for name, cells in points.extras.items() if all(map(_ISO.fullmatch, cells))), None)
    if stamps and "time" not in table.columns and None not in point_of:
        columns["time"] = column("time", _seconds(points, stamps))
        del columns[stamps]
    return columns


def _seconds(points: PointExport, name: str) -> list[str]:
    """Return ISO 8601 stamps as seconds since the first; other formats leave month and day open and stay text."""
    times = []
    for line, cell in zip(points.lines, points.extras[name], strict=True):
        try:
            times.append(datetime.fromisoformat(cell).replace(tzinfo=None).timestamp())
        except ValueError:
            raise TableError(Place(points.path, line), f"{cell!r} is no date and time") from None
    return [repr(float(seconds)) for seconds in np.array(times) - min(times)]
