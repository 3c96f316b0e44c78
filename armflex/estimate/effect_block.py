"""An effect as a block of a fit: its amplitudes, and those of its inner parameters that the law is smooth in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Setup
from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.view import View
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Effect, EffectLaw, full
from armflex.parameters import ArmParameter, of_effect

LARGEST_MOTION = 0.03
"""RMS of the tip's motion that is expected of a missing effect at most, by how far the arm reaches: one standard
deviation. An axis that is off by two degrees somebody sees."""

LOOSE = 2.0
"""Prior standard deviation of the logarithm of an inner parameter about where its search ended."""

STEP = 1e-4
"""Step of numerical derivatives by inner parameters: relative for positive ones, of their size for others."""


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
    def _origin(self) -> Array:
        """Inner values that the free ones move from: as they are, or where a prior holds them."""
        inners = zip(self.effect.law.inner, self.effect.inner, strict=True)
        return np.array([value if one.spread is None else one.default for one, value in inners], float)

    @property
    def start(self) -> Array:
        moved = np.array(self.effect.inner) - self._origin
        return np.concatenate([self.effect.acting, moved[list(self.free)]])

    def jacobian(self, view: View) -> Array:
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
        """Return the setup with the effect a step away, but for that by which it remembers: its state tells."""
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
    location, law = effect.location, effect.law
    jacobian = [view.effect_jacobian(effect, context)]
    for i in free:
        step = STEP if law.inner[i].positive else STEP * max(abs(effect.inner[i]), 1e-2)
        ends = []
        for side in (1.0, -1.0):
            moved = list(effect.inner)
            moved[i] = law.inner[i].moved(effect.inner[i], side * step)
            ends.append(view.jacobian(law, location, tuple(moved), context) @ effect.acting)
        jacobian.append(((ends[0] - ends[1]) / (2.0 * step))[:, :, None])
    return np.concatenate(jacobian, axis=2)


def largest_motion(view: View) -> float:
    """Return the RMS of the tip's motion that is expected of a missing effect at most [m]; see `LARGEST_MOTION`."""
    return LARGEST_MOTION * float(np.linalg.norm(view.line.tip[:, :3, 3], axis=1).max())


def amplitude_prior(effect: Effect, free: tuple[int, ...], view: View, context: Context) -> Array:
    """Return (k,) prior standard deviations: amplitudes that move the tip by `largest_motion`, inner ones loosely."""
    jacobian = view.effect_jacobian(effect, context)
    moved = np.array([view.rms(one) for one in jacobian.transpose(2, 0, 1)])
    # What moves nothing stays at zero rather than wander off.
    amplitudes = np.where(moved > 0.0, largest_motion(view) / np.where(moved > 0.0, moved, 1.0), 1e-12)
    amplitudes = np.minimum(amplitudes, [effect.law.amplitudes[i].most for i in effect.location.terms])
    searched = [one.spread or (LOOSE if one.positive else np.inf) for one in map(effect.law.inner.__getitem__, free)]
    return np.concatenate([amplitudes, searched])
