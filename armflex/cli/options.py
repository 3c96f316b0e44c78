"""What several commands are asked: the arm they load, quantities with units, files that they write."""

from __future__ import annotations

import functools
import json
import os
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from armflex.arm import Arm, no_such_drive, warn
from armflex.cli.terminal import print_table, result_on_stdout, say, show_flags, showing_stages
from armflex.conventions import NUMBER, WRENCH_NAMES, Array, parse_quantity
from armflex.declaration import DEEP, MAX_BYTES
from armflex.errors import Flag, InputError, UnknownNameError, did_you_mean, listing
from armflex.files.arm_file import ROBOTS, load_arm
from armflex.laws.effects.in_arm import about_time, settled_covariates
from armflex.measured.campaign_clock import as_in
from armflex.measured.forces import FORCE_AXES, FORCE_KINDS, UNLOADED, Unnamed, read_force_table
from armflex.measured.joined import joined
from armflex.measured.measurements import Measurements, read_measurements
from armflex.measured.points import PointExport, read_points
from armflex.result import plain
from armflex.robot.robot import lock_side_joints
from armflex.rows.rows import TIME
from armflex.rows.wrench import Wrench
from armflex.storage.read_file import read_file
from armflex.storage.whole_file import STDOUT, is_replaced, is_stdout, write_whole
from armflex.trajectory import Trajectory, read_trajectory
from armflex.version import __version__

if TYPE_CHECKING:
    from armflex.intake import Intake

RADIANS = np.pi * np.pi / 180.0
"""What is pi, as written, in degrees [rad]."""


InputPath = click.Path(path_type=Path)

UNNAMED = "for rows that name none"
FORCE_HELP = "at the tip in base axes, elsewhere with frame=LINK,axes=link"


class Choice(click.Choice):
    """One of some names; for another the error names the nearest."""

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Any:
        """Return the name; fail where it is not one of them."""
        if value not in self.choices:
            choices = ", ".join(self.choices)
            self.fail(
                f"{value!r} is not known{did_you_mean(value, self.choices)} (known: {choices})", parameter, context
            )
        return super().convert(value, parameter, context)


class Quantity(click.ParamType):
    """A number with a unit of some kind, such as 'length'; the command gets it in SI."""

    def __init__(self, kind: str) -> None:
        self.name = kind

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> float:
        """Return the number; raise `UnitError` where the unit is missing or of another kind."""
        return parse_quantity(value, self.name) if isinstance(value, str) else value


class OutputPath(click.Path):
    """A file to be written, `-` for stdout; its folder is looked at before anything is computed or written."""

    def __init__(self) -> None:
        super().__init__(dir_okay=False, readable=False, path_type=Path)  # nobody reads it

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Path:
        """Return the path; fail where no file can be written there."""
        path = STDOUT if value == "-" else Path(os.fsdecode(super().convert(value, parameter, context)))
        try:
            replaced = is_replaced(path)
            folder = Path(os.path.realpath(path)).parent if path.is_symlink() else path.parent
        except OSError as error:
            self.fail(f"{path} cannot be written: {error.strerror}", parameter, context)
        if replaced and not folder.is_dir():
            self.fail(f"folder {folder} of {path.name!r} does not exist", parameter, context)
        if replaced and not os.access(folder, os.W_OK):
            self.fail(f"folder {folder} cannot be written", parameter, context)
        if replaced and path.exists() and not os.access(path, os.W_OK):
            self.fail(f"{path} is write-protected", parameter, context)
        return path


TABLES = (".csv", ".parquet", ".pq", ".xlsx", ".xlsm")
"""Suffixes that no arm has."""

FILES = {
    "ARM": "An arm.toml: URDF, flexures, payloads; or a URDF alone, which is rigid.",
    "TRAJ.csv": "A path: time, q_<joint>; optional payload, via (a name where it counts), tolerance, "
    "v_<joint>, a_<joint>, "
    "force_fx .. force_mz with force_frame and force_axes, and what effects depend on.",
    "ROWS.csv": "What is to be predicted: q_<joint>; optional payload, session, time, approach_<joint>, force_*.",
    "MEAS.csv": "What was measured: q_<joint>, x y z, sigma; optional pose, session, payload, time, force_*, and "
    "whatever else was recorded.",
    "JOINT.csv": "A joint on a bench: loads fx fy fz [mx my mz] and deflections dx dy dz [rx ry rz].",
}
"""What the arguments of commands are. Units are SI, or a suffix of a column says another: q_A1_deg, x_mm."""


class Command(click.Command):
    """A command that writes its result to `--json`, see `write_json`; its help says what the files are.

    It writes over none of its inputs, nor one of its outputs over another, which is checked before it begins.
    """

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        text = "Write the result for programs to FILE; - for stdout, and all else goes to stderr."
        self.params.append(click.Option(["--json", "json_path"], type=OutputPath(), help=text))

    def format_epilog(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write what the files are that the command reads."""
        files = [(meant, FILES[meant]) for parameter in self.params if (meant := _file(parameter)) in FILES]
        if files:
            with formatter.section("Files, in SI unless a column says its unit: q_A1_deg, x_mm, force_fz_kN"):
                formatter.write_dl(files)

    def invoke(self, context: click.Context) -> Any:
        """Run the command, unless an output is an input, a file that an input names, or another output; links count."""
        paths = {
            parameter: context.params.get(parameter.name)
            for parameter in self.params
            if isinstance(parameter.type, click.Path)
        }
        given = {parameter: path for parameter, path in paths.items() if isinstance(path, Path)}
        outputs = [(option.opts[0], path) for option, path in given.items() if isinstance(option.type, OutputPath)]
        inputs = [path for parameter, path in given.items() if not isinstance(parameter.type, OutputPath)]
        inputs += [path for parameter, several in paths.items() if parameter.nargs == -1 for path in several or ()]
        read = [file for path in inputs for file in named_files(path)]
        for option, path in outputs:
            if any(same_file(path, file) for file in read):
                raise InputError(f"{path} is an input of this command; name another file with {option}")
        for (name, first), (other, second) in combinations(outputs, 2):
            if same_file(first, second):
                raise InputError(f"{name} and {other} are the same file {second}; name another one")
        if said := [option for option, path in outputs if is_stdout(path)]:
            if len(said) > 1:
                raise InputError(f"{' and '.join(said)} both go to stdout: name a file with one of them")
            result_on_stdout()
        context.meta[__name__] = context.params.pop("json_path")
        self._check_kinds(paths)
        with showing_stages(f"reading {listing((path.name for path in inputs), 3)}"):
            return super().invoke(context)

    def _check_kinds(self, paths: Mapping[click.Parameter, Any]) -> None:
        """Raise `InputError` where a table is given as the arm, or an arm as a table, as when they are exchanged."""
        wrong = list[tuple[str, Path]]()
        for parameter, several in paths.items():
            name, suffixes = _file(parameter), TABLES if _file(parameter) == "ARM" else (".toml", *ROBOTS)
            each = several if isinstance(several, tuple) else (several,)
            wrong += [(name, path) for path in each if name in FILES and path and path.suffix.lower() in suffixes]
        if not wrong:
            return
        said = ", ".join(f"{path} is no {'arm' if name == 'ARM' else 'table'} ({name})" for name, path in wrong)
        order = " ".join(str(parameter.metavar) for parameter in self.params if isinstance(parameter, click.Argument))
        hint = "are they exchanged" if len(wrong) > 1 else "is another file meant"
        raise InputError(f"{said}: {hint}? armflex {click.get_current_context().info_name} {order}")


def _file(parameter: click.Parameter) -> str:
    """Return which of `FILES` a parameter is, one of them or several."""
    return (parameter.metavar or "").removesuffix(" ...")


def json_path() -> Path | None:
    """Return what `--json` of the running command says."""
    return click.get_current_context().meta[__name__]


def write_json(content: dict[str, Any], path: Path | None = None) -> None:
    """Write a result to a path or `--json`, whole or not at all; nothing where neither is given.

    What names its format, which is its schema, names the version of armflex. It is strict JSON: arrays are lists,
    dataclasses their fields, and what is not finite null; see `plain`.
    """
    if path := path or json_path():
        named = {**content, "armflex": __version__} if "format" in content else content
        write_whole(path, (json.dumps(plain(named), indent=1, allow_nan=False) + "\n").encode())


def conclude(content: Callable[[], dict[str, Any]], flags: Sequence[Flag], arm: Arm | None = None) -> None:
    """Show the flags about a result, and write it for programs with them, its format's name and the arm's frames.

    `content` is asked for where there is a `--json` alone: much of it may have to be computed.
    """
    show_flags(flags)
    if json_path():
        named = {"format": f"armflex-{click.get_current_context().info_name}-1", **content()}
        named |= {"flags": [str(flag) for flag in flags]}
        write_json(named if arm is None else named | {"base": arm.robot.base, "tip": arm.robot.tip})


def named_files(path: Path) -> list[Path]:
    """Return an input, and the files beside it that a TOML file names under whatever key: a URDF, laws."""
    if path.suffix != ".toml":
        return [path]
    try:
        text = read_file(path, MAX_BYTES).decode("utf-8-sig")
        values: list[Any] = [] if DEEP.search(text) else [tomllib.loads(text)]
    except (OSError, ValueError, RecursionError):
        return [path]  # who reads it will say what is wrong with it
    files = [path]
    while values:
        value = values.pop()
        if isinstance(value, dict | list):
            values += value.values() if isinstance(value, dict) else value
        elif isinstance(value, str):
            try:
                files += [path.parent / value] if (path.parent / value).is_file() else []
            except (OSError, ValueError):  # a text that cannot be a path
                continue
    return files


def same_file(output: Path, other: Path) -> bool:
    """Return whether writing a file would change another one; a device or a pipe is no file that could be lost."""
    if output.exists() and other.exists():
        return output.is_file() and output.samefile(other)
    return os.path.realpath(output) == os.path.realpath(other)  # also of links that end nowhere, or in a circle


lax = click.option("--lax", is_flag=True,
                   help="Warn of unknown URDF tags on the chain, and of impossible inertias in motion, instead of "
                        "refusing them.")  # fmt: skip


def arm(function: Callable) -> Callable:
    """Add the ARM argument, `--preset`, `--tip` and `--lax`; the command is called with the loaded arm first."""

    @lax
    @click.option("--tip", metavar="LINK", help="Link whose motion is reported, where ARM is a bare URDF.")
    @click.option("--preset", metavar="NAME", help="Use the flexures of [preset.NAME] in ARM.")
    @click.argument("arm_path", metavar="ARM", type=InputPath)
    @functools.wraps(function)
    def with_arm(arm_path: Path, preset: str | None, tip: str | None, lax: bool, **rest: Any) -> Any:
        return function(load_arm(arm_path, preset=preset, tip=tip, strict=not lax), **rest)

    return with_arm


def as_in_campaign(function: Callable) -> Callable:
    """Add `--as-in`; the command, whose arm comes first, is called with the arm on that campaign's clock."""

    @click.option("--as-in", "campaign_path", type=InputPath, metavar="CAMPAIGN.csv",
                  help="Times are those of this campaign, which ARM was fitted to; else the arm is meant as it was "
                       "left.")  # fmt: skip
    @functools.wraps(function)
    def on_clock(arm: Arm, campaign_path: Path | None, **rest: Any) -> Any:
        return function(arm if campaign_path is None else as_in(arm, campaign_path), **rest)

    return on_clock


keep = click.option("--keep", is_flag=True,
                    help="ARM is calibrated or traced already: keep it, and fit only where the instrument stands. "
                         "The uncertainty of the fitted parameters is kept and enters that of the new frames. Not "
                         "for an arm with an effect on the model itself: link_mass, payload_mass, payload_com, "
                         "gravity_tilt, tracker_scale, session_frame.")  # fmt: skip


anyway = click.option("--anyway", is_flag=True,
                      help="Take the campaign as it is written, even if it is plausible only in another "
                           "convention.")  # fmt: skip


sigma_r = click.option("--sigma-r", type=Quantity("angle"), metavar="0.5mrad",
                       help="Standard deviation of a recorded orientation, in files as they are; without it "
                            "orientations are not used.")  # fmt: skip
target = click.option("--target", "targets", multiple=True, metavar="NAME",
                      help="Topic, frame, body or marker of a recording that is the target; repeat it for several "
                           "targets.")  # fmt: skip
joints = click.option("--joints", multiple=True, metavar="TOPIC",
                      help="Topic of a recording that has the joints, where several have the same ones; repeat it for "
                           "several.")  # fmt: skip
take = click.option("--take", multiple=True, metavar="COLUMN=MEANING",
                    help="Meaning of a column whose name does not state it: q_J1_deg, x_mm, qw, pose, time, payload, "
                         "session; unused leaves it out.")  # fmt: skip
sigma = click.option("--sigma", type=Quantity("length"), metavar="0.05mm",
                     help="Standard deviation of a measured coordinate, for a log and a tracker's export as they "
                          "are.")  # fmt: skip


def as_they_are(function: Callable) -> Callable:
    """Add what is asked of files that are read as they are, see `taken_in`."""
    return sigma(take(joints(target(sigma_r(function)))))


def taken_in(
    paths: Sequence[Path], sigma: float | None, take: Sequence[str], targets: Sequence[str], **more: Any
) -> Intake:
    """Return files as they are as one campaign; print what each column was taken as, and how rows were joined."""
    from armflex.intake import intake  # imports scipy

    pairs = [assignment.rpartition("=") for assignment in take]
    wrong = next((text for text, pair in zip(take, pairs, strict=True) if not pair[0] or not pair[2]), None)
    if wrong:
        raise InputError(f"--take {wrong}: expected COLUMN=MEANING")
    asked = {column: meaning for column, _, meaning in pairs}

    def ask(question: str, choices: Sequence[str]) -> str:
        return click.prompt(question, type=click.Choice(list(choices)), err=True)

    taken = intake(paths, sigma, asked, ask if sys.stdin.isatty() else None, targets, **more)
    print_table("Columns", ["file", "column", "is", "unit", "because of"], taken.taken)
    say(f"{len(taken.lines)} rows, joined {taken.joined}.")
    for note in taken.notes:
        say(f"Note: {note}.")
    if taken.without_point:
        rows = [f"{name} (line {line})" for name, line in taken.without_point]
        say(f"Rows without a point: {listing(rows, len(rows))}.")
    return taken


def measurements(function: Callable[..., Any], several: bool = True) -> Callable[..., Any]:
    """Give a command campaigns, or files as they are that make one, and how these are read; it has `points`, too.

    `measured` returns them for an arm, as one; see `joined`. The arm, where another option loads it, comes first.
    """

    @functools.wraps(function)
    def with_rows(
        *arms: Arm,
        payload: str,
        force_text: str | None,
        points: PointExport | None,
        paths: tuple[Path, ...],
        sigma: float | None,
        sigma_r: float | None,
        take: tuple[str, ...],
        targets: tuple[str, ...],
        joints: tuple[str, ...],
        **rest: Any,
    ) -> Any:
        if points is not None and len(paths) > 1:
            raise InputError(f"--points has the positions of one campaign, and {len(paths)} are given")
        as_they_are = sigma is not None or any(path.is_dir() for path in paths)  # pictures have no coordinates
        if not as_they_are and len(paths) > 1 and not several:
            raise InputError(f"{len(paths)} files: expected one campaign; a log and an export as they are need --sigma")
        if not as_they_are and (take or targets or joints or sigma_r is not None):
            raise InputError("--take, --target, --joints and --sigma-r are for files as they are, which need --sigma")

        def measured(arm: Arm) -> Measurements:
            unnamed = unnamed_loads(arm, payload, force_text)
            if as_they_are:
                taken = taken_in(paths, sigma, take, targets, joints=joints, sigma_r=sigma_r)
                heads = [line for line in taken.declare.splitlines() if line[0] == "["]
                if missing := [line for line in heads if line[12:-1] not in arm.sensors]:
                    text = taken.declare.replace("TIP", arm.robot.tip)
                    raise InputError(f"{missing[0]} is not in the arm file, for the further target:\n{text}")
                return read_measurements(taken.table, arm, unnamed=unnamed)
            return joined([read_measurements(path, arm, points=points, unnamed=unnamed) for path in paths], arm)

        return function(*arms, measured=measured, **rest)

    paths_given = click.argument("paths", metavar="MEAS.csv ...", type=InputPath, nargs=-1, required=True)
    return paths_given(as_they_are(force_option(payload_option(with_rows))))


def campaign(function: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command an arm and its campaigns, and how both are taken: `keep`, `anyway`, `lax`; see `measurements`."""
    decorated = measurements(function)
    for given in (points, lax, anyway, keep, click.argument("arm_path", metavar="ARM", type=InputPath)):
        decorated = given(decorated)
    return decorated


def declared_arm(path: Path, command: str, keep: bool | None = None, lax: bool = False) -> Arm:
    """Return the arm of an arm.toml that a command fits; a bare URDF says nothing of what may move.

    `keep` is None of a command that has no such option.
    """
    if path.suffix != ".toml":
        raise InputError(f"{path}: {command} needs an arm.toml, whose [prior] names what is fitted")
    arm = load_arm(path, strict=not lax)
    if arm.certainty is not None and not keep:
        other = "" if keep is None else ", or with --keep from this one"
        raise InputError(f"{path} is calibrated already: {command} starts from the arm as declared{other}")
    if keep and arm.certainty is None:
        raise InputError(f"{path} is not calibrated: there is nothing to keep")
    return arm


covariates = click.option("--covariates", default="", metavar="temperature=25,approach_A2=1",
                          callback=lambda context, parameter, text: parse_covariates(text),
                          help="Values of covariates that no column gives, in SI and degrees Celsius.")  # fmt: skip


def named_values(texts: Iterable[str], form: str) -> dict[str, list[float]]:
    """Return numbers by name from texts such as 'temperature=10,35' or 'operator=bob=1'; raise of others."""
    numbers: dict[str, list[float]] = {}
    for text in texts:
        # A level of a text column is a name with '=' in it, and may itself have more; a number has none.
        name, equals, values = (piece.strip() for piece in text.rpartition("="))
        parts = [part.strip() for part in values.split(",")]
        if not equals or not name or not all(NUMBER.fullmatch(part) and np.isfinite(float(part)) for part in parts):
            raise InputError(f"--covariates: {text!r} is not of the form {form}")
        if name in numbers:
            raise InputError(f"--covariates: {name!r} is given twice")
        numbers[name] = [float(part) for part in parts]
    return numbers


def parse_covariates(text: str) -> dict[str, float]:
    """Return a number by name from 'temperature=25,approach_A2=1,operator=bob=1'; raise as `named_values`."""
    parts = filter(None, (part.strip() for part in text.split(",")))
    return {name: value for name, (value,) in named_values(parts, "NAME=NUMBER or COLUMN=LEVEL=NUMBER").items()}


settable = click.option("--covariates", "--covariate", "covariates", multiple=True, metavar="NAME=LOW,HIGH",
                        callback=lambda context, parameter, texts: named_values(texts, "NAME=NUMBER,NUMBER"),
                        help="Values that can be set of what effects depend on; once for each name.")  # fmt: skip


def points(function: Callable) -> Callable:
    """Add `--points`, `--points-unit` and `--points-frame`; the command gets a `PointExport` or None as `points`."""

    @click.option("--points", "points_path", type=InputPath, help="Positions exported apart from MEAS.csv.")
    @click.option("--points-unit", metavar="mm", help="Unit of these positions, where their file does not state it.")
    @click.option("--points-frame", metavar="NAME",
                  help="Frame of these positions, where their file does not state it.")  # fmt: skip
    @functools.wraps(function)
    def with_points(points_path: Path | None, points_unit: str | None, points_frame: str | None, **rest: Any) -> Any:
        if points_path is None and (points_unit or points_frame):
            raise InputError("--points-unit and --points-frame need --points")
        points = None if points_path is None else read_points(points_path, points_unit, points_frame)
        return function(points=points, **rest)

    return with_points


def parse_positions(text: str, arm: Arm) -> tuple[Array, Arm]:
    """Return q (nq,) from 'A1=0.3,A4=-10deg', and the arm with its joints off the chain where the text has them.

    For joints of the chain that are not named see `Arm.position`. What is wrong with a form, a name, a unit or, off the
    chain, a limit is raised.
    """
    positions: dict[str, float] = {}
    robot, beside = arm.robot, [arm.robot.urdf.joints[name] for name in arm.robot.locked if arm.robot.stem(name)]
    kinds = {joint.name: joint.kind for joint in (*robot.moving, *beside)}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise InputError(f"--q: {part!r} is not of the form JOINT=POSITION")
        if name in positions:
            raise InputError(f"--q: joint {name!r} is given twice")
        if name not in kinds:
            raise no_such_drive(robot, name, kinds)
        kind, unit = ("length", "m") if kinds[name] == "prismatic" else ("angle", "rad")
        positions[name] = parse_quantity(value if value[-1:].isalpha() else value + unit, kind)
        parts = positions[name] / RADIANS * 12.0  # of pi, as written
        # How near to a twelfth of pi a number is one that was rounded to two digits behind the point, in such parts
        if value.endswith("deg") and parts and abs(parts - round(parts)) < 5e-3 and 0 < abs(round(parts)) <= 24:
            text = f"--q: {name} at {value} is {round(parts)}/12 of pi as a number: radians? Then leave deg out"
            warn([Flag("radians", text)])
    held = {name: positions.pop(name) for name in (joint.name for joint in beside) if name in positions}
    if held:
        # What is locked anew must be within its limits, and what mimics it follows.
        lock_side_joints(robot.urdf, robot.base, robot.chain, held)
        if stray := robot.stray(held):
            raise InputError(f"--q: {stray[1]}")
        moved = {name: float(at) for name, at in robot.side_positions(held).items()}
        arm = replace(arm, robot=replace(robot, locked={**robot.locked, **moved}))
    return arm.position(**positions), arm


def configuration(function: Callable) -> Callable:
    """Add ARM, one configuration of it, its loads and covariates; the command gets arm, q (nq,), payload, and the rest.

    They are `wrenches` from `--force`, and `covariates`, settled.
    """

    @arm
    @as_in_campaign
    @click.option("--q", "positions", multiple=True, metavar="A1=0.3,A4=-10deg",
                  help="Joint positions; others are 0, or in the middle of limits that 0 is outside of.")  # fmt: skip
    @click.option("--payload", default="none", show_default=True, metavar="NAME", help="Payload of ARM.")
    @click.option("--force", "forces", multiple=True, metavar="LINK=FX,FY,FZ",
                  help=f"External load with unit, or as fx=0,fz=-500N: {FORCE_HELP}. Any number.")  # fmt: skip
    @covariates
    @functools.wraps(function)
    def configured(
        arm: Arm,
        positions: tuple[str, ...],
        payload: str,
        forces: tuple[str, ...],
        covariates: dict[str, float],
        **rest: Any,
    ) -> Any:
        show_flags(about_time(arm, (TIME, *covariates)))
        wrenches = [parse_force(text, arm) for text in forces]
        along = rest.get("trajectory_path") is not None and not positions  # a path brings its own positions
        q, arm = (arm.robot.home, arm) if along else parse_positions(",".join(positions), arm)
        return function(arm, q, payload, wrenches=wrenches, covariates=settled_covariates(arm, covariates), **rest)

    return configured


def loads(function: Callable) -> Callable:
    """Add `--payload` and `--force` for rows that name none: the command gets them as `unnamed`, arm first.

    A command that has `--force-table`, too, gets that or `--force`.
    """

    @functools.wraps(function)
    def with_loads(arm: Arm, payload: str, force_text: str | None, **rest: Any) -> Any:
        if force_text is not None and rest.get("table_path") is not None:
            raise InputError("--force and --force-table exclude each other")
        return function(arm, unnamed=unnamed_loads(arm, payload, force_text), **rest)

    return force_option(payload_option(with_loads))


def unnamed_loads(arm: Arm, payload: str, force_text: str | None) -> Unnamed:
    """Return what loads rows that name none; raise where the arm has no such payload or link."""
    arm.payload(payload)
    return Unnamed(payload, None if force_text is None else parse_force(force_text, arm))


force_option = click.option("--force", "force_text", metavar="fx=0,fz=-500N",
                            help=f"External load {UNNAMED}: {FORCE_HELP}.")  # fmt: skip
payload_option = click.option("--payload", default="none", show_default=True, metavar="NAME",
                              help=f"Payload of ARM {UNNAMED}.")  # fmt: skip


force_table = click.option("--force-table", "table_path", metavar="F.csv", type=InputPath,
                           help="External loads along the path: a column s, the length of path [m] from the first "
                                "row on, and the force_ columns of a trajectory; linear between its rows.")  # fmt: skip


def read_path(path: Path, arm: Arm, unnamed: Unnamed = UNLOADED, table_path: Path | None = None) -> Trajectory:
    """Return a trajectory under the loads that its rows, or the command's options, say; flags are shown."""
    trajectory = read_trajectory(path, arm, unnamed)
    if table_path is None:
        return trajectory
    trajectory, flags = trajectory.under(read_force_table(table_path, arm), arm)
    show_flags(flags)
    return trajectory


def parse_force(text: str, arm: Arm) -> Wrench:
    """Return a load from 'fx=0,fz=-500N,my=20Nm', or from 'tool=0,0,-500N', whose unit holds for all three.

    The first form may end with `frame=LINK`, the tip where it does not, and `axes=link`, those of the base else. What
    is of neither form is refused, as are other names and units.
    """
    form = f"--force: {text!r} is not of the form LINK=FX,FY,FZ with a unit, such as tool=0,0,-500N, or fx=0,fz=-500N"
    first, _, values = (part.strip() for part in text.partition("="))
    words, given = (*WRENCH_NAMES, "frame", "axes"), dict[str, str]()
    if first in words:
        for part in text.split(","):
            name, equals, value = (piece.strip() for piece in part.partition("="))
            if not equals or not value or name in given:
                raise InputError(f"{form}: {part.strip()!r}" + (" is given twice" if name in given else ""))
            if name not in words:
                raise InputError(f"--force: no component {name!r}{did_you_mean(name, words)} (known: {listing(words)})")
            given[name] = value
    else:
        parts = values.split(",")
        if len(parts) != 3:
            raise InputError(form)
        unit = parts[-1].strip().lstrip("+-.0123456789eE")
        given = {name: part.strip().removesuffix(unit) + unit for name, part in zip(WRENCH_NAMES, parts, strict=False)}
        given["frame"] = first
    frame, axes = given.pop("frame", arm.robot.tip), given.pop("axes", "base")
    if frame not in arm.link_names:
        raise UnknownNameError("link", frame, arm.link_names)
    if axes not in FORCE_AXES:
        raise InputError(f"--force: axes is {axes!r}, expected base or link{did_you_mean(axes, FORCE_AXES)}")
    numbers = []
    for name, kind in FORCE_KINDS.items():
        value = given.get(name.removeprefix("force_"), "0")
        unit = {"force": "N", "moment": "Nm"}[kind]
        numbers.append(parse_quantity(value if not NUMBER.fullmatch(value) or float(value) else f"0{unit}", kind))
    return Wrench(frame, np.array(numbers[:3]), np.array(numbers[3:]), FORCE_AXES[axes])
