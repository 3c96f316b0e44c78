"""A link that is not as drawn: a constant twist at its end."""

from armflex.laws.effects.context import AXES
from armflex.laws.effects.effect import Amplitude, DependsOn, Plausible, TwistLaw, Words
from armflex.laws.effects.shapes import ON_THE_LINK, singly_and_together
from armflex.laws.terms import UNITS, Term

LINK_GEOMETRY = TwistLaw(
    name="link_geometry",
    words=Words("link geometry correction", "the geometry of the link differs from the drawing", "constant twist"),
    instead=ON_THE_LINK,
    plausible=Plausible(0.005, 0.01, "what is built a cm off its drawing is measured again"),
    places=lambda records: singly_and_together(records.links, (0, 1, 2), (3, 4, 5)),
    amplitudes=tuple(Amplitude(axis, "m" if axis[0] == "d" else "rad") for axis in AXES),
    terms=lambda here, inner: [[Term(unit)] for unit in UNITS],
    depends_on=DependsOn.NOTHING,
    stands_for=("geometry",),
)
