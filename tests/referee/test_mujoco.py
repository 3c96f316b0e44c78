"""MuJoCo as referee: loads, forward kinematics and, for single-axis drives, the equilibrium itself.

The first referee shares no code with armflex: MuJoCo reads the bundled URDF, every moving body gets three slides and
a ball behind its joint, their generalized gravity gives the wrench on the flexure in its moved frame, and the pose
is exp6 of C times that wrench with an exponential written out here, iterated to a fixed point. (Three slides and
three hinges would be another convention, some tenths of a millimetre away.) The second lets MuJoCo's own springs and
dampers come to rest.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Sequence
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from support.small_arms import ROBOTS, skew_parts

from armflex import Arm, Flexure, Wrench, compensate, load_arm, read_trajectory
from armflex.laws import LinearLaw


def exp6(twist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return position and quaternion (w x y z) of the exponential of a (6,) twist, linear first."""
    turn = twist[3:]
    angle = np.linalg.norm(turn)
    cross = skew_parts(turn)
    half = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2  # (1 - cos) / angle^2
    square = angle * angle
    third = 1 / 6 - square / 120 + square**2 / 5040 - square**3 / 362880  # (angle - sin) / angle^3
    position = (np.eye(3) + half * cross + third * cross @ cross) @ twist[:3]
    return position, np.concatenate([[np.cos(0.5 * angle)], 0.5 * np.sinc(0.5 * angle / np.pi) * turn])


class Referee:
    """A bundled arm as MuJoCo knows it."""

    def __init__(self, name: str) -> None:
        folder = ROBOTS / name
        self.toml = tomllib.loads((folder / "arm.toml").read_text())
        self.urdf = (folder / "robot.urdf").read_text()
        self.models: dict[str, mujoco.MjModel] = {}

    def spec(self, payload: str, flexures: bool = False) -> mujoco.MjSpec:
        """Return the URDF with the payload fixed to the tip, and with a body of its own for what a joint moves."""
        root = ElementTree.fromstring(self.urdf)
        for flexure in self.toml["flexure"].values() if flexures else ():
            child = root.find(f"joint[@name='{flexure['joint']}']/child")
            link, moved = child.get("link"), f"{flexure['joint']}/moved"
            child.set("link", moved)
            ElementTree.SubElement(root, "link", name=moved)
            given = ElementTree.SubElement(root, "joint", name=f"{moved}/joint", type="fixed")
            ElementTree.SubElement(given, "parent", link=moved)
            ElementTree.SubElement(given, "child", link=link)
        # Bodies need some mass to move; 1e-14 kg weigh less than the comparison can see.
        options = {"fusestatic": "false", "discardvisual": "true", "boundmass": "1e-14", "boundinertia": "1e-14"}
        ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", options)
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, "unicode"))
        spec.option.gravity = self.toml["robot"]["gravity"]
        carried = self.toml["payload"].get(payload, {"mass": 0.0})
        if carried["mass"]:
            load = spec.body(self.toml["robot"]["tip"]).add_body(name="payload")
            load.mass, load.ipos, load.fullinertia = carried["mass"], carried["com"], carried["inertia"]
            load.explicitinertial = True
        return spec

    def model(self, payload: str) -> mujoco.MjModel:
        """Return the model with slides and a ball behind every joint that gives."""
        if payload not in self.models:
            spec = self.spec(payload, flexures=True)
            for name, flexure in self.toml["flexure"].items():
                (body,) = spec.joint(flexure["joint"]).parent.bodies
                for axis, direction in zip("xyz", np.eye(3), strict=True):
                    body.add_joint(name=f"{name}/{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=direction)
                body.add_joint(name=f"{name}/ball", type=mujoco.mjtJoint.mjJNT_BALL)
            for joint in spec.joints:
                joint.armature = 1.0  # for MuJoCo's own checks of the mass matrix; statics does not see it
            self.models[payload] = spec.compile()
        return self.models[payload]

    def compliance(self, name: str, q: dict[str, float]) -> np.ndarray:
        """Return the (6, 6) that the arm.toml states, its polynomial written out."""
        flexure, total = self.toml["flexure"][name], np.zeros((6, 6))
        for key, power in (("compliance", 0), ("compliance_q1", 1), ("compliance_q2", 2), ("compliance_q3", 3)):
            if key in flexure:
                values = np.array(flexure[key])
                total += (np.diag(values) if values.ndim == 1 else values) * q[flexure["joint"]] ** power
        return total

    def solve(
        self, q: dict[str, float], payload: str, pushes: Sequence[Wrench] = ()
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return wrenches (n, 6), twists (n, 6) and the tip's pose (4, 4)."""
        model = self.model(payload)
        data = mujoco.MjData(model)
        for name, value in q.items():
            data.qpos[model.joint(name).qposadr[0]] = value
        names = list(self.toml["flexure"])
        compliances = [self.compliance(name, q) for name in names]
        twists = np.zeros((len(names), 6))
        for _ in range(200):
            wrenches = self.wrenches(model, data, names, twists, pushes)
            updated = np.array([c @ w for c, w in zip(compliances, wrenches, strict=True)])
            change, twists = np.abs(updated - twists).max(), updated
            if change < 1e-16:
                break
        assert change < 1e-15
        return self.wrenches(model, data, names, twists, pushes), twists, self.tip(model, data)

    def wrenches(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        names: list[str],
        twists: np.ndarray,
        pushes: Sequence[Wrench],
    ) -> np.ndarray:
        """Put the flexures at exp6 of their twists; return the wrench on each in its moved frame."""
        slides = [[model.joint(f"{name}/{axis}") for axis in "xyz"] for name in names]
        balls = [model.joint(f"{name}/ball") for name in names]
        for slide, ball, twist in zip(slides, balls, twists, strict=True):
            position, quaternion = exp6(twist)
            data.qpos[[joint.qposadr[0] for joint in slide]] = position
            data.qpos[ball.qposadr[0] : ball.qposadr[0] + 4] = quaternion
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_fwdVelocity(model, data)
        held, found = data.qfrc_bias.copy(), []
        for push in pushes:
            body, given = data.body(push.frame), np.zeros(model.nv)
            turn = np.eye(3) if push.axes == "base" else body.xmat.reshape(3, 3)
            number = model.body(push.frame).id
            mujoco.mj_applyFT(model, data, turn @ push.force, turn @ push.moment, body.xpos, number, given)
            held -= given
        for slide, ball in zip(slides, balls, strict=True):
            rotation, start = np.zeros(9), ball.qposadr[0]
            mujoco.mju_quat2Mat(rotation, data.qpos[start : start + 4])
            force = -held[[joint.dofadr[0] for joint in slide]]  # along axes that the ball does not turn
            moment = -held[ball.dofadr[0] : ball.dofadr[0] + 3]
            found.append(np.concatenate([rotation.reshape(3, 3).T @ force, moment]))
        return np.array(found)

    def rigid_tip(self, q: dict[str, float], payload: str) -> np.ndarray:
        """Return the tip's pose (4, 4) with every flexure straight."""
        model = self.model(payload)
        data = mujoco.MjData(model)
        for name, value in q.items():
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        return self.tip(model, data)

    def tip(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        body = data.body(self.toml["robot"]["tip"])
        return np.block([[body.xmat.reshape(3, 3), body.xpos[:, None]], [np.zeros(3), np.ones(1)]])


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
