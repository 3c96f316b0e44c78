"""A robot as Pinocchio models it, rigid or with a free-flyer wherever it may give, and what the models are asked.

The models are built joint by joint from the validated data rather than from edited URDF text: every position is one
number (Pinocchio reads a continuous joint as a cosine and a sine), numbers are parsed once, and joints keep the
chain's order. `tests/referee/test_robot.py` holds the result against Pinocchio's own URDF reader.

Asked are the loads on the flexures, how they change, and where the tip is. Everything is in the generalized velocities
of the flexible model: a motion has the twists of the flexures, exponential coordinates, among zeros for the joints, and
a torque is minus the loads that deform them. So nothing is gathered where an equilibrium is found.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import UnsupportedError
from armflex.mechanics.laws import LawStack, PlacedLaws
from armflex.mechanics.spring import Spring
from armflex.mechanics.ties import Ties
from armflex.robot import Corrections, Robot, Site
from armflex.robot.linkage import Linkage
from armflex.robot.urdf import MOVING, Joint
from armflex.rows.wrench import Wrench, same_objects, wrenches_in

gravity, static_torque, rnea, integrate = (
    pin.computeGeneralizedGravity,
    pin.computeStaticTorque,
    pin.rnea,
    pin.integrate,
)
place_frames, place_joints = pin.framesForwardKinematics, pin.forwardKinematics
log3, dot, BASE_AXES = pin.log3, np.dot, pin.LOCAL_WORLD_ALIGNED

BASE = np.eye(4)
NOTHING_KNOWN: Mapping[str, Array] = {}

TERMS = 20
"""Of the series of exp6's derivative, which ends below rounding for turns of a radian."""

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
    if payload is not None:
        model.appendBodyToJoint(model.frames[tip].parentJoint, payload, model.frames[tip].placement)
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

    def some(self, rows: int | slice | np.ndarray) -> LoadCase:
        """Return one of N rows, or the (M,) of some numbers."""
        v, a = (None if values is None else values[rows] for values in (self.v, self.a))
        known = {name: values[rows] if np.ndim(values) else values for name, values in self.covariates.items()}
        return LoadCase(self.q[rows], v, a, wrenches_in(self.wrenches, rows), known)


class Mechanics:
    """One thread's Pinocchio of an arm with its payload, rigid and flexible; never to be shared between threads."""

    def __init__(
        self,
        rigid: FlexModel,
        flex: FlexModel,
        stack: LawStack,
        pulls: Sequence[Load] = (),
        springs: Sequence[Spring] = (),
        linkage: Linkage | None = None,
        moved: Mapping[str, Array] | None = None,
    ) -> None:
        self.rigid, self.flex, self.pulls, self.linkage = rigid, flex, tuple(pulls), linkage or Linkage()
        self.model, self.data, self._rigid_data = flex.model, flex.model.createData(), rigid.model.createData()
        self.ties = Ties(self.model, self.data, self.linkage, springs, moved) if springs or linkage else None
        self.solver: tuple[tuple[Any, ...], Any] | None = None  # of `loop_rows`, which keeps them here
        self.trees: tuple[Any, Any, Any] | None = None
        self.laws = PlacedLaws(stack, flex.flexure_v.reshape(-1, 6), flex.size)
        self._frames = {link: flex.frame(link) for link in flex.links}
        self._carriers: dict[str, tuple[int, Array, Array]] = {}
        # Views into Pinocchio's own memory: to ask for them costs more than to compute what they show.
        self._turns = [self.data.oMi[at].rotation.T.reshape(9) for at in range(self.model.njoints)]
        self.weight = partial(gravity, self.model, self.data)
        self.flexures = np.ix_(flex.flexure_v, flex.flexure_v)
        tip, rigid_tip = self.data.oMf[flex.tip], self._rigid_data.oMf[rigid.tip]
        self._shift, self._turn = tip.translation, tip.rotation
        self._last = (), self._loaded((), static_torque)
        self._rigid_shift, self._rigid_turn = rigid_tip.translation, rigid_tip.rotation.T

    def rigid_configuration(self, q: Array) -> Array:
        """Return the flexible model's configuration with the joints at (nq,) positions and every flexure at zero."""
        configuration = self.flex.neutral.copy()
        configuration[self.flex.q_index] = q
        return configuration

    def flexed(self, rigid: Array, motion: Array) -> Array:
        """Return the configuration with the flexures at exp6 of the twists in a (nv,) motion."""
        return integrate(self.model, rigid, motion)

    def load(self, case: LoadCase) -> Callable[[Array], Array]:
        """Return the map from configurations to (nv,) generalized torques that hold the arm [N, Nm].

        They are what parents exert on children: minus the loads that deform.
        """
        load = self._of_tree(case)
        return load if self.ties is None else partial(self._sprung, load)

    def _of_tree(self, case: LoadCase) -> Callable[[Array], Array]:
        """Return the same without springs."""
        moves = case.v is not None or case.a is not None
        if not (moves or case.wrenches or self.pulls):
            return self.weight
        if moves:
            v, a = self._velocities(case)
            return self._loaded(case.wrenches, partial(_accelerated, v, a))
        if not same_objects(self._last[0], case.wrenches):
            self._last = case.wrenches, self._loaded(case.wrenches, static_torque)
        return self._last[1]

    def _sprung(self, load: Callable[[Array], Array], configuration: Array) -> Array:
        """Return the torque that holds an arm with springs."""
        assert self.ties is not None
        torque = load(configuration)
        pin.computeJointJacobians(self.model, self.data, configuration)
        return torque + self.ties.sprung()[1]

    def spring_states(self, configuration: Array) -> Array:
        """Return (n_springs, 2) of lengths [m] and tensions [N]."""
        if self.ties is None:
            return np.empty((0, 2))
        pin.computeJointJacobians(self.model, self.data, configuration)
        return self.ties.sprung()[0]

    def _loaded(self, wrenches: tuple[Wrench, ...], hold: Callable[..., Array]) -> Callable[[Array], Array]:
        """Return the map for what holds the arm under forces on Pinocchio's joints, in their axes."""
        model, data, forces = self.model, self.data, pin.StdVec_Force()
        forces.extend([pin.Force.Zero()] * model.njoints)
        # What follows its link stands in the joint's axes; of what is dead the joint's rotation is a factor.
        standing: dict[int, Array] = {}
        dead: dict[int, Array] = {}
        posed = []
        for load in (*wrenches, *self.pulls):
            at, by_turn, by_link = self._carriers.get(load.frame) or self._carrier(load.frame)
            if load.follows:
                standing[at] = standing.get(at, 0.0) + load.at(BASE).dot(by_link)
            elif load.dead:
                dead[at] = dead.get(at, 0.0) + load.at(BASE).dot(by_turn)
            else:
                posed.append((load, self._frames[load.frame], forces[at].vector))
                dead.setdefault(at, np.zeros(54))
        for at, force in standing.items():
            forces[at].vector[:] = force
        turning = [
            (part.reshape(6, 9), self._turns[at], standing.get(at), forces[at].vector) for at, part in dead.items()
        ]
        if not turning:
            return lambda configuration: hold(model, data, configuration, forces)

        def loaded(configuration: Array) -> Array:
            place_joints(model, data, configuration)
            for per_turn, turn, same, here in turning:
                dot(per_turn, turn, here)
                if same is not None:
                    here += same
            for load, frame, here in posed:
                pose = pin.updateFramePlacement(model, data, frame)
                here += model.frames[frame].placement.act(_in_axes_of(pose, load)).vector
            return hold(model, data, configuration, forces)

        return loaded

    def _carrier(self, link: str) -> tuple[int, Array, Array]:
        """Return the Pinocchio joint of a link, and what makes a wrench on it a force on that, in its axes.

        (6, 54) by which a wrench in base axes is to be multiplied for the force per entry of the joint's rotation, by
        columns, and (6, 6) for one in axes of the link.
        """
        frame = self.model.frames[self._frames[link]]
        lever, lines = pin.skew(frame.placement.translation), np.eye(6).reshape(6, 2, 3)
        turned = [[np.kron(np.eye(3), part) for part in line] for line in lines]
        by_turn = np.array([np.vstack([force, moment + lever @ force]).ravel() for force, moment in turned])
        self._carriers[link] = found = frame.parentJoint, by_turn, frame.placement.inverse().action
        return found

    def stiffness(self, configuration: Array, case: LoadCase, forces: Array | None = None) -> Array:
        """Return the (nv, nv) change of the torque per body motion of joints and flexures: the geometric stiffness.

        Args:
            configuration: Of the flexible model.
            case: What acts.
            forces: (6 K,) in the closures' slots, where these and the springs are placed already; None without them.
        """
        total = self._stiffness_of_tree(configuration, case)
        if self.ties is not None:
            if forces is None:  # else they are placed already
                self.ties.place(configuration)
                self.ties.sprung()
            total += self.ties.stiffness(np.zeros(0) if forces is None else forces)
        return total

    def _stiffness_of_tree(self, configuration: Array, case: LoadCase) -> Array:
        model, data, loads = self.model, self.data, (*case.wrenches, *self.pulls)
        if not (loads or case.moves):
            return np.array(pin.computeGeneralizedGravityDerivatives(model, data, configuration))
        forces, (v, a) = self._forces(configuration, loads), self._velocities(case)
        total = np.array(pin.computeRNEADerivatives(model, data, configuration, v, a, forces)[0])
        for load in loads:
            # What the load adds by changing in its link's axes when the link moves.
            frame = self._frames[load.frame]
            jacobian = frame_jacobian(model, data, configuration, frame, pin.LOCAL)
            pose = self.frame_pose(configuration, frame)
            local, turn = _in_axes_of(pose, load), np.kron(np.eye(2), pose.rotation)
            change = turn.T @ load.change(pose.homogeneous) @ turn
            change[:, 3:] += np.vstack([pin.skew(local.linear), pin.skew(local.angular)])
            total -= jacobian.T @ change @ jacobian
        return total

    def exponential_jacobian(self, rigid: Array, motion: Array) -> Array:
        """Return the (6 n, 6 n) right Jacobian of exp6 at the twists: body motion per change of coordinates."""
        return pin.dIntegrate(self.model, rigid, motion, pin.ArgumentPosition.ARG1)[self.flexures]

    def tip_jacobian(self, configuration: Array) -> Array:
        """Return the (6, nv) motion of the tip origin in base axes per body motion of joints and flexures."""
        return frame_jacobian(self.model, self.data, configuration, self.flex.tip, BASE_AXES)

    def displacement(self, configuration: Array, q: Array) -> Array:
        """Return the (6,) displacement of the tip from where the rigid arm has it at (nq,) positions [m, rad]."""
        place_frames(self.model, self.data, configuration)
        place_frames(self.rigid.model, self._rigid_data, self._controlled(q))
        found = np.empty(6)
        np.subtract(self._shift, self._rigid_shift, found[:3])
        found[3:] = log3(self._turn.dot(self._rigid_turn))
        return found

    def _controlled(self, q: Array) -> Array:
        """Return the rigid model's configuration at (nq,) positions, where the controller knows it to be."""
        return q

    def frame_pose(self, configuration: Array, frame: int) -> pin.SE3:
        """Return a frame's pose in the base."""
        pin.forwardKinematics(self.model, self.data, configuration)
        return pin.updateFramePlacement(self.model, self.data, frame).copy()

    def rigid_tip_pose(self, q: Array) -> pin.SE3:
        """Return the tip's pose of the rigid arm at joint positions (nq,)."""
        pin.forwardKinematics(self.rigid.model, self._rigid_data, self._controlled(q))
        return pin.updateFramePlacement(self.rigid.model, self._rigid_data, self.rigid.tip).copy()

    def link_poses(self, configuration: Array) -> dict[str, Array]:
        """Return the (4, 4) pose of every link at and beyond the base."""
        place_frames(self.model, self.data, configuration)
        return {link: self.data.oMf[frame].homogeneous for link, frame in self._frames.items()}

    def joint_loads(self, configuration: Array, case: LoadCase) -> Array:
        """Return the (nq, 6) wrench on the structure at every joint, in the joint's child frame [N, Nm]."""
        forces, (v, a) = self._forces(configuration, (*case.wrenches, *self.pulls)), self._velocities(case)
        if self.ties is not None:
            self._sprung(self.weight, configuration)
            self.ties.push(np.zeros(0), forces)
        rnea(self.model, self.data, configuration, v, a, forces)
        return np.array([-self.data.f[self.model.getJointId(name)].vector for name in self.rigid.model.names[1:]])

    def _velocities(self, case: LoadCase) -> Array:
        """Return (2, nv) velocities and accelerations."""
        full = np.zeros((2, self.model.nv))
        for into, values in zip(full, (case.v, case.a), strict=True):
            if values is not None:
                into[self.flex.v_index] = values
        return full

    def _forces(self, configuration: Array, loads: Sequence[Load]) -> pin.StdVec_Force:
        """Return the external force on every Pinocchio joint, in its local frame."""
        forces = pin.StdVec_Force()
        forces.extend([pin.Force.Zero()] * self.model.njoints)
        for load in loads:
            frame = self._frames[load.frame]
            owner = self.model.frames[frame]
            local = _in_axes_of(self.frame_pose(configuration, frame), load)
            forces[owner.parentJoint] = forces[owner.parentJoint] + owner.placement.act(local)
        return forces


def _accelerated(v: Array, a: Array, *asked: Any) -> Array:
    """Return the torque that holds a moving arm under forces on its joints."""
    model, data, configuration, forces = asked
    return rnea(model, data, configuration, v, a, forces)


def _in_axes_of(pose: pin.SE3, load: Load) -> pin.Force:
    """Return a load in the axes of its link."""
    wrench = load.at(pose.homogeneous)
    return pin.Force(pose.rotation.T @ wrench[:3], pose.rotation.T @ wrench[3:])


def exponential_jacobian(twists: Array) -> Array:
    """Return the (..., 6, 6) body motion per change of (..., 6) exponential coordinates; Pinocchio's is good to 7e-9.

    The series `sum (-ad)^k / (k + 1)!` of the right Jacobian of SE(3) (Barfoot, State Estimation for Robotics, 7.83).
    """
    turning, found = np.zeros((*twists.shape, 6)), np.eye(6)
    for place in ((0, 0), (1, 1), (0, 1)):
        vector = twists[..., 3:] if place[0] == place[1] else twists[..., :3]
        skew = np.cross(vector[..., None, :], np.eye(3)).swapaxes(-1, -2)
        turning[..., 3 * place[0] : 3 * place[0] + 3, 3 * place[1] : 3 * place[1] + 3] = skew
    for k in range(TERMS, 0, -1):
        found = np.eye(6) - turning @ found / (k + 1)
    return found
