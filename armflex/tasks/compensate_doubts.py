"""What is doubtful about a compensated trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from armflex.arm import Arm
from armflex.errors import Flag
from armflex.tasks.inverse_kinematics import NEAR_SINGULAR
from armflex.trajectory import Trajectory

if TYPE_CHECKING:
    from armflex.tasks.compensate import CompensatedRow


def doubts(moved: Trajectory, rows: Sequence[CompensatedRow]) -> tuple[Flag, ...]:
    """Return where joints move far for little, changes may not be the smallest, and payloads change."""
    flags = []
    near = min(rows, key=lambda row: row.sigma_min)
    if near.sigma_min < NEAR_SINGULAR:
        text = f"at {near.time:g} s the smallest singular value is {near.sigma_min:.2g}: joints move far for little"
        flags.append(Flag("near_singular", text))
    doubtful = [row for row in rows if row.reached and not row.smallest]
    if doubtful:
        text = f"{len(doubtful)} rows, the first at {doubtful[0].time:g} s, are reached; smaller changes may do as well"
        flags.append(Flag("not_smallest", text))
    for i in range(1, len(moved)):
        if moved.payload[i] != moved.payload[i - 1]:
            jump = float(np.linalg.norm(rows[i].before[:3] - rows[i - 1].before[:3]))
            change = f"from {moved.payload[i - 1]} to {moved.payload[i]} at {moved.time[i]:g} s"
            between = f"between the rows at {moved.time[i - 1]:g} s and {moved.time[i]:g} s"
            text = f"{change} the tip springs by {jump * 1e3:.3g} mm; {between} it is off by up to as much"
            flags.append(Flag("payload_change", f"{text}, which the error halfway between rows leaves out"))
    return tuple(flags)


def too_wide(widest: float | None, between: float | None) -> tuple[Flag, ...]:
    """Return a flag where the error halfway between rows is larger than was asked [m]."""
    if between is None or (widest is not None and widest <= between):
        return ()
    left = "is not looked at with targets of one's own" if widest is None else f"is still {widest:.3g} m"
    return (Flag("between", f"the error halfway between rows {left}; at most {between:g} m was asked"),)


def too_fast(arm: Arm, commanded: Trajectory, moved: Trajectory) -> tuple[Flag, ...]:
    """Return a flag where a joint would be asked to move faster than its limit, and was not before."""
    if len(moved) < 2:
        return ()
    limits = np.array([joint.velocity for joint in arm.robot.moving])
    given, share = (np.abs(np.diff(t.q, axis=0)) / np.diff(t.time)[:, None] / limits for t in (commanded, moved))
    # A path that was too fast before is not held against the compensation.
    worse = np.where(share > 1.001 * np.maximum(given, 1.0), share, 0.0)
    segment, joint = np.unravel_index(int(np.argmax(worse)), worse.shape)
    if not worse.any():
        return ()
    where = f"{arm.joint_names[joint]} would move at {share[segment, joint]:.2g} times its speed limit"
    times = f"at {moved.time[segment]:g} s (commanded path: {given[segment, joint]:.2g} times)"
    return (Flag("too_fast", f"{where} {times}"),)
