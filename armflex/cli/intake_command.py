"""armflex intake: files as people have them into a campaign."""

from __future__ import annotations

from pathlib import Path

import click

from armflex.cli import options
from armflex.cli.terminal import say
from armflex.errors import InputError
from armflex.measured.table import write_table
from armflex.storage.whole_file import together, write_whole


@click.command(cls=options.Command)
@click.argument("paths", metavar="FILE...", nargs=-1, required=True, type=options.InputPath)
@options.as_they_are
@click.option(
    "--dh", type=options.Choice(["standard", "modified"]), help="Form of a table of DH parameters among the files."
)
@click.option(
    "--arm",
    "arm_path",
    metavar="ARM.toml",
    type=options.OutputPath(),
    help="Arm file to write, where the files have a table of DH parameters; further targets are in it.",
)
@click.option("-o", "--output", required=True, type=options.OutputPath(), help="Campaign to write.")
def command(
    paths: tuple[Path, ...],
    sigma: float | None,
    take: tuple[str, ...],
    targets: tuple[str, ...],
    dh: str | None,
    arm_path: Path | None,
    output: Path,
) -> None:
    """Join a controller's log and a tracker's export, or read one file with both, to a campaign.

    A log alone becomes a path, each row a via-point. A table of DH parameters becomes an arm file with --arm.

    Text files with semicolons, commas, tabs or blanks, decimal commas, comments and titles, in UTF-8, UTF-16 or
    Windows-1252, and workbooks; bags of ROS (rosbag2, MCAP), Motive CSV, C3D, and traces of KUKA controllers. Rows are
    joined by the points' names, else in their order, else by time; a recording counts where the arm stands. What every
    column was taken as is printed first. An open unit is asked for on a terminal, and refused elsewhere.
    """
    found = options.taken_in(paths, sigma, take, targets, dh)
    if arm_path is not None and found.arm is None:
        raise InputError("--arm: no file has a table of DH parameters: columns theta, d, a, alpha")
    if found.declare and arm_path is None:
        say("A further target is an instrument of its own. For the arm file:")
        for line in found.declare.splitlines():
            say(line)
    with together():
        write_table(output, found.columns)
        if arm_path is not None and found.arm is not None:
            write_whole(arm_path, found.arm.encode())
    options.conclude(lambda: {"joined": found.joined, "taken": found.taken, "notes": found.notes}, ())
    say(f"Written to {' and '.join(str(path) for path in (output, arm_path) if path)}.")
