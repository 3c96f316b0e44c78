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
    """What the instrument would read in every row, how sure that is, and how far the tip is from the rigid arm's.

    x y z and pose_rx pose_ry pose_rz are of a calibrated arm's target, in the instrument's frame; of any other arm they
    are of the tip, in the base frame. sigma_* are of x y z. dx dy dz rx ry rz are of the tip, in base axes.
    """
    with together():
        with progress("predicting") as tick:
            rows, flags = predict_file(arm, rows_path, output, tick, covariates, unnamed, table_path)
        options.conclude(lambda: {"rows": rows}, flags, arm)
    base, tip = arm.robot.base, arm.robot.tip
    read = f"tip {tip}, base frame {base}" if arm.instrument is None else "target, instrument's frame"
    say(f"{rows} rows written to {output}: x y z, pose_r* ({read}); dx .. rz (tip {tip}, base axes {base}).")
