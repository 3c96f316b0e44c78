"""Any URDF: declare where it gives, then ask. Here one of PyPI's example-robot-data."""

from importlib.metadata import distribution
from pathlib import Path

import numpy as np

import armflex

ARM = """
[robot]
urdf = "{urdf}"
tip = "tool0"
gravity = [0.0, 0.0, -9.81]

[payload.gripper]
mass = 8.0
com = [0.0, 0.0, 0.1]

[flexure.shoulder]
joint = "shoulder_lift_joint"
compliance = [0.0, 0.0, 0.0, 5e-6, 2e-5, 5e-6]   # rad/Nm; a joint of a light arm

[flexure.elbow]
joint = "elbow_joint"
compliance = [0.0, 0.0, 0.0, 5e-6, 3e-5, 5e-6]
"""


def main(folder: str = ".") -> float:
    robots = distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")
    file = Path(folder) / "ur10.toml"
    file.write_text(ARM.format(urdf=Path(robots, "ur_description/urdf/ur10_robot.urdf").as_posix()))
    arm = armflex.load_arm(file)
    found = arm.deflection(arm.position(shoulder_lift_joint=-0.3), payload="gripper")
    print(f"base {arm.robot.base}, tip {arm.robot.tip}: {found.displacement[:3] * 1e3} mm")
    return float(np.linalg.norm(found.displacement[:3]))


if __name__ == "__main__":
    main()
