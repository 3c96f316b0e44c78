"""armflex compensate: joint positions that cancel the sag."""

from pathlib import Path

import click
import numpy as np

from armflex.arm import Arm
from armflex.cli import options
from armflex.cli.terminal import doing, no_via_points, number, plus_minus, print_table, progress, say
from armflex.errors import InputError, enough_memory, further
from armflex.measured.forces import Unnamed
from armflex.result import record
from armflex.storage.whole_file import together
from armflex.tasks.calm import SLOWER, Calmed
from armflex.tasks.calm import calm as calm_path
from armflex.tasks.compensate import Compensation, compensate
from armflex.trajectory import write_trajectory

MOST_ROWS = 40
"""Of a table on a screen."""


@click.command(cls=options.Command)
@options.arm
@options.as_in_campaign
@click.argument("trajectory_path", metavar="TRAJ.csv", type=options.InputPath)
@click.option("-o", "--output", required=True, type=options.OutputPath(), help="Compensated trajectory to write.")
@click.option("--match", type=options.Choice(["position", "pose"]), default="position", show_default=True,
              help="Correct the position of the tip, or its orientation as well.")  # fmt: skip
@click.option("--between", type=options.Quantity("length"), metavar="0.1mm",
              help="Insert rows until the error halfway between rows is below this.")  # fmt: skip
@click.option("--calm", is_flag=True, help="Time the path so that the tip swings little where it stops: input shaping.")
@click.option("--slower", type=click.FloatRange(min=1.0), metavar="1.3",
              help="With --calm: how many times as long a motion may take [default: 1.3].")  # fmt: skip
@click.option("--best-effort", is_flag=True, help="Write the best feasible rows where others cannot be reached.")
@options.loads
@options.force_table
@options.covariates
def command(
    arm: Arm,
    unnamed: Unnamed,
    table_path: Path | None,
    trajectory_path: Path,
    output: Path,
    match: str,
    between: float | None,
    calm: bool,
    slower: float | None,
    best_effort: bool,
    covariates: dict[str, float],
) -> int:
    """Put the loaded, deflected tip where the rigid arm would have been, and report what remains.

    Process forces are those of the rows, of --force or of --force-table; they are written with the rows.
    Nothing is written where a row cannot be reached, unless --best-effort is given.
    """
    if slower is not None and not calm:
        raise InputError("--slower limits the time that --calm adds: give --calm, too")
    trajectory = options.read_path(trajectory_path, arm, unnamed, table_path)
    with enough_memory(f"{len(trajectory)} rows"), progress("compensating") as tick:
        asked = {"best_effort": True, "between": between, "covariates": covariates}
        compensation = compensate(arm, trajectory, match, progress=tick, **asked)
    summary = record(compensation, "ok match between_m relative_sigma_m rows")
    summary["remains_m"], summary["sigma_m"] = compensation.remains_m
    written, flags, calmed = compensation.ok or best_effort, compensation.flags, None
    if calm and written:
        doing("shaping")
        calmed = calm_path(arm, compensation.trajectory, slower or SLOWER, covariates)
        flags, summary["calm"] = further(flags, calmed.flags), calmed.motions
    with together():
        if written:
            write_trajectory(compensation.trajectory if calmed is None else calmed.trajectory, output)
        options.conclude(lambda: summary, flags, arm)
    say(f"base {arm.robot.base}, tip {arm.robot.tip}", "")
    print_compensation(compensation)
    if calmed is not None:
        print_calmed(calmed)
    say(f"Written to {output}." if written else "Nothing is written; --best-effort writes the feasible rows.")
    return 0 if compensation.ok else 1


def print_calmed(calmed: Calmed) -> None:
    """Print how each motion is timed, and how far the tip swings after it."""
    rows = [
        [
            motion.via or "-",
            motion.shaper or "left as it is",
            *(number(seconds, 3) for seconds in motion.duration_s),
            *(number(swing * 1e3, 3) for swing in motion.swing_m),
        ]
        for motion in calmed.motions
    ]
    columns = ["motion to", "shaper", "before s", "after s", "swing before mm", "after mm", "frequencies 10 % off mm"]
    print_table("Motions from rest to rest", columns, rows)
    say("Swing is the largest shift of the tip about where it comes to rest, all modes together.", "")


def print_compensation(compensation: Compensation) -> None:
    """Print the via-points before and after, what was not reached, and the worst of the path.

    Where the path names no via-points, its first and last row and the one where most remains stand for it.
    """
    before, after = (
        np.linalg.norm([getattr(row, name)[:3] for row in compensation.rows], axis=1) for name in ("before", "after")
    )
    worst = compensation.rows[int(np.argmax(after))]
    stand_in = []
    if not any(row.via for row in compensation.rows):
        say(no_via_points("its first and last row, that where most remains, and what is not reached"), "")
        stand_in = [compensation.rows[0], worst, compensation.rows[-1]]
    shown = [
        [
            row.via or "-",
            f"{row.time:g}",
            number(float(shift_before) * 1e3),
            number(float(shift_after) * 1e3, 2),
            plus_minus(row.relative_sigma_m),
            *(number(float(np.linalg.norm(error[3:])) * 1e3, 3) for error in (row.before, row.after)),
            number(float(np.abs(row.change).max()), 3),
            "reached" if row.reached else row.reason,
        ]
        for row, shift_before, shift_after in zip(compensation.rows, before, after, strict=True)
        if row.via or not row.reached or any(row is other for other in stand_in)
    ]
    columns = ["row", "time s", "before mm", "remains mm", "± mm", "before mrad", "remains mrad", "most rad or m"]
    columns.append("result")
    print_table(f"Tip error, matching {compensation.match}", columns, shown[:MOST_ROWS])
    if hidden := shown[MOST_ROWS:]:
        missed = sum(row[-1] != "reached" for row in hidden)
        say(f"{len(hidden)} further rows are not shown; {missed} of them were not reached.")
    reached = sum(row.reached for row in compensation.rows)
    sigma, relative = compensation.remains_m[1], compensation.relative_sigma_m
    about = "" if relative is None else f" (± mm: {plus_minus(relative)})"
    largest = f"largest error {number(before.max() * 1e3)} mm before, {number(after.max() * 1e3, 2)} mm{about} after"
    turns = ", ".join(
        f"{number(turn * 1e3, 2)} mrad {when}"
        for turn, when in zip(compensation.turns_rad, ("before", "after"), strict=True)
    )
    say(f"{reached} of {len(compensation.rows)} rows reached; {largest}; turned by up to {turns}.")
    if sigma is not None:
        say("± is one standard uncertainty of what remains, from the laws and the fitted parameters.")
    if plus_minus(sigma) != plus_minus(relative):
        text = "It is that of the campaign's target before its instrument. Of the tip in the base frame it is up to"
        say(f"{text} ± {plus_minus(sigma)} mm: the places of base and target are uncertain, alike in all rows.")
    if compensation.between_m is not None:
        say(f"Halfway between rows of one payload the error is up to {number(compensation.between_m * 1e3, 3)} mm.")
