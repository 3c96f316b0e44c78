"""Axes, enough poses, and the noise that repeats tell."""

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.measurement_rows import campaign, written

from armflex import Arm, Measurements, calibrate, read_measurements
from armflex.errors import ConventionError, IdentifiabilityError
from armflex.estimate.placement import check_enough
from armflex.measured.repeats import repeats


def station(rng: np.random.Generator) -> pin.SE3:
    """Return a level instrument somewhere."""
    return pin.SE3(pin.exp3(np.array([0.0, 0.0, rng.uniform(-3, 3)])), rng.normal(0.0, 3.0, 3))


def seen(points: np.ndarray, pose: pin.SE3) -> np.ndarray:
    return points @ pose.rotation.T + pose.translation


def on_arm(arm: Arm, folder: Path, poses: np.ndarray) -> Measurements:
    """Return a campaign with clean positions of an instrument somewhere."""
    rng = np.random.default_rng(4)
    tips = np.array([arm.deflection(q).pose.translation for q in poses])
    rows = campaign(len(poses))
    for row, q, place in zip(rows, poses, seen(tips, station(rng)) + rng.normal(0, 2e-4, tips.shape), strict=True):
        row |= {f"q_J{i + 1}": float(value) for i, value in enumerate(q)}
        row |= dict(zip("xyz", place.tolist(), strict=True))
    return read_measurements(written(folder, rows), arm)


@pytest.fixture
def unknown(heavy: Arm) -> Arm:
    measurement = dataclasses.replace(heavy.measurement, frame="unknown")
    return dataclasses.replace(heavy, measurement=measurement)


def test_calibrate_refuses_swapped_axes_and_one_pose_only(unknown: Arm, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    found = on_arm(unknown, tmp_path, rng.uniform(-0.8, 0.8, (12, 6)))
    assert calibrate(unknown, found).rms < 1e-3
    with pytest.raises(ConventionError, match=r"rows.csv: .*a left-handed frame's"):
        calibrate(unknown, dataclasses.replace(found, position=found.position[:, [0, 2, 1]]))
    alike = on_arm(unknown, tmp_path, np.tile(rng.uniform(-0.8, 0.8, 6), (12, 1)))
    with pytest.raises(IdentifiabilityError, match="12 measured points are all alike") as caught:
        calibrate(unknown, alike)
    assert caught.value.rank == 3 and caught.value.names == ("instrument rx", "instrument ry", "instrument rz")


def test_points_on_a_line_leave_a_turn_about_it_free() -> None:
    points = np.linspace(-1.0, 1.0, 9)[:, None] * np.array([0.0, 1.0, 0.0]) + [5.0, 4.0, 3.0]
    sigma = np.full((9, 3), 2e-4)
    with pytest.raises(IdentifiabilityError, match=r"lie on one line.*rank 5") as caught:
        check_enough(points, sigma)
    assert caught.value.names == ("instrument ry",) and caught.value.condition > 1e6
    with pytest.raises(IdentifiabilityError):
        check_enough(points + 5e-4 * np.eye(3)[[0, 1, 2] * 3], sigma)
    check_enough(points + 0.05 * np.eye(3)[[0, 1, 2] * 3], sigma)


def repeated(arm: Arm, folder: Path, sets: int, each: int, noise: float, sessions: int = 1) -> Measurements:
    """Return poses in a few sessions, each read a few times; sessions differ by 1 mm, poses by metres."""
    rng = np.random.default_rng(6)
    shifts = rng.normal(0.0, 1e-3, (sets, sessions, 3))
    rows = []
    for k in range(sessions):
        for i, row in enumerate(campaign(sets, seed=7)):
            for _ in range(each):
                place = np.array([row[axis] for axis in "xyz"]) + shifts[i, k] + rng.normal(0.0, noise, 3) * [1, 2, 3]
                reading = dict(zip("xyz", place.tolist(), strict=True))
                rows.append(row | reading | {"session": f"s{k}", "time": 10.0 * len(rows)})
    return read_measurements(written(folder, rows), arm)


def test_repeats_tell_the_noise_of_each_axis(heavy: Arm, tmp_path: Path) -> None:
    told = repeats(repeated(heavy, tmp_path, sets=200, each=3, noise=1e-4, sessions=2))
    assert told.same_session.freedom == 800 and told.same_session.groups == 400 and not told.same_session.lost
    np.testing.assert_allclose(told.same_session.sigma, 1e-4 * np.array([1, 2, 3]), rtol=4 * 0.025)
    np.testing.assert_allclose(told.same_session.ratio, told.same_session.sigma / 2e-4, rtol=1e-12)
    assert told.same_session.uncertainty == pytest.approx(0.025)
    between = np.sqrt(1e-6 + (1e-4 * np.array([1, 2, 3])) ** 2 / 3)
    assert told.across_sessions.freedom == 200
    np.testing.assert_allclose(told.across_sessions.sigma, between, rtol=4 * 0.05)


@pytest.mark.parametrize("each", [2, 3, 5])
def test_a_lost_beam_among_repeats_is_left_out(heavy: Arm, tmp_path: Path, each: int) -> None:
    clean = repeated(heavy, tmp_path, sets=40, each=each, noise=1e-4)
    position = clean.position.copy()
    position[4 * each] += [1.0, 0.0, -0.5]
    position[9 * each + 1] += [0.0, 0.02, 0.0]
    told = repeats(dataclasses.replace(clean, position=position)).same_session
    assert {4 * each, 9 * each + 1} <= set(told.lost) and len(told.lost) == (4 if each == 2 else 2)
    np.testing.assert_allclose(told.sigma, repeats(clean).same_session.sigma, rtol=0.2)


def test_few_repeats_throw_none_away(heavy: Arm, tmp_path: Path) -> None:
    for sets in (1, 2, 3):
        assert not repeats(repeated(heavy, tmp_path, sets=sets, each=2, noise=1e-4)).same_session.lost


def test_noise_that_is_stated_wrongly_is_flagged(heavy: Arm, tmp_path: Path) -> None:
    for noise, flagged in ((1e-3, True), (1e-4, False), (1e-5, True)):
        told = repeats(repeated(heavy, tmp_path, sets=40, each=2, noise=noise))
        assert [flag.code for flag in told.flags] == ["stated_noise"] * flagged


def test_other_loads_poses_and_unread_rows_are_no_repeats(heavy: Arm, tmp_path: Path) -> None:
    found = repeated(heavy, tmp_path, sets=6, each=2, noise=1e-4)
    first = np.arange(len(found)) % 2 == 0
    assert repeats(dataclasses.replace(found, measured=first)) is None
    moved = dataclasses.replace(found, q=found.q + np.where(first, 0.0, 1e-4)[:, None])
    assert repeats(moved) is None and repeats(moved, tolerance=2e-4).same_session.freedom == 6
    loads = tuple("none" if odd else "heavy" for odd in first)
    assert repeats(dataclasses.replace(found, payload=loads)) is None


def test_play_shows_across_approaches_only(heavy: Arm, tmp_path: Path) -> None:
    found = repeated(heavy, tmp_path, sets=60, each=4, noise=1e-4)
    side = np.where(np.arange(len(found)) % 4 < 2, 1.0, -1.0)[:, None]
    moved = dataclasses.replace(found, approach=np.repeat(side, 6, axis=1), position=found.position + 1e-3 * side)
    told = repeats(moved)
    np.testing.assert_allclose(told.same_approach.sigma, 1e-4 * np.array([1, 2, 3]), rtol=0.25)
    assert (told.same_session.sigma > 1e-3).all() and told.same_approach.freedom == 120


@pytest.mark.parametrize(
    ("columns", "unit_length"),
    [("qw qx qy qz", True), ("o_w o_x o_y o_z", True), ("roll_deg pitch_deg yaw_deg", False), ("A B C", False),
     ("euler_x euler_y euler_z", False), ("r11 r12 r13 r21 r22 r23 r31 r32 r33", False)],
)  # fmt: skip
def test_an_orientation_in_other_forms_is_said_with_the_form_that_is_read(
    heavy: Arm, tmp_path: Path, columns: str, unit_length: bool
) -> None:
    """Four numbers of another length are no orientation, and three of four are none either."""
    names, rng = columns.split(), np.random.default_rng(8)
    turns = rng.normal(size=(12, len(names)))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)

    def told(size: float, count: int = 9) -> list[str]:
        rows = campaign(12)
        for row, turn in zip(rows, size * turns, strict=True):
            row |= dict(zip(names[:count], turn.tolist(), strict=False))
        flags = read_measurements(written(tmp_path, rows), heavy).flags
        return [flag.text for flag in flags if flag.code == "orientation_unread"]

    (text,) = told(1.0)
    assert "rx, ry, rz (a rotation vector" in text and all(name in text for name in names)
    assert bool(told(3.0)) is not unit_length and not told(1.0, len(names) - 1)
