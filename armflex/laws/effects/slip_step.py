"""A joint that slipped: a step at a time to be found."""

from collections.abc import Iterable

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Afterwards, Amplitude, Inner, Plausible, TwistLaw, Words
from armflex.laws.effects.location import Location
from armflex.laws.effects.shapes import at_joints, on_axis, twists
from armflex.laws.terms import Factor, Of


def moments(time: Array) -> Array:
    """Return the moments in between some at which something may have stepped: one reading before it is a lost beam."""
    time = np.unique(time)
    return (0.5 * (time[1:] + time[:-1]))[1:-1]


def times(location: Location, context: Context) -> Iterable[float]:
    """Return the times at which a search for a step begins."""
    between = moments(context.column("time"))
    # Times to begin the search with
    return between[np.linspace(0, len(between) - 1, 40).astype(int)] if len(between) else ()


SLIP_STEP = TwistLaw(
    name="slip_step",
    words=Words("slip", "the joint moved once and stayed there", "size from a moment on"),
    instead="drive to one pose again after every few readings",
    plausible=Plausible(0.005, 0.01, "a tooth of a belt"),
    places=lambda records: at_joints(records, covariate="time") if records.timed else [],
    amplitudes=(Amplitude("size", "{m}"),),
    terms=lambda here, inner: twists(here.direction, (Factor(Of.STEP, "time", (inner[0],)),)),
    direction=on_axis,
    inner=(Inner("at", "s", times, positive=False, smooth=False),),
    afterwards=Afterwards.STAYS,
)
