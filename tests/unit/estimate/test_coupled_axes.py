"""Axes that are coupled, which the columns do not say, are asked about by the parts that they are coupled by."""

import re
from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import write_columns

from armflex import calibrate, load_arm
from armflex.errors import ConventionError
from armflex.measured.measurements import read_measurements

DECLARED = """[robot]
dh = "standard"
gravity = [0.0, 0.0, -9.81]
[robot.joint]
A1 = { d_mm = 450, a_mm = 150, alpha_deg = -90 }
A2 = { theta_deg = -90, a_mm = 600 }
A3 = { a_mm = 120, alpha_deg = -90 }
A4 = { d_mm = 600, alpha_deg = 90 }
A5 = { alpha_deg = -90 }
A6 = { d_mm = 100 }
[measurement]
frame = "unknown"
[prior]
joint_offset = 2e-3
tool = 0.2
geometry = 1e-3
"""
pytestmark = pytest.mark.filterwarnings("ignore::armflex.ArmflexWarning")


def campaign(folder: Path, by: np.ndarray, moved: np.ndarray | float = 0.0) -> list[str]:
    """Return what is asked about axes of a campaign whose columns q are those of joints at q A + b."""
    (folder / "arm.toml").write_text(DECLARED)
    arm, rng = load_arm(folder / "arm.toml"), np.random.default_rng(3)
    q = rng.uniform(-1.5, 1.5, (60, 6))
    errors = moved * np.sin(2.0 * q) if np.ndim(moved) else moved
    pose = np.array([arm.rigid_pose(row).homogeneous for row in q @ by + errors])
    seen = pose[:, :3, 3] + pose[:, :3, :3] @ [0.05, 0.03, 0.08] + [2.0, -1.0, 0.5] + rng.normal(0.0, 2e-5, (60, 3))
    columns = {f"q_{name}": q[:, i] for i, name in enumerate(arm.joint_names)}
    columns |= {name: seen[:, i] for i, name in enumerate("xyz")} | {"sigma": [2e-5] * 60}
    write_columns(folder / "campaign.csv", {name: list(map(float, values)) for name, values in columns.items()})
    flags = calibrate(arm, read_measurements(folder / "campaign.csv", arm)).flags
    return [flag.text for flag in flags if flag.code == "coupled_axes"]


def test_parts_of_a_wrist_s_gears_are_named(tmp_path: Path) -> None:
    by = np.eye(6)
    by[3, 4], by[3, 5], by[4, 5] = 0.01, -0.0125, 0.02
    (said,) = campaign(tmp_path, by)
    sums = re.search(r"A5 = q_A5 \+ (\S+) q_A4, A6 = q_A6 - (\S+) q_A4 \+ (\S+) q_A5:", said)
    assert sums is not None and list(map(float, sums.groups())) == pytest.approx([0.01, 0.0125, 0.02], rel=0.05)


def test_a_part_that_is_refused_is_named_in_the_refusal(tmp_path: Path) -> None:
    by = np.eye(6)
    by[1, 2] = 0.02
    with pytest.raises(ConventionError, match=r"A3 = q_A3 \+ 0.0\d+ q_A2:"):
        campaign(tmp_path, by)


@pytest.mark.parametrize("what", ["nothing", "a scale", "eccentric gears"])
def test_what_is_no_coupling_is_not_called_one(what: str, tmp_path: Path) -> None:
    by = np.diag([1.0, 1.0, 1.0, 1.003, 1.0, 1.0]) if what == "a scale" else np.eye(6)
    assert campaign(tmp_path, by, np.full(6, 4e-4) if what == "eccentric gears" else 0.0) == []
