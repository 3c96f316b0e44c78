"""The position of a joint as an encoder on its links reads it: the drive's own compliance and backlash are in it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.readings.end import End, shifted, turned
from armflex.readings.kind import Ends, Kind
from armflex.readings.postures import Postures
from armflex.readings.sensor import SCALE, zero_of
from armflex.robot import Robot


@dataclass(frozen=True)
class Shaft:
    """The joint that an encoder reads: between the link inboard of it and its own.

    Attributes:
        joint: Its name.
        inboard: The link that it turns or slides on.
        straight: Whether it slides.
        axis: (3,) unit vector in its own axes.
        origin: (4, 4) its frame at zero in the inboard link [m].
    """

    joint: str
    inboard: str
    straight: bool
    axis: Array
    origin: Array


@dataclass(frozen=True, eq=False)
class Encoder(Kind):
    """(N, 1) angle or way of the joint's link on the one inboard of it [rad or m]."""

    dimension = 1
    unit, quantity = "rad", "angle"
    channels = ("",)
    nuisances = (zero_of(("",), "rad"), SCALE)

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return the joint's link, its shaft, and the kind: it slides or turns."""
        joints = {joint.name: joint for joint in robot.moving}
        joint = joints[table.choice("joint", tuple(joints))]
        slides, origin = joint.kind == "prismatic", np.eye(4)
        origin[:3, :3], origin[:3, 3] = joint.rotation, joint.origin
        shaft = Shaft(joint.name, joint.parent, slides, np.asarray(joint.axis), origin)
        return {"kind": SlideEncoder if slides else cls, "link": joint.child, "about": shaft}

    def _angle(self, at: Postures) -> tuple[Array, Array]:
        """Return the (N, 1) position [rad or m], and the (N, 3) motion in the base that it is of."""
        sensor, shaft = at.sensors[self.name], at.sensors[self.name].about
        inboard, link = at.pose(shaft.inboard) @ shaft.origin, at.pose(sensor.link)
        back, axis = inboard[:, :3, :3].swapaxes(1, 2), inboard[:, :3, :3] @ shaft.axis
        if shaft.straight:
            away = np.einsum("nij,nj->ni", back, link[:, :3, 3] - inboard[:, :3, 3])
            return away @ shaft.axis[:, None], axis
        # About where the controller has it: a rotation vector is about the axis but for what the joint gives.
        q = at.q[shaft.joint]
        turns = back @ link[:, :3, :3]
        left = [pin.exp3(-value * shaft.axis) @ turn for value, turn in zip(q, turns, strict=True)]
        turned_axes = [link[i, :3, :3] @ pin.Jlog3(turn).T @ shaft.axis for i, turn in enumerate(left)]
        angles = np.array([pin.log3(turn) for turn in left]).reshape(-1, 3) @ shaft.axis[:, None]
        return q[:, None] + angles, np.array(turned_axes).reshape(-1, 3)

    def ideal(self, at: Postures) -> Array:
        return self._angle(at)[0]

    def ends(self, at: Postures) -> Ends:
        """Return the joint's link, which turns or slides, and the one inboard of it."""
        sensor, shaft, along = at.sensors[self.name], at.sensors[self.name].about, self._angle(at)[1][:, None]
        none = np.zeros((len(along), 3))
        end, inboard = (End(link, at.pose(link), none, none) for link in (sensor.link, shaft.inboard))
        if not shaft.straight:
            return {"end": (end, turned(along)), "eye": (inboard, turned(-along))}
        # The way is along an axis that turns with the inboard link.
        lever = np.cross((end.place - inboard.place)[:, None], along)
        return {"end": (end, shifted(along)), "eye": (inboard, -np.concatenate([along, lever], axis=2))}


@dataclass(frozen=True, eq=False)
class SlideEncoder(Encoder):
    """The same of a joint that slides [m]."""

    unit, quantity = "m", "length"
    nuisances = (zero_of(("",), "m"), SCALE)
