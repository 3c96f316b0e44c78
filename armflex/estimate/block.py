"""What a fit may move: parameters that belong together, with what was known of them and what they do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from armflex.arm import Setup
from armflex.conventions import Array
from armflex.estimate.view import View
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import EffectLaw
from armflex.parameters import ArmParameter, ParameterKind


class Block(ABC):
    """Parameters that belong together."""

    logarithmic: bool = False
    """Whether a parameter is the logarithm of a factor: its column then changes as fast as what it stands for."""

    curved: bool = False
    """Whether readings change otherwise than in a straight line where a value moves by a tenth."""

    by_row: bool = True
    """Whether the columns of a row depend on that row alone."""

    parameters: tuple[ArmParameter, ...]
    """What they are."""

    prior: Array
    """(k,) standard deviations about zero; infinite where nothing is known."""

    @abstractmethod
    def jacobian(self, view: View) -> Array:
        """Return (M, d, k) changes of the readings per parameter at the view's setup."""

    @abstractmethod
    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with (k,) values added to the declared one."""

    @property
    def start(self) -> Array:
        """(k,) values of the arm as it is."""
        return np.zeros(len(self.parameters))

    def of_rows(self, context: Context | None) -> Block:
        """Return the block as it is asked about other rows, as effects see them."""
        return self

    def stepped(self, setup: Setup, step: Array) -> Setup:
        """Return the setup a (k,) step away, to first order in how the arm bends."""
        return self.apply(setup, step)

    @property
    def kind(self) -> ParameterKind:
        """What the parameters are of."""
        return self.parameters[0].group.kind

    @property
    def looks_like(self) -> EffectLaw | None:
        """The law of the catalogue that an error of it would look like, None where there is none."""
        return next((law for law in CATALOGUE.values() if self.kind in law.stands_for), None)

    @property
    def moves(self) -> bool:
        """Whether they move the tip, rather than what is read of it."""
        return self.parameters[0].group.moves

    @property
    def name(self) -> str:
        """Which part of the model it is, for people."""
        return self.parameters[0].group.block

    @property
    def labels(self) -> tuple[str, ...]:
        """What each parameter is called in it."""
        return tuple(parameter.rest for parameter in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """One unit per parameter."""
        return tuple(parameter.unit for parameter in self.parameters)


def places_of(block: Block, blocks: Sequence[Block]) -> np.ndarray:
    """Return the places of one block's parameters among those of all."""
    start = 0
    for other in blocks:
        if other is block:
            return np.arange(start, start + len(other.parameters))
        start += len(other.parameters)
    raise KeyError(block.name)


def parameters_of(blocks: Sequence[Block]) -> tuple[ArmParameter, ...]:
    """Return the parameters of all blocks in their order."""
    return tuple(parameter for block in blocks for parameter in block.parameters)
