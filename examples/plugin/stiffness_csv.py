"""The stiffness of every joint about its own axis, as a table that a spreadsheet reads."""

import numpy as np

from armflex import Arm
from armflex.export import Exported
from armflex.laws.law import anywhere
from armflex.robot.urdf import drive_of


def export(arm: Arm) -> Exported:
    """Return a line for each flexure: its joint and its stiffness [Nm/rad or N/m]."""
    lines, stiffness = ["joint,stiffness"], {}
    for flexure in arm.flexures:
        joint = next(joint for joint in arm.robot.chain if joint.name == flexure.joint)
        compliance = flexure.law.tangent(np.zeros(6), anywhere(arm.robot))
        drive = drive_of(joint)
        stiffness[joint.name] = 1.0 / float(drive @ compliance @ drive)
        lines.append(f"{joint.name},{stiffness[joint.name]:.6g}")
    notes = ("Under a small load; a law that hardens is stiffer under a larger one.",)
    return Exported("\n".join(lines) + "\n", notes, {"stiffness": stiffness})
