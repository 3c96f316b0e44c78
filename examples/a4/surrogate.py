"""A surrogate bench for joint A4. Not the paper's data: 71 of its 91 training rows and all new rows are unpublished.

Loads are drawn as the paper describes them and its Table I shows them: a force along the bearing's z axis and one
normal to it. The direction of the latter in row n of Table I is (-1)^n floor(n / 2) degrees, in all twenty rows, so 91
rows sweep from -45 to 45 degrees by one degree each. Sizes are uniform over ranges of which Table I's are the inside.
New rows have the same sizes and any direction of that sector.

The deflection is the law that the library finds in Table I (full compliance, radial load, magnitude) plus two assumed
terms that no polynomial of that kind follows:
    contact    a clearance that closes smoothly about a radial load, along that load
    softening  more compliance along z once the axial load has overcome a preload
plus Gaussian noise. How well a network does depends on these constants: a contact half as wide asks for more rows than
91. They were chosen so that a network is needed and 91 rows can teach it.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

import armflex
from armflex.bench.fitted import predicted
from armflex.bench.learners import Options, learner
from armflex.conventions import Array
from armflex.laws.law import Law

TRAINING, NEW, EXACT = 91, 60, 1000
"""Rows to train on, measured rows to judge by, and rows without noise to judge by."""

RADIAL, AXIAL, SECTOR = (1.0, 3.0), (-2.5, -0.5), 45
"""kN, kN and degrees. Table I has 1.07 to 2.93 kN and -2.47 to -0.61 kN; the paper says 1000 to 5000 N."""

CLEARANCE, CONTACT, CONTACT_WIDTH = 1.2, 2.0, 0.7
"""mm moved before and after the contact's middle, which is at 2 kN of radial load, and its width in kN."""

SOFTENING, PRELOAD, PRELOAD_WIDTH = 8.0, 1.5, 0.2
"""mm/kN beside the 47 along z that Table I gives, beyond 1.5 kN, coming in over 0.2 kN."""

NOISE = np.array([0.05e-3, 0.05e-3, 0.1e-3])
"""Standard deviation of a reading along x, y and z [m]."""


@dataclass(frozen=True)
class Rows:
    """(N, 3) loads [N], exact deflections [m], and those with noise."""

    loads: Array
    exact: Array
    measured: Array


@dataclass(frozen=True)
class Bench:
    """Rows to train on, new rows, and many more of the latter's kind whose exact deflection counts."""

    training: Rows
    new: Rows
    many: Rows


def bench(seed: int) -> Bench:
    """Return what one bench campaign gives; another seed is another campaign."""
    rng = np.random.default_rng(seed)
    number = np.arange(1, TRAINING + 1)
    sweep = (-1.0) ** number * (number // 2)
    angles = (sweep, *(rng.uniform(-SECTOR, SECTOR, count) for count in (NEW, EXACT)))
    return Bench(*(_rows(np.radians(angle), rng) for angle in angles))


def _rows(angle: Array, rng: np.random.Generator) -> Rows:
    radial, axial = rng.uniform(*RADIAL, len(angle)), rng.uniform(*AXIAL, len(angle))
    loads = 1e3 * np.stack([radial * np.cos(angle), radial * np.sin(angle), axial], axis=1)
    exact = predicted(table_law(), loads) + nonlinear(loads)
    return Rows(loads, exact, exact + NOISE * rng.normal(size=exact.shape))


@cache
def table_law() -> Law:
    """Return the law of the twenty published rows, in their printed units."""
    rows = armflex.read_joint_data(armflex.bundled_robot("tarm_like") / "a4_table_1.csv")
    return learner("polynomial", Options(features=("radial", "magnitude")))(rows.loads, rows.deflections, 0).law


def nonlinear(loads: Array) -> Array:
    """Return the (N, 3) deflections [m] that are assumed beside the law of the published rows; none without load."""
    across, along = 1e-3 * loads[:, :2], -1e-3 * loads[:, 2:]
    radial = np.linalg.norm(across, axis=1, keepdims=True)
    closed = np.tanh((radial - CONTACT) / CONTACT_WIDTH) + np.tanh(CONTACT / CONTACT_WIDTH)
    beyond = np.logaddexp(0.0, (along - PRELOAD) / PRELOAD_WIDTH) - np.logaddexp(0.0, -PRELOAD / PRELOAD_WIDTH)
    shift = CLEARANCE * closed * across / np.maximum(radial, 1e-12)
    return 1e-3 * np.hstack([shift, -SOFTENING * PRELOAD_WIDTH * beyond])
