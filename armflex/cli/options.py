"""What several commands share: the arm they load, quantities with units, JSON files, progress."""

from __future__ import annotations

import functools
import json
import os
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.arm import Arm
from armflex.cli.tables import complain, stream
from armflex.conventions import NUMBER, Array, parse_quantity
from armflex.errors import Flag, InputError, UnknownNameError, did_you_mean
from armflex.files.arm_file import load_arm
from armflex.measured.point_export import read_points
from armflex.storage.whole_file import is_replaced, write_whole

PathArgument = click.Path(path_type=Path)


class Command(click.Command):
    """A command that writes over none of its inputs, nor one of its outputs over another; checked before it begins."""

    def invoke(self, context: click.Context) -> Any:
        """Run the command; raise what `keep_inputs` does."""
        keep_inputs(context)
        return super().invoke(context)


class Choice(click.Choice):
    """One of some names; another one is told the nearest."""

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Any:
        """Return the name; fail where it is not one of them."""
        if value not in self.choices:
            known = ", ".join(self.choices)
            self.fail(f"{value!r} is not known{did_you_mean(value, self.choices)} (known: {known})", parameter, context)
        return super().convert(value, parameter, context)


class OutputPath(click.Path):
    """A file to be written; its folder is looked at before anything is computed or written."""

    def __init__(self) -> None:
        super().__init__(dir_okay=False, readable=False, path_type=Path)  # nobody reads it

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Path:
        """Return the path; fail where no file can be written there."""
        path = super().convert(value, parameter, context)
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


def keep_inputs(context: click.Context) -> None:
    """Raise `InputError` where an output is an input, a file that an input names, or another output; links count."""
    paths = {one: context.params.get(one.name) for one in context.command.params if isinstance(one.type, click.Path)}
    given = {one: path for one, path in paths.items() if isinstance(path, Path)}
    outputs = [(one.opts[0], path) for one, path in given.items() if isinstance(one.type, OutputPath)]
    inputs = [file for one, path in given.items() if not isinstance(one.type, OutputPath) for file in named_files(path)]
    for option, path in outputs:
        if any(same_file(path, file) for file in inputs):
            raise InputError(f"{path} is an input of this command; name another file with {option}")
    for (one, first), (other, second) in combinations(outputs, 2):
        if same_file(first, second):
            raise InputError(f"{one} and {other} are the same file {second}; name another one")


def named_files(path: Path) -> list[Path]:
    """Return an input, and the files beside it that a TOML file names under whatever key: a URDF, laws."""
    if path.suffix != ".toml":
        return [path]
    try:
        texts = list(_texts(tomllib.loads(path.read_text(encoding="utf-8-sig"))))
    except (OSError, ValueError, RecursionError):
        return [path]  # who reads it will say what is wrong with it
    beside = [path.parent / text for text in texts]
    return [path, *(file for file in beside if _is_file(file))]


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a text that cannot be a path
        return False


def _texts(value: Any) -> Iterator[str]:
    """Yield every text in nested tables and lists."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _texts(item)


def same_file(output: Path, other: Path) -> bool:
    """Return whether writing a file would change another one; a device or a pipe is no file that could be lost."""
    if output.exists() and other.exists():
        return output.is_file() and output.samefile(other)
    return os.path.realpath(output) == os.path.realpath(other)  # also of links that end nowhere, or in a circle


def arm_argument(function: Callable) -> Callable:
    """Add the ARM argument, `--preset`, `--tip` and `--lax`; the command is called with the loaded arm first."""

    @functools.wraps(function)
    def with_arm(arm_path: Path, preset: str | None, tip: str | None, lax: bool, **rest: Any) -> Any:
        return function(load_arm(arm_path, preset=preset, tip=tip, strict=not lax), **rest)

    for decorate in (
        click.argument("arm_path", metavar="ARM", type=PathArgument),
        click.option("--preset", metavar="NAME", help="Use the flexures of [preset.NAME] in ARM."),
        click.option("--tip", metavar="LINK", help="Link whose motion is reported, where ARM is a bare URDF."),
        click.option(
            "--lax",
            is_flag=True,
            help="Flag unknown URDF tags on the chain, and motion with impossible inertias, do not refuse.",
        ),
    ):
        with_arm = decorate(with_arm)
    return with_arm


keep_option = click.option(
    "--keep",
    is_flag=True,
    help="ARM is calibrated or traced already: keep it, and fit only where the instrument stands. The uncertainty of "
    "what was fitted before stays as it was, and counts as independent of the new frames'. Not for an arm with an "
    "effect on the model itself: link_mass, payload_mass, payload_com, gravity_tilt, tracker_scale, session_frame.",
)


def declared_arm(path: Path, command: str, keep: bool = False) -> Arm:
    """Return the arm of an arm.toml that a command fits; a bare URDF says nothing of what may move."""
    if path.suffix != ".toml":
        raise InputError(f"{path}: {command} needs an arm.toml, whose [prior] says what may move")
    arm = load_arm(path)
    if arm.certainty is not None and not keep:
        text = f"{path} is calibrated already: {command} starts from the arm as declared, or with --keep from this one"
        raise InputError(text)
    if keep and arm.certainty is None:
        raise InputError(f"{path} is not calibrated: there is nothing to keep")
    return arm


def covariates_option(function: Callable) -> Callable:
    """Add `--covariates`; the command gets a dict of numbers by name."""
    return click.option(
        "--covariates",
        default="",
        metavar="temperature=25,approach_A2=1",
        callback=lambda context, parameter, text: parse_covariates(text),
        help="What the arm's effects depend on beside the rows' columns, SI and degrees Celsius; no other names.",
    )(function)


def parse_covariates(text: str) -> dict[str, float]:
    """Return numbers by name from 'temperature=25,approach_A2=1,operator=bob=1'.

    Raises:
        InputError: Not of that form, not a finite number, or a name given twice.
    """
    found: dict[str, float] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        # A level of a text column is a name with '=' in it, and may itself have more; a number has none.
        name, equals, value = (piece.strip() for piece in part.rpartition("="))
        if not equals or not name or not NUMBER.fullmatch(value) or not np.isfinite(float(value)):
            raise InputError(f"--covariates: {part!r} is not of the form NAME=NUMBER or COLUMN=LEVEL=NUMBER")
        if name in found:
            raise InputError(f"--covariates: {name!r} is given twice")
        found[name] = float(value)
    return found


def points_options(function: Callable) -> Callable:
    """Add `--points`, `--points-unit` and `--points-frame`; the command gets a `PointExport` or None as `points`."""

    @functools.wraps(function)
    def with_points(points_path: Path | None, points_unit: str | None, points_frame: str | None, **rest: Any) -> Any:
        if points_path is None and (points_unit or points_frame):
            raise InputError("--points-unit and --points-frame go with --points")
        points = None if points_path is None else read_points(points_path, points_unit, points_frame)
        return function(points=points, **rest)

    for decorate in (
        click.option("--points", "points_path", type=PathArgument, help="Positions exported apart from MEAS.csv."),
        click.option("--points-unit", metavar="mm", help="Their unit, where the file does not state it."),
        click.option("--points-frame", metavar="NAME", help="Their frame, where the file does not state it."),
    ):
        with_points = decorate(with_points)
    return with_points


def json_option(function: Callable) -> Callable:
    """Add `--json FILE`."""
    return click.option("--json", "json_path", type=OutputPath(), help="Write the result for programs to FILE.")(
        function
    )


def write_json(path: Path | None, content: dict[str, Any]) -> None:
    """Write a result as strict JSON, whole or not at all; nothing when no path is given."""
    if path is not None:
        write_whole(path, (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())


def parse_positions(text: str, arm: Arm) -> Array:
    """Return q (nq,) from 'A1=0.3,A4=-10deg'; for joints not named see `Arm.position`.

    Raises:
        InputError: Not of that form; UnknownNameError, UnitError for names and units.
    """
    positions: dict[str, float] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise InputError(f"--q: {part!r} is not of the form JOINT=POSITION")
        if name in positions:
            raise InputError(f"--q: joint {name!r} is given twice")
        positions[name] = _position(arm, name, value)
    return arm.position(**positions)


def _position(arm: Arm, name: str, value: str) -> float:
    if name not in arm.joint_names:
        raise UnknownNameError("joint", name, arm.joint_names)
    prismatic = arm.robot.moving[arm.joint_names.index(name)].kind == "prismatic"
    has_unit = value[-1:].isalpha()
    text = value if has_unit else value + ("m" if prismatic else "rad")
    return parse_quantity(text, "length" if prismatic else "angle")


def parse_force(text: str) -> tuple[str, Array]:
    """Return link and (3,) force [N] from 'tool=0,0,-500N'; the unit holds for all three."""
    link, equals, values = text.partition("=")
    parts = values.split(",")
    if not equals or len(parts) != 3:
        raise InputError(f"--force: {text!r} is not of the form LINK=FX,FY,FZ with a unit, such as tool=0,0,-500N")
    unit = parts[-1].strip().lstrip("+-.0123456789eE")
    numbers = [part.strip().removesuffix(unit) for part in parts]
    return link.strip(), np.array([parse_quantity(number + unit, "force") for number in numbers])


@contextmanager
def progress(title: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function of (done, total) that draws a bar on a terminal's stderr and is silent elsewhere."""
    from rich.progress import Progress

    out = stream(stderr=True)
    with Progress(console=out, transient=True, disable=not out.is_terminal) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def was_interrupted(error: BaseException | None) -> bool:
    """Return whether Ctrl-C is behind an error: libraries that tidy up after it may fail, and raise that instead."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


_said: set[str] = set()


def show_flags(flags: Sequence[Flag]) -> None:
    """Print doubts about a result on stderr."""
    for flag in flags:
        say_warning(str(flag))


def say_warning(text: str) -> None:
    """Print a warning on stderr, once: an arm's doubts come with every result."""
    if text not in _said:
        _said.add(text)
        complain(f"warning: {text}")
