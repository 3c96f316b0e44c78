"""Backlash: (gap / 2) s, s the direction from which the joint came."""

from __future__ import annotations

from armflex.laws.effects.law import Amplitude, TwistLaw
from armflex.laws.effects.shapes import approach, at_drives, on_drive

BACKLASH = TwistLaw(
    "backlash",
    lambda scene: at_drives(scene, "approach_{joint}"),
    (Amplitude("gap", "{m}"),),
    on_drive(lambda here, wrench, row, inner: (0.5 * approach(here, row),)),
)
