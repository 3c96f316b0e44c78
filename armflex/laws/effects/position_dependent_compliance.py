"""Compliance that changes with the joint's position: (C1 q + C2 q^2) w along one axis."""

from __future__ import annotations

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.law import Amplitude, TwistLaw, Values
from armflex.laws.effects.scene import Scene
from armflex.laws.effects.shapes import along, at_joints, on_axis, own_position
from armflex.laws.effects.spot import Here, Spot, with_terms


def _places(scene: Scene) -> list[Spot]:
    spots = [Spot(spot.site, spot.axis, (f"q_{spot.site}",)) for spot in at_joints(scene)]
    return with_terms(spots, (0,), (0, 1))


def _shapes(here: Here, wrench: Array, row: Row, inner: Values) -> tuple[Array, ...]:
    load, position = along(here, wrench), own_position(here, row)
    return position * load, position**2 * load


POSITION_DEPENDENT_COMPLIANCE = TwistLaw(
    "position_dependent_compliance",
    _places,
    (Amplitude("C1", "{m}/{w} per q"), Amplitude("C2", "{m}/{w} per q^2")),
    on_axis(_shapes),
    loaded=True,
    linear=True,
)
