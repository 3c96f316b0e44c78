"""A link that grows as it warms: alpha L (T - Tref) along the link."""

from __future__ import annotations

from armflex.laws.effects.law import Along, Amplitude, TwistLaw
from armflex.laws.effects.scene import Scene
from armflex.laws.effects.shapes import LAGGED, WARM, warmth
from armflex.laws.effects.spot import Spot


def _places(scene: Scene) -> list[Spot]:
    return [Spot(link, None, (name,)) for link in scene.links for name in scene.temperatures]


THERMAL_GROWTH = TwistLaw(
    "thermal_growth",
    _places,
    (Amplitude("alpha", "1/K"),),
    Along(lambda here, wrench, row, inner: (warmth(here, row, *inner),), lambda here, inner: here.stretch),
    WARM,
    memory=LAGGED,
)
