"""What is doubtful about a question to an arm, or about its answer: wrong units first of all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag, PayloadError, UnknownNameError
from armflex.mechanics.loads import Payload, Wrench
from armflex.mechanics.structure import Structure

FORCE_BAND = 10.0
"""External forces beyond this many times the arm's weight are flagged: kN or kgf given as N?"""

SAG_BAND = 0.1
"""Displacements beyond this fraction of the reach are flagged."""


def payload_doubts(arm: Structure, payload: Payload, accelerated: bool) -> tuple[Flag, ...]:
    """Return the doubts about a payload; raise `PayloadError` where its centre of mass is beyond the arm's reach."""
    distance = float(np.linalg.norm(payload.com))
    if payload.mass and distance > max(arm.robot.reach, 1.0):
        raise PayloadError(f"payload CoM is {distance:g} m from the tip, more than the arm's reach: millimetres?")
    flags: tuple[Flag, ...] = ()
    if arm.payload_rating is not None and payload.mass > arm.payload_rating:
        text = f"payload of {payload.mass:g} kg exceeds the rated {arm.payload_rating:g} kg"
        flags = (Flag("beyond_rating", text),)
    if accelerated and payload.mass and payload.inertia is None:
        flags = (*flags, Flag("no_inertia", "the payload's inertia is not given, so its turning adds no load"))
    return flags


def wrench_doubts(arm: Structure, wrenches: Sequence[Wrench]) -> tuple[Flag, ...]:
    """Return the doubts about loads from outside; raise `UnknownNameError` where one is at no link of the arm."""
    flags = []
    for wrench in wrenches:
        if wrench.frame not in arm.robot.urdf.links or wrench.frame not in arm.link_names:
            raise UnknownNameError("link", wrench.frame, arm.link_names)
        if wrench.axes == "frame":
            text = f"the load at {wrench.frame!r} turns with its link; buckling is checked, flutter is not"
            flags.append(Flag("follower_load", text))
        size = float(np.linalg.norm(wrench.force))
        if 0.0 < FORCE_BAND * arm.weight < size:
            text = f"{size:.3g} N at {wrench.frame!r} is over {FORCE_BAND:g} times the arm's weight: kN or kgf?"
            flags.append(Flag("large_force", text))
    return tuple(flags)


def sag_doubts(arm: Structure, displacement: Array) -> tuple[Flag, ...]:
    """Return a flag where the tip moves by a good part of the reach."""
    sag = float(np.linalg.norm(displacement[:3]))
    if sag <= SAG_BAND * arm.robot.reach:
        return ()
    return (Flag("large_sag", f"the tip moves {sag:.3g} m, over {SAG_BAND:.0%} of the reach"),)
