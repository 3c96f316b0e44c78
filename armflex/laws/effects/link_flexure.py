"""A link that bends at its end, in the frame before its end joint's motion: C w, on one axis or about several."""

from armflex.laws.effects.context import AXES
from armflex.laws.effects.effect import Amplitude, DependsOn, Plausible, TwistLaw, Words
from armflex.laws.effects.shapes import (
    CROSSED,
    ON_THE_LINK,
    crossed_terms,
    each_axis,
    singly_and_together,
    turning_terms,
)

LINK_FLEXURE = TwistLaw(
    name="link_flexure",
    words=Words("link flexure", "the link itself bends", "C · w"),
    instead=ON_THE_LINK,
    plausible=Plausible(0.015, 0.01, "a larger deflection is visible to the naked eye, and declared"),
    places=lambda records: singly_and_together(records.links, *turning_terms(3, 6)),
    amplitudes=(
        *(Amplitude(f"C_{axis}", "m/N" if axis[0] == "d" else "rad/Nm", positive=True) for axis in AXES),
        *(Amplitude(name, "rad/Nm") for name in CROSSED),
    ),
    terms=lambda here, inner: [*each_axis(), *crossed_terms()],
    depends_on=DependsOn.COMPLIANCE,
)
