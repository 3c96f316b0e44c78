"""Where the instrument stands: every session by itself, and what a level one knows of gravity."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import three_joint_plant
from support.campaign_files import numbers, write_columns
from support.plant import Rows, apply, pose, turn

from armflex import calibrate, load_arm, predict, read_measurements
from armflex.errors import ConvergenceError
from armflex.estimate.blocks import declared_blocks
from armflex.estimate.fit import THOROUGH, fit
from armflex.estimate.placement import first_guess
from armflex.readings import Readings
from armflex.robot import Corrections

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
@pytest.mark.filterwarnings("ignore:gravity_in:armflex.ArmflexWarning")
def test_gravity_is_turned_once_however_often_an_arm_is_calibrated(level, tmp_path: Path, keep: bool) -> None:
    file, (first, second) = level
    arm = load_arm(file)
    known = calibrate(arm, read_measurements(first, arm))
    written = load_arm(known.write(tmp_path / "arm.toml"))
    for one in (known.arm, written):
        np.testing.assert_allclose(one.robot.gravity, TILT.T @ [0.0, 0.0, -9.81], atol=2e-3)
        again = calibrate(one, read_measurements(second, one), keep=keep)
        np.testing.assert_allclose(again.arm.robot.gravity, one.robot.gravity, atol=2e-3)
        rows = read_measurements(second, again.arm)
        error = predict(again.arm, rows).position - rows.position
        assert np.sqrt((error**2).sum(axis=1).mean()) < 1.1 * np.sqrt(3.0) * three_joint_plant.SIGMA


FAR = {
    "near": pose(np.zeros(3), np.eye(3)),
    "again": pose(np.array([0.0004, -0.0003, 0.0002]), turn(np.array([2e-5, -3e-5, 4e-5]))),
    "beside": pose(np.array([0.2, -0.1, 0.05]), turn(np.array([0.03, -0.02, 0.1]))),
    "behind": pose(np.array([6.0, 3.0, -0.5]), turn(np.array([0.02, 0.01, 2.5]))),
}
"""Frames of sessions: the instrument at its marks, moved by a hand's breadth, and on the other side of the arm."""


def several(folder: Path, frames: dict, count: int = 120) -> tuple[Path, Path]:
    """Write an arm and a campaign of it whose sessions have frames of their own, the joints' zeros off."""
    plant = three_joint_plant.declared(folder)
    prior = "joint_offset = 1e-3\nsession_translation = 5e-4\nsession_rotation = 5e-5"
    file = folder / "arm.toml"
    file.write_text(file.read_text().replace("joint_offset = 1e-3", prior))
    plant.offset = {joint.name: 1e-3 for joint in plant.joints[1:3]}
    rng = np.random.default_rng(5)
    q, still = rng.uniform(-1.2, 1.2, (count, 3)), np.zeros((count, 3))
    names = [list(frames)[i * len(frames) // count] for i in range(count)]
    plain = apply(three_joint_plant.STATION, plant.points(plant.relax(Rows.plain(q, np.zeros(count), still))))
    read = np.array([apply(frames[name], point[None])[0] for name, point in zip(names, plain, strict=True)])
    read += rng.normal(0.0, three_joint_plant.SIGMA, read.shape)
    columns = {f"q_J{i + 1}": numbers(q[:, i]) for i in range(3)} | {
        a: numbers(read[:, i]) for i, a in enumerate("xyz")
    }
    columns |= {"session": names, "sigma": [three_joint_plant.SIGMA] * count}
    table = folder / "rows.csv"
    write_columns(table, columns)
    return file, table


def far_target(folder: Path, lost: float, seed: int = 5) -> tuple[Path, Path]:
    """Write an arm whose target is declared at the flange and hangs 0.2 m away, and a campaign of four places of the
    instrument, of whose readings a share is lost by centimetres.
    """
    file, table = several(folder, FAR)
    file.write_text(file.read_text().replace("joint_offset = 1e-3", "joint_offset = 3e-3\ntool = 0.3\ngeometry = 2e-3"))
    arm, rng = load_arm(file), np.random.default_rng(seed)
    rows = read_measurements(table, arm)
    arm = replace(arm, corrections=Corrections({"J2": 3e-3, "J3": -2e-3}, {"J3": rng.normal(0.0, 1e-3, 6)}))
    tip = arm.deflection(rows.q, rows.payload).pose
    points = apply(three_joint_plant.STATION, tip[:, :3, 3] + tip[:, :3, :3] @ [0.05, 0.02, 0.2])
    read = np.array([apply(FAR[name], point[None])[0] for name, point in zip(rows.session, points, strict=True)])
    read += rng.normal(0.0, three_joint_plant.SIGMA, read.shape)
    read += rng.normal(0.0, 0.05, read.shape) * (rng.random(len(read)) < lost)[:, None]
    columns = {f"q_J{i + 1}": numbers(rows.q[:, i]) for i in range(3)}
    columns |= dict(zip("xyz", map(numbers, read.T), strict=True)) | {"session": list(rows.session)}
    write_columns(table, columns | {"sigma": [three_joint_plant.SIGMA] * len(read)})
    return file, table


@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_a_target_far_from_where_it_is_declared_does_not_mislead_the_frames(tmp_path: Path, lost: float) -> None:
    file, table = far_target(tmp_path, lost)
    arm = load_arm(file)
    found = calibrate(arm, read_measurements(table, arm))
    off = np.linalg.norm(found.fit.view.residual, axis=1)
    assert np.median(off) < 2.0 * np.sqrt(3.0) * three_joint_plant.SIGMA
    assert len(found.fit.history) < 60
    assert {flag.text.split("'")[1] for flag in found.flags if flag.code == "session_apart"} == {"beside", "behind"}


def error_of(arm, rows) -> float:
    off = predict(arm, rows).position - rows.position
    return float(np.sqrt((off**2).sum(axis=1).mean())) / (np.sqrt(3.0) * three_joint_plant.SIGMA)


@pytest.mark.parametrize("which", [("near", "again"), ("near", "beside"), tuple(FAR)])
def test_sessions_far_from_each_other_fit_as_well_as_near_ones(tmp_path: Path, which: tuple[str, ...]) -> None:
    file, table = several(tmp_path, {name: FAR[name] for name in which})
    arm = load_arm(file)
    rows = read_measurements(table, arm)
    found = calibrate(arm, rows)
    offsets = [found.arm.corrections.joint_offset[name] for name in ("J2", "J3")]
    np.testing.assert_allclose(offsets, 1e-3, atol=6e-5)
    said = {flag.text.split("'")[1] for flag in found.flags if flag.code == "session_apart"}
    assert said == set(which) & {"beside", "behind"}
    written = load_arm(found.write(tmp_path / "fitted.toml"))
    for one in (found.arm, written):
        assert 0.9 < error_of(one, rows) < 1.05
    frames = {name: FAR[name] for name in ("behind", "near")}
    _, later = several(tmp_path, frames)
    again = calibrate(written, read_measurements(later, written), keep=True)
    assert error_of(again.arm, read_measurements(later, again.arm)) < 1.1


def test_predictions_are_as_uncertain_as_the_session_sees_them(tmp_path: Path) -> None:
    """Axes of a session that is turned by a right angle have each other's standard deviations."""
    quarter = pose(np.array([3.0, 1.0, 0.0]), turn(np.array([0.0, 0.0, np.pi / 2.0])))
    file, table = several(tmp_path, {"one": FAR["near"], "two": quarter})
    arm = load_arm(file)
    rows = read_measurements(table, arm)
    known = calibrate(arm, rows).arm
    half = len(rows) // 2
    same = replace(rows, q=np.vstack([rows.q[:half]] * 2))
    sigma = predict(known, same).sigma
    assert sigma is not None
    assert not np.allclose(sigma[:half, 0], sigma[:half, 1], rtol=0.05)
    np.testing.assert_allclose(sigma[half:, :2], sigma[:half, 1::-1], rtol=0.2)


@pytest.mark.slow
def test_a_fit_that_does_not_settle_says_what_still_moves_and_which_rows_are_furthest_off(tmp_path: Path) -> None:
    file, table = several(tmp_path, {"near": FAR["near"]}, 40)
    arm = load_arm(file)
    rows = read_measurements(table, arm)
    lost = np.array(rows.position)
    lost[7] += 0.05
    rows = replace(rows, readings=Readings(40, (replace(rows.readings.kinds[0], values=lost),)))
    declared, _ = first_guess(arm, rows, np.arange(40))
    with pytest.raises(
        ConvergenceError, match=r"did not settle; still moving: .* by .*; .* of what is left is at .*rows.csv:9, "
    ):
        fit(declared, declared_blocks(declared, rows), rows, effort=replace(THOROUGH, iterations=1))
