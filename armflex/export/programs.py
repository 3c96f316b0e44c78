"""A path as robot controllers take it: joint moves in the units and the order of axes of each language."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from armflex.arm import Arm
from armflex.conventions import UNITS, Array, number
from armflex.errors import Flag, InputError, UnknownNameError, UnsupportedError, listing, naming
from armflex.export import Exported
from armflex.export.quoting import line_comment, yaml_string
from armflex.export.rigid import require_six_turning
from armflex.laws.effects.in_arm import depended_on
from armflex.measured.forces import UNLOADED, Unnamed, read_force_table
from armflex.tasks.compensate import compensate as compensated
from armflex.trajectory import Trajectory, read_trajectory
from armflex.version import __version__

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,23}")
"""What all languages take as a name; KRL has the shortest."""

WORDS = """abs and any axis bool bas char const continue decl def default deffct defdat do else elseif end enddat endfct
    endfor endfunc endif endloop endmodule endproc endswitch endwhile enum error exit ext external false fdat for frame
    from func global goto halt if import int interrupt is local loop module mod movej movel moveabsj not num or pers pos
    private proc ptp public real record repeat resume return run signal stop string struct switch sync test then thread
    to trap true undo until var wait when while xor"""
"""Words of the languages, which are no names there."""

UNCONNECTED = "9E9"
"""RAPID's value of an external axis that is not there."""

ZONE = (1.0, 1.5, 1.5, 0.15, 1.5, 0.15)
"""What makes RAPID's predefined zones of their radius [mm]: point, orientation and external axes [mm], the turns of
these [deg], as in z10 = [FALSE, 10, 15, 15, 1.5, 15, 1.5]."""


def _stops(name: str, times: int, blends: int) -> tuple[str, ...]:
    if times - blends < 1 or times < 2:
        return ()
    text = f"The robot stops at {times - blends + 1} of {times + 1} rows"
    return (f"{text}: a column `blend` [m] of the path (or blend_mm) lets it pass through a row without a stop.",)


@dataclass(frozen=True)
class Language:
    """How a controller's language writes a path of joint moves.

    Attributes:
        called: Its name in messages.
        robot, external: Its axes: of the arm, which turn, and beside it, which turn or slide.
        comment: What a comment begins with.
        opening, closing: Lines around the moves, with `{name}` for the program's (`{NAME}` in capitals), and `{axes}`
            where these are listed.
        move: The lines of a row, from its number, every axis' position by name, the time that the way takes [s], None
            for the first, and the blend [m].
        place: The lines of a row where positions stand after all moves, from its number and every axis' position;
            after the first of the closing lines.
        finish: What is done to all lines in the end.
        radians: Whether turning axes are in rad, else in deg; sliding ones are in mm.
        lost: What it cannot hold, or does at rows, as it is said, from the program's name, how many ways have times and
            rows blends.
    """

    called: str
    robot: tuple[str, ...]
    external: tuple[str, ...]
    comment: str
    opening: tuple[str, ...]
    closing: tuple[str, ...]
    move: Callable[[int, Mapping[str, str], float | None, float], str]
    radians: bool = False
    lost: Callable[[str, int, int], tuple[str, ...]] = _stops
    place: Callable[[int, Mapping[str, str]], str] | None = None
    finish: Callable[[list[str]], list[str]] = list


def _urscript_move(row: int, at: Mapping[str, str], time: float | None, blend: float) -> str:
    timed = "" if time is None else f", t={_decimal(time, 6)}"
    return f"  movej([{', '.join(at.values())}]{timed}" + (f", r={_decimal(blend, 6)})" if blend else ")")


def _krl_move(row: int, at: Mapping[str, str], time: float | None, blend: float) -> str:
    return f"PTP {{E6AXIS: {', '.join(f'{axis} {value}' for axis, value in at.items() if value)}}}"


def _krl_lost(name: str, times: int, blends: int) -> tuple[str, ...]:
    notes = (f"The program is called {name}, and so must its file be: {name}.src.",)
    lost = [f"{times} times between rows"] * bool(times) + [f"{blends} blends"] * bool(blends)
    if not lost:
        return notes
    text = f"KRL's PTP takes percents of its own maxima: {' and '.join(lost)} of the path are not in the program."
    return (*notes, text)


def _rapid_move(row: int, at: Mapping[str, str], time: float | None, blend: float) -> str:
    robot = ",".join(at[axis] or "0" for axis in RAPID_AXES)
    external = ",".join(at[axis] or UNCONNECTED for axis in RAPID_EXTERNAL)
    speed = "v100" if time is None else f"v100\\T:={_decimal(time, 6)}"
    zone = f"[FALSE,{','.join(_decimal(1e3 * blend * share, 6) for share in ZONE)}]" if blend else "fine"
    return f"    MoveAbsJ [[{robot}],[{external}]]\\NoEOffs,{speed},{zone},tool0;"


def _ls_move(row: int, at: Mapping[str, str], time: float | None, blend: float) -> str:
    paced = "10%" if time is None else f"{max(round(1e3 * time), 1)}msec"
    if time is not None and time > MOST_MS:
        paced = f"{time:.1f}sec"
    return f":J P[{row + 1}] {paced} FINE"


def _ls_place(row: int, at: Mapping[str, str]) -> str:
    """Return a position as joint angles: what a robot has not is at 0."""
    units = [(axis, at[axis] or "0", "deg" if axis in LS_AXES else "mm") for axis in at if at[axis] or axis in LS_AXES]
    held = ",\n".join(f"\t{axis}= {value} {unit}" for axis, value, unit in units)
    return f"P[{row + 1}]{{\n   GP1:\n\tUF : 0, UT : 1,\n{held}\n}};"


def _ls_finish(lines: list[str]) -> list[str]:
    """Number the lines of a program; a remark is a line of its own, before the move, of at most 32 letters."""
    done: list[str] = []
    count = 0
    for line in lines:
        if not line.startswith(":"):
            done.append(line)
            continue
        move, _, remark = line.partition("!")
        words = remark.strip().replace(";", ",")
        parts = [f":  !{words[i : i + REMARK]}" for i in range(0, len(words), REMARK)]
        for part in [*parts, *([move.rstrip()] if move.startswith(":J") else [])]:
            count += 1
            done.append(f"{count:4d}{part} ;")
    return done


def _ls_lost(name: str, times: int, blends: int) -> tuple[str, ...]:
    notes = ("Most FANUC controllers count J3 from the level, a URDF counts it from link 2: J3 is as this arm has it.",)
    return (
        (*notes, f"TP has blends in per cent: {blends} blends of the path are not in the program.") if blends else notes
    )


def _val3_move(row: int, at: Mapping[str, str], time: float | None, blend: float) -> str:
    kind = f"joint\n  mDesc.leave={_decimal(1e3 * blend, 6)}\n  mDesc.reach=mDesc.leave" if blend else "off"
    held = ",".join(value or "0" for value in at.values())
    return f"  mDesc.blend={kind}\n  jPoint={{{held}}}\n  movej(jPoint,flange,mDesc)"


def _val3_lost(name: str, times: int, blends: int) -> tuple[str, ...]:
    notes = (f"VAL3 wants the file to be named as the program is: {name}.pgx.",)
    text = f"VAL3's movej takes per cent of its own maxima: {times} times between rows are not in the program."
    return (*notes, text) if times else notes


MOST_MS = 32.0
"""Longest time that TP takes in milliseconds [s]; above, in tenths of a second."""

REMARK = 32
"""Letters of a remark in TP."""

LS_AXES = tuple(f"J{i}" for i in range(1, 7))
RAPID_AXES, RAPID_EXTERNAL = tuple(f"rax_{i}" for i in range(1, 7)), tuple(f"eax_{letter}" for letter in "abcdef")

LANGUAGES = {
    # movej with six joint positions in rad, times and blends where the path has them.
    "urscript": Language(
        "URScript",
        tuple(f"{i}" for i in range(6)),
        (),
        "  #",
        ("def {name}():", "{axes}"),
        ("end",),
        _urscript_move,
        True,
    ),
    # PTP knows neither times nor distances of a blend. The file must have the program's name.
    "krl": Language(
        "KRL",
        tuple(f"A{i}" for i in range(1, 7)),
        tuple(f"E{i}" for i in range(1, 7)),
        ";",
        ("DEF {name}()", "{axes}", "; speeds are those of the controller: PTP takes no times", "BAS(#INITMOV,0)"),
        ("END",),
        _krl_move,
        lost=_krl_lost,
    ),
    # A robot's axis that the arm has not is at 0, an external one unconnected. The way to the first row has no time:
    # there, and nowhere else, 100 mm/s hold.
    "rapid": Language(
        "RAPID",
        RAPID_AXES,
        RAPID_EXTERNAL,
        "  !",
        ("MODULE {name}_module", "{axes}", "  PROC {name}()"),
        ("  ENDPROC", "ENDMODULE"),
        _rapid_move,
    ),
    # TP as ASCII: J moves with times in ms, positions after them, a remark has at most 32 letters.
    "ls": Language(
        "TP",
        LS_AXES,
        tuple(f"E{i}" for i in range(1, 4)),
        ":  !",
        ("/PROG  {NAME}", "/ATTR", "DEFAULT_GROUP = 1,*,*,*,*;", "/MN", "{axes}"),
        ("/POS", "/END"),
        _ls_move,
        lost=_ls_lost,
        place=_ls_place,
        finish=_ls_finish,
    ),
    # A program of an application, its point and motion descriptor local to it.
    "val3": Language(
        "VAL3",
        tuple(f"j{i}" for i in range(1, 7)),
        (),
        "  //",
        (
            '<?xml version="1.0" encoding="utf-8"?>',
            '<Programs xmlns="http://www.staubli.com/robotics/VAL3/Program/2"'
            ' xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">',
            '<Program name="{name}" access="public">',
            "<Locals>",
            '<Local name="jPoint" type="jointRx" xsi:type="array" size="1" />',
            '<Local name="mDesc" type="mdesc" xsi:type="array" size="1" />',
            "</Locals>",
            "<Code><![CDATA[begin",
            "{axes}",
        ),
        ("  waitEndMove()", "end]]></Code>", "</Program>", "</Programs>"),
        _val3_move,
        lost=_val3_lost,
    ),
}


def is_name(text: str) -> bool:
    """Return whether every language takes a text as the name of a program."""
    return bool(NAME.fullmatch(text)) and text.lower() not in WORDS.split()


def program(
    language: Language, arm: Arm, traj: Path, name: str = "armflex_path", axes: str = "", **asked: Any
) -> Exported:
    """Return a path as a program of joint moves.

    Args:
        language: Of the controller.
        arm: The arm.
        traj: A trajectory.csv; a column `blend` [m], or blend_mm and the like, says how far from a row the tool may
            begin to turn towards the next.
        name: Of the program.
        axes: Which joint is which axis, as in 'A1=J2,A2=J1,E1=rail', every joint once; turning ones in order on the
            arm's axes and sliding ones on external ones where it is empty.
        asked: As of `path_of`.

    Raises:
        TableError, JointLimitError: The path cannot be read, or leaves the joints' limits.
        UnreachableError: It cannot be compensated.
        UnsupportedError: The arm has not what the controller has; said by name, with how many.
        InputError: The name is none of the language, or `axes` are not all joints' and all the language's.
    """
    path, notes, flags, head = path_of(arm, traj, **asked)
    if not is_name(name):
        expected = "expected a letter, then up to 23 letters, digits and _, no word of a language"
        raise InputError(f"--name {name!r}: {expected}")
    slides = [joint.kind == "prismatic" for joint in arm.robot.moving]
    units = [("mm", 1e3) if slide else ("rad", 1.0) if language.radians else ("deg", 180.0 / np.pi) for slide in slides]
    placed = _axes(arm, language, axes)
    called = "joint {} of movej" if language.called == "URScript" else "{}"
    comments = [f"{language.comment} {line}" for line in head]
    comments += [f"{language.comment} {called.format(axis)} [{units[i][0]}]: {line_comment(arm.joint_names[i])}"
                for axis, i in placed.items()]  # fmt: skip
    lines, places = list[str](), list[str]()
    for line in language.opening:
        lines += comments if line == "{axes}" else [line.format(name=name, NAME=name.upper())]
    blends = _blends(path)
    for i, (q, blend) in enumerate(zip(path.q, blends, strict=True)):
        at = dict.fromkeys((*language.robot, *language.external), "")
        at |= {axis: _decimal(q[j] * units[j][1], 12 if language.radians else 9) for axis, j in placed.items()}
        time = float(path.time[i] - path.time[i - 1]) if i else None
        lines.append(language.move(i, at, time, blend) + _via(path, i, language.comment.split()[-1]))
        places += [language.place(i, at)] if language.place else []
    lost = language.lost(name, len(path) - 1, sum(map(bool, blends)))
    ended = language.finish([*lines, language.closing[0], *places, *language.closing[1:], ""])
    return Exported("\n".join(ended), (*notes, *lost), flags=flags)


urscript, krl, rapid, ls, val3 = (partial(program, language) for language in LANGUAGES.values())


def jointtrajectory(arm: Arm, traj: Path, **asked: Any) -> Exported:
    """Return a path as YAML of a ROS 2 trajectory_msgs/JointTrajectory: rad and m, times from the first row on.

    Velocities and accelerations are there where the path has them; the message has no place for blends, which is said.
    Arguments and errors are those of `path_of`.
    """
    path, notes, flags, head = path_of(arm, traj, **asked)
    names = ", ".join(yaml_string(joint) for joint in arm.joint_names)
    lines = [f"# {line}" for line in head]
    lines += ["header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}", f"joint_names: [{names}]", "points:"]
    motion = (("positions", path.q), ("velocities", path.v), ("accelerations", path.a))
    for i, time in enumerate(path.time):
        for mark, (what, values) in zip("-  ", motion, strict=True):
            row = "[]" if values is None else f"[{', '.join(_decimal(value, 12) for value in values[i])}]"
            lines.append(f"{mark} {what}: {row}")
        seconds, left = divmod(round(float(time - path.time[0]) * 1e9), 10**9)
        lines.append(f"  time_from_start: {{sec: {seconds}, nanosec: {left}}}{_via(path, i, '#')}")
    if any(_blends(path)):
        notes += ("A JointTrajectory has no place for blends: the path's are left out.",)
    return Exported("\n".join([*lines, ""]), notes, flags=flags)


def path_of(
    arm: Arm,
    traj: Path,
    compensate: bool = False,
    covariates: Mapping[str, float] | None = None,
    unnamed: Unnamed = UNLOADED,
    table_path: Path | None = None,
    arm_file: str = "",
) -> tuple[Trajectory, tuple[str, ...], tuple[Flag, ...], tuple[str, ...]]:
    """Return the path to be written, in the arm's order of joints, what is to be said of it, flags, and its head.

    Args:
        arm: The arm.
        traj: A trajectory.csv.
        compensate: Whether the path is to be one on which the loaded tip is where the rigid one would have been.
        covariates: What the arm's effects depend on and no column gives.
        unnamed: What loads rows that name no payload, or no force.
        table_path: Loads by the length of path; see `read_force_table`.
        arm_file: What the head says that the arm was read from.

    Raises:
        InputError: Covariates or loads are given, and nothing is compensated.
        TableError, JointLimitError, UnreachableError: As `program`.
    """
    path = read_trajectory(traj, arm, unnamed)
    for q, place in zip(path.q, path.places, strict=True):
        with naming(place):
            arm.check_position(q)
    if not compensate:
        if covariates or unnamed != UNLOADED or table_path is not None:
            given = "--covariates" if covariates else "--payload, --force and --force-table"
            raise InputError(f"{given} need --compensate: without it nothing depends on them")
        notes = "The path is written as it is; --compensate has the loaded tip where the rigid one would be."
        if path.is_moved:
            notes = (
                "The path is written as it is. Its joints differ from its target_ columns: it is compensated already."
            )
        what = "Compensated before: the joints differ from the target_ columns" if path.is_moved else "Not compensated"
        return path, (notes,), (), _head(path, what, arm_file)
    path, flags = (path, ()) if table_path is None else path.under(read_force_table(table_path, arm), arm)
    compensation = compensated(arm, path, covariates=covariates)
    before = float(max(np.linalg.norm(row.before[:3]) for row in compensation.rows))
    after, sigma = compensation.remains_m
    relative = compensation.relative_sigma_m
    plus_minus = "" if relative is None else f" ± {relative * 1e3:.2g}"
    left = f"of {number(before * 1e3, 3)} mm at most {number(after * 1e3, 2)}{plus_minus} mm"
    if sigma is not None and sigma != relative:
        left += f" (± {sigma * 1e3:.2g} mm in the base frame, with where the base stands)"
    text = f"Compensated: {left} remain in the rows"
    between = compensation.between_m or 0.0
    notes = (f"{text}, {between * 1e3:.2g} mm halfway between.",)
    head = _head(path, f"Compensated{_conditions(arm, path, covariates or {})}", arm_file)
    return compensation.trajectory, notes, (*flags, *compensation.flags), head


def _conditions(arm: Arm, path: Trajectory, covariates: Mapping[str, float]) -> str:
    """Return for what columns that effects depend on a path was compensated, such as a temperature: ' for ..'."""
    given = {name: (value, value) for name, value in covariates.items()}
    given |= {name: (float(np.min(values)), float(np.max(values))) for name, values in path.covariates.items()}
    needed = [(name, *ends) for name, ends in given.items() if name in depended_on(arm)]
    texts = [f"{name} {low:g}" + (f" to {high:g}" if high > low else "") for name, low, high in needed]
    return f" for {listing(texts)}" if texts else ""


def _head(path: Trajectory, what: str, arm_file: str) -> tuple[str, ...]:
    """Return the lines that a program begins with: what wrote it, from what, and for which loads."""
    loads = [wrench.sizes for wrench in path.wrenches if not wrench.hangs]
    force, moment = np.max(loads, axis=0, initial=0.0) if loads else (0.0, 0.0)
    pushed = f"loads from outside up to {force:.4g} N and {moment:.4g} Nm" if loads else "no load from outside"
    written = f"Written by armflex {__version__}" + (f" from {arm_file}" if arm_file else "")
    return line_comment(written), line_comment(f"{what}; payload {listing(dict.fromkeys(path.payload))}, {pushed}")


def _axes(arm: Arm, language: Language, text: str) -> dict[str, int]:
    """Return the place in q of every axis that has a joint, the arm's first."""
    slides, every = [joint.kind == "prismatic" for joint in arm.robot.moving], (*language.robot, *language.external)
    if not language.external:
        require_six_turning(arm, f"{language.called}'s movej")
    places: dict[str, int] = {}
    if text:
        for part in text.split(","):
            axis, equals, joint = (piece.strip() for piece in part.partition("="))
            if not equals:
                raise InputError(f"--axes: {part.strip()!r} is not of the form AXIS=JOINT")
            for name, names, what in ((axis, every, f"axis of {language.called}"), (joint, arm.joint_names, "joint")):
                if name not in names:
                    raise UnknownNameError(what, name, names)
            place = arm.joint_names.index(joint)
            if axis in places or place in places.values():
                raise InputError(f"--axes: {axis if axis in places else joint!r} is given twice")
            if axis in language.robot and slides[place]:
                raise InputError(f"--axes: {joint!r} slides, axes {every[0]} to {language.robot[-1]} turn")
            places[axis] = place
        left = [name for i, name in enumerate(arm.joint_names) if i not in places.values()]
        if left:
            raise InputError(f"--axes: no axis for {listing(left)}; every joint needs one")
    else:
        for axes, kind, sliding in ((language.robot, "turning", False), (language.external, "sliding", True)):
            joints = [i for i, slide in enumerate(slides) if slide == sliding]
            if len(joints) > len(axes):
                beyond = listing(arm.joint_names[i] for i in joints[len(axes) :])
                has = f"{language.called} has {len(axes)} axes {axes[0]} to {axes[-1]} for {kind} joints"
                more = "; --axes puts turning ones on external axes" if language.external and not sliding else ""
                raise UnsupportedError(f"{has}, this arm has {len(joints)}: no place for {beyond}{more}")
            places |= dict(zip(axes, joints, strict=False))
    return {axis: places[axis] for axis in every if axis in places}


def _blends(path: Trajectory) -> list[float]:
    """Return the blend of each row [m], 0 where it has none, as at the end; raise of several columns, or below 0."""
    factors = {"blend": 1.0} | {f"blend_{unit}": factor for unit, factor in UNITS["length"].items()}
    given = [name for name in path.covariates if name in factors]
    if len(given) > 1:
        raise InputError(f"{listing(given)} are the same column in several units; expected one")
    if not given:
        return [0.0] * len(path)
    blends: Array = factors[given[0]] * np.asarray(path.covariates[given[0]])
    if (blends < 0.0).any():
        raise InputError(f"{given[0]} is negative at {path.time[int(np.argmin(blends))]:g} s")
    return [*blends[:-1].tolist(), 0.0]


def _decimal(value: float, digits: int) -> str:
    """Return a number without exponent and without a negative zero."""
    return f"{round(float(value), digits) + 0.0:.{digits}f}"


def _via(path: Trajectory, i: int, mark: str) -> str:
    return f"  {mark} {line_comment(path.via[i])}" if path.via[i] else ""
