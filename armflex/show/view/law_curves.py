"""Laws that were learned as a picture: every joint's twist over the observed loads, with its band."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.errors import InputError, ShapeError, UnknownNameError
from armflex.laws.law import Row, anywhere
from armflex.laws.learned import LearnedLaw
from armflex.plotting import check_ending, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BEYOND = 0.3
"""How far beyond the observed loads the picture goes, as a part of their range."""

STEPS = 241
NORMAL_95 = 1.96
Curve = tuple[Array, Array]
"""(M, 6) loads on a flexure [N, Nm] and (M, 6) its twists under them [m, rad]."""


@dataclass(frozen=True)
class Slice:
    """A learned law along one component of the load, the others at their mean.

    Attributes:
        name: Of the flexure.
        law: Its law.
        row: Joint positions: the middle of every travel.
        axis: Of the twist, 0 to 5.
        component: Of the load, 0 to 5: the one that turns this axis most within the observed loads.
    """

    name: str
    law: LearnedLaw
    row: Row
    axis: int
    component: int

    def loads(self, beyond: float = BEYOND) -> Array:
        """Return (n, 6) loads along the component, from below the smallest that was seen to above the largest."""
        low, high = self.law.seen.loads[:, self.component]
        loads = np.tile(self.law.seen.mean, (STEPS, 1))
        loads[:, self.component] = np.linspace(low - beyond * (high - low), high + beyond * (high - low), STEPS)
        return loads

    def twist(self, loads: Array) -> Array:
        """Return the (n,) learned twist."""
        return self.law.twist(loads, self.row)[:, self.axis]

    def declared(self, loads: Array) -> Array:
        """Return the (n,) twist as it was declared."""
        return self.law.at(self.law.start).twist(loads, self.row)[:, self.axis]

    def band(self, loads: Array) -> Array | None:
        """Return half the (n,) width of the 95 % band, None where nobody says how well the law is known."""
        covariance = self.law.covariance(loads, self.row)
        return None if covariance is None else NORMAL_95 * np.sqrt(covariance[:, self.axis, self.axis])


@checked_kinds
def draw_laws(arm: Arm, path: str | Path, points: Mapping[str, Curve] | None = None) -> Path:
    """Write a picture of every learned law, a panel for each axis in which a flexure gives.

    A panel shows the twist over the load component that changes it most; the other components stay at the mean of
    those seen, joints in the middle of their travel. Grey is where no load was seen.

    Args:
        arm: A calibrated arm, see `calibrate`.
        path: Ends in .png, .pdf or .svg.
        points: Known loads and twists of flexures by name, from a test bench say. What the other components do at a
            point is taken off it as the law says (a partial residual), so its distance from the curve is the law's
            error under the point's own load.

    Raises:
        InputError: The path ends otherwise, or no law of the arm was learned.
        UnknownNameError: `points` names no learned flexure.
        ShapeError: They are not (M, 6) each.
        FileError: It cannot be written.
    """
    path, known = Path(path), dict(points or {})
    check_ending(path)
    lines = _lines(arm)
    names = list(dict.fromkeys(one.name for line in lines for one in line))
    for name, pair in known.items():
        if name not in names:
            raise UnknownNameError("learned flexure", name, names)
        for what, values in zip(("loads", "twists"), pair, strict=True):
            if np.ndim(values) != 2 or np.shape(values)[1] != 6 or len(values) != len(pair[0]):
                raise ShapeError(f"{what} of {name}", "(M, 6)", np.shape(values))
    with picture(path, 10.8, 2.5 * len(lines) + 0.5, dpi=110.0) as figure:
        places = figure.subplots(len(lines), 3, squeeze=False)
        for panels, line in zip(places, lines, strict=True):
            for axes in panels[[place not in [one.axis % 3 for one in line] for place in range(3)]]:
                axes.set_axis_off()
            for one in line:
                _draw(panels[one.axis % 3], one, known.get(one.name))
        shown = {
            name: handle for axes in places.flat for handle, name in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=len(shown), frameon=False)
    return path


def _lines(arm: Arm) -> list[list[Slice]]:
    """Return the slices of every flexure that was learned: of the rotations in which it gives, then of the shifts."""
    row, lines = anywhere(arm.robot), []
    for flexure in arm.flexures:
        if (law := flexure.learned) is None:
            continue
        for axes in (range(3, 6), range(3)):
            giving = [axis for axis in axes if law.seen.twist_scale[axis] > 0.0]
            every = [[Slice(flexure.name, law, row, axis, load) for load in range(6)] for axis in giving]
            if giving:
                lines.append(
                    [max(one, key=lambda along: float(np.ptp(along.twist(along.loads(0.0))))) for one in every]
                )
    if not lines:
        raise InputError("no law of this arm was learned: put learn = true at a flexure, then calibrate")
    return lines


def _draw(axes: Axes, one: Slice, points: Curve | None) -> None:
    unit, scale = "mm" if one.axis < 3 else "mrad", 1e3
    loads, kind, per = one.loads(), "N" if one.component < 3 else "Nm", 1.0
    if np.abs(one.law.seen.loads[:, one.component]).max() >= 5e3:  # in thousands where loads are large
        kind, per = f"k{kind}", 1e-3
    x, y, band = per * loads[:, one.component], scale * one.twist(loads), one.band(loads)
    if points is not None:
        given, twists = (np.asarray(values, float) for values in points)
        at = np.interp(given[:, one.component], loads[:, one.component], y, np.nan, np.nan)
        error = scale * (twists[:, one.axis] - one.twist(given))
        axes.plot(per * given[:, one.component], at + error, ".", color="0.25", ms=2.5, zorder=3, label="known points")
    if band is not None:
        axes.fill_between(x, y - scale * band, y + scale * band, color="C0", alpha=0.25, lw=0, label="95 % band")
    axes.plot(x, scale * one.declared(loads), "--", color="C3", lw=1.2, label="declared")
    axes.plot(x, y, color="C0", lw=1.8, label="learned")
    low, high = per * one.law.seen.loads[:, one.component]
    axes.axvspan(x[0], low, color="0.92", zorder=0, lw=0, label="no observed load")
    axes.axvspan(high, x[-1], color="0.92", zorder=0, lw=0)
    axes.set(xlim=(x[0], x[-1]), xlabel=f"{WRENCH_NAMES[one.component]} [{kind}]")
    axes.set_ylabel(f"{TWIST_NAMES[one.axis]} [{unit}]")
    axes.set_title(one.name, loc="left", fontsize=10)
    axes.grid(alpha=0.3)
