"""Machines with loops: a palletizer that keeps its wrist level, and oil under 125 t.

Both are bundled, and what the numbers say can be had by hand: rods that do not give keep the wrist as the column is,
and the cylinder under a guided table carries what stands on it.
"""

import numpy as np

import armflex


def main() -> tuple[float, float, float]:
    """Return by how much [rad] the wrist tilts more than the column, by what share the lift cylinder's tension is off
    the weight above it, and how far [m] the lifter is off its path once compensated.
    """
    folder = armflex.bundled_robot("palletizer")
    arm = armflex.load_arm(folder / "arm.toml")
    path = armflex.read_trajectory(folder / "trajectory.csv", arm)
    column = arm.flexure_names.index("tilt")
    level = 0.0
    for q, payload, name in zip(path.q, path.payload, path.via, strict=True):
        found = arm.deflection(q, payload)
        upright = found.pose.rotation[2, 2]  # the cosine of the tool's tilt
        leaning = np.linalg.norm(found.pose.rotation[:2, 2])
        level = max(level, abs(np.arctan2(leaning, upright) - abs(found.twists[column, 4])))
        if name:
            sag, length = found.displacement[2], np.round(found.spring_states[0, 0], 3)
            print(f"{name}: the tool sags by {-sag * 1e3:.2f} mm, the gravity spring is {length} m long")
    print(f"the wrist is as level as the column to {level:.1e} rad")

    folder = armflex.bundled_robot("hybrid_lifter")
    arm = armflex.load_arm(folder / "arm.toml")
    path = armflex.read_trajectory(folder / "trajectory.csv", arm)
    carried = ("table", "gimbal", "platform")
    mass = arm.payloads["t125"].mass + sum(arm.robot.urdf.links[name].inertial.mass for name in carried)
    off = 0.0
    for q, name in zip(path.q, path.via, strict=True):
        found = arm.deflection(q, "t125")
        along = found.link_poses()["table"][2, 2]  # the guides lean with the transporter
        length, tension = found.cylinder_states["lift"]
        off = max(off, abs(tension / (-9.81 * mass * along) - 1.0))
        if name:
            shorter = q[arm.joint_names.index("lift")] - length
            print(f"{name}: the lift cylinder carries {-tension / 1e3:.0f} kN and is {shorter * 1e3:.2f} mm shorter")
    result = armflex.compensate(arm, path)
    left = max(np.abs(row.after[:3]).max() for row in result.rows)
    print(f"after compensation {left:.1e} m remain at the rows, {result.between_m:.1e} m between them")
    return level, off, float(left)


if __name__ == "__main__":
    main()
