"""
Trace a real robot
==================

Two robots that were measured with a laser tracker and published (P. Jacobi, ``serial_robots_datasets``, MIT licence): a
UR5 in 1000 poses, and a cable-driven Barrett WAM in 216. What is wrong with them nobody has said. Both campaigns travel
with the repository, in ``tests/measured``.
"""

# %%
# A UR5
# -----
#
# Fourteen lines of ``arm.toml``: the URDF, and what may be off. Nothing gives; the robot carries nothing.
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import armflex

places = [at / "tests" / "measured" for at in (Path.cwd(), *Path.cwd().parents)]
folder = next(place for place in places if place.is_dir())
print((folder / "ur5_tsinghua" / "arm.toml").read_text())


def campaign(name: str) -> tuple[armflex.Arm, armflex.Measurements]:
    arm = armflex.load_arm(folder / name / "arm.toml")
    return arm, armflex.read_measurements(folder / name / "campaign.csv", arm)


def error(arm: armflex.Arm, rows: armflex.Measurements, some: np.ndarray) -> np.ndarray:
    """Return the 3-D errors [mm] at some rows."""
    away = armflex.predict(arm, rows).position - rows.position
    return 1e3 * np.linalg.norm(away[some], axis=1)


def told(errors: np.ndarray) -> str:
    """Return the root mean square, mean and largest of some errors [mm]."""
    return f"{np.sqrt(np.mean(errors**2)):.3f} mm RMS, {errors.mean():.3f} mm mean, {errors.max():.2f} mm at most"


# %%
# Every fourth pose is used, the others are held out. ``calibrate`` finds the instrument, the target on the flange, and
# the errors of zeros and geometry.
arm, rows = campaign("ur5_tsinghua")
every = np.arange(len(rows))
used, held_out = every[every % 4 == 0], every[every % 4 != 0]
calibrated = armflex.calibrate(arm, rows, rows=used)
before = error(calibrated.arm, rows, held_out)
print(f"{len(used)} poses used, {len(held_out)} held out: {told(before)}")

# %%
# ``trace`` asks what is left.
traced = armflex.trace(arm, rows, rows=used)
for family in traced.at_every_drive:  # small everywhere: no drive shows it alone, all of them together do
    print(family.title)
for one in traced.found:
    values = ", ".join(f"{name} = {value:.3g}" for name, value in one.effect.named.items())
    print(f"{one.effect.title}: {values}")
after = error(traced.arm, rows, held_out)
print(f"on held-out poses {told(after)}; as declared, instrument and target placed: {1e3 * traced.declared_rms:.2f} mm")

fig, ax = plt.subplots(figsize=(7, 3), layout="constrained")
for name, values in (("calibrated", before), ("traced", after)):
    ax.plot(np.sort(values), np.linspace(0, 1, len(values)), label=name)
ax.set(xlabel="3-D error on held-out poses [mm]", ylabel="share of poses")
ax.legend(frameon=False)

# %%
# The published model of this campaign, geometry and a graph network trained on it, reaches 0.155 mm on its own 20 test
# poses; the nominal robot is 2.6 mm off.
#
# A cable-driven arm
# ------------------
#
# The WAM's joints give, by how much nobody knows: its ``arm.toml`` declares a compliance at each, known to a factor.
# Its repeatability is about 2 mm.
arm, rows = campaign("wam_tsinghua")
every = np.arange(len(rows))
used, held_out = every[every % 2 == 0], every[every % 2 != 0]
calibrated = armflex.calibrate(arm, rows, rows=used)
before = error(calibrated.arm, rows, held_out)
traced = armflex.trace(arm, rows, rows=used)
after = error(traced.arm, rows, held_out)
print(f"held-out poses, calibrated: {told(before)}")
print(f"held-out poses, traced: {told(after)}; as declared {1e3 * traced.declared_rms:.1f} mm RMS")
for title in (*(family.title for family in traced.at_every_drive), *(one.effect.title for one in traced.found)):
    print(title)

# %%
# What could not be decided is said as well:
for line in traced.next_measurement[:4]:
    print("-", line)
