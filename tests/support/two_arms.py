"""A torso that gives, with the arm that is asked about and another beside it: what a column moves off the chain."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from armflex import Arm, load_arm

BODIES = (
    # link, its parent, joint kind, origin, rpy, axis, limits, mass, centre, mimic
    ("torso", "base", "revolute", "0 0 0.4", "0 0 0", "0 0 1", "-3 3", 40.0, "0.02 0 0.3", ""),
    ("upper", "torso", "revolute", "0 0.2 0.5", "0.3 0 0", "0 1 0", "-2.5 2.5", 9.0, "0.2 0 0", ""),
    ("fore", "upper", "revolute", "0.4 0 0", "0 0.2 0", "0 1 0", "-2.5 2.5", 5.0, "0.15 0.02 0", ""),
    ("tool", "fore", "fixed", "0.35 0 0", "0 0 0", "", "", 0.0, "", ""),
    ("other_upper", "torso", "revolute", "0 -0.2 0.5", "-0.3 0.1 0", "0 1 0", "-2 2", 12.0, "0.25 0 0.01", ""),
    ("other_fore", "other_upper", "revolute", "0.45 0 0", "0 0 0.4", "0.6 0 0.8", "-2 2", 7.0, "0.2 0 0", ""),
    ("other_slide", "other_fore", "prismatic", "0.3 0 0", "0 0 0", "1 0 0", "0 0.4", 3.0, "0.1 0 0", ""),
    ("finger", "other_slide", "prismatic", "0.1 0 0", "0 0 0", "0 1 0", "0 0.2", 0.6, "0 0.05 0",
     '<mimic joint="to_other_slide" multiplier="0.5"/>'),
)  # fmt: skip

TOML = """
[robot]
urdf = "robot.urdf"
base = "base"
tip = "tool"
gravity = [0.0, 0.0, -9.81]
locked = { to_other_upper = 0.4 }

[payload.part]
mass = 6.0
com = [0.05, 0.0, 0.02]

[flexure.column]
joint = "to_torso"
compliance = [1e-8, 1e-8, 1e-9, 9e-6, 7e-6, 4e-6]

[flexure.shoulder]
joint = "to_upper"
compliance = [1e-8, 1e-8, 1e-8, 2e-5, 3e-5, 2e-5]

[measurement]
frame = "unknown"

[prior]
joint_offset = 1e-3
compliance = 0.3
tool = 0.005
"""

BESIDE = ("to_other_upper", "to_other_fore", "to_other_slide")
"""Joints off the chain that a row may place; the finger follows the last of them."""


def urdf() -> str:
    """Return the robot's text."""
    parts = ['<robot name="two_arms"><link name="base"/>']
    for link, parent, kind, origin, rpy, axis, limits, mass, centre, mimic in BODIES:
        lower, _, upper = limits.partition(" ")
        moves = f'<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>' if axis else ""
        body = f'<origin xyz="{centre}"/><mass value="{mass}"/>' if mass else ""
        inertia = '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'
        parts.append(f'<link name="{link}">{f"<inertial>{body}{inertia}</inertial>" if mass else ""}</link>')
        ends = f'<parent link="{parent}"/><child link="{link}"/><origin xyz="{origin}" rpy="{rpy}"/>'
        parts.append(f'<joint name="to_{link}" type="{kind}">{ends}{moves}{mimic}</joint>')
    return "".join([*parts, "</robot>"])


def two_arms(folder: Path, locked: dict[str, float] | None = None, instead: Mapping[str, str] | None = None) -> Arm:
    """Return the arm from its files in a folder, its other arm's joints held where they are asked to be.

    `instead` has other lines in place of those that begin with its keys.
    """
    (folder / "robot.urdf").write_text(urdf())
    given = (instead or {}).items()
    lines = (next((line for start, line in given if one.startswith(start)), one) for one in TOML.split("\n"))
    text = "\n".join(lines)
    if locked is not None:
        held = ", ".join(f"{name} = {float(at)!r}" for name, at in locked.items())
        text = text.replace("locked = { to_other_upper = 0.4 }", f"locked = {{ {held} }}")
    (folder / "arm.toml").write_text(text)
    return load_arm(folder / "arm.toml")


def beside(count: int, seed: int = 3) -> dict[str, np.ndarray]:
    """Return (N,) positions of the other arm's joints [rad or m]."""
    rng = np.random.default_rng(seed)
    ranges = ((-1.8, 1.8), (-1.8, 1.8), (0.0, 0.4))
    return {name: rng.uniform(*ends, count) for name, ends in zip(BESIDE, ranges, strict=True)}
