"""Fleets of six: the seventh is calibrated with 12 rows and what the others have in common, against 60 rows without.

    python tests/studies/fleets.py [--fleets N] [--seed S]

Every sister has its own joint zeros, geometry and compliance about the fleet's: heavy_six under two payloads, a tracker
that stands anywhere. Each is left out in turn. Printed are the RMS of the readings' error at 72 other poses
[mm], how many coordinates are within 1.96 of the stated standard deviation, the same with the fleet's true mean and
spread as the prior, and how often a stranger with other common errors is left out.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from support.heavy_campaign import declared

import armflex
from armflex.arm import Arm, Setup
from armflex.estimate.block import factor_block
from armflex.estimate.calibrate import calibrate
from armflex.estimate.fleet import common
from armflex.measured.measurements import Measurements
from armflex.parameters import ParameterKind, of_motions, of_offsets
from armflex.readings.instrument import Instrument
from armflex.robot import Corrections
from armflex.tasks.predict import predict

PRIOR = "joint_offset = 2e-3\ngeometry = 1e-3\ncompliance = 0.3\ntool = 0.05"


def sister(arm: Arm, rng: np.random.Generator, mean: dict, spread: float) -> Arm:
    """Return an arm of the fleet."""
    names = arm.joint_names
    offset = {name: float(mean["offset"][i] + spread * 4e-4 * rng.normal()) for i, name in enumerate(names)}
    geometry = {
        name: mean["geometry"][i] + spread * np.array([2e-4] * 3 + [1e-4] * 3) * rng.normal(size=6)
        for i, name in enumerate(names)
    }
    block = factor_block(arm, {f.name: tuple(f.law.freed(None)) for f in arm.flexures})  # every axis that gives
    factors = mean["compliance"][: len(block.parameters)] + spread * 0.05 * rng.normal(size=len(block.parameters))
    soft = block.apply(Setup(arm, Instrument()), factors).arm
    return replace(soft, corrections=Corrections(offset, geometry))


def known(arm: Arm, mean: dict, spread: float) -> dict[str, tuple[float, float]]:
    """Return mean and standard deviation of each parameter as they were drawn."""
    found = {}
    for i, one in enumerate(of_offsets(arm.robot)):
        found[one.label] = mean["offset"][i], 4e-4 * spread
    for i, one in enumerate(of_motions(ParameterKind.GEOMETRY, arm.joint_names)):
        found[one.label] = mean["geometry"].ravel()[i], spread * (2e-4 if str(one.name)[0] == "d" else 1e-4)
    block = factor_block(arm, {f.name: tuple(f.law.freed(None)) for f in arm.flexures})
    for i, one in enumerate(block.parameters):
        found[one.label] = mean["compliance"][i], spread * 0.05
    return {name: (float(a), float(b)) for name, (a, b) in found.items()}


def campaign(arm: Arm, rng: np.random.Generator, count: int, noise: float) -> Measurements:
    """Return measured rows of an arm, and its instrument anywhere."""
    lower = np.maximum([joint.lower for joint in arm.robot.moving], -2.0)
    upper = np.minimum([joint.upper for joint in arm.robot.moving], 2.0)
    q = rng.uniform(lower, upper, (count, len(lower)))
    payload = tuple(rng.choice(["empty", "p200"], count).tolist())
    pose = pin.SE3(pin.exp3(rng.normal(0.0, 0.5, 3)), rng.normal(0.0, 1.0, 3))
    place = replace(arm, instrument=Instrument(pose, target=np.array([0.01, 0.02, 0.03])))
    rows = Measurements(
        joint_names=arm.joint_names, pose=tuple(map(str, range(count))), session=("a",) * count, payload=payload,
        time=np.arange(float(count)), q=q, approach=np.zeros_like(q), measured=np.ones(count, bool),
        position=np.zeros((count, 3)), sigma=np.full((count, 3), noise),
    )  # fmt: skip
    exact = predict(place, rows).position
    return replace_position(rows, exact + rng.normal(0.0, noise, exact.shape))


def replace_position(rows: Measurements, position: np.ndarray) -> Measurements:
    kinds = tuple(replace(kind, values=position) for kind in rows.readings.kinds)
    return replace(rows, readings=replace(rows.readings, kinds=kinds))


def scored(found: Arm, pose_of: Measurements) -> tuple[float, float]:
    """Return RMS error of predicted readings at fresh poses [m], and the share within 1.96 standard deviations."""
    told = predict(found, pose_of)
    off = told.position - pose_of.position
    std = np.sqrt(told.sigma**2 + pose_of.sigma**2)
    return float(np.sqrt((off**2).sum(axis=1).mean())), float((np.abs(off) < 1.96 * std).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fleets", type=int, default=3)
    parser.add_argument("--spread", type=float, default=0.5, help="of sisters, 1: as large as their common errors")
    parser.add_argument("--noise", type=float, default=3e-5, help="of the tracker [m]")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    lines, strange = [], []
    with tempfile.TemporaryDirectory() as folder:
        arm = armflex.load_arm(declared(Path(folder), PRIOR))
    for fleet in range(asked.fleets):
        rng = np.random.default_rng([asked.seed, fleet])

        def means(rng: np.random.Generator = rng) -> dict:
            return {"offset": 8e-4 * rng.normal(size=6), "geometry": 3e-4 * rng.normal(size=(6, 6)),
                    "compliance": 0.15 * rng.normal(size=40)}  # fmt: skip

        mean = means()
        truths = [sister(arm, rng, mean, asked.spread) for _ in range(6)]
        whole = [campaign(truth, rng, 132, asked.noise) for truth in truths]  # 60 fitted, 12 of them few, 72 kept back
        fitted = [calibrate(arm, rows.some(np.arange(60))) for rows in whole]
        other = sister(arm, rng, means(), asked.spread)
        odd = calibrate(arm, campaign(other, rng, 60, asked.noise)).arm
        for out in range(6):
            others = {str(i): one.arm for i, one in enumerate(fitted) if i != out}
            prior = replace(arm.prior, each=common(others).each)
            kept = whole[out].some(np.arange(60, 132))
            few = whole[out].some(np.arange(12))
            oracle = calibrate(replace(arm, prior=replace(arm.prior, each=known(arm, mean, asked.spread))), few)
            with_prior = calibrate(replace(arm, prior=prior), few)
            alone = calibrate(arm, few)
            line = [scored(one.arm, kept) for one in (with_prior, alone, fitted[out], oracle)]
            lines.append([number for pair in line for number in pair])
            if out == 0:
                strange.append("odd" in common({**others, "odd": odd}).strangers)
            print(fleet, out, *(f"{1e3 * rms:.4f} mm {100 * share:.0f} %" for rms, share in line), flush=True)
    table = np.array(lines)
    for name, i in (
        ("12 rows with the fleet", 0),
        ("12 rows alone", 2),
        ("60 rows alone", 4),
        ("12 rows, fleet known", 6),
    ):
        rms = 1e3 * np.sqrt((table[:, i] ** 2).mean())
        print(f"{name}: {rms:.4f} mm, {100 * table[:, i + 1].mean():.1f} % within 1.96 standard deviations")
    print(f"strangers left out: {sum(strange)} of {len(strange)}")


if __name__ == "__main__":
    main()
