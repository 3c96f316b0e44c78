"""Campaigns of machines that MuJoCo simulates: positions in thirty poses, and frequencies in ten more."""

from dataclasses import replace

import numpy as np

from armflex import Arm, Flexure, Measurements, load_arm
from armflex.arm import Measurement, Prior
from armflex.laws import LinearLaw
from armflex.readings import Frequency, Position, Readings
from armflex.readings.frequency import Swing
from armflex.readings.sensor import Sensor
from armflex.rows import Rows
from support.mujoco_arm import Referee, Sprung
from support.small_arms import ROBOTS

ROBOT, STIFFNESS, CARRIED = "heavy_six", 3e5, "p100"
POSES, RINGING = 30, 10
SOFTER, HEAVIER = 0.3, 0.2
"""Standard deviations of the logarithms of true compliances and masses."""

SIGMA, SHARE = 1e-4, 1e-3
"""Of a position [m], and of a frequency, relative."""


def driven(arm: Arm, stiffness: float) -> Arm:
    """Return an arm whose drives give along their own axes [Nm/rad or N/m], and nothing else."""
    drives = []
    for one in arm.robot.moving:
        compliance, place = np.zeros((6, 6)), slice(0, 3) if one.kind == "prismatic" else slice(3, 6)
        compliance[place, place] = np.outer(one.axis, one.axis) / stiffness
        drives.append(Flexure(one.name, one.name, LinearLaw(compliance)))
    return replace(arm, flexures=tuple(drives), damping_ratio=0.02)


def declared() -> Arm:
    """Return the arm as its file declares it: springs in the drives, masses and compliances open, payloads known."""
    arm = driven(load_arm(ROBOTS / ROBOT / "arm.toml"), STIFFNESS)
    ring = Sensor("ring", Frequency, arm.robot.tip, 0.005, np.zeros(0), np.zeros(0), about=Swing())
    prior, sensors = Prior(compliance=SOFTER, mass=HEAVIER), {"ring": ring}
    return replace(arm, prior=prior, measurement=Measurement("base"), sensors=sensors, certainty=None)


def machine(arm: Arm, seed: int) -> tuple[Measurements, Measurements, dict[str, float]]:
    """Return what was read of one machine, positions alone and with frequencies, and the truth by label."""
    rng, referee, count = np.random.default_rng(seed), Referee(ROBOT), POSES + RINGING
    q = rng.uniform(arm.robot.lower, arm.robot.upper, (count, len(arm.joint_names)))
    softer = rng.normal(0.0, SOFTER, len(arm.joint_names))
    links = [name for name in arm.weighing if not name.startswith("payload ")]
    heavier = dict(zip(links, rng.normal(0.0, HEAVIER, len(links)).tolist(), strict=True))
    masses = {name: float(np.exp(value)) for name, value in heavier.items()}
    loads = [["none", CARRIED][row % 2] if row < POSES else ["none", CARRIED][row % 4 // 2] for row in range(count)]
    plants = {
        load: Sprung(referee, arm.joint_names, load, STIFFNESS / np.exp(softer), masses) for load in ("none", CARRIED)
    }
    position, ring, mode = np.zeros((count, 3)), np.zeros((count, 1)), np.zeros(count, dtype=int)
    for row, plant in enumerate(plants[load] for load in loads):
        if row < POSES:
            plant.rest(q[row])
            position[row] = plant.point(np.zeros(3)) + rng.normal(0.0, SIGMA, 3)
        else:
            mode[row] = row % len(q[row]) + 1
            ring[row] = plant.swings(q[row])[0][mode[row] - 1] * (1.0 + SHARE * rng.normal())
    tracked = np.arange(count)[:, None] < POSES
    kinds = (
        Position(position, np.where(tracked, SIGMA, np.inf) * np.ones(3)),
        Frequency(ring, np.where(tracked, np.inf, SHARE * ring), "ring", mode),
    )
    rows = Rows.of(arm.joint_names, q, tuple(loads), {}, session="s", derived=("time",))
    both = Measurements.of(rows, Readings(count, kinds))
    alone = Measurements.of(rows.some(np.arange(POSES)), Readings(count, kinds[:1]).some(np.arange(POSES)))
    pairs = zip(arm.joint_names, softer.tolist(), strict=True)
    return alone, both, {f"mass {name}": value for name, value in heavier.items()} | dict(pairs)
