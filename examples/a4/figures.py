"""Figures of the surrogate study: those of the paper's figures 4 to 9, and what it says about a network's size."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from a4.study import Trial, average, determined, precisions
from a4.surrogate import NOISE, Rows

from armflex.bench.cross_validation import BAND
from armflex.bench.fitted import predicted, stated_std
from armflex.laws.law import Law

matplotlib.use("Agg")
from matplotlib import pyplot

AXES = "xyz"
LINE, BAND_COLOUR, SQUARE = "#c0392b", "#f1948a", "#1f3a5f"


def deformation(path: Path, title: str, law: Law, rows: Rows, band: bool = False) -> None:
    """Draw measured squares and the model's line over the sample number, and beside them what is left."""
    canvas, grid = pyplot.subplots(3, 2, figsize=(11.0, 7.0), sharex=True, layout="constrained")
    line, number = 1e3 * predicted(law, rows.loads), np.arange(1, len(rows.loads) + 1)
    measured, wide = 1e3 * rows.measured, 1e3 * BAND * stated_std(law, rows.loads)
    for i, (left, right) in enumerate(grid):
        left.plot(number, line[:, i], color=LINE, lw=0.9, label="model")
        for axes, middle, points in ((left, line[:, i], measured[:, i]), (right, 0.0, measured[:, i] - line[:, i])):
            if band:
                low, high = middle - wide[:, i], middle + wide[:, i]
                axes.fill_between(number, low, high, color=BAND_COLOUR, alpha=0.6, lw=0, label="95 % band")
            axes.plot(number, points, "s", ms=3.0, mfc="none", mec=SQUARE, label="measured")
        right.axhline(0.0, color=LINE, lw=0.9)
        left.set_ylabel(f"deformation {AXES[i]} [mm]")
        right.set_ylabel(f"measured - model {AXES[i]} [mm]")
    grid[0, 0].legend(fontsize=8, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False)
    for axes in grid[-1]:
        axes.set_xlabel("sample number")
    canvas.suptitle(title)
    _save(canvas, path)


def sizes(path: Path, networks: Mapping[int, Sequence[Trial]]) -> None:
    """Draw what new data and the weights' posterior say about the number of neurons."""
    canvas, ((density, count), (shares, groups)) = pyplot.subplots(2, 2, figsize=(11.0, 7.5), layout="constrained")
    _density(density, networks)
    _counts(count, networks)
    _shares(shares, networks)
    _precisions(groups, networks)
    _save(canvas, path)


def _density(axes: Any, networks: Mapping[int, Sequence[Trial]]) -> None:
    for i, trials in enumerate(networks.values()):
        axes.plot([i] * len(trials), [trial.score.density for trial in trials], "o", color="0.6", ms=4)
    axes.plot([average(trials, "density") for trials in networks.values()], "s-", color=LINE, label="mean")
    axes.axhline(0.0, color="k", lw=0.7, ls=":", label="exact law and noise")
    axes.set(title="held out: log predictive density of a new reading", ylabel="less that of the truth")
    _by_size(axes, networks)


def _counts(axes: Any, networks: Mapping[int, Sequence[Trial]]) -> None:
    weights = [average(trials, "weights") for trials in networks.values()]
    used = [average(trials, "effective") for trials in networks.values()]
    place = np.arange(len(weights))
    axes.bar(place - 0.2, weights, 0.4, color="0.8", label="weights")
    bars = axes.bar(place + 0.2, used, 0.4, color=SQUARE, label="that the data determine")
    axes.bar_label(bars, fmt="%.0f", fontsize=9)
    axes.set(title="weights there are, and effective ones", ylabel="number")
    _by_size(axes, networks)


def _shares(axes: Any, networks: Mapping[int, Sequence[Trial]]) -> None:
    for size, trials in networks.items():
        axes.plot(np.mean([determined(trial.fitted) for trial in trials], axis=0), label=f"{size} neurons")
    axes.set(title="weights' posterior: share determined by the data, sorted", xlabel="weight", ylabel="share")
    axes.legend(fontsize=9)


def _precisions(axes: Any, networks: Mapping[int, Sequence[Trial]]) -> None:
    found = [precisions(trials) for trials in networks.values()]
    for name, mark in zip(found[0], "osD^", strict=True):
        axes.semilogy([each[name] for each in found], f"{mark}-", label=name)
    axes.set(title="prior precision that the evidence finds", ylabel="precision, scaled units")
    _by_size(axes, networks)


def _by_size(axes: Any, networks: Mapping[int, Sequence[Trial]]) -> None:
    axes.set_xticks(range(len(networks)), [f"{size}" for size in networks])
    axes.set_xlabel("hidden neurons")
    axes.legend(fontsize=9)


def benches(path: Path, trials: Mapping[str, Sequence[Trial]], covered: Sequence[Trial]) -> None:
    """Draw every model's error on new data over the noise, and the coverage of the band, on all benches."""
    canvas, (errors, cover) = pyplot.subplots(1, 2, figsize=(12.0, 4.8), layout="constrained")
    for i, own in enumerate(trials.values()):
        ratios = np.array([trial.score.new for trial in own]) / NOISE
        for axis, colour in enumerate(("C0", "C1", "C2")):
            place = np.full(len(own), i + 0.2 * (axis - 1))
            errors.plot(ratios[:, axis], place, "o", ms=4, color=colour, label=AXES[axis] if i == 0 else None)
    errors.axvline(1.5, color="k", lw=0.8, ls=":", label="1.5")
    errors.set_yticks(range(len(trials)), trials)
    errors.set(xscale="log", xlabel="RMS on new data / noise", title="each point a bench")
    errors.set_xticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"], minor=False)
    errors.xaxis.set_minor_formatter("")
    errors.invert_yaxis()
    errors.legend(fontsize=9)
    _coverage(cover, covered)
    _save(canvas, path)


def _coverage(axes: Any, trials: Sequence[Trial]) -> None:
    inside = 100.0 * np.array([trial.score.inside for trial in trials])
    seeds = np.arange(len(trials))
    for axis in range(3):
        axes.plot(seeds + 0.1 * (axis - 1), inside[:, axis], "o", ms=4, label=AXES[axis])
    axes.plot(seeds, inside.mean(axis=1), "k_", ms=14, label="all axes")
    axes.axhspan(90.0, 99.0, color="0.9", zorder=0, label="90 to 99 %")
    axes.axhline(95.0, color="k", lw=0.7, ls=":")
    axes.set(xlabel="bench", ylabel="new readings inside [%]", title=f"95 % band of {trials[0].name}")
    axes.set_ylim(inside.min() - 8.0, 101.0)
    axes.set_xticks(seeds)
    axes.legend(fontsize=9, ncols=3, loc="lower left")


def _save(canvas: Any, path: Path) -> None:
    canvas.savefig(path, dpi=110)
    pyplot.close(canvas)
