"""Where the moving joints off the chain are held: they weigh, but they do not move."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from armflex.conventions import finite_array
from armflex.errors import Flag, JointLimitError, UnknownNameError
from armflex.robot.elements import MOVING, Joint
from armflex.robot.tree import joints_by_parent
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
    """
    on_chain = {joint.name for joint in chain}
    side = {joint.name: joint for joint in urdf.joints.values() if joint.kind in MOVING and joint.name not in on_chain}
    for name in locked:
        if name not in side:
            raise UnknownNameError("joint off the chain", name, side)
    asked = {name: _asked(side[name], value) for name, value in locked.items()}
    wanted = {name: _wanted(urdf, side, asked, joint) for name, joint in side.items()}
    held = {name: float(np.clip(wanted[name] or 0.0, joint.lower, joint.upper)) for name, joint in side.items()}
    weighing = _joints_below(urdf, base)
    doubtful = [joint for name, joint in side.items() if wanted[name] != held[name] and joint.mimic]
    flags = (_flag(joint, held[joint.name]) for joint in doubtful if joint.name in weighing)
    return held, tuple(flags)


def _asked(joint: Joint, value: float) -> float:
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
        joint, factor, offset = urdf.joints[master], factor * multiplier, factor * shift + offset
    return None


def _joints_below(urdf: Urdf, base: str) -> set[str]:
    children, stack, below = joints_by_parent(urdf), [base], set()
    while stack:
        for joint in children[stack.pop()]:
            below.add(joint.name)
            stack.append(joint.child)
    return below


def _flag(joint: Joint, position: float) -> Flag:
    text = (
        f"{joint.place}: joint {joint.name!r} off the chain mimics {joint.mimic[0]!r} but is held at {position:g}, and "
        "its weight with it; name it in [robot.locked] if that is meant"
    )
    return Flag("locked_mimic", text)
