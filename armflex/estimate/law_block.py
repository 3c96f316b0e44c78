"""The parameters of flexures' laws as a block of a fit: what is learned of them, or factors on what they give."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Arm, Setup
from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.view import View
from armflex.laws import Law
from armflex.laws.declared import Flexure
from armflex.laws.joint.carried import ScaledLaw, scaled
from armflex.laws.law import split
from armflex.laws.learned import LearnedLaw, Seen, learned_law, seen_in
from armflex.parameters import ArmParameter, ParameterKind, of_law


@dataclass(frozen=True, eq=False)
class LawsBlock(Block):
    """Values of the laws of some flexures.

    Attributes:
        flexures: Their names.
        laws: The laws at the values where a fit starts.
    """

    flexures: tuple[str, ...]
    laws: tuple[Law, ...]
    curved = True

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        kind = ParameterKind.COMPLIANCE if self.logarithmic else ParameterKind.LAW
        pairs = zip(self.flexures, self.laws, strict=True)
        return tuple(one for name, law in pairs for one in of_law(name, law, kind))

    @property
    def prior(self) -> Array:
        return np.array([one.prior for law in self.laws for one in law.parameters])

    @property
    def start(self) -> Array:
        return np.concatenate([law.values for law in self.laws])

    def jacobian(self, view: View) -> Array:
        """Return the columns of every value, through the laws' answer; effects add nothing to them."""
        line, names, jacobian = view.line, view.setup.arm.flexure_names, []
        for place, name in enumerate(self.flexures):
            index = names.index(name)
            free = self._free(place, view.setup.arm.flexures[index].law)
            jacobian.append((index, free.by_values(line.flexure_wrenches[:, index], line.row)))
        return view.answer(
            lambda one: np.concatenate([one.laws[:, :, index] @ twist for index, twist in jacobian], axis=2)
        )

    def apply(self, setup: Setup, values: Array) -> Setup:
        return self._with(setup, [law.at(own) for law, own in zip(self.laws, self.split(values), strict=True)])

    def stepped(self, setup: Setup, step: Array) -> Setup:
        return self._with(setup, [law.moved(own) for law, own in zip(self.laws, self.split(step), strict=True)])

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        """Return every law's part of (k,) values."""
        return split(self.laws, values)

    @abstractmethod
    def _free(self, place: int, law: Law) -> Law:
        """Return the law that a flexure has with the parameters of one of the block's."""

    @abstractmethod
    def _with(self, setup: Setup, laws: Sequence[Law]) -> Setup:
        """Return the setup with what the block's laws are now."""


@dataclass(frozen=True, eq=False)
class LawBlock(LawsBlock):
    """Values of all learned laws."""

    laws: tuple[LearnedLaw, ...]

    def _free(self, place: int, law: Law) -> Law:
        return law

    def _with(self, setup: Setup, laws: Sequence[Law]) -> Setup:
        return replace(setup, arm=with_laws(setup.arm, dict(zip(self.flexures, laws, strict=True))))


@dataclass(frozen=True, eq=False)
class FactorBlock(LawsBlock):
    """Logarithmic factors on some axes of what flexures' own laws give: C becomes S C S; see `joint.carried`."""

    laws: tuple[ScaledLaw, ...]
    logarithmic = True

    def _free(self, place: int, law: Law) -> Law:
        return self.laws[place].with_laws((law,))

    def _with(self, setup: Setup, laws: Sequence[ScaledLaw]) -> Setup:
        arm, steps = setup.arm, {name: law.logarithms for name, law in zip(self.flexures, laws, strict=True)}
        own = {one.name: scaled(one.law, np.exp(0.5 * steps[one.name])) for one in arm.flexures if one.name in steps}
        factors = {name: arm.factors.get(name, np.zeros(6)) + step for name, step in steps.items()}
        return replace(setup, arm=replace(with_laws(arm, own), factors={**arm.factors, **factors}))


def learned_laws(arm: Arm) -> dict[str, LearnedLaw]:
    """Return the learned laws of an arm by flexure."""
    return {flexure.name: flexure.learned for flexure in arm.flexures if flexure.learned}


def with_laws(arm: Arm, laws: Mapping[str, Law]) -> Arm:
    """Return the arm with other laws at some flexures."""
    changed = [replace(f, law=laws[f.name]) if f.name in laws else f for f in arm.flexures]
    return replace(arm, flexures=tuple(changed))


def factor_block(arm: Arm, axes: Mapping[str, tuple[int, ...]], std: float = 0.0) -> FactorBlock:
    """Return the block of factors on some axes of flexures' compliances."""
    laws = {flexure.name: flexure.law for flexure in arm.flexures}
    return FactorBlock(tuple(axes), tuple(ScaledLaw(laws[name], np.zeros(6), own, std) for name, own in axes.items()))


def law_block(setup: Setup, rows: View, seen: Mapping[str, Seen] | None = None) -> LawBlock | None:
    """Return the block of everything that is to be learned, as it was declared, None where nothing is.

    `rows` shows the loads, unless `seen` has those of every flexure.
    """

    def start(flexure: Flexure, index: int) -> LearnedLaw:
        assert flexure.learn is not None
        declared = flexure.learned.declared if flexure.learned else flexure.law
        loads = seen[flexure.name] if seen else seen_in(declared, rows.line.flexure_wrenches[:, index], rows.line.row)
        return learned_law(declared, flexure.learn, loads)

    laws = {one.name: start(one, i) for i, one in enumerate(setup.arm.flexures) if one.learn is not None}
    return LawBlock(tuple(laws), tuple(laws.values())) if laws else None
