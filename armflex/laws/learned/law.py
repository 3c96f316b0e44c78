"""A law learned on the whole arm: what was declared, with parameters, and a correction at the loads that were seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.laws.joint.linear import LinearLaw
from armflex.laws.law import Law, Row, WithoutParameters, beyond
from armflex.laws.learned.correction import Correction, fading
from armflex.laws.learned.linearised import Linearised, moved
from armflex.laws.learned.part import Group, Part
from armflex.laws.learned.seen import Seen
from armflex.laws.learned.window import Window
from armflex.laws.parameter import Parameter

SLACK = 0.02
"""Of the range of a load, by which it may be beyond those seen: a campaign's loads are those of the arm as it bends."""


@dataclass(frozen=True, eq=False)
class LearnedLaw(Law):
    """The sum of parts at values of their parameters.

    Attributes:
        declared: The law that it is learned about.
        plain: The part that holds under every load.
        correction: The part that counts within the window alone, None for none.
        seen: The loads that it was learned under.
        values: (k,) values of both parts' parameters, the plain one's first.
        scales: Prior standard deviation of every group of parameters.
        spread: (k, k) covariance of the values, None where nobody says.
        reach: (6,) how large a correction may be at the loads seen, its doubt included [m, rad]; None for none.
        faded: Reach, see `Window`, from which on a correction is nothing; infinite while it is being learned.
        energy: (6, 6) matrix of the reach, None where distance is the reach.
        about: (6, 6) covariance of the declared law's scatter about what its parameters say, None for none.
    """

    declared: Law
    plain: Part
    correction: Part | None
    seen: Seen
    values: Array
    scales: tuple[float, ...]
    spread: Array | None = None
    reach: Array | None = None
    faded: float = np.inf
    energy: Array | None = None
    about: Array | None = None

    @cached_property
    def window(self) -> Window:
        """Where the correction counts."""
        return self.seen.window(self.faded, self.energy)

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """The parameters of both parts, with the scale that each group has now."""
        return tuple(replace(group, std=std) for group, std in zip(self.expected, self.scales, strict=True))

    @cached_property
    def expected(self) -> tuple[Group, ...]:
        """The same with the scale that was expected beforehand."""
        return (*self.plain.groups, *(self.correction.groups if self.correction else ()))

    @property
    def labels(self) -> tuple[str, ...]:
        """One name per parameter."""
        return tuple(label for group in self.groups for label in group.labels)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Without dimension, as they are expected now."""
        return tuple(Parameter(name, "1", std) for name, std in zip(self.labels, self.prior.tolist(), strict=True))

    @property
    def prior(self) -> Array:
        """(k,) prior standard deviations about zero."""
        return _stds(self.groups)

    @property
    def expected_std(self) -> Array:
        """(k,) the same as expected beforehand."""
        return _stds(self.expected)

    @property
    def start(self) -> Array:
        """(k,) values where learning starts: the law as declared."""
        return np.concatenate([self.plain.start, self.correction.start if self.correction else np.zeros(0)])

    def correcting(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6) twist that the correction adds."""
        return self._corrected.twist(wrench, row) if self.correction else np.zeros_like(wrench)

    def std(self, spread: Array, wrench: Array, row: Row) -> Array:
        """Return the (..., 6) standard deviation of the twist for a (k, k) covariance of the values."""
        by = self.by_values(wrench, row)
        return np.sqrt(np.maximum(np.einsum("...ak,kl,...al->...a", by, spread, by, optimize=True), 0.0))

    def at(self, values: Array) -> LearnedLaw:
        """Return the law at other values."""
        return replace(self, values=values, spread=None)

    def without_correction(self) -> LearnedLaw:
        """Return the plain part alone."""
        plain, count = self._split[0], len(self.plain.groups)
        return replace(self, correction=None, values=plain, scales=self.scales[:count], spread=None, reach=None)

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the twist."""
        twist = self._base.twist(wrench, row)
        return twist if self.correction is None else twist + self.correcting(wrench, row)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the derivative by the wrench."""
        tangent = np.broadcast_to(self._base.tangent(wrench, row), (*wrench.shape[:-1], 6, 6))
        return tangent if self.correction is None else tangent + self._corrected.tangent(wrench, row)

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the (..., 6, k) derivative of the twist by the values."""
        plain, own = self._split
        by_plain = self.plain.by_values(plain, wrench, row)
        if self.correction is None:
            return by_plain
        window = self.window
        by_own = self.correction.by_values(own, window.drawn_in(wrench), row) * window.weight(wrench)[..., None, None]
        return np.concatenate([np.broadcast_to(by_plain, (*by_own.shape[:-1], by_plain.shape[-1])), by_own], axis=-1)

    @property
    def values_covariance(self) -> Array | None:
        """As the campaign left it."""
        return self.spread

    def scatter(self, wrench: Array, row: Row) -> Array | None:
        """Return the declared law's scatter, and beyond the loads what may be left of a correction.

        Beyond the loads seen a correction may be as large as it was among them, and grow with the load.
        """
        found = self.about
        if self.reach is not None:
            std = self.window.unknown(wrench)[..., None] * self.reach
            unknown = std[..., None] ** 2 * np.eye(6)
            found = unknown if found is None else found + unknown
        return found

    def certain(self) -> LearnedLaw:
        """Return the law with its values taken as known."""
        return replace(self, spread=None)

    def settled(self, spread: Array, wrenches: Array, row: Row) -> LearnedLaw:
        """Return the law with the (k, k) covariance of its values, fitted where its loads were (M, 6) wrenches."""
        loads = np.array([wrenches.min(axis=0), wrenches.max(axis=0)])
        if self.correction is None:
            return replace(self, spread=spread, seen=replace(self.seen, loads=loads))
        sizes = self.correction.twist(self._split[1], wrenches, row)
        by, start = self.correction.by_values(self._split[1], wrenches, row), len(self.plain.start)
        doubt = np.einsum("nak,kl,nal->na", by, spread[start:, start:], by, optimize=True)
        reach = np.sqrt((sizes**2 + doubt).max(axis=0))
        faded, energy = fading(self._base, self._corrected, wrenches, row)
        found = {"reach": reach, "faded": faded, "energy": energy}
        return replace(self, spread=spread, seen=replace(self.seen, loads=loads), **found)

    def moved(self, step: Array) -> LearnedLaw:
        """Return the law whose twist is that of a (k,) step of its values away, to first order in the values."""
        (values, own), count = self._split, len(self.plain.start)
        plain, values = moved(self.plain, values, step[:count])
        correction = None if self.correction is None else Linearised(self.correction, own)
        there = np.concatenate([values, own + step[count:]])
        return replace(self, plain=plain, correction=correction, values=there, spread=None)

    @property
    def parts(self) -> tuple[Law, ...]:
        """The plain part as a law that solvers know, and the correction."""
        if self._known is None:
            return (self,)
        return (self._known,) if self.correction is None else (self._known, self._corrected)

    @cached_property
    def _known(self) -> Law | None:
        """The plain part as a law that solvers know."""
        return self.plain.law(self._split[0])

    @cached_property
    def _base(self) -> Law:
        """The plain part as a law."""
        return self._known or Plain(self.plain, self._split[0])

    @cached_property
    def constant(self) -> Array | None:
        """(6, 6) compliance where the law is nothing else, None where it is."""
        known = self.parts
        return known[0].compliance if len(known) == 1 and isinstance(known[0], LinearLaw) else None

    @cached_property
    def _corrected(self) -> Correction:
        assert self.correction is not None
        return Correction(self.correction, self._split[1], self.window)

    @cached_property
    def _split(self) -> tuple[Array, Array]:
        """Values of the plain part and of the correction."""
        count = len(self.plain.start)
        return self.values[:count], self.values[count:]

    @property
    def trained_on(self) -> Array:
        """The loads seen."""
        return self.window.loads

    def doubts(self, wrench: Array, row: Row) -> tuple[Flag, ...]:
        """Return a flag for every component of the load beyond those seen, by more than anybody knows them."""
        low, high = self.window.loads
        return beyond(np.array([low, high]) + SLACK * (high - low) * np.array([[-1.0], [1.0]]), wrench)


def _stds(groups: Sequence[Group]) -> Array:
    """Return the (k,) standard deviations of the parameters of groups."""
    return np.concatenate([np.zeros(0), *(np.full(len(group.labels), group.std) for group in groups)])


@dataclass(frozen=True, eq=False)
class Plain(WithoutParameters):
    """A part at values of its parameters."""

    part: Part
    point: Array

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the part's twist."""
        return self.part.twist(self.point, wrench, row)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the part's tangent."""
        return self.part.tangent(self.point, wrench, row)
