"""armflex compensate: joint positions that cancel the sag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from armflex.arm import Arm
from armflex.cli.options import (
    Choice,
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
from armflex.cli.tables import console, no_via_points, number, print_table
from armflex.conventions import parse_quantity
from armflex.errors import enough_memory
from armflex.tasks.compensate import CompensatedRow, Compensation, compensate
from armflex.trajectory import read_trajectory, write_trajectory

MOST_ROWS = 40
"""Of a table on a screen."""


@click.command(cls=Command)
@arm_argument
@click.argument("trajectory_path", metavar="TRAJ.csv", type=PathArgument)
@click.option("-o", "--output", required=True, type=OutputPath(), help="Compensated trajectory to write.")
@click.option("--match", type=Choice(["position", "pose"]), default="position", show_default=True)
@click.option("--between", metavar="0.1mm", help="Insert rows until the error halfway between rows is below this.")
@click.option("--best-effort", is_flag=True, help="Write the best feasible rows where others cannot be reached.")
@covariates_option
@json_option
def command(
    arm: Arm,
    trajectory_path: Path,
    output: Path,
    match: str,
    between: str | None,
    best_effort: bool,
    covariates: dict[str, float],
    json_path: Path | None,
) -> int:
    """Put the loaded, deflected tip where the rigid arm would have been, and say what remains.

    Nothing is written where a row cannot be reached, unless --best-effort is given.
    """
    trajectory = read_trajectory(trajectory_path, arm)
    gap = None if between is None else parse_quantity(between, "length")
    with enough_memory(f"{len(trajectory)} rows"), progress("compensating") as tick:
        asked = {"best_effort": True, "between": gap, "covariates": covariates}
        found = compensate(arm, trajectory, match, progress=tick, **asked)
    console().print(f"base {arm.robot.base}, tip {arm.robot.tip}", "")
    print_compensation(found)
    show_flags(found.flags)
    write_json(json_path, as_json(found) | {"base": arm.robot.base, "tip": arm.robot.tip})
    if found.ok or best_effort:
        write_trajectory(found.trajectory, output)
        console().print(f"Written to {output}.")
    else:
        console().print("Nothing is written; --best-effort writes the feasible rows.")
    return 0 if found.ok else 1


def print_compensation(found: Compensation) -> None:
    """Print the via-points before and after, what was not reached, and the worst of the path.

    Where the path names no via-points, its first and last row and the one where most remains stand for it.
    """
    lost = [row for row in found.rows if not row.reached]
    worst = max(found.rows, key=lambda row: _length(row.after))
    if not any(row.via for row in found.rows):
        console().print(no_via_points("its first and last row, that where most remains, and what is not reached"))
    stand_in = [] if any(row.via for row in found.rows) else [found.rows[0], worst, found.rows[-1]]
    shown = [row for row in found.rows if row.via or not row.reached or any(row is one for one in stand_in)]
    columns = ["row", "time s", "before mm", "remains mm", "before mrad", "remains mrad", "most rad or m", "result"]
    print_table(f"Tip error, matching {found.match}", columns, [_cells(row) for row in shown[:MOST_ROWS]])
    if hidden := shown[MOST_ROWS:]:
        missed = sum(not row.reached for row in hidden)
        console().print(f"... and {len(hidden)} more via-points and rows not reached, {missed} of them not reached.")
    before, after = (max(_length(getattr(row, name)) for row in found.rows) for name in ("before", "after"))
    largest = f"largest error {number(before * 1e3)} mm before, {number(after * 1e3, 2)} mm after"
    console().print(f"{len(found.rows) - len(lost)} of {len(found.rows)} rows reached; {largest}.")
    if found.between_m is not None:
        console().print(f"Halfway between rows of one payload up to {number(found.between_m * 1e3, 3)} mm remain.")


def _cells(row: CompensatedRow) -> list[str]:
    return [
        row.via or "-",
        f"{row.time:g}",
        number(_length(row.before) * 1e3),
        number(_length(row.after) * 1e3, 2),
        number(_length(row.before[3:]) * 1e3, 3),
        number(_length(row.after[3:]) * 1e3, 3),
        number(float(np.abs(row.change).max()), 3),
        "reached" if row.reached else row.reason,
    ]


def _length(error: np.ndarray) -> float:
    return float(np.linalg.norm(error[:3]))


def as_json(found: Compensation) -> dict[str, Any]:
    """Return a compensation for programs, SI."""
    return {
        "format": "armflex-compensate-1",
        "ok": found.ok,
        "match": found.match,
        "between_m": found.between_m,
        "rows": [
            {
                "time": row.time,
                "via": row.via,
                "reached": row.reached,
                "smallest": row.smallest,
                "reason": row.reason,
                "before": row.before.tolist(),
                "after": row.after.tolist(),
                "change": row.change.tolist(),
                "sigma_min": row.sigma_min,
            }
            for row in found.rows
        ],
        "flags": [str(flag) for flag in found.flags],
    }
