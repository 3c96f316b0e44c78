"""A path whose payload changes on an arm with loops: every task says of each row what the arm does there alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import write_columns
from support.fixtures import ROBOTS

from armflex import check, compensate, load_arm, predict, read_measurements, read_trajectory
from armflex.export import programs

LOAD = {"a": "", "b": "t125"}


@pytest.mark.parametrize("split", ["abab", "aaabb", "baaab"])
def test_every_task_takes_a_payload_that_changes_from_row_to_row(split: str, tmp_path: Path) -> None:
    arm, file = load_arm(ROBOTS / "hybrid_lifter" / "arm.toml"), tmp_path / "path.csv"
    steps = np.arange(len(split))[:, None] * np.array([0.01, 0.01, 0.02, 0.005, 0.004])
    q = np.array([0.1, 0.1, 1.7, 0.95, 0.95]) + steps
    columns = {f"q_{name}": q[:, j].tolist() for j, name in enumerate(arm.joint_names)}
    payloads = [LOAD[letter] for letter in split]
    write_columns(file, {"time": (20.0 * np.arange(len(split))).tolist(), **columns, "payload": payloads})

    rows = [(at, name or None) for at, name in zip(q, payloads, strict=True)]
    alone = [replace(arm).deflection(*row) for row in rows]
    predicted = predict(arm, read_measurements(file, arm, inputs_only=True))
    np.testing.assert_allclose(predicted.displacement, [one.displacement for one in alone], rtol=0, atol=1e-11)
    np.testing.assert_allclose(predicted.position, [one.pose.translation for one in alone], rtol=0, atol=1e-11)

    path = read_trajectory(file, arm)
    report = check(arm, path, 1.0)
    lengths = [np.linalg.norm(one.displacement[:3]) for one in alone]
    assert [point.displacement_m for point in report.rows] == pytest.approx(lengths, abs=1e-11)

    moved = compensate(arm, path)
    for at, (start, payload) in zip(moved.trajectory.q, rows, strict=True):
        loaded, meant = replace(arm).deflection(at, payload).pose, arm.rigid_pose(start)
        np.testing.assert_allclose(loaded.translation, meant.translation, rtol=0, atol=1e-6)
    assert max(point.displacement_m for point in check(arm, moved.trajectory, 1.0).rows) < 1e-6

    yaml = pytest.importorskip("yaml")
    points = yaml.safe_load(programs.jointtrajectory(arm, file, compensate=True).text)["points"]
    np.testing.assert_allclose([point["positions"] for point in points], moved.trajectory.q, rtol=0, atol=1e-7)
