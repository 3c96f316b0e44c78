"""Where the moving joints off the chain are held: they weigh, but they do not move."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from armflex.conventions import finite_array
from armflex.errors import Flag, JointLimitError, UnknownNameError, did_you_mean
from armflex.robot.elements import MOVING, Joint
from armflex.robot.tree import links_below
from armflex.robot.urdf import Urdf


def lock_side_joints(
    urdf: Urdf, base: str, chain: tuple[Joint, ...], locked: Mapping[str, float]
) -> tuple[dict[str, float], tuple[Flag, ...]]:
    """Return the position of every moving joint off the chain [rad or m], and the doubts about them.

    Each is held as asked; else, where it mimics another such joint, as that one says; else at zero or the nearest
    limit. A joint that mimics one of the chain should move with it, as a counterweight does, so it is flagged.

    Raises:
        UnknownNameError: A joint to be locked is not off the chain.
        JointLimitError: A joint is locked outside its limits.
        UrdfError: A joint is locked that cannot be read.
    """
    on_chain = {joint.name for joint in chain}
    side = {joint.name: joint for joint in urdf.joints.values() if joint.kind in MOVING and joint.name not in on_chain}
    for name in locked:
        if name not in side:
            raise UnknownNameError("joint off the chain", name, side)
    asked = {name: _asked(side[name], value) for name, value in locked.items()}
    wanted = {name: _wanted(urdf, side, asked, joint) for name, joint in side.items()}
    held = {name: float(np.clip(wanted[name] or 0.0, joint.lower, joint.upper)) for name, joint in side.items()}
    weighing = links_below(urdf, base)
    doubtful = [joint for name, joint in side.items() if wanted[name] != held[name] and joint.mimic]
    flags = (_flag(urdf, joint, held[joint.name]) for joint in doubtful if joint.child in weighing)
    return held, tuple(flags)


def _asked(joint: Joint, value: float) -> float:
    if joint.faults:
        raise joint.faults[0].error
    position = float(finite_array(value, f"locked {joint.name}", ()))
    if not joint.lower <= position <= joint.upper:
        limits = f"[{joint.lower:g}, {joint.upper:g}]"
        raise JointLimitError(f"joint {joint.name!r} is locked at {position:g}, outside its limits {limits}")
    return position


def _wanted(urdf: Urdf, side: Mapping[str, Joint], asked: Mapping[str, float], joint: Joint) -> float | None:
    """Return where a joint wants to be, None where that depends on the chain or on itself."""
    factor, offset = 1.0, 0.0
    for _ in range(len(side) + 1):
        if joint.name in asked:
            return factor * asked[joint.name] + offset
        if joint.name not in side:
            return offset if joint.kind == "fixed" else None
        if joint.mimic is None:
            return factor * float(np.clip(0.0, joint.lower, joint.upper)) + offset
        master, multiplier, shift = joint.mimic
        if master not in urdf.joints:
            return None
        joint, factor, offset = urdf.joints[master], factor * multiplier, factor * shift + offset
    return None


def _flag(urdf: Urdf, joint: Joint, position: float) -> Flag:
    assert joint.mimic is not None
    master = joint.mimic[0]
    missing = "" if master in urdf.joints else f", which is no joint{did_you_mean(master, urdf.joints)}"
    text = (
        f"{joint.place}: joint {joint.name!r} off the chain mimics {master!r}{missing} but is held at {position:g}, "
        "and its weight with it; name it in [robot.locked] if that is meant"
    )
    return Flag("locked_mimic", text)
