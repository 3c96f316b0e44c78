"""
Milling
=======

A robot that mills is pushed aside by its own cut. The force is known well enough from the feed and the depth; what it
does to the tool depends on the pose. Here a six-axis robot for 300 kg cuts a slot of 600 mm, and the path is corrected
before it is driven.
"""

# %%
# The robot and its spindle
# -------------------------
import matplotlib.pyplot as plt
import numpy as np

import armflex

arm = armflex.load_arm(armflex.bundled_robot("heavy_six") / "arm.toml")
spindle = "p100"  # 100 kg

# %%
# The path
# --------
#
# A straight line along y at a constant attitude, by Newton on the rigid tip.
import pinocchio as pin

start = arm.position(J1=-0.25, J2=0.35, J3=0.25, J5=0.9)


def rigid_pose(q: np.ndarray) -> pin.SE3:
    return arm.deflection(q).rigid_pose


def jacobian(q: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Return the (6, nq) Jacobian of the rigid tip by differences, base axes."""
    here, columns = rigid_pose(q), []
    for row in np.eye(len(q)):
        there = rigid_pose(q + step * row)
        turn = pin.log3(there.rotation @ here.rotation.T)
        columns.append(np.concatenate([there.translation - here.translation, turn]) / step)
    return np.array(columns).T


first, path = rigid_pose(start), [start]
for length in np.linspace(0.0, 0.6, 25):
    q = path[-1]
    for _ in range(3):
        here = rigid_pose(q)
        shift = first.translation + np.array([0.0, length, 0.0]) - here.translation
        q = q + np.linalg.solve(jacobian(q), np.concatenate([shift, pin.log3(first.rotation @ here.rotation.T)]))
    path.append(q)
Q = np.array(path[1:])
rigid = arm.deflection(Q).rigid_pose[:, :3, 3]
print(f"from {rigid[0].round(3)} to {rigid[-1].round(3)} m")

# %%
# The cutting force
# -----------------
#
# A 16 mm cutter with four teeth in aluminium, 3 mm deep, 0.1 mm a tooth: the mean force of a slot by a mechanistic
# model with specific forces of 800 and 300 N/mm². It acts across the feed for the greater part.
depth, feed, teeth, kt, kr = 3.0, 0.1, 4, 800.0, 300.0  # mm, mm a tooth, -, N/mm^2, N/mm^2
along = teeth * depth * feed * kr / 4
across = teeth * depth * feed * kt / 4
print(f"{along:.0f} N against the feed, {across:.0f} N across it")
cut = armflex.Wrench(arm.robot.tip, np.array([across, -along, 0.0]), np.zeros(3))

# %%
# What it does to the slot
# ------------------------
loaded = arm.deflection(Q, payload=spindle, wrenches=[cut])
idle = arm.deflection(Q, payload=spindle)
by_cut = 1e3 * (loaded.displacement - idle.displacement)
whole = 1e3 * loaded.displacement
std = 1e3 * np.sqrt(np.einsum("nii->ni", loaded.covariance))

y = 1e3 * (rigid[:, 1] - rigid[0, 1])
fig, axes = plt.subplots(1, 2, figsize=(8, 3), layout="constrained", sharex=True)
axes[0].plot(y, whole[:, 2], label="weight and cut")
axes[0].fill_between(y, whole[:, 2] - 2 * std[:, 2], whole[:, 2] + 2 * std[:, 2], alpha=0.25)
axes[0].set(ylabel="depth is off by [mm]", xlabel="along the slot [mm]")
axes[1].plot(y, by_cut[:, 0], color="C1")
axes[1].set(ylabel="pushed aside by the cut [mm]", xlabel="along the slot [mm]")

# %%
# Corrected
# ---------
#
# Joint positions for which the tool under weight *and* cut is where the path was drawn: Newton on the deflected tip.
fixed = Q.copy()
for _ in range(4):
    flexed = arm.deflection(fixed, payload=spindle, wrenches=[cut]).pose
    for i, q in enumerate(fixed):
        fixed[i] = q + np.linalg.lstsq(jacobian(q)[:3], rigid[i] - flexed[i, :3, 3], rcond=None)[0]
left = arm.deflection(fixed, payload=spindle, wrenches=[cut]).pose[:, :3, 3] - rigid
before = np.linalg.norm(whole[:, :3], axis=1).max()
print(f"off by {before:.2f} mm at most before, {1e3 * np.abs(left).max():.1e} mm after")

# %%
# The model cancels its own deflection to rounding. The real machine keeps what the model does not know: the standard
# uncertainty of the compliances, which are declared to 20 % here, is
print(f"{np.linalg.norm(std[:, :3], axis=1).max():.2f} mm at most: measure, and calibrate, before this is believed.")
