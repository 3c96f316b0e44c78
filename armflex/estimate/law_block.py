"""The parameters of laws that are learned on the whole arm, as a block of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.view import View
from armflex.laws import Law
from armflex.laws.flexure import Flexure
from armflex.laws.learned import LearnedLaw, Seen, learned_law, seen_in
from armflex.parameters import ArmParameter, of_law
from armflex.setup import Setup


@dataclass(frozen=True, eq=False)
class LawBlock(Block):
    """Values of all learned laws.

    Attributes:
        flexures: Their names.
        laws: The laws at the values where learning starts.
    """

    flexures: tuple[str, ...]
    laws: tuple[LearnedLaw, ...]

    @property
    def curved(self) -> bool:
        """That a learned law is: no tenth of its values is a straight line."""
        return True

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """Parts of what was declared."""
        pairs = zip(self.flexures, self.laws, strict=True)
        return tuple(one for name, law in pairs for one in of_law(name, law))

    @property
    def prior(self) -> Array:
        """By groups."""
        return np.concatenate([law.prior for law in self.laws])

    @property
    def start(self) -> Array:
        """(k,) values where learning starts."""
        return np.concatenate([law.values for law in self.laws])

    def columns(self, view: View) -> Array:
        """Return the laws' derivatives through the tip's answer to each flexure's twist."""
        names, columns = view.setup.arm.flexure_names, []
        for name in self.flexures:
            index = names.index(name)
            law = view.setup.arm.flexures[index].learned
            assert law is not None
            columns.append(
                view.line.laws[:, :, index] @ law.by_values(view.line.flexure_wrenches[:, index], view.line.row)
            )
        return view.answer(np.concatenate(columns, axis=2))

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the laws at (k,) values."""
        pairs = zip(self.flexures, self.split(values), strict=True)
        laws = {name: law.at(own) for (name, own), law in zip(pairs, self.laws, strict=True)}
        return replace(setup, arm=with_laws(setup.arm, laws))

    def stepped(self, setup: Setup, step: Array) -> Setup:
        """Return the setup with every law a step away."""
        pairs = zip(self.flexures, self.laws, self.split(step), strict=True)
        return replace(setup, arm=with_laws(setup.arm, {name: law.moved(own) for name, law, own in pairs}))

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        """Return every law's part of (k,) values."""
        return np.split(values, np.cumsum([len(law.values) for law in self.laws])[:-1])


def learned_laws(arm: Arm) -> dict[str, LearnedLaw]:
    """Return the learned laws of an arm by flexure."""
    return {flexure.name: flexure.learned for flexure in arm.flexures if flexure.learned}


def with_laws(arm: Arm, laws: dict[str, LearnedLaw]) -> Arm:
    """Return the arm with other laws at some flexures."""
    changed = [replace(f, law=laws[f.name]) if f.name in laws else f for f in arm.flexures]
    return replace(arm, flexures=tuple(changed))


def law_block(setup: Setup, rows: View, seen: Mapping[str, Seen] | None = None) -> LawBlock | None:
    """Return the block of everything that is to be learned, None where nothing is.

    `rows` shows the loads, unless `seen` has those of every flexure.
    """
    free = [(i, flexure) for i, flexure in enumerate(setup.arm.flexures) if flexure.learn is not None]
    if not free:
        return None
    laws = [start_law(flexure, seen[flexure.name] if seen else _seen(flexure, i, rows)) for i, flexure in free]
    return LawBlock(tuple(flexure.name for _, flexure in free), tuple(laws))


def start_law(flexure: Flexure, seen: Seen) -> LearnedLaw:
    """Return the law of a flexure with its parameters, as it was declared, also where it was learned before."""
    assert flexure.learn is not None
    return learned_law(_declared(flexure), flexure.learn, seen)


def _declared(flexure: Flexure) -> Law:
    return flexure.learned.declared if flexure.learned else flexure.law


def _seen(flexure: Flexure, index: int, rows: View) -> Seen:
    return seen_in(_declared(flexure), rows.line.flexure_wrenches[:, index], rows.line.row)
