"""Coupling of two axes of a joint: C_ab w_b on a and the same on b, because compliance is symmetric."""

from itertools import combinations

import numpy as np

from armflex.laws.effects.context import AXES
from armflex.laws.effects.effect import Amplitude, DependsOn, Plausible, TwistLaw, Values, Words
from armflex.laws.effects.location import Here, Location
from armflex.laws.terms import UNITS, Term, straight


def _terms(here: Here, inner: Values) -> list[list[Term]]:
    both = np.outer(here.direction, UNITS[AXES.index(here.location.partner)])
    return [[straight(np.asarray(both + both.T, float))]]


CROSS_COUPLING = TwistLaw(
    name="cross_coupling",
    words=Words("cross coupling", "a load along one axis deflects another", "C_ab · w_b"),
    instead="hang a weight that loads one axis of the joint alone and measure a target beside the joint",
    plausible=Plausible(0.005, 0.005, "bearings couple a tenth of what they give, bent links half"),
    places=lambda records: [
        Location(joint, a, partner=b) for joint in records.joints for a, b in combinations(records.axes(joint), 2)
    ],
    amplitudes=(Amplitude("C", "{m}/{across}"),),
    terms=_terms,
    depends_on=DependsOn.COMPLIANCE,
    symmetric=True,
)
