"""A correction by named terms of the load: even ones (contacts), odd ones (stiffening), mixed ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.laws.law import Row
from armflex.laws.learned.correcting import Correcting
from armflex.laws.learned.part import Group

FORMS = ("|{}|", "{}|{}|", "{}^2", "{}^3")
"""Terms of one component."""

START = 0.3
"""Where the search for the size of all terms together starts, as a part of the declared law's own twist."""


@dataclass(frozen=True, eq=False)
class PolynomialPart(Correcting):
    """Terms |z|, z|z|, z^2, z^3 of every component z = load / scale that counts, products of two, radial loads.

    Attributes, beside those of `Correcting`:
        linear: Whether z is among the terms, where no compliance is learned beside them.
    """

    linear: bool = False

    @property
    def groups(self) -> tuple[Group, ...]:
        """One: beforehand all terms are of one size, in parts of the twist of their axis."""
        names = [WRENCH_NAMES[i] for i in self.components]
        kinds = ("{}", *FORMS) if self.linear else FORMS
        terms = [form.format(name, name) for form in kinds for name in names]
        terms += [f"{names[i]}*{names[j]}" for i, j in self._pairs] + [f"radial_{names[i][0]}" for i, _ in self._radial]
        axes = [TWIST_NAMES[axis] for axis in self.axes]
        labels = tuple(f"{axis}:{term}" for axis in axes for term in terms)
        return (Group("terms", labels, START / np.sqrt(len(terms)), True),) if labels else ()

    @property
    def start(self) -> Array:
        """Zero: no correction."""
        return np.zeros(sum(len(group.labels) for group in self.groups))

    def twist(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the twist."""
        z, gains = self.scaled(wrench), self._gains(values)
        size = np.abs(z)
        twist = (gains.steep(z, size, 1.0, 1.0) @ z[..., None])[..., 0] + size @ gains.size.T
        return twist + self._lengths(z) @ gains.radial.T if self._radial else twist

    def tangent(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the derivative by the wrench."""
        z, gains = self.scaled(wrench), self._gains(values)
        slopes = gains.steep(z, np.abs(z), 2.0, 3.0) + gains.size * np.sign(z)[..., None, :]
        if self._radial:
            slopes = slopes + gains.radial @ self._radial_slopes(z)
        whole = np.zeros((*wrench.shape[:-1], 6, 6))
        whole[..., self.components] = slopes / self.typical
        return whole

    def by_values(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the derivative by the values."""
        terms = self._terms(wrench)
        return np.einsum("...p,ab->...abp", terms, self.spread).reshape(*wrench.shape[:-1], 6, -1)

    def _terms(self, wrench: Array) -> Array:
        z = self.scaled(wrench)
        first, second = self._pair_columns
        straight = [z] if self.linear else []
        alone = [np.abs(z), z * np.abs(z), z**2, z**3]
        return np.concatenate([*straight, *alone, z[..., first] * z[..., second], self._lengths(z)], axis=-1)

    def _lengths(self, z: Array) -> Array:
        """Return the (..., r) radial loads."""
        first, second = self._radial_columns
        return np.hypot(z[..., first], z[..., second])

    def _radial_slopes(self, z: Array) -> Array:
        """Return their (..., r, c) derivative by z, zero where there is no load."""
        first, second = self._radial_columns
        own, length = np.eye(len(self.components)), self._lengths(z)[..., None]
        sides = z[..., first, None] * own[first] + z[..., second, None] * own[second]
        return sides / np.where(length > 0.0, length, 1.0)

    def _gains(self, values: Array) -> _Gains:
        """Return the twist per term; a law asks for many loads at the same values."""
        key = values.tobytes()
        if key not in self._known:
            self._known.clear()
            self._known[key] = self._made(values)
        return self._known[key]

    def _made(self, values: Array) -> _Gains:
        count, pairs = len(self.components), len(self._pairs)
        twists = self.spread @ values.reshape(len(self.axes), -1)
        if not self.linear:
            twists = np.hstack([np.zeros((6, count)), twists])
        ends = np.cumsum([count, count, count, count, count, pairs])
        straight, size, turned, squares, cubes, products, radial = np.split(twists, ends, axis=1)
        forms = np.zeros((count, 6, count))
        forms[np.arange(count), :, np.arange(count)] = squares.T
        first, second = self._pair_columns
        forms[first, :, second] = forms[second, :, first] = 0.5 * products.T
        return _Gains(straight, size, turned, forms.reshape(count, -1), cubes, radial)

    @cached_property
    def _known(self) -> dict[bytes, _Gains]:
        """The gains at the last values."""
        return {}

    @cached_property
    def _pairs(self) -> list[tuple[int, int]]:
        count = len(self.components)
        return [(i, j) for i in range(count) for j in range(i + 1, count)]

    @cached_property
    def _radial(self) -> list[tuple[int, int]]:
        """Places of x and y of the force, and of the moment, where both count."""
        known = list(self.components)
        return [(known.index(x), known.index(x + 1)) for x in (0, 3) if {x, x + 1} <= set(known)]

    @cached_property
    def _pair_columns(self) -> tuple[np.ndarray, np.ndarray]:
        return _columns(self._pairs)

    @cached_property
    def _radial_columns(self) -> tuple[np.ndarray, np.ndarray]:
        return _columns(self._radial)


@dataclass(frozen=True, eq=False)
class _Gains:
    """Twist per term of c components z, (6, c) but where it is said: z, |z|, z|z|, squares and products, z^3, lengths.

    `forms` is (c, 6 c): a symmetric matrix for every axis.
    """

    straight: Array
    size: Array
    turned: Array
    forms: Array
    cubes: Array
    radial: Array

    def steep(self, z: Array, size: Array, second: float, third: float) -> Array:
        """Return the (..., 6, c) matrix that z is multiplied with, powers beyond the first weighed as is said."""
        curved = (z @ self.forms).reshape(*z.shape[:-1], *self.size.shape) + self.turned * size[..., None, :]
        return self.straight + second * curved + (third * self.cubes) * (z * z)[..., None, :]


def _columns(pairs: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the second of every pair."""
    first, second = np.array(pairs, dtype=int).reshape(-1, 2).T
    return first, second
