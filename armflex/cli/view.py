"""armflex view: a page of the arm."""

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
    parse_positions,
    progress,
    show_flags,
    write_json,
)
from armflex.cli.tables import console
from armflex.conventions import parse_quantity
from armflex.errors import InputError
from armflex.show.view.view import view
from armflex.tasks.check import check
from armflex.trajectory import read_trajectory


@click.command(cls=Command)
@arm_argument
@click.option("--traj", "trajectory_path", type=PathArgument, metavar="TRAJ.csv", help="Animate this trajectory.")
@click.option("--tolerance", metavar="5mm", help="Colour the via-points by their verdict.")
@click.option("--q", "positions", default="", metavar="A1=0.3", help="Joint positions where no trajectory is given.")
@click.option("--payload", default="none", show_default=True, help="Carried at --q.")
@click.option("--magnify", type=float, help="Factor on the deflections shown; a round one is chosen otherwise.")
@click.option("--meshes", is_flag=True, help="Draw the URDF's mesh files where they lie beside it.")
@click.option("-o", "--output", required=True, type=OutputPath(), help="HTML page to write.")
@covariates_option
@json_option
def command(
    arm: Arm,
    trajectory_path: Path | None,
    tolerance: str | None,
    positions: str,
    payload: str,
    magnify: float | None,
    meshes: bool,
    output: Path,
    covariates: dict[str, float],
    json_path: Path | None,
) -> None:
    """One self-contained page, made without a display, opened by any browser."""
    if trajectory_path is None and tolerance is not None:
        raise InputError("--tolerance goes with --traj")
    if trajectory_path is not None and (positions or payload != "none"):
        raise InputError("--traj brings its own positions and payloads: leave --q and --payload out")
    shown = {"magnification": magnify, "meshes": meshes, "covariates": covariates, "path": output}
    if trajectory_path is None:
        view(arm, parse_positions(positions, arm) if positions else None, payload, **shown)
    else:
        trajectory = read_trajectory(trajectory_path, arm)
        report = None
        if tolerance is not None:
            with progress("checking") as tick:
                report = check(
                    arm, trajectory, parse_quantity(tolerance, "length"), progress=tick, covariates=covariates
                )
        view(arm, trajectory=trajectory, report=report, **shown)
        show_flags(trajectory.with_constants(arm, covariates).derived_directions(arm))
    written = {"format": "armflex-view-1", "page": str(output), "base": arm.robot.base, "tip": arm.robot.tip}
    write_json(json_path, written)
    console().print(f"Written to {output}; open it in a browser.")
