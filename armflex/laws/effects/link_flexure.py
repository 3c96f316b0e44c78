"""A link that gives at its end, in the frame before its end joint's motion: C w, on one axis or its three turns."""

from __future__ import annotations

from armflex.laws.effects.effect import Amplitude, TwistLaw, Words
from armflex.laws.effects.location import Location
from armflex.laws.effects.scene import AXES, Records
from armflex.laws.effects.shapes import ON_THE_LINK, at_links, unit_twists


def _places(records: Records) -> list[Location]:
    single = [
        Location(location.site, location.axis, terms=(AXES.index(str(location.axis)),))
        for location in at_links(records)
    ]
    bending = ((3, 4), (3, 5), (4, 5), (3, 4, 5))
    return single + [Location(link, None, terms=terms) for link in records.links for terms in bending]


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
