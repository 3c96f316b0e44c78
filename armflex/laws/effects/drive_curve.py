"""What no law has of a drive's error over its position: a smooth curve, f(q), about the joint's own axis or another.

The curve is a sum of sines over the recorded range and some way beyond, at both ends of which it is zero: where nothing
was measured it ends. Their amplitudes have a prior that falls with their number; see `armflex.trace.families`.
"""

from functools import lru_cache

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import AXES_TURN, Records
from armflex.laws.effects.curves import FINE, curves
from armflex.laws.effects.effect import Plausible, Values, Words
from armflex.laws.effects.location import Here, Location, drive_axis
from armflex.laws.effects.shapes import SECOND_ENCODER

MOST_SINES = 256
"""Tolerance: sines that a curve has at most."""


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


DRIVE_CURVE = curves(
    _way,
    _knots,
    MOST_SINES,
    ("low", "high", "as recorded"),
    name="drive_curve",
    words=Words("curve of a drive", "the joint errs by a smooth curve over its position", "f(q)"),
    plausible=Plausible(0.001, 0.003, "gears are made to some arcmin"),
    places=_places,
    instead=SECOND_ENCODER,
)
