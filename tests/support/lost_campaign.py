"""Campaigns of a six-axis arm, by numpy alone: two rows exchanged, one reading far off, and a first joint that stands
upright and bends, so that hardly any load shows by how much.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from armflex.conventions import Array

JOINTS = (  # place, axis, mass, centre of mass
    ((0, 0, 0.35), (0, 0, 1), 20.0, (0, 0, 0.1)),
    ((0.1, 0, 0.15), (0, 1, 0), 18.0, (0, 0, 0.25)),
    ((0, 0, 0.55), (0, 1, 0), 12.0, (0.05, 0, 0.05)),
    ((0.15, 0, 0.1), (1, 0, 0), 6.0, (0.15, 0, 0)),
    ((0.4, 0, 0), (0, 1, 0), 3.0, (0.04, 0, 0)),
    ((0.1, 0, 0), (1, 0, 0), 1.5, (0.02, 0, 0)),
)
FLANGE, TARGET = np.array([0.05, 0.0, 0.0]), np.array([0.05, 0.03, 0.08])
STIFFNESS = (1e5, 1e5, 6e4, 2e4, 1.5e4, 1e4)
TRAVEL = (1.8, 0.9, 0.9, 1.8, 1.2, 1.8)
PRIOR = "[prior]\njoint_offset = 2e-3\ntool = 0.3\ngeometry = 1e-3\ncompliance = 0.5\n"

SIGMA, OFF, GEOMETRY, SOFTER, FAR = 5e-5, 1e-3, 5e-4, 0.3, 0.03
"""Of a reading [m], of joints' zeros [rad], of frames [m, rad], of compliances, and of the lost beam [m]."""


def write_arm(folder: Path, flexures: str = "", prior: str = PRIOR) -> Path:
    """Write the arm as declared; by default each drive bends as `STIFFNESS` has it."""
    links, parent = ['<robot name="six"><link name="base"/><link name="tool"/>'], "base"
    for number, (place, axis, mass, com) in enumerate(JOINTS, 1):
        inertia = " ".join(f'i{a}="{mass * 0.01 * (a[0] == a[1])}"' for a in ("xx", "yy", "zz", "xy", "xz", "yz"))
        body = f'<origin xyz="{_spaced(com)}"/><mass value="{mass}"/><inertia {inertia}/>'
        links.append(f'<link name="L{number}"><inertial>{body}</inertial></link>')
        links.append(f'<joint name="J{number}" type="revolute"><parent link="{parent}"/><child link="L{number}"/>')
        links.append(f'<origin xyz="{_spaced(place)}"/><axis xyz="{_spaced(axis)}"/>')
        links.append('<limit lower="-3" upper="3" effort="2000" velocity="2"/></joint>')
        parent = f"L{number}"
    links.append('<joint name="flange" type="fixed"><parent link="L6"/><child link="tool"/>')
    links.append(f'<origin xyz="{_spaced(FLANGE.tolist())}"/></joint></robot>')
    (folder / "six.urdf").write_text("\n".join(links))
    drives = (f'[flexure.f{i}]\njoint = "J{i}"\njoint_stiffness = {k:g}\n' for i, k in enumerate(STIFFNESS, 1))
    head = '[robot]\nurdf = "six.urdf"\ntip = "tool"\ngravity = [0.0, 0.0, -9.81]\n[measurement]\nframe = "unknown"\n'
    path = folder / "arm.toml"
    path.write_text(f"{head}{prior}{flexures or ''.join(drives)}")
    return path


def _spaced(numbers: Sequence[float]) -> str:
    return " ".join(map(repr, numbers))


def write_campaign(folder: Path, seed: int, count: int = 40) -> tuple[Path, set[int]]:
    """Write a campaign of a machine that differs from the arm; return it, and the three rows that are wrong."""
    rng = np.random.default_rng(1000 + seed)
    stiffness = np.array(STIFFNESS) * np.exp(SOFTER * rng.normal(size=6))
    off, shifts, turns = OFF * rng.normal(size=6), *(GEOMETRY * rng.normal(size=(2, 6, 3)))
    draws = np.random.default_rng(seed)
    q = np.column_stack([draws.uniform(-one, one, count) for one in TRAVEL])
    points = np.array([_rest(own + off, stiffness, shifts, turns) for own in q])
    heading = np.random.default_rng(seed).uniform(-3.0, 3.0)
    frame = Rotation.from_euler("xyz", [0.02, -0.03, heading])
    read = frame.apply(points) + [2.1, -1.4, 0.9] + SIGMA * rng.normal(size=points.shape)
    i, j = rng.choice(count, 2, replace=False).tolist()
    read[[i, j]] = read[[j, i]]
    lost = int(rng.choice([row for row in range(count) if row not in (i, j)]))
    way = rng.normal(size=3)
    read[lost] += FAR * way / np.linalg.norm(way)
    lines = [",".join([*(f"q_J{n}" for n in range(1, 7)), "x,y,z,sigma"])]
    lines += [",".join(map(repr, (*a, *b, SIGMA))) for a, b in zip(q.tolist(), read.tolist(), strict=True)]
    path = folder / "rows.csv"
    path.write_text("\n".join(lines) + "\n")
    return path, {i, j, lost}


def _rest(q: Array, stiffness: Array, shifts: Array, turns: Array) -> Array:
    """Return (3,) where the target comes to rest in the base [m], each drive a spring about its axis."""
    bent = np.zeros(6)
    for _ in range(200):
        turn, place, drives, bodies = Rotation.identity(), np.zeros(3), [], []
        for (at, axis, mass, com), shift, tilt, angle in zip(JOINTS, shifts, turns, q + bent, strict=True):
            place = place + turn.apply(np.array(at) + shift)
            turn = turn * Rotation.from_euler("xyz", tilt)
            drives.append((place, turn.apply(axis)))
            turn = turn * Rotation.from_rotvec(angle * np.array(axis))
            bodies.append((place + turn.apply(com), np.array([0.0, 0.0, -9.81 * mass])))
        torque = [
            sum(axis @ np.cross(at - place, weight) for at, weight in bodies[number:])
            for number, (place, axis) in enumerate(drives)
        ]
        before, bent = bent, np.array(torque) / stiffness
        if np.abs(bent - before).max() < 1e-13:
            break
    return place + turn.apply(FLANGE + TARGET)
