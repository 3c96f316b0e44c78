"""Axes, enough poses, and the noise that repeats tell."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.measurement_rows import campaign, written

from armflex import Arm, Measurements, calibrate, read_measurements
from armflex.errors import AxesError, IdentifiabilityError, Place, UnitError
from armflex.estimate.placement import check_axes, check_enough
from armflex.measured.repeats import repeats

PLACES = [Place(Path("m.csv"), 2 + i) for i in range(40)]
SWAPS = {
    "y and z": ([0, 2, 1], [1, 1, 1], "y and z swapped"),
    "x and z": ([2, 1, 0], [1, 1, 1], "x and z swapped"),
    "x and y": ([1, 0, 2], [1, 1, 1], "x and y swapped, or one of them reversed"),
    "-x": ([0, 1, 2], [-1, 1, 1], "x and y swapped, or one of them reversed"),
    "-z": ([0, 1, 2], [1, 1, -1], "z reversed"),
}


def station(rng: np.random.Generator) -> pin.SE3:
    """Return a level instrument somewhere."""
    return pin.SE3(pin.exp3(np.array([0.0, 0.0, rng.uniform(-3, 3)])), rng.normal(0.0, 3.0, 3))


def seen(points: np.ndarray, pose: pin.SE3) -> np.ndarray:
    return points @ pose.rotation.T + pose.translation


@pytest.mark.parametrize("swap", SWAPS)
def test_swapped_axes_of_an_instrument_anywhere_are_named(swap: str) -> None:
    order, signs, said = SWAPS[swap]
    rng = np.random.default_rng(0)
    points = rng.uniform(-2.0, 2.0, (40, 3))
    sagging = points + rng.normal(0.0, 5e-3, (40, 3))
    measured = seen(sagging, station(rng))[:, order] * signs
    measured[[7, 20]] += [[1.0, 0.0, 0.0], [0.0, 30.0, 10.0]]
    with pytest.raises(AxesError, match=rf"m.csv:2: .*times better mirrored.*{said}"):
        check_axes(points, measured, PLACES)


def test_a_turned_frame_is_told_where_the_instrument_is_known() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-2.0, 2.0, (20, 3))
    pose = station(rng)
    measured = seen(points, pose) + rng.normal(0.0, 1e-2, (20, 3))
    check_axes(points, measured, pose=pose)
    turned = np.column_stack([measured[:, 1], -measured[:, 0], measured[:, 2]])
    with pytest.raises(AxesError, match=r"when x, y, z are read as -y, x, z"):
        check_axes(points, turned, pose=pose)
    check_axes(points, turned)  # an instrument that stands anywhere may be turned


@pytest.mark.parametrize("factor", [1e3, 1e-3])
def test_a_campaign_wholly_in_another_unit_is_told(factor: float) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-2.0, 2.0, (20, 3))
    with pytest.raises(UnitError, match="mm"):
        check_axes(points, factor * seen(points, station(rng)), PLACES)


@pytest.mark.parametrize("thickness", [0.0, 1e-9, 1e-3, 0.05, 1.0])
@pytest.mark.parametrize("error", [0.0, 2e-4, 0.02, 0.3])
@pytest.mark.parametrize("count", [3, 4, 6, 8, 40])
def test_good_data_raise_nothing(thickness: float, error: float, count: int) -> None:
    """Planar and nearly planar points, few points, and sag many times the declared one, over many draws."""
    for seed in range(30):
        rng = np.random.default_rng(seed)
        points = rng.uniform(-3.0, 3.0, (count, 3)) * [1.0, 1.0, thickness]
        sag = np.column_stack([np.zeros((count, 2)), -0.03 * error * (points[:, :2] ** 2).sum(axis=1)])
        measured = seen(points + sag + rng.normal(0.0, error, (count, 3)), station(rng))
        check_axes(points, measured)


def test_too_few_or_too_flat_points_tell_nothing_of_axes() -> None:
    rng = np.random.default_rng(9)
    points = rng.uniform(-2.0, 2.0, (6, 3))
    check_axes(points[:5], points[:5] * [1.0, 1.0, -1.0])
    with pytest.raises(AxesError):
        check_axes(points, points * [1.0, 1.0, -1.0])
    check_axes(points * [1.0, 1.0, 1e-6], points * [1.0, 1.0, -1e-6])
    for size in (1e-7, 5e-7, 1e-6, 1e-4):
        check_axes(size * rng.uniform(-2.0, 2.0, (40, 3)), rng.normal(0.0, 2e-4, (40, 3)))


def test_a_sagging_planar_arm_is_not_taken_for_mirrored() -> None:
    """All poses in a plane: what thickness there is comes from sag, declared three times too small."""
    rng = np.random.default_rng(3)
    plane = np.column_stack([rng.uniform(-8.0, 8.0, (60, 2)), np.zeros(60)])
    sag = np.array([0.0, 0.0, -1.0]) * (plane[:, :2] ** 2).sum(axis=1)[:, None]
    check_axes(plane + 1e-3 * sag, seen(plane + 3e-3 * sag, station(rng)))
    check_axes(plane, seen(plane + 3e-3 * sag, station(rng)))


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
    with pytest.raises(AxesError, match=r"rows.csv:2: .*y and z swapped"):
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
