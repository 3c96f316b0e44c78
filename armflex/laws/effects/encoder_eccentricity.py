"""Eccentric encoder disc or bearing: A sin q + B cos q."""

from __future__ import annotations

import numpy as np

from armflex.laws.effects.law import Amplitude, TwistLaw
from armflex.laws.effects.scene import Scene
from armflex.laws.effects.shapes import at_drives, on_drive, own_position
from armflex.laws.effects.spot import Spot, with_terms


def _places(scene: Scene) -> list[Spot]:
    turning = [spot for spot in at_drives(scene, "q_{joint}") if str(spot.axis).startswith("r")]
    return with_terms(turning, (0, 1))


ENCODER_ECCENTRICITY = TwistLaw(
    "encoder_eccentricity",
    _places,
    (Amplitude("A", "rad"), Amplitude("B", "rad")),
    on_drive(lambda here, wrench, row, inner: (np.sin(own_position(here, row)), np.cos(own_position(here, row)))),
)
