"""What the page of a machine's history shows: a table of what changed, and every parameter over the dates."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

from armflex.conventions import SHOWN
from armflex.estimate.calibrations import Course, History
from armflex.show.report.svg import AFTER, BEFORE, MARK, canvas, cut, grid, inline
from armflex.show.report.words import measure

MOST = 24
"""Parameters that the figure has room for."""


def account(found: History, labels: Sequence[str]) -> SimpleNamespace:
    """Return what the template shows."""
    changed, count = found.changed, len(found.names)
    what = f"{len(changed)} of {len(found.courses)} parameters changed" if changed else "Nothing changed"
    some = found.courses[:MOST]
    more = f" The first {MOST} of {len(found.courses)} are drawn." if len(found.courses) > MOST else ""
    return SimpleNamespace(
        title=f"One machine over {count} calibrations",
        headline=f"{what} between {labels[0]} and {labels[-1]}.",
        changes=tuple(
            (
                one.parameter.label,
                one.change,
                f"since {labels[one.since]}" if one.since else "all along",
                measure(one.size, one.size_std, one.parameter.unit),
            )
            for one in changed
        ),
        courses=_drawn(some, found, labels),
        caption=f"Bars: two standard uncertainties. Those that changed stand first, a jump with a dashed line.{more}",
    )


def _drawn(some: Sequence[Course], found: History, labels: Sequence[str]) -> str:
    rows = (len(some) + 2) // 3
    drawing, axes = canvas(10.0, 1.5 * rows + 0.4, rows, 3)
    for axis in axes[len(some) :]:
        axis.set_axis_off()
    for axis, one in zip(axes, some, strict=False):
        unit, factor = SHOWN.get(one.parameter.unit, (one.parameter.unit, 1.0))
        colour = AFTER if one.change else BEFORE
        bars = 2.0 * factor * one.std
        axis.errorbar(found.dates, factor * one.value, bars, fmt="o", color=colour, ecolor=colour, ms=3.0, lw=1.0)
        if one.since:
            axis.axvline(0.5 * float(found.dates[one.since - 1] + found.dates[one.since]), color=MARK, ls="--", lw=1.0)
        axis.set_title(cut(f"{one.parameter.label} [{unit}]" + (f": {one.change}" if one.change else ""), 44))
        ends = [0, len(labels) - 1]
        axis.set_xticks([float(found.dates[i]) for i in ends], [cut(labels[i], 12) for i in ends])
        grid(axis, "y")
    return inline(drawing, "parameters over the dates")
