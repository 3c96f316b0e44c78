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
        z = wrench * self._inverse
        size = np.abs(z)
        products = (z[..., :, None] * z[..., None, :]).reshape(*z.shape[:-1], 36)
        lengths = np.hypot(z[..., 0::3], z[..., 1::3])
        terms = np.concatenate([z, size, z * size, z * size * size, products, lengths], axis=-1)
        return terms @ self._gains(values).twists

    def tangent(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the derivative by the wrench."""
        z = wrench * self._inverse
        lengths = np.hypot(z[..., 0::3], z[..., 1::3])[..., None]
        sides = z.reshape(*z.shape[:-1], 2, 3)[..., :2] / np.where(lengths > 0.0, lengths, 1.0)
        one, sides = np.ones_like(z[..., :1]), sides.reshape(*z.shape[:-1], 4)
        slopes = np.concatenate([one, np.sign(z), np.abs(z), z, z * z, sides], axis=-1)
        return (slopes @ self._gains(values).tangents).reshape(*z.shape[:-1], 6, 6)

    def by_values(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the derivative by the values."""
        terms = self._terms(wrench)
        return np.einsum("...p,ab->...abp", terms, self.spread).reshape(*wrench.shape[:-1], 6, -1)

    def _terms(self, wrench: Array) -> Array:
        z = self.scaled(wrench)
        (first, second), (x, y) = self._pair_columns, self._radial_columns
        straight = [z] if self.linear else []
        alone = [np.abs(z), z * np.abs(z), z**2, z**3]
        products, lengths = z[..., first] * z[..., second], np.hypot(z[..., x], z[..., y])
        return np.concatenate([*straight, *alone, products, lengths], axis=-1)

    @cached_property
    def _inverse(self) -> Array:
        """(6,) what a load is multiplied with, zero for components that do not count."""
        inverse = np.zeros(6)
        inverse[list(self.components)] = 1.0 / self.typical
        return inverse

    def _gains(self, values: Array) -> _Gains:
        """Return the twist per term; a law asks for many loads at the same values."""
        key = values.tobytes()
        if key not in self._known:
            self._known.clear()
            self._known[key] = self._made(values)
        return self._known[key]

    def _made(self, values: Array) -> _Gains:
        twists, known, count = self.spread @ values.reshape(len(self.axes), -1), list(self.components), len(self._pairs)
        alone = np.zeros((5, 6, 6))  # z, |z|, z|z|, z^2, z^3; axis, component
        size = (len(FORMS) + self.linear) * len(known)
        alone[-len(FORMS) - self.linear :, :, known] = twists[:, :size].reshape(6, -1, len(known)).swapaxes(0, 1)
        forms, radial = np.zeros((6, 6, 6)), np.zeros((6, 2))  # component, component, axis
        forms[range(6), range(6)] = alone[3].T
        for (i, j), twist in zip(self._pairs, 0.5 * twists[:, size : size + count].T, strict=True):
            forms[known[i], known[j]] = forms[known[j], known[i]] = twist
        for (i, _), twist in zip(self._radial, twists[:, size + count :].T, strict=True):
            radial[:, known[i] // 3] = twist
        return _gains_of(alone, forms, radial, self._inverse)

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
    """All terms of six components z at once, so that a load costs a product.

    Attributes:
        twists: (62, 6) twist per z, |z|, z|z|, z^3, product of two, radial load.
        tangents: (29, 36) derivative of the twist by the load per 1, sign z, |z|, z, z^2, direction of a radial load.
    """

    twists: Array
    tangents: Array


def _gains_of(alone: Array, forms: Array, radial: Array, inverse: Array) -> _Gains:
    """Return the gains of (5, 6, 6) terms of one component, (6, 6, 6) products and (6, 2) radial loads."""
    straight, size, turned, _, cubes = alone
    own = np.eye(6)
    each = [own[:, None, :] * part for part in (size, 2.0 * turned, 3.0 * cubes)]
    sides = radial[:, [0, 0, 1, 1]].T[:, :, None] * own[[0, 1, 3, 4], None, :]
    tangents = np.concatenate([straight[None], each[0], each[1], 2.0 * forms.swapaxes(1, 2), each[2], sides])
    twists = np.concatenate([straight.T, size.T, turned.T, cubes.T, forms.reshape(36, 6), radial.T])
    return _Gains(twists, (tangents * inverse).reshape(29, 36))


def _columns(pairs: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the second of every pair."""
    first, second = np.array(pairs, dtype=int).reshape(-1, 2).T
    return first, second
