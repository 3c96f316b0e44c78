"""A palletizing arm whose lower arm hangs on a spring: its URDF and what its springs are."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from armflex import Arm
from armflex.mechanics.spring import CoilSpring, GasSpring, Spring
from support.small_arms import arm_of, joint, link

JOINTS = {  # parent, child, place, axis
    "turn": ("base", "column", (0.0, 0.0, 0.4), (0.0, 0.0, 1.0)),
    "lower": ("column", "arm", (0.2, 0.0, 0.3), (0.0, 1.0, 0.0)),
    "upper": ("arm", "fore", (0.0, 0.05, 1.1), (0.0, 1.0, 0.0)),
}
BODIES = {"column": (150.0, (0.05, 0.01, 0.1)), "arm": (90.0, (0.0, 0.02, 0.5)), "fore": (60.0, (0.6, 0.0, 0.1))}
SOFTNESS = {"turn": 2e-6, "lower": 3e-6, "upper": 4e-6}
"""Compliance about each drive [rad/Nm]."""

TOOL = (1.3, 0.0, 0.0)
BALANCER = Spring(
    "balancer", "column", np.array([-0.25, 0.1, -0.1]), "arm", np.array([0.05, 0.02, 0.7]), CoilSpring(60e3, 0.6)
)
TIE = Spring("tie", "base", np.array([0.3, 0.6, 0.1]), "fore", np.array([0.4, 0.1, 0.0]), CoilSpring(8e3, 1.1, 2e3))
STRUT = replace(BALANCER, name="strut", law=GasSpring(9e6, 1.2e-3, 1.0, 1.3))


def sprung(folder: Path, springs: tuple[Spring, ...], full: bool = False) -> Arm:
    """Return the arm; it gives about its drives alone, or about and along all axes."""
    parts = [link("base"), *(link(name, mass, com, 1.0) for name, (mass, com) in BODIES.items()), link("tool")]
    parts += [joint(name, parent, child, place, axis=axis) for name, (parent, child, place, axis) in JOINTS.items()]
    parts.append(joint("flange", "fore", "tool", TOOL, kind="fixed"))
    laws = {}
    for name, (_, _, _, axis) in JOINTS.items():
        rest = [2e-8, 3e-8, 1e-8, 5e-7, 4e-7, 6e-7] if full else np.zeros(6)
        laws[name] = np.diag(rest) + SOFTNESS[name] * np.outer([0, 0, 0, *axis], [0, 0, 0, *axis])
    return replace(arm_of(folder, parts, "tool", laws), springs=springs)
