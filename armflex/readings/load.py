"""Loads that the arm carries: the torque of a drive, and what a load cell between two links reads."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.readings.kind import Kind
from armflex.readings.postures import Postures
from armflex.readings.sensor import AXES, SCALE, Nuisance, zero_of
from armflex.robot import Robot


@dataclass(frozen=True)
class Drive:
    """The drive whose torque is read.

    Attributes:
        joint: Its joint.
        axis: (6,) unit wrench on the structure about or along it, in the joint's frame.
        ratio: Reading per load on the drive: -1 over the gear ratio where it reads what the drive exerts.
    """

    joint: str
    axis: Array
    ratio: float


@dataclass(frozen=True, eq=False)
class Torque(Kind):
    """(N, 1) torque of a standing drive, on the motor's side of its gear [Nm].

    It holds the weight of all that is outboard, and loads from outside. `friction` is what the drive exerts more after
    it moved in the joint's positive direction, and less after the negative one.
    """

    dimension = 1
    unit, quantity = "Nm", "moment"
    channels = ("",)
    nuisances = (zero_of(("",), "Nm"), SCALE, Nuisance("friction", ("",), "Nm"))
    by_motion = False

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return the joint's link, and the drive."""
        joints = {joint.name: joint for joint in robot.moving}
        joint = joints[table.choice("joint", tuple(joints))]
        slides = joint.kind == "prismatic"
        if slides and not table.has("ratio"):
            raise table.fail("joint", f"{joint.name!r} slides: give `ratio`, radians of the motor per metre")
        ratio = table.number("ratio", 1.0)
        if not abs(ratio) > 0.0:
            raise table.fail("ratio", "expected turns of the motor per turn of the joint, got 0")
        sign = {"drive": -1.0, "load": 1.0}[table.choice("reads", ("drive", "load"), "drive")]
        axis = np.zeros(6)
        axis[slice(0, 3) if slides else slice(3, 6)] = joint.axis
        return {"link": joint.child, "about": Drive(joint.name, axis, sign / ratio)}

    def ideal(self, at: Postures) -> Array:
        """Return (N, 1) what the load makes the drive read [Nm]."""
        drive = at.about(self.name, Drive)
        return (drive.ratio * at.load(f"link:{drive.joint}") @ drive.axis)[:, None]

    def predicted(self, at: Postures) -> Array:
        return super().predicted(at) + at.of(self.name, "friction") * self.others(at)["friction"][..., 0]

    def others(self, at: Postures) -> Mapping[str, Array]:
        """Return what is against the direction that the joint came in."""
        drive = at.about(self.name, Drive)
        return {"friction": -np.sign(drive.ratio) * at.approach[drive.joint][:, None, None]}


@dataclass(frozen=True, eq=False)
class Force(Kind):
    """(N, 3) force that what is outboard exerts at a joint, at the base or on the tool, in axes of that place [N]."""

    dimension = 3
    unit, quantity = "N", "force"
    channels = AXES
    nuisances = (zero_of(AXES, "N"),)
    by_motion = False
    part = slice(0, 3)

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return the tip, and the site of the load cell."""
        site = table.choice("site", ("base", *robot.joint_names, "tool"), "tool")
        return {"link": robot.tip, "about": site}

    def ideal(self, at: Postures) -> Array:
        return at.load(str(at.sensors[self.name].about))[:, self.part]


@dataclass(frozen=True, eq=False)
class Moment(Force):
    """(N, 3) moment with it, about the origin of that place [Nm]."""

    unit, quantity = "Nm", "moment"
    nuisances = (zero_of(AXES, "Nm"),)
    part = slice(3, 6)
