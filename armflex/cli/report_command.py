"""armflex report: a campaign as a page, after a standard."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import click

from armflex.arm import Arm
from armflex.cli import options
from armflex.cli.terminal import doing, print_table, say, say_written
from armflex.errors import InputError
from armflex.measured.measurements import Measurements
from armflex.show.report import write_report
from armflex.show.report.performance import table
from armflex.show.report.words import millimetres
from armflex.storage.whole_file import together
from armflex.tasks.iso9283 import iso9283


@click.command(cls=options.Command)
@options.points
@options.arm
@partial(options.measurements, several=False)
@click.option("--iso9283", "standard", is_flag=True, help="Pose accuracy, repeatability, directions and drift.")
@click.option("--block", type=options.Quantity("time"), help="Time of one block of cycles, such as 10min: for drift.")
@click.option("-o", "--output", type=options.OutputPath(), help="Page to write.")
def command(
    arm: Arm, measured: Callable[[Arm], Measurements], standard: bool, block: float | None, output: Path | None
) -> None:
    """Pose characteristics of a campaign with repeats, as ISO 9283 defines them.

    AP, the pose accuracy, is the distance of the mean measured position from the tip in the controller's model; for a
    calibrated arm also from the tip in its own model. A log and an export are read as they are if --sigma is given.
    """
    if not standard:
        raise InputError("which report? --iso9283 is known; of a trace it is written by `armflex trace --report`")
    measurements = measured(arm)
    doing("finding pose characteristics")
    performance = iso9283(arm, measurements, block)
    with together():
        options.conclude(performance.content, measurements.flags, arm)
        if output is not None:
            write_report(performance, output)
    print_table("ISO 9283 pose characteristics", *table(performance))
    for name, several in (("vAP", performance.directions), ("dAP", performance.drifts)):
        for characteristic in several:
            again = "" if characteristic.repeatability is None else f", dRP {millimetres(characteristic.repeatability)}"
            accuracy, count = millimetres(characteristic.accuracy), f"{characteristic.number} {characteristic.of}"
            say(f"{characteristic.pose}: {name} {accuracy}{again} ({count}).")
    say("", *performance.remarks)
    say_written(output)
