"""What wanders in time: the base or instrument, and the zeros of drives, as a random walk over the campaign.

The walk is a sum of the terms of its Karhunen-Loeve expansion (Ash and Gardner 1975, "Topics in stochastic processes",
1.4), whose amplitudes have one size, by the evidence; see `armflex.trace.families`. What the base did is not carried to
another day: its mean stands in for it. The zero of a drive stays where it came to: the best forecast of a random walk
is its last value.
"""

from functools import lru_cache

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.laws.effects.context import Records
from armflex.laws.effects.curves import FINE, curves
from armflex.laws.effects.effect import Afterwards, Plausible, Words
from armflex.laws.effects.location import BASE, Location, drive_axis
from armflex.laws.effects.shapes import ON_THE_FLOOR
from armflex.rows.rows import TIME

WALK_TERMS = 32
"""Tolerance: terms of a walk, finer ones are noise."""

RATES = np.pi * (np.arange(1, WALK_TERMS + 1) - 0.5)
"""Radians of every term over the campaign."""


def walk_terms(share: Array) -> Array:
    """Return the (..., k) terms of a walk at (...,) shares of its time, at the end of which its variance is 1."""
    return np.sqrt(2.0) * np.sin(RATES * share[..., None]) / RATES


@lru_cache(8)
def _knots(terms: tuple[int, ...]) -> Array:
    return walk_terms(np.linspace(0.0, 1.0, FINE * WALK_TERMS + 1)).T[list(terms)]


def walk_at(site: str, axis: str) -> Location:
    """Return the place of a walk of all terms, in time."""
    return Location(site, axis, (TIME,), tuple(range(WALK_TERMS)))


def _at_base(records: Records) -> list[Location]:
    return [walk_at(BASE, axis) for axis in TWIST_NAMES if records.timed]


def _at_drives(records: Records) -> list[Location]:
    return [walk_at(joint.name, drive_axis(joint)) for joint in records.robot.moving if records.timed]


BASE_WANDERING = curves(
    lambda here, inner: here.direction,
    _knots,
    WALK_TERMS,
    ("start", "end", "s"),
    name="base_wandering",
    words=Words("wandering of the base", "the foundation or the instrument wanders in time", "f(t)"),
    plausible=Plausible(0.003, 0.003, "a machine that wanders further is bolted down again"),
    places=_at_base,
    instead=ON_THE_FLOOR,
    afterwards=Afterwards.WANDERS,
)

DRIVE_WANDERING = curves(
    lambda here, inner: here.drive,
    _knots,
    WALK_TERMS,
    ("start", "end", "s"),
    name="drive_wandering",
    words=Words("wandering of a drive", "the joint's zero wanders in time", "f(t)"),
    plausible=Plausible(0.005, 0.01, "a tooth of a belt"),
    places=_at_drives,
    instead="drive to one pose again after every few readings",
    afterwards=Afterwards.STAYS,
)
