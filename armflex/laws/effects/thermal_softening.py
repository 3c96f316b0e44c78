"""A joint that softens as it warms: beta (T - Tref) C w, on one axis or on all."""

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.context import Records
from armflex.laws.effects.effect import Afterwards, Amplitude, DependsOn, Plausible, TwistLaw, Values, Words
from armflex.laws.effects.location import Here, Location
from armflex.laws.effects.shapes import LAGGED, WARM, at_joints, shows_lag, warm, with_temperature
from armflex.laws.terms import Terms, weight_of

MOST = 0.1
"""Largest plausible beta [1/K]: plastics near their softening point; steel and gears have a thousandth."""


def _places(records: Records) -> list[Location]:
    whole = [Location(joint, None, (name,)) for joint in records.joints for name in records.temperatures]
    return whole + with_temperature(lambda name: at_joints(records, covariate=name), records)


def _basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    twist = np.zeros_like(wrench) if here.base_law is None else here.base_law.twist(wrench, row)
    if here.location.axis:
        twist = twist * np.abs(here.direction)
    return (np.asarray(weight_of(warm(here, *inner), row))[..., None] * twist)[..., None, :]


def _terms(here: Here, inner: Values) -> list[Terms]:
    axes = np.abs(here.direction) if here.location.axis else 1.0
    base = () if here.base_law is None else here.base_law.terms()
    return [[term.times(axes, *warm(here, *inner)) for term in base]]


THERMAL_SOFTENING = TwistLaw(
    name="thermal_softening",
    words=Words("thermal softening", "the compliance of the joint grows as it warms", "β (T − T₀) · C w"),
    instead="load the joint with weights at one pose when it is cold and when it is warm",
    plausible=Plausible(0.015, 0.01, "a part of what a joint gives"),
    places=_places,
    amplitudes=(Amplitude("beta", "1/K", most=MOST),),
    terms=_terms,
    basis=_basis,
    inner=WARM,
    depends_on=DependsOn.COMPLIANCE,
    memory=LAGGED,
    afterwards=Afterwards.ANEW,
    possible=shows_lag,
)
