"""Moves of bundled arms whose drives are springs and dampers, and how their tips swing afterwards, as MuJoCo has it."""

from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
from scipy.linalg import eigh

from armflex import Arm, Trajectory, load_arm
from support.mujoco_arm import Referee, Sprung
from support.small_arms import ROBOTS
from support.sprung_campaign import driven

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


def moves(name: str, count: int) -> Iterator[tuple[Arm, Sprung, Trajectory]]:
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
