"""Several files to one campaign: rows brought together by name, by time or by their order."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from armflex.conventions import NUMBER, UNITS, Array
from armflex.errors import InputError, Place, TableError, listing
from armflex.intake.meanings import Meaning, meanings
from armflex.intake.sources import Source, read_source, said
from armflex.measured.points import LENGTHS

TARGET = re.compile(r"(.+?)[ _\-.:]*(?:T|SMR|TGT|TARGET|PRISM|REFL\w*)[ _\-]?(\d)", re.IGNORECASE)
"""How the name of a point ends that is of one target among several."""

CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)")

TURNS = ("a", "b", "c", "w", "p", "r", "rx", "ry", "rz")
"""Columns beside a controller's own X Y Z that are the orientation of its tool."""

Ask = Callable[[str, Sequence[str]], str]
"""Asks a question with its possible answers, where somebody is there to answer."""


@dataclass(frozen=True, eq=False)
class Intake:
    """Files as one campaign.

    Attributes:
        columns: Of the campaign, text and numbers by header, every one of as many rows.
        taken: (file, column, what it is, unit, why) of every column.
        joined: How rows were brought together, in words.
        declare: What the arm file needs for it: a further target's [instrument.NAME].
        notes: What was left out, and why.
    """

    columns: Mapping[str, Sequence[Any]]
    taken: tuple[tuple[str, str, str, str, str], ...]
    joined: str
    declare: str = ""
    notes: tuple[str, ...] = ()


def intake(
    paths: Sequence[str | Path], sigma: float, taken: Mapping[str, str] | None = None, ask: Ask | None = None
) -> Intake:
    """Return the campaign that a controller's log and a tracker's export are together, or one file with both.

    Args:
        paths: The files, in any order.
        sigma: One standard deviation of a measured coordinate [m].
        taken: What columns are where their names do not say it, by name: `q_J1_deg`, `x_mm`, `pose`, `time`.
        ask: Asks where a guess is open; a file is refused there when not given.

    Raises:
        InputError: With everything that is wrong or open in the files, each with what to do.
        TableError: A file is no table.
    """
    sources, known, wrong = [read_source(path) for path in paths], dict(taken or {}), list[str]()
    every = {name for one in sources for name in one.header}
    wrong += [
        f"--take {name}: no file has this column (columns: {listing(every)})" for name in known if name not in every
    ]
    understood = [meanings(source, known) for source in sources]
    logs = [i for i, own in enumerate(understood) if any(one.kind == "joint" for one in own)]
    points = [i for i, own in enumerate(understood) if any(one.kind == "coordinate" for one in own)]
    if len(points) > 1 and len(set(points) - set(logs)) == 1:  # a log has where its controller holds the tool to be
        for i in set(points) & set(logs):
            why = "the controller's own, computed from its joints"
            understood[i] = tuple(
                replace(one, kind="unused", unit="", why=why)
                if one.kind == "coordinate" or one.name.lower() in TURNS
                else one
                for one in understood[i]
            )
        points = [i for i in points if i not in logs]
    for i, source in enumerate(sources):
        understood[i], about = _settled(source, understood[i], ask)
        wrong += about
    for i, source in enumerate(sources):
        if i not in (*logs, *points):
            named = listing(source.header)
            wrong.append(f"{source.path}: neither joints nor x y z among its columns ({named}): --take COLUMN=q_J1_deg")
    if len(logs) != 1 or len(points) != 1:
        text = f"{len(logs)} files have joints and {len(points)} have x y z"
        wrong.append(f"{text}: give one log and one export, or one file of both")
    if wrong:
        raise InputError("\n".join(wrong))
    log, export = sources[logs[0]], sources[points[0]]
    if log is not export:  # what an instrument's program adds is no cause of the arm's errors
        understood[points[0]] = tuple(
            replace(one, kind="unused") if one.kind == "covariate" else one for one in understood[points[0]]
        )
    of_log, of_export = understood[logs[0]], understood[points[0]]
    rows = _numbers(log, of_log, ("joint",))
    places = _numbers(export, of_export, ("coordinate",))
    if log is export:
        names = list(_cells(log, of_log, "name") or map(str, range(1, len(log.lines) + 1)))
        pairs, targets, joined, notes = {"": np.arange(len(names))}, [""], "one file: row by row", ()
    else:
        pairs, targets, names, joined, notes = _joined(log, of_log, export, of_export)
    columns: dict[str, Sequence[Any]] = {"pose": names}
    columns |= {one.name: _cells(log, (one,), "kept") or () for one in of_log if one.kind == "kept"}
    if (times := _cells(log, of_log, "time")) and (seconds := _seconds(times)) is not None:
        columns["time"] = (seconds - seconds.min()).tolist()
    for name, values in rows.items():
        columns[f"q_{name}"] = values.tolist()
    xyz = np.column_stack([places[axis] for axis in "xyz"])
    for number, target in enumerate(targets):
        head = ("x", "y", "z") if number == 0 else tuple(f"target{target}_{axis}" for axis in "xyz")
        own = pairs[target]
        for i, axis in enumerate(head):
            columns[axis] = ["" if row < 0 else float(xyz[row, i]) for row in own]
        if number == 0:
            columns["sigma"] = [sigma] * len(names)
    for one, cells in zip(of_log, log.columns, strict=True):
        if one.kind == "covariate" and one.name not in columns and all(map(NUMBER.fullmatch, cells)):
            columns[one.name] = list(map(float, cells))
    table = tuple(
        (source.path.name, one.column, _words(one), one.unit or "", one.why)
        for source, own in zip(sources, understood, strict=True)
        for one in own
    )
    declare = "\n".join(
        f'[instrument.target{target}]\nkind = "position"\nlink = "TIP"          # the link that it is on\n'
        f"point = [0.0, 0.0, 0.0]\npoint_std = 0.3       # its place is found\nsigma = {sigma:g}"
        for target in targets[1:]
    )
    return Intake(columns, table, joined, declare, notes)


def _words(one: Meaning) -> str:
    words = {"joint": f"joint {one.name}", "coordinate": f"measured {one.name}", "name": "name of the row or point"}
    words |= {"time": "time", "kept": one.name, "covariate": "a covariate", "unused": "not used"}
    return words[one.kind]


def _settled(source: Source, own: Sequence[Meaning], ask: Ask | None) -> tuple[tuple[Meaning, ...], list[str]]:
    """Return what columns are with every open unit settled, and what is wrong with them."""
    found, wrong, answers = [], list[str](), dict[str, str]()
    for one in own:
        if one.kind in ("joint", "coordinate") and one.unit is None:
            choices = ("deg", "rad") if one.kind == "joint" else ("mm", "m", "inch")
            if ask is not None and one.kind not in answers:
                answers[one.kind] = ask(
                    f"{source.path.name}: in which unit is {one.column!r}, and all like it?", choices
                )
            if one.kind in answers:
                one = Meaning(one.column, one.kind, one.name, answers[one.kind], "as answered")
            else:
                base = f"q_{one.name}" if one.kind == "joint" else one.name
                wrong.append(
                    f"{source.path}: the unit of column {one.column!r} is stated nowhere:"
                    f" --take '{one.column}={base}_{choices[0]}' or ={base}_{choices[1]}"
                )
        found.append(one)
    for name in dict.fromkeys(source.header):
        if source.header.count(name) > 1:
            wrong.append(f"{source.path}: two columns are called {name!r}: rename one")
    for kind in ("joint", "coordinate", "name", "time"):
        named = [one for one in found if one.kind == kind]
        for one in {one.name for one in named}:
            twice = [other.column for other in named if other.name == one]
            if len(twice) > 1:
                wrong.append(
                    f"{source.path}: columns {listing(map(repr, twice))} are all {_words(named[0])}: --take one"
                )
    for one, cells in zip(found, source.columns, strict=True):
        if one.kind in ("joint", "coordinate"):
            bad = next((i for i, cell in enumerate(cells) if not NUMBER.fullmatch(cell)), None)
            if bad is not None and not (one.kind == "coordinate" and not cells[bad]):
                place = Place(source.path, source.lines[bad])
                wrong.append(f"{place}: {one.column!r} is {said(cells[bad])}, expected a number")
    return tuple(found), wrong


def _numbers(source: Source, own: Sequence[Meaning], kinds: tuple[str, ...]) -> dict[str, Array]:
    """Return (N,) numbers of joints or coordinates in SI, by name; nan where a cell is empty."""
    return {
        one.name: np.array([float(cell) if cell else np.nan for cell in cells])
        * (UNITS["angle"] if one.kind == "joint" else LENGTHS)[one.unit or ""]
        for one, cells in zip(own, source.columns, strict=True)
        if one.kind in kinds
    }


def _cells(source: Source, own: Sequence[Meaning], kind: str) -> tuple[str, ...] | None:
    every = dict(zip(source.header, source.columns, strict=True))
    return next((every[one.column] for one in own if one.kind == kind), None)


def _seconds(cells: Sequence[str]) -> Array | None:
    """Return times [s]: numbers, ISO 8601 stamps, or a clock's; None where they are something else."""
    found = []
    for cell in cells:
        if NUMBER.fullmatch(cell):
            found.append(float(cell))
            continue
        try:
            found.append(datetime.fromisoformat(cell).replace(tzinfo=None).timestamp())
        except ValueError:
            match = CLOCK.search(cell)
            if match is None:
                return None
            found.append(3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3].replace(",", ".")))
    return np.array(found)


def _joined(
    log: Source, of_log: Sequence[Meaning], export: Source, of_export: Sequence[Meaning]
) -> tuple[dict[str, np.ndarray], list[str], list[str], str, tuple[str, ...]]:
    """Return by target the (N,) row of the export for each of the log, -1 where there is none; targets, names, how.

    By name where the files share any, else row by row where they are as long, else by time.
    """
    wanted, given = _cells(log, of_log, "name"), _cells(export, of_export, "name")
    count = len(log.lines)
    names = list(wanted or map(str, range(1, count + 1)))
    split = [(match[1], match[2]) if (match := TARGET.fullmatch(one)) else (one, "") for one in given or ()]
    split = [(base.split("::")[-1].strip(), target) for base, target in split]
    targets = sorted({target for _, target in split})
    several = len(targets) > 1
    if given and not several:
        split, targets = [(one.split("::")[-1].strip(), "") for one in given], [""]
    if wanted and given and set(wanted) & {base for base, _ in split}:
        found = {target: np.full(count, -1) for target in targets}
        for target in targets:
            rows: dict[str, list[int]] = {}
            for i, (base, own) in enumerate(split):
                if own == target:
                    rows.setdefault(base, []).append(i)
            for row, name in enumerate(wanted):
                if rows.get(name):
                    found[target][row] = rows[name].pop(0)
            spare = [export.lines[i] for left in rows.values() for i in left]
            if spare:
                text = (
                    f"{len(spare)} points of {export.path.name} belong to no row (lines {listing(map(str, spare), 5)})"
                )
                return found, targets, names, "by name", (text,)
        empty = [names[i] for i in range(count) if all(found[target][i] < 0 for target in targets)]
        notes = (f"no point of {len(empty)} rows: {listing(empty, 5)}; their x y z are empty",) if empty else ()
        return found, targets, names, f"by name{f', targets {listing(targets)}' if several else ''}", notes
    per = len(export.lines) // max(len(targets), 1)
    if per == count and (not several or all(sum(own == one for _, own in split) == count for one in targets)):
        found = {one: np.array([i for i, (_, own) in enumerate(split) if own == one] if several else np.arange(count))
                 for one in targets or [""]}  # fmt: skip
        return found, targets or [""], names, "row by row: no name is in both files", ()
    here, there = (_cells(one, own, "time") for one, own in ((log, of_log), (export, of_export)))
    at, of = (None if cells is None else _seconds(cells) for cells in (here, there))
    if at is not None and of is not None and not several:
        near = np.abs(of[None] - at[:, None]).argmin(axis=1)
        apart = np.abs(of[near] - at)
        step = float(np.median(np.diff(np.sort(of)))) if len(of) > 1 else 1.0
        row = np.where(apart <= 0.5 * step, near, -1)
        if (row >= 0).any():
            notes = (f"{int((row < 0).sum())} rows have no point within {0.5 * step:.3g} s",) if (row < 0).any() else ()
            return {"": row}, [""], names, f"by time, {float(np.median(apart)):.3g} s apart", notes
    problem = f"{count} rows of {log.path.name} and {per} points of {export.path.name} share no name and no time"
    raise TableError(Place(export.path), f"{problem}: add a column 'point' to the log, or the same names to both")
