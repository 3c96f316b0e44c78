"""A simulated six-axis arm: a UR5 with errors of zeros and geometry that its arm.toml does not have."""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
from public import write_campaign

from armflex import Arm, predict
from armflex.laws.effects import Effect
from armflex.measured.measurements import Measurements, read_measurements
from armflex.readings import Readings
from armflex.readings.instrument import Instrument
from armflex.robot import Corrections
from armflex.rows import Rows
from support.effect_arms import quietly
from support.plant import turn

DECLARED = Path(__file__).parents[1] / "public_arms" / "ur5_tsinghua" / "arm.toml"
SIGMA = 1e-4  # m
LOWER = np.radians([-20.0, -105.0, 60.0, -100.0, 50.0, -25.0])
UPPER = np.radians([55.0, -30.0, 140.0, 5.0, 140.0, 15.0])
"""Where a UR5 stands whose tool works in front of it, pointing down."""
STATION = pin.SE3(turn(np.array([0.1, -0.05, 2.0])), np.array([2.5, -1.0, 0.6]))
INSTRUMENT = Instrument(STATION, target=np.array([1e-3, -2e-3, 0.034]))


@cache
def declared() -> Arm:
    """Return the arm as its arm.toml has it."""
    return quietly(DECLARED)


@cache
def true_arm() -> Arm:
    """Return an arm whose zeros and joint frames are off by about a millimetre and a milliradian."""
    arm, rng = declared(), np.random.default_rng(2)
    offsets = {joint: float(rng.normal(0.0, 2e-3)) for joint in arm.joint_names}
    frames = {joint: rng.normal(0.0, 1e-3, 6) for joint in arm.joint_names}
    return replace(arm, corrections=Corrections(offsets, frames), instrument=INSTRUMENT)


def campaign(count: int = 200, seed: int = 0, effects: Sequence[Effect] = ()) -> tuple[Arm, Measurements]:
    """Return the declared arm and `count` readings of the true one with effects, read from a file."""
    rng, arm = np.random.default_rng([seed, count]), replace(true_arm(), effects=tuple(effects))
    q = rng.uniform(LOWER, UPPER, (count, 6))
    rows = Rows.of(arm.joint_names, q, ["none"] * count, {})
    position = predict(arm, Measurements.of(rows, Readings(count, ()))).position + rng.normal(0.0, SIGMA, (count, 3))
    lines = ([f"p{i}", "s0", 10.0 * i, *q[i], *position[i], SIGMA] for i in range(count))
    with tempfile.TemporaryDirectory() as folder:
        write_campaign(Path(folder) / "campaign.csv", list(arm.joint_names), lines)
        return declared(), read_measurements(Path(folder) / "campaign.csv", declared())
