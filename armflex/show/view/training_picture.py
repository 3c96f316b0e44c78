"""What `train` learned, drawn: the law, its band and posterior, what is left, and held-out against training error."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from armflex.bench.fitted import NOWHERE, predicted, stated_std, wrenches
from armflex.bench.training import TrainResult
from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.laws import Law
from armflex.measured.joint_data import JointData
from armflex.plotting import check_ending, picture
from armflex.show.view.law_curves import NORMAL_95

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DRAWS = 200
"""Laws drawn from the posterior for the picture of its slopes."""

CURVES = 25
"""Of these, how many are drawn as curves."""

WIDTH = 16
"""Letters of a model's name below one bar."""


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
    told = bool(np.isfinite(std).all()) and bool(std.any())
    draws = [law.draw(rng) for _ in range(DRAWS)] if told else []
    with picture(path, 11.0, 2.3 * size + 2.6, dpi=110.0) as figure:
        parts: Any = figure.subfigures(2, 1, height_ratios=[2.3 * size, 2.6])
        upper, lower = parts
        for column, (shown, rest, slopes) in enumerate(upper.subplots(size, 3, squeeze=False)):
            name, unit, factor = TWIST_NAMES[column], data.units[column], data.factors[column]
            component = _strongest(law, data, column)
            loads = np.tile(middle, (61, 1))
            loads[:, component] = np.linspace(data.loads[:, component].min(), data.loads[:, component].max(), 61)
            x, load = _thousands(loads[:, component], component)
            at, y = _thousands(data.loads[:, component], component)[0], predicted(law, loads)[:, column] / factor
            if told:
                half = NORMAL_95 * stated_std(law, loads)[:, column] / factor
                shown.fill_between(x, y - half, y + half, color="C0", alpha=0.2, lw=0, label="95 % band")
                for i, one in enumerate(draws[:CURVES]):
                    drawn = predicted(one, loads)[:, column] / factor
                    shown.plot(x, drawn, color="C1", lw=0.5, alpha=0.5, label="posterior" if i == 0 else None)
            shown.plot(x, y, color="C0", lw=1.6, label="law")
            points = np.interp(at, x, y) + left[:, column]
            shown.plot(at, points, ".", color="0.2", ms=4, label="rows, other loads taken off")
            shown.set(xlabel=f"{WRENCH_NAMES[component]} [{load}]", ylabel=f"{name} [{unit}]")
            rows = np.arange(1, len(data) + 1)
            if told:
                half = NORMAL_95 * std[:, column]
                rest.errorbar(rows, np.zeros(len(rows)), half, fmt="none", ecolor="C0", alpha=0.4)
            rest.axhline(0.0, color="0.6", lw=0.8)
            rest.plot(rows, left[:, column], ".", color="0.2", ms=4)
            rest.set(xlabel="row", ylabel=f"residual of {name} [{unit}]")
            _posterior(slopes, law, draws, wrenches(middle[None])[0], column, component)
        first = upper.axes[0]
        upper.legend(*first.get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
        axes = lower.subplots()
        own = result.trained.model
        bars = [(f"{own}\ntraining", result.train_rms), (f"{own}\nheld out", result.held_out_rms)]
        bars += [(f"{fill(name, WIDTH)}\nheld out", rms) for name, rms in result.compared if len(result.compared) > 1]
        place, width = np.arange(len(bars)), 0.8 / size
        for column in range(size):
            values = [rms[column] for _, rms in bars]
            label = f"{TWIST_NAMES[column]} [{data.units[column]}]"
            axes.bar(place + (column - (size - 1) / 2) * width, values, width, label=label)
        axes.set_xticks(place, [name for name, _ in bars], fontsize=8)
        axes.set(ylabel="RMS", title=f"Training and held-out error ({result.held_out})")
        axes.legend(frameon=False, fontsize=8)
    return path


def _strongest(law: Law, data: JointData, column: int) -> int:
    """Return the load component along which a column changes most over the rows."""
    middle, changes = data.loads.mean(axis=0), []
    for component in range(data.size):
        ends = np.tile(middle, (2, 1))
        ends[:, component] = data.loads[:, component].min(), data.loads[:, component].max()
        changes.append(abs(float(np.diff(predicted(law, ends)[:, column])[0])))
    return int(np.argmax(changes))


def _thousands(loads: Array, component: int) -> tuple[Array, str]:
    unit = "N" if component < 3 else "Nm"
    return (loads / 1e3, f"k{unit}") if np.abs(loads).max(initial=0.0) >= 5e3 else (loads, unit)


def _posterior(axes: Axes, law: Law, draws: Sequence[Law], load: Array, column: int, component: int) -> None:
    """Draw how sure the slope of a column along a load is."""
    unit = f"{'m' if column < 3 else 'rad'}/{'N' if component < 3 else 'Nm'}"
    title = f"slope {TWIST_NAMES[column]} per {WRENCH_NAMES[component]} [{unit}]"
    slope = float(law.tangent(load, NOWHERE)[column, component])
    axes.axvline(slope, color="C0", lw=1.6)
    values = np.array([one.tangent(load, NOWHERE)[column, component] for one in draws])
    if len(values) and np.ptp(values) > 0.0:
        axes.hist(values, bins=24, color="C1", alpha=0.6)
    else:
        axes.text(0.5, 0.5, "no uncertainty stated", transform=axes.transAxes, ha="center")
    axes.set(xlabel=title, yticks=[])
