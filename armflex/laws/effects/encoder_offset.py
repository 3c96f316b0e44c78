"""Encoder offset: the joint is elsewhere than reported, always by the same amount."""

from __future__ import annotations

import numpy as np

from armflex.laws.effects.law import Amplitude, TwistLaw
from armflex.laws.effects.shapes import at_drives, on_drive

ENCODER_OFFSET = TwistLaw(
    "encoder_offset",
    at_drives,
    (Amplitude("offset", "{m}"),),
    on_drive(lambda here, wrench, row, inner: (np.ones(wrench.shape[:-1]),)),
)
