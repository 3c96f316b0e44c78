"""armflex plan: what to measure next."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from armflex.cli import options
from armflex.cli.options import InputPath, OutputPath, Quantity
from armflex.cli.terminal import number, print_table, progress, say, say_written
from armflex.errors import InputError
from armflex.estimate.identify import about_zeros
from armflex.files.arm_file import load_arm
from armflex.files.dh_table import in_dh_words
from armflex.measured.measurements import read_measurements
from armflex.measured.points import PointExport
from armflex.parameters import OF_SESSION, ParameterKind
from armflex.plan.drive import write_plan
from armflex.plan.instruments import declaration
from armflex.plan.planning import plan
from armflex.plotting import check_ending
from armflex.storage.whole_file import together
from armflex.trajectory import read_trajectory

if TYPE_CHECKING:
    from armflex.plan.planned_rows import Plan


@click.command(cls=options.Command)
@click.argument("arm_path", metavar="ARM", type=InputPath)
@click.option("-o", "--output", required=True, type=OutputPath(), help="Rows to measure, with x y z to be filled in.")
@click.option("--rows", type=int, default=20, show_default=True, help="Positions that will be read.")
@click.option("--after", "after_path", type=InputPath, metavar="MEAS.csv", help="Campaign that was measured already.")
@click.option("--along", "along_path", type=InputPath, metavar="TRAJ.csv", help="Minimise uncertainty along this path.")
@click.option("--between", metavar="E1,E2,...",
              help="Distinguish two effects or more, each LAW:SITE[:AXIS[:PARTNER]] as trace's JSON and [[effect]] "
                   "have them: backlash:A2:ry,encoder_offset:A2")  # fmt: skip
@click.option("--instruments", metavar="wire,level",
              help="What is read: names that ARM declares, or wire, level, accelerometer, encoder, target, whose "
                   "best place is chosen, and tracker.")  # fmt: skip
@click.option("--payload", "payloads", metavar="A,B", help="Payloads that may be carried [default: all payloads].")
@options.settable
@click.option("--sigma", type=Quantity("length"), metavar="0.2mm",
              help="Noise of a position reading [default: that of MEAS.csv, else 0.2mm].")  # fmt: skip
@click.option("--floor", type=Quantity("length"), metavar="-0.8m",
              help="Lowest height of any link, target or payload in the base frame; that of the base where left out, "
                   "unless the arm hangs below it.")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the candidate rows.")
@options.points
@options.lax
@click.option("--picture", type=OutputPath(), metavar="PLAN.png", help="Draw certainty against readings, and where.")
def command(
    arm_path: Path,
    output: Path,
    rows: int,
    after_path: Path | None,
    along_path: Path | None,
    between: str | None,
    instruments: str | None,
    payloads: str | None,
    covariates: dict[str, list[float]],
    picture: Path | None,
    lax: bool,
    points: PointExport | None,
    **given: Any,
) -> None:
    """The rows to measure next, in the order to drive them, and what they will determine.

    They minimise the uncertainty of what [prior] frees or of predictions --along a path, or distinguish effects
    (--between). Stops whose pose begins with 'to ' are driven to and not read.
    """
    if picture is not None:
        check_ending(picture)  # before minutes of work
    if arm_path.suffix != ".toml":
        raise InputError(f"{arm_path}: plan needs an arm.toml, whose [prior] says what is not known")
    if points is not None and after_path is None:
        raise InputError("--points needs --after: it has the positions of that campaign")
    arm = load_arm(arm_path, strict=not lax)
    asked = {
        "after": None if after_path is None else read_measurements(after_path, arm, points=points),
        "along": None if along_path is None else read_trajectory(along_path, arm),
        "between": None if between is None else tuple(part.strip() for part in between.split(",")),
        "payloads": None if payloads is None else [name.strip() for name in payloads.split(",")],
        "covariates": covariates,
        "instruments": None if instruments is None else [name.strip() for name in instruments.split(",")],
    }
    if between is not None and (len(asked["between"]) < 2 or not all(asked["between"])):
        raise InputError(f"--between: {between!r} is not of the form E1,E2, such as backlash:A2,friction_windup:A2")
    with progress("planning") as tick:
        planned = plan(arm, rows, progress=tick, **asked, **given)
    with together():
        write_plan(planned, output)
        if picture is not None:
            from armflex.plan.picture import draw_plan

            draw_plan(planned, picture)
        options.conclude(planned.content, planned.flags)
    print_plan(planned)
    say_written(output, picture)


def print_plan(planned: Plan) -> None:
    """Print what will be reached, against poses at random, which parameters gain most, and what stays undetermined."""
    count, stops = len(planned.worth), len(planned.rows)
    before, after = (planned.figure(value) for value in planned.reached[[0, -1]])
    run_ups = f", and {stops - count} stops to come from the right side" if stops > count else ""
    by = "" if "" in planned.reach.read else f" by {', '.join(planned.reach.read)}"
    noise = "" if by else f"; noise {number(float(planned.reach.sigma.max()) * 1e3, 2)} mm"
    say(f"{count} rows to read{run_ups}{by}{noise}")
    if planned.random_rows is None:
        reached = planned.figure(planned.random.mean(axis=0)[-1])
        at_random = f"{planned.random.shape[1] - 1} poses at random reach {reached}"
    else:
        at_random = f"as much as {planned.random_rows} poses at random"
    say(f"{planned.goal.title}: now {before}, after the rows {after}; {at_random}")
    for mount in planned.mounts:
        others = ", ".join(f"{name} {value:.3g}" for name, value in mount.others[:3])
        text = f"{mount.sensor.name}: rows at random reach {mount.reached:.3g} with it, {mount.without:.3g} without"
        say(text + (f" (elsewhere: {others})" if others else ""))
        say(*declaration(mount.sensor).splitlines())
    left = sum(planned.offered.dropped.values())
    if left:
        reasons = ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in planned.offered.dropped.items())
        say(f"Of {left + len(planned.offered.rows)} rows offered {left} were excluded: {reasons}.")
    for hypothesis in planned.hypotheses:
        named = zip(hypothesis.candidate.labels, hypothesis.size, hypothesis.candidate.units, strict=True)
        sizes = ", ".join(f"{label} {value:.3g} {unit}" for label, value, unit in named if value)
        say(f"{hypothesis.name} {sizes}, {hypothesis.source}")
    # Where instruments stand is no gain.
    places = (ParameterKind.INSTRUMENT, *OF_SESSION, ParameterKind.SENSOR)
    others = {parameter.label for parameter in planned.model.parameters if parameter.group.kind in places}
    gaining = [row for row in planned.certainties if row["name"] not in others and not planned.hypotheses]
    # Parameters that are shown on the terminal; --json has all
    gaining = sorted(gaining, key=lambda p: p["after"] / p["before"])[:10]
    words, rows = in_dh_words(planned.reach.arm.robot), []
    for row in gaining:  # those of unit 1 are logarithms of factors, or shares
        unit, times = ("%", 100.0) if row["unit"] == "1" else (row["unit"], 1.0)
        stds = (number(times * row[when], 3, 0.0) for when in ("before", "after"))
        rows.append([words.get(row["name"], (row["name"],))[0], *stds, unit])
    if rows:
        print_table("Expected to become more certain, most first", ["parameter", "± now", "± after", "unit"], rows)
        say(*about_zeros(planned.model.parameters))
    say(*planned.advice)
