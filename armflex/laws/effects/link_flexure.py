"""A link that gives at its end, in the frame before its end joint's motion: C w, on one axis or its three turns."""

from __future__ import annotations

from armflex.laws.effects.law import Amplitude, TwistLaw, Words
from armflex.laws.effects.scene import AXES, Records
from armflex.laws.effects.shapes import ON_THE_LINK, at_links, unit_twists
from armflex.laws.effects.spot import Spot


def _places(records: Records) -> list[Spot]:
    single = [Spot(spot.site, spot.axis, terms=(AXES.index(str(spot.axis)),)) for spot in at_links(records)]
    bending = ((3, 4), (3, 5), (4, 5), (3, 4, 5))
    return single + [Spot(link, None, terms=terms) for link in records.links for terms in bending]


LINK_FLEXURE = TwistLaw(
    name="link_flexure",
    words=Words("link flexure", "the link itself bends", "C · w"),
    instead=ON_THE_LINK,
    places=_places,
    amplitudes=tuple(Amplitude(f"C_{axis}", "m/N" if axis[0] == "d" else "rad/Nm", positive=True) for axis in AXES),
    basis=lambda here, wrench, row, inner: unit_twists(wrench),
    loaded=True,
    linear=True,
)
