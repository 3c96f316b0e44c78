"""A twist that is the same way whichever way the load points: c |w_perp|, or c tau^2."""

import numpy as np

from armflex.laws.effects.effect import Amplitude, DependsOn, Plausible, TwistLaw, Values, Words
from armflex.laws.effects.location import Here, with_terms
from armflex.laws.effects.shapes import at_joints, on_axis
from armflex.laws.terms import Term, part, power


def _terms(here: Here, inner: Values) -> list[list[Term]]:
    way = here.direction
    lengths = (np.diag((1.0 - way) * direction) for direction in np.repeat(np.eye(2), 3, axis=1))
    each = (*((power(form, 0.5),) for form in lengths), (part(way), part(way)))
    return [[Term(way, features=features)] for features in each]


EVEN_IN_LOAD = TwistLaw(
    name="even_in_load",
    words=Words("deflection even in the load", "the same way whichever way it is loaded", "c |w|, c τ²"),
    instead="load the joint with the same weight from either side",
    plausible=Plausible(0.002, 0.003, "a part of what bearings give"),
    places=lambda records: with_terms(at_joints(records), (0,), (1,), (2,)),
    amplitudes=(Amplitude("c_force", "{m}/N"), Amplitude("c_moment", "{m}/Nm"), Amplitude("c_square", "{m}/{w}^2")),
    terms=_terms,
    direction=on_axis,
    depends_on=DependsOn.LOAD,
)
