"""Campaigns that wires, levels, accelerometers and further targets read of the plant: plain numpy, none of armflex."""

from __future__ import annotations

import csv
import re
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from support.heavy_campaign import PAYLOADS, declared
from support.plant import Plant, Push, Rows, State, apply, turn

WIRE = """
[instrument.wire1]
kind = "distance"
link = "tool"
point = [0.0, 0.0, 0.1]
anchor = [1.6, -1.2, 0.3]
anchor_std = 0.01
length_offset_std = 0.005
sigma = 5e-5
"""

LEVEL = """
[instrument.level3]
kind = "inclination"
link = "link3"
mounting_std = 5e-3
bias_std = 1e-3
sigma = 2e-5
"""

ACCELERATION = """
[instrument.acc2]
kind = "acceleration"
link = "link2"
mounting_std = 5e-3
bias_std = 2e-2
scale_std = 2e-3
reads = "specific_force"
sigma = 3e-4
"""

TARGET = """
[instrument.smr2]
kind = "position"
link = "tool"
point = [0.0, 0.3, 0.05]
point_std = 1e-3
sigma = 2e-5
"""

ENCODER = """
[instrument.enc2]
kind = "encoder"
joint = "J2"
bias_std = 1e-3
sigma = 5e-6
"""

CAMERA = """
[instrument.cam]
kind = "relative_position"
link = "tool"
point = [0.0, 0.0, 0.1]
seen_from = "link2"
anchor = [0.1, 0.3, 0.2]
anchor_std = 5e-3
mounting_std = 5e-3
sigma = 2e-5
"""

PRIOR = "joint_offset = 1e-3\ncompliance = 0.2\n"


@dataclass
class Machine:
    """A heavy_six that is not quite as declared, and instruments that stand not quite where they are said to.

    Attributes:
        plant: As it is.
        factors: (6, 6) logarithm of every declared compliance's factor, by joint and axis.
        rng: Of everything that chance decides.
        off: What is open of every instrument: by name, then by what it is.
    """

    plant: Plant
    factors: np.ndarray
    rng: np.random.Generator
    off: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)

    @classmethod
    def draw(cls, arm: Path, seed: int, compliance: float = 0.2, offset: float = 1e-3) -> Machine:
        rng, plant = np.random.default_rng(seed), Plant.read(arm)
        factors = rng.normal(0.0, compliance, (len(plant.joints), 6))
        for joint, factor in zip(plant.joints, factors, strict=True):
            root = np.exp(0.5 * factor)
            plant.compliance[joint.name] = root[:, None] * plant.compliance[joint.name] * root
            plant.offset[joint.name] = float(rng.normal(0.0, offset))
        machine = cls(plant, factors, rng)
        for name, given in tomllib.loads(arm.read_text()).get("instrument", {}).items():
            size = {"anchor": 3, "point": 3, "mounting": 3, "scale": 1, "length_offset": 1}
            size["bias"] = {"inclination": 2, "acceleration": 3, "encoder": 1}.get(given["kind"], 0)
            machine.off[name] = {
                what: rng.normal(0.0, 1.0, count) * given.get(f"{what}_std", 0.0) for what, count in size.items()
            }
        return machine

    def rows(self, count: int, spread: float = 1.0) -> Rows:
        """Return stops all over, every payload in turn."""
        low = np.array([max(joint.lower, -1.4) for joint in self.plant.joints]) * spread
        high = np.array([min(joint.upper, 1.4) for joint in self.plant.joints]) * spread
        q = self.rng.uniform(low, high, (count, len(low)))
        number = np.arange(count) % len(PAYLOADS)
        rows = Rows.plain(
            q, np.array([PAYLOADS[i][1] for i in number]), np.array([PAYLOADS[i][2] for i in number], float)
        )
        rows.payload = number
        return rows

    def read(self, name: str, given: dict, state: State) -> np.ndarray:
        """Return what an instrument reads of the machine at rest, without noise."""
        plant, off = self.plant, self.off[name]
        names = ["base", *(f"link{i + 1}" for i in range(len(plant.joints))), "tool"]
        frames = np.concatenate([np.tile(np.eye(4), (len(state.frames), 1, 1, 1)), state.frames], axis=1)

        def of(link: str) -> np.ndarray:
            return frames[:, names.index(link)]

        def number(what: str, size: int) -> np.ndarray:
            return np.array(given.get(what, np.zeros(size)), float) + off[what]

        if given["kind"] == "encoder":
            place = [joint.name for joint in plant.joints].index(given["joint"])
            joint = plant.joints[place]
            back = np.linalg.inv(frames[:, place] @ joint.origin) @ frames[:, place + 1]
            angle = np.array([_angle(one[:3, :3], joint.axis) for one in back])
            return angle[:, None] + off["bias"]
        link = of(given["link"])
        axes = link[:, :3, :3] @ turn(number("mounting", 3))
        if given["kind"] == "distance":
            length = np.linalg.norm(apply(link, number("point", 3)) - number("anchor", 3), axis=1)
            return length[:, None] * (1.0 + off["scale"]) + number("length_offset", 1)
        if given["kind"] == "position":
            return apply(link, number("point", 3))
        if given["kind"] == "relative_position":
            other = of(given["seen_from"])
            eye = apply(other, number("anchor", 3))
            looks = other[:, :3, :3] @ turn(number("mounting", 3))
            return np.einsum("nij,ni->nj", looks, apply(link, number("point", 3)) - eye)
        if given["kind"] == "inclination":
            up = -plant.gravity / np.linalg.norm(plant.gravity)
            return np.arcsin(np.einsum("nij,i->nj", axes, up)[:, :2]) + off["bias"]
        sign = -1.0 if given.get("reads") == "specific_force" else 1.0
        return sign * (1.0 + off["scale"]) * np.einsum("nij,i->nj", axes, plant.gravity) + off["bias"]


def _angle(turned: np.ndarray, axis: np.ndarray) -> float:
    """Return the part about an axis of a rotation's vector."""
    skew = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    sine, cosine = np.linalg.norm(skew), 0.5 * (np.trace(turned) - 1.0)
    return float(np.arctan2(sine, cosine) / max(sine, 1e-300) * (skew @ axis))


CHANNELS = {"distance": ("",), "encoder": ("",), "inclination": ("_x", "_y")}
UNITS = {"distance": ("_mm", 1e3), "inclination": ("_deg", 180.0 / np.pi)}


def heavy(folder: Path, *instruments: str, prior: str = PRIOR) -> Path:
    """Write heavy_six with instruments."""
    folder.mkdir(parents=True, exist_ok=True)
    file = declared(folder, prior)
    file.write_text(file.read_text() + "".join(instruments))
    return file


def measured(
    machine: Machine,
    arm: Path,
    rows: Rows,
    file: Path,
    tracker: float | None = None,
    effects: tuple = (),
    **given: object,
) -> Path:
    """Write a campaign of every instrument that the arm file declares, and of a tracker in the base with a sigma [m].

    Args:
        machine: The truth.
        arm: What is declared.
        rows: What is driven.
        file: Where to.
        tracker: Noise of x y z, none where not given.
        effects: Of the plant.
        given: Further columns by name.
    """
    state, columns = machine.plant.relax(rows, effects), {}
    for joint, q in zip(machine.plant.joints, rows.q.T, strict=True):
        columns[f"q_{joint.name}"] = q
    columns["payload"] = [PAYLOADS[i][0] for i in rows.payload]
    if tracker is not None:
        points = machine.plant.points(state)
        seen = points + machine.rng.normal(0.0, tracker, points.shape)
        columns |= {axis: seen[:, i] for i, axis in enumerate("xyz")} | {"sigma": np.full(len(points), tracker)}
    for name, one in tomllib.loads(arm.read_text()).get("instrument", {}).items():
        exact = machine.read(name, one, state)
        seen = exact + machine.rng.normal(0.0, one["sigma"], exact.shape)
        unit, factor = UNITS.get(one["kind"], ("", 1.0))
        for i, channel in enumerate(CHANNELS.get(one["kind"], ("_x", "_y", "_z"))):
            columns[f"{name}{channel}{unit}"] = factor * seen[:, i]
    columns |= given
    with open(file, "w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(columns)
        writer.writerows(zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True))
    return file


def in_base(text: str) -> str:
    """Return an arm file whose tracker stands in the base frame."""
    return re.sub(r'frame = "unknown"', 'frame = "base"', text)


__all__ = ["ACCELERATION", "CAMERA", "ENCODER", "LEVEL", "TARGET", "WIRE", "Machine", "Push", "heavy", "measured"]
