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
# The bundled boom, its mast's guides with a play that closes, read by a tracker with 0.2 mm of noise per axis. All of
# it is in ``examples/12_learn_on_the_arm.py``, which runs without a notebook, too.
import inspect
import runpy
from pathlib import Path
from tempfile import mkdtemp

import matplotlib.image as image
import matplotlib.pyplot as plt
import numpy as np

import armflex

checkout = armflex.bundled_robot("tarm_like").parents[1]
example = runpy.run_path(str(checkout / "examples" / "12_learn_on_the_arm.py"))
print(inspect.getsource(example["Yielding"].twist))

# %%
# What to learn
# -------------
#
# A line of ``arm.toml`` says that M1's law is to be learned: a polynomial of the load about the declared compliance.
work = Path(mkdtemp())
declared, learning = example["arms"](work)
print("".join(line for line in (work / "learn.toml").read_text().splitlines(keepends=True) if "learn" in line))

# %%
# With and without
# ----------------
campaign, held_out = (
    example["measured"](declared, table, i) for i, table in enumerate(("campaign.csv", "held_out.csv"))
)
fig, ax = plt.subplots(figsize=(7, 3), layout="constrained")
for name, arm in (("not learned", declared), ("learned", learning)):
    found = armflex.calibrate(arm, campaign).arm
    errors = np.linalg.norm(example["away"](found, held_out), axis=1) * 1e3
    print(f"{name}: {np.sqrt((errors**2).mean()):.2f} mm RMS on held-out poses; the noise is {0.2 * 3**0.5:.2f} mm")
    ax.plot(np.sort(errors), np.linspace(0, 1, len(errors)), label=name)
ax.set(xlabel="3-D error on held-out poses [mm]", ylabel="share of poses")
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
