"""armflex: manipulators that sag. Joint compliance, end-effector deflection, path checks and compensation."""

from armflex.arm import Arm as Arm
from armflex.arm import Flexure as Flexure
from armflex.arm_file import load_arm as load_arm
from armflex.loads import Payload as Payload
from armflex.loads import Wrench as Wrench

__version__ = "0.1.0"
