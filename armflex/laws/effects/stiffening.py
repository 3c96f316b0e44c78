"""A joint that stiffens (or softens) with its load: c2 tau|tau| and c3 tau^3."""

from armflex.laws.effects.effect import Amplitude, DependsOn, Plausible, TwistLaw, Values, Words
from armflex.laws.effects.location import Here, with_terms
from armflex.laws.effects.shapes import at_joints, on_axis
from armflex.laws.terms import Curve, Term, part


def _terms(here: Here, inner: Values) -> list[list[Term]]:
    load, size = part(here.direction), part(here.direction, Curve.SIZE)
    return [[Term(here.direction, features=factors)] for factors in ((load, size), (load, load, load))]


STIFFENING = TwistLaw(
    name="stiffening",
    words=Words(
        "load-dependent stiffness", "the deflection of the joint is not proportional to the load", "c₂ τ|τ| + c₃ τ³"
    ),
    instead="load the joint in steps with weights at one pose",
    plausible=Plausible(0.015, 0.01, "a part of what a joint gives"),
    places=lambda records: with_terms(at_joints(records), (0,), (1,), (0, 1)),
    amplitudes=(Amplitude("c2", "{m}/{w}^2"), Amplitude("c3", "{m}/{w}^3")),
    terms=_terms,
    direction=on_axis,
    depends_on=DependsOn.COMPLIANCE,
)
