"""The README's picture of errors before and after, drawn of the published UR5: a minute or two.

    python docs/_ext/before_after.py DIR docs/_static/before_after.svg

DIR is a folder of published repositories, as of `tests/public.py`.

As by `tests/public.py --rows 250 --cut rest`, 250 poses spread evenly are fitted; the errors drawn are of all others.
"""

from __future__ import annotations

import runpy
import sys
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

import armflex

TESTS = Path(__file__).parents[2] / "tests"
COLOURS = {"nominal": "#7a8699", "calibrated": "#2a5d9c", "traced": "#c4502e"}


def errors(folder: Path) -> dict[str, np.ndarray]:
    """Return the 3-D errors [mm] of the nominal, the calibrated and the traced arm at the poses held out."""
    published = runpy.run_path(str(TESTS / "public.py"))["published"]
    with tempfile.TemporaryDirectory() as converted:
        file, table = published(folder, Path(converted))["ur5_tsinghua"]
        arm = armflex.load_arm(file)
        rows = armflex.read_measurements(table, arm)
    every = np.arange(len(rows))
    used = np.linspace(0, len(every) - 1, 250).astype(int)
    held_out = np.setdiff1d(every, used)
    traced = armflex.trace(arm, rows, rows=used)
    calibrated, placed = traced.calibration.arm, traced.calibration.placed.setup
    nominal = replace(placed.arm, instrument=placed.instrument, certainty=None)
    found = {}
    for name, one in zip(COLOURS, (nominal, calibrated, traced.arm), strict=True):
        away = armflex.predict(one, rows).position - rows.position
        found[name] = 1e3 * np.linalg.norm(away[held_out], axis=1)
    return found


def main(folder: Path, path: Path) -> None:
    """Draw the share of poses whose error is below a length."""
    matplotlib.rcParams["svg.hashsalt"] = "armflex"  # the same file each time
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    axes = figure.subplots()
    for name, values in errors(folder).items():
        rms = np.sqrt(np.mean(values**2))
        label = f"{name}: {rms:.3f} mm RMS"
        axes.plot(np.sort(values), np.linspace(0.0, 100.0, len(values)), color=COLOURS[name], lw=2, label=label)
        print(label)
    axes.set(xscale="log", xlabel="3-D error at a pose held out [mm]", ylabel="poses below it [%]", ylim=(0, 100))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, loc="upper left")
    figure.savefig(path, facecolor="white", metadata={"Date": None})


if __name__ == "__main__":
    warnings.simplefilter("ignore", armflex.ArmflexWarning)
    main(*map(Path, sys.argv[1:]))
