"""Whole arms of every shape: bundled, crooked, corrected, with networks."""

from dataclasses import replace
from functools import cache

import numpy as np

from armflex import Arm, Flexure, load_arm
from armflex.robot import Corrections
from support.bench import some_law
from support.small_arms import ROBOTS, arm_of, joint, link, three_joints


@cache
def bundled(name: str) -> Arm:
    return load_arm(ROBOTS / name / "arm.toml")


def positions(arm: Arm, count: int, seed: int = 3) -> np.ndarray:
    lower, upper = np.maximum(arm.robot.lower, -2.0), np.minimum(arm.robot.upper, 2.0)
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))


def corrected(arm: Arm) -> Arm:
    """Return an arm whose joints and links are not quite where they are said to be."""
    twist = np.array([2e-3, -1e-3, 3e-3, 4e-3, -2e-3, 5e-3])
    moved = Corrections(dict.fromkeys(arm.joint_names, 3e-3), {arm.joint_names[2]: twist, arm.joint_names[-1]: -twist})
    return replace(arm, corrections=moved)


def crooked(folder, laws: dict, **options: object) -> Arm:
    """Return oblique and sliding joints, a side branch, and flexures at the base, at a fixed joint and before one."""
    parts = [
        link("base"),
        joint("yaw", "base", "column", (0.1, -0.05, 0.4), (0.1, 0.05, -0.2), (0, 0, -1)),
        link("column", 80.0, (0.05, 0.02, 0.2), 4.0),
        joint("side", "column", "counterweight", (-0.5, 0, 0.1), (0, 0, 0.3), (1, 0, 0)),
        link("counterweight", 25.0, (-0.2, 0, 0.1)),
        joint("slide", "column", "mast", (0.1, 0, 0.5), (0, -0.3, 0.2), (0.0, 0.6, 0.8), kind="prismatic"),
        link("mast", 60.0, (0.3, 0.05, 0.02), 5.0),
        joint("seam", "mast", "boom", (0.2, 0.1, 0.0), (0.2, 0.0, 0.1), kind="fixed"),
        link("boom", 20.0, (0.2, 0.0, 0.05)),
        joint("roll", "boom", "fore", (1.0, 0.02, 0.1), (0.2, 0.1, 0), (0.6, 0, 0.8)),
        link("fore", 30.0, (0.3, -0.04, 0), 2.0),
        joint("flange", "fore", "tool", (0.6, 0.05, 0.1), (0, 0.4, 0), kind="fixed"),
        link("tool"),
    ]
    arm = arm_of(folder, parts, "tool", {}, locked={"side": 0.7}, **options)
    return replace(arm, flexures=tuple(Flexure(name, *where) for name, where in laws.items()))


def networks(folder, size: int = 6) -> Arm:
    return three_joints(folder, [some_law(size, 1, seed) for seed in range(3)])
