"""Compliance on top of the declared one, missing or wrong: C_aa w_a, on one axis or about several at once."""

from armflex.laws.effects.context import AXES
from armflex.laws.effects.effect import Amplitude, DependsOn, Plausible, TwistLaw, Watching, Words
from armflex.laws.effects.shapes import about_several, at_joints, compliances, each_axis

COMPLIANCE = TwistLaw(
    name="compliance",
    words=Words("compliance", "the compliance of the joint is larger (or smaller) than declared", "C · w"),
    instead=Watching("measure a second target between the joints in question"),
    plausible=Plausible(0.015, 0.01, "a larger deflection is visible to the naked eye, and declared"),
    places=lambda records: [*at_joints(records), *about_several(records, 4)],
    amplitudes=(
        Amplitude("C", "{m}/{w}"),
        *(Amplitude(f"C_{axis}", "m/N" if axis[0] == "d" else "rad/Nm") for axis in AXES),
    ),
    terms=lambda here, inner: [*compliances(here.direction, ()), *each_axis()],
    depends_on=DependsOn.COMPLIANCE,
    stands_for=("compliance", "law"),
)
