"""Advice in words: what a campaign lacks."""

from __future__ import annotations

import numpy as np

from armflex.measured.measurements import Measurements


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
