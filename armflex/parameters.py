"""What of an arm can be uncertain, as files and reports name it: block and parameter, 'compliance A4 ry'."""

from __future__ import annotations

from armflex.conventions import TWIST_NAMES
from armflex.flexure import Flexure
from armflex.laws.learned import LearnedLaw

INSTRUMENT, SESSIONS, MOUNTING = "instrument", "session_frame", "mounting"
FRAMES = (INSTRUMENT, SESSIONS, MOUNTING)
"""Blocks of one campaign alone: frames that nothing says will be the same in the next."""

COMPLIANCE, LAW, EFFECT = "compliance", "law", "effect"

BLOCKS = (INSTRUMENT, SESSIONS, MOUNTING, "tool", "joint_offset", "geometry", COMPLIANCE, LAW, EFFECT)
"""What the name of every fitted parameter begins with."""


def law_labels(flexure: Flexure) -> tuple[str, ...]:
    """Return how the parameters of a flexure's law are named in a `Certainty`; names may hold blanks themselves."""
    law = flexure.law
    if isinstance(law, LearnedLaw):
        return tuple(f"{LAW} {flexure.name} {label}" for label in law.labels)
    return tuple(f"{COMPLIANCE} {flexure.name} {axis}" for axis in TWIST_NAMES)
