"""A boom of eight joints, bent and loaded, for armflex and for its peers: the same springs, masses and posture.

Peers that know only single-axis springs get every joint as a fixed frame with up to six of them behind it: slides
along x, y, z, then hinges about x, y, z, in series. That is another convention than armflex's `exp6`; an armflex arm of
single-axis flexures in series has the peers' own.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from support.plant import Plant, screw
from support.small_arms import joint, link, robot

from armflex import Arm, load_arm
from armflex.conventions import Array

JOINTS = {  # axis, origin in the parent [m], mass [kg] and centre of mass [m] of what it carries
    "M1": ("prismatic", (0, 0, -1), (0, 0, 0), 1500.0, (0, 0, -2.0)),
    "A1": ("revolute", (0, 0, 1), (0, 0, -4.5), 420.0, (0, 0, -0.3)),
    "A2": ("revolute", (0, 1, 0), (0, 0, -0.6), 650.0, (1.1, 0, 0)),
    "A3": ("revolute", (0, 0, 1), (2.4, 0, 0), 480.0, (1.0, 0, 0)),
    "A4": ("revolute", (0, 1, 0), (2.2, 0, 0), 420.0, (0.9, 0, 0)),
    "A5": ("revolute", (0, 0, 1), (2.0, 0, 0), 260.0, (0.7, 0, 0)),
    "A6": ("revolute", (0, 1, 0), (1.6, 0, 0), 180.0, (0.5, 0, 0)),
    "A7": ("revolute", (1, 0, 0), (1.2, 0, 0), 420.0, (0.8, 0, 0)),  # with 300 kg in the gripper
}
TIP = (0.7, 0.0, 0.0)
POSTURE = {"M1": 2.0, "A1": 0.3, "A2": 0.1, "A3": 0.4, "A4": -0.2, "A5": -0.5, "A6": 0.25, "A7": 0.4}
COMPLIANCE = np.array([1e-9, 1e-9, 1e-9, 4e-8, 8e-8, 8e-8])
"""Of the first joint [m/N, rad/Nm]; every next one gives a third more."""


@dataclass(frozen=True)
class Station:
    """What lies between two joints: a frame fixed in the one before, springs, and the body behind them.

    Attributes:
        placement: (4, 4) pose in the frame before, the joint's own position included.
        compliance: (6,) of the springs along and about x, y, z, 0 where there is none [m/N, rad/Nm].
        mass: Of the body [kg].
        com: (3,) its centre of mass [m].
    """

    placement: Array
    compliance: Array
    mass: float
    com: Array

    @property
    def springs(self) -> list[int]:
        """Axes that give: 0 to 2 slides, 3 to 5 hinges."""
        return [axis for axis in range(6) if self.compliance[axis] > 0.0]


@dataclass(frozen=True)
class Boom:
    """The boom as armflex reads it, and as its peers are told."""

    arm: Arm
    series: Arm
    """The same with every spring a flexure of its own, in the peers' order."""
    q: Array
    stations: tuple[Station, ...]
    tip: Array
    gravity: Array

    @property
    def freedoms(self) -> int:
        """How many springs there are."""
        return sum(len(station.springs) for station in self.stations)


def make_boom(folder: Path, drives_only: bool, sag: float) -> Boom:
    """Return the boom with a spring at every drive, or six behind every joint, soft enough to sag so far [m]."""
    (folder / "robot.urdf").write_text(urdf())
    factor = 1.0
    for _ in range(12):
        compliance = {name: factor * given for name, given in declared(drives_only).items()}
        arm, q = read(folder, "arm.toml", compliance, in_series=False)
        found = arm.deflection(q, allow_large=True)
        factor *= sag / float(np.linalg.norm(found.displacement[:3]))
    series, _ = read(folder, "series.toml", compliance, in_series=True)
    plant = Plant.read(folder / "arm.toml")
    moved = screw(q[:, None] * np.array([one.drive for one in plant.joints]))
    stations = [
        Station(one.origin @ motion, compliance[one.name], one.mass, one.com)
        for one, motion in zip(plant.joints, moved, strict=True)
    ]
    return Boom(arm, series, q, tuple(stations), plant.tip[:3, 3], plant.gravity)


def declared(drives_only: bool) -> dict[str, Array]:
    """Return the (6,) compliances by joint."""
    found = {}
    for number, (name, (kind, axis, *_)) in enumerate(JOINTS.items()):
        drive = np.concatenate([np.abs(axis), np.zeros(3)] if kind == "prismatic" else [np.zeros(3), np.abs(axis)])
        found[name] = COMPLIANCE * (4 / 3) ** number * (drive if drives_only else 1.0)
    return found


def urdf() -> str:
    """Return the boom's URDF."""
    parts, before = [link("base")], "base"
    for name, (kind, axis, origin, mass, com) in JOINTS.items():
        parts += [joint(name, before, f"{name}_link", origin, axis=axis, kind=kind)]
        parts += [link(f"{name}_link", mass, com, 0.1 * mass)]
        before = f"{name}_link"
    return robot(*parts, joint("tool_fix", before, "tool", TIP, kind="fixed"), link("tool"))


def read(folder: Path, file: str, compliance: dict[str, Array], in_series: bool) -> tuple[Arm, Array]:
    """Return the arm of an arm.toml written here, and the posture."""
    lines = ["[robot]", 'urdf = "robot.urdf"', 'tip = "tool"', "gravity = [0.0, 0.0, -9.81]"]
    for name, values in compliance.items():
        single = [(f"{name}_{axis}", values * np.eye(6)[axis]) for axis in range(6) if values[axis] > 0.0]
        for flexure, diagonal in single if in_series else [(name, values)]:
            lines += [f"[flexure.{flexure}]", f'joint = "{name}"', 'model = "linear"']
            lines += [f"compliance = {[float(x) for x in diagonal]}"]
    (folder / file).write_text("\n".join(lines) + "\n")
    arm = load_arm(folder / file)
    return arm, arm.position(**POSTURE)
