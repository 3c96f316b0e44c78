"""A robot as Pinocchio models it, rigid or with a free-flyer wherever it may give.

The models are built joint by joint from the validated data rather than from edited URDF text: every position is one
number (Pinocchio reads a continuous joint as a cosine and a sine), numbers are parsed once, and joints keep the
chain's order. `tests/referee/test_robot.py` holds the result against Pinocchio's own URDF reader.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import UnsupportedError
from armflex.robot import Corrections, Robot, Site
from armflex.robot.urdf import MOVING, Joint
from armflex.rows.wrench import Wrench, wrenches_in

BASE_AXES = pin.LOCAL_WORLD_ALIGNED
NOTHING_KNOWN: Mapping[str, Array] = {}

MAX_FREEDOMS = 1000
"""Joints and six times the flexures; Pinocchio's workspace grows with the cube of it (3500 take 22 s to make)."""


def frame_jacobian(model: pin.Model, data: pin.Data, configuration: Array, frame: int, axes: Any) -> Array:
    """Return the (6, nv) motion of a frame per body motion of everything; where nv is 1 Pinocchio returns (6,)."""
    return pin.computeFrameJacobian(model, data, configuration, frame, axes).reshape(6, model.nv)


@dataclass(frozen=True)
class FlexModel:
    """A Pinocchio model and where its parts are.

    Attributes:
        model: Shared read-only; each thread makes its own `pin.Data`.
        neutral: (nq_model,) configuration with all joints and flexures at zero.
        q_index: (nq,) place of each joint position in the configuration; cylinders, which are last, have none.
        v_index: (nq,) place of each joint velocity.
        flexure_v: (6 n,) places of the flexures' twists, in the order of the sites; of those at closures in the slots.
        tip: Frame id of the tip link.
        base: Frame id of the base link.
        free_q, free_v: (p,) places of the joints without a drive.
        size: Velocities of the model, and after them six slots for each closure of the robot's linkage.
    """

    model: pin.Model
    neutral: Array
    q_index: np.ndarray
    v_index: np.ndarray
    flexure_v: np.ndarray
    tip: int
    base: int
    free_q: np.ndarray
    free_v: np.ndarray
    size: int

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
    corrections: Corrections | None = None,
) -> FlexModel:
    """Return the model of a robot with a flexure at every site, several at one joint in series.

    Args:
        robot: A validated robot.
        sites: Places of the flexures; names and joints must exist in the robot.
        corrections: Constant errors of the kinematics; none when not given.

    Raises:
        UnsupportedError: More than `MAX_FREEDOMS` degrees of freedom.
    """
    freedoms = len(robot.jointed) + 6 * len(sites)
    if freedoms > MAX_FREEDOMS:
        raise UnsupportedError(f"{robot.urdf.path}: {freedoms} degrees of freedom, more than {MAX_FREEDOMS}")
    corrections, model, on_chain = corrections or Corrections(), pin.Model(), {joint.name for joint in robot.places}
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

    # A joint is added with all that it carries before the next one: Pinocchio takes subtrees to be consecutive.
    stack: list[tuple[str, Joint | None, int, pin.SE3]] = [(robot.base, None, *flexed(None, 0, pin.SE3.Identity()))]
    while stack:
        link, joint, parent, place = stack.pop()
        if joint is not None:
            parent, place = jointed(joint, parent, place)
        body = corrections.body(link, robot.urdf.links[link].inertial)
        if body is not None:
            model.appendBodyToJoint(parent, body, place)
        model.addFrame(pin.Frame(link, parent, 0, place, pin.FrameType.BODY))
        stack.extend((joint.child, joint, parent, place) for joint in robot.urdf.children[link])
    tip = model.getFrameId(robot.tip, pin.FrameType.BODY)
    joined, free = robot.linkage.joined, robot.linkage.free
    driven = (joint.name for joint in robot.jointed if joint.name not in free)
    joints, freed = ([model.joints[model.getJointId(name)] for name in names] for names in (driven, free))
    starts = [
        model.nv + 6 * joined.index(site.joint)
        if site.joint in joined
        else model.joints[model.getJointId(_flexure_name(site))].idx_v
        for site in sites
    ]
    return FlexModel(
        model=model,
        neutral=pin.neutral(model),
        q_index=np.array([joint.idx_q for joint in joints], dtype=int),
        v_index=np.array([joint.idx_v for joint in joints], dtype=int),
        flexure_v=np.array([start + axis for start in starts for axis in range(6)], dtype=int),
        tip=tip,
        base=model.getFrameId(robot.base, pin.FrameType.BODY),
        free_q=np.array([joint.idx_q for joint in freed], dtype=int),
        free_v=np.array([joint.idx_v for joint in freed], dtype=int),
        size=model.nv + 6 * len(robot.linkage.closures),
    )


def carrying(flex: FlexModel, payload: pin.Inertia | None, gravity: Array) -> FlexModel:
    """Return a copy of a model with a payload, an inertia in the tip frame, at its tip, under (3,) gravity [m/s^2]."""
    model, tip = copy(flex.model), flex.model.frames[flex.tip]
    model.gravity.linear = gravity
    if payload is not None:
        model.appendBodyToJoint(tip.parentJoint, payload, tip.placement)
    return replace(flex, model=model)


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


class Load(Protocol):
    """A load from outside on one link, which may depend on where the link is."""

    @property
    def frame(self) -> str:
        """The link."""
        ...

    @property
    def dead(self) -> bool:
        """Whether the wrench is the same wherever the link is."""
        ...

    @property
    def follows(self) -> bool:
        """Whether the wrench is the same in the axes of its link wherever that is: a follower load."""
        ...

    @property
    def sizes(self) -> tuple[float, float]:
        """Of force [N] and moment [N m], of a dead or a follower load."""
        ...

    def at(self, pose: Array) -> Array:
        """Return the (..., 6) wrench on the structure at the link's origin, base axes, for (..., 4, 4) poses of it."""
        ...

    def change(self, pose: Array) -> Array:
        """Return the (..., 6, 6) change of that wrench per shift and small rotation of the link, base axes."""
        ...


class LoadCase(NamedTuple):
    """One configuration, or N, and what acts there.

    Attributes:
        q, v, a: (nq,) or (N, nq) joint positions [rad or m], velocities and accelerations; None where the arm stands.
        wrenches: Loads from outside, beside those that the arm's effects put on its links; of N configurations each
            the same in all, or one for each.
        covariates: What the laws may know beyond positions, by name: numbers, or (N,) of them, in SI units.
    """

    q: Array
    v: Array | None = None
    a: Array | None = None
    wrenches: tuple[Wrench, ...] = ()
    covariates: Mapping[str, Array] = NOTHING_KNOWN

    @property
    def moves(self) -> bool:
        """Whether there is a velocity or an acceleration."""
        return self.v is not None or self.a is not None

    @property
    def motion(self) -> Array | None:
        """(2, nq) or (N, 2, nq) velocities and accelerations; None where it stands."""
        if not self.moves:
            return None
        motion = np.zeros((*self.q.shape[:-1], 2, self.q.shape[-1]))
        for order, rates in enumerate((self.v, self.a)):
            if rates is not None:
                motion[..., order, :] = rates
        return motion

    def some(self, rows: int | slice | np.ndarray) -> LoadCase:
        """Return one of N rows, or the (M,) of some numbers."""
        v, a = (None if values is None else values[rows] for values in (self.v, self.a))
        known = {name: values[rows] if np.ndim(values) else values for name, values in self.covariates.items()}
        return LoadCase(self.q[rows], v, a, wrenches_in(self.wrenches, rows), known)
