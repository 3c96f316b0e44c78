"""armflex predict: where the tip will be, for every row of a table."""

from pathlib import Path

import click

from armflex.arm import Arm
from armflex.cli import options
from armflex.cli.terminal import progress, say
from armflex.measured.forces import Unnamed
from armflex.storage.whole_file import together
from armflex.tasks.predict import predict_file


@click.command(cls=options.Command)
@options.arm
@options.as_in_campaign
@click.argument("rows_path", metavar="ROWS.csv", type=options.InputPath)
@click.option("-o", "--output", required=True, type=options.OutputPath(), help="Table to write.")
@options.loads
@options.force_table
@options.covariates
def command(
    arm: Arm, unnamed: Unnamed, table_path: Path | None, rows_path: Path, output: Path, covariates: dict[str, float]
) -> None:
    """The predicted tip pose, its uncertainty, and the displacement from the rigid arm, row by row."""
    with together():
        with progress("predicting") as tick:
            rows, flags = predict_file(arm, rows_path, output, tick, covariates, unnamed, table_path)
        options.conclude(lambda: {"rows": rows}, flags, arm)
    say(f"{rows} rows written to {output} (base {arm.robot.base}, tip {arm.robot.tip}).")
