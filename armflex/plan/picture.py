"""A plan as a picture: certainty against readings, and where the tip's place is well known, before and after."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from armflex.arguments import checked_kinds
from armflex.plan.design import TOptimal
from armflex.plotting import picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armflex.plan.planned_rows import Plan


@checked_kinds
def draw_plan(planned: Plan, path: str | Path) -> Path:
    """Write a picture of a plan.

    Args:
        planned: The plan.
        path: Ends in .png, .pdf or .svg.

    Raises:
        InputError: The path ends otherwise.
        FileError: It cannot be written.
    """
    path = Path(path)
    with picture(path, 15.0, 5.0) as figure:
        from matplotlib.colors import LogNorm

        curve, *maps = figure.subplots(1, 3, width_ratios=(1.1, 1.0, 1.0))
        _draw_curve(curve, planned)
        uncertainty = {title: values * 1e3 for title, values in planned.uncertainty.items()}
        every = np.concatenate(list(uncertainty.values()))
        norm = LogNorm(float(np.quantile(every, 0.01)), float(np.quantile(every, 0.99)))
        tip = planned.offered.view.line.tip[:, :3, 3]
        around = np.hypot(tip[:, 0], tip[:, 1]), tip[:, 2]  # the mean where the tip is, all around the base's z axis
        for axes, (title, values) in zip(maps, uncertainty.items(), strict=True):
            # Cells across a map
            marks = axes.hexbin(*around, values, gridsize=22, norm=norm, cmap="viridis_r", linewidths=0.2)
            axes.set(title=title, xlabel="distance from the base's z axis [m]", aspect="equal")
        maps[0].set_ylabel("z [m]")
        arm = planned.reach.arm
        tips = [arm.rigid_pose(q, enforce_limits=False).translation for q in planned.rows.q[planned.rows.measured]]
        read = np.hypot(*np.array(tips)[:, :2].T), np.array(tips)[:, 2]
        maps[1].plot(*read, "o", mfc="none", mec="crimson", ms=6)
        maps[1].set_title(f"{maps[1].get_title()} (circles)")
        for axes in maps:
            axes.update_datalim(np.transpose(read))
            axes.margins(0.05)  # room beside what a map shows, as a share of its width or height
            axes.autoscale_view()
        text = "standard deviation of what would be read, 3-D [mm]"
        _plain(figure.colorbar(marks, ax=maps, label=text, extend="both").ax)
    return path


def _draw_curve(axes: Axes, planned: Plan) -> None:
    """Draw what is reached after each reading, planned and at random."""
    shown = planned.goal.shown
    at_random = np.sort(shown(planned.random), axis=0)
    count = np.arange(at_random.shape[1])
    axes.fill_between(count, at_random[0], at_random[-1], color="0.85", label=f"random, {len(at_random)} draws")
    axes.plot(count, shown(planned.random.mean(axis=0)), color="0.5", label="random, mean")
    axes.plot(np.arange(len(planned.reached)), shown(planned.reached), color="crimson", marker=".", label="planned")
    if planned.random_rows is not None:
        end = float(shown(planned.reached[-1]))
        axes.plot([len(planned.worth), planned.random_rows], [end, end], ":", color="crimson")
    axes.set(xlabel="readings", ylabel=planned.goal.title, xlim=(0, count[-1]))
    if not isinstance(planned.goal, TOptimal):
        drawn = np.concatenate([np.asarray(shown(planned.reached))[3:], at_random[:, 3:].ravel()])
        axes.set_yscale("log")
        _plain(axes)
        axes.set_ylim(0.9 * drawn.min(), 1.1 * drawn.max())
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3, which="both")


def _plain(axes: Axes) -> None:
    """Write the numbers of a logarithmic scale as they are, not as powers of ten."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
    axes.yaxis.set_major_formatter("{x:.3g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
