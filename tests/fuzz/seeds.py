"""Valid inputs that the fuzz tests spoil: a small arm with every kind of law, its campaign, and what a fit wrote."""

import functools
import tomllib
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from harness import FOLDER, written
from support.campaign_files import PRIOR
from support.small_arms import CROOKED, joint, random_compliance, robot
from support.structures import BEAM
from support.two_links import PAYLOADS

from armflex import Arm, calibrate, load_arm, predict, read_measurements
from armflex.estimate.block import EffectBlock
from armflex.measured.measurements import Measurements

SLIDING = joint("lift", "column", "upper", (0.1, 0, 0.5), (0, -0.3, 0.2), (0, 0, 1), kind="prismatic")
URDF = robot(*CROOKED[:3], SLIDING, *CROOKED[4:])

ARM = f"""[robot]
urdf = "robot.urdf"
tip = "tool"
base = "base"
gravity = [0.0, 0.0, -9.81]
payload_rating = 30.0

{PAYLOADS}
[flexure.Y]
joint = "yaw"
model = "linear"
relative_std = 0.1
compliance = {random_compliance(1).tolist()}

[flexure.L]
joint = "lift"
model = "position_dependent"
depends_on = "lift"
relative_std = 0.2
compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4e-8, 3e-7]
compliance_q1 = [1e-10, 1e-10, 0.0, 0.0, 0.0, 1e-8]

[flexure.S]
joint = "roll"
model = "structural"
tip = "3"
components = 6
node = [0.0, 0.0, 0.1]

[flexure.S.nodes]
1 = [0.0, 0.0, 0.25]
3 = [0.3, 0.0, 0.0]

[[flexure.S.subjoint]]
at = "1"
compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4.5e-8, 2e-7]
relative_std = 0.2
holds = ["dx", "dy", "dz", "rx", "ry", "rz"]

{BEAM.format("1").replace("[[beam]]", "[[flexure.S.beam]]")}up = [0.0, 0.1, 1.0]

[flexure.R]
joint = "roll"
compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4.5e-8, 2e-7]
LEARN

[preset.other.flexure.Y]
joint = "yaw"
compliance = [1e-9, 1e-9, 6e-10, 4e-8, 4.5e-8, 2e-7]

{PRIOR}geometry = 1e-4

[[effect]]
name = "backlash"
site = "yaw"
axis = "rz"
parameters = {{ gap = 3.6e-4 }}
std = {{ gap = 2e-5 }}

[[effect]]
name = "gear_harmonic"
site = "roll"
axis = "rz"
parameters = {{ A = 1e-4, B = 1e-5, k = 3.0 }}

[[effect]]
name = "thermal_growth"
site = "roll"
parameters = {{ alpha = 1e-5, reference = 20.0, lag = 100.0 }}

[[effect]]
name = "unnamed"
shape = "wave"
site = "roll"
axis = "dz"
covariates = ["temperature"]
parameters = {{ A = 1e-4, B = 1e-5, k = 0.3 }}
"""

OF_THE_MODEL = """
[[effect]]
name = "payload_mass"
site = "tool"
parameters = { mass = 0.2 }

[[effect]]
name = "tracker_scale"
site = "base"
parameters = { lambda = 1e-5 }
"""
"""Effects about which nothing can be fitted: a trace adds them at its end."""

PATH_HEADER = (
    "time",
    "q_yaw",
    "q_lift",
    "q_roll",
    "payload",
    "via",
    "v_yaw",
    "v_lift",
    "v_roll",
    "a_yaw",
    "a_lift",
    "a_roll",
)
PATH = [
    ("0.0", "0.1", "0.0", "0.2", "p5", "start", *"000000"),
    ("1.0", "0.2", "0.1", "0.2", "p5", "", *"100001"),
    ("2.0", "0.3", "0.1", "0.1", "none", "end", *"000000"),
]
JOINTS = ("yaw", "lift", "roll")
ROWS = 40


def quietly(path: Path, **options: Any) -> Arm:
    """Load an arm without its warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_arm(path, **options)


@functools.cache
def declared(learn: bool = False) -> Path:
    """Write the arm and return its path; with `learn` the law of one flexure is to be learned."""
    written("robot.urdf", URDF)
    text = ARM.replace("LEARN", 'model = "linear"\nlearn = true' if learn else 'model = "linear"')
    return written(f"declared_{learn:d}.toml", text)


@functools.cache
def arm() -> Arm:
    """Return the arm without its effects: tables for it need no further columns."""
    declared()
    return quietly(written("plain.toml", ARM.replace("LEARN", "").partition("[[effect]]")[0]))


@functools.cache
def campaign() -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Return header and rows of a campaign of the arm with its effects, temperature and orientations included."""
    rng, whole = np.random.default_rng(5), quietly(declared())
    header = ("pose", "session", "time", "payload", "temperature", "shift", *(f"q_{name}" for name in JOINTS))
    q = rng.uniform((-2.0, -1.0, -2.0), (2.0, 1.0, 2.0), (ROWS, 3))
    known = [
        (f"p{i}", f"s{i // 20}", 10.0 * i, ("none", "p5", "p20")[i % 3], rng.uniform(18, 30), "ab"[i % 2])
        for i in range(ROWS)
    ]
    approach = np.where(rng.uniform(size=(ROWS, 3)) < 0.5, -1, 1)
    header = (*header, *(f"approach_{name}" for name in JOINTS))
    rows = [(*map(_text, (*known[i], *q[i])), *map(str, approach[i])) for i in range(ROWS)]
    inputs = written("inputs.csv", _csv(header, rows))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = predict(whole, read_measurements(inputs, whole, inputs_only=True))
    place = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.9])), np.array([3.0, -1.0, 0.5]))
    read = found.position @ place.rotation.T + place.translation + rng.normal(0.0, 1e-4, (ROWS, 3))
    turned = [pin.log3(place.rotation @ pin.exp3(rotation)) + rng.normal(0.0, 1e-4, 3) for rotation in found.rotation]
    header = (*header, "x", "y", "z", "sigma", "rx", "ry", "rz", "sigma_r")
    rows = [
        (*row, *map(_text, read[i]), "1e-4", *map(_text, turned[i]), "1e-4") if i != 7 else (*row, *[""] * 8)
        for i, row in enumerate(rows)
    ]
    return header, tuple(rows)


def _text(value: object) -> str:
    return f"{value:.8g}" if isinstance(value, float) else str(value)


def _csv(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "".join(",".join(row) + "\n" for row in (header, *rows))


@functools.cache
def measurements() -> Measurements:
    """Return the campaign, read."""
    whole = quietly(declared())
    return read_measurements(written("campaign.csv", _csv(*campaign())), whole)


@functools.cache
def asked() -> Measurements:
    """Return two rows of the campaign without what was measured, to predict at."""
    header, rows = campaign()
    end = header.index("x")
    path = written("asked.csv", _csv(header[:end], [row[:end] for row in rows[1:3]]))
    return read_measurements(path, quietly(declared()), inputs_only=True)


@functools.cache
def fitted(learn: bool = False) -> str:
    """Return the text of the arm as `calibrate` writes it, effects and covariance included."""
    path = declared(learn)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = calibrate(quietly(path), measurements())
    return found.write(FOLDER / f"fitted_{learn:d}.toml").read_text()


@functools.cache
def traced(learn: bool = False) -> dict[str, Any]:
    """Return what was fitted as tables, with what a trace adds: effects, an unexplained twist, open directions."""
    text = fitted(learn) + OF_THE_MODEL
    effects = quietly(written(f"traced_{learn:d}.toml", text)).effects
    blocks = [EffectBlock(e, tuple(range(len(e.inner))), None, i, np.zeros(0)) for i, e in enumerate(effects)]
    labels = [f"{block.name} {label}" for block in blocks for label in block.labels]
    variances = [float(0.1 * value) ** 2 for block in blocks for value in block.effect.values]
    tree = tomllib.loads(text)
    found = tree["calibration"]
    count = len(found["parameters"])
    found["parameters"] += labels
    found["covariance"] += [[0.0] * (count + i) + [variance] for i, variance in enumerate(variances)]
    found["unexplained"] = {"site": "lift", "axis": "dz", "std": 1e-5}
    found["undetermined"] = [[0.0] * (len(found["parameters"]) - 1) + [1.0]]
    found["misfit_m"] = 1e-5
    return tree
