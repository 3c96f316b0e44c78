"""armflex intake: files as people have them into a campaign."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import click

from armflex.cli import options
from armflex.cli.terminal import print_table, say
from armflex.errors import InputError
from armflex.intake import intake
from armflex.measured.table import write_table


@click.command(cls=options.Command)
@click.argument("paths", metavar="FILE...", nargs=-1, required=True, type=options.InputPath)
@click.option(
    "--sigma",
    required=True,
    type=options.Quantity("length"),
    metavar="0.05mm",
    help="One standard deviation of a measured coordinate.",
)
@click.option(
    "--take",
    multiple=True,
    metavar="COLUMN=MEANING",
    help="What a column is where its name does not say it: q_J1_deg, x_mm, pose, time, payload, session.",
)
@click.option(
    "--target",
    "targets",
    multiple=True,
    metavar="NAME",
    help="Topic, frame, body or marker of a recording that is the target; several are several targets.",
)
@click.option("-o", "--output", required=True, type=options.OutputPath(), help="Campaign to write.")
def command(
    paths: tuple[Path, ...], sigma: float, take: tuple[str, ...], targets: tuple[str, ...], output: Path
) -> None:
    """Join a controller's log and a tracker's export, or read one file with both, to a campaign.

    Text files with semicolons, commas, tabs or blanks, decimal commas, comments and titles, in UTF-8, UTF-16 or
    Windows-1252, and workbooks; bags of ROS (rosbag2, MCAP), Motive CSV, C3D, and traces of KUKA controllers. Rows are
    joined by the points' names, else in their order, else by time; a recording counts where the arm stands. What every
    column was taken as is printed first. An open unit is asked for on a terminal, and refused elsewhere.
    """
    pairs = [one.rpartition("=") for one in take]
    if wrong := next((one for one, pair in zip(take, pairs, strict=True) if not pair[0] or not pair[2]), None):
        raise InputError(f"--take {wrong}: expected COLUMN=MEANING")
    asked = {column: meaning for column, _, meaning in pairs}
    found = intake(paths, sigma, asked, _ask if sys.stdin.isatty() else None, targets)
    print_table("Columns", ["file", "column", "is", "unit", "because of"], found.taken)
    say(f"{len(found.columns['pose'])} rows, joined {found.joined}.")
    for note in found.notes:
        say(f"Note: {note}.")
    if found.declare:
        say("A further target is an instrument of its own. For the arm file:")
        for line in found.declare.splitlines():
            say(line)
    write_table(output, found.columns)
    options.conclude(lambda: {"joined": found.joined, "taken": found.taken, "notes": found.notes}, ())
    say(f"Written to {output}.")


def _ask(question: str, choices: Sequence[str]) -> str:
    return click.prompt(question, type=click.Choice(list(choices)), err=True)
