"""Where the instrument stands: what a level one knows of gravity, whatever campaign the arm was fitted to before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import three_joint_plant
from support.plant import Rows, apply, pose, turn

from armflex import calibrate, load_arm, predict, read_measurements
from armflex.estimate.calibrate import write_calibrated

TILT = turn(np.array([0.25, -0.1, 0.0]))
"""How the base stands under level instruments."""

SOFT = "compliance = [0.0, 0.0, 0.0, 1e-5, 4e-5, 1e-5]"


@pytest.fixture(scope="module")
def level(tmp_path_factory) -> tuple[Path, list[Path]]:
    """An arm on a tilted base, and campaigns of it from two places of a level instrument."""
    folder = tmp_path_factory.mktemp("level")
    three_joint_plant.declared(folder)
    text = (folder / "arm.toml").read_text().replace('"unknown"', '"unknown"\ngravity_in = "measurement"')
    (folder / "arm.toml").write_text(text.replace("compliance = [0.0, 0.0, 0.0, 1e-6, 4e-6, 1e-6]", SOFT))
    plant, rng, files = three_joint_plant.Plant.read(folder / "arm.toml"), np.random.default_rng(2), []
    plant.gravity = TILT.T @ plant.gravity
    for number, heading in enumerate((0.7, -2.0)):
        q = rng.uniform(-1.2, 1.2, (60, 3))
        station = pose(np.array([2.0, -1.0, 0.3]), turn(np.array([0.0, 0.0, heading])) @ TILT)
        read = apply(station, plant.points(plant.relax(Rows.plain(q, np.zeros(60), np.zeros((60, 3))))))
        read += rng.normal(0.0, three_joint_plant.SIGMA, read.shape)
        files.append(three_joint_plant.write_campaign(folder / f"{number}.csv", q, read))
    return folder / "arm.toml", files


@pytest.mark.parametrize("keep", [True, False])
def test_gravity_is_turned_once_however_often_an_arm_is_calibrated(level, tmp_path: Path, keep: bool) -> None:
    file, (first, second) = level
    arm = load_arm(file)
    known = calibrate(arm, read_measurements(first, arm))
    written = load_arm(write_calibrated(file, known, tmp_path / "arm.toml"))
    for one in (known.arm, written):
        np.testing.assert_allclose(one.robot.gravity, TILT.T @ [0.0, 0.0, -9.81], atol=2e-3)
        again = calibrate(one, read_measurements(second, one), keep=keep)
        np.testing.assert_allclose(again.arm.robot.gravity, one.robot.gravity, atol=2e-3)
        rows = read_measurements(second, again.arm)
        error = predict(again.arm, rows).position - rows.position
        assert np.sqrt((error**2).sum(axis=1).mean()) < 1.1 * np.sqrt(3.0) * three_joint_plant.SIGMA
