"""armflex export: the arm as other programs read it."""

import importlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from armflex.arm import Arm
from armflex.cli import options
from armflex.cli.terminal import complain, doing, say, say_file, say_written, show_flags
from armflex.errors import InputError, PluginError, listing
from armflex.export import Exported, exporter_fault
from armflex.export.programs import is_name
from armflex.measured.forces import UNLOADED, Unnamed
from armflex.plugins import Registry
from armflex.storage.whole_file import together, write_whole


@dataclass(frozen=True)
class Format:
    """A format: a function gets the arm and those of its options that were given.

    Attributes:
        module: Of `armflex.export`.
        options: Options of the command, by their names in Python, that mean something to it.
        needs: Options without which nothing can be written.
        function: Of the module.
    """

    module: str
    options: tuple[str, ...] = ()
    needs: tuple[str, ...] = ("output",)
    function: str = "export"


PATH = ("traj", "compensate", "covariates", "unnamed", "table_path")
"""Options of the formats of a path."""

_BUNDLED = {
    "urdf": Format("urdf_file", options=("over",)),
    "sheet": Format("sheet", options=("over",), needs=()),
    "yaml": Format("yaml_files", options=("flavour", "over"), needs=("flavour", "output")),
    "c": Format("c_code", options=("name",)),
    "shaper": Format("shaper", options=("traj", "name", "slower", "covariates", "unnamed"), needs=("traj", "output")),
    **{
        name: Format("programs", options=(*PATH, "name", "axes"), needs=("traj", "output"), function=name)
        for name in ("urscript", "krl", "rapid", "ls", "val3")
    },
    "jointtrajectory": Format("programs", options=PATH, needs=("traj", "output"), function="jointtrajectory"),
}


FORMATS: Registry[Any] = Registry("armflex.exporters", _BUNDLED, lambda name, export: exporter_fault(export))
"""What `--to` may be: a `Format`, or the function of a plug-in."""


def _exporter(target: str) -> tuple[Format, Callable[..., Exported]]:
    """Return what a format wants, and its function; a plug-in's function says by its parameters what it wants."""
    form = FORMATS[target]
    if isinstance(form, Format):
        return form, getattr(importlib.import_module(f"armflex.export.{form.module}"), form.function)
    _, *parameters = inspect.signature(form).parameters.values()
    needs = [parameter.name for parameter in parameters if parameter.default is parameter.empty]
    return Format("", tuple(parameter.name for parameter in parameters), (*needs, "output")), form


@click.command(cls=options.Command)
@options.arm
@options.as_in_campaign
@click.option("--to", "target", type=options.Choice(FORMATS.names()), required=True,
              help="sheet: what is typed into a controller; yaml: calibrations for ROS; c: C99 without dependencies; "
                   "shaper: C99 with the impulses that calm the path of --traj; urscript, krl, rapid, ls (FANUC), "
                   "val3 (Staubli), jointtrajectory: a program with that path.")  # fmt: skip
@click.option("-o", "--output", type=options.OutputPath(), help="File to write.")
@click.option("--name", help="c, shaper: what every name in the file begins with [default: arm, shaper]; of a "
                             "program: its name [default: that of the file].")  # fmt: skip
@click.option("--flavour", type=options.Choice(["ur_calibration", "robot_calibration"]), help="yaml: who reads it.")
@click.option("--over", metavar="ROWS.csv", type=options.InputPath,
              help="Rows over which the omitted error is computed [default: the joints' limits].")  # fmt: skip
@click.option("--traj", metavar="TRAJ.csv", type=options.InputPath, help="The path that a program has.")
@click.option("--slower", type=click.FloatRange(min=1.0), metavar="1.3",
              help="shaper: how many times as long a motion may take [default: 1.3].")  # fmt: skip
@click.option("--compensate", is_flag=True, default=None, help="Write the path on which the loaded tip is where the "
                                                               "rigid one would be.")  # fmt: skip
@click.option("--axes", metavar="A1=J2,E1=rail", help="Of a program: which joint is which axis of the "
              "controller, each joint once [default: in their order, sliding ones on external axes].")  # fmt: skip
@options.loads
@options.force_table
@click.option("--covariates", metavar="temperature=25", help="With --compensate: what the arm's effects depend on.",
              callback=lambda *given: None if given[2] is None else options.parse_covariates(given[2]))  # fmt: skip
def command(arm: Arm, unnamed: Unnamed, target: str, output: Path | None, **given: Any) -> None:
    """Write the arm for other programs: see --to.

    What a format cannot express is refused by name, or omitted, and the error of omitting it is printed in mm.
    """
    (wanted, export), asked = _exporter(target), {option: value for option, value in given.items() if value is not None}
    asked |= {} if unnamed == UNLOADED else {"unnamed": unnamed}
    context = click.get_current_context()
    flags = {declared.name: declared.opts[0] for declared in context.command.params}
    for option in [option for option in asked if option not in wanted.options]:
        targets = [name for name in FORMATS if option in _exporter(name)[0].options]
        flag = flags.get(option, "--payload or --force")
        raise InputError(f"{flag} has no meaning for --to {target}; it is an option of --to {listing(targets)}")
    given_too = {"output"} if output else set[str]()
    for option in [option for option in wanted.needs if option not in asked.keys() | given_too]:
        kind = next(declared.type for declared in context.command.params if declared.name == option)
        more = f" {' or '.join(kind.choices)}" if isinstance(kind, options.Choice) else ""
        raise InputError(f"--to {target} needs {flags[option]}{more}")
    if wanted.module and "traj" in asked:
        asked["arm_file"] = str(context.params["arm_path"])
    doing("exporting")
    if "axes" in wanted.options and output is not None and is_name(output.stem):
        asked.setdefault("name", output.stem)  # controllers want a file to be named as its program
    exported = export(arm, **asked)
    if not isinstance(exported, Exported):
        raise PluginError(f"the exporter {target!r} gives a {type(exported).__name__}, expected an Exported")
    with together():
        if output is not None:
            write_whole(output, exported.text.encode())
        options.write_json({"format": "armflex-export-1", "to": target, **exported.numbers})
    if output is None:
        say_file((exported.page or exported.text).removesuffix("\n"))
    show_flags(exported.flags)
    for line in exported.notes:
        complain(line) if output is None else say(line)
    say_written(output)
