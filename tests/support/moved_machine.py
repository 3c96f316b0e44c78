"""Campaigns of one machine of three joints on several sites: base, level instrument and target anew in each."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from support import three_joint_plant
from support.campaign_files import numbers, write_columns
from support.plant import Rows, apply, pose, turn
from support.three_joint_plant import SIGMA

LEVEL = '[measurement]\nframe = "unknown"\ngravity_in = "measurement"'


@dataclass(frozen=True)
class Site:
    """Where a campaign is taken.

    Attributes:
        slope: (3,) rotation vector of the base from level [rad].
        turn: How the instrument is turned about the vertical [rad].
        target: (3,) of the tip frame [m].
        fixed: Joint positions that are the same in all rows, by number [rad].
        count: Of its rows.
    """

    slope: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: float = 0.7
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fixed: Mapping[int, float] | None = None
    count: int = 40


SITES = {"flat": Site(), "hill": Site((0.15, -0.1, 0.0), 2.1, (0.004, -0.002, 0.003))}


def declare(folder: Path, prior: str = "joint_offset = 1e-3\ncompliance = 0.2\ntool = 0.005") -> Path:
    """Write the arm, measured by a level instrument."""
    three_joint_plant.declared(folder)
    file, text = folder / "arm.toml", three_joint_plant.ARM
    head, _ = text.replace("1e-6, 4e-6, 1e-6", "1e-5, 4e-5, 1e-5").split("[prior]")
    file.write_text(head.replace('[measurement]\nframe = "unknown"', LEVEL) + f"[prior]\n{prior}\n")
    return file


def measure(
    folder: Path,
    sites: Mapping[str, Site] = SITES,
    offsets: Mapping[int, float] | None = None,
    softer: float = 1.0,
    seed: int = 3,
    noise: float = SIGMA,
) -> list[Path]:
    """Write a campaign from every site, of a machine with other joint zeros [rad] that gives so many times as much."""
    rng, files = np.random.default_rng(seed), []
    for name, site in sites.items():
        plant = three_joint_plant.Plant.read(folder / "arm.toml")
        plant.compliance = {at: softer * own for at, own in plant.compliance.items()}
        plant.offset = {plant.joints[i].name: value for i, value in (offsets or {}).items()}
        station = pose(np.array([2.0, -1.0, 0.3]), turn(np.array([0.0, 0.0, site.turn])) @ turn(np.array(site.slope)))
        plant.gravity, plant.target = station[:3, :3].T @ plant.gravity, np.array(site.target)
        q = rng.uniform(-1.2, 1.2, (site.count, 3))
        for joint, value in (site.fixed or {}).items():
            q[:, joint] = value
        rows = Rows.plain(q, np.zeros(site.count), np.zeros((site.count, 3)))
        read = apply(station, plant.points(plant.relax(rows))) + rng.normal(0.0, 1.0, (site.count, 3)) * noise
        columns: dict[str, list] = {f"q_J{i + 1}": numbers(q[:, i]) for i in range(3)}
        columns |= dict(zip("xyz", map(numbers, read.T), strict=True)) | {"sigma": [SIGMA] * site.count}
        files.append(folder / f"{name}.csv")
        write_columns(files[-1], columns)
    return files
