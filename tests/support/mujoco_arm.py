"""A bundled arm as MuJoCo knows it: shares no code with the package that it judges."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from scipy.linalg import eigh

from armflex import Wrench
from support.small_arms import ROBOTS, skew_parts


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
    """An arm as MuJoCo knows it: a bundled one by its name, or that of a folder."""

    def __init__(self, name: str | Path) -> None:
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
        for power in range(9):
            if (key := f"compliance_q{power}" if power else "compliance") in flexure:
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
        self, model: mujoco.MjModel, data: mujoco.MjData, names: list[str], twists: np.ndarray, pushes: Sequence[Wrench]
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


class Sprung:
    """A bundled arm whose drives are springs, as MuJoCo has it under one payload: at rest, and how it swings.

    Attributes:
        model, data: MuJoCo's.
        stiffness: (nq,) of the springs [Nm/rad or N/m].
        places, dofs: Of the joints among MuJoCo's positions and velocities.
    """

    def __init__(
        self, referee: Referee, joints: Sequence[str], payload: str, stiffness: np.ndarray, masses: dict[str, float]
    ) -> None:
        """`masses` has factors on mass and moments of inertia by body, 'payload' for what is carried."""
        spec = referee.spec(payload)
        self.model = spec.compile()
        for name, factor in masses.items():
            number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name)
            if number >= 0:
                self.model.body_mass[number] *= factor
                self.model.body_inertia[number] *= factor
        self.data, self.stiffness = mujoco.MjData(self.model), np.asarray(stiffness)
        mujoco.mj_setConst(self.model, self.data)
        self.places = [self.model.joint(name).qposadr[0] for name in joints]
        self.dofs = [self.model.joint(name).dofadr[0] for name in joints]
        self.tip = self.model.body(referee.toml["robot"]["tip"]).id

    def held(self, at: np.ndarray) -> np.ndarray:
        """Return (nq,) what drives must exert to hold joint positions."""
        self.data.qpos[self.places] = at
        mujoco.mj_forward(self.model, self.data)
        return self.data.qfrc_bias[self.dofs].copy()

    def rest(self, q: np.ndarray) -> np.ndarray:
        """Return (nq,) where the joints come to rest when their drives are at q, and leave the arm there."""
        rest = q.copy()
        for _ in range(500):
            rest, before = q - self.held(rest) / self.stiffness, rest
            if np.abs(rest - before).max() < 1e-15:
                break
        self.held(rest)
        return rest

    def point(self, lever: np.ndarray) -> np.ndarray:
        """Return (3,) a point of the tip [m] where the arm was left."""
        return self.data.xpos[self.tip] + self.data.xmat[self.tip].reshape(3, 3) @ lever

    def mass(self) -> np.ndarray:
        """Return the (nq, nq) mass matrix where the arm was left."""
        whole = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, whole)
        return whole[np.ix_(self.dofs, self.dofs)]

    def springs(self, rest: np.ndarray) -> np.ndarray:
        """Return the (nq, nq) stiffness at rest, by central differences of the forces."""
        steps = 1e-5 * np.eye(len(rest))
        bent = np.column_stack([(self.held(rest + step) - self.held(rest - step)) / 2e-5 for step in steps])
        return np.diag(self.stiffness) + 0.5 * (bent + bent.T)

    def swings(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the frequencies [Hz] about the rest at q, and the tip's shapes (m, 6) for unit modal mass."""
        rest = self.rest(q)
        stiffness = self.springs(rest)
        self.held(rest)
        squares, vectors = eigh(stiffness, self.mass())
        linear, turning = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        mujoco.mj_jacBody(self.model, self.data, linear, turning, self.tip)
        return np.sqrt(squares) / (2.0 * np.pi), (np.vstack([linear, turning])[:, self.dofs] @ vectors).T
