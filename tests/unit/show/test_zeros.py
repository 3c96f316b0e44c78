"""A calibration's page and the sheet for the controller have one number, and one uncertainty, for a joint's zero."""

import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import write_columns

from armflex import calibrate, load_arm
from armflex.export.sheet import joint_zeros
from armflex.measured.measurements import read_measurements
from armflex.show.report import write_report

ZEROS = np.array([0.0, -1.2e-3, 0.9e-3])
DECLARED = """[robot]
dh = "standard"
gravity = [0.0, 0.0, -9.81]
[robot.joint]
A1 = { d_mm = 450, a_mm = 150, alpha_deg = -90 }
A2 = { theta_deg = -90, a_mm = 850 }
A3 = { a_mm = 600 }
[measurement]
frame = "base"
[prior]
joint_offset = 2e-3
geometry = 1e-3
"""


@pytest.mark.filterwarnings("ignore::armflex.ArmflexWarning")
def test_the_page_has_the_zeros_that_go_into_the_controller(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(DECLARED)
    arm, rng = load_arm(tmp_path / "arm.toml"), np.random.default_rng(2)
    q = rng.uniform(-1.5, 1.5, (40, 3))
    seen = np.array([arm.rigid_pose(row + ZEROS).translation for row in q]) + rng.normal(0.0, 2e-5, (40, 3))
    columns = {f"q_{name}": q[:, i].tolist() for i, name in enumerate(arm.joint_names)}
    write_columns(tmp_path / "c.csv", columns | dict(zip("xyz", seen.T.tolist(), strict=True)) | {"sigma": [2e-5] * 40})
    calibration = calibrate(arm, read_measurements(tmp_path / "c.csv", arm))
    zeros = joint_zeros(calibration.arm)
    for name, zero in zip(arm.joint_names[1:], ZEROS[1:], strict=True):
        value, std, unit = zeros[name]
        assert unit == "rad" and std < 2e-4 and abs(value - zero) < 4.0 * std
    alone = next(p for p in calibration.parameters if p.name == "joint_offset A2")
    assert alone.std > 5.0 * zeros["A2"][1]  # what turns the frame about the axis does as well
    write_report(calibration, tmp_path / "page.html")
    text = unescape(re.sub(r"<[^>]+>", " ", (tmp_path / "page.html").read_text()))
    value, std, _ = zeros["A2"]
    row = re.search(r"is added to its reading.*?A2\s+(−[\d.]+) ± ([\d.]+) mrad", text, re.S)
    assert row is not None and float(row[1].replace("−", "-")) == pytest.approx(1e3 * value, abs=1e3 * std)
    assert float(row[2]) == pytest.approx(1e3 * std, rel=0.1)
