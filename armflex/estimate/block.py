"""What a fit may move: parameters that belong together, with what was known of them and what they do.

Here are what every such block says, the block of an effect (its amplitudes, and those of its inner parameters that the
law is smooth in), and those of flexures' laws (what is learned of them, or factors on what they give).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Arm, Setup
from armflex.conventions import RESOLUTION, Array
from armflex.estimate.view import QUOTIENT_STEP, View
from armflex.laws import Law
from armflex.laws.declared import Flexure
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Effect, EffectLaw, Search, full
from armflex.laws.joint.carried import ScaledLaw, scaled
from armflex.laws.law import split
from armflex.laws.learned import LearnedLaw, Seen, learned_law, seen_in
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import ArmParameter, ParameterKind, of_effect, of_law


class Block(ABC):
    """Parameters that belong together."""

    logarithmic: bool = False
    """Whether a parameter is the logarithm of a factor: its column then changes as fast as what it stands for."""

    curved: bool = False
    """Whether readings are nonlinear in a value where a value moves by a tenth."""

    by_row: bool = True
    """Whether the columns of a row depend on that row alone."""

    parameters: tuple[ArmParameter, ...]
    """What they are."""

    prior: Array
    """(k,) standard deviations about zero; infinite where nothing is known."""

    def jacobian(self, view: View) -> Array:
        """Return (M, d, k) changes of the readings per parameter at the view's setup."""
        columns = self.columns(view)
        if not (view.indirect and self.moves):
            return columns
        here, sizes = self.at_setup(view.setup), self.steps
        setups = ((here.stepped(view.setup, step), size) for step, size in zip(np.diag(sizes), sizes, strict=True))
        return columns + view.quotients(self, setups)

    @abstractmethod
    def columns(self, view: View) -> Array:
        """Return the part of `jacobian` that is known by formula: by motions of links and by the instrument."""

    @property
    def steps(self) -> Array:
        """(k,) steps of difference quotients, where readings need them: small parts of what is likely."""
        likely = np.where(np.isfinite(self.prior), self.prior, 0.0) if len(self.prior) else np.zeros(len(self.start))
        usual = np.where(self.start != 0.0, np.abs(self.start), 1.0)
        return QUOTIENT_STEP * np.where(likely > 0.0, likely, usual)

    def at_setup(self, setup: Setup) -> Block:
        """Return the block with its start where a setup is that the block was applied to."""
        return self

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

    def resized(self, places: np.ndarray, values: Array, posterior: LinearGaussian) -> Block:
        """Return the block with a prior as wide as a fit says, where that is open: a step of EM.

        Args:
            places: (k,) of its parameters among the P of the fit.
            values: (P,) what the fit found.
            posterior: What is known of those.
        """
        return self

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


LOOSE_INNER = 2.0
"""Prior: standard deviation of the logarithm of an inner parameter about where its search ended."""


@dataclass(frozen=True, eq=False)
class EffectBlock(Block):
    """Free values of one effect.

    Attributes:
        effect: Where it starts; its fixed inner parameters stay as they are here.
        free: Which inner parameters move, from where they start; positive ones by the logarithm of a factor.
        context: The campaign; None where the block is only applied.
        ordinal: Place of the effect among the arm's.
        prior: (k,) standard deviations of its values about zero; see `amplitude_prior`.
        number: Which it is among the arm's effects of the same name, from 1 on; see `numbers_of`.
    """

    effect: Effect
    free: tuple[int, ...]
    context: Context | None
    ordinal: int
    prior: Array
    number: int = 1

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """Acting amplitudes, then free inner parameters."""
        every, terms = of_effect(self.effect, self.number), len(self.effect.location.terms)
        return (*every[:terms], *(every[terms + i] for i in self.free))

    @property
    def by_row(self) -> bool:
        """Whether it remembers nothing of the rows before."""
        return not self.effect.law.memory

    @property
    def start(self) -> Array:
        free = list(self.free)
        return np.concatenate([self.effect.acting, np.array(self.effect.inner)[free] - self._origin[free]])

    @property
    def _origin(self) -> Array:
        """Inner values that the free ones move from: as they are, or where a prior holds them."""
        inners = zip(self.effect.law.inner, self.effect.inner, strict=True)
        return np.array([value if inner.spread is None else inner.default for inner, value in inners], float)

    def at_setup(self, setup: Setup) -> EffectBlock:
        return replace(self, effect=setup.arm.effects[self.ordinal])

    def columns(self, view: View) -> Array:
        """Return (M, d, k): exact for amplitudes, central differences for inner parameters."""
        assert self.context is not None
        return effect_jacobian(view.setup.arm.effects[self.ordinal], self.free, view, self.context)

    def at(self, values: Array) -> Effect:
        """Return the effect at (k,) values of the block."""
        law, location = self.effect.law, self.effect.location
        amplitudes = full(values[: len(location.terms)], location, len(law.amplitudes))
        inner, origin = list(self.effect.inner), self._origin.tolist()
        for place, i in enumerate(self.free):
            inner[i] = law.inner[i].moved(origin[i], float(values[len(location.terms) + place]))
        return replace(self.effect, values=(*amplitudes, *inner))

    def apply(self, setup: Setup, values: Array) -> Setup:
        return setup.with_effect(self.at(values))

    @property
    def looks_like(self) -> EffectLaw:
        return self.effect.law

    def of_rows(self, context: Context | None) -> EffectBlock:
        return replace(self, context=context)

    def stepped(self, setup: Setup, step: Array) -> Setup:
        """Return the setup with the effect a step away, but for that by which it remembers: its state says that."""
        law, values = self.effect.law, self.start + step
        if law.memory:
            values = np.append(values[: len(self.effect.location.terms)], np.zeros(len(self.free)))
        effect, kept = self.at(values), list(setup.arm.effects)
        if law.changes_model:  # it has changed the arm, to which what is more of it is added
            more = np.subtract(effect.amplitudes, self.effect.amplitudes)
            setup = setup.with_effect(replace(effect, values=(*more.tolist(), *effect.inner)))
        kept[self.ordinal] = effect
        return replace(setup, arm=replace(setup.arm, effects=tuple(kept)))

    def std(self, values: Array, std: Array) -> dict[str, float]:
        """Return the standard uncertainty of each free value by name, logarithms turned back."""
        inner, law = self.at(values).inner, self.effect.law
        scale = [abs(inner[i]) if law.inner[i].positive else 1.0 for i in self.free]
        scales = [*(1.0 for _ in self.effect.location.terms), *scale]
        return {label: float(size) * unit for label, size, unit in zip(self.labels, std, scales, strict=True)}


def effect_jacobian(effect: Effect, free: tuple[int, ...], view: View, context: Context) -> Array:
    """Return (M, d, k) changes of the readings: exact per amplitude, central differences per free inner parameter."""
    law, jacobian = effect.law, [view.effect_jacobian(effect, context)]
    for i in free:
        step = QUOTIENT_STEP if law.inner[i].positive else QUOTIENT_STEP * max(abs(effect.inner[i]), QUOTIENT_STEP)
        ends = []
        for side in (1.0, -1.0):
            moved = list(effect.inner)
            moved[i] = law.inner[i].moved(effect.inner[i], side * step)
            ends.append(
                view.effect_jacobian(replace(effect, values=(*effect.amplitudes, *moved)), context) @ effect.acting
            )
        jacobian.append(((ends[0] - ends[1]) / (2.0 * step))[:, :, None])
    return np.concatenate(jacobian, axis=2)


def amplitude_prior(effect: Effect, free: tuple[int, ...], view: View, context: Context) -> Array:
    """Return (k,) prior standard deviations: amplitudes that move the tip by `View.largest_motion`, inner ones loosely.

    What pulls towards a point is no farther from where its search ended than the arm reaches.
    """
    jacobian = view.effect_jacobian(effect, context)
    moved = np.array([view.rms(column) for column in jacobian.transpose(2, 0, 1)]) / view.per_metre
    # What moves nothing stays at zero rather than wander off.
    amplitudes = np.where(moved > 0.0, view.largest_motion / np.where(moved > 0.0, moved, 1.0), RESOLUTION)
    amplitudes = np.minimum(amplitudes, [effect.law.amplitudes[i].most for i in effect.location.terms])
    far = context.size if effect.law.search is Search.SPACE else np.inf
    searched = [
        inner.spread or (LOOSE_INNER if inner.positive else far) for inner in map(effect.law.inner.__getitem__, free)
    ]
    return np.concatenate([amplitudes, searched])


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
        return tuple(parameter for name, law in pairs for parameter in of_law(name, law, kind))

    @property
    def prior(self) -> Array:
        return np.array([parameter.prior for law in self.laws for parameter in law.parameters])

    @property
    def start(self) -> Array:
        return np.concatenate([law.values for law in self.laws])

    def columns(self, view: View) -> Array:
        """Return the columns of every value, through the laws' answer; effects add nothing to them."""
        line, names, jacobian = view.line, view.setup.arm.flexure_names, []
        for place, name in enumerate(self.flexures):
            index = names.index(name)
            free = self._free(place, view.setup.arm.flexures[index].law)
            jacobian.append((index, free.by_values(line.flexure_wrenches[:, index], line.row)))
        return view.answer(
            lambda line: np.concatenate([line.laws[:, :, index] @ twist for index, twist in jacobian], axis=2)
        )

    def apply(self, setup: Setup, values: Array) -> Setup:
        return self._with(setup, [law.at(part) for law, part in zip(self.laws, self.split(values), strict=True)])

    def stepped(self, setup: Setup, step: Array) -> Setup:
        return self._with(setup, [law.moved(part) for law, part in zip(self.laws, self.split(step), strict=True)])

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

    def at_setup(self, setup: Setup) -> LawBlock:
        laws = learned_laws(setup.arm)
        return replace(self, laws=tuple(laws[name] for name in self.flexures))

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
        laws_after = {
            flexure.name: scaled(flexure.law, np.exp(0.5 * steps[flexure.name]))
            for flexure in arm.flexures
            if flexure.name in steps
        }
        factors = {name: arm.factors.get(name, np.zeros(6)) + step for name, step in steps.items()}
        return replace(setup, arm=replace(with_laws(arm, laws_after), factors={**arm.factors, **factors}))


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
    return FactorBlock(tuple(axes), tuple(ScaledLaw(laws[name], np.zeros(6), free, std) for name, free in axes.items()))


def law_block(setup: Setup, rows: View, seen: Mapping[str, Seen] | None = None) -> LawBlock | None:
    """Return the block of everything that is to be learned, as it was declared, None where nothing is.

    `rows` shows the loads, unless `seen` has those of every flexure.
    """

    def start(flexure: Flexure, index: int) -> LearnedLaw:
        assert flexure.learn is not None
        declared = flexure.learned.declared if flexure.learned else flexure.law
        loads = seen[flexure.name] if seen else seen_in(declared, rows.line.flexure_wrenches[:, index], rows.line.row)
        return learned_law(declared, flexure.learn, loads)

    laws = {
        flexure.name: start(flexure, i) for i, flexure in enumerate(setup.arm.flexures) if flexure.learn is not None
    }
    return LawBlock(tuple(laws), tuple(laws.values())) if laws else None
