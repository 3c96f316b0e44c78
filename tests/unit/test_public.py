"""Real machines: the public UR5 and WAM, calibrated and traced, and the converters of published layouts."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import public as scoreboard
import pytest
from support.effect_arms import quietly
from support.public_campaigns import MEASURED, public

from armflex import calibrate, predict, trace
from armflex.cli.calibrate_command import as_json
from armflex.cli.trace_command import print_trace
from armflex.errors import ConvergenceError
from armflex.estimate.calibrate import Calibration
from armflex.estimate.fit import Effort, fit
from armflex.estimate.held_out import apart_folds


@pytest.fixture(scope="module")
def ur5() -> Calibration:
    return calibrate(*public("ur5_tsinghua"))


def test_the_ur5_is_calibrated_to_a_ninth_of_a_millimetre(ur5: Calibration) -> None:
    assert ur5.held_out is not None and 1e3 * ur5.held_out[1] < 0.115


def test_what_only_a_combination_tells_is_marked(ur5: Calibration) -> None:
    """Axes 2, 3 and 4 are parallel: shifts along them add up, and each by itself is told by its prior alone."""
    found, axes = {one.name: one for one in ur5.parameters}, ("shoulder_lift", "elbow", "wrist_1")
    along = [found[f"geometry {joint}_joint dy"] for joint in axes]
    assert all(one.determined and one.combined for one in along)
    assert all({other.name for other in along} - {one.name} <= set(one.trades_against) for one in along)
    assert found["geometry elbow_joint dz"].determined and not found["geometry elbow_joint dz"].combined
    assert {one["name"] for one in as_json(ur5)["parameters"] if one["only_combined_with"]} >= {a.name for a in along}


def test_a_fit_that_does_not_settle_names_what_resists(ur5: Calibration) -> None:
    short = Effort(2, 0.0, content=False)
    with pytest.raises(ConvergenceError, match=r"still moving: geometry .* left is at .*campaign.csv:\d+"):
        fit(ur5.fit.declared, ur5.fit.blocks, ur5.measurements, effort=short)


def test_poses_too_few_to_tell_an_effect_from_chance_are_said_to_be(capsys: pytest.CaptureFixture) -> None:
    arm, measurements = public("ur5_tsinghua")
    stiff = replace(arm, prior=replace(arm.prior, joint_offset=1e-5, geometry=0.0))
    found = trace(stiff, measurements.some(np.arange(0, len(measurements), 150)))
    assert not found.found and found.undecided is not None
    assert found.undecided.poses == 7 and found.undecided.rms > 3.0 * found.undecided.stated
    print_trace(found)
    said = capsys.readouterr().out
    assert "cannot decide what is missing: 0.893 mm RMS" in said and "No further effect" not in said


@pytest.mark.slow
def test_the_wam_is_calibrated_to_two_and_a_half_millimetres() -> None:
    found = calibrate(*public("wam_tsinghua"))
    assert found.held_out is not None and 1e3 * found.held_out[1] < 2.4


@pytest.mark.slow
def test_a_traced_ur5_predicts_poses_that_it_has_not_seen() -> None:
    """The published hybrid network: 0.155 mm, mean of 20 poses; calibrated kinematics alone: 0.103 mm."""
    arm, measurements = public("ur5_tsinghua")
    learned = np.arange(0, len(measurements), 3)
    found = trace(arm, measurements, learned)
    rest = np.setdiff1d(np.arange(len(measurements)), learned)
    error = np.linalg.norm(predict(found.arm, measurements).position - measurements.position, axis=1)
    assert 1e3 * error[rest].mean() < 0.070
    # What is stated of poses held out is what other poses get, of a fit to a fifth fewer rows: 250 rows get 0.062 mm.
    other = np.sqrt((error[rest] ** 2).mean())
    assert other < found.held_out[1] < 1.15 * other
    assert found.at_every_drive and all(len(one.members) > 1 for one in found.at_every_drive)


def test_the_published_layout_is_read(tmp_path: Path) -> None:
    """Target and difference in mm, joints in degrees: the campaign that travels with the tests, to rounding."""
    arm, measurements = public("wam_tsinghua")
    folder = tmp_path / "published" / "WAM"
    folder.mkdir(parents=True)
    rows = list(csv.DictReader((MEASURED / "wam_tsinghua" / "campaign.csv").open()))
    head = ["step_order", "x_t", "y_t", "z_t", "x_dif", "y_dif", "z_dif", *(f"joint_{i + 1}" for i in range(7))]
    with (folder / "3D_WAM_uncalibrated_grid_cleaned.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        for number, row in enumerate(rows):
            target = [round(float(row[f"{axis}_mm"])) for axis in "xyz"]
            difference = [float(row[f"{axis}_mm"]) - one for axis, one in zip("xyz", target, strict=True)]
            writer.writerow([number, *target, *difference, *(row[f"q_j{i + 1}_deg"] for i in range(7))])
    scoreboard.from_tsinghua(tmp_path / "published", tmp_path / "converted")
    ((name, file, table),) = scoreboard.campaigns(tmp_path / "converted")
    assert name == "wam_tsinghua" and (file.parent / "LICENSE").exists()
    again = scoreboard.read_measurements(table, arm)
    np.testing.assert_allclose(again.q, measurements.q, atol=1e-12)
    np.testing.assert_allclose(again.position, measurements.position, atol=1e-12)


def test_parts_of_joint_space_lie_apart() -> None:
    q = np.random.default_rng(0).normal(size=(200, 6))
    part = apart_folds(q, 4)
    assert sorted(np.unique(part)) == [0, 1, 2, 3] and np.bincount(part).min() > 10
    far = np.linalg.norm(q[:, None] - q, axis=2)
    np.fill_diagonal(far, np.inf)
    apart = np.where(part[:, None] != part, far, np.inf).min(axis=1).mean()
    mixed = np.random.default_rng(1).permutation(part)
    assert apart > np.where(mixed[:, None] != mixed, far, np.inf).min(axis=1).mean()


@pytest.mark.slow
def test_decimal_commas_and_stations_are_read(tmp_path: Path) -> None:
    """The layouts of the UR10 (semicolons, mm, decimal commas) and of the lifting column (YAML by station)."""
    yaml = pytest.importorskip("yaml")
    urdf = (MEASURED / "ur5_tsinghua" / "robot.urdf").read_text()
    (tmp_path / "ur10_robot.urdf").write_text(urdf)
    arm = quietly(MEASURED / "ur5_tsinghua" / "arm.toml")
    series = tmp_path / "ipa" / "Series_B"
    series.mkdir(parents=True)
    head = [*arm.joint_names, *(f"measurement_{axis}" for axis in "xyz")]
    rows = ["-3,14159;-1,5708;0;-1,5708;0;0;383,76294;-3240,8734;201,93157"] * 2
    (series / "measurements_joint_configurations.csv").write_text("\n".join([";".join(head), *rows]))
    (series / "measurements_grid.csv").write_text("Goal x;measurement_x\n1,0;2,0")  # no joint positions: left out
    scoreboard.from_ipa(tmp_path, tmp_path / "converted")
    ((name, _, table),) = scoreboard.campaigns(tmp_path / "converted")
    found = scoreboard.read_measurements(table, arm)
    assert name == "ipa_ur10" and found.session == ("Series_B",) * 2
    np.testing.assert_allclose(found.q[0], [-3.14159, -1.5708, 0.0, -1.5708, 0.0, 0.0])
    np.testing.assert_allclose(found.position[0], [0.38376294, -3.2408734, 0.20193157])
    data = tmp_path / "hilti" / "data"
    (data / "datasets").mkdir(parents=True)
    (data / "trailblazer.urdf").write_text(urdf.replace("</joint>", '<mimic joint="a"/></joint>', 1))
    readings = [
        {"time": time, "joint_states": [0.1 * time] * 6, "prism_position": [1.0, 2.0, time]} for time in (5.0, 3.0)
    ]
    station = {"stationing_measurements": readings[:1], "evaluation_measurements": readings[1:]}
    heights = {1.98: {"solution_spaces": {7: station}}}
    said = {"joint_names": list(arm.joint_names), "column_heights": heights}
    (data / "datasets" / "flat.yaml").write_text(yaml.safe_dump(said))
    scoreboard.from_hilti(tmp_path, tmp_path / "column")
    ((_, file, table),) = scoreboard.campaigns(tmp_path / "column")
    found = scoreboard.read_measurements(table, arm)
    assert "mimic" not in (file.parent / "trailblazer.urdf").read_text()
    np.testing.assert_allclose(found.time, [0.0, 2.0])
    np.testing.assert_allclose(found.position[:, 2], [3.0, 5.0])
