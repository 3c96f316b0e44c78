"""Several files to one campaign: rows brought together by name, by time or by their order."""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from armflex.conventions import LARGEST, NUMBER, Array, in_mm
from armflex.errors import (
    FEW,
    InputError,
    ManyErrors,
    Place,
    TableError,
    UnknownNameError,
    UrdfError,
    did_you_mean,
    listing,
)
from armflex.files.arm_file import ROBOTS
from armflex.intake.bags import together
from armflex.intake.clock import counted, doubt, goes_back, times, unread
from armflex.intake.dh import UPRIGHT, DhTable, arm_text, is_dh, read_dh
from armflex.intake.lost import emptied, without_lost
from armflex.intake.meanings import (
    ANGLE_UNITS,
    ANGLES,
    COUNTS,
    OUTER,
    ROUNDED,
    SETS,
    SINCE_1970,
    STEPS,
    TIME_UNITS,
    TURN,
    VECTOR,
    Ask,
    Meaning,
    combined,
    meanings,
    polar,
    stated,
)
from armflex.intake.names import is_resorted, paired_names
from armflex.intake.picture_files import camera
from armflex.intake.pointing import Run, instrument_text, is_pointing, meanings_of, mount_text, read_pointing
from armflex.intake.recordings import read_sources
from armflex.intake.sources import NO_READING, Cells, SourceTable, numbers, said
from armflex.intake.streams import (
    STANDS,
    STEP,
    between,
    contradiction,
    dwells,
    held,
    is_dense,
    is_sampled,
    nearest,
    never_there,
    offset,
    paired,
    reduced,
    repeated,
    spread,
    two_sources,
    unsteady,
    unwrapped,
)
from armflex.measured.points import LENGTHS
from armflex.measured.table import Column, Table, csv_text
from armflex.robot.robot import Robot, load_robot

TARGET = re.compile(
    r"(.+?)(?:(?:(?<=\d)|[ _\-.:])T|[ _\-.:]*(?:SMR|TGT|TARGET|PRISM|REFL\w*))[ _\-]?(\d)", re.IGNORECASE
)
"""How the name of a point ends that is of one target among several; not that of `Punkt_1`."""

MOST_TURNS = 10.0
"""No joint of an arm is turned further from its zero."""

MOST_METRES = 1e4
"""No place is further from where it is measured [m]: a total station reaches 3.5 km."""

ONE_TARGET = 5e-3
"""Tolerance: places of one name in two exports that are nearer [m] are of one target: a sphere of one is wider."""

MOST_MOTION = 200.0
"""No arm moves a target over more [m]: no structure of one is longer."""

SAMPLES = 100
"""So many rows that stand and move are samples, whatever their clock is."""

FRAMES = re.compile(
    r"(?:(?:coord\w*|ref(?:erence)?|work(?:ing)?)[ _]?)?(?:frame|system|c?sys|ucs)(?:[ _]?(?:id|name))?"
    r"|\w*(?:koordinaten|bezugs)system",
    re.IGNORECASE,
)
"""Header of a column that says in which frame a place is."""

TURNS = ("a", "b", "c", "w", "p", "r", "rx", "ry", "rz")
"""Columns beside a controller's own X Y Z that are the orientation of its tool."""

DIGITS = 12
"""Decimals of a metre or a radian: further ones are of a conversion."""

CIRCUMSTANCE = re.compile(
    r".*(?:temp|mass|gewicht|weight|humid|feucht|press|druck|operator|bediener).*"
    r"|(?:.*[\W_])?(?:(?:pay)?load|\w*last)(?:[\W_].*)?",
    re.IGNORECASE,
)
"""Names of what an instrument's program, or a recording, has beside readings and may be a cause of the arm's errors."""


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
        arm: Text of an arm file, where one of the files has its DH parameters.
    """

    columns: Mapping[str, Sequence[Any]]
    taken: tuple[tuple[str, str, str, str, str], ...]
    joined: str
    declare: str
    notes: tuple[str, ...]
    lines: tuple[int, ...]
    path: Path
    arm: str | None = None

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


def intake(
    paths: Sequence[str | Path],
    sigma: float | None,
    taken: Mapping[str, str] | None = None,
    ask: Ask | None = None,
    targets: Sequence[str] = (),
    dh: str | None = None,
    *,
    sigma_r: float | None = None,
    board: str | None = None,
    on_arm: bool = False,
    beside: Path | None = None,
    tip: str | None = None,
    joints: Sequence[str] = (),
) -> Intake:
    """Return the campaign that a controller's log and a tracker's export are together, or one file with both.

    A log alone becomes rows without readings: a path, or poses to predict.

    A recording counts where the arm stands: a row for each dwell, with the means of what was recorded in it. Pictures
    of a board, or a table of corners, are an export as well: each row has the name of its picture.

    Args:
        paths: The files, in any order.
        sigma: One standard deviation of a measured coordinate [m]; None where none is measured.
        taken: What columns are where their names do not say it, by name: `q_J1_deg`, `x_mm`, `pose`, `time`.
        ask: Asks where a guess is open; a file is refused there when not given.
        targets: Which topics, bodies or markers of recordings are the targets.
        dh: Form of a table of DH parameters among the files, "standard" or "modified".
        sigma_r: One standard deviation of a recorded orientation [rad]; None leaves orientations out.
        board: The board in pictures as one option, see `board_of`; None where the arm file has it.
        on_arm: Whether the board is on the arm, and not the camera.
        beside: Folder of the campaign, that of the log when not given: what is named in it is relative to this.
        tip: Last link of a URDF among the files, its only leaf when not given.
        joints: Which topics of a recording have the joints, where several have the same ones.

    Raises:
        ManyErrors: With everything that is wrong or open in the files, each with what to do.
        InputError: The arm never stands in a recording, or two recordings do not match.
        TableError: A file is no table.
        UnsupportedError: The package that reads a recording is not installed.
    """
    if runs := [Path(path) for path in paths if is_pointing(Path(path))]:
        return _pointing([Path(path) for path in paths], runs, taken or {}, sigma)
    sources, asked_for, wrong = list[SourceTable](), dict(taken or {}), list[str]()
    robot = None
    robots = [Path(path) for path in paths if Path(path).suffix.lower() in ROBOTS]
    for path in paths:
        try:
            sources += read_sources(path) if Path(path) not in robots else []
        except TableError as error:
            wrong.append(str(error))
    sources = _gone_on(sources)
    rows_of_arm = next((source for source in sources if is_dh(source)), None)
    sources, arm = [source for source in sources if source is not rows_of_arm], None
    try:
        unused = [name for name, meaning in asked_for.items() if meaning == "unused"]
        arm = read_dh(rows_of_arm, dh, ask, unused) if rows_of_arm is not None else None
        robot = load_robot(robots[0], tip, allow_massless=True) if robots else None
    except (TableError, ManyErrors, UrdfError, UnknownNameError) as error:
        wrong += str(error).splitlines()
    if len(robots) + (rows_of_arm is not None) > 1:
        wrong.append("several files describe the arm: give one URDF, or one table of DH parameters")
    every = dict.fromkeys(name for source in (*sources, *filter(None, [rows_of_arm])) for name in source.header)
    wrong += [
        f"--take {name}: no file has this column (columns: {listing(every)})" for name in asked_for if name not in every
    ]
    moving = [] if robot is None else [joint.name for joint in robot.moving]
    slides = [] if robot is None else [joint.name for joint in robot.moving if joint.kind == "prismatic"]
    understood = [meanings(source, asked_for, moving, slides) for source in sources]
    for source, meant in zip(sources, understood, strict=True):
        wrong += combined(source, meant, asked_for, moving)
    sources, understood, about = _one_log(sources, understood, joints, ask)
    wrong += about
    logs = [i for i, meant in enumerate(understood) if any(meaning.kind == "joint" for meaning in meant)]
    points = [i for i, meant in enumerate(understood) if any(meaning.kind == "coordinate" for meaning in meant)]
    points, about = _chosen(sources, points, targets, ask)
    wrong += about
    if points and set(points) - set(logs):  # a log has where its controller holds the tool to be
        for i in set(points) & set(logs):
            why = "the controller's own, computed from its joints"
            understood[i] = tuple(
                replace(meaning, kind="unused", unit="", why=why)
                if meaning.kind in ("coordinate", "turn") or meaning.name.lower() in TURNS
                else meaning
                for meaning in understood[i]
            )
        points = [i for i in points if i not in logs]
    pictures = [
        i for i, meant in enumerate(understood) if i not in logs and any(meaning.kind == "picture" for meaning in meant)
    ]
    for i, source in enumerate(sources):
        if i in (*logs, *points, *pictures):
            try:
                sources[i] = without_lost(source, understood[i], i not in logs) if i in points else source
            except TableError as error:
                wrong.append(str(error))
            understood[i], about = _settled(sources[i], understood[i], ask, slides)
            wrong += about + (_in_frames(sources[i], understood[i]) if i in points else [])
        elif not source.part:
            wrong.append(_no_place(source, joints=False))
    if not points and not pictures and len(logs) == len(sources) == 1:
        wrong += filter(None, [_no_place(sources[0], joints=True)])
    if not wrong and (len(logs) != 1 or len(pictures) > 1 or (not points and not pictures and len(sources) > 1)):
        text = f"{len(logs)} files have joints and {len(points)} have x y z"
        text += f", {len(pictures)} are pictures" if pictures else ""
        wrong.append(f"{listing(map(str, paths), FEW)}: {text}: give one log and one export, or one file of both")
    if points and sigma is None:
        wrong.append("the files have coordinates: --sigma 0.05mm says how well one is measured")
    if sigma_r is not None and points:
        wrong += _unturned([sources[i] for i in points], [understood[i] for i in points])
    for one in sources if wrong else ():
        if {"x", "y", "z"} <= {*one.header} and any(name.startswith("sigma") for name in one.header):
            wrong.append(f"{one.path}: has x y z and sigma, as a campaign in SI: calibrate and trace read one as it is")
    declared, shown, beside = "", list[str](), beside or (sources[logs[0]].path.parent if logs else Path())
    if board is not None and not pictures:
        wrong.append("--board: no folder of pictures and no table of corners is among the files")
    elif board is not None:
        source, name = (
            sources[pictures[0]],
            next(meaning.name for meaning in understood[pictures[0]] if meaning.kind == "picture"),
        )
        declared, shown, about = camera(source, board, on_arm, name, beside)
        wrong += about
    if robot is not None and len(logs) == 1:
        understood[logs[0]], about = _as_robot(understood[logs[0]], robot)
        wrong += about
    if wrong:
        raise ManyErrors(wrong)
    log, exports = logs[0], [i for i in points if i not in logs]
    beside_joints = {meaning.column.partition(" ")[0].lower() for meaning in understood[log]} & {*TURNS}
    if log in points and len(beside_joints) >= 3:
        text = "x y z stand beside the joints, with angles of the tool as controllers log them: these compute them from"
        sources[log] = replace(sources[log], notes=(*sources[log].notes, f"{text} the joints; are they measured?"))
    for i in exports:  # what an instrument's program says of its own readings is no cause of the arm's errors
        why = "of the instrument"
        understood[i] = tuple(
            replace(meaning, kind="unused", why=why)
            if meaning.kind == "covariate" and not _is_kept(meaning)
            else meaning
            for meaning in understood[i]
        )
    understood[log] = _named_alike(sources, understood, log, exports)
    sources, notes = _standing(sources, understood, log, exports)
    about = list(dict.fromkeys(note for i in (log, *points) for note in sources[i].notes))
    joined = _campaign(sources, understood, log, points, pictures, (sigma, sigma_r), beside, [*shown, *notes, *about])
    joined = replace(joined, declare="\n\n".join(filter(None, (joined.declare, declared))))
    if robot is not None:
        urdf = Path(os.path.relpath(robots[0], beside)).as_posix()
        lines = ["[robot]", f'urdf = "{urdf}"', f'tip = "{robot.tip}"', UPRIGHT]
        lines += ["allow_massless = true"] if any(flag.code == "massless" for flag in robot.flags) else []
        return replace(joined, arm=arm_text(lines, robot.tip, joined.declare, bool(points)))
    return joined if rows_of_arm is None or arm is None else _by_dh(joined, rows_of_arm, arm, bool(points))


def _gone_on(sources: Sequence[SourceTable]) -> list[SourceTable]:
    """Return sources in which a part of a recording that goes on in another file is whole, and stands once."""
    whole = list[SourceTable]()
    for source in sources:
        alike = (i for i, other in enumerate(whole) if (other.part, other.header) == (source.part, source.header))
        recorded = source.header[:1] == ("time",) and all(isinstance(cells, np.ndarray) for cells in source.columns)
        at = next(alike, None) if source.part and recorded else None
        if at is None:
            whole.append(source)
            continue
        first, second = sorted((whole[at], source), key=lambda part: part.columns[0][0])
        pairs = [(numbers(before), numbers(after)) for before, after in zip(first.columns, second.columns, strict=True)]
        if first.path != second.path and pairs[0][0].max() < pairs[0][1].min():
            columns = [np.concatenate(pair) for pair in pairs]
            lines, notes = (*first.lines, *second.lines), (*first.notes, *second.notes)
            doubts = {**first.doubts, **second.doubts}
            whole[at] = replace(first, lines=lines, columns=tuple(columns), notes=notes, doubts=doubts)
        elif not all(np.array_equal(before, after, equal_nan=True) for before, after in pairs):
            whole.append(source)
    return whole


def _called_alike(sources: Sequence[SourceTable], indices: Sequence[int], chosen: Sequence[str]) -> list[str]:
    """Return what is wrong where a chosen part of a recording is not the only one of its name."""
    for name in chosen:
        several = [sources[i].path for i in indices if sources[i].part == name]
        if len(several) > 1:
            files = listing(map(str, dict.fromkeys(several)), FEW)
            text = f"{len(several)} parts are called {name!r}, and they differ: call each by a name of its own,"
            return [f"{files}: {text} or make a campaign of each recording and give all to calibrate"]
    return []


def _pointing(paths: Sequence[Path], runs: Sequence[Path], taken: Mapping[str, str], sigma: float | None) -> Intake:
    """Return pointing runs as one campaign, each a session where they are several."""
    if others := [str(path) for path in paths if path not in runs]:
        raise InputError(f"{runs[0]} is a pointing run, a campaign by itself: {listing(others)} cannot be joined to it")
    if taken or sigma is not None:
        text = "its columns and units are known; how well a direction is known is `sigma` of [instrument.star]"
        raise InputError(f"{runs[0]} is a pointing run: leave out --{'take' if taken else 'sigma'}, {text}")
    read, wrong = list[Run](), list[str]()
    for path in runs:
        try:
            read.append(read_pointing(path))
        except TableError as error:
            wrong.append(str(error))
    if wrong:
        raise ManyErrors(wrong)
    if len({run.joints for run in read}) > 1:
        raise InputError(f"{listing(map(str, runs))} are of mounts with different axes: give those of one mount")
    every = [run.columns for run in read]
    shared = [name for name in every[0] if all(name in columns_of for columns_of in every)]
    columns: dict[str, Sequence[Any]] = {
        name: [cell for columns_of in every for cell in columns_of[name]] for name in shared
    }
    if len(read) > 1:
        columns["session"] = [run.path.stem for run in read for _ in run.lines]
        columns["pose"] = [f"{run.path.stem} {name}" for run in read for name in run.names]
    table = tuple(meaning for run in read for meaning in meanings_of(run))
    notes = tuple(note for run in read for note in run.notes)
    lines = tuple(line for run in read for line in run.lines)
    how = "to nothing: a row has star and axes"
    return Intake(columns, table, how, instrument_text(read[0]), notes, lines, read[0].path, mount_text(read[0]))


def _is_kept(meaning: Meaning) -> bool:
    """Return whether a column beside readings or samples is a covariate: by its name, or as asked."""
    return meaning.why == "as asked" or bool(CIRCUMSTANCE.fullmatch(meaning.name))


def _by_dh(joined: Intake, source: SourceTable, arm: DhTable, tracked: bool) -> Intake:
    """Return a campaign with the arm file of a table of DH parameters, whose rows are the log's joints.

    Raises:
        TableError: There are more or fewer of them.
    """
    joints, notes = [name.removeprefix("q_") for name in joined.columns if name.startswith("q_")], joined.notes
    if names := next((names for _, names in SETS if {*names} == {*joints}), None):  # ROS sorts them by name
        joints = list(names)
    elif len({joint.rstrip("0123456789") for joint in joints}) == 1 and all(joint[-1:].isdigit() for joint in joints):
        joints.sort(key=lambda joint: int(re.findall(r"\d+", joint)[-1]))
    else:
        notes = (*notes, f"the rows of {source.title} are {listing(joints)}")
    if len(joints) != len(arm.rows):
        text = f"has {len(arm.rows)} rows, and the log {len(joints)} joints: {listing(joints)}"
        raise TableError(Place(source.path), text)
    units = {what.removeprefix("joint "): (column, unit) for _, column, what, unit, _ in joined.taken}
    for row, (name, slides) in enumerate(zip(joints, arm.slides, strict=True)):
        column, unit = units.get(name, (name, "rad"))
        if unit != "rad" and (unit in LENGTHS) != slides:
            text = f"joint {name!r} {'slides' if slides else 'turns'}, and column {column!r} of the log is in {unit}"
            raise TableError(Place(source.path, source.lines[row]), text)
    taken = (*((source.title, *cells) for cells in arm.taken), *joined.taken)
    text = arm_text(arm.lines(joints), "flange", joined.declare, tracked)
    return replace(joined, taken=taken, notes=notes, arm=text)


def _named_alike(
    sources: Sequence[SourceTable], understood: Sequence[tuple[Meaning, ...]], log: int, exports: Sequence[int]
) -> tuple[Meaning, ...]:
    """Return what a log's columns are, one without a meaning among them its names where most are those of points."""
    meant, source = understood[log], sources[log]
    given = [cells for i in exports if (cells := _cells(sources[i], understood[i], "name")) is not None]
    if not given or any(meaning.kind == "name" and meaning.why != COUNTS for meaning in meant):
        return meant
    labels = [str(label).split("::")[-1].strip() for cells in given for label in cells]
    labels = [*labels, *(match[1] for label in labels if (match := TARGET.fullmatch(label)))]
    for i, (meaning, cells) in enumerate(zip(meant, source.columns, strict=True)):
        pairing = None
        if meaning.kind in ("covariate", "unused"):
            pairing = paired_names(list(map(str, cells)), labels, by_number=False)
        if pairing is not None and 2 * len(pairing.shared) > len(cells):
            named = replace(meaning, kind="name", name="pose", unit="", why="the points' names")
            others = [replace(other, kind="unused") if other.kind == "name" else other for other in meant]
            return (*others[:i], named, *others[i + 1 :])
    return meant


def _as_robot(of_log: tuple[Meaning, ...], robot: Robot) -> tuple[tuple[Meaning, ...], list[str]]:
    """Return what a log's columns are with its joints as the robot's file calls them, and what is wrong.

    Joints that a controller only numbers are those of the file, base to tip.
    """
    named, moving = (
        [meaning.name for meaning in of_log if meaning.kind == "joint"],
        [meaning.name for meaning in robot.moving],
    )
    kinds = {joint.name: joint.kind for joint in robot.moving}
    for meaning in of_log:
        slides = kinds.get(meaning.name) == "prismatic"
        if (
            meaning.kind == "joint"
            and meaning.name in kinds
            and meaning.unit not in (None, "rad")
            and (meaning.unit in LENGTHS) != slides
        ):
            text = (
                f"column {meaning.column!r} is in {meaning.unit}, and joint {meaning.name!r} of {robot.urdf.path.name}"
            )
            return of_log, [f"{text} {'slides' if slides else 'turns'}"]
    if set(moving) <= set(named):
        off = {"kind": "unused", "unit": "", "why": "no joint between base and tip"}
        return tuple(
            replace(meaning, **off) if meaning.kind == "joint" and meaning.name not in moving else meaning
            for meaning in of_log
        ), []
    numbered = [re.fullmatch(r"\D*?(\d)", joint) for joint in named]
    counts = [match and int(match[1]) for match in numbered]
    if names := next((names for _, names in SETS if {*names} == {*named}), None):
        counts = [names.index(joint) for joint in named]
    if counts not in (list(range(1, len(moving) + 1)), list(range(len(moving)))):
        text = f"the log has joints {listing(named)}, and {robot.urdf.path.name} has {listing(moving)}"
        return of_log, [f"{text}: --take 'COLUMN=q_{moving[0]}'"]
    by = dict(zip(named, moving, strict=True))
    return tuple(
        replace(meaning, name=by[meaning.name]) if meaning.kind == "joint" else meaning for meaning in of_log
    ), []


def _chosen(
    sources: Sequence[SourceTable], points: Sequence[int], targets: Sequence[str], ask: Ask | None
) -> tuple[list[int], list[str]]:
    """Return which sources with places count: all files, and of the parts of a recording those that are targets."""
    parts = {sources[i].part: i for i in points if sources[i].part}
    whole = [i for i in points if not sources[i].part]
    if unknown := [name for name in targets if name not in parts]:
        hint = did_you_mean(unknown[0], parts)
        return whole, [f"--target {unknown[0]}: no recording has it{hint} (they have: {listing(parts)})"]
    if targets:
        return whole + [parts[name] for name in targets], _called_alike(sources, points, targets)
    stamped = [name for name in parts if "->" not in name] or list(parts)
    if len(stamped) > 1 and ask is not None:
        stamped = [ask("Which of these is the target?", stamped)]
    if len(stamped) > 1:
        return whole, [f"several could be the target: {listing(stamped)}: --target '{stamped[0]}', one or more times"]
    return whole + [parts[name] for name in stamped], _called_alike(sources, points, stamped)


def _one_log(
    sources: Sequence[SourceTable],
    understood: Sequence[tuple[Meaning, ...]],
    topics: Sequence[str],
    ask: Ask | None,
) -> tuple[list[SourceTable], list[tuple[Meaning, ...]], list[str]]:
    """Return sources, what their columns are, and what is wrong, with the joints of a recording's topics as one log.

    Joints with different names are joined over time; where two topics have the same joint, one of them is chosen.
    """
    logs = [
        i for i, meant in enumerate(understood) if sources[i].part and any(meaning.kind == "joint" for meaning in meant)
    ]
    parts = {sources[i].part: i for i in logs}
    if unknown := [name for name in topics if name not in parts]:
        hint = did_you_mean(unknown[0], parts)
        text = f"--joints {unknown[0]}: no recording has joints there{hint} (they are in: {listing(parts)})"
        return list(sources), list(understood), [text]
    of_topic = {
        part: {meaning.name for meaning in understood[i] if meaning.kind == "joint"} for part, i in parts.items()
    }
    chosen = list(topics) or list(parts)
    if alike := _called_alike(sources, logs, chosen):
        return list(sources), list(understood), alike
    for part in chosen:
        rivals = [other for other in chosen if of_topic[other] & of_topic[part]]
        if len(rivals) > 1 and ask is not None and not topics:
            answer = ask("Which of these topics has the joints?", rivals)
            chosen = [other for other in chosen if other not in rivals or other == answer]
        elif len(rivals) > 1:
            both = listing(sorted(of_topic[rivals[0]] & of_topic[rivals[1]]))
            text = f"{listing(rivals)} have the same joints ({both}): --joints {rivals[0]}, or the other"
            return list(sources), list(understood), [f"{sources[parts[part]].path}: {text}"]
    chosen_parts = [parts[part] for part in parts if part in chosen]
    kept = [i for i in range(len(sources)) if i not in logs or i in chosen_parts]
    if len(chosen_parts) > 1 and len({sources[i].path for i in chosen_parts}) == 1:
        first, merged = chosen_parts[0], together([sources[i] for i in chosen_parts])
        kept = [i for i in kept if i == first or i not in chosen_parts]
        meant = {meaning.column: meaning for i in chosen_parts for meaning in understood[i]}
        return (
            [merged if i == first else sources[i] for i in kept],
            [tuple(meant[name] for name in merged.header) if i == first else understood[i] for i in kept],
            [],
        )
    return [sources[i] for i in kept], [understood[i] for i in kept], []


def _moved(source: SourceTable, meant: Sequence[Meaning]) -> tuple[Array, str]:
    """Return (N, d) joint positions [rad] of a log, else (N, 3) places [m], and that unit."""
    kind, unit = ("joint", "rad") if any(meaning.kind == "joint" for meaning in meant) else ("coordinate", "m")
    return np.column_stack([*_numbers(source, meant, (kind,)).values()]), unit


def _filled(source: SourceTable, meant: Sequence[Meaning]) -> SourceTable:
    """Return a log with the joints that are empty in rows of other topics' messages there, see `between`."""
    values = {i: numbers(source.columns[i]) for i, meaning in enumerate(meant) if meaning.kind == "joint"}
    gaps = {i: read for i, cells in values.items() if (read := np.isfinite(cells)).any() and not read.all()}
    if source.part or not gaps or (time := times(source, meant)) is None or not np.isfinite(time).all():
        return source
    time, columns = spread(time), list(source.columns)
    for i, read in gaps.items():
        columns[i] = between(time, time[read], values[i][read])
    return replace(source, columns=tuple(columns))


def _standing(
    sources: list[SourceTable], understood: list[tuple[Meaning, ...]], log: int, exports: Sequence[int]
) -> tuple[list[SourceTable], list[str]]:
    """Return sources with recordings reduced to where the arm stood, all at once, and what was found of their clocks.

    Raises:
        InputError: The arm never stands, or two recordings do not match.
    """
    clocks, notes, shifts = dict[int, Array](), list[str](), dict[Path, float]()
    written, sources = sources, [_filled(source, meant) for source, meant in zip(sources, understood, strict=True)]
    moved = {i: _moved(sources[i], understood[i]) for i in (log, *exports)}
    for i, (values, unit) in moved.items():
        if (time := times(sources[i], understood[i])) is not None and is_dense(even := spread(time), values, unit):
            clocks[i] = even
            if (row := goes_back(time, _moved(written[i], understood[i])[0])) is not None:
                text = f"its clock goes back {time[row - 1] - time[row]:.4g} s here: it was set again, or counts over"
                raise TableError(Place(sources[i].path, sources[i].lines[row]), f"{text}: part the file there")
            if not np.array_equal(time, even):
                stamps = f"{len(np.unique(time))} stamps for {len(time)} rows"
                notes.append(f"the clock of {sources[i].title} repeats itself ({stamps}): rows are spread between them")
            if unit == "rad":
                sources[i] = _continuous(sources[i], understood[i], even)
                moved[i] = _moved(sources[i], understood[i])
            if (pair := two_sources(even, places := moved[i][0], unit)) is not None:
                at, further = pair
                apart = float(np.linalg.norm(places[further] - places[at]))
                text = f"{listing(f'{value:.6g}' for value in places[at])} {unit} at {even[at]:.3f} s here and"
                text = f"{sources[i].part} is at {text} {listing(f'{value:.6g}' for value in places[further])} at"
                text += (
                    f" {even[further]:.3f} s, {in_mm(apart) if unit == 'm' else f'{apart:.4g} {unit}'} apart, to and"
                )
                text += " fro while the arm stands: two programs or instruments wrote it, keep one of them"
                raise TableError(Place(sources[i].path, sources[i].lines[at]), text.strip())
        elif is_sampled(STEP * np.arange(len(values), dtype=float), values, unit) and len(values) >= SAMPLES:
            text = f"has {len(values)} rows of what stands and moves, samples of a recording, and no clock of one: "
            other = unread(sources[i], understood[i]) or "--take COLUMN=time_s says which column it is"
            text += other if time is None else f"its rows are {_step(time)}"
            raise InputError(f"{sources[i].title}: {text}")
    if not clocks:
        return sources, []
    first = log if log in clocks else exports[0]
    values, unit = moved[first]
    read = clocks[first][np.isfinite(values).all(axis=1)]
    before, after = (read.min() - clocks[first].min(), clocks[first].max() - read.max()) if len(read) else (0.0, 0.0)
    if max(before, after) > STANDS:
        text = f"{sources[first].title} lacks a joint in its first {before:.4g} s and its last {after:.4g} s"
        notes.append(f"{text}: no row is of then")
    spans = dwells(clocks[first], values, unit)
    within = [(clocks[first] >= start) & (clocks[first] <= end) for start, end in spans]
    there = np.array([np.isfinite(values[rows]).any(axis=0).all() for rows in within], dtype=bool)
    if not there.all() and there.any():
        text = f"{len(spans) - np.count_nonzero(there)} more stands, the first at {spans[there.argmin(), 0]:.4g} s,"
        notes.append(f"{text} are left out: some joint has no position there")
    spans = spans[there]
    if not len(spans):
        text = f"nothing stands still for {STANDS:g} s in it, whose rows are {_step(clocks[first])}"
        raise InputError(f"{sources[first].path}: {text}: a campaign stops for a second at each pose")
    notes.insert(0, f"the arm stands {len(spans)} times in {sources[first].title}")
    for i in clocks:
        shift = 0.0
        if i != first and first == log:
            path = sources[i].path
            if path not in shifts:
                shifts[path] = offset(clocks[log], moved[log][0], clocks[i], moved[i][0])
                notes.append(f"the clock of {sources[i].title} is {shifts[path]:+.3f} s off, as the motions say")
            shift = shifts[path]
            order, places = np.argsort(clocks[i], kind="stable"), moved[i][0]
            gone = np.zeros(len(places), dtype=bool)
            of_log = [between(clocks[i][order] - shift, clocks[log], column) for column in moved[log][0].T]
            gone[order] = held(places[order], clocks[i][order], spans + shift, np.column_stack(of_log))
            if gone.any():
                sources[i] = emptied(sources[i], understood[i], gone, "is exactly where it was before")
            gone = unsteady(clocks[i], np.where(gone[:, None], np.nan, places), spans + shift)
            if gone.any():
                sources[i] = emptied(sources[i], understood[i], gone, "moves or jumps while the arm stands")
        sources[i], understood[i] = _one_sided(sources[i], understood[i])
        sources[i] = _within_turn(reduced(sources[i], clocks[i], spans, shift), written[i], understood[i])
        understood[i] = tuple(
            replace(meaning, kind="unused", why="a signal of a recording")
            if meaning.kind == "covariate" and not _is_kept(meaning)
            else meaning
            for meaning in understood[i]
        )
    return sources, notes


def _continuous(source: SourceTable, meant: Sequence[Meaning], time: Array) -> SourceTable:
    """Return a recording of joints without the full turns by which they jump, and empty where they never were.

    Args:
        source: The recording.
        meant: What its columns are.
        time: (N,) [s].

    Raises:
        TableError: Two programs wrote its positions.
    """
    order, columns, notes = np.argsort(time, kind="stable"), list(source.columns), source.notes
    values, _ = _moved(source, meant)
    gone = np.zeros(len(time), dtype=bool)
    gone[order] = never_there(time[order], values[order])
    if gone.any():
        row = int(gone.argmax())
        text = f"{np.count_nonzero(gone)} rows of {source.title} have all joints at 0, and jump from or to there"
        notes = (*notes, f"{text}, as in line {source.lines[row]}: they are left out")
    joints = [(i, meaning) for i, meaning in enumerate(meant) if meaning.kind == "joint"]
    for (i, meaning), column in zip(joints, np.where(gone[:, None], np.nan, values)[order].T, strict=True):
        rows, turning = order[read := np.isfinite(column)], meaning.unit in ANGLE_UNITS
        if not source.part and (at := contradiction(time[rows], column[read])) is not None:
            text = f"{meaning.column!r} is at {column[read][at]:.4g} [{'rad' if turning else 'm'}] here and elsewhere"
            place = Place(source.path, source.lines[rows[at]])
            raise TableError(place, f"{text} just before and after, again and again: two programs wrote it")
        there = unwrapped(column[read]) if turning else column[read]
        if gone.any() or (there != column[read]).any():
            cells = np.full(len(time), np.nan)
            cells[rows] = there / (LENGTHS | ANGLE_UNITS)[meaning.unit or ""]
            columns[i] = cells
    return replace(source, columns=tuple(columns), notes=notes)


def _within_turn(source: SourceTable, written: SourceTable, meant: Sequence[Meaning]) -> SourceTable:
    """Return the rows of dwells with joints on the branch that their recording is written on."""
    columns = list(source.columns)
    for i, meaning in enumerate(meant):
        if meaning.kind == "joint" and meaning.unit in ANGLE_UNITS:
            full, read = 2.0 * np.pi / ANGLE_UNITS[meaning.unit], numbers(written.columns[i])
            middle = 0.5 * (np.nanmin(read) + np.nanmax(read))
            columns[i] = numbers(columns[i]) - full * np.round((numbers(columns[i]) - middle) / full)
    return replace(source, columns=tuple(columns))


def _step(time: Array) -> str:
    apart = f"{float(np.median(np.diff(np.sort(time)))):.3g} s apart"
    return apart if np.isfinite(time).all() else "without a time in some lines"


def _campaign(
    sources: Sequence[SourceTable],
    understood: Sequence[Sequence[Meaning]],
    log_at: int,
    points: Sequence[int],
    pictures: Sequence[int],
    sigmas: tuple[float | None, float | None],
    beside: Path,
    notes: Sequence[str],
) -> Intake:
    """Return the rows of the log with the places, orientations and pictures that belong to them."""
    log, of_log = sources[log_at], understood[log_at]
    rows, notes, hows = _numbers(log, of_log, ("joint",)), list(notes), list[str]()
    for name, values in rows.items():
        for i in np.flatnonzero(~np.isfinite(values))[:1]:
            raise TableError(Place(log.path, log.lines[i]), f"joint {name!r} has no position while the arm stands here")
    names = list(map(str, _cells(log, of_log, "name") or range(1, len(log.lines) + 1)))
    placed: dict[str, Array] = {}
    exported: list[tuple[int, np.ndarray]] = []
    turned = np.zeros((0, 4))
    for i in points:
        if i == log_at:
            pairs, how, about = {"": np.arange(len(names))}, "one file: row by row", []
        else:
            pairs, names, how, about = _joined(log, of_log, names, sources[i], understood[i])
        export, more = _unheld(sources[i], understood[i], pairs, np.column_stack([*rows.values()]))
        xyz = np.column_stack([_numbers(export, understood[i], ("coordinate",))[axis] for axis in "xyz"])
        hows, notes = [*hows, how], [*notes, *about, *more]
        for target, row_of in pairs.items():
            label = target if len(points) < 2 else str(len(placed) + 1)
            if i != log_at and row_of is next(iter(pairs.values())):
                exported.append((i, row_of))
            places = np.where((row_of >= 0)[:, None], xyz[row_of], np.nan)
            whole = i == log_at or export.part or len(pairs) > 1
            before = None if whole else _read_before(placed, places, names, export)
            if (not placed or before == next(iter(placed))) and (four := _turns(export, understood[i])) is not None:
                others = turned if len(turned) else np.full((len(names), 4), np.nan)
                turned = np.where((row_of >= 0)[:, None], four[row_of], others)
            if before is not None:
                places = np.where(np.isfinite(places), places, placed[before])
                empty = [name for name, place in zip(names, places, strict=True) if not np.isfinite(place).all()]
                notes = [note for note in notes if not note.endswith("rows stay empty")]
                notes.append(f"{export.path.name} goes on with the target of the export before it")
                text = f"{listing(empty, 5)} without a point: {len(empty)} of {len(names)} rows stay empty"
                notes += [text] if empty else []
            placed[label if before is None else before] = places
    path = not points and not pictures and not any(meaning.kind == "picture" for meaning in of_log)
    columns: dict[str, Sequence[Any]] = {"via" if path else "pose": names}
    for meaning in of_log:
        if meaning.kind == "kept":
            columns[meaning.name] = list(map(str, _cells(log, (meaning,), "kept") or ()))
    timed = times(log, of_log)
    notes += filter(None, [unread(log, of_log)])
    if timed is not None and not (there := np.isfinite(timed)).all():
        notes.append(f"times are left out: line {log.lines[int(there.argmin())]} of {log.path.name} has none")
        timed = None
    if timed is not None and path:
        columns["time"] = (timed - timed.min()).tolist()
        notes += [f"time 0 is {_clock(log, of_log, timed)[int(timed.argmin())]}"] if timed.min() > SINCE_1970 else []
    elif timed is not None:
        columns["time"] = _clock(log, of_log, timed)
    elif path:
        columns["time"] = np.arange(len(names), dtype=float).tolist()
        notes.append("the log has no times: each row is a second after the one before")
    for name, values in rows.items():
        columns[f"q_{name}"] = values.tolist()
    for number, (target, xyz) in enumerate(placed.items()):
        head = ("x", "y", "z") if number == 0 else tuple(f"target{target}_{axis}" for axis in "xyz")
        measured = np.isfinite(xyz).all(axis=1)
        for i, axis in enumerate(head):
            columns[axis] = [
                float(at) if is_measured else ""
                for at, is_measured in zip(xyz[:, i], np.atleast_1d(measured), strict=True)
            ]
        if number == 0:
            columns["sigma"] = [sigmas[0]] * len(names)
    if len(turned) and sigmas[1] is None:
        notes.append("orientations of the target are not used: --sigma-r 0.5mrad says how well one is measured")
    elif len(turned):
        measured = np.asarray(np.isfinite(turned).all(axis=1))
        vectors = Rotation.from_quat(np.where(measured[:, None], turned, [0.0, 0.0, 0.0, 1.0])).as_rotvec()
        for axis, column in zip(("rx", "ry", "rz"), vectors.T, strict=True):
            columns[axis] = [float(at) if is_measured else "" for at, is_measured in zip(column, measured, strict=True)]
        columns["sigma_r"] = [sigmas[1]] * len(names)
    for meaning in of_log:
        if meaning.kind == "picture":
            columns[meaning.name] = list(map(str, _cells(log, (meaning,), "picture") or ()))
    for i in pictures:
        pairs, _, how, about = _joined(log, of_log, names, sources[i], understood[i])
        hows, notes, whole = [*hows, f"pictures {how}"], [*notes, *about], sources[i].path.is_dir()
        name, cells = next(
            (meaning.name, _cells(sources[i], (meaning,), "picture"))
            for meaning in understood[i]
            if meaning.kind == "picture"
        )
        folder = Path(os.path.relpath(sources[i].path, beside)) if whole else Path()
        paths = [(folder / str(one)).as_posix() for one in cells or ()]
        columns[name] = [paths[k] if k >= 0 else "" for k in pairs[""]]
    for meaning, cells in zip(of_log, log.columns, strict=True):
        if meaning.kind == "covariate" and meaning.name not in columns:  # a socket, a height that was read in some rows
            values = numbers(cells)
            columns[meaning.name] = values.tolist() if np.isfinite(values).all() else list(map(str, cells))
    for i, row_of in exported:
        notes += _add_beside(columns, sources[i], understood[i], row_of)
    table = tuple(
        (source.title, meaning.column, _words(meaning), meaning.unit or "", meaning.why)
        for i, (source, meant) in enumerate(zip(sources, understood, strict=True))
        if i in (log_at, *points) or not source.part
        for meaning in meant
    )
    declare = "\n".join(
        f'[instrument.target{target}]\nkind = "position"\nlink = "TIP"          # the link that it is on\n'
        f"point = [0.0, 0.0, 0.0]\npoint_std = 0.3       # its place is found\nsigma = {sigmas[0]:g}"
        for target in list(placed)[1:]
    )
    how = listing(dict.fromkeys(hows)) if hows else "to nothing: each is a via-point"
    return Intake(columns, table, how, declare, tuple(notes), log.lines, log.path)


def _read_before(placed: Mapping[str, Array], places: Array, names: Sequence[str], export: SourceTable) -> str | None:
    """Return which target an export reads on: one that has no other place in any row, None where that is none.

    Raises:
        TableError: Its places are another reading of those of a target.
    """
    for target, before in placed.items():
        apart = np.linalg.norm(places - before, axis=1)
        both = np.isfinite(apart)
        if not apart[both].any():
            return target
        if apart[both].max() < ONE_TARGET:
            row = int(np.nanargmax(apart))
            text = f"has {names[row]!r}, which another export has {in_mm(apart[row])} from there: leave one out"
            raise TableError(Place(export.path), text)
    return None


def _unheld(
    export: SourceTable, meant: Sequence[Meaning], pairs: Mapping[str, np.ndarray], joints: Array
) -> tuple[SourceTable, Sequence[str]]:
    """Return an export that is empty where an instrument holds its last place, see `repeated`, and a note of it.

    Args:
        export: With x, y and z.
        meant: What its columns are.
        pairs: By target, (N,) its row for each of the log, -1 for none.
        joints: (N, n) positions in the log [rad or m].
    """
    places = np.column_stack([_numbers(export, meant, ("coordinate",))[axis] for axis in "xyz"])
    gone = np.zeros(len(places), dtype=bool)
    for row_of in pairs.values():
        of_log = np.argsort(row_of, kind="stable")[np.count_nonzero(row_of < 0) :]
        gone[row_of[of_log]] |= repeated(places[row_of[of_log]], joints[of_log])
    if not gone.any():
        return export, ()
    export = emptied(export, meant, gone, "is exactly where it was before, though joints moved")
    return export, export.notes[-1:]


def _add_beside(
    columns: dict[str, Sequence[Any]], source: SourceTable, meant: Sequence[Meaning], row_of: np.ndarray
) -> list[str]:
    """Add what an export has beside its readings to a campaign; return what is left out of it, in words.

    Args:
        columns: Of the campaign; they are not replaced.
        source: The export.
        meant: What its columns are.
        row_of: (N,) its row for each of the campaign, -1 for none.
    """
    for meaning, cells in zip(meant, source.columns, strict=True):
        if meaning.kind in ("covariate", "kept") and meaning.name not in columns:
            values, there = numbers(cells)[row_of], row_of >= 0
            texts = [str(cells[k]) if k >= 0 else "" for k in row_of]
            columns[meaning.name] = values.tolist() if (np.isfinite(values) & there).all() else texts
    if "time" not in columns and (row_of >= 0).all() and (seconds := times(source, meant)) is not None:
        clock = _clock(source, meant, seconds) if np.isfinite(seconds).all() else None
        columns |= {} if clock is None else {"time": [clock[k] for k in row_of]}
    left = [
        f"{meaning.column!r} ({listing(map(said, states), FEW)})" if 1 < len(states) <= FEW else repr(meaning.column)
        for meaning, cells in zip(meant, source.columns, strict=True)
        if meaning.kind == "unused" and meaning.why == "of the instrument"
        for states in [sorted({*map(str, cells)} - {""})]
    ]
    text = f"{listing(left, 8)} of {source.title} left out, as of the instrument: --take 'COLUMN=NAME' keeps one"
    return [text] if left else []


def _clock(source: SourceTable, meant: Sequence[Meaning], seconds: Array) -> list[Any]:
    """Return times [s] as a campaign has them: dates where the clock has them (ISO 8601), else from the first."""
    if not seconds.min() > SINCE_1970:
        return (seconds - seconds.min()).tolist()
    cells = _cells(source, meant, "time")
    counted = cells is not None and np.isfinite(numbers(cells)).any()  # of Unix: in UTC
    dates = [datetime.fromtimestamp(float(second), UTC) for second in seconds]
    return [(date if counted else date.replace(tzinfo=None)).isoformat() for date in dates]


def _words(meaning: Meaning) -> str:
    words = {
        "joint": f"joint {meaning.name}",
        "coordinate": f"measured {meaning.name}",
        "name": "name of the row or point",
    }
    words |= {"turn": f"measured orientation {meaning.name}", "picture": f"picture of {meaning.name}"}
    words |= {"time": meaning.name, "kept": meaning.name, "covariate": "a covariate", "unused": "not used"}
    return words[meaning.kind]


def _settled(
    source: SourceTable, meant: Sequence[Meaning], ask: Ask | None, slides: Sequence[str]
) -> tuple[tuple[Meaning, ...], list[str]]:
    """Return what columns are with every open unit settled, and what is wrong with them."""
    settled, wrong, answers = [], list[str](), dict[tuple[str, tuple[str, ...]], str]()
    for one in meant:
        if one.kind in ("joint", "coordinate", "turn") and one.unit is None:
            length = one.kind == "coordinate" or (one.kind == "joint" and one.name in slides)
            choices = ("mm", "m", "inch") if length else ("mm", "deg") if one.why == OUTER else ("deg", "rad")
            kind = (one.kind, choices)
            if ask is not None and kind not in answers:
                answers[kind] = ask(f"{source.path.name}: in which unit is {one.column!r}, and all like it?", choices)
            if kind in answers:
                one = replace(one, unit=answers[kind], why="as answered")
            else:
                base = f"q_{one.name}" if one.kind == "joint" else one.name
                said_twice = listing(stated(source)) if one.kind == "coordinate" else ""
                wrong.append(
                    f"{source.path}: the unit of column {one.column!r} is "
                    f"{f'stated as {said_twice}' if said_twice else 'stated nowhere'}:"
                    f" --take '{one.column}={base}_{choices[0]}' or ={base}_{choices[1]}"
                )
        elif unknown := _unknown_unit(source, one):
            wrong.append(unknown)
            one = replace(one, unit="")
        elif (
            (units := LENGTHS if one.kind == "coordinate" else ANGLE_UNITS)
            and one.kind in ("coordinate", "joint")
            and one.unit in units
            and one.why != "as asked"
            and (others := stated(source, units))
            and not any(np.isclose(units[one.unit], units[other]) for other in others)
        ):
            text = f"{source.path}: {one.column!r} is in {one.unit}, and the file's head says {listing(others)}:"
            base = f"q_{one.name}" if one.kind == "joint" else one.name
            wrong.append(f"{text} --take '{one.column}={base}_{one.unit}' if it is")
        settled.append(one)
    for name in dict.fromkeys(source.header):
        if source.header.count(name) > 1:
            wrong.append(f"{source.path}: two columns are called {name!r}: rename one")
    for kind in ("joint", "coordinate", "turn", "name", "time"):
        named = [meaning for meaning in settled if meaning.kind == kind]
        for one in {name.name for name in named}:
            twice = [other.column for other in named if other.name == one]
            if len(twice) > 1:
                wrong.append(
                    f"{source.path}: columns {listing(map(repr, twice))} are all"
                    f" {_words(next(name for name in named if name.name == one))}: --take one"
                )
    sampled = False  # so that a row is of one topic among several
    if not wrong and any(meaning.kind in ("joint", "coordinate") for meaning in settled):
        values, unit = _moved(_filled(source, settled), settled)
        settled = counted(source, settled, values, unit)
        wrong += filter(None, [doubt(source, settled)])
        time = times(source, settled) if not wrong else None
        sampled = time is not None and is_dense(spread(time), values, unit)
    for one, cells in zip(settled, source.columns, strict=True):
        if one.kind in ("joint", "coordinate", "turn", "time"):
            values = numbers(cells)
            bad = np.abs(values) > LARGEST
            if one.kind != "time" and not isinstance(cells, np.ndarray):
                blank = one.kind in ("coordinate", "turn") or sampled
                bad |= [not (NUMBER.fullmatch(cell) or (blank and NO_READING.fullmatch(cell))) for cell in cells]
            if one.kind == "joint" and not (source.part or sampled):
                bad |= np.isnan(values)
            if bad.any():
                at = int(bad.argmax())
                place = Place(source.path, source.lines[at])
                wrong.append(f"{place}: {one.column!r} is {said(str(cells[at]))}, expected a number")
            elif one.kind != "time" and one.unit:
                wrong += _implausible(source, one, values)
        if one.kind == "joint" and one.column in source.doubts:
            wrong.append(f"{source.path}: {source.doubts[one.column]}")
    return tuple(settled), wrong


def _no_place(source: SourceTable, joints: bool) -> str:
    """Return what is wrong with a file that has no places, nor `joints`; nothing where those are enough."""
    if columns := polar(source.header):
        named = ", ".join(f"{name} = {column!r}" for name, column in zip(("Hz", "V", "D"), columns, strict=True))
        text = "has angles and a distance and no x y z: have coordinates exported, or compute columns"
        text += " x = D sin V sin Hz, y = D sin V cos Hz, z = D cos V"
        return f"{source.path}: {text} ({named}; V from the zenith, Hz clockwise, as a total station counts)"
    named = listing(source.header)
    text = f"{source.path}: neither joints nor x y z among its columns ({named}): --take COLUMN=q_J1_deg"
    return "" if joints else text


def _in_frames(source: SourceTable, meant: Sequence[Meaning]) -> list[str]:
    """Return what is wrong with places that a column says to be in several frames."""
    wrong = list[str]()
    for meaning, cells in zip(meant, source.columns, strict=True):
        if meaning.kind != "covariate" or meaning.why == "as asked" or not FRAMES.fullmatch(meaning.column.strip()):
            continue
        frames = sorted({*map(str, cells)} - {""})
        if len(frames) > 1 and not all(map(NUMBER.fullmatch, frames)):
            text = f"{source.path}: {meaning.column!r} says that places are in {listing(map(said, frames), FEW)}:"
            text += (
                f" export them in one frame, or --take '{meaning.column}=session' where the instrument was set up anew,"
            )
            wrong.append(f"{text} '{meaning.column}=unused' where all are in one")
    return wrong


def _unknown_unit(source: SourceTable, meaning: Meaning) -> str:
    """Return what is wrong with the unit that a header states, nothing where it is known."""
    units = {"joint": ANGLE_UNITS | LENGTHS, "coordinate": LENGTHS, "turn": ANGLE_UNITS, "time": TIME_UNITS}
    known = units.get(meaning.kind, {})
    cells = source.columns[source.header.index(meaning.column)]
    clock = meaning.kind == "time" and not np.isfinite(numbers(cells)).any()
    if not meaning.unit or not known or meaning.unit in known or clock:
        return ""
    base = f"q_{meaning.name}" if meaning.kind == "joint" else meaning.name
    if meaning.kind == "joint" and STEPS.fullmatch(meaning.unit):
        text = f"column {meaning.column!r} is in {meaning.unit}, and how many are a turn, and which is 0, is in no file"
        return f"{source.path}: {text}: convert it to degrees, as the drive's manual says"
    text = f"column {meaning.column!r} is in {meaning.unit!r}, which is not known ({listing(known, 6)})"
    return f"{source.path}: {text}: convert it, or --take '{meaning.column}={base}_UNIT'"


def _implausible(source: SourceTable, meaning: Meaning, values: Array) -> list[str]:
    """Return what is wrong with (N,) numbers of a joint, a place or a turn that no arm reaches, by line and column."""
    turns = meaning.kind != "coordinate" and meaning.unit in ANGLE_UNITS
    factor = (LENGTHS if meaning.kind == "coordinate" else LENGTHS | ANGLE_UNITS)[meaning.unit or ""]
    size = np.abs(values) * factor
    most = TURN if meaning.kind == "turn" else 2.0 * np.pi * MOST_TURNS
    beyond = size > (most if turns else MOST_METRES)
    if not beyond.any():
        read = factor * values[np.isfinite(values)]
        moves = 0.0 if turns or not len(read) else float(np.diff(np.quantile(read, [0.1, 0.9]))[0])
        text = f"{meaning.column!r} in {meaning.unit} moves over {moves:.4g} m, and no arm does: is it in mm?"
        remedy = f"--take '{meaning.column}={meaning.name}_mm'" if not source.part else "convert it"
        return [f"{source.path}: {text} {remedy}"] if moves > MOST_MOTION else []
    at, base = int(beyond.argmax()), f"q_{meaning.name}" if meaning.kind == "joint" else meaning.name
    what = f"{size[at] / (2.0 * np.pi):.4g} turns" if turns else f"{1e-3 * size[at]:.4g} km"
    more = f", and {np.count_nonzero(beyond) - 1} rows more" if np.count_nonzero(beyond) > 1 else ""
    other = " or ".join(unit for unit in (("deg", "rad") if turns else ("mm", "m", "um")) if unit != meaning.unit)
    text = f"{meaning.column!r} is {values[at]:.10g} {meaning.unit}, {what}{more}: no arm is there"
    return [
        f"{Place(source.path, source.lines[at])}: {text}; empty it, or --take '{meaning.column}={base}_UNIT' ({other})"
    ]


def _numbers(source: SourceTable, meant: Sequence[Meaning], kinds: tuple[str, ...]) -> dict[str, Array]:
    """Return (N,) numbers of joints or coordinates in SI, by name; nan where a cell is empty."""
    factors = LENGTHS | ANGLE_UNITS

    def converted(values: Array, factor: float) -> Array:
        return values if factor == 1.0 else np.round(values * factor, DIGITS)

    return {
        meaning.name: converted(numbers(cells), factors[meaning.unit or ""])
        for meaning, cells in zip(meant, source.columns, strict=True)
        if meaning.kind in kinds
    }


def _turns(source: SourceTable, meant: Sequence[Meaning]) -> Array | None:
    """Return (N, 4) quaternions x y z w of a target, not a number where none was read; None where it has none."""
    parts = {
        meaning.name: numbers(cells) * ANGLE_UNITS.get(meaning.unit or "", 1.0)
        for meaning, cells in zip(meant, source.columns, strict=True)
        if meaning.kind == "turn"
    }
    if parts.keys() >= {"qw", "qx", "qy", "qz"}:
        four = np.column_stack([parts[f"q{axis}"] for axis in "xyzw"])
        size = np.sqrt((four**2).sum(axis=1))
        four[size < 0.1] = np.nan  # noughts where nothing was set
        for i in np.flatnonzero(np.abs(size - 1.0) > ROUNDED)[:1] if np.isfinite(four).any() else ():
            if np.isfinite(four[i]).all():
                raise TableError(
                    Place(source.path, source.lines[i]), f"its quaternion is {size[i]:.4g} long, expected 1"
                )
        return np.asarray(four / size[:, None], dtype=float)
    if names := next((names for names in (VECTOR, ANGLES) if parts.keys() >= set(names)), None):
        three = np.column_stack([parts[name] for name in names])
        read, four = np.isfinite(three).all(axis=1), np.full((len(three), 4), np.nan)
        if read.any():
            turn = Rotation.from_rotvec(three[read]) if names == VECTOR else Rotation.from_euler("xyz", three[read])
            four[read] = turn.as_quat()
        return four
    return None


def _one_sided(source: SourceTable, meant: tuple[Meaning, ...]) -> tuple[SourceTable, tuple[Meaning, ...]]:
    """Return a recording with its orientation as quaternions on one side, so that means of them exist."""
    four = _turns(source, meant)
    if four is None or not (read := np.isfinite(four).all(axis=1)).any():
        return source, meant
    apart = (four[read][1:] * four[read][:-1]).sum(axis=1) < 0.0
    four[read] *= np.cumprod(np.concatenate([[1.0], np.where(apart, -1.0, 1.0)]))[:, None]
    kept = [i for i, meaning in enumerate(meant) if meaning.kind != "turn"]
    names = ("qx", "qy", "qz", "qw")
    columns = (*(source.columns[i] for i in kept), *four.T)
    header = (*(source.header[i] for i in kept), *names)
    turns = (Meaning(name, "turn", name, "", "its orientation") for name in names)
    return replace(source, header=header, columns=columns), (*(meant[i] for i in kept), *turns)


def _unturned(sources: Sequence[SourceTable], understood: Sequence[Sequence[Meaning]]) -> list[str]:
    """Return why no file has the orientation that --sigma-r is of, nothing where one has it."""
    turns = [{meaning.name for meaning in meant if meaning.kind == "turn"} for meant in understood]
    whole = ({"qw", "qx", "qy", "qz"}, {*VECTOR}, {*ANGLES})
    if any(names >= names_of for names in turns for names_of in whole):
        return []
    wrong = list[str]()
    for source, meant in zip(sources, understood, strict=True):
        text = f"{source.path}: --sigma-r, and no orientation is read"
        quaternion = [meaning for meaning in meant if meaning.name == "turn"]
        wrong += [f"{text}: {meaning.column!r} is of {meaning.why}" for meaning in quaternion]
        others = listing(repr(meaning.column) for meaning in meant if meaning.kind in ("covariate", "unused", "turn"))
        if not quaternion:
            text += f" (other columns: {others}): a quaternion is qw qx qy qz; --take 'COLUMN=rx_deg', ry_deg, rz_deg"
            wrong.append(f"{text} for a rotation vector, roll_deg, pitch_deg, yaw_deg for angles about fixed x, y, z")
    return wrong


def _cells(source: SourceTable, meant: Sequence[Meaning], kind: str) -> Cells | None:
    every = dict(zip(source.header, source.columns, strict=True))
    return next((every[meaning.column] for meaning in meant if meaning.kind == kind and meaning.name != "date"), None)


def _joined(
    log: SourceTable, of_log: Sequence[Meaning], names: list[str], export: SourceTable, of_export: Sequence[Meaning]
) -> tuple[dict[str, np.ndarray], list[str], str, list[str]]:
    """Return by target the (N,) row of the export for each of the log, -1 for none; names of rows, how, and notes.

    By name where the files share any; by time where both have a clock and one is a recording, or their order is in
    doubt; else row by row where they are as long, else by time.

    Raises:
        TableError: Nothing says which rows are of one another: names that differ are no order.
    """
    wanted, given = _cells(log, of_log, "name"), _cells(export, of_export, "name")
    count, what = len(log.lines), "picture" if any(meaning.kind == "picture" for meaning in of_export) else "point"
    if what == "picture":
        given, wanted = list(map(str, given or ())), names
        if (pictured := _cells(log, of_log, "picture")) is not None:
            wanted = [Path(str(picture)).stem for picture in pictured]
    labels = [str(label).split("::")[-1].strip() for label in ([""] * len(export.lines) if given is None else given)]
    split = [(match[1], match[2]) if (match := TARGET.fullmatch(label)) else (label, "") for label in labels]
    targets = sorted({target for _, target in split})
    if len(targets) < 2 or len({base for base, _ in split}) < 2 or what == "picture":
        split, targets = [(label, "") for label in labels], [""]
    several = f", targets {listing(targets)}" if len(targets) > 1 else ""
    rows_of = {target: np.array([i for i, (_, of) in enumerate(split) if of == target]) for target in targets}
    counted = what == "point" and any(meaning.kind == "name" and meaning.why == COUNTS for meaning in of_log)
    pairing = None
    if wanted is not None and given is not None:
        pairing = paired_names(list(map(str, wanted)), [base for base, _ in split])
    if pairing is not None and not (counted and not pairing.shared >= set(pairing.points)):
        row_of, spare = {}, list[int]()
        for target, rows in rows_of.items():
            left: dict[Hashable, list[int]] = {}
            for i in rows.tolist():
                left.setdefault(pairing.points[i], []).append(i)
            repeated = Counter(pairing.rows)
            for key, places in left.items():
                if key in repeated and len(places) != repeated[key]:
                    of_point = [export.lines[i] for i in places]
                    of_row = [log.lines[i] for i, name in enumerate(pairing.rows) if name == key]
                    raise TableError(
                        Place(export.path, export.lines[places[-1]]),
                        f"{what} {split[places[0]][0]!r} stands in {_lines(of_point)} here and in"
                        f" {_lines(of_row)} of {log.path.name}: which is of which row is not known;"
                        " leave out what does not count, or give each a name of its own",
                    )
            row_of[target] = np.array([left[key].pop(0) if left.get(key) else -1 for key in pairing.rows])
            spare += [export.lines[i] for lines in left.values() for i in lines]
        notes = []
        if spare:
            at = listing(map(str, sorted(spare)), 5)
            notes.append(f"{len(spare)} {what}s of {export.path.name} belong to no row (lines {at})")
        empty = [names[i] for i in range(count) if all(row_of[target][i] < 0 for target in targets)]
        if empty:
            notes.append(f"{listing(empty, 5)} without a {what}: {len(empty)} of {count} rows stay empty")
        pairs = ((names[i], split[row[i]][0]) for row in row_of.values() for i in range(count) if row[i] >= 0)
        if (differing := next((pair for pair in pairs if pair[0] != pair[1]), None)) and what == "point":
            notes.append(f"names are written in two ways: {differing[0]!r} of the log is point {differing[1]!r}")
        return row_of, names, f"by {'the number in their names' if pairing.numbered else 'name'}{several}", notes
    if log.spans is not None and export.spans is log.spans:
        empty = sum(not line for line in export.lines)
        notes = [f"{empty} of them have no reading of {export.title}"] if empty else []
        return {"": np.arange(count)}, names, "by time", notes
    at, of = times(log, of_log), times(export, of_export)
    timed = at is not None and of is not None and not (np.isnan(at).any() or np.isnan(of).any())
    equal = all(len(rows) == count for rows in rows_of.values())
    recorded = log.spans is not None or export.spans is not None
    other = (
        what == "point"
        and not counted
        and all(cells is not None and len(set(map(str, cells))) > 1 for cells in (wanted, given))
    )  # both have names, and they are not the same
    points = None if given is None else [split[i][0] for i in rows_of[targets[0]]]
    ordered = points if wanted is None or counted else names if given is None else None  # the other says nothing
    resorted = what == "point" and ordered is not None and is_resorted(ordered)
    unlike = False
    if at is not None and of is not None and timed and equal and len(targets) == 1:
        unlike = bool((np.argsort(at, kind="stable") != np.argsort(of, kind="stable")).any())
    if timed and at is not None and of is not None and (recorded or not equal or other or resorted or unlike):
        row_of, shifts, apart, spare = {}, [], [], list[int]()
        for target, rows in rows_of.items():
            base, seconds = (log.spans, of[rows]) if export.spans is None else (export.spans, at)
            try:
                places, shift = nearest(at, seconds) if base is None else paired(base, seconds)
            except InputError as error:
                raise TableError(Place(export.path), f"{error}") from None
            shifts.append(shift)
            if export.spans is not None:
                row_of[target] = places
                continue
            row = np.full(count, -1)
            for i, place in zip(rows, places, strict=True):
                if place >= 0 and row[place] < 0:
                    row[place] = i
                else:
                    spare.append(export.lines[i])
            row_of[target] = row
            apart += np.abs(of[row[row >= 0]] - shift - at[row >= 0]).tolist()
        if any((row >= 0).any() for row in row_of.values()):
            off = max(shifts, key=abs)
            notes = [f"the clocks are {off:+.2f} s apart, as most {what}s then fall on a row"] if off else []
            empty = sum(all(row[i] < 0 for row in row_of.values()) for i in range(count))
            notes += [f"{empty} rows have no {what} at their time"] if empty else []
            notes += [f"{len(spare)} {what}s of {export.path.name} belong to no row ({_lines(spare)})"] if spare else []
            how = f"by time{several}" + (f", {float(np.median(apart)):.3g} s apart" if apart else "")
            return row_of, names, how, notes
    header = [
        next((meaning.column for meaning in meant if meaning.kind == "name"), "") for meant in (of_log, of_export)
    ]
    if equal and (other or resorted):
        of_points, of_rows = (
            f"{called} {listing(dict.fromkeys(map(str, cells)), 3)}" if said else f"{without} has no names"
            for called, cells, said, without in (
                ("points are called", labels, given is not None, export.path.name),
                (f"the rows of {log.path.name} are called", names, wanted is not None and not counted, log.path.name),
            )
        )
        text = f"{of_points}, and {of_rows}: which is of which is not certain. Give both the same names"
        text += f", or --take '{header[0] if other or given is None else header[1]}=unused' joins them row by row"
        raise TableError(Place(export.path), text)
    if equal:
        open_ = given is not None and wanted is None and what == "point"
        called = [split[i][0] for i in rows_of[targets[0]]] if open_ else names
        return rows_of, called, f"row by row: no name is in both files{several}", []
    per = {len(rows) for rows in rows_of.values()}
    problem = f"{count} rows of {log.path.name} and {listing(map(str, per))} {what}s of {export.path.name}"
    text = f"{problem} share no name and no time: add a column 'point' to the log, or the same names to both, "
    text += "or say with --take 'COLUMN=time' which column of each is its clock"
    raise TableError(Place(export.path), text)


def _lines(numbers: Sequence[int]) -> str:
    """Return lines of a file in words."""
    return f"line{'s' if len(numbers) > 1 else ''} {listing(map(str, numbers), 5)}"
