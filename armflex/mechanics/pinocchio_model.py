"""What Pinocchio is asked: loads on the flexures, how they change, and where the tip is.

One `Mechanics` belongs to one arm with one payload. It is shared between threads; each thread keeps its own
`pin.Data` here, because making one costs a hundred times what a query does.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.mechanics.loads import Load
from armflex.robot import FlexModel


@dataclass(frozen=True)
class LoadCase:
    """Where the joints are and what acts: q, v, a of shape (nq,), and external wrenches."""

    q: Array
    v: Array | None = None
    a: Array | None = None
    wrenches: tuple[Load, ...] = ()


@dataclass(frozen=True)
class Mechanics:
    """Pinocchio models of an arm with its payload, rigid and flexible."""

    rigid: FlexModel
    flex: FlexModel
    _local: threading.local = field(default_factory=threading.local, repr=False)

    def __reduce__(self) -> tuple:
        """Return the models; a workspace belongs to its thread and is made again."""
        return Mechanics, (self.rigid, self.flex)

    @property
    def data(self) -> pin.Data:
        """This thread's workspace for the flexible model."""
        if not hasattr(self._local, "flex"):
            self._local.flex = self.flex.model.createData()
            self._local.rigid = self.rigid.model.createData()
        return self._local.flex

    def straight(self, case: LoadCase) -> Array:
        """Return the flexible model's configuration with the joints at q and every flexure at zero."""
        configuration = self.flex.neutral.copy()
        configuration[self.flex.q_index] = case.q
        return configuration

    def bent(self, straight: Array, twists: Array) -> Array:
        """Return the configuration with the flexures at exp6 of their (6 n,) twists."""
        return pin.integrate(self.flex.model, straight, self._velocity(twists))

    def exponential_jacobian(self, straight: Array, twists: Array) -> Array:
        """Return the (6 n, 6 n) right Jacobian of exp6 at the twists: body motion per change of coordinates."""
        whole = pin.dIntegrate(self.flex.model, straight, self._velocity(twists), pin.ArgumentPosition.ARG1)
        return whole[np.ix_(self.flex.flexure_v, self.flex.flexure_v)]

    def turning(self, straight: Array, configuration: Array, twists: Array, case: LoadCase) -> Array:
        """Return the (6 n, 6 n) fall of the flexures' loads per change of their twists, which bent the arm."""
        places = self.flex.flexure_v
        geometric = self.stiffness(configuration, case)[np.ix_(places, places)]
        return geometric @ self.exponential_jacobian(straight, twists)

    def _velocity(self, twists: Array) -> Array:
        velocity = np.zeros(self.flex.model.nv)
        velocity[self.flex.flexure_v] = twists
        return velocity

    def torque(self, configuration: Array, case: LoadCase) -> Array:
        """Return the (nv,) generalized force that holds the arm: what parents exert on children."""
        model, data = self.flex.model, self.data
        if case.v is None and case.a is None and not case.wrenches:
            return pin.computeGeneralizedGravity(model, data, configuration)
        return pin.rnea(model, data, configuration, *self._motion(case), self._forces(configuration, case))

    def loads(self, configuration: Array, case: LoadCase) -> Array:
        """Return the (6 n,) wrenches on the structure at the flexures, local axes [N, Nm]."""
        return -self.torque(configuration, case)[self.flex.flexure_v]

    def stiffness(self, configuration: Array, case: LoadCase) -> Array:
        """Return the (nv, nv) change of `torque` per body motion of joints and flexures: the geometric stiffness."""
        model, data = self.flex.model, self.data
        if case.v is None and case.a is None and not case.wrenches:
            return np.array(pin.computeGeneralizedGravityDerivatives(model, data, configuration))
        forces = self._forces(configuration, case)
        total = np.array(pin.computeRNEADerivatives(model, data, configuration, *self._motion(case), forces)[0])
        for load in case.wrenches:
            total += self._turning(configuration, load)
        return total

    def _motion(self, case: LoadCase) -> tuple[Array, Array]:
        full = []
        for values in (case.v, case.a):
            vector = np.zeros(self.flex.model.nv)
            if values is not None:
                vector[self.flex.v_index] = values
            full.append(vector)
        return full[0], full[1]

    def _turning(self, configuration: Array, load: Load) -> Array:
        """Return what a load adds to the stiffness by changing in its link's axes when the link moves."""
        model, data, frame = self.flex.model, self.data, self.flex.frame(load.frame)
        jacobian = pin.computeFrameJacobian(model, data, configuration, frame, pin.LOCAL)
        pose = self.frame_pose(configuration, frame)
        local = self._local_load(pose, load)
        turn = np.kron(np.eye(2), pose.rotation)
        change = turn.T @ load.change(pose.homogeneous) @ turn
        change[:, 3:] += np.vstack([pin.skew(local.linear), pin.skew(local.angular)])
        return -jacobian.T @ change @ jacobian

    @staticmethod
    def _local_load(pose: pin.SE3, load: Load) -> pin.Force:
        """Return a load in the axes of its link."""
        wrench = load.at(pose.homogeneous)
        return pin.Force(pose.rotation.T @ wrench[:3], pose.rotation.T @ wrench[3:])

    def _forces(self, configuration: Array, case: LoadCase) -> pin.StdVec_Force:
        """Return the external force on every Pinocchio joint, in its local frame."""
        forces = pin.StdVec_Force()
        forces.extend([pin.Force.Zero()] * self.flex.model.njoints)
        for load in case.wrenches:
            frame = self.flex.frame(load.frame)
            owner = self.flex.model.frames[frame]
            local = self._local_load(self.frame_pose(configuration, frame), load)
            forces[owner.parentJoint] = forces[owner.parentJoint] + owner.placement.act(local)
        return forces

    def frame_pose(self, configuration: Array, frame: int) -> pin.SE3:
        """Return a frame's pose in the base."""
        pin.forwardKinematics(self.flex.model, self.data, configuration)
        return pin.updateFramePlacement(self.flex.model, self.data, frame).copy()

    def tip_pose(self, configuration: Array) -> pin.SE3:
        """Return the tip's pose in the base."""
        return self.frame_pose(configuration, self.flex.tip)

    def link_poses(self, configuration: Array) -> dict[str, Array]:
        """Return the (4, 4) pose of every link at and beyond the base."""
        pin.framesForwardKinematics(self.flex.model, self.data, configuration)
        return {link: self.data.oMf[self.flex.frame(link)].homogeneous for link in self.flex.links}

    def tip_jacobian(self, configuration: Array) -> Array:
        """Return the (6, nv) motion of the tip origin in base axes per body motion of joints and flexures."""
        model, data = self.flex.model, self.data
        return pin.computeFrameJacobian(model, data, configuration, self.flex.tip, pin.LOCAL_WORLD_ALIGNED)

    def rigid_tip_pose(self, q: Array) -> pin.SE3:
        """Return the tip's pose of the rigid arm at joint positions (nq,)."""
        _ = self.data
        data = self._local.rigid
        pin.forwardKinematics(self.rigid.model, data, q)
        return pin.updateFramePlacement(self.rigid.model, data, self.rigid.tip).copy()

    def joint_loads(self, configuration: Array, case: LoadCase) -> Array:
        """Return the (nq, 6) wrench on the structure at every joint, in the joint's child frame [N, Nm]."""
        model, data = self.flex.model, self.data
        pin.rnea(model, data, configuration, *self._motion(case), self._forces(configuration, case))
        ids = [model.getJointId(name) for name in self.rigid.model.names[1:]]
        return np.array([-data.f[joint].vector for joint in ids])
