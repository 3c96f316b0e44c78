"""What of the files describes the arm, a URDF or a table of DH parameters: its joints, and the arm file of both."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from armflex.errors import ManyErrors, Place, TableError, UnknownNameError, UrdfError, listing
from armflex.files.arm_file import ROBOTS
from armflex.intake.campaign import Intake
from armflex.intake.dh import UPRIGHT, DhTable, arm_text, is_dh, read_dh
from armflex.intake.meanings import SETS, Ask
from armflex.intake.record import Record
from armflex.intake.sources import SourceTable
from armflex.measured.points import LENGTHS
from armflex.robot.robot import Robot, load_robot


@dataclass(frozen=True, eq=False)
class ArmSource:
    """What describes the arm, if anything: a URDF's robot, or a table of DH parameters and what they are."""

    robot: Robot | None = None
    table: SourceTable | None = None
    dh: DhTable | None = None

    @property
    def joints(self) -> list[str]:
        """Names of the robot's joints, base to tip."""
        return [] if self.robot is None else [joint.name for joint in self.robot.moving]

    def slides_among(self, names: Sequence[str]) -> list[str] | None:
        """Return those of a log's joints, as it calls them, that are lengths; None where no file says it."""
        if self.robot is None:
            if self.dh is None:
                return None
            kinds = self.dh.slides
        else:
            slides = [joint.name for joint in self.robot.moving if joint.kind == "prismatic"]
            if {*self.joints} & {*names}:
                return slides
            kinds = [name in slides for name in self.joints]
        ordered = base_to_tip(names) or list(names)
        return [name for name, slid in zip(ordered, kinds, strict=True) if slid] if len(ordered) == len(kinds) else []

    def named(self, log: Record) -> tuple[Record, list[str]]:
        """Return a log with its joints as the robot's file calls them, and what is wrong.

        Joints that a controller only numbers are those of the file, base to tip.
        """
        if self.robot is None:
            return log, []
        joints, moving, file = [joint for joint, _ in log.of("joint")], self.joints, self.robot.urdf.path.name
        sliding = self.slides_among([joint.name for joint in joints]) or ()
        for joint in joints:
            slides = joint.name in sliding
            if joint.name in moving and joint.unit not in (None, "rad") and (joint.unit in LENGTHS) != slides:
                text = f"column {joint.column!r} is in {joint.unit}, and joint {joint.name!r} of {file}"
                return log, [f"{text} {'slides' if slides else 'turns'}"]
        named = [joint.name for joint in joints]
        if set(moving) <= set(named):
            why = "no joint between base and tip"
            beside = [joint for joint in joints if joint.name not in moving]
            return log.where(beside.__contains__, kind="unused", unit="", why=why), []
        counts = [(match := re.fullmatch(r"\D*?(\d)", name)) and int(match[1]) for name in named]
        if names := next((names for _, names in SETS if {*names} == {*named}), None):
            counts = [names.index(name) for name in named]
        if counts not in (list(range(1, len(moving) + 1)), list(range(len(moving)))):
            text = (
                f"the log has joints {listing(named)}, and {file} has {listing(moving)}: say which column each is, as"
            )
            return log, [f"{text} --take 'COLUMN=q_{next((name for name in moving if name not in named), moving[0])}'"]
        by = dict(zip(named, moving, strict=True))
        meant = (replace(joint, name=by[joint.name]) if joint.kind == "joint" else joint for joint in log.meant)
        return replace(log, meant=tuple(meant)), []

    def described(self, joined: Intake, beside: Path, tracked: bool) -> Intake:
        """Return a campaign, beside which its files are, with the arm file, where anything describes the arm.

        Raises:
            TableError: The table has more or fewer rows than the log has joints.
        """
        if self.robot is None:
            return joined if self.table is None or self.dh is None else _by_dh(joined, self.table, self.dh, tracked)
        urdf = Path(os.path.relpath(self.robot.urdf.path, beside)).as_posix()
        lines = ["[robot]", f'urdf = "{urdf}"', f'tip = "{self.robot.tip}"', UPRIGHT]
        lines += ["allow_massless = true"] if any(flag.code == "massless" for flag in self.robot.flags) else []
        return replace(joined, arm=arm_text(lines, self.robot.tip, joined.declare, tracked))


def arm_source(
    paths: Sequence[Path],
    sources: Sequence[SourceTable],
    dh: str | None,
    ask: Ask | None,
    tip: str | None,
    asked: Mapping[str, str],
) -> tuple[ArmSource, list[str]]:
    """Return what of the files describes the arm, and what is wrong with it; see `intake` for what is asked."""
    robots, wrong, arm = [path for path in paths if path.suffix.lower() in ROBOTS], list[str](), ArmSource()
    table = next((source for source in sources if is_dh(source, asked)), None)
    try:
        arm = ArmSource(table=table)
        arm = replace(arm, dh=None if table is None else read_dh(table, dh, ask, asked))
        arm = replace(arm, robot=load_robot(robots[0], tip, allow_massless=True) if robots else None)
    except (TableError, ManyErrors, UrdfError, UnknownNameError) as error:
        wrong += str(error).splitlines()
    if len(robots) + (table is not None) > 1:
        wrong.append("several files describe the arm: give one URDF, or one table of DH parameters")
    return arm, wrong


def _by_dh(joined: Intake, table: SourceTable, arm: DhTable, tracked: bool) -> Intake:
    """Return a campaign with the arm file of a table of DH parameters, whose rows are the log's joints."""
    joints, notes = [name.removeprefix("q_") for name in joined.columns if name.startswith("q_")], joined.notes
    if ordered := base_to_tip(joints):
        joints = ordered
    else:
        notes = (*notes, f"the rows of {table.title} are {listing(joints)}")
    if len(joints) != len(arm.rows):
        text = f"has {len(arm.rows)} rows, and the log {len(joints)} joints: {listing(joints)}"
        if len(joints) < len(arm.rows):
            text += "; say which column is another, as --take 'COLUMN=q_NAME_deg', or =q_NAME_mm of one that slides"
        raise TableError(Place(table.path), text)
    units = {what.removeprefix("joint "): (column, unit) for _, column, what, unit, _ in joined.taken}
    for row, (name, slides) in enumerate(zip(joints, arm.slides, strict=True)):
        column, unit = units.get(name, (name, "rad"))
        if unit != "rad" and (unit in LENGTHS) != slides:
            text = f"joint {name!r} {'slides' if slides else 'turns'}, and column {column!r} of the log is in {unit}"
            raise TableError(Place(table.path, table.lines[row]), text)
    taken = (*((table.title, *cells) for cells in arm.taken), *joined.taken)
    text = arm_text(arm.lines(joints), "flange", joined.declare, tracked)
    return replace(joined, taken=taken, notes=notes, arm=text)


def base_to_tip(joints: Sequence[str]) -> list[str] | None:
    """Return joints in their order where their names say it: a set of names that all know, or numbers."""
    if names := next((names for _, names in SETS if {*names} == {*joints}), None):  # ROS sorts them by name
        return list(names)
    if len({joint.rstrip("0123456789") for joint in joints}) == 1 and all(joint[-1:].isdigit() for joint in joints):
        return sorted(joints, key=lambda joint: int(re.findall(r"\d+", joint)[-1]))
    return None
