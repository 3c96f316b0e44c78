"""Advice in words: what to measure where the tip cannot tell, and what a campaign lacks."""

from __future__ import annotations

import numpy as np

from armflex.effects.law import Effect
from armflex.measured.measurements import Measurements

BY_HAND = "push the joint to and fro with its brake on, because play gives without force and wind-up springs back"
OVER_ITS_RANGE = "compare the joint's encoder with a second one or an inclinometer on its link over the joint's range"
IN_STEPS = "load the joint in steps with weights at one pose"
ON_THE_LINK = "measure a second target on the link"
ON_THE_FLOOR = "measure fixed targets on the floor in every session"

INSTEAD = {
    "encoder_offset": "level the joint's link with an inclinometer",
    "encoder_scale": OVER_ITS_RANGE,
    "encoder_eccentricity": OVER_ITS_RANGE,
    "gear_harmonic": "measure through one turn of the joint's motor in twenty steps",
    "backlash": BY_HAND,
    "friction_windup": BY_HAND,
    "hysteresis": "load and unload the joint with weights at one pose",
    "compliance": "measure a second target between the joints in question",
    "cross_coupling": "hang a weight that loads one axis of the joint alone and measure a target beside the joint",
    "stiffening": IN_STEPS,
    "deadband": "reverse the load on the joint with a counterweight or with the arm turned over",
    "even_in_load": "load the joint with the same weight from either side",
    "position_dependent_compliance": "hang the same weight on the joint's link at several positions of the joint",
    "thermal_softening": "load the joint with weights at one pose when it is cold and when it is warm",
    "creep": "hold the heaviest payload for an hour and the empty arm as well",
    "slip_step": "drive to one pose again after every few readings",
    "dress_pack": "repeat a few poses with the dress pack untied",
    "base_compliance": "measure a target on the base with and without load",
    "base_thermal": "measure a target on the base at two temperatures",
    "base_drift": ON_THE_FLOOR,
    "gravity_tilt": "put an inclinometer on the base",
    "tracker_scale": "measure a scale bar or a second instrument's distance with the instrument",
    "session_frame": ON_THE_FLOOR,
    "payload_mass": "weigh the payload",
    "payload_com": "carry the same mass at another place of the tool",
    "tool_shift": "measure a second target on the tool",
    "tip_force": "measure again with whatever pulls on the tool taken off",
    "thermal_growth": f"{ON_THE_LINK} at two temperatures",
    "thermal_bending": f"{ON_THE_LINK} at two temperatures",
    "link_flexure": ON_THE_LINK,
    "link_mass": "weigh the link",
    "link_geometry": ON_THE_LINK,
    "umbilical": "measure again with the umbilical taken off",
    "magnetic_pull": "measure again with the field off",
}
"""What shows an effect by other means than more rows of the same kind: one for every law of the catalogue."""


def instead(own: Effect, rival: Effect) -> str:
    """Return what tells two effects apart that move the tip alike."""
    told = dict.fromkeys(INSTEAD[e.law.name] for e in (rival, own) if e.law.name in INSTEAD)
    return ", or ".join(told) or "measure a second target between the places in question"


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
    derived = [name for name in measurements.derived if name != "time"]
    if derived:
        told.append(
            f"Write down {', '.join(derived[:4])}: the direction a joint came from was taken from the rows before."
        )
    if "time" in measurements.derived:
        told.append("Write down the time of every row: nothing that drifts, lags or slips was looked for.")
    if len(set(zip(measurements.pose, measurements.payload, strict=True))) == len(measurements):
        told.append("Repeat ten poses or more: repeats give the noise without any model.")
    return tuple(told)
