"""
Your own URDF
=============

From a URDF to a verdict on a path, with an arm that knows how uncertain it is.
"""

# %%
# A URDF comes without compliance. Here is one of the bundled robots, of which nothing but the URDF is used; put the
# path of your own in its place, and the name of the link whose motion counts.
from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

import armflex

urdf, tip = armflex.bundled_robot("heavy_six") / "robot.urdf", "tool"
folder = Path(mkdtemp())
bare = armflex.load_arm(urdf, tip=tip)
print("joints:", ", ".join(bare.joint_names))

# %%
# Where it gives
# --------------
#
# A data sheet gives the stiffness of each drive about its own axis in Nm/rad. A flexure at each joint takes its
# inverse; the other axes are stiff until something better is known. ``relative_std`` says what such figures are worth.
stiffness = {
    "J1": (2.5e6, "z"),
    "J2": (2.0e6, "y"),
    "J3": (1.5e6, "y"),
    "J4": (4e5, "x"),
    "J5": (4e5, "y"),
    "J6": (2e5, "x"),
}
lines = [f'[robot]\nurdf = "{urdf.as_posix()}"\ntip = "{tip}"\ngravity = [0.0, 0.0, -9.81]\n']
lines.append("[payload.gripper]\nmass = 150.0\ncom = [0.0, 0.0, 0.2]\n")
for joint, (value, axis) in stiffness.items():
    compliance = [0.0] * 6
    compliance["xyz".index(axis) + 3] = 1.0 / value
    lines.append(f'[flexure.{joint}]\njoint = "{joint}"\ncompliance = {compliance}\nrelative_std = 0.2\n')
(folder / "arm.toml").write_text("\n".join(lines))
arm = armflex.load_arm(folder / "arm.toml")

# %%
# How far the tip moves
# ---------------------
reach = np.deg2rad(np.linspace(-30.0, 60.0, 31))
found = arm.deflection(np.array([arm.position(J2=q) for q in reach]), payload="gripper")
down = -1e3 * found.displacement[:, 2]
std = 1e3 * np.sqrt(found.covariance[:, 2, 2])
fig, ax = plt.subplots(figsize=(7, 3), layout="constrained")
ax.fill_between(np.rad2deg(reach), down - 2 * std, down + 2 * std, alpha=0.25, label="two standard uncertainties")
ax.plot(np.rad2deg(reach), down, label="the tip's sag")
ax.set(xlabel="J2 [deg]", ylabel="down [mm]")
ax.legend(frameon=False)

# %%
# Which joint it comes from, at 30 degrees:
one = arm.deflection(arm.position(J2=np.deg2rad(30.0)), payload="gripper")
for name, part in zip(arm.flexure_names, one.contributions, strict=True):
    print(f"{name}: {1e3 * np.linalg.norm(part[:3]):.3f} mm")

# %%
# A path
# ------
#
# Ten seconds from one side to the other with the gripper, three via-points. A check asks the path between them as well.
time = np.linspace(0.0, 10.0, 21)
q = np.array([arm.position(J1=-0.6 + 0.12 * t, J2=0.2 + 0.03 * t, J5=0.5) for t in time])
via = ["pick" if t == 0 else "middle" if t == 5 else "place" if t == 10 else "" for t in time]
path = armflex.Trajectory(arm.joint_names, time, q, ("gripper",) * len(time), tuple(via))
report = armflex.check(arm, path, tolerance=1e-3)
for point in report.via_points:
    shift, std = 1e3 * point.displacement_m, 1e3 * point.sigma_m
    print(f"{point.name}: {shift:.2f} ± {std:.2f} mm, {point.verdict}, most of it from {point.cause}")

# %%
# The joint positions that cancel the sag, and what remains of it:
fixed = armflex.compensate(arm, path)
change = np.rad2deg(np.abs(fixed.trajectory.q - path.q).max(axis=0))
print("largest change by joint [deg]:", dict(zip(arm.joint_names, change.round(4).tolist(), strict=True)))
flexed = arm.deflection(fixed.trajectory.q, payload="gripper").pose[:, :3, 3]
rigid = bare.deflection(path.q).pose[:, :3, 3]
print(f"the loaded tip is {1e3 * np.linalg.norm(flexed - rigid, axis=1).max():.1e} mm at most from where it should be")
