"""armflex prior: what sister arms have in common, as the prior of the next one."""

import os
from pathlib import Path

import click

from armflex.cli import options
from armflex.cli.terminal import number, print_table, say, say_written
from armflex.errors import InputError, listing
from armflex.estimate.calibrations import common
from armflex.files.arm_file import load_arm, write_prior
from armflex.result import record
from armflex.storage.whole_file import together

MOST_LINES = 20


@click.command(cls=options.Command)
@click.argument("paths", metavar="ARM.toml ...", nargs=-1, required=True, type=options.InputPath)
@click.option("-o", "--output", required=True, type=options.OutputPath(), help="Arm file to write, for the next one.")
@click.option("--all", "show_all", is_flag=True, help="List every parameter.")
def command(paths: tuple[Path, ...], output: Path, show_all: bool) -> None:
    """Write what calibrated sister arms have in common as the prior of the next one, which then needs fewer rows.

    Mean and spread of offsets, geometry, masses and compliance are estimated from the sisters' own uncertainties, and
    the prior of the next one is as wide as so few sisters leave it. It is [prior.each] in its arm file. An arm that
    does not belong with the others is left out.
    """
    if len({os.path.realpath(path) for path in paths}) < len(paths):
        raise InputError("an arm file is given twice: each sister counts once")
    fleet = common({str(path): load_arm(path) for path in paths})
    kept = [path for path in paths if str(path) in fleet.sisters]
    content = {
        "format": "armflex-prior-1",
        "sisters": fleet.sisters,
        "strangers": [{"arm": name, "log_odds": odds} for name, odds in fleet.strangers.items()],
        "parameters": [
            record(parameter, "unit", name="label") | {"mean": mean, "spread": spread, "std": std}
            for parameter, mean, spread, std in zip(fleet.parameters, fleet.mean, fleet.spread, fleet.std, strict=True)
        ],
        "held": [parameter.label for parameter in fleet.held],
    }
    with together():
        options.write_json(content)
        write_prior(kept[0], fleet.each, output)
    rows = [
        [parameter.label, *(number(value, 3) for value in values), parameter.unit]
        for parameter, *values in zip(fleet.parameters, fleet.mean, fleet.spread, fleet.std, strict=True)
    ]
    print_table(
        f"{len(fleet.sisters)} sisters",
        ["parameter", "mean", "spread", "± of the next one", "unit"],
        rows if show_all else rows[:MOST_LINES],
    )
    if not show_all and len(rows) > MOST_LINES:
        say(f"{len(rows) - MOST_LINES} more with --all.")
    if fleet.held:
        say(f"As declared, because others do the same to every reading: {listing((p.label for p in fleet.held), 8)}.")
    for name, odds in fleet.strangers.items():
        say(f"Left out: {name} is no sister of the others (odds of 1 to {number(10 ** min(odds / 2.3026, 300), 2)}).")
    say_written(output)
