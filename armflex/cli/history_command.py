"""armflex history: one machine over several calibrations."""

import os
from datetime import date
from pathlib import Path

import click
import numpy as np

from armflex.cli import options
from armflex.cli.terminal import number, print_table, say, say_written
from armflex.errors import InputError
from armflex.estimate.calibrations import history
from armflex.files.arm_file import load_arm
from armflex.result import record
from armflex.storage.whole_file import together


@click.command(cls=options.Command)
@click.argument("paths", metavar="ARM.toml ...", nargs=-1, required=True, type=options.InputPath)
@click.option("--dates", metavar="2026-01-15,..",
              help="Dates of the calibrations, in their order; without it they are evenly spaced.")  # fmt: skip
@click.option("-o", "--output", type=options.OutputPath(), help="HTML page to write.")
def command(paths: tuple[Path, ...], dates: str | None, output: Path | None) -> None:
    """Say which parameters of one machine jumped or drifted between its calibrations, and since when.

    The files are calibrations of one declared arm, each with a campaign of its own, in the order of their dates.
    """
    if len({os.path.realpath(path) for path in paths}) < len(paths):
        raise InputError("an arm file is given twice: each calibration counts once")
    labels = [part.strip() for part in dates.split(",")] if dates else [path.stem for path in paths]
    try:
        days = [float(date.fromisoformat(label).toordinal()) for label in labels] if dates else range(len(paths))
    except ValueError:
        raise InputError(f"--dates: {dates!r} is not of the form 2026-01-15,2026-03-02,..") from None
    if len(labels) != len(paths):
        raise InputError(f"--dates: {len(labels)} dates for {len(paths)} files")
    courses = history({str(path): load_arm(path) for path in paths}, list(days))
    with together():
        options.write_json(
            {
                "format": "armflex-history-1",
                "dates": labels,
                "parameters": [
                    record(course, "value std", name="parameter.label", unit="parameter.unit")
                    | dict.fromkeys(("change", "size", "size_std"))
                    | (record(course, "change size size_std") if course.change else {})
                    | {"since": labels[course.since] if course.since else None}
                    for course in courses.courses
                ],
            }
        )
        if output is not None:
            from armflex.show.report import write_report  # draws

            write_report(courses, output, labels)
    rows = []
    for course in courses.changed:
        when, sizes = f"since {labels[course.since]}" if course.since else "all along", (course.size, course.size_std)
        cells = (number(size, digits) for size, digits in zip(sizes, (3, 2), strict=True))
        rows.append([course.parameter.label, course.change, when, *cells, course.parameter.unit])
    if rows:
        print_table("What changed", ["parameter", "how", "when", "by", "± std", "unit"], rows)
    else:
        over = f"{len(courses.courses)} parameters over {len(paths)} calibrations"
        say(f"Nothing changed beyond its uncertainty: {over}.")
    last = np.argsort(courses.dates)[-2:].tolist()
    for course, step, std in courses.between(*last) if len(paths) > 2 else ():
        text = f"{number(step, 3)} ± {number(std, 2)} {course.parameter.unit}"
        say(f"Between {labels[last[0]]} and {labels[last[1]]}: {course.parameter.label} by {text}.")
    say_written(output)
