"""A link that grows as it warms: alpha L (T - Tref) along the link."""

from __future__ import annotations

from armflex.conventions import Array
from armflex.effects.law import Amplitude, TwistLaw, Values
from armflex.effects.scene import Scene
from armflex.effects.shapes import LAGGED, WARM, warmth
from armflex.effects.spot import Here, Spot
from armflex.laws import Row


def _places(scene: Scene) -> list[Spot]:
    return [Spot(link, None, (name,)) for link in scene.links for name in scene.temperatures]


def _basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    return (warmth(here, row, *inner)[..., None] * here.stretch)[..., None, :]


THERMAL_GROWTH = TwistLaw("thermal_growth", _places, (Amplitude("alpha", "1/K"),), _basis, WARM, memory=LAGGED)
