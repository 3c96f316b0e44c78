"""Modes of machines with loops: MuJoCo's mass matrix and differences of its forces on the closed loops."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.linalg import eigh, null_space
from support.arms import bundled
from support.machines import MACHINES, poses
from support.small_arms import ROBOTS
from test_loops_mujoco import Mujoco

from armflex import read_trajectory
from armflex.tasks.settle import settle


def frequencies(referee: Mujoco, here: np.ndarray) -> np.ndarray:
    """Return natural frequencies [Hz] of the machine about positions at which it rests, drives holding.

    With A the loops' Jacobian, f their forces and N the motions that they allow, N'(K - d(A'f)) N u = w^2 N'M N u: the
    change of A at the same f is found by differences, as that of all other forces is.
    """
    left, jacobian, _ = referee.look(here)
    across = np.linalg.svd(jacobian)[0][:, : np.linalg.matrix_rank(jacobian, tol=1e-6)]
    forces = across @ np.linalg.lstsq(jacobian.T @ across, left, rcond=1e-12)[0]
    stiffness = np.empty((len(here), len(here)))
    for i in range(len(here)):
        sides = []
        for side in (1e-6, -1e-6):
            moved = here.copy()
            moved[i] += side
            left, other, _ = referee.look(moved)
            sides.append(left - other.T @ forces)
        stiffness[:, i] = -(sides[0] - sides[1]) / 2e-6
    referee.look(here)
    mass = np.zeros((referee.model.nv,) * 2)
    mujoco.mj_fullM(referee.model, referee.data, mass)  # pyright: ignore[reportAttributeAccessIssue]
    mass = mass[np.ix_(referee.free, referee.free)]
    free = null_space(across.T @ jacobian, rcond=1e-9)
    stiffness = 0.5 * (stiffness + stiffness.T)
    return np.sqrt(eigh(free.T @ stiffness @ free, free.T @ mass @ free, eigvals_only=True)) / (2.0 * np.pi)


@pytest.mark.parametrize("row", range(2))
@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_swings_as_mujoco_has_it(name: str, row: int, tmp_path) -> None:
    machine, q = MACHINES[name], poses(name)[row]
    arm = machine.load(tmp_path)
    found, modes = arm.deflection(q), arm.modes(q)
    referee, flexures = Mujoco(name, q), arm.flexure_names

    def own(joint: str) -> float:
        if joint in found.passive:
            return found.passive[joint]
        key = joint.removesuffix("/gives")
        return float(found.twists[flexures.index(key), 3:] @ machine.gives[key][0])

    expected = frequencies(referee, np.array([own(referee.names[i]) for i in referee.free]))
    count = min(len(expected), len(modes.frequencies))
    np.testing.assert_allclose(modes.frequencies[:count], expected[:count], rtol=1e-6)
    assert count >= 2
    # Of a mode the energy of the flexures is that of the motion, but for what the loads take of it.
    assert np.abs(modes.sensitivities.sum(axis=1) - 0.5).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["palletizer", "hybrid_lifter"])
def test_bundled_machines_settle(name: str) -> None:
    arm = bundled(name)
    report = settle(arm, read_trajectory(ROBOTS / name / "trajectory.csv", arm), within=1e-3)
    assert len(report.via_points) == 3
    for one in report.via_points[1:]:  # the first is where it stands
        assert np.isfinite(one.settle_s) and 1e-6 < one.peak_m < 1e-2
