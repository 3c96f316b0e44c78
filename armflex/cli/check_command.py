"""armflex check: a trajectory against a tolerance."""

from pathlib import Path
from typing import Any

import click

from armflex.arm import Arm
from armflex.cli import options
from armflex.cli.terminal import doing, no_via_points, number, plus_minus, print_table, progress, say, say_written
from armflex.errors import enough_memory, further
from armflex.measured.forces import Unnamed
from armflex.mechanics.equilibrium import METHODS
from armflex.result import record
from armflex.storage.whole_file import together
from armflex.tasks.check import CheckReport, Point, check
from armflex.tasks.settle import SettlingReport, settle
from armflex.trajectory import read_trajectory


@click.command(cls=options.Command)
@options.arm
@options.as_in_campaign
@click.argument("trajectory_path", metavar="TRAJ.csv", type=options.InputPath)
@click.option("--tolerance", type=options.Quantity("length"), metavar="5mm",
              help="Largest displacement of the tip, with unit, where a column tolerance has none.")  # fmt: skip
@click.option("--angle", type=options.Quantity("angle"), metavar="1mrad",
              help="Largest rotation of the tip, with unit.")  # fmt: skip
@click.option("--against", "desired_path", metavar="DESIRED.csv", type=options.InputPath,
              help="Compare the flexed tip with the rigid tip on this path instead of on TRAJ: is a compensated "
                   "path where it was meant to be?")  # fmt: skip
@click.option("--settle", "within", type=options.Quantity("length"), metavar="1mm",
              help="Also: how long after each via-point the tip swings by more than this, and the peak.")  # fmt: skip
@click.option("--report", "report_path", type=options.OutputPath(), metavar="R.html",
              help="Write a page: picture, margins, first frequencies, settling, what it rests on.")  # fmt: skip
@click.option("--method", type=options.Choice(METHODS), default="exact", show_default=True,
              help="How the equilibrium is found.")  # fmt: skip
@options.loads
@options.force_table
@options.covariates
def command(
    arm: Arm,
    unnamed: Unnamed,
    table_path: Path | None,
    trajectory_path: Path,
    tolerance: float | None,
    angle: float | None,
    desired_path: Path | None,
    within: float | None,
    report_path: Path | None,
    **how: Any,
) -> int:
    """Each via-point and the path between: displacement, margin, verdict, worst first.

    The displacement is that of the loaded tip from the rigid tip, on the same path or, with --against, on another one.
    """
    trajectory = options.read_path(trajectory_path, arm, unnamed, table_path)
    against = None if desired_path is None else read_trajectory(desired_path, arm)
    with enough_memory(f"{len(trajectory)} rows"), progress("checking") as tick:
        report = check(arm, trajectory, tolerance, angle, progress=tick, against=against, **how)
        swing = None if within is None else settle(arm, trajectory, within, how["covariates"])
    moved = against is not None or trajectory.is_moved
    said = record(report, "ok tolerance_m angle_rad samples load_factor via_points path_worst relative_sigma_m")
    said |= {"against": str(desired_path or trajectory_path)} if moved else {}
    flags = report.flags if swing is None else further(report.flags, swing.flags)
    said |= {} if swing is None else record(swing, settle_within_m="within_m", settling="via_points")
    with together():
        if report_path is not None:
            from armflex.show.report import write_report
            from armflex.show.report.checked import CheckedPath

            doing("drawing")
            read = {"arm": click.get_current_context().params["arm_path"], "path": trajectory_path}
            read |= {} if desired_path is None else {"desired path": desired_path}
            files = {name: str(path) for name, path in read.items()}
            asked = arm, trajectory, report, within or report.tolerance_m, how["covariates"], files, swing
            write_report(CheckedPath(*asked), report_path)
        options.conclude(lambda: said, flags, arm)
    meant = "" if desired_path is None else f"; against the rigid tip on {desired_path}"
    say(f"base {arm.robot.base}, tip {arm.robot.tip}{meant}", "")
    print_check(report, "off by" if moved else "moves")
    if swing is not None:
        print_settling(swing)
    say_written(report_path)
    return 0 if report.ok else 1


def print_check(report: CheckReport, moves: str = "moves") -> None:
    """Print the via-points, worst first, and the worst of the path."""
    asked, by_row = report.asked, report.by_row
    columns = ["via-point", "time s", "payload", f"{moves} mm", "± mm", "margin mm", "turns mrad", "verdict", "cause"]
    if report.angle_rad is not None:
        columns.insert(7, "margin mrad")
    if by_row:
        columns.insert(5, "allowed mm")
    if report.via_points:
        rows = [_row(point, point.name, by_row) for point in report.via_points]
        print_table(f"Via-points against {asked}, worst first", columns, rows)
    else:
        say(no_via_points("the first, the worst and the last"), "")
        worst = min(report.rows, key=lambda point: point.badness)
        named = {"first": report.rows[0], "worst row": worst, "last": report.rows[-1]}
        rows = [_row(point, name, by_row) for name, point in named.items()]
        print_table(f"Rows against {asked}", ["row", *columns[1:]], rows)
    print_table(
        "Worst of the whole path", columns, [_row(report.path_worst, report.path_worst.name or "between", by_row)]
    )
    for point in dict.fromkeys([*report.via_points, report.path_worst]):
        if point.reason:
            say(f"{point.name or 'between'} at {point.time:g} s: {point.reason}")
    worst, relative = report.path_worst.sigma_m, report.relative_sigma_m
    if worst is not None and relative is not None and 2.0 * relative < worst:
        text = "± is of the tip in the base frame; that of the campaign's target before its instrument is up to"
        say(f"{text} {plus_minus(relative)} mm. The rest is where base and target stand, the same for all rows.")
    failed = report.path_worst.verdict == "fail"
    verdict = "within tolerance" if report.ok else f"NOT {'' if failed else 'certain to be '}within tolerance"
    say(f"The path is {verdict} ({report.samples} configurations evaluated).")


def print_settling(report: SettlingReport) -> None:
    """Print a line for every via-point: how long the tip swings there, how far, and which mode is the slowest."""
    rows = []
    for point in report.via_points:
        slowest = "none" if point.frequency_hz is None else number(point.frequency_hz, 3)
        peak, name = number(point.peak_m * 1e3, 3), point.name or "last row"
        rows.append([name, f"{point.time:g}", number(point.settle_s, 3), peak, slowest, point.flexure or "none"])
    columns = ["via-point", "time s", "settles in s", "peak mm", "slowest mode Hz", "flexure"]
    print_table(f"Swing until within {report.within_m * 1e3:g} mm, if the drives stop there", columns, rows)


def _row(point: Point, name: str, by_row: bool) -> list[str]:
    return [
        name,
        f"{point.time:g}",
        point.payload,
        number(point.displacement_m * 1e3),
        plus_minus(point.sigma_m),
        *([number(point.tolerance_m * 1e3)] if by_row else []),
        number(point.margin_m * 1e3, 3),
        number(point.rotation_rad * 1e3, 3),
        *([] if point.margin_rad is None else [number(point.margin_rad * 1e3, 3)]),
        point.verdict,
        point.cause or "none",
    ]
