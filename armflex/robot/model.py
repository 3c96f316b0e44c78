"""Pinocchio models of a robot, rigid or with a free-flyer wherever it may give.

The models are built joint by joint from the validated data rather than from edited URDF text: every position is one
number (Pinocchio reads a continuous joint as a cosine and a sine), numbers are parsed once, and joints keep the
chain's order. `tests/referee/test_robot.py` holds the result against Pinocchio's own URDF reader.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import UnsupportedError
from armflex.robot.robot import Robot
from armflex.robot.urdf import MOVING, Inertial, Joint

MAX_FREEDOMS = 1000
"""Joints and six times the flexures; Pinocchio's workspace grows with the cube of it (3500 take 22 s to make)."""


@dataclass(frozen=True)
class Site:
    """Where something gives: outboard of a joint's motion, in its child frame; the base when `joint` is None.

    With `before` it is the end of the link that the joint ends: inboard of the joint's motion, in its origin frame.
    """

    name: str
    joint: str | None
    before: bool = False


@dataclass(frozen=True)
class Corrections:
    """Constant errors of the kinematics, found by calibration.

    Attributes:
        joint_offset: What each joint's true position exceeds the reported one by [rad or m].
        geometry: (6,) twist of each joint's origin frame, in its own axes [m, rad].
        bodies: (4,) extra mass of a link [kg], and how far its centre of mass is from the declared one [m].
    """

    joint_offset: Mapping[str, float] = field(default_factory=dict)
    geometry: Mapping[str, Array] = field(default_factory=dict)
    bodies: Mapping[str, Array] = field(default_factory=dict)

    @property
    def move(self) -> bool:
        """Whether the rigid arm stands elsewhere than without them."""
        return any(self.joint_offset.values()) or any(np.any(twist) for twist in self.geometry.values())

    def body(self, link: str, inertial: Inertial | None) -> pin.Inertia | None:
        """Return the true body of a link, None for one without mass."""
        extra = self.bodies.get(link, np.zeros(4))
        nominal = pin.Inertia.Zero()
        if inertial is not None:
            # Pinocchio wants exact symmetry and no negative diagonal: rounding would break both, and
            # `Robot.check_motion` refuses what is negative by more.
            turned = inertial.turned
            np.fill_diagonal(turned, np.diag(turned).clip(0.0))
            nominal = pin.Inertia(inertial.mass, inertial.origin, turned)
        mass = nominal.mass + float(extra[0])
        if mass <= 0.0:
            return None
        return pin.Inertia(mass, nominal.lever + extra[1:], nominal.inertia)

    def frame(self, joint: Joint) -> pin.SE3:
        """Return the true origin frame of a joint in its nominal one."""
        return pin.exp6(pin.Motion(np.asarray(self.geometry.get(joint.name, np.zeros(6)))))

    def zero(self, joint: Joint) -> pin.SE3:
        """Return the true zero of a moving joint in its origin frame."""
        return joint.motion(self.joint_offset.get(joint.name, 0.0))


@dataclass(frozen=True)
class FlexModel:
    """A Pinocchio model and where its parts are.

    Attributes:
        model: Shared read-only; each thread makes its own `pin.Data`.
        neutral: (nq_model,) configuration with all joints and flexures at zero.
        q_index: (nq,) place of each joint position in the configuration.
        v_index: (nq,) place of each joint velocity.
        flexure_v: (6 n,) places of the flexures' twists, in the order of the sites.
        tip: Frame id of the tip link.
        base: Frame id of the base link.
    """

    model: pin.Model
    neutral: Array
    q_index: np.ndarray
    v_index: np.ndarray
    flexure_v: np.ndarray
    tip: int
    base: int

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links at and beyond the base."""
        return tuple(frame.name for frame in self.model.frames if frame.type == pin.FrameType.BODY)

    def frame(self, link: str) -> int:
        """Return the frame id of a link that is known to exist (Pinocchio answers any other name, too)."""
        return self.model.getFrameId(link, pin.FrameType.BODY)


def build_model(
    robot: Robot,
    sites: Sequence[Site] = (),
    payload: pin.Inertia | None = None,
    corrections: Corrections | None = None,
) -> FlexModel:
    """Return the model of a robot with a flexure at every site, several at one joint in series.

    Args:
        robot: A validated robot.
        sites: Places of the flexures; names and joints must exist in the robot.
        payload: Inertia in the tip frame, rigidly fixed to the tip.
        corrections: Constant errors of the kinematics; none when not given.

    Raises:
        UnsupportedError: More than `MAX_FREEDOMS` degrees of freedom.
    """
    freedoms = len(robot.moving) + 6 * len(sites)
    if freedoms > MAX_FREEDOMS:
        raise UnsupportedError(f"{robot.urdf.path}: {freedoms} degrees of freedom, more than {MAX_FREEDOMS}")
    corrections, model, on_chain = corrections or Corrections(), pin.Model(), {joint.name for joint in robot.chain}
    model.name, model.gravity.linear = robot.urdf.name, robot.gravity

    def flexed(joint: str | None, parent: int, place: pin.SE3, before: bool = False) -> tuple[int, pin.SE3]:
        """Add the flexures at a joint; return the Pinocchio joint of what is beyond them, and its place on that."""
        for site in sites:
            if site.joint == joint and site.before == before:
                parent = model.addJoint(parent, pin.JointModelFreeFlyer(), place, _flexure_name(site))
                place = pin.SE3.Identity()
        return parent, place

    def jointed(joint: Joint, parent: int, place: pin.SE3) -> tuple[int, pin.SE3]:
        """Add a joint and the flexures behind it; return the Pinocchio joint and the child link's place on it."""
        here = place * pin.SE3(joint.rotation, joint.origin) * corrections.frame(joint)
        parent, here = flexed(joint.name, parent, here, before=True)
        if joint.kind not in MOVING:
            return flexed(joint.name, parent, here)
        if joint.name not in on_chain:
            return parent, here * joint.motion(robot.locked[joint.name])
        added = model.addJoint(parent, _joint_model(joint), here * corrections.zero(joint), joint.name)
        return flexed(joint.name, added, pin.SE3.Identity())

    stack = [(robot.base, *flexed(None, 0, pin.SE3.Identity()))]
    while stack:
        link, parent, place = stack.pop()
        body = corrections.body(link, robot.urdf.links[link].inertial)
        if body is not None:
            model.appendBodyToJoint(parent, body, place)
        model.addFrame(pin.Frame(link, parent, 0, place, pin.FrameType.BODY))
        stack.extend((joint.child, *jointed(joint, parent, place)) for joint in robot.urdf.children[link])
    tip = model.getFrameId(robot.tip, pin.FrameType.BODY)
    if payload is not None:
        model.appendBodyToJoint(model.frames[tip].parentJoint, payload, model.frames[tip].placement)
    joints = [model.joints[model.getJointId(name)] for name in robot.joint_names]
    starts = [model.joints[model.getJointId(_flexure_name(site))].idx_v for site in sites]
    return FlexModel(
        model=model,
        neutral=pin.neutral(model),
        q_index=np.array([joint.idx_q for joint in joints]),
        v_index=np.array([joint.idx_v for joint in joints]),
        flexure_v=np.array([start + axis for start in starts for axis in range(6)], dtype=int),
        tip=tip,
        base=model.getFrameId(robot.base, pin.FrameType.BODY),
    )


def _flexure_name(site: Site) -> str:
    return f"flexure:{site.name}"  # a prefix, because a flexure may have its joint's name


def _joint_model(joint: Joint) -> pin.JointModel:
    aligned = ("PX", "PY", "PZ") if joint.kind == "prismatic" else ("RX", "RY", "RZ")
    for axis, name in zip(np.eye(3), aligned, strict=True):
        if np.array_equal(axis, joint.axis):
            return getattr(pin, f"JointModel{name}")()
    if joint.kind == "prismatic":
        return pin.JointModelPrismaticUnaligned(joint.axis)
    return pin.JointModelRevoluteUnaligned(joint.axis)
