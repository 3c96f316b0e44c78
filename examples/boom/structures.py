"""Meshes of the bundled boom's joints: rings of solids, joined by rollers and drives that stiffen under load.

Everything is assumed, as the boom is. A joint of A1 to A6 is a housing and a shaft, two rings of C3D20R about its
axis. Rollers are springs along inclined lines of contact from ring to ring (four-point contact, Hertz: force by
compression to the power 1.5, with a little preload), and the drive is springs along the circumference, which stiffen as
gears do. The housing is held where the inner link is bolted to it, on one side. A4 has an upper and a lower such ring,
as in figure 2 of the source paper, whose shafts are joined to the tip (node 3) by two fork arms of solids. M1 is
three nested tubes with guide rollers at both ends of every overlap.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

SECTORS = 12
HEX = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
TURNS = {
    "z": np.eye(3),
    "y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "x": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
}
"""Axis of a joint -> rotation of z into it."""


@dataclass
class Model:
    """Nodes, bricks, springs and sets of a structure, written as an .inp file [m, N, kg]."""

    points: list[np.ndarray] = field(default_factory=list)
    elements: list[list[int]] = field(default_factory=list)
    springs: dict[str, tuple[str, list[tuple[int, int]]]] = field(default_factory=dict)
    sets: dict[str, list[int]] = field(default_factory=dict)

    def ring(
        self, inner: float, outer: float, levels: np.ndarray, centre: tuple[float, float, float] = (0, 0, 0)
    ) -> Ring:
        """Add a ring of C3D20R about z: one element across its wall; return its nodes by sector, side and level."""
        known: dict[tuple[int, ...], int] = {}

        def node(sector: float, wall: float, level: float) -> int:
            key = (round(2 * sector) % (2 * SECTORS), round(2 * wall), round(2 * level))
            if key not in known:
                angle = np.pi * key[0] / SECTORS
                radius = inner + 0.5 * key[1] * (outer - inner)
                z = np.interp(level, range(len(levels)), levels)
                self.points.append(np.add((radius * np.cos(angle), radius * np.sin(angle), z), centre))
                known[key] = len(self.points)
            return known[key]

        for sector in range(SECTORS):
            for level in range(len(levels) - 1):
                corners = [(sector + y, x, level + z) for x, y, z in HEX]
                middles = [np.add(corners[a], corners[b]) / 2.0 for a, b in EDGES]
                self.elements.append([node(*place) for place in (*corners, *middles)])
        return Ring(known)

    def box(self, start: np.ndarray, end: np.ndarray, counts: tuple[int, int, int], known: dict) -> None:
        """Add a box of C3D20R; corners at the same place as those in `known` are the same nodes."""
        for cell in np.ndindex(*counts):
            corners = [np.add(cell, h) for h in HEX]
            places = [*corners, *(np.add(corners[a], corners[b]) / 2.0 for a, b in EDGES)]
            own = []
            for place in places:
                point = start + (end - start) * place / counts
                key = tuple(np.round(point, 9))
                if key not in known:
                    self.points.append(point)
                    known[key] = len(self.points)
                own.append(known[key])
            self.elements.append(own)

    def hold(self, name: str, table: str, pairs: list[tuple[int, int]]) -> None:
        """Add springs of one law, (force, elongation) lines, between pairs of nodes."""
        self.springs[name] = (table, pairs)

    def write(self, path: Path, turn: np.ndarray) -> Path:
        """Write the model, its axes turned."""
        lines = ["*NODE"]
        lines += [
            f"{i}, {x:.12e}, {y:.12e}, {z:.12e}"
            for i, (x, y, z) in enumerate((np.array(self.points) @ turn.T).tolist(), 1)
        ]
        lines.append("*ELEMENT, TYPE=C3D20R, ELSET=SOLID")
        for number, own in enumerate(self.elements, 1):
            row = [str(number), *map(str, own)]
            lines += [", ".join(row[:12]) + ",", ", ".join(row[12:])]
        for name, nodes in self.sets.items():
            lines += [f"*NSET, NSET={name}", *map(str, sorted(set(nodes)))]
        number = len(self.elements)
        for name, (table, pairs) in self.springs.items():
            lines.append(f"*ELEMENT, TYPE=SPRINGA, ELSET={name}")
            lines += [f"{number + i}, {a}, {b}" for i, (a, b) in enumerate(pairs, 1)]
            number += len(pairs)
            lines += [f"*SPRING, ELSET={name}, NONLINEAR", table]
        lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", "2.1e11, 0.3", "*DENSITY", "7850."]
        lines += ["*SOLID SECTION, ELSET=SOLID, MATERIAL=STEEL"]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path


@dataclass
class Ring:
    """Nodes of a ring by twice their sector, wall (0 inside, 2 outside) and level."""

    known: dict[tuple[int, ...], int]

    def at(self, sector: int, wall: int, level: int) -> int:
        """Return a corner node."""
        return self.known[(2 * sector) % (2 * SECTORS), 2 * wall, 2 * level]

    def where(self, condition) -> list[int]:
        """Return the nodes whose (twice sector, wall, level) meet a condition."""
        return [node for key, node in self.known.items() if condition(*key)]


def roller(stiffness: float, preload: float) -> str:
    """Return the law of a line of contact [N/m^1.5, m]: it pushes, by compression to the power 1.5, preloaded."""
    travel = np.concatenate([-np.geomspace(2e-3, 1e-6, 40), [0.0], np.geomspace(1e-6, preload, 12), [5e-3]])
    force = stiffness * (preload**1.5 - np.maximum(preload - travel, 0.0) ** 1.5)
    return "\n".join(f"{f:.9e}, {e:.9e}" for f, e in zip(force, travel, strict=True))


def drive(stiffness: float, rated: float) -> str:
    """Return the law of a drive's spring [N/m, N]: from 0.6 to beyond 1.4 of its stiffness at the rated force."""
    half = np.geomspace(1e-7, 2e-2, 45)
    force = stiffness * half * (0.6 + 0.8 * np.minimum(stiffness * half / rated, 3.0) ** 0.5)
    travel, both = np.concatenate([-half[::-1], [0.0], half]), np.concatenate([-force[::-1], [0.0], force])
    return "\n".join(f"{f:.9e}, {e:.9e}" for f, e in zip(both, travel, strict=True))


@dataclass(frozen=True)
class Bearing:
    """Sizes of a ring: mean radius of its gap and height [m], of a contact [N/m^1.5], of its drive [Nm/rad, Nm]."""

    axis: str
    radius: float
    height: float
    contact: float
    stiffness: float = 0.0
    torque: float = 0.0
    preload: float = 2e-5


BEARINGS = {
    "A1": Bearing("z", 0.45, 0.40, 3.0e10, 8e6, 3e4),
    "A2": Bearing("y", 0.30, 0.60, 4.0e10, 1.2e7, 1.2e5),
    "A3": Bearing("z", 0.30, 0.60, 2.5e10, 6e6, 3e4),
    "A4": Bearing("z", 0.22, 0.20, 2.5e10, 1.494785e6, 1.222614e4),
    "A5": Bearing("z", 0.20, 0.44, 1.0e10, 2e6, 1e4),
    "A6": Bearing("x", 0.15, 0.24, 0.8e10, 1e6, 5e3),
}
"""A4 is one of its two rings."""


def bearing(model: Model, sizes: Bearing, name: str, centre: float = 0.0, driven: bool = True) -> tuple[Ring, Ring]:
    """Add a housing and a shaft about z with their rollers and drive; return both."""
    gap, step = 0.25 * sizes.height, 0.25 * sizes.height
    levels = centre + step * np.arange(-2, 3)
    wall = 0.35 * sizes.radius
    shaft = model.ring(sizes.radius - 0.5 * gap - wall, sizes.radius - 0.5 * gap, levels)
    housing = model.ring(sizes.radius + 0.5 * gap, sizes.radius + 0.5 * gap + wall, levels)
    pairs = [
        (shaft.at(sector, 1, level), housing.at(sector, 0, level + side))
        for sector in range(SECTORS)
        for level in (1, 3)
        for side in (-1, 1)
    ]
    model.hold(f"ROLLERS_{name}", roller(sizes.contact, sizes.preload), pairs)
    if driven:
        along = [(shaft.at(i, 1, 2), housing.at(i + side, 0, 2)) for i in range(SECTORS) for side in (-1, 1)]
        ends = np.array([[model.points[a - 1], model.points[b - 1]] for a, b in along])
        lever = abs(np.cross(ends[0, 0], ends[0, 1] - ends[0, 0])[2]) / np.linalg.norm(ends[0, 1] - ends[0, 0])
        each = len(along) * lever
        model.hold(f"DRIVE_{name}", drive(sizes.stiffness / (each * lever), sizes.torque / each), along)
    return shaft, housing


def bolted(housing: Ring) -> list[int]:
    """Return the outer nodes of a housing's inboard half."""
    return housing.where(lambda sector, wall, level: wall == 2 and SECTORS // 2 <= sector <= 3 * SECTORS // 2)


def ends(shaft: Ring) -> list[int]:
    """Return the nodes of a shaft's end faces."""
    return shaft.where(lambda sector, wall, level: level in (0, 8))


def hinge(name: str, path: Path) -> Path:
    """Write the joint of one pair of rings; its shaft's end faces carry the load."""
    model, sizes = Model(), BEARINGS[name]
    shaft, housing = bearing(model, sizes, name)
    model.sets = {"HELD": bolted(housing), "CARRIES": ends(shaft)}
    return model.write(path, TURNS[sizes.axis])


SPAN, REACH = 0.25, 0.6
"""A4: half the distance of its rings, and where its tip is along x [m]."""


def fork(path: Path, part: str) -> Path:
    """Write A4: one "ring" about the origin, one "arm" beside it with its weld, or the "whole" up to the tip.

    What carries the ring is the face of its shaft that the arm is welded to. Of the arm that face is held.
    """
    model, sizes = Model(), BEARINGS["A4"]
    held: list[int] = []
    tip: list[int] = []
    for name, centre in {"whole": (("UPPER", SPAN), ("LOWER", -SPAN))}.get(part, ((part.upper(), 0.0),)):
        shaft, housing = bearing(model, sizes, name, centre, driven=name in ("LOWER", "RING"))
        face = shaft.where(
            lambda sector, wall, level: (
                level in (0, 4, 8) and wall == 2 and not SECTORS // 4 < sector < 7 * SECTORS // 4
            )
        )
        held += [*shaft.known.values(), *housing.known.values()] if part == "arm" else bolted(housing)
        if part == "ring":
            tip = face
            continue
        known: dict = {}
        model.box(np.array([0.26, -0.15, centre - 0.1]), np.array([REACH, 0.15, centre + 0.1]), (3, 2, 1), known)
        near = [node for key, node in known.items() if abs(key[0] - 0.26) < 1e-9]
        tip += [node for key, node in known.items() if abs(key[0] - REACH) < 1e-9]
        stiff = "\n".join(f"{f:.9e}, {e:.9e}" for f, e in ((-2e8, -1e-2), (0.0, 0.0), (2e8, 1e-2)))
        model.hold(f"WELD_{name}", stiff, [(a, b) for a in face for b in near if a % 2 == b % 2])
    model.sets = {"HELD": held, "CARRIES": tip}
    return model.write(path, np.eye(3))


STAGE, TUBES = 3.5, (0.42, 0.35, 0.28)
"""M1: length of a stage, and mean radii [m]."""


def mast(path: Path, extension: float, step: float = 0.5) -> Path:
    """Write M1 at an extension [m], a multiple of 2 `step` from 0 to 6 m: its frame is at the last stage's lower end.

    Elements are `step` [m] long.
    """
    model, rings, tops = Model(), [], []
    levels = round(STAGE / step)
    for number, radius in enumerate(TUBES):
        low = -0.5 * extension * number
        rings.append(model.ring(radius - 0.012, radius + 0.012, low + step * np.arange(levels + 1)))
        tops.append(low)
    for outer in range(len(TUBES) - 1):
        shift = round((tops[outer] - tops[outer + 1]) / step)
        guides, along, ropes = [], [], []
        for level in (0, levels - shift):  # of the outer stage: the overlap's ends
            for sector in range(SECTORS):
                inside = level + shift
                guides.append((rings[outer + 1].at(sector, 1, inside), rings[outer].at(sector, 0, level)))
                along += [
                    (rings[outer + 1].at(sector, 1, inside), rings[outer].at(sector + s, 0, level)) for s in (-1, 1)
                ]
        for sector in range(SECTORS):
            ropes.append((rings[outer + 1].at(sector, 1, levels - 1), rings[outer].at(sector, 0, levels - shift)))
        model.hold(f"GUIDES_{outer}", roller(1.5e9, 1e-4), guides)
        model.hold(f"TURN_{outer}", drive(4e7, 2e4), along)
        model.hold(f"ROPES_{outer}", drive(2e7, 2e4), ropes)
    first, last = rings[0], rings[-1]
    model.sets = {
        "HELD": first.where(lambda sector, wall, level: level == 2 * levels),
        "CARRIES": last.where(lambda sector, wall, level: level == 0),
    }
    return model.write(path, np.eye(3))
