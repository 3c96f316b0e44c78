"""Compliance on top of the declared one, missing or wrong: C_aa w_a."""

from __future__ import annotations

from armflex.effects.law import Amplitude, TwistLaw
from armflex.effects.shapes import along, at_joints, on_axis

COMPLIANCE = TwistLaw(
    "compliance",
    at_joints,
    (Amplitude("C", "{m}/{w}"),),
    lambda here, wrench, row, inner: on_axis(here, along(here, wrench)),
    loaded=True,
)
