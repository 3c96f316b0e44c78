"""Rows of a campaign as its file holds them."""

import csv
from pathlib import Path

import numpy as np

from armflex import Measurements

JOINTS = tuple(f"J{i}" for i in range(1, 7))


def campaign(count: int = 12, seed: int = 0) -> list[dict[str, object]]:
    """Return rows of poses within a few metres of the instrument."""
    rng = np.random.default_rng(seed)
    rows = []
    for i in range(count):
        identity = {"pose": f"p{i}", "session": "s0", "time": 10.0 * i, "payload": "none"}
        joints = {f"q_{name}": float(value) for name, value in zip(JOINTS, rng.uniform(-1.0, 1.0, 6), strict=True)}
        place = {axis: float(value) for axis, value in zip("xyz", rng.uniform(1.0, 3.0, 3), strict=True)}
        rows.append(identity | joints | place | {"sigma": 2e-4})
    return rows


def written(folder: Path, rows: list[dict[str, object]], name: str = "rows.csv") -> Path:
    path = folder / name
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return path


def codes(found: Measurements) -> list[str]:
    return [flag.code for flag in found.flags]
