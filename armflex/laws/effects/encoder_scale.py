"""Encoder scale: eps (q - q0); q0 is an encoder offset, which calibration has, and is taken as zero."""

from __future__ import annotations

from armflex.laws.effects.law import Amplitude, TwistLaw
from armflex.laws.effects.shapes import at_drives, on_drive, own_position

ENCODER_SCALE = TwistLaw(
    "encoder_scale",
    lambda scene: at_drives(scene, "q_{joint}"),
    (Amplitude("scale", "1"),),
    on_drive(lambda here, wrench, row, inner: (own_position(here, row),)),
)
