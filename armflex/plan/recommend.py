"""What no tip reading can tell, and what would tell it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.identify import UNDETERMINED, partners_of
from armflex.laws.effects.compliance import COMPLIANCE
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.shapes import ON_THE_LINK
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import FRAMES
from armflex.plan.design_model import Model, Suspect


def instead(own: Effect, rival: Effect) -> str:
    """Return what tells two effects apart that move the tip alike."""
    told = dict.fromkeys(effect.law.instead for effect in (rival, own) if effect.law.instead)
    return ", or ".join(told) or "measure a second target between the places in question"


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
    block = next(block for block in model.blocks if place in model.place(block))
    law = block.looks_like
    instead = law.instead if law is not None and law.instead else ON_THE_LINK
    return Blind(name, moves, partners, UNLOADED if faint and block.kind in COMPLIANCE.stands_for else instead)


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
