"""Friction wind-up: s (a + b |tau|), the drive train twisted by the friction it had to overcome."""

from __future__ import annotations

import numpy as np

from armflex.laws.effects.law import Amplitude, TwistLaw
from armflex.laws.effects.shapes import approach, at_drives, on_drive
from armflex.laws.effects.spot import with_terms

FRICTION_WINDUP = TwistLaw(
    "friction_windup",
    lambda scene: with_terms(at_drives(scene, "approach_{joint}"), (0, 1), (1,)),
    (Amplitude("a", "{m}"), Amplitude("b", "{m}/{w}")),
    on_drive(
        lambda here, wrench, row, inner: (approach(here, row), approach(here, row) * np.abs(wrench @ here.drive)),
    ),
    loaded=True,
)
