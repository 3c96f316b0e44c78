"""A link that is built otherwise than drawn: a constant twist at its end."""

from __future__ import annotations

import numpy as np

from armflex.laws.effects.law import Amplitude, TwistLaw
from armflex.laws.effects.scene import AXES, Scene
from armflex.laws.effects.shapes import at_links
from armflex.laws.effects.spot import Spot


def _places(scene: Scene) -> list[Spot]:
    single = [Spot(spot.site, spot.axis, terms=(AXES.index(str(spot.axis)),)) for spot in at_links(scene)]
    whole = [Spot(link, None, terms=terms) for link in scene.links for terms in ((0, 1, 2), (3, 4, 5))]
    return single + whole


LINK_GEOMETRY = TwistLaw(
    "link_geometry",
    _places,
    tuple(Amplitude(axis, "m" if axis[0] == "d" else "rad") for axis in AXES),
    lambda here, wrench, row, inner: np.broadcast_to(np.eye(6), (*wrench.shape[:-1], 6, 6)),
)
