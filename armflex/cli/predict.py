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
from armflex.tasks.predict import predict_file


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
    with progress("predicting") as tick:
        rows, flags = predict_file(arm, rows_path, output, tick, covariates)
    show_flags(flags)
    summary = {"format": "armflex-predict-1", "rows": rows, "base": arm.robot.base, "tip": arm.robot.tip}
    write_json(json_path, summary | {"flags": [str(flag) for flag in flags]})
    console().print(f"{rows} rows written to {output} (base {arm.robot.base}, tip {arm.robot.tip}).")
