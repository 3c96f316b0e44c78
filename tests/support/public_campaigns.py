"""The two public campaigns that travel with the tests (P. Jacobi, serial_robots_datasets, MIT: see LICENSE in each)."""

from __future__ import annotations

from pathlib import Path

from armflex import Arm
from armflex.measured.measurements import Measurements, read_measurements
from support.effect_arms import quietly

MEASURED = Path(__file__).parents[1] / "measured"


def public(name: str) -> tuple[Arm, Measurements]:
    """Return an arm as declared and its campaign: ur5_tsinghua (1000 poses) or wam_tsinghua (216)."""
    arm = quietly(MEASURED / name / "arm.toml")
    return arm, read_measurements(MEASURED / name / "campaign.csv", arm)
