"""Paths that leave little swing, against MuJoCo with springs and dampers at the joints, also where the model is off."""

import ctypes
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from support.compiled_arm import COMPILER
from support.mujoco_arm import Referee, Sprung
from support.mujoco_moves import MACHINES, moves, swung
from support.small_arms import ROBOTS

from armflex import InputError, Trajectory, load_arm
from armflex.export.shaper import export
from armflex.tasks.calm import KINDS, calm, impulses
from armflex.tasks.settle import settle
from armflex.trajectory import write_trajectory

OFF = ((1.0, 1.0), (0.9, 1.1), (1.1, 0.9))
"""Factors on the stiffness and on the payload of the machine, of which the model knows nothing."""


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_a_tenth_of_the_swing_is_left_in_mujoco(name: str) -> None:
    referee, (stiffness, _, _, step) = Referee(name), MACHINES[name]
    for arm, _, path in moves(name, 3):
        found = calm(arm, path)
        shaped, joints = found.trajectory, len(arm.joint_names)
        assert shaped.time[-1] <= 1.3 * path.time[-1] + 1e-9
        for softer, heavier in OFF:
            factors = {"payload": heavier}
            plant = Sprung(referee, arm.joint_names, path.payload[0], np.full(joints, stiffness * softer), factors)
            before, after = (swung(plant, one.time, one.q, 1.5, step)[1].max() for one in (path, shaped))
            assert after < 0.1 * before


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("damping", [0.0, 0.01, 0.2])
def test_a_shaper_cancels_what_its_first_impulse_leaves(kind: str, damping: float) -> None:
    """Residual of an impulse train on a damped oscillator (Singer and Seering 1990, eq. (3)), over that of one."""

    def residual(factor: float) -> float:
        times, sizes = impulses(kind, 2.0, damping)
        natural = 2.0 * np.pi * 2.0 * factor
        turned = natural * np.sqrt(1.0 - damping**2)
        return abs((sizes * np.exp((damping * natural + 1j * turned) * (times - times[-1]))).sum())

    times, sizes = impulses(kind, 2.0, damping)
    assert sizes.sum() == pytest.approx(1.0) and (sizes > 0.0).all() and times[0] == 0.0
    if kind == "EI":
        assert residual(1.0) <= 0.0501 and min(residual(1.1), residual(0.9)) < 0.05
        assert damping > 0.01 or residual(1.0) == pytest.approx(0.05, rel=0.05)
    else:
        assert residual(1.0) < 1e-12
    slope = (residual(1.001) - residual(0.999)) / 0.002
    assert abs(slope) < (2.0 if kind == "ZV" else 0.05)


def two_motions() -> Trajectory:
    """A path with a stop at its middle, along two lines and with a corner in the second motion."""
    q = np.zeros((5, 6))
    q[1:, 0], q[3:, 1], q[4, 2] = 0.4, 0.3, 0.3
    names = ("", "stop", "", "corner", "end")
    return Trajectory(load_arm(ROBOTS / "heavy_six" / "arm.toml").joint_names, np.array([0.0, 2.0, 3.0, 5.0, 7.0]), q,
                      ("p100",) * 5, names)  # fmt: skip


def test_the_path_stays_and_no_joint_is_faster() -> None:
    arm = replace(load_arm(ROBOTS / "heavy_six" / "arm.toml"), damping_ratio=0.02)
    path = two_motions()
    found = calm(arm, path)
    shaped = found.trajectory
    assert [one.via for one in found.motions] == ["stop", "corner", "end"]  # at a corner it stops, too
    assert all(one.shaper for one in found.motions)
    # Every row of the path is passed, by its name and in order, and every new row is on a line between two of them.
    rows = [shaped.via.index(name) for name in ("stop", "corner", "end")]
    np.testing.assert_allclose(shaped.q[rows], path.q[[1, 3, 4]], rtol=0, atol=1e-12)
    lines = zip(path.q[:-1], path.q[1:], strict=True)
    off = np.array([[away(row, *line) for row in shaped.q] for line in lines]).min(axis=0)
    assert off.max() < 1e-12
    speeds = [np.abs(np.diff(one.q, axis=0) / np.diff(one.time)[:, None]).max(axis=0) for one in (path, shaped)]
    assert (speeds[1] <= speeds[0] * max(one.speedup for one in found.motions) + 1e-9).all()
    # The stop lasts as long as before, and each motion at most 1.3 times as long.
    stand = shaped.time[rows[0] + 1] - shaped.time[rows[0]]
    assert stand == pytest.approx(1.0)
    for one in found.motions:
        before, after = one.duration_s
        assert before < after <= 1.3 * before + 1e-9 and one.swing_m[2] < 0.1 * one.swing_m[0]
    calmed = {one.name: one.peak_m for one in settle(arm, shaped, 1e-4).via_points}
    stopped = {one.name: one.peak_m for one in settle(arm, path, 1e-4).via_points}
    assert calmed["stop"] < 0.1 * stopped["stop"] and calmed["end"] < 0.1 * stopped["end"]


def away(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Return how far a point is from a stretch of a line."""
    way = end - start
    share = np.clip((point - start) @ way / max(way @ way, 1e-300), 0.0, 1.0)
    return float(np.linalg.norm(point - start - share * way))


def test_speed_limits_decide_what_fits() -> None:
    """A motion too short for its shapers is driven faster between them, unless a joint is at its limit."""
    arm = replace(load_arm(ROBOTS / "heavy_six" / "arm.toml"), damping_ratio=0.02)
    q = np.zeros((2, 6))
    q[1, 0] = 0.05
    path = Trajectory(arm.joint_names, np.array([0.0, 0.4]), q, ("p100",) * 2, ("", "end"))
    (quick,) = calm(arm, path).motions
    assert quick.shaper and quick.speedup > 1.0 and quick.duration_s[1] <= 0.52 + 1e-9
    limit = arm.robot.moving[0].velocity
    path = replace(path, time=np.array([0.0, 0.05 / limit]))
    found = calm(arm, path)
    assert not found.motions[0].shaper and [flag.code for flag in found.flags] == ["not_calmed"]
    np.testing.assert_array_equal(found.trajectory.q, path.q)


def test_what_no_timing_calms_is_said() -> None:
    """A path beyond a speed limit stays beyond it; a payload that is picked up at the end springs the tip."""
    arm = replace(load_arm(ROBOTS / "heavy_six" / "arm.toml"), damping_ratio=0.02)
    q, limit = np.zeros((2, 6)), arm.robot.moving[0].velocity
    q[1, 0] = 0.05
    path = Trajectory(arm.joint_names, np.array([0.0, 0.05 / (2.0 * limit)]), q, ("none", "p100"), ("", "there"))
    said = {flag.code: flag.text for flag in calm(arm, path).flags}
    assert "drives J1 at 2 times its speed limit" in said["speed_limit"]
    tips = [arm.deflection(q[1], one).displacement[:3] for one in ("none", "p100")]
    assert f"springs by {1e3 * np.linalg.norm(tips[1] - tips[0]):.3g} mm" in said["springs"]
    slow = replace(path, time=np.array([0.0, 1.0]))
    (calmed,) = calm(arm, slow).motions
    (plain,) = calm(arm, replace(slow, payload=("none",) * 2)).motions
    assert calmed.swing_m == plain.swing_m and calmed.shaper == plain.shaper


def test_what_cannot_be_calmed_is_refused() -> None:
    arm, path = load_arm(ROBOTS / "heavy_six" / "arm.toml"), two_motions()
    with pytest.raises(InputError, match="slower must be at least 1"):
        calm(arm, path, 0.9)
    with pytest.raises(InputError, match="v_ or a_ columns"):
        calm(arm, replace(path, v=np.zeros_like(path.q)))
    with pytest.raises(InputError, match="declares no flexure"):
        calm(replace(arm, flexures=()), path)
    still = replace(path, q=np.zeros_like(path.q))
    assert calm(arm, still).motions == ()
    np.testing.assert_array_equal(calm(arm, still).trajectory.time, path.time)


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
def test_the_impulses_in_c_are_those_of_the_path(tmp_path) -> None:
    arm = replace(load_arm(ROBOTS / "heavy_six" / "arm.toml"), damping_ratio=0.02)
    path = two_motions()
    write_trajectory(path, tmp_path / "path.csv")
    found, wanted = export(arm, tmp_path / "path.csv"), calm(arm, path)
    (tmp_path / "shaper.c").write_text(found.text)
    strict = [COMPILER, "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run([*strict, "shaper.c", "-o", "shaper.so"], cwd=tmp_path, check=True, timeout=600)
    library = ctypes.CDLL(str(tmp_path / "shaper.so"))
    library.shaper_shaped.restype = ctypes.c_double
    way = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(
        lambda time: float(np.interp(time, [0.0, 2.0], [0.0, 0.4]))
    )
    shaped = wanted.trajectory
    for time, joint in zip(shaped.time, shaped.q[:, 0], strict=True):
        if time <= wanted.motions[0].duration_s[1]:
            assert library.shaper_shaped(0, ctypes.c_double(time), way) == pytest.approx(joint, abs=1e-12)
    with pytest.raises(InputError, match="no name in C"):
        export(arm, tmp_path / "path.csv", name="2nd")
