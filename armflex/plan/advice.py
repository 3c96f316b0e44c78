"""What no tip reading can tell, and what would tell it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.identify import UNDETERMINED, partners_of
from armflex.laws.effects.law import Effect
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import FRAMES
from armflex.plan.model import Model, Suspect

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


AS_EFFECT = {
    "joint_offset": "encoder_offset",
    "compliance": "compliance",
    "law": "compliance",
    "geometry": "link_geometry",
    "tool": "tool_shift",
}
"""Declared parameters -> the effect that would look like an error of theirs."""

UNLOADED = "pull the tip sideways with a known force"
"""For compliances that weight alone does not load enough to be seen."""

MOST_NAMES = 6
"""Parameters that one line of advice names."""


@dataclass(frozen=True)
class Blind:
    """A parameter of which no tip reading tells anything.

    Attributes:
        name: Block and label.
        moves: What one standard deviation of it moves a reading by at most [m].
        partners: Parameters that it can be exchanged for without the readings noticing; empty where it moves them too
            little to be seen beside the noise.
        instead: What would tell.
    """

    name: str
    moves: float
    partners: tuple[str, ...]
    instead: str


def blind_spots(model: Model, rows: Array, sigma: float) -> tuple[Blind, ...]:
    """Return the parameters that stay as uncertain as [prior] has them though all of (N, 3, P) rows were measured."""
    seen = np.tensordot(rows, rows, axes=([0, 1], [0, 1]))
    whole = model.known.with_rows(rows)
    left = model.std(whole) > UNDETERMINED * model.prior
    most = np.sqrt((rows**2).sum(axis=1)).max(axis=0)
    asked = np.repeat([_is_asked(block) for block in model.blocks], [len(block.parameters) for block in model.blocks])
    return tuple(_blind(model, seen, whole, int(i), float(most[i] * sigma)) for i in np.flatnonzero(asked & left))


def _is_asked(block: Block) -> bool:
    """Return whether a block is of the arm: neither where the instrument stands nor what is in question."""
    return block.kind not in FRAMES and not isinstance(block, Suspect)


def _blind(model: Model, seen: Array, whole: LinearGaussian, place: int, moves: float) -> Blind:
    name = model.names[place]
    faint = seen[place, place] < 1.0
    partners = () if faint else partners_of(seen, whole, place, model.names)
    block, _, label = name.partition(" ")
    law = label.split(" ")[0] if block == "effect" else AS_EFFECT.get(block, block)
    instead = UNLOADED if faint and AS_EFFECT.get(block) == "compliance" else INSTEAD.get(law, ON_THE_LINK)
    return Blind(name, moves, partners, instead)


def in_words(blind: Sequence[Blind]) -> tuple[str, ...]:
    """Return one line for all parameters that the same measurement would tell."""
    told = []
    for instead in dict.fromkeys(one.instead for one in blind):
        names = [one.name for one in blind if one.instead == instead]
        more = f", and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
        told.append(f"No tip reading tells {', '.join(names[:MOST_NAMES])}{more}; {_why(blind, instead)}, {instead}.")
    return tuple(told)


def _why(blind: Sequence[Blind], instead: str) -> str:
    if instead != UNLOADED:
        return "instead"
    most = max(one.moves for one in blind if one.instead == UNLOADED)
    return f"under weight alone each moves the tip by {most * 1e3:.1g} mm at most; where it matters"
