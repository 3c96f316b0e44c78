"""A UR10 drills: a stiffness per joint, a path, and a program for its controller on which the drill meets the holes.

The URDF is that of PyPI's example-robot-data; the stiffnesses are of the size that papers find for this arm.
"""

import re
import sys
import tempfile
from importlib.metadata import distribution
from pathlib import Path

import numpy as np

import armflex
from armflex.export import programs
from armflex.trajectory import write_trajectory

STIFFNESS = {
    "shoulder_pan_joint": 2.0e4,
    "shoulder_lift_joint": 2.5e4,
    "elbow_joint": 1.7e4,
    "wrist_1_joint": 6.0e3,
    "wrist_2_joint": 6.0e3,
    "wrist_3_joint": 6.0e3,
}  # Nm/rad
THRUST = 60.0  # N, along the drill where the bit is in
HOLES = 5


def main(folder: str = "") -> tuple[float, float]:
    """Return how far [m] the drill is off at the holes as commanded, and when it is driven as the program says."""
    place = Path(folder or tempfile.mkdtemp())
    robots = Path(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots"))
    drill = armflex.Payload(3.0, [0.0, 0.0, 0.1])
    urdf = robots / "ur_description" / "urdf" / "ur10_robot.urdf"
    ground = {"gravity": [0.0, 0.0, -9.81], "tool": {"xyz": [0.0, 0.0, 0.2]}}
    arm = armflex.make_arm(urdf, STIFFNESS, {"drill": drill}, tip="tool0", **ground)

    q = np.tile([0.0, -1.2, 1.7, -2.07, -1.57, 0.0], (HOLES, 1))
    q[:, 0] = np.linspace(-0.4, 0.4, HOLES)
    names = tuple(f"hole {i}" for i in range(1, HOLES + 1))
    thrust = armflex.Wrench(arm.robot.tip, np.tile([0.0, 0.0, -THRUST], (HOLES, 1)), np.zeros((HOLES, 3)), "frame")
    path = armflex.Trajectory(arm.joint_names, np.arange(HOLES) * 2.0, q, ("drill",) * HOLES, names, wrenches=(thrust,))
    file = write_trajectory(path, place / "holes.csv")

    # As `armflex export arm.toml --to urscript --traj holes.csv --compensate -o drill.script`
    script = programs.urscript(arm, file, compensate=True, name="drill")
    (place / "drill.script").write_text(script.text)
    print(*script.notes, sep="\n")
    print(script.text.splitlines()[7])

    moves = re.findall(r"movej\(\[(.*?)\]", script.text)
    driven = np.array([[float(value) for value in move.split(",")] for move in moves])
    holes = np.array([arm.rigid_pose(row).translation for row in q])

    def error(rows: np.ndarray) -> float:
        there = arm.deflection(rows, "drill", wrenches=[thrust]).pose[:, :3, 3]
        return float(np.linalg.norm(there - holes, axis=1).max())

    before, after = error(q), error(driven)
    print(f"as commanded the drill is {before * 1e3:.2f} mm off, as the program says {after * 1e3:.1e} mm")
    return before, after


if __name__ == "__main__":
    main(*sys.argv[1:])
