"""Real machines: the public UR5 and WAM, where they are there, and the converters of published layouts."""

import csv
import re
import runpy
from pathlib import Path

import numpy as np
import public as scoreboard
import pytest
from support import six_axes
from support.effect_arms import quietly
from support.public_campaigns import campaign, where_published
from support.small_arms import ROBOTS

from armflex import calibrate, predict, trace
from armflex.estimate.held_out import apart_folds


@where_published
def test_the_ur5_is_calibrated_to_a_ninth_of_a_millimetre() -> None:
    found = calibrate(*campaign("ur5_tsinghua"))
    assert found.held_out is not None and 1e3 * found.held_out[1] < 0.115


@where_published
@pytest.mark.slow
def test_the_wam_is_calibrated_to_two_and_a_half_millimetres() -> None:
    found = calibrate(*campaign("wam_tsinghua"))
    assert found.held_out is not None and 1e3 * found.held_out[1] < 2.4


@where_published
@pytest.mark.slow
def test_a_traced_ur5_predicts_poses_that_it_has_not_seen() -> None:
    """The published hybrid network: 0.155 mm, mean of 20 poses; calibrated kinematics alone: 0.103 mm."""
    arm, measurements = campaign("ur5_tsinghua")
    learned = np.arange(0, len(measurements), 3)
    found = trace(arm, measurements, learned)
    rest = np.setdiff1d(np.arange(len(measurements)), learned)
    error = np.linalg.norm(predict(found.arm, measurements).position - measurements.position, axis=1)
    assert 1e3 * error[rest].mean() < 0.070
    # What is stated of poses held out is what other poses get, of a fit to a fifth fewer rows: 250 rows get 0.062 mm.
    other = np.sqrt((error[rest] ** 2).mean())
    assert other < found.held_out[1] < 1.15 * other
    assert "curve of the drives" in found.common


@pytest.mark.parametrize(("name", "joints", "sigma"), [("UR5", 6, 1e-4), ("WAM", 7, 1e-3)])
def test_the_published_layout_is_read(tmp_path: Path, name: str, joints: int, sigma: float) -> None:
    """Target and difference in mm, joints in degrees, as they stand in the repository; test poses stay apart."""
    rng = np.random.default_rng(0)
    target, difference = rng.uniform(-800.0, 800.0, (5, 3)), rng.uniform(-20.0, 20.0, (5, 3))
    q, folder = rng.uniform(-90.0, 90.0, (5, joints)), tmp_path / "serial_robots_datasets" / name
    folder.mkdir(parents=True)
    (folder.parent / "LICENSE").write_text("MIT License\n")
    head = ["step_order", *(f"{axis}_{of}" for of in ("t", "dif") for axis in "xyz")]
    head += [f"joint_{i + 1}" for i in range(joints)]
    for kind, some in (("grid", slice(0, 4)), ("random", slice(4, 5))):
        with (folder / f"3D_{name}_uncalibrated_{kind}_cleaned.csv").open("w", newline="") as file:
            table = np.column_stack([np.arange(5), target, difference, q])[some]
            csv.writer(file).writerows([head, *table.tolist()])
    found = scoreboard.published(tmp_path, tmp_path / "converted")
    assert list(found) == [f"{name.lower()}_tsinghua"]
    ((file, table),) = found.values()
    assert (file.parent / "LICENSE").read_text() == "MIT License\n"
    arm = quietly(file)
    for path, some in ((table, slice(0, 4)), (table.parent / "test.csv", slice(4, 5))):
        rows = scoreboard.read_measurements(path, arm)
        np.testing.assert_allclose(rows.q, np.radians(q[some]), atol=1e-12)
        np.testing.assert_allclose(rows.position, 1e-3 * (target + difference)[some], atol=1e-12)
        np.testing.assert_allclose(rows.sigma, sigma)


def test_a_folder_without_a_campaign_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["public.py", str(tmp_path)])
    with pytest.raises(SystemExit, match="2"):
        scoreboard.main()
    assert "no campaign beside an arm.toml" in capsys.readouterr().err


@pytest.mark.slow
def test_the_notebook_traces_what_it_hid(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.delenv("ARMFLEX_PUBLIC", raising=False)
    monkeypatch.setenv("MPLBACKEND", "agg")
    runpy.run_path(str(ROBOTS.parent / "docs" / "notebooks" / "plot_3_trace_a_real_robot.py"))
    said = capsys.readouterr().out
    assert "simulated: 200 poses used" in said
    assert re.findall(r"^  (\w[\w ]+ at J\d)", said, re.M) == ["backlash at J2", "encoder eccentricity at J3"]


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
    urdf = (six_axes.DECLARED.parent / "robot.urdf").read_text()
    (tmp_path / "ur10_robot.urdf").write_text(urdf)
    arm = six_axes.declared()
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
    (series / "measurements_twice.csv").write_text("\n".join([";".join(head), rows[0]]))
    scoreboard.from_ipa(tmp_path, tmp_path / "both")
    names = {
        table.stem: len(scoreboard.read_measurements(table, arm))
        for _, _, table in scoreboard.campaigns(tmp_path / "both")
    }
    assert names == {"series_B_joint_configurations": 2, "series_B_twice": 1}  # one overwrote the other
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
