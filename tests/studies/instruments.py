"""What cheap instruments are worth, on machines drawn from heavy_six; the plant that is measured shares no code.

    python tests/studies/instruments.py wires [--machines 20]
    python tests/studies/instruments.py accelerometers --measured DIR

`wires`: 60 wire lengths and one level against 60 tracker positions of the same cost in noise: three numbers a row, each
root three times as uncertain. Printed are how many of the compliances that are told lie in their 95 % interval, and the
error of the tip elsewhere, the best frame of either allowed. `accelerometers`: those of the Hilti machine beside its
positions, and what is found with them and without.
"""

from __future__ import annotations

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import argparse
import csv
import tempfile
import warnings
from pathlib import Path

import numpy as np
from support.heavy_campaign import PAYLOADS
from support.instruments import LEVEL, WIRE, Machine, heavy, measured

from armflex import Arm, calibrate, load_arm, read_measurements
from armflex.conventions import TWIST_NAMES
from armflex.estimate import Calibration
from armflex.readings.instrument import fit_frame

ROWS, WIRE_NOISE, TOLD, INSIDE = 60, 5e-5, 0.5, 1.96
"""Rows of a campaign, noise of a wire [m], share of its prior up to which a compliance is told, standard deviations."""


def elsewhere(machine: Machine, arm: Arm) -> float:
    """Return the RMS error of the tip at other poses [m], the best frame allowed."""
    rows = machine.rows(100)
    truth = machine.plant.relax(rows).frames[:, -1, :3, 3]
    found = arm.deflection(rows.q, [PAYLOADS[i][0] for i in rows.payload]).pose[:, :3, 3]
    frame = fit_frame(found, truth)
    return float(np.sqrt(((found @ frame.rotation.T + frame.translation - truth) ** 2).sum(axis=1).mean()))


def inside(machine: Machine, found: Calibration) -> np.ndarray:
    """Return of every compliance that is told whether the true one is inside its 95 % interval."""
    joints, hits = [joint.name for joint in machine.plant.joints], []
    for one in found.parameters:
        if one.which.group.kind == "compliance" and one.std < TOLD * one.prior:
            truth = machine.factors[joints.index(str(one.which.group.of)), TWIST_NAMES.index(str(one.which.name))]
            hits.append(abs(one.value - truth) < INSIDE * one.std)
    return np.array(hits, dtype=bool)


def wires(folder: Path, machines: int, first: int = 0) -> dict[str, float]:
    """Return coverage, machines all of whose intervals hold, and errors of the tip elsewhere [m]."""
    hits, errors, not_told = [], [], 0
    for seed in range(first, first + machines):
        own = []
        for name, instruments in (("cheap", (WIRE, LEVEL)), ("tracker", ()), ("wire alone", (WIRE,))):
            arm = heavy(folder / name, *instruments)
            machine = Machine.draw(arm, seed)
            tracker = None if instruments else np.sqrt(3.0) * WIRE_NOISE
            rows = measured(machine, arm, machine.rows(ROWS), folder / name / "rows.csv", tracker)
            loaded = load_arm(arm)
            found = calibrate(loaded, read_measurements(rows, loaded))
            if name == "cheap":
                hits.append(inside(machine, found))
            not_told += len(found.undetermined) if name == "wire alone" else 0
            own.append(elsewhere(machine, found.arm))
        errors.append(own)
        print(f"machine {seed}: {hits[-1].sum()} of {len(hits[-1])} inside, tip {np.round(1e6 * np.array(own), 1)} um")
    cheap, tracker, alone = np.sqrt((np.array(errors) ** 2).mean(axis=0))
    return {
        "coverage": float(np.concatenate(hits).mean()),
        "machines": float(sum(one.mean() >= 0.9 for one in hits)),
        "tip_cheap_m": float(cheap),
        "tip_tracker_m": float(tracker),
        "tip_wire_alone_m": float(alone),
        "ratio": float(cheap / tracker),
        "not_told_by_a_wire": not_told / machines,
    }


HILTI = """
[instrument.acc_base]
kind = "acceleration"
link = "base_link"
reads = "specific_force"
mounting_std = 0.05
bias_std = 0.05
sigma = 5e-3

[instrument.acc_column]
kind = "acceleration"
link = "column_top"
reads = "specific_force"
mounting_std = 0.05
bias_std = 0.05
sigma = 5e-3
"""


def accelerometers(machine: Path, folder: Path) -> None:
    """Print what the accelerometers add to the positions of every campaign of the Hilti machine."""
    declared = (machine / "arm.toml").read_text().replace('"trailblazer.urdf"', f'"{machine / "trailblazer.urdf"}"')
    for name in ("flat", "pallet", "seesaw"):
        rows, felt = (list(csv.DictReader((machine / f"{name}{end}.csv").open())) for end in ("", ".accel"))
        for row, own in zip(rows, felt, strict=True):
            row |= {f"acc_{key.replace('_accel', '')}": value for key, value in own.items()}
        file = folder / f"{name}.csv"
        with open(file, "w", newline="") as out:
            writer = csv.DictWriter(out, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
        for title, text in (("positions", declared), ("and accelerometers", declared + HILTI)):
            toml = folder / "arm.toml"
            toml.write_text(text)
            arm = load_arm(toml)
            found = calibrate(arm, read_measurements(file, arm), anyway=True)
            sizes = ", ".join(f"{kind.title} {after:.3g} {kind.unit}" for kind, _, after, _ in found.by_kind)
            spread = np.exp(np.mean([np.log(p.std / p.prior) for p in found.parameters if p.which.group.moves]))
            print(f"{name}, {title}: held out {1e3 * found.held_out[1]:.3f} mm, {sizes}; std over prior {spread:.3f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("wires", "accelerometers"))
    parser.add_argument("--machines", type=int, default=20)
    parser.add_argument("--measured", type=Path)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as scratch:
        if given.what == "wires":
            print("\n".join(f"{name} {value:.4g}" for name, value in wires(Path(scratch), given.machines).items()))
        else:
            accelerometers(given.measured, Path(scratch))
