"""Compliance that changes with the joint's position: (C1 q + C2 q^2) w along one axis."""

from armflex.laws.effects.effect import Amplitude, DependsOn, Plausible, TwistLaw, Words
from armflex.laws.effects.location import Location, with_terms
from armflex.laws.effects.shapes import compliances, on_axis, own_column
from armflex.laws.terms import powers

POSITION_DEPENDENT_COMPLIANCE = TwistLaw(
    name="position_dependent_compliance",
    words=Words(
        "position-dependent compliance", "the compliance of the joint depends on its position", "(C₁ q + C₂ q²) · w"
    ),
    instead="hang the same weight on the joint's link at several positions of the joint",
    plausible=Plausible(0.015, 0.01, "a part of what a joint gives"),
    places=lambda records: with_terms(
        [Location(joint, axis, (f"q_{joint}",)) for joint in records.joints for axis in records.axes(joint)],
        (0,),
        (0, 1),
    ),
    amplitudes=(Amplitude("C1", "{m}/{w} per q"), Amplitude("C2", "{m}/{w} per q^2")),
    terms=lambda here, inner: compliances(here.direction, *(powers(own_column(here), exponent) for exponent in (1, 2))),
    direction=on_axis,
    depends_on=DependsOn.COMPLIANCE,
)
