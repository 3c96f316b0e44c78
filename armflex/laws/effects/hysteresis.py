"""Hysteresis: a play operator of the load, which depends on the rows driven before (Maxwell slip with one element)."""

from collections.abc import Iterable

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import AXES, Context
from armflex.laws.effects.effect import Amplitude, Inner, Memory, Plausible, TwistLaw, Values, Words
from armflex.laws.effects.location import Location
from armflex.laws.effects.shapes import at_joints, on_axis, play_in, twists
from armflex.laws.terms import powers


def play(load: Array, radius: float) -> Array:
    """Return (N,) the play operator of a (N,) load in row order, at rest at zero before the first row."""
    return play_in(np.asarray(load, dtype=float), float(radius))


def _state(location: Location, inner: Values) -> str:
    return f"play_{location.key}_{inner[0]:.4g}"


def _radii(location: Location, context: Context) -> Iterable[float]:
    load = context.wrenches[location.site][:, AXES.index(str(location.axis))]
    return float(np.ptp(load)) * np.array([0.05, 0.1, 0.2, 0.3])


HYSTERESIS = TwistLaw(
    name="hysteresis",
    words=Words("hysteresis", "the deflection of the joint depends on earlier loads", "gain · play(τ; radius)"),
    instead="load and unload the joint with weights at one pose",
    plausible=Plausible(0.001, 0.002, "a part of lost motion"),
    places=at_joints,
    amplitudes=(Amplitude("gain", "{m}/{w}", positive=True),),
    terms=lambda here, inner: twists(here.direction, powers(_state(here.location, inner), 1)),
    direction=on_axis,
    inner=(Inner("radius", "{w}", _radii),),
    memory=Memory(_state, lambda here, wrench, row, inner: play(wrench @ here.direction, inner[0]), "{w}"),
)
