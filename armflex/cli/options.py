"""What several commands share: the arm they load, quantities with units, JSON files, progress."""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.arm import Arm
from armflex.arm_file import load_arm
from armflex.conventions import NUMBER, Array, parse_quantity
from armflex.errors import Flag, InputError, UnknownNameError
from armflex.point_export import read_points
from armflex.whole_file import write_whole

PathArgument = click.Path(path_type=Path)


class OutputPath(click.Path):
    """A file to be written; its folder is looked at before anything is computed or written."""

    def __init__(self) -> None:
        super().__init__(dir_okay=False, path_type=Path)

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Path:
        """Return the path; fail where no file can be written there."""
        path = super().convert(value, parameter, context)
        if not path.parent.is_dir():
            self.fail(f"folder {path.parent} of {path.name!r} does not exist", parameter, context)
        if not os.access(path.parent, os.W_OK):
            self.fail(f"folder {path.parent} cannot be written", parameter, context)
        return path


def arm_argument(function: Callable) -> Callable:
    """Add the ARM argument, `--preset`, `--tip` and `--lax`; the command is called with the loaded arm first."""

    @functools.wraps(function)
    def with_arm(arm_path: Path, preset: str | None, tip: str | None, lax: bool, **rest: Any) -> Any:
        return function(load_arm(arm_path, preset=preset, tip=tip, strict=not lax), **rest)

    for decorate in (
        click.argument("arm_path", metavar="ARM", type=PathArgument),
        click.option("--preset", metavar="NAME", help="Use the flexures of [preset.NAME] in ARM."),
        click.option("--tip", metavar="LINK", help="Link whose motion is reported, where ARM is a bare URDF."),
        click.option("--lax", is_flag=True, help="Flag unknown URDF tags and impossible inertias, do not refuse."),
    ):
        with_arm = decorate(with_arm)
    return with_arm


keep_option = click.option(
    "--keep",
    is_flag=True,
    help="ARM is calibrated or traced already: keep it, and fit only where the instrument stands.",
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
        help="What the arm's effects depend on, SI and degrees Celsius; a column of the rows needs none.",
    )(function)


def parse_covariates(text: str) -> dict[str, float]:
    """Return numbers by name from 'temperature=25,approach_A2=1'.

    Raises:
        InputError: Not of that form, not a finite number, or a name given twice.
    """
    found: dict[str, float] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not name or not NUMBER.fullmatch(value) or not np.isfinite(float(value)):
            raise InputError(f"--covariates: {part!r} is not of the form NAME=NUMBER")
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
    """Return q (nq,) from 'A1=0.3,A4=-10deg'; joints not named are at zero.

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
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


_said: set[str] = set()


def show_flags(flags: Sequence[Flag]) -> None:
    """Print doubts about a result on stderr."""
    for flag in flags:
        say_warning(str(flag))


def say_warning(text: str) -> None:
    """Print a warning on stderr, once: an arm's doubts come with every result."""
    if text not in _said:
        _said.add(text)
        click.echo(f"warning: {text}", err=True)


def keep_inputs(output: Path) -> None:
    """Raise `InputError` where a command's output would replace one of the files it is made from."""
    for parameter, value in click.get_current_context().params.items():
        is_input = isinstance(value, Path) and parameter not in ("output", "json_path", "report_path")
        if is_input and output.resolve() == value.resolve():
            raise InputError(f"{output} is an input of this command; name another file with -o")
