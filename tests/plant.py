"""A machine to be measured: plain numpy and ElementTree, sharing no code with armflex.

Its own URDF reading, its own kinematics by 4 x 4 products, its own exponential, loads by summing weights one by one,
equilibrium by plain relaxation. Campaigns are written as the CSV and TOML files that a user would bring.
"""

from __future__ import annotations

import csv
import tomllib
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

Array = np.ndarray


def hat(v: Array) -> Array:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0.0]])


def turn(vector: Array) -> Array:
    """Rotation matrix of a rotation vector (Rodrigues)."""
    angle = np.linalg.norm(vector)
    k = hat(vector / angle) if angle > 1e-14 else np.zeros((3, 3))
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def screw(twist: Array) -> Array:
    """Pose of an exponential coordinate, linear first, by the series of its 4 x 4 generator."""
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = hat(twist[3:]), twist[:3]
    total, term = np.eye(4), np.eye(4)
    for n in range(1, 14):
        term = term @ generator / n
        total = total + term
    return total


def pose(position: Array, rotation: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


@dataclass
class Joint:
    name: str
    kind: str
    axis: Array
    origin: Array
    mass: float
    com: Array
    lower: float
    upper: float


@dataclass
class Plant:
    """The true machine: a serial chain with a flexure behind every joint that `compliance` names."""

    joints: list[Joint]
    tip: Array
    compliance: dict[str, Array]
    gravity: Array
    offset: dict[str, float] = field(default_factory=dict)
    target: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def read(cls, arm: Path) -> Plant:
        declared = tomllib.loads(arm.read_text())
        root = ET.parse(arm.parent / declared["robot"]["urdf"]).getroot()
        joints, tip = [], np.eye(4)
        child_of = {j.find("parent").get("link"): j for j in root.findall("joint")}
        links = {link.get("name"): link for link in root.findall("link")}
        here = next(name for name in links if name not in {j.find("child").get("link") for j in root.findall("joint")})
        while here in child_of:
            element = child_of[here]
            here = element.find("child").get("link")
            at = origin_of(element)
            if element.get("type") == "fixed":
                tip = tip @ at
            else:
                joints.append(joint_of(element, at, links[here]))
        flexures = declared["flexure"]
        compliance = {f["joint"]: np.diag(np.array(f["compliance"], float)) for f in flexures.values()}
        return cls(joints, tip, compliance, np.array(declared["robot"]["gravity"], float))

    def rigid(self, q: Array) -> list[Array]:
        return self.frames(q, np.zeros((len(self.joints), 6)))

    def frames(self, q: Array, twists: Array) -> list[Array]:
        """Pose of every link's body (behind its flexure), then of the tip."""
        T, found = np.eye(4), []
        for joint, position, twist in zip(self.joints, q, twists, strict=True):
            true = position + self.offset.get(joint.name, 0.0)
            move = (
                pose(true * joint.axis, np.eye(3))
                if joint.kind == "prismatic"
                else pose(np.zeros(3), turn(true * joint.axis))
            )
            T = T @ joint.origin @ move @ screw(twist)
            found.append(T)
        return [*found, T @ self.tip]

    def loads(self, frames: list[Array], mass: float, com: Array) -> Array:
        """Wrench on every flexure in its own axes, weights added one by one from the tip inwards."""
        weights = [(j.mass, T[:3, :3] @ j.com + T[:3, 3]) for j, T in zip(self.joints, frames, strict=False)]
        carried = (mass, frames[-1][:3, :3] @ com + frames[-1][:3, 3])
        wrenches = []
        for i, T in enumerate(frames[:-1]):
            force, moment = np.zeros(3), np.zeros(3)
            for m, at in [*weights[i:], carried]:
                force = force + m * self.gravity
                moment = moment + np.cross(at - T[:3, 3], m * self.gravity)
            wrenches.append(np.concatenate([T[:3, :3].T @ force, T[:3, :3].T @ moment]))
        return np.array(wrenches)

    def settle(self, q: Array, mass: float, com: Array) -> list[Array]:
        """Frames of the loaded arm."""
        twists = np.zeros((len(self.joints), 6))
        for _ in range(60):
            wrenches = self.loads(self.frames(q, twists), mass, com)
            new = np.array(
                [self.compliance.get(j.name, np.zeros((6, 6))) @ w for j, w in zip(self.joints, wrenches, strict=True)]
            )
            if np.abs(new - twists).max() < 1e-14:
                break
            twists = new
        return self.frames(q, twists)


def origin_of(element: ET.Element) -> Array:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    xyz = np.array(origin.get("xyz", "0 0 0").split(), float)
    r, p, y = map(float, origin.get("rpy", "0 0 0").split())
    return pose(xyz, turn(np.array([0, 0, y])) @ turn(np.array([0, p, 0])) @ turn(np.array([r, 0, 0])))


def joint_of(element: ET.Element, at: Array, link: ET.Element) -> Joint:
    inertial, limit = link.find("inertial"), element.find("limit")
    return Joint(
        element.get("name"),
        element.get("type"),
        np.array(element.find("axis").get("xyz").split(), float),
        at,
        float(inertial.find("mass").get("value")),
        origin_of(inertial)[:3, 3],
        float(limit.get("lower")),
        float(limit.get("upper")),
    )


@dataclass
class Campaign:
    """How it was measured: instrument, sessions, noise, poses, drawn by seed."""

    seed: int
    poses: int = 60
    sessions: int = 3
    noise: float = 2e-4
    payloads: tuple[tuple[str, float, tuple], ...] = (("none", 0.0, (0, 0, 0)),)

    def write(self, plant: Plant, path: Path) -> dict[str, Array]:
        """Write measurements.csv; return what was true: instrument, session shifts, noise-free positions."""
        rng = np.random.default_rng(self.seed)
        station = pose(rng.normal(0, 3, 3), turn(np.array([0, 0, rng.uniform(-3, 3)])))
        shifts = [pose(rng.normal(0, 2e-4, 3), turn(rng.normal(0, 2e-5, 3))) for _ in range(self.sessions)]
        rows, clean = [], []
        for number in range(self.poses):
            q = np.array([rng.uniform(max(j.lower, -2.5) * 0.9, min(j.upper, 2.5) * 0.9) for j in plant.joints])
            for name, mass, com in self.payloads:
                session = number * self.sessions // self.poses
                tip = plant.settle(q, mass, np.array(com, float))[-1]
                read = shifts[session] @ station @ tip @ np.array([*plant.target, 1.0])
                clean.append(read[:3])
                seen = read[:3] + rng.normal(0, self.noise, 3)
                identity = {"pose": f"p{number}", "session": f"s{session}", "time": 10.0 * len(rows), "payload": name}
                joints = {f"q_{j.name}": repr(float(x)) for j, x in zip(plant.joints, q, strict=True)}
                rows.append(
                    {
                        **identity,
                        **joints,
                        **dict(zip("xyz", map(repr, map(float, seen)), strict=True)),
                        "sigma": self.noise,
                    }
                )
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)
        return {"station": station, "shifts": np.array(shifts), "clean": np.array(clean)}
