"""A path as robot controllers take it: joint moves in the units and the order of axes of each language."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from armflex.arm import Arm
from armflex.conventions import UNITS, Array, printable
from armflex.errors import InputError, UnsupportedError, listing, naming
from armflex.export.exported import Exported
from armflex.export.rigid import require_six_turning
from armflex.tasks.compensate import compensate
from armflex.trajectory import Trajectory, read_trajectory

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,23}")
"""What all three languages take as a name; KRL has the shortest."""

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


def urscript(
    arm: Arm,
    traj: Path,
    compensate: bool = False,
    covariates: Mapping[str, float] | None = None,
    name: str = "armflex_path",
) -> Exported:
    """Return a path as URScript: movej with six joint positions in rad, times and blends where the path has them.

    Args:
        arm: The arm.
        traj: A trajectory.csv; a column `blend` [m], or blend_mm and the like, says how far from a row the tool may
            begin to turn towards the next.
        compensate: Whether the path is to be one on which the loaded tip is where the rigid one would have been.
        covariates: What the arm's effects depend on and no column gives.
        name: Of the program.

    Raises:
        TableError, JointLimitError: The path cannot be read, or leaves the joints' limits.
        UnreachableError: It cannot be compensated.
        UnsupportedError: The arm has not what the controller has; said by name, with how many.
        InputError: The name is none of the language.
    """
    path, told = _path(arm, traj, compensate, covariates)
    _check_name(name)
    require_six_turning(arm, "URScript's movej")
    lines = [f"def {name}():"]
    lines += [f"  # joint {i} of movej [rad]: {_comment(joint)}" for i, joint in enumerate(arm.joint_names)]
    for i, (q, time, blend) in enumerate(zip(path.q, _durations(path), _blends(path), strict=True)):
        values = ", ".join(_decimal(value, 12) for value in q)
        extra = ("" if time is None else f", t={_decimal(time, 6)}") + (f", r={_decimal(blend, 6)}" if blend else "")
        lines.append(f"  movej([{values}]{extra}){_via(path, i, '#')}")
    return Exported("\n".join([*lines, "end", ""]), told)


def krl(
    arm: Arm,
    traj: Path,
    compensate: bool = False,
    covariates: Mapping[str, float] | None = None,
    name: str = "armflex_path",
) -> Exported:
    """Return a path as KRL: PTP with turning joints as A1.. in deg, and sliding ones as external axes E1.. in mm.

    PTP knows neither times nor distances of a blend, so neither is written, which is said. The file must have the
    program's name. Arguments and errors are those of `urscript`.
    """
    path, told = _path(arm, traj, compensate, covariates)
    _check_name(name)
    axes = _axes(arm, "KRL", [f"A{i}" for i in range(1, 7)], [f"E{i}" for i in range(1, 7)])
    lines = [f"DEF {name}()"]
    lines += [f"; {axis} [{unit}]: {_comment(arm.joint_names[i])}" for axis, i, unit, _ in axes]
    lines += ["; speeds are those of the controller: PTP takes no times", "BAS(#INITMOV,0)"]
    for i, q in enumerate(path.q):
        values = ", ".join(f"{axis} {_decimal(q[place] * factor, 9)}" for axis, place, _, factor in axes)
        lines.append(f"PTP {{E6AXIS: {values}}}{_via(path, i, ';')}")
    told += (f"KRL wants the file to be named as the program is: {name}.src.",)
    lost = [f"{len(path) - 1} times between rows"] if len(path) > 1 else []
    lost += [f"{count} blends"] if (count := sum(map(bool, _blends(path)))) else []
    if lost:
        told += (
            f"KRL's PTP takes percents of its own maxima: {' and '.join(lost)} of the path are not in the program.",
        )
    return Exported("\n".join([*lines, "END", ""]), told)


def rapid(
    arm: Arm,
    traj: Path,
    compensate: bool = False,
    covariates: Mapping[str, float] | None = None,
    name: str = "armflex_path",
) -> Exported:
    """Return a path as RAPID: MoveAbsJ with turning joints in deg and sliding ones as external axes a to f in mm.

    A robot's axis that the arm has not is at 0, an external one unconnected. The way to the first row has no time:
    there, and nowhere else, 100 mm/s hold. Arguments and errors are those of `urscript`.
    """
    path, told = _path(arm, traj, compensate, covariates)
    _check_name(name)
    robot, external = [f"rax_{i}" for i in range(1, 7)], [f"eax_{letter}" for letter in "abcdef"]
    axes = _axes(arm, "RAPID", robot, external)
    lines = [f"MODULE {name}_module"]
    lines += [f"  ! {axis} [{unit}]: {_comment(arm.joint_names[i])}" for axis, i, unit, _ in axes]
    lines += [f"  PROC {name}()"]
    for i, (q, time, blend) in enumerate(zip(path.q, _durations(path), _blends(path), strict=True)):
        given = {axis: _decimal(q[place] * factor, 9) for axis, place, _, factor in axes}
        turning = ",".join(given.get(axis, "0") for axis in robot)
        sliding = ",".join(given.get(axis, UNCONNECTED) for axis in external)
        speed = "v100" if time is None else f"v100\\T:={_decimal(time, 6)}"
        radii = ",".join(_decimal(1e3 * blend * share, 6) for share in ZONE) if blend else ""
        zone = f"[FALSE,{radii}]" if blend else "fine"
        lines.append(f"    MoveAbsJ [[{turning}],[{sliding}]]\\NoEOffs,{speed},{zone},tool0;{_via(path, i, '!')}")
    return Exported("\n".join([*lines, "  ENDPROC", "ENDMODULE", ""]), told)


def jointtrajectory(
    arm: Arm, traj: Path, compensate: bool = False, covariates: Mapping[str, float] | None = None
) -> Exported:
    """Return a path as YAML of a ROS 2 trajectory_msgs/JointTrajectory: rad and m, times from the first row on.

    Velocities and accelerations are there where the path has them; the message has no place for blends, which is said.
    Arguments and errors are those of `urscript`.
    """
    path, told = _path(arm, traj, compensate, covariates)
    names = ", ".join(json.dumps(joint, ensure_ascii=False) for joint in arm.joint_names)
    lines = ["header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}", f"joint_names: [{names}]", "points:"]
    motion = (("positions", path.q), ("velocities", path.v), ("accelerations", path.a))
    for i, time in enumerate(path.time):
        for mark, (what, values) in zip("-  ", motion, strict=True):
            row = "[]" if values is None else f"[{', '.join(_decimal(value, 12) for value in values[i])}]"
            lines.append(f"{mark} {what}: {row}")
        seconds, left = divmod(round(float(time - path.time[0]) * 1e9), 10**9)
        lines.append(f"  time_from_start: {{sec: {seconds}, nanosec: {left}}}{_via(path, i, '#')}")
    if any(_blends(path)):
        told += ("A JointTrajectory has no place for blends: the path's are left out.",)
    return Exported("\n".join([*lines, ""]), told)


def _path(
    arm: Arm, file: Path, compensated: bool, covariates: Mapping[str, float] | None
) -> tuple[Trajectory, tuple[str, ...]]:
    """Return the path to be written, in the arm's order of joints, and what is to be said of it."""
    path = read_trajectory(file, arm)
    for q, place in zip(path.q, path.places, strict=True):
        with naming(place):
            arm.check_position(q)
    if not compensated:
        if covariates:
            raise InputError("--covariates go with --compensate: without it nothing depends on them")
        return path, ("The path is written as it is; --compensate has the loaded tip where the rigid one would be.",)
    found = compensate(arm, path, covariates=covariates)
    before, (after, sigma) = max(np.linalg.norm(row.before[:3]) for row in found.rows), found.remains_m
    known = "" if sigma is None else f" ± {sigma * 1e3:.2g}"
    text = f"Compensated: of {before * 1e3:.3g} mm at most {after * 1e3:.2g}{known} mm remain in the rows"
    between = found.between_m or 0.0
    return found.trajectory, (f"{text}, {between * 1e3:.2g} mm halfway between.", *map(str, found.flags))


def _check_name(name: str) -> None:
    if not NAME.fullmatch(name) or name.lower() in WORDS.split():
        raise InputError(
            f"--name {name!r}: expected a letter, then up to 23 letters, digits and _, no word of a language"
        )


def _axes(arm: Arm, language: str, turning: list[str], sliding: list[str]) -> list[tuple[str, int, str, float]]:
    """Return axis, place in q, unit and factor to it of every joint: turning ones in order, then sliding ones."""
    found = []
    for axes, kind, unit, factor in ((turning, "turning", "deg", 180.0 / np.pi), (sliding, "sliding", "mm", 1e3)):
        own = [i for i, joint in enumerate(arm.robot.moving) if (joint.kind == "prismatic") == (kind == "sliding")]
        if len(own) > len(axes):
            beyond = listing(arm.joint_names[i] for i in own[len(axes) :])
            has = f"{language} has {len(axes)} axes {axes[0]} to {axes[-1]} for {kind} joints, this arm has {len(own)}"
            raise UnsupportedError(f"{has}: no place for {beyond}")
        found += [(axis, i, unit, factor) for axis, i in zip(axes, own, strict=False)]
    return found


def _durations(path: Trajectory) -> list[float | None]:
    """Return the time that the way to each row takes [s], None for the first."""
    return [None, *np.diff(path.time).tolist()]


def _blends(path: Trajectory) -> list[float]:
    """Return the blend of each row [m], 0 where it has none; a path ends at rest, so its last row has none.

    Raises:
        InputError: There are several columns of blends, or one is negative.
    """
    known = {"blend": 1.0} | {f"blend_{unit}": factor for unit, factor in UNITS["length"].items()}
    given = [name for name in path.covariates if name in known]
    if len(given) > 1:
        raise InputError(f"{listing(given)} are the same column in several units; expected one")
    if not given:
        return [0.0] * len(path)
    blends: Array = known[given[0]] * np.asarray(path.covariates[given[0]])
    if (blends < 0.0).any():
        raise InputError(f"{given[0]} is negative at {path.time[int(np.argmin(blends))]:g} s")
    return [*blends[:-1].tolist(), 0.0]


def _decimal(value: float, digits: int) -> str:
    """Return a number without exponent and without a negative zero."""
    return f"{round(float(value), digits) + 0.0:.{digits}f}"


def _comment(text: str) -> str:
    """Return a text that ends no comment in any of the languages and has letters that all controllers read."""
    return printable(text).encode("ascii", "backslashreplace").decode()


def _via(path: Trajectory, i: int, mark: str) -> str:
    return f"  {mark} {_comment(path.via[i])}" if path.via[i] else ""
