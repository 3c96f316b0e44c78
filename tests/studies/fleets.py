"""Fleets of six: the seventh is calibrated with 12 rows and what the others have in common, against 60 rows without.

    python tests/studies/fleets.py [--fleets N] [--seed S] [--planned]

The machines are those of `support.plant`, which shares no code with armflex: heavy_six under two payloads, each with
joint zeros, geometry and compliance of its own about the fleet's. Each is left out in turn. Printed are the RMS of the
readings' error at 72 other poses [mm], and how many coordinates are within 1.96 of the stated standard deviation, of
a tracker that stands anywhere with a target that is anywhere on the tool, and of one that both are known of; the same
with the fleet's true mean and spread as the prior; and how often a stranger with other common errors is left out. With
--planned the 12 rows are those that `plan` asks for, of each prior its own.
"""

import argparse
import sys
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from support.heavy_campaign import declared  # noqa: E402
from support.plant import Plant, Rows, apply, pose, screw, turn  # noqa: E402

import armflex  # noqa: E402
from armflex.arm import Arm  # noqa: E402
from armflex.estimate.block import factor_block  # noqa: E402
from armflex.estimate.calibrate import calibrate  # noqa: E402
from armflex.estimate.calibrations import common  # noqa: E402
from armflex.measured.measurements import Measurements  # noqa: E402
from armflex.parameters import ParameterKind, of_motions, of_offsets  # noqa: E402
from armflex.tasks.predict import predict  # noqa: E402

PRIOR = "joint_offset = 2e-3\ngeometry = 1e-3\ncompliance = 0.3\n"
SPREAD = {"offset": 4e-4, "geometry": np.array([2e-4] * 3 + [1e-4] * 3), "compliance": 0.05}
"""Of a fleet's sisters, times --spread."""


def drawn(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return what all of a fleet have: zeros [rad], motions at each joint [m, rad], relative compliances."""
    shape = {"offset": (6,), "geometry": (6, 6), "compliance": (6, 6)}
    size = {"offset": 8e-4, "geometry": 3e-4, "compliance": 0.15}
    return {name: size[name] * rng.normal(size=shape[name]) for name in shape}


def sister(file: Path, rng: np.random.Generator, mean: dict[str, np.ndarray], spread: float) -> Plant:
    """Return a machine of the fleet."""
    own = {name: mean[name] + spread * SPREAD[name] * rng.normal(size=mean[name].shape) for name in mean}
    plant = Plant.read(file)
    for i, joint in enumerate(plant.joints):
        joint.origin = joint.origin @ screw(own["geometry"][i])
        plant.offset[joint.name] = own["offset"][i]
        plant.compliance[joint.name] = plant.compliance[joint.name] * (1.0 + own["compliance"][i])
    return plant


def known(arm: Arm, mean: dict[str, np.ndarray], spread: float) -> dict[str, tuple[float, float]]:
    """Return mean and standard deviation of each parameter as they were drawn."""
    found = {one.label: (mean["offset"][i], 4e-4 * spread) for i, one in enumerate(of_offsets(arm.robot))}
    for i, one in enumerate(of_motions(ParameterKind.GEOMETRY, arm.joint_names)):
        found[one.label] = mean["geometry"].ravel()[i], spread * SPREAD["geometry"][i % 6]
    freed = {f.name: tuple(f.law.freed(None)) for f in arm.flexures}
    every = {f.name: i for i, f in enumerate(arm.flexures)}
    axes = [(every[name], axis) for name, own in freed.items() for axis in own]
    for (i, axis), one in zip(axes, factor_block(arm, freed).parameters, strict=True):
        found[one.label] = mean["compliance"][i][int(axis)], spread * SPREAD["compliance"]
    return {name: (float(a), float(b)) for name, (a, b) in found.items()}


def campaign(
    arm: Arm, plant: Plant, rng: np.random.Generator, count: int, noise: float, station: np.ndarray | None = None,
    stops: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[Measurements, np.ndarray]:  # fmt: skip
    """Return measured rows of a machine, at random or at stops (joint positions, loaded), and where the tracker stands.

    That is anywhere unless it is given; in the base, the target is at the tip.
    """
    limits = [(max(joint.lower, -2.0), min(joint.upper, 2.0)) for joint in plant.joints]
    q, loaded = rng.uniform(*np.array(limits).T, (count, 6)), rng.random(count) < 0.5
    anywhere = pose(rng.normal(0.0, 1.0, 3), turn(rng.normal(0.0, 0.5, 3)))
    (q, loaded), station = stops or (q, loaded), anywhere if station is None else station
    plant.target = np.array([0.01, 0.02, 0.03]) * (station != np.eye(4)).any()
    com = np.where(loaded[:, None], [0.1, 0.0, 0.0], 0.0)
    true = apply(station, plant.points(plant.relax(Rows.plain(q, 200.0 * loaded, com))))
    rows = Measurements(
        joint_names=arm.joint_names, pose=tuple(map(str, range(count))), session=("a",) * count,
        payload=tuple(np.where(loaded, "p200", "empty").tolist()), time=np.arange(float(count)), q=q,
        approach=np.zeros_like(q), measured=np.ones(count, bool),
        position=true + rng.normal(0.0, noise, true.shape), sigma=np.full((count, 3), noise),
    )  # fmt: skip
    return rows, station


def planned(arm: Arm, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Return joint positions and whether loaded of the 12 rows that `plan` asks for."""
    rows = armflex.plan(arm, 12, payloads=("empty", "p200"), sigma=noise).rows
    return rows.q[rows.measured], np.array(rows.payload)[rows.measured] == "p200"


def scored(found: Arm, rows: Measurements) -> tuple[float, float]:
    """Return RMS error of predicted readings at fresh poses [m], and the share within 1.96 standard deviations."""
    told = predict(found, rows)
    off, std = told.position - rows.position, np.hypot(told.sigma, rows.sigma)
    return float(np.sqrt((off**2).sum(axis=1).mean())), float((np.abs(off) < 1.96 * std).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fleets", type=int, default=3)
    parser.add_argument("--spread", type=float, default=0.5, help="of sisters, 1: as large as their common errors")
    parser.add_argument("--noise", type=float, default=3e-5, help="of the tracker [m]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--planned", action="store_true", help="the 12 rows are planned, not at random")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    for placed in (False, True):
        with tempfile.TemporaryDirectory() as folder:
            file = declared(Path(folder), PRIOR + ("" if placed else "tool = 0.05\n"))
            if placed:
                file.write_text(file.read_text().replace('frame = "unknown"', 'frame = "base"'))
            print("instrument and target known" if placed else "instrument and target anywhere")
            one_setting(file, asked, placed)


def one_setting(file: Path, asked: argparse.Namespace, placed: bool) -> None:
    """Print the figures of all fleets."""
    arm, lines, strange = armflex.load_arm(file), [], []
    for fleet in range(asked.fleets):
        rng = np.random.default_rng([asked.seed, fleet])
        mean = drawn(rng)
        sisters = [sister(file, rng, mean, asked.spread) for _ in range(6)]
        # 60 fitted, 12 of them few, 72 kept back
        base = np.eye(4) if placed else None
        measured = [campaign(arm, plant, rng, 132, asked.noise, base) for plant in sisters]
        whole = [rows for rows, _ in measured]
        fitted = [calibrate(arm, rows.some(np.arange(60))) for rows in whole]
        other = sister(file, rng, drawn(rng), asked.spread)
        odd = calibrate(arm, campaign(arm, other, rng, 60, asked.noise, base)[0]).arm
        for out in range(6):
            others = {str(i): one.arm for i, one in enumerate(fitted) if i != out}
            few, kept = (whole[out].some(own) for own in (np.arange(12), np.arange(60, 132)))
            priors = (common(others).each, None, known(arm, mean, asked.spread))
            each = [replace(arm, prior=arm.prior if own is None else replace(arm.prior, each=own)) for own in priors]
            rows = [few] * len(each)
            if asked.planned:
                own, there = np.random.default_rng([asked.seed, fleet, out]), measured[out][1]
                stops = [planned(one, asked.noise) for one in each]
                rows = [campaign(arm, sisters[out], own, 12, asked.noise, there, one)[0] for one in stops]
            line = [scored(calibrate(*pair).arm, kept) for pair in zip(each, rows, strict=True)]
            line.append(scored(fitted[out].arm, kept))
            lines.append([number for pair in line for number in pair])
            if out == 0:
                strange.append("odd" in common({**others, "odd": odd}).strangers)
            print(fleet, out, *(f"{1e3 * rms:.4f} mm {100 * share:.0f} %" for rms, share in line), flush=True)
    table = np.array(lines)
    for i, name in enumerate(("12 rows, fleet", "12 rows alone", "12 rows, fleet known", "60 rows alone")):
        rms = 1e3 * np.sqrt((table[:, 2 * i] ** 2).mean())
        print(f"{name}: {rms:.4f} mm, {100 * table[:, 2 * i + 1].mean():.1f} % within 1.96 standard deviations")
    print(f"strangers left out: {sum(strange)} of {len(strange)}")


if __name__ == "__main__":
    main()
