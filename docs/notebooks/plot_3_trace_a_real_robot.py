"""
Trace a robot
=============

An arm bends and errs in ways that its ``arm.toml`` does not say. Here the arm is simulated, so that what it lacks is
known. The same page traces two real robots where their campaigns are: a UR5 in 1000 poses and a cable-driven Barrett
WAM in 216, measured with a laser tracker and published by P. Jacobi (``serial_robots_datasets`` on GitHub, MIT
licence). With that repository in a folder ``DIR``::

    ARMFLEX_PUBLIC=DIR python docs/notebooks/plot_3_trace_a_real_robot.py
"""

# %%
# The campaign
# ------------
#
# The bundled ``heavy_six``, with two effects that nobody declares: play in the second joint and an eccentric encoder in
# the third. Its tip is read in 400 poses, with a noise of 0.1 mm in each coordinate.
import csv
import os
import runpy
from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

import armflex

HIDDEN = """
[[effect]]
name = "backlash"
site = "J2"
axis = "ry"
parameters = { gap = 6e-4 }

[[effect]]
name = "encoder_eccentricity"
site = "J3"
axis = "ry"
covariates = ["q_J3"]
parameters = { A = 3e-4, B = -2e-4 }
"""
SIGMA = 1e-4  # m
work = Path(mkdtemp())


def simulated() -> tuple[Path, Path]:
    """Return the arm.toml as declared, and what is read of an arm that has the hidden effects as well."""
    robot = armflex.bundled_robot("heavy_six")
    declared = (robot / "arm.toml").read_text().replace("robot.urdf", (robot / "robot.urdf").as_posix())
    for name, text in (("arm.toml", declared), ("true.toml", declared + HIDDEN)):
        (work / name).write_text(text)
    true, rng = armflex.load_arm(work / "true.toml"), np.random.default_rng(0)
    q = rng.uniform(np.maximum(true.robot.lower, -1.2), np.minimum(true.robot.upper, 1.2), (400, 6))
    came = np.sign(np.diff(q, axis=0, prepend=0.0))  # where each joint came from
    names = [f"{column}_{joint}" for column in ("q", "approach") for joint in true.joint_names]
    payloads = rng.choice(["empty", "p100", "p200"], len(q))

    def write(name: str, *columns: np.ndarray, further: tuple[str, ...] = ()) -> Path:
        rows = zip(payloads, *np.column_stack([q, came, *columns]).T, strict=True)
        with (work / name).open("w", newline="") as file:
            csv.writer(file).writerows([["payload", *names, *further], *rows])
        return work / name

    path = write("poses.csv")
    position = armflex.predict(true, armflex.read_measurements(path, true, inputs_only=True)).position
    read = position + rng.normal(0.0, SIGMA, position.shape)
    return work / "arm.toml", write("campaign.csv", read, np.full(len(q), SIGMA), further=("x", "y", "z", "sigma"))


if folder := os.environ.get("ARMFLEX_PUBLIC"):
    places = [at / "tests" / "public.py" for at in (Path.cwd(), *Path.cwd().parents)]
    published = runpy.run_path(str(next(place for place in places if place.is_file())))["published"]
    campaigns = {name: files for name, files in published(Path(folder), work).items() if name.endswith("_tsinghua")}
    if not campaigns:
        raise SystemExit(f"ARMFLEX_PUBLIC: no serial_robots_datasets in {folder}")
else:
    campaigns = {"simulated": simulated()}

# %%
# Calibrated and traced
# ---------------------
#
# Every second pose is used (of the UR5 every fourth), the others are held out. ``calibrate`` finds the instrument, the
# target on the flange, and the errors of zeros, geometry and compliance that ``arm.toml`` allows. ``trace`` asks what
# is left.


def error(arm: armflex.Arm, rows: armflex.Measurements, some: np.ndarray) -> np.ndarray:
    """Return the 3-D errors [mm] at some rows."""
    away = armflex.predict(arm, rows).position - rows.position
    return 1e3 * np.linalg.norm(away[some], axis=1)


def said(errors: np.ndarray) -> str:
    """Return the root mean square, mean and largest of some errors [mm]."""
    return f"{np.sqrt(np.mean(errors**2)):.3f} mm RMS, {errors.mean():.3f} mm mean, {errors.max():.2f} mm at most"


fig, axes = plt.subplots(len(campaigns), figsize=(7, 3 * len(campaigns)), layout="constrained", squeeze=False)
for (name, (file, table)), ax in zip(campaigns.items(), axes[:, 0], strict=True):
    arm = armflex.load_arm(file)
    rows = armflex.read_measurements(table, arm)
    every, step = np.arange(len(rows)), 4 if name == "ur5_tsinghua" else 2
    used, held_out = every[every % step == 0], every[every % step != 0]
    traced = armflex.trace(arm, rows, rows=used)
    print(f"{name}: {len(used)} poses used, {len(held_out)} held out")
    print(f"  as declared, instrument and target placed: {1e3 * traced.declared_rms:.2f} mm RMS")
    for title, found in (("calibrated", traced.calibration.arm), ("traced", traced.arm)):
        errors = error(found, rows, held_out)
        print(f"  {title}, on held-out poses: {said(errors)}")
        ax.plot(np.sort(errors), np.linspace(0, 1, len(errors)), label=title)
    for family in traced.common:  # small everywhere: no drive shows it alone, all of them together do
        print(f"  {family}")
    for one in traced.found:
        values = ", ".join(f"{parameter} = {value:.3g}" for parameter, value in one.effect.named.items())
        print(f"  {one.effect.title}: {values}")
    for line in traced.next_measurement[:4]:  # what could not be decided
        print("  -", line)
    ax.set(xlabel="3-D error on held-out poses [mm]", ylabel="share of poses", title=name)
    ax.legend(frameon=False)

# %%
# The published models of the two real robots, geometry and a graph network trained on it, reach a mean of 0.155 mm (the
# UR5) and 2.92 mm (the WAM) on 20 test poses of their own. :doc:`/trace` has the figures that this page prints of them.
