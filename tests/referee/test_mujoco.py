"""MuJoCo as referee: loads, forward kinematics and, for single-axis drives, the equilibrium itself.

The first referee shares no code with armflex: MuJoCo reads the bundled URDF, every moving body gets three slides and
a ball behind its joint, their generalized gravity gives the wrench on the flexure in its moved frame, and the pose
is exp6 of C times that wrench with an exponential written out here, iterated to a fixed point. (Three slides and
three hinges would be another convention, some tenths of a millimetre away.) The second lets MuJoCo's own springs and
dampers come to rest.
"""

import csv
from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
from support.mujoco_arm import Referee
from support.small_arms import ROBOTS

from armflex import Arm, Flexure, Wrench, compensate, load_arm, read_trajectory
from armflex.laws import LinearLaw


@pytest.fixture(scope="module", params=["tarm_like", "heavy_six"])
def both(request) -> tuple[Arm, Referee]:
    return load_arm(ROBOTS / request.param / "arm.toml"), Referee(request.param)


def assert_agree(arm: Arm, referee: Referee, q: np.ndarray, payload: str, pushes: Sequence[Wrench] = ()) -> float:
    """Assert that loads, twists and the tip agree; return the sag [m]."""
    wrenches, twists, tip = referee.solve(dict(zip(arm.joint_names, q, strict=True)), payload, pushes)
    result = arm.deflection(q, payload, wrenches=pushes)
    assert arm.flexure_names == tuple(referee.toml["flexure"])
    np.testing.assert_allclose(result.wrenches, wrenches, rtol=0, atol=1e-12 * np.abs(wrenches).max())
    np.testing.assert_allclose(result.twists, twists, rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.pose.homogeneous, tip, rtol=0, atol=1e-12)
    rows = arm.deflection(q[None], payload, wrenches=pushes)
    np.testing.assert_allclose(rows.twists[0], twists, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rows.wrenches[0], wrenches, rtol=0, atol=1e-12 * np.abs(wrenches).max())
    return float(np.linalg.norm(result.displacement[:3]))


@pytest.mark.parametrize("heaviest", [False, True])
def test_loads_flexures_and_tip_at_random_positions(both, heaviest):
    arm, referee = both
    payload = list(referee.toml["payload"])[-1] if heaviest else "none"
    random = np.random.default_rng(11)
    sags = [assert_agree(arm, referee, random.uniform(arm.robot.lower, arm.robot.upper), payload) for _ in range(8)]
    assert max(sags) > (0.08 if arm.robot.urdf.name == "tarm_like" else 0.003)


@pytest.mark.parametrize("axes", ["base", "frame"])
def test_pushes_in_base_and_link_axes_at_random_positions(both, axes):
    arm, referee = both
    random = np.random.default_rng(12)
    for _ in range(4):
        forces = 300.0 * random.normal(size=(2, 2, 3))
        pushes = [Wrench(link, *load, axes) for link, load in zip(("tool", arm.link_names[3]), forces, strict=True)]
        assert_agree(arm, referee, random.uniform(arm.robot.lower, arm.robot.upper), "none", pushes)


def test_loads_flexures_and_tip_at_the_via_points(both):
    arm, referee = both
    with (ROBOTS / arm.robot.urdf.name / "trajectory.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["via"]]
    assert len(rows) >= 6
    for row in rows:
        q = np.array([float(row[f"q_{name}"]) for name in arm.joint_names])
        assert_agree(arm, referee, q, row["payload"])


def test_the_straight_arm_under_full_load(both):
    arm, referee = both
    sag = assert_agree(arm, referee, np.clip(0.0, arm.robot.lower, arm.robot.upper), list(referee.toml["payload"])[-1])
    assert sag > (0.15 if arm.robot.urdf.name == "tarm_like" else 0.005)


@pytest.mark.slow
def test_compensated_via_points_are_where_the_rigid_arm_would_be(both):
    arm, referee = both
    path = read_trajectory(ROBOTS / arm.robot.urdf.name / "trajectory.csv", arm)
    moved = compensate(arm, path).trajectory
    rows = [i for i, via in enumerate(path.via) if via]
    assert len(rows) >= 6
    sags = []
    for i in rows:
        commanded, compensated = (dict(zip(arm.joint_names, q, strict=True)) for q in (path.q[i], moved.q[i]))
        wanted = referee.rigid_tip(commanded, path.payload[i])[:3, 3]
        sags.append(np.linalg.norm(referee.solve(commanded, path.payload[i])[2][:3, 3] - wanted))
        assert np.linalg.norm(referee.solve(compensated, path.payload[i])[2][:3, 3] - wanted) < 1e-9, path.via[i]
    assert max(sags) > 0.003


# MuJoCo's own springs as a solver.

STIFFNESS = {"J1": 1.6e5, "J2": 1.3e5, "J3": 1e5, "J4": 2.5e4, "J5": 2e4, "J6": 1.5e4}


def relaxed(referee: Referee, q: dict[str, float], payload: str) -> tuple[np.ndarray, np.ndarray]:
    """Return joint positions (n,) and tip (4, 4) once springs that pull every joint to q have come to rest."""
    spec = referee.spec(payload)
    spec.option.timestep = 0.01
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model = spec.compile()
    for name, value in q.items():
        joint = model.joint(name)
        model.jnt_stiffness[joint.id] = STIFFNESS[name]
        model.qpos_spring[joint.qposadr[0]] = value
        model.dof_damping[joint.dofadr[0]] = 0.15 * STIFFNESS[name]
    data = mujoco.MjData(model)
    places = [model.joint(name).qposadr[0] for name in q]
    data.qpos[places] = list(q.values())
    for _ in range(20000):
        mujoco.mj_step(model, data)
        if np.abs(data.qvel).max() < 1e-13:
            break
    assert np.abs(data.qvel).max() < 1e-13
    mujoco.mj_forward(model, data)
    return data.qpos[places].copy(), referee.tip(model, data)


@pytest.mark.slow
@pytest.mark.parametrize("payload", ["none", "p200"])
@pytest.mark.parametrize("seed", range(3))
def test_springs_at_rest(payload, seed):
    """Six soft drives and nothing else that gives."""
    referee, declared = Referee("heavy_six"), load_arm(ROBOTS / "heavy_six" / "arm.toml")
    drives = []
    for joint in declared.robot.moving:
        compliance = np.zeros((6, 6))
        compliance[3:, 3:] = np.outer(joint.axis, joint.axis) / STIFFNESS[joint.name]
        drives.append(Flexure(joint.name, joint.name, LinearLaw(compliance)))
    arm = Arm(declared.robot, tuple(drives), declared.payloads)
    q = np.random.default_rng(seed).uniform(0.5 * arm.robot.lower, 0.5 * arm.robot.upper)
    rest, tip = relaxed(referee, dict(zip(arm.joint_names, q, strict=True)), payload)
    result = arm.deflection(q, payload)
    turns = [twist[3:] @ joint.axis for twist, joint in zip(result.twists, arm.robot.moving, strict=True)]
    np.testing.assert_allclose(q + turns, rest, rtol=0, atol=1e-10)
    np.testing.assert_allclose(result.pose.homogeneous, tip, rtol=0, atol=1e-10)
    assert np.linalg.norm(result.displacement[:3]) > 0.004
