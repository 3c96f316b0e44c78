"""What no law has of a drive's error over its position: a smooth curve, f(q), about the joint's own axis or another.

The curve is a sum of sines over the recorded range and some way beyond, at both ends of which it is zero: where nothing
was measured it ends. Their amplitudes have a prior that falls with their number; see `armflex.trace.families`. At work
it is a table (`Of.TABLE`), of each sine the same as of their sum: at `FINE` knots a half-wave of the finest, an error
of a thousandth of that.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import AXES_TURN, Records
from armflex.laws.effects.effect import Amplitude, Inner, Plausible, Search, TwistLaw, Values, Words
from armflex.laws.effects.location import Here, Location, drive_axis
from armflex.laws.effects.shapes import SECOND_ENCODER, of_column, own_column, twists
from armflex.laws.terms import Factor, Term, Terms, table

MOST_SINES, FINE = 256, 8
"""Tolerance: sines that a curve has at most, and knots of its table for each half-wave of the finest."""


def _places(records: Records) -> list[Location]:
    every = tuple(range(MOST_SINES))
    return [
        Location(joint.name, axis, (f"q_{joint.name}",), every)
        for joint in records.robot.moving
        for axis in dict.fromkeys(
            (drive_axis(joint), *(turned for turned in AXES_TURN if turned in records.axes(joint.name)))
        )
    ]


def _way(here: Here, inner: Values = ()) -> Array:
    """Return the (6,) direction: the joint's own motion where it is about that axis."""
    assert here.joint is not None
    return here.drive if here.location.axis == drive_axis(here.joint) else here.direction


@lru_cache(256)
def _knots(acting: tuple[int, ...]) -> Array:
    """Return the (k, K) values of some of the sines at the knots of their table."""
    places = np.linspace(0.0, np.pi, FINE * (max(acting) + 1) + 1)
    return np.sin((np.array(acting)[:, None] + 1.0) * places)


def _table(here: Here, inner: Values, values: Array) -> Factor:
    low, high = inner
    return table(own_column(here), low, (high - low) / (len(values) - 1), values.tolist())


def _terms(here: Here, inner: Values) -> list[list[Term]]:
    acting, each = here.location.terms, [list[Term]() for _ in range(MOST_SINES)]
    factors = [_table(here, inner, values) for values in _knots(acting)]
    for i, term in zip(acting, twists(_way(here), *([factor] for factor in factors)), strict=True):
        each[i] = term
    return each


def _joined(here: Here, amplitudes: Sequence[float], inner: Values) -> Terms:
    acting = here.location.terms
    values = np.array([amplitudes[i] for i in acting]) @ _knots(acting)
    return [Term(_way(here), factors=(_table(here, inner, values),))]


DRIVE_CURVE = TwistLaw(
    name="drive_curve",
    words=Words("curve of a drive", "the joint errs by a smooth curve over its position", "f(q)"),
    plausible=Plausible(0.001, 0.003, "gears are made to some arcmin"),
    places=_places,
    amplitudes=tuple(Amplitude(f"s{i + 1}", "{m}") for i in range(MOST_SINES)),
    terms=_terms,
    joined=_joined,
    instead=SECOND_ENCODER,
    direction=_way,
    inner=(
        Inner("low", "as recorded", of_column(lambda x: (float(x.min()),)), positive=False, polished=False),
        Inner("high", "as recorded", of_column(lambda x: (float(x.max()),)), positive=False, polished=False),
    ),
    search=Search.NOWHERE,
)
