"""armflex predict: where the tip will be, for every row of a table."""

from __future__ import annotations

from pathlib import Path

import click

from armflex.arm import Arm
from armflex.cli.options import (
    Command,
    OutputPath,
    PathArgument,
    arm_argument,
    covariates_option,
    json_option,
    progress,
    show_flags,
    write_json,
)
from armflex.cli.tables import console
from armflex.measured.measurements import read_measurements
from armflex.tasks.predict import predict, write_predictions


@click.command(cls=Command)
@arm_argument
@click.argument("rows_path", metavar="ROWS.csv", type=PathArgument)
@click.option("-o", "--output", required=True, type=OutputPath(), help="Table to write.")
@covariates_option
@json_option
def command(
    arm: Arm,
    rows_path: Path,
    output: Path,
    covariates: dict[str, float],
    json_path: Path | None,
) -> None:
    """The predicted tip pose, its uncertainty, and the displacement from the rigid arm, row by row."""
    rows = read_measurements(rows_path, arm, inputs_only=True)
    with progress("predicting") as tick:
        found = predict(arm, rows, tick, covariates)
    write_predictions(found, output)
    show_flags(found.flags)
    summary = {"format": "armflex-predict-1", "rows": len(rows.q), "base": arm.robot.base, "tip": arm.robot.tip}
    write_json(json_path, summary | {"flags": [str(flag) for flag in found.flags]})
    console().print(f"{len(rows.q)} rows written to {output} (base {arm.robot.base}, tip {arm.robot.tip}).")
