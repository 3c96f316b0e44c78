"""armflex view: a page of the arm."""

from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.arm import Arm
from armflex.cli import options
from armflex.cli.terminal import progress, say, show_flags
from armflex.errors import InputError
from armflex.measured.forces import Unnamed
from armflex.show.view.arm_scene import view
from armflex.storage.whole_file import together
from armflex.tasks.check import check
from armflex.trajectory import read_trajectory


@click.command(cls=options.Command)
@options.arm
@click.option("--traj", "trajectory_path", type=options.InputPath, metavar="TRAJ.csv", help="Animate this trajectory.")
@click.option("--tolerance", type=options.Quantity("length"), metavar="5mm",
              help="Colour the via-points by their verdict.")  # fmt: skip
@click.option("--q", "positions", multiple=True, metavar="A1=0.3", help="Joint positions where no path is given.")
@click.option("--magnify", "magnification", type=float,
              help="Factor by which deflections are enlarged; a round one is chosen otherwise.")  # fmt: skip
@click.option("--meshes", is_flag=True, help="Draw the URDF's mesh files where they lie beside it.")
@click.option("-o", "--output", "path", required=True, type=options.OutputPath(), help="HTML page to write.")
@options.loads
@options.covariates
def command(
    arm: Arm,
    unnamed: Unnamed,
    trajectory_path: Path | None,
    tolerance: float | None,
    positions: tuple[str, ...],
    **shown: Any,
) -> None:
    """Write one self-contained page of the arm, which any browser opens. No display is needed."""
    if trajectory_path is None and tolerance is not None:
        raise InputError("--tolerance needs --traj")
    if trajectory_path is not None and positions:
        raise InputError("--traj brings its own positions: leave --q out")
    path, covariates = shown["path"], shown["covariates"]
    with together():
        if trajectory_path is None:
            pulled = () if unnamed.force is None else (unnamed.force,)
            q, arm = options.parse_positions(",".join(positions), arm) if positions else (None, arm)
            view(arm, q, unnamed.payload, wrenches=pulled, **shown)
        else:
            trajectory = read_trajectory(trajectory_path, arm, unnamed)
            report = None
            by_row = trajectory.tolerance is not None and np.isfinite(trajectory.tolerance).all()
            if tolerance is not None or by_row:
                with progress("checking") as tick:
                    report = check(arm, trajectory, tolerance, progress=tick, covariates=covariates)
            with progress("drawing") as tick:
                view(arm, trajectory=trajectory, report=report, progress=tick, **shown)
            show_flags(trajectory.with_constants(arm, covariates).derived_directions(arm))
        named = {"page": str(path), "base": arm.robot.base, "tip": arm.robot.tip}
        options.write_json({"format": "armflex-view-1", **named})
    say(f"Written to {path}; open it in a browser.")
