"""Effects that no catalogue names, and the list of all makers."""

from collections.abc import Callable

import numpy as np

import support.undeclared_elsewhere as elsewhere
import support.undeclared_joints as joints
from support.undeclared import REFERENCE, Context, Effect, Redraw, driven, given

Maker = Callable[[Context], Effect]


def bump(s: Context) -> Effect:
    """A narrow place in one joint."""
    i = s.joint()
    centre = float(np.quantile(s.rows.q[:, i], s.rng.uniform(0.2, 0.8)))
    width = float(s.rng.uniform(0.04, 0.12) * np.ptp(s.rows.q[:, i]))
    told = {"law": "bump", "centre": centre, "width": width}
    return driven(
        s,
        "unnamed",
        i,
        lambda t: np.exp(-0.5 * ((t.rows.q[:, i] - centre) / width) ** 2),
        lambda x: {"height": x, **told},
        (f"q_{s.plant.joints[i].name}",),
        s.sign(),
    )


def other_joint(s: Context) -> Effect:
    """One joint turns with the sine of another's position."""
    i, a = s.joint(), int(s.rng.integers(3, 6))
    other = s.joint(turning=True)
    if other == i:
        raise Redraw
    k, phase, name = float(s.rng.uniform(1.0, 3.0)), float(s.rng.uniform(-np.pi, np.pi)), s.plant.joints[other].name
    told = {"law": "other_joint", "of": name, "k": k, "phase": phase}
    return given(
        s,
        "unnamed",
        i,
        a,
        lambda t: np.sin(k * t.rows.q[:, other] + phase),
        lambda x: {"amplitude": x, **told},
        (f"q_{name}",),
    )


def product(s: Context) -> Effect:
    i = s.joint(turning=True)
    k, warm, name = float(s.rng.uniform(2.0, 4.0)), s.rows.temperature - REFERENCE, s.plant.joints[i].name
    told = {"law": "product", "k": k, "T_ref": REFERENCE}
    return driven(
        s,
        "unnamed",
        i,
        lambda t: np.sin(k * t.rows.q[:, i]) * warm,
        lambda x: {"amplitude": x, **told},
        (f"q_{name}", "temperature"),
        s.sign(),
    )


def random_pose(s: Context) -> Effect:
    """A twist per pose that nothing recorded explains."""
    i, a = s.joint(), int(s.rng.integers(3, 6))
    names = np.unique(s.rows.pose)
    of_row = s.rng.normal(size=len(names))[np.searchsorted(names, s.rows.pose)]
    return given(s, "unexplained", i, a, lambda t: of_row, lambda x: {"std": x, "law": "random_pose"}, ())


def by_name(*makers: Maker) -> dict[str, Maker]:
    return {maker.__name__: maker for maker in makers}


CATALOGUE: dict[str, Maker] = by_name(
    joints.encoder_offset,
    joints.encoder_scale,
    joints.encoder_eccentricity,
    joints.gear_harmonic,
    joints.backlash,
    joints.friction_windup,
    joints.hysteresis,
    joints.stiffening,
    joints.deadband,
    joints.even_in_load,
    joints.compliance,
    joints.cross_coupling,
    joints.position_dependent_compliance,
    joints.thermal_softening,
    joints.creep,
    joints.slip_step,
    joints.dress_pack,
    elsewhere.thermal_growth,
    elsewhere.thermal_bending,
    elsewhere.link_flexure,
    elsewhere.link_mass,
    elsewhere.link_geometry,
    elsewhere.payload_mass,
    elsewhere.payload_com,
    elsewhere.tool_shift,
    elsewhere.tip_force,
    elsewhere.umbilical,
    elsewhere.magnetic_pull,
    elsewhere.base_compliance,
    elsewhere.base_thermal,
    elsewhere.base_drift,
    elsewhere.gravity_tilt,
    elsewhere.tracker_scale,
    elsewhere.session_frame,
)
LAGGING = ("thermal_growth", "thermal_bending", "thermal_softening", "base_thermal")
UNNAMED: dict[str, Maker] = by_name(bump, other_joint, product, random_pose)
