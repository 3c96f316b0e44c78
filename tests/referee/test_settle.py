"""How long a tip swings after a move, against MuJoCo with springs and dampers at the joints."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.linalg import eigh
from support.mujoco_arm import Referee, Sprung
from support.small_arms import ROBOTS
from support.sprung_campaign import driven

from armflex import Arm, InputError, Trajectory, load_arm
from armflex.tasks.settle import settle

MACHINES = {"heavy_six": (3e5, "p100", (1.0, 2.5), 3e-4), "tarm_like": (4e6, "p300", (3.0, 6.0), 5e-4)}
"""Stiffness of the drives [Nm/rad or N/m], payload, duration of moves [s] and time step [s]."""

DAMPED, WITHIN = 0.05, 1e-3


def swung(plant: Sprung, times: np.ndarray, q: np.ndarray, longer: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times after the move [s], and how far the tip then is from where it comes to rest [m]."""
    model, data = plant.model, plant.data
    model.opt.timestep = step
    start, rest = plant.rest(q[0]), plant.rest(q[-1])
    stiffness = plant.springs(rest)
    plant.held(rest)
    mass, end = plant.mass(), plant.point(np.zeros(3)).copy()
    squares, shapes = eigh(stiffness, mass)
    damper = mass @ shapes @ np.diag(2.0 * DAMPED * np.sqrt(squares)) @ shapes.T @ mass
    data.qpos[plant.places], data.qvel[:], data.time = start, 0.0, 0.0
    at = np.arange(int((times[-1] + longer) / step)) * step
    driven = np.column_stack([np.interp(at, times, one) for one in q.T])
    speeds, away = np.gradient(driven, step, axis=0), np.empty(len(at))
    for i, (where, speed) in enumerate(zip(driven, speeds, strict=True)):
        spring = plant.stiffness * (where - data.qpos[plant.places])
        data.qfrc_applied[plant.dofs] = spring + damper @ (speed - data.qvel[plant.dofs])
        mujoco.mj_step(model, data)
        away[i] = np.linalg.norm(plant.point(np.zeros(3)) - end)
    after = at >= times[-1]
    return at[after] - times[-1], away[after]


def moves(name: str, count: int):
    """Yield arms, plants and smooth moves from rest to rest."""
    stiffness, payload, (shortest, longest), _ = MACHINES[name]
    arm = replace(driven(load_arm(ROBOTS / name / "arm.toml"), stiffness), damping_ratio=DAMPED)
    referee, rng, joints = Referee(name), np.random.default_rng(1), len(arm.joint_names)
    for number in range(count):
        carried = ["none", payload][number % 2]
        start = 0.6 * rng.uniform(arm.robot.lower, arm.robot.upper)
        goal = np.clip(start + rng.uniform(-0.6, 0.6, joints), 0.9 * arm.robot.lower, 0.9 * arm.robot.upper)
        times = np.linspace(0.0, rng.uniform(shortest, longest), 101)
        share = times / times[-1]
        q = start + np.outer(3.0 * share**2 - 2.0 * share**3, goal - start)
        plant = Sprung(referee, arm.joint_names, carried, np.full(joints, stiffness), {})
        yield arm, plant, Trajectory(arm.joint_names, times, q, (carried,) * 101, ("",) * 100 + ("end",))


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_settling_and_peak_are_those_of_mujoco(name: str) -> None:
    settling, peaks = [], []
    for arm, plant, path in moves(name, 10):
        (found,) = settle(arm, path, WITHIN).via_points
        after, away = swung(plant, path.time, path.q, 1.3 * found.settle_s + 1.0, MACHINES[name][3])
        outside = np.flatnonzero(away > WITHIN)
        seconds = float(after[outside[-1]]) if len(outside) else 0.0
        assert seconds < after[-1] - 0.3
        settling.append(abs(found.settle_s - seconds) / max(seconds, 0.2))
        peaks.append(abs(found.peak_m - away.max()) / away.max())
    # One in ten may have a peak that is almost the tolerance: whether it counts is a matter of a few per cent of it.
    assert np.median(settling) < 0.02 and np.sum(np.array(settling) > 0.15) <= 1
    assert max(peaks) < 0.1


def test_a_mass_on_a_spring_swings_as_the_textbook_has_it() -> None:
    """One mode, drives that stop from a steady speed at once: peak v / w, and the envelope of the decay."""
    arm = driven(load_arm(ROBOTS / "heavy_six" / "arm.toml"), 3e5)
    arm = replace(arm, damping_ratio=0.05, flexures=arm.flexures[:1], robot=replace(arm.robot, gravity=np.zeros(3)))
    q = np.zeros((2, len(arm.joint_names)))
    q[0, 0] = -0.2
    path = Trajectory(arm.joint_names, np.array([0.0, 50.0]), q, ("none",) * 2, ("", "end"))
    (found,) = settle(arm, path, 1e-5).via_points
    modes = arm.modes(q[1])
    natural = 2.0 * np.pi * modes.frequencies[0]
    lever = np.linalg.norm(arm.rigid_pose(q[1]).translation[:2])
    size = 0.004 * lever / natural * np.exp(-0.05 / np.sqrt(1.0 - 0.05**2) * np.arctan2(np.sqrt(1.0 - 0.05**2), 0.05))
    assert found.peak_m == pytest.approx(size, rel=5e-3)
    assert found.frequency_hz == pytest.approx(modes.frequencies[0]) and found.flexure == arm.flexure_names[0]
    envelope = np.log(0.004 * lever / natural / np.sqrt(1.0 - 0.05**2) / 1e-5) / (0.05 * natural)
    assert envelope - np.pi / natural - 1e-2 < found.settle_s <= envelope + 1e-2


def test_what_cannot_settle_is_refused() -> None:
    arm = load_arm(ROBOTS / "heavy_six" / "arm.toml")
    path = Trajectory(arm.joint_names, np.array([0.0]), np.zeros((1, 6)), ("none",), ("end",))
    with pytest.raises(InputError, match="within must be positive"):
        settle(arm, path, 0.0)
    with pytest.raises(InputError, match="declares no flexure"):
        settle(replace(arm, flexures=()), path, 1e-3)
    still = settle(arm, path, 1e-3)
    assert still.via_points[0].settle_s == 0.0 and still.via_points[0].peak_m == pytest.approx(0.0, abs=1e-12)
    assert [flag.code for flag in still.flags] == ["damping_assumed"]


def test_a_payload_that_is_put_down_lets_the_arm_swing(tmp_path) -> None:
    """The arm springs back from where the load had it: the first peak is that step, nearly undamped."""
    arm: Arm = load_arm(ROBOTS / "heavy_six" / "arm.toml")
    q = np.zeros((3, 6))
    path = Trajectory(arm.joint_names, np.arange(3.0), q, ("p100", "none", "none"), ("", "let go", "later"))
    first, _ = settle(arm, path, 1e-4).via_points
    step = arm.deflection(q[0], "p100").displacement[:3] - arm.deflection(q[0], "none").displacement[:3]
    assert first.peak_m == pytest.approx(np.linalg.norm(step), rel=0.1)
