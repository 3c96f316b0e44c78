"""A base that tilts under the moment on it: C_b times the moment, the same about all axes, or each its own.

About several axes C_b is a symmetric matrix: what stands askew leans sideways, too.
"""

import numpy as np

from armflex.laws.effects.context import AXES_TURN, Records
from armflex.laws.effects.effect import Amplitude, DependsOn, Plausible, TwistLaw, Words
from armflex.laws.effects.location import BASE, Location
from armflex.laws.effects.shapes import CROSSED, crossed_terms, each_axis, turning_terms
from armflex.laws.terms import straight


def _places(records: Records) -> list[Location]:
    single = [Location(BASE, axis, terms=(1 + i,)) for i, axis in enumerate(AXES_TURN)]
    return [Location(BASE), *single, *(Location(BASE, terms=terms) for terms in turning_terms(1, 4))]


BASE_COMPLIANCE = TwistLaw(
    name="base_compliance",
    words=Words("base compliance", "the foundation tilts under the load", "C · w"),
    instead="measure a target on the base with and without load",
    plausible=Plausible(0.005, 0.005, "a foundation that tilts by more is repaired"),
    places=_places,
    amplitudes=(
        *(Amplitude(name, "rad/Nm", positive=True) for name in ("C", "C_rx", "C_ry", "C_rz")),
        *(Amplitude(name, "rad/Nm") for name in CROSSED),
    ),
    terms=lambda here, inner: [[straight(np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]))], *each_axis(3), *crossed_terms()],
    depends_on=DependsOn.COMPLIANCE,
)
