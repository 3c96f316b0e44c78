"""Learned laws as pictures: a twist over its loads, with its band; what `train` learned, and what is left over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.bench.fitted import NOWHERE, predicted, stated_std, wrenches
from armflex.bench.training import TrainResult
from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.errors import InputError, ShapeError, UnknownNameError
from armflex.laws import Law
from armflex.laws.law import Row, anywhere
from armflex.laws.learned import LearnedLaw
from armflex.measured.joint_data import JointData
from armflex.plotting import check_ending, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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

    # How far beyond the observed loads the picture goes, as a part of their range.
    def loads(self, beyond: float = 0.3) -> Array:
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
    path, curves = Path(path), dict(points or {})
    check_ending(path)
    lines = _lines(arm)
    names = list(dict.fromkeys(section.name for line in lines for section in line))
    for name, pair in curves.items():
        if name not in names:
            raise UnknownNameError("learned flexure", name, names)
        for what, values in zip(("loads", "twists"), pair, strict=True):
            if np.ndim(values) != 2 or np.shape(values)[1] != 6 or len(values) != len(pair[0]):
                raise ShapeError(f"{what} of {name}", "(M, 6)", np.shape(values))
    with picture(path, 10.8, 2.5 * len(lines) + 0.5, dpi=110.0) as figure:
        places = figure.subplots(len(lines), 3, squeeze=False)
        for panels, line in zip(places, lines, strict=True):
            for axes in panels[[place not in [section.axis % 3 for section in line] for place in range(3)]]:
                axes.set_axis_off()
            for section in line:
                _draw(panels[section.axis % 3], section, curves.get(section.name))
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
                    [max(slices, key=lambda along: float(np.ptp(along.twist(along.loads(0.0))))) for slices in every]
                )
    if not lines:
        raise InputError("no law of this arm was learned: put learn = true at a flexure, then calibrate")
    return lines


def _draw(axes: Axes, section: Slice, points: Curve | None) -> None:
    unit, scale = "mm" if section.axis < 3 else "mrad", 1e3
    loads, kind, per = section.loads(), "N" if section.component < 3 else "Nm", 1.0
    if np.abs(section.law.seen.loads[:, section.component]).max() >= 5e3:  # in thousands where loads are large
        kind, per = f"k{kind}", 1e-3
    x, y, band = per * loads[:, section.component], scale * section.twist(loads), section.band(loads)
    if points is not None:
        given, twists = (np.asarray(values, float) for values in points)
        at = np.interp(given[:, section.component], loads[:, section.component], y, np.nan, np.nan)
        error = scale * (twists[:, section.axis] - section.twist(given))
        along = per * given[:, section.component]
        axes.plot(along, at + error, ".", color="0.25", ms=2.5, zorder=3, label="known points")
    if band is not None:
        axes.fill_between(x, y - scale * band, y + scale * band, color="C0", alpha=0.25, lw=0, label="95 % band")
    axes.plot(x, scale * section.declared(loads), "--", color="C3", lw=1.2, label="declared")
    axes.plot(x, y, color="C0", lw=1.8, label="learned")
    low, high = per * section.law.seen.loads[:, section.component]
    axes.axvspan(x[0], low, color="0.92", zorder=0, lw=0, label="no observed load")
    axes.axvspan(high, x[-1], color="0.92", zorder=0, lw=0)
    axes.set(xlim=(x[0], x[-1]), xlabel=f"{WRENCH_NAMES[section.component]} [{kind}]")
    axes.set_ylabel(f"{TWIST_NAMES[section.axis]} [{unit}]")
    axes.set_title(section.name, loc="left", fontsize=10)
    axes.grid(alpha=0.3)


DRAWS = 200
"""Laws drawn from the posterior for the picture of its slopes."""


def _along(loads: Array, component: int, count: int) -> Array:
    """Return (count, k) loads from the least to the most of a component, the others at their means."""
    line = np.tile(loads.mean(axis=0), (count, 1))
    line[:, component] = np.linspace(loads[:, component].min(), loads[:, component].max(), count)
    return line


def draw_training(result: TrainResult, data: JointData, path: str | Path) -> Path:
    """Write a picture of a trained law: a row of panels for each deflection column, in the file's units.

    Left: the law over the load that changes it most, the others at their means, with its 95 % band, laws drawn from
    its posterior, and the rows with what their other loads do taken off (partial residuals). Middle: what is left of
    every row, training, against the band. Right: the posterior of the slope at the mean load. Below: held-out against
    training error, of every model that was compared.

    Args:
        result: What `train` returned.
        data: The rows that it was given.
        path: Ends in .png, .pdf or .svg.

    Raises:
        InputError: The path ends otherwise.
        FileError: It cannot be written.
    """
    check_ending(path := Path(path))
    law, size = result.trained.law, data.size
    middle, rng = data.loads.mean(axis=0), np.random.default_rng(0)
    left = (data.deflections - predicted(law, data.loads)) / data.factors
    std = stated_std(law, data.loads) / data.factors
    uncertain = bool(np.isfinite(std).all()) and bool(std.any())
    draws = [law.draw(rng) for _ in range(DRAWS)] if uncertain else []
    with picture(path, 11.0, 2.3 * size + 2.6, dpi=110.0) as figure:
        parts: Any = figure.subfigures(2, 1, height_ratios=[2.3 * size, 2.6])
        upper, lower = parts
        for column, (shown, rest, slopes) in enumerate(upper.subplots(size, 3, squeeze=False)):
            name, unit, factor = TWIST_NAMES[column], data.units[column], data.factors[column]
            # The load that changes the column most over the rows.
            ends = [predicted(law, _along(data.loads, axis, 2))[:, column] for axis in range(size)]
            component = int(np.argmax(np.abs(np.diff(ends))))
            loads = _along(data.loads, component, 61)
            x, load = _thousands(loads[:, component], component)
            at, y = _thousands(data.loads[:, component], component)[0], predicted(law, loads)[:, column] / factor
            if uncertain:
                half = NORMAL_95 * stated_std(law, loads)[:, column] / factor
                shown.fill_between(x, y - half, y + half, color="C0", alpha=0.2, lw=0, label="95 % band")
                for i, drawn_law in enumerate(draws[:25]):  # of these, how many are drawn as curves
                    drawn = predicted(drawn_law, loads)[:, column] / factor
                    shown.plot(x, drawn, color="C1", lw=0.5, alpha=0.5, label="posterior" if i == 0 else None)
            shown.plot(x, y, color="C0", lw=1.6, label="law")
            points = np.interp(at, x, y) + left[:, column]
            shown.plot(at, points, ".", color="0.2", ms=4, label="rows, other loads taken off")
            shown.set(xlabel=f"{WRENCH_NAMES[component]} [{load}]", ylabel=f"{name} [{unit}]")
            rows = np.arange(1, len(data) + 1)
            if uncertain:
                half = NORMAL_95 * std[:, column]
                rest.errorbar(rows, np.zeros(len(rows)), half, fmt="none", ecolor="C0", alpha=0.4)
            rest.axhline(0.0, color="0.6", lw=0.8)
            rest.plot(rows, left[:, column], ".", color="0.2", ms=4)
            rest.set(xlabel="row", ylabel=f"residual of {name} [{unit}]")
            _posterior(slopes, law, draws, wrenches(middle[None])[0], column, component)
        first = upper.axes[0]
        upper.legend(*first.get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
        _errors(lower.subplots(), result, data)
    return path


def _errors(axes: Axes, result: TrainResult, data: JointData) -> None:
    """Draw held-out against training error, of every model that was compared."""
    trained_as, size = result.trained.model, data.size
    bars = [(f"{trained_as}\ntraining", result.train_rms), (f"{trained_as}\nheld out", result.held_out_rms)]
    # Letters of a model's name below one bar.
    bars += [(f"{fill(name, 16)}\nheld out", rms) for name, rms in result.compared if len(result.compared) > 1]
    place, width = np.arange(len(bars)), 0.8 / size
    for column in range(size):
        values = [rms[column] for _, rms in bars]
        label = f"{TWIST_NAMES[column]} [{data.units[column]}]"
        axes.bar(place + (column - (size - 1) / 2) * width, values, width, label=label)
    axes.set_xticks(place, [name for name, _ in bars], fontsize=8)
    axes.set(ylabel="RMS", title=f"Training and held-out error ({result.held_out})")
    axes.legend(frameon=False, fontsize=8)


def _thousands(loads: Array, component: int) -> tuple[Array, str]:
    unit = "N" if component < 3 else "Nm"
    return (loads / 1e3, f"k{unit}") if np.abs(loads).max(initial=0.0) >= 5e3 else (loads, unit)


def _posterior(axes: Axes, law: Law, draws: Sequence[Law], load: Array, column: int, component: int) -> None:
    """Draw how sure the slope of a column along a load is."""
    unit = f"{'m' if column < 3 else 'rad'}/{'N' if component < 3 else 'Nm'}"
    title = f"slope {TWIST_NAMES[column]} per {WRENCH_NAMES[component]} [{unit}]"
    slope = float(law.tangent(load, NOWHERE)[column, component])
    axes.axvline(slope, color="C0", lw=1.6)
    values = np.array([drawn.tangent(load, NOWHERE)[column, component] for drawn in draws])
    if len(values) and np.ptp(values) > 0.0:
        axes.hist(values, bins=24, color="C1", alpha=0.6)
    else:
        axes.text(0.5, 0.5, "no uncertainty stated", transform=axes.transAxes, ha="center")
    axes.set(xlabel=title, yticks=[])
