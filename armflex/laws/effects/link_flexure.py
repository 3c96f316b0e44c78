"""A link that gives at its end, in the frame before its end joint's motion: C w, on one axis or its three turns."""

from __future__ import annotations

from armflex.laws.effects.law import Amplitude, TwistLaw
from armflex.laws.effects.scene import AXES, Scene
from armflex.laws.effects.shapes import at_links, unit_twists
from armflex.laws.effects.spot import Spot


def _places(scene: Scene) -> list[Spot]:
    single = [Spot(spot.site, spot.axis, terms=(AXES.index(str(spot.axis)),)) for spot in at_links(scene)]
    bending = ((3, 4), (3, 5), (4, 5), (3, 4, 5))
    return single + [Spot(link, None, terms=terms) for link in scene.links for terms in bending]


LINK_FLEXURE = TwistLaw(
    "link_flexure",
    _places,
    tuple(Amplitude(f"C_{axis}", "m/N" if axis[0] == "d" else "rad/Nm", positive=True) for axis in AXES),
    lambda here, wrench, row, inner: unit_twists(wrench),
    loaded=True,
    linear=True,
)
