"""Every effect that a campaign is searched for, by name: a new one is its file, and its line here."""

from __future__ import annotations

from armflex.laws.effects.backlash import BACKLASH
from armflex.laws.effects.base_compliance import BASE_COMPLIANCE
from armflex.laws.effects.base_drift import BASE_DRIFT
from armflex.laws.effects.base_thermal import BASE_THERMAL
from armflex.laws.effects.compliance import COMPLIANCE
from armflex.laws.effects.creep import CREEP
from armflex.laws.effects.cross_coupling import CROSS_COUPLING
from armflex.laws.effects.deadband import DEADBAND
from armflex.laws.effects.dress_pack import DRESS_PACK
from armflex.laws.effects.effect import EffectLaw
from armflex.laws.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from armflex.laws.effects.encoder_offset import ENCODER_OFFSET
from armflex.laws.effects.encoder_scale import ENCODER_SCALE
from armflex.laws.effects.even_in_load import EVEN_IN_LOAD
from armflex.laws.effects.friction_windup import FRICTION_WINDUP
from armflex.laws.effects.gear_harmonic import GEAR_HARMONIC
from armflex.laws.effects.gravity_tilt import GRAVITY_TILT
from armflex.laws.effects.guide import GUIDE
from armflex.laws.effects.hysteresis import HYSTERESIS
from armflex.laws.effects.link_flexure import LINK_FLEXURE
from armflex.laws.effects.link_geometry import LINK_GEOMETRY
from armflex.laws.effects.link_mass import LINK_MASS
from armflex.laws.effects.magnetic_pull import MAGNETIC_PULL
from armflex.laws.effects.payload_com import PAYLOAD_COM
from armflex.laws.effects.payload_mass import PAYLOAD_MASS
from armflex.laws.effects.position_dependent_compliance import POSITION_DEPENDENT_COMPLIANCE
from armflex.laws.effects.session_frame import SESSION_FRAME
from armflex.laws.effects.slip_step import SLIP_STEP
from armflex.laws.effects.stiffening import STIFFENING
from armflex.laws.effects.thermal_bending import THERMAL_BENDING
from armflex.laws.effects.thermal_growth import THERMAL_GROWTH
from armflex.laws.effects.thermal_softening import THERMAL_SOFTENING
from armflex.laws.effects.tip_force import TIP_FORCE
from armflex.laws.effects.tool_shift import TOOL_SHIFT
from armflex.laws.effects.tracker_scale import TRACKER_SCALE
from armflex.laws.effects.umbilical import UMBILICAL
from armflex.laws.effects.unnamed import BUMP, LEVEL, LINE, PRODUCT, SPLINE, SPLINE_COMPLIANCE, WAVE, WAVE_PRODUCT

LAWS: tuple[EffectLaw, ...] = (
    ENCODER_OFFSET,
    ENCODER_SCALE,
    ENCODER_ECCENTRICITY,
    GEAR_HARMONIC,
    BACKLASH,
    FRICTION_WINDUP,
    HYSTERESIS,
    COMPLIANCE,
    CROSS_COUPLING,
    STIFFENING,
    DEADBAND,
    EVEN_IN_LOAD,
    POSITION_DEPENDENT_COMPLIANCE,
    THERMAL_SOFTENING,
    CREEP,
    SLIP_STEP,
    DRESS_PACK,
    BASE_COMPLIANCE,
    BASE_THERMAL,
    BASE_DRIFT,
    GRAVITY_TILT,
    TRACKER_SCALE,
    SESSION_FRAME,
    PAYLOAD_MASS,
    PAYLOAD_COM,
    TOOL_SHIFT,
    TIP_FORCE,
    THERMAL_GROWTH,
    THERMAL_BENDING,
    LINK_FLEXURE,
    LINK_MASS,
    LINK_GEOMETRY,
    UMBILICAL,
    MAGNETIC_PULL,
    GUIDE,
    LEVEL,
    LINE,
    WAVE,
    BUMP,
    SPLINE,
    SPLINE_COMPLIANCE,
    WAVE_PRODUCT,
    PRODUCT,
)
"""In the order of preference where the data cannot tell two laws apart: the plainer first; then what has no name."""

EVERY: dict[str, EffectLaw] = {law.name: law for law in LAWS}
"""Name -> law."""

CATALOGUE: dict[str, EffectLaw] = {law.name: law for law in LAWS if not law.shape}
"""Those that files call by it."""

SHAPES: dict[str, EffectLaw] = {law.shape: law for law in LAWS if law.shape}
"""What files call a shape without a name -> shape."""
