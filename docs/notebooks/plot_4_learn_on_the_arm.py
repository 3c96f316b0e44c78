"""
Learn on the arm
================

A mast whose guides have play: it tilts under small moments and holds under large ones. Nobody declared that, and no
bench will ever see the mast. Its law is learned from readings of the tip.
"""

# %%
# The machine
# -----------
#
# The bundled boom, its mast's guides with a play that closes, read by a tracker with 0.2 mm of noise per axis.
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp

import matplotlib.image as image
import matplotlib.pyplot as plt
import numpy as np

import armflex
from armflex.laws import Row
from armflex.laws.law import WithoutParameters

folder, work = armflex.bundled_robot("tarm_like"), Path(mkdtemp())


class Yielding(WithoutParameters):
    """The declared law, and a tilt that saturates."""

    def __init__(self, linear):
        self.linear = linear

    def twist(self, wrench: np.ndarray, row: Row) -> np.ndarray:
        twist = self.linear.twist(wrench, row).copy()
        twist[..., 3] += 1e-3 * np.tanh(wrench[..., 3] / 4e4)
        return twist

    def tangent(self, wrench: np.ndarray, row: Row) -> np.ndarray:
        tangent = np.broadcast_to(self.linear.tangent(wrench, row), (*wrench.shape, 6)).copy()
        tangent[..., 3, 3] += 1e-3 / 4e4 / np.cosh(wrench[..., 3] / 4e4) ** 2
        return tangent


declared = armflex.load_arm(folder / "measured.toml")
yielding = [replace(one, law=Yielding(one.law)) if one.name == "M1" else one for one in declared.flexures]
machine = replace(declared, flexures=tuple(yielding))


def measured(table: str, seed: int) -> armflex.Measurements:
    rows = armflex.read_measurements(folder / table, declared)
    read = armflex.predict(machine, rows).position
    noise = np.random.default_rng(seed).normal(0.0, 2e-4, read.shape)
    return replace(rows, position=np.where(rows.measured[:, None], read + noise, 0.0))


campaign, held_out = measured("campaign.csv", 0), measured("held_out.csv", 1)
print(len(campaign), "rows,", int(campaign.measured.sum()), "of them read")

# %%
# What to learn
# -------------
#
# A line of ``arm.toml`` says that M1's law is to be learned: a polynomial of the load about the declared compliance.
text = (folder / "measured.toml").read_text()
text = text.replace('"robot.urdf"', f'"{(folder / "robot.urdf").as_posix()}"')
text = text.replace('joint = "M1"\nmodel = "linear"', 'joint = "M1"\nmodel = "polynomial"\nlearn = true')
(work / "learn.toml").write_text(text)
learning = armflex.load_arm(work / "learn.toml")

# %%
# With and without
# ----------------
errors = {}
for name, arm in (("not learned", declared), ("learned", learning)):
    found = armflex.calibrate(arm, campaign).arm
    away = (armflex.predict(found, held_out).position - held_out.position)[held_out.measured]
    errors[name] = np.linalg.norm(away, axis=1) * 1e3
    rms, noise = np.sqrt((errors[name] ** 2).mean()), 0.2 * 3**0.5
    print(f"{name}: {rms:.2f} mm RMS on poses not used; the noise is {noise:.2f} mm")

fig, ax = plt.subplots(figsize=(7, 3), layout="constrained")
for name, values in errors.items():
    ax.plot(np.sort(values), np.linspace(0, 1, len(values)), label=name)
ax.set(xlabel="3-D error on poses not used [mm]", ylabel="share of poses")
ax.legend(frameon=False)

# %%
# The law
# -------
#
# As learned, with its band, over the loads that were seen:
armflex.draw_laws(found, work / "laws.png")
fig = plt.figure(figsize=(8, 5))
axes = fig.add_axes((0, 0, 1, 1))
axes.imshow(image.imread(work / "laws.png"))
axes.set_axis_off()
