"""A machine to be measured: plain numpy and ElementTree, sharing no code with armflex.

Its own URDF reading, its own kinematics by 4 x 4 products, its own exponential, loads by summing weights one by one,
equilibrium by plain relaxation, over all rows of a campaign at once. Effects that nobody declared push at it through
`Push`. Campaigns are written as the CSV and TOML files that a user would bring.
"""

from __future__ import annotations

import csv
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

Array = np.ndarray


def hat(v: Array) -> Array:
    """Cross product matrices (..., 3, 3) of (..., 3) vectors."""
    out = np.zeros((*v.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., k, j], out[..., j, k] = v[..., i], -v[..., i]
    return out


def turn(vector: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) (Rodrigues)."""
    return screw(np.concatenate([np.zeros_like(vector), vector], axis=-1))[..., :3, :3]


def screw(twist: Array) -> Array:
    """Poses (..., 4, 4) of exponential coordinates (..., 6), linear first, in closed form."""
    k = hat(np.asarray(twist[..., 3:], float))
    angle = np.linalg.norm(twist[..., 3:], axis=-1)[..., None, None]
    sine, half = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    small, wide = angle**2, np.maximum(angle, 0.1)
    series = (1 - small / 20 * (1 - small / 42 * (1 - small / 72))) / 6
    third = np.where(angle < 0.1, series, (wide - np.sin(wide)) / wide**3)
    out, kk = np.zeros((*twist.shape[:-1], 4, 4)), k @ k
    out[..., :3, :3] = np.eye(3) + sine * k + half * kk
    out[..., :3, 3] = ((np.eye(3) + half * k + third * kk) @ twist[..., :3, None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def pose(position: Array, rotation: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


def apply(T: Array, point: Array) -> Array:
    """Points (..., 3) seen through poses (..., 4, 4)."""
    return (T[..., :3, :3] @ point[..., None])[..., 0] + T[..., :3, 3]


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

    @property
    def drive(self) -> Array:
        """Six-vector of the joint's own motion."""
        zero = np.zeros(3)
        return np.concatenate([self.axis, zero] if self.kind == "prismatic" else [zero, self.axis])


@dataclass
class Rows:
    """What was driven, one stop per row, in order; `payload` and `session` are numbers."""

    q: Array
    mass: Array
    com: Array
    approach: Array
    pose: Array
    session: Array
    payload: Array
    time: Array
    temperature: Array
    hold: Array
    humidity: Array
    measured: Array
    held_out: Array

    @classmethod
    def plain(cls, q: Array, mass: Array, com: Array) -> Rows:
        none, every = np.zeros(len(q)), np.ones(len(q), bool)
        whole = none.astype(int)
        return cls(
            q, mass, com, np.ones(q.shape), np.arange(len(q)), whole, whole, none, none, none, none, every, ~every
        )


class Push:
    """What effects add: twists (N, site, 6), loads in base axes on a body (the tip counts as one), and readings."""

    def __init__(self, rows: int, joints: int) -> None:
        self.base = np.zeros((rows, 1, 6))  # at the base's origin
        self.link = np.zeros((rows, joints + 1, 6))  # at the end of a link, before the motion of the joint that ends it
        self.motion = np.zeros((rows, joints, 6))  # just outboard of the motion, before the flexure
        self.flexure = np.zeros((rows, joints, 6))  # together with the flexure's own twist
        self.loads: list[tuple[int, Array, Array]] = []  # body, force (N, 3), point (N, 3)
        self.tilt = np.zeros(3)  # rotation of gravity
        self.target = np.zeros((rows, 3))  # m, in the tip frame
        self.shift = np.zeros((rows, 3))  # m, in the instrument's frame
        self.scale = 0.0  # of the range

    def change(self, other: Push) -> float:
        if len(self.loads) != len(other.loads) or (self.tilt != other.tilt).any():
            return np.inf
        pairs = [(getattr(self, name), getattr(other, name)) for name in ("base", "link", "motion", "flexure")]
        return max(float(np.abs(a - b).max()) for a, b in pairs)


@dataclass
class State:
    """The arm at every row: link bodies behind their flexures and the tip, link ends, and loads in local axes."""

    rows: Rows
    frames: Array  # (N, joints + 1, 4, 4), the tip last
    ends: Array  # (N, joints + 1, 4, 4) before each joint's motion, the tip last
    wrenches: Array  # (N, joints, 6) at each flexure
    end_wrenches: Array  # (N, joints + 1, 6)
    base_wrench: Array  # (N, 6)
    push: Push
    twists: Array  # (N, joints, 6)


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
        return cls.read_text(arm.read_text(), arm.parent)

    @classmethod
    def read_text(cls, text: str, folder: Path = Path()) -> Plant:
        declared = tomllib.loads(text)
        root = ET.parse(folder / declared["robot"]["urdf"]).getroot()
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

    def settle(self, q: Array, mass: float, com: Array) -> list[Array]:
        """Frames of the loaded arm at one position: every link's body (behind its flexure), then the tip."""
        rows = Rows.plain(np.array(q, float)[None], np.array([mass], float), np.array(com, float)[None])
        return list(self.relax(rows).frames[0])

    def relax(
        self,
        rows: Rows,
        effects: Sequence[Callable[[State, Push], None]] = (),
        start: State | None = None,
        tolerance: float = 1e-14,
    ) -> State:
        """Return the equilibrium at every row under the effects."""
        count, joints = rows.q.shape
        offset = np.array([self.offset.get(j.name, 0.0) for j in self.joints])
        move = screw((rows.q + offset)[..., None] * np.array([j.drive for j in self.joints]))
        law = np.array([self.compliance.get(j.name, np.zeros((6, 6))) for j in self.joints])
        twists, push = (start.twists, start.push) if start else (np.zeros((count, joints, 6)), Push(count, joints))
        for _ in range(100):
            state = self.place(rows, move, twists, push)
            new = Push(count, joints)
            for effect in effects:
                effect(state, new)
            given = (law @ state.wrenches[..., None])[..., 0] + new.flexure
            change = max(float(np.abs(given - twists).max()), new.change(push))
            twists, push = given, new
            if change < tolerance:
                break
        else:
            raise ArithmeticError("the arm does not come to rest")
        return self.place(rows, move, twists, push)

    def place(self, rows: Rows, move: Array, twists: Array, push: Push) -> State:
        """Frames and loads for given twists."""
        fixed = [j.origin for j in self.joints] + [self.tip]
        T, frames, ends = screw(push.base[:, 0]), [], []
        base = T
        link, flexure = screw(push.link), screw(twists)
        move = move @ screw(push.motion) if push.motion.any() else move
        for i, origin in enumerate(fixed):
            T = T @ origin @ link[:, i]
            ends.append(T)
            if i < len(self.joints):
                T = T @ move[:, i] @ flexure[:, i]
            frames.append(T)
        at, ends = np.stack(frames, 1), np.stack(ends, 1)
        force, moment = self.totals(rows, at, push)
        return State(
            rows,
            at,
            ends,
            seen_from(at[:, :-1], force[:, :-1], moment[:, :-1]),
            seen_from(ends, force, moment),
            seen_from(base, force[:, 0], moment[:, 0]),
            push,
            twists,
        )

    def totals(self, rows: Rows, frames: Array, push: Push) -> tuple[Array, Array]:
        """Force and moment about the base origin (N, joints + 1, 3) on each body and all outboard of it."""
        gravity = turn(push.tilt) @ self.gravity
        force, moment = np.zeros((2, *frames.shape[:2], 3))
        weights = [
            (i, j.mass * np.tile(gravity, (len(rows.q), 1)), apply(frames[:, i], j.com))
            for i, j in enumerate(self.joints)
        ]
        payload = (len(self.joints), rows.mass[:, None] * gravity, apply(frames[:, -1], rows.com))
        for body, pull, point in [*weights, payload, *push.loads]:
            force[:, body] += pull
            moment[:, body] += np.cross(point, pull)
        return tuple(np.cumsum(x[:, ::-1], axis=1)[:, ::-1] for x in (force, moment))

    def points(self, state: State) -> Array:
        """The (N, 3) target in the base frame."""
        return apply(state.frames[:, -1], self.target + state.push.target)


def seen_from(T: Array, force: Array, moment: Array) -> Array:
    """Wrenches (..., 6) in the axes and about the origins of poses, of a force and its moment about the base."""
    about = moment - np.cross(T[..., :3, 3], force)
    turned = np.swapaxes(T[..., :3, :3], -1, -2)
    return np.concatenate([(turned @ v[..., None])[..., 0] for v in (force, about)], axis=-1)


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
        """Write measurements.csv; return what was true: instrument, session shifts, noise-free positions, tip axes."""
        rng = np.random.default_rng(self.seed)
        station = pose(rng.normal(0, 3, 3), turn(np.array([0, 0, rng.uniform(-3, 3)])))
        shifts = [pose(rng.normal(0, 2e-4, 3), turn(rng.normal(0, 2e-5, 3))) for _ in range(self.sessions)]
        rows, clean, axes = [], [], []
        for number in range(self.poses):
            q = np.array([rng.uniform(max(j.lower, -2.5) * 0.9, min(j.upper, 2.5) * 0.9) for j in plant.joints])
            for name, mass, com in self.payloads:
                session = number * self.sessions // self.poses
                tip = plant.settle(q, mass, np.array(com, float))[-1]
                read = shifts[session] @ station @ tip @ np.array([*plant.target, 1.0])
                clean.append(read[:3])
                axes.append((shifts[session] @ station @ tip)[:3, :3])
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
        return {"station": station, "shifts": np.array(shifts), "clean": np.array(clean), "axes": np.array(axes)}
