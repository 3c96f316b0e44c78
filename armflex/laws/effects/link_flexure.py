"""A link that gives at its end, in the frame before its end joint's motion: C w, on one axis or its three turns."""

from armflex.laws.effects.context import AXES
from armflex.laws.effects.effect import Amplitude, TwistLaw, Words
from armflex.laws.effects.shapes import ON_THE_LINK, singly_and_together, unit_twists

LINK_FLEXURE = TwistLaw(
    name="link_flexure",
    words=Words("link flexure", "the link itself bends", "C · w"),
    instead=ON_THE_LINK,
    places=lambda records: singly_and_together(records.links, (3, 4), (3, 5), (4, 5), (3, 4, 5)),
    amplitudes=tuple(Amplitude(f"C_{axis}", "m/N" if axis[0] == "d" else "rad/Nm", positive=True) for axis in AXES),
    basis=lambda here, wrench, row, inner: unit_twists(wrench),
    loaded=True,
    linear=True,
)
