"""Meshes of bars for tests: structured solids written as .inp, and what beams of them do."""

from pathlib import Path

import numpy as np

HEX = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
TET_EDGES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
TETS = [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)]
STEEL = ("*MATERIAL, NAME=STEEL", "*ELASTIC", "2.1e11, 0.3", "*DENSITY", "7850.")


def bar(
    kind: str, counts: tuple[int, int, int], size: tuple[float, float, float], hollow: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) points and (E, k) nodes of a bar along x, or of a tube with `hollow` cells of wall."""
    points: dict[tuple[float, ...], int] = {}
    elements = []
    for i, j, k in np.ndindex(*counts):
        if hollow and hollow <= j < counts[1] - hollow and hollow <= k < counts[2] - hollow:
            continue
        corners = [np.add(h, (i, j, k)) for h in HEX]
        for own in TETS if kind in ("C3D4", "C3D10") else [range(8)]:
            places = [corners[a] for a in own]
            edges = {"C3D10": TET_EDGES, "C3D20": EDGES}.get(kind, [])
            places += [np.add(places[a], places[b]) / 2.0 for a, b in edges]
            elements.append([points.setdefault(tuple(place), len(points)) for place in places])
    return np.array(list(points)) * np.array(size) / counts, np.array(elements)


def write_bar(
    path: Path, kind: str, points: np.ndarray, nodes: np.ndarray, head: tuple[str, ...] = (), scale: float = 1.0
) -> Path:
    """Write a bar as .inp with the sets ROOT and TIP at its ends."""
    lines = [*head, "*NODE"]
    lines += [f"{i}, {x * scale!r}, {y * scale!r}, {z * scale!r}" for i, (x, y, z) in enumerate(points.tolist(), 1)]
    lines.append(f"*ELEMENT, TYPE={kind}, ELSET=ALL")
    for i, own in enumerate(nodes.tolist(), 1):
        row = [i, *(n + 1 for n in own)]
        lines += [
            ", ".join(map(str, row[s : s + 12])) + ("," if s + 12 < len(row) else "") for s in range(0, len(row), 12)
        ]
    for name, place in (("ROOT", points[:, 0].min()), ("TIP", points[:, 0].max())):
        lines += [f"*NSET, NSET={name}", *(str(i + 1) for i in np.flatnonzero(np.abs(points[:, 0] - place) < 1e-9))]
    lines += [*STEEL, "*SOLID SECTION, ELSET=ALL, MATERIAL=STEEL"]
    path.write_text("\n".join(lines) + "\n")
    return path
