"""Advice in words: what to measure where the tip cannot tell, and what a campaign lacks."""

from __future__ import annotations

import numpy as np

from armflex.effects.law import Effect
from armflex.measurements import Measurements

INSTEAD = {
    "dress_pack": "repeat a few poses with the dress pack untied",
    "encoder_scale": "compare the joint's encoder with a second one, or an inclinometer on its link, over its range",
    "encoder_offset": "level the joint's link with an inclinometer, or measure a second target on it",
    "gravity_tilt": "put an inclinometer on the base",
    "base_compliance": "measure a target on the base with and without load",
    "base_thermal": "measure a target on the base at two temperatures",
    "base_drift": "measure fixed targets on the floor in every session",
    "session_frame": "measure fixed targets on the floor in every session",
    "payload_mass": "weigh the payload",
    "payload_com": "carry the same mass at another place of the tool",
    "link_mass": "weigh the link, or measure with its neighbours at another angle and no payload",
    "link_flexure": "measure a second target on the link",
    "link_geometry": "measure a second target on the link",
    "thermal_growth": "measure a second target on the link at two temperatures",
    "thermal_bending": "measure a second target on the link at two temperatures",
    "deadband": "reverse the load on the joint, with a counterweight or the arm turned over",
    "compliance": "measure a second target between the joints in question",
    "backlash": "approach the same poses from both sides, with and without payload",
    "friction_windup": "approach the same poses from both sides at two payloads",
    "hysteresis": "load and unload the joint at one pose",
    "creep": "hold the heaviest payload for an hour, and the empty arm as well",
    "tool_shift": "measure a second target on the tool",
    "tip_force": "measure again with whatever pulls on the tool taken off",
    "umbilical": "measure again with the umbilical taken off",
    "magnetic_pull": "measure again with the field off",
}
"""What shows an effect by other means than the tip's position."""


def instead(own: Effect, rival: Effect) -> str:
    """Return what tells two effects apart that move the tip alike."""
    told = dict.fromkeys(INSTEAD[e.law.name] for e in (rival, own) if e.law.name in INSTEAD)
    if not told:
        return "measure a second target, between the places in question"
    return " or ".join(told)


def lacking(measurements: Measurements) -> tuple[str, ...]:
    """Return what would make a campaign able to show more."""
    told = []
    used = measurements.measured
    names = np.array(measurements.payload)[used]
    kinds = len(set(names.tolist()))
    if kinds < 3:
        told.append(
            f"Measure with three payloads, one in between: {kinds} cannot tell a curved law from a straight one."
        )
    if len(set(measurements.session)) < 2:
        told.append(
            "Set the instrument up again half way: one session cannot tell a drift of the base from one of the arm."
        )
    turned = measurements.approach[used]
    one_way = [name for i, name in enumerate(measurements.joint_names) if len(set(turned[:, i].tolist()) - {0.0}) < 2]
    if one_way:
        told.append(f"Approach poses from both sides with {', '.join(one_way[:4])}: backlash does not show otherwise.")
    if len(set(zip(measurements.pose, measurements.payload, strict=True))) == len(measurements):
        told.append("Repeat ten poses or more: repeats give the noise without any model.")
    return tuple(told)
