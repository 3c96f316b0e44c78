"""Every effect that an arm may have, by name: a new one is its file, and its line here or an entry point."""

from importlib import import_module

from armflex.laws.effects.drive_curve import DRIVE_CURVE
from armflex.laws.effects.effect import EffectLaw
from armflex.laws.effects.guide import GUIDES
from armflex.laws.effects.unnamed import (
    BUMP,
    LEVEL,
    LINE,
    LINE_COMPLIANCE,
    LINE_PLAY,
    PRODUCT,
    SPLINE,
    SPLINE_COMPLIANCE,
    WAVE,
    WAVE_PRODUCT,
)
from armflex.laws.effects.wandering import BASE_WANDERING, DRIVE_WANDERING
from armflex.plugins import Registry

NAMED = (
    "encoder_offset",
    "encoder_scale",
    "encoder_eccentricity",
    "gear_harmonic",
    "backlash",
    "friction_windup",
    "hysteresis",
    "compliance",
    "cross_coupling",
    "stiffening",
    "deadband",
    "even_in_load",
    "position_dependent_compliance",
    "thermal_softening",
    "creep",
    "slip_step",
    "dress_pack",
    "base_compliance",
    "base_thermal",
    "base_drift",
    "instrument_moved",
    "gravity_tilt",
    "tracker_scale",
    "refraction",
    "session_frame",
    "payload_mass",
    "payload_com",
    "tool_shift",
    "tip_force",
    "thermal_growth",
    "thermal_bending",
    "link_flexure",
    "link_mass",
    "link_geometry",
    "umbilical",
    "magnetic_pull",
    "pin_play",
    "cylinder_leak",
    "weak_spring",
    "bent_rod",
    "support_lift",
    "guide",
    "telescope_bending",
)
"""A file each, whose law has its name in capitals; see `LAWS` for the order."""

LAWS: tuple[EffectLaw, ...] = (
    *(getattr(import_module(f"armflex.laws.effects.{name}"), name.upper()) for name in NAMED),
    *(LEVEL, LINE, WAVE, BUMP, SPLINE, SPLINE_COMPLIANCE, WAVE_PRODUCT, PRODUCT),
    *(DRIVE_CURVE, LINE_COMPLIANCE, LINE_PLAY, GUIDES, BASE_WANDERING, DRIVE_WANDERING),
)
"""In the order of preference where the data do not distinguish two laws: the plainer first; then unnamed shapes, and
last those that are `dense`."""


def _fault(name: str, law: object) -> str:
    if not isinstance(law, EffectLaw) or law.shape:
        return "expected an EffectLaw of armflex.laws.effects"
    return "" if law.name == name else f"expected the law's name, {law.name!r}"


GROUP = "armflex.effects"
"""Of the entry points by which other distributions add laws."""

EVERY: Registry[EffectLaw] = Registry(GROUP, {law.name: law for law in LAWS}, _fault)
"""Name -> law."""

CATALOGUE: Registry[EffectLaw] = Registry(GROUP, {law.name: law for law in LAWS if not law.shape}, _fault)
"""Those that files call by it."""

SHAPES: dict[str, EffectLaw] = {law.shape: law for law in LAWS if law.shape}
"""What files call an unnamed shape -> shape."""
