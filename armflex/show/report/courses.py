"""What the page of a machine's history shows: a table of what changed, and every parameter over the dates."""

from collections.abc import Sequence
from types import SimpleNamespace

from armflex.conventions import SHOWN
from armflex.estimate.calibrations import Course, History
from armflex.show.report.svg import AFTER, BEFORE, MARK, canvas, cut, grid, inline
from armflex.show.report.words import measure

MOST = 24
"""Parameters that the figure has room for."""


def account(history: History, labels: Sequence[str]) -> SimpleNamespace:
    """Return what the template shows."""
    changed, count = history.changed, len(history.names)
    what = f"{len(changed)} of {len(history.courses)} parameters changed" if changed else "Nothing changed"
    courses = history.courses[:MOST]
    more = f" The first {MOST} of {len(history.courses)} are drawn." if len(history.courses) > MOST else ""
    return SimpleNamespace(
        title=f"One machine over {count} calibrations",
        headline=f"{what} between {labels[0]} and {labels[-1]}.",
        changes=tuple(
            (
                course.parameter.label,
                course.change,
                f"since {labels[course.since]}" if course.since else "all along",
                measure(course.size, course.size_std, course.parameter.unit),
            )
            for course in changed
        ),
        courses=_drawn(courses, history, labels),
        caption=f"Bars: two standard uncertainties. Those that changed stand first, a jump with a dashed line.{more}",
    )


def _drawn(courses: Sequence[Course], history: History, labels: Sequence[str]) -> str:
    rows = (len(courses) + 2) // 3
    drawing, axes = canvas(10.0, 1.5 * rows + 0.4, rows, 3)
    for axis in axes[len(courses) :]:
        axis.set_axis_off()
    for axis, course in zip(axes, courses, strict=False):
        unit, factor = SHOWN.get(course.parameter.unit, (course.parameter.unit, 1.0))
        colour = AFTER if course.change else BEFORE
        bars = 2.0 * factor * course.std
        axis.errorbar(history.dates, factor * course.value, bars, fmt="o", color=colour, ecolor=colour, ms=3.0, lw=1.0)
        if course.since:
            before, after = history.dates[course.since - 1 : course.since + 1]
            axis.axvline(0.5 * float(before + after), color=MARK, ls="--", lw=1.0)
        axis.set_title(cut(f"{course.parameter.label} [{unit}]" + (f": {course.change}" if course.change else ""), 44))
        ends = [0, len(labels) - 1]
        axis.set_xticks([float(history.dates[i]) for i in ends], [cut(labels[i], 12) for i in ends])
        grid(axis, "y")
    return inline(drawing, "parameters over the dates")
