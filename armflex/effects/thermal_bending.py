"""A link that bends as it warms: beta (T - Tref), a rotation at its end."""

from __future__ import annotations

from armflex.effects.law import Amplitude, TwistLaw
from armflex.effects.scene import AXES_TURN
from armflex.effects.shapes import LAGGED, WARM, at_links, on_axis, warmth, with_temperature

THERMAL_BENDING = TwistLaw(
    "thermal_bending",
    lambda scene: with_temperature(lambda name: at_links(scene, AXES_TURN, name), scene),
    (Amplitude("beta", "rad/K"),),
    lambda here, wrench, row, inner: on_axis(here, warmth(here, row, *inner)),
    WARM,
    memory=LAGGED,
)
