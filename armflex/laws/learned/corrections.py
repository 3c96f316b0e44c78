"""Corrections about a law: by named terms of the load (even ones are contacts, odd ones stiffening), or by a network.

Loads and twists are in parts of what is typical of the flexure, so that values are of size 1 or less where they make
sense. No load, no correction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.laws.law import Law, Row
from armflex.laws.parameter import Parameter

Scales = tuple[tuple[int, ...], tuple[int, ...], Array, Array]
"""Components, axes and scales of a `Correcting`."""

FORMS = ("|{}|", "{}|{}|", "{}^2", "{}^3")
"""Terms of one component."""

TERMS = START = 0.3
"""Where the search starts for the size of all terms together, and of a network's output: as a part of the declared
law's own twist."""

STEEP = 1.5
"""Prior standard deviation of a hidden neuron's net value at a typical load."""


@dataclass(frozen=True, eq=False)
class Correcting(Law):
    """Scales of a correction.

    Attributes:
        components: Of the load that count, 0 to 5.
        axes: Of the twist that answer, 0 to 5.
        load_scale: (6,) typical loads [N, Nm].
        twist_scale: (6,) typical twists [m, rad]; values are in parts of them.
        values: (k,) values of the parameters.
    """

    components: tuple[int, ...]
    axes: tuple[int, ...]
    load_scale: Array
    twist_scale: Array
    values: Array

    def at(self, values: Array) -> Law:
        """Return the law at other values."""
        return replace(self, values=values)

    def parts_of_typical(self, wrench: Array) -> Array:
        """Return the (..., c) components that count of a (..., 6) wrench, as multiples of typical ones."""
        return wrench[..., self.components] / self.typical

    @cached_property
    def typical(self) -> Array:
        """(c,) typical loads of the components that count."""
        return self.load_scale[list(self.components)]

    @cached_property
    def to_twist(self) -> Array:
        """(6, a) typical twist at the place of every axis that answers."""
        return np.diag(self.twist_scale)[:, list(self.axes)]


@dataclass(frozen=True, eq=False)
class NetworkCorrection(Correcting):
    """twist = scale W (tanh(V z + b) - tanh(b)), z = load / scale.

    Attributes, beside those of `Correcting`:
        neurons: Number of hidden neurons.
    """

    neurons: int

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Hidden weights, biases, output weights."""
        hidden = [f"n{h}:{WRENCH_NAMES[i]}" for h in range(self.neurons) for i in self.components]
        output = [f"{TWIST_NAMES[axis]}:n{h}" for axis in self.axes for h in range(self.neurons)]
        steep, std = STEEP / np.sqrt(len(self.components)), START / np.sqrt(self.neurons)
        return (
            *(Parameter(name, "1", steep, group="hidden") for name in hidden),
            *(Parameter(f"n{h}:bias", "1", 1.0, group="bias") for h in range(self.neurons)),
            *(Parameter(name, "1", std, group="output", sized=True) for name in output),
        )

    @classmethod
    def start(cls, scales: Scales, neurons: int, seed: int = 0) -> NetworkCorrection:
        """Return drawn hidden weights and biases, and an output of zero: no correction."""
        rng, inputs = np.random.default_rng(seed), len(scales[0])
        hidden = rng.normal(0.0, STEEP / np.sqrt(inputs), neurons * inputs)
        values = [hidden, rng.normal(0.0, 1.0, neurons), np.zeros(len(scales[1]) * neurons)]
        return cls(*scales, np.concatenate(values), neurons)

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the twist."""
        hidden, bias, output = self._weights
        return (np.tanh(self.parts_of_typical(wrench) @ hidden.T + bias) - np.tanh(bias)) @ (self.to_twist @ output).T

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the derivative by the wrench."""
        hidden, bias, output = self._weights
        slope = 1.0 - np.tanh(self.parts_of_typical(wrench) @ hidden.T + bias) ** 2
        whole = np.zeros((*wrench.shape[:-1], 6, 6))
        into = hidden / self.typical
        whole[..., self.components] = (self.to_twist @ output) @ (slope[..., None] * into)
        return whole

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the derivative by the values."""
        hidden, bias, output = self._weights
        z = self.parts_of_typical(wrench)
        curve = np.tanh(z @ hidden.T + bias)
        gains, shape = self.to_twist @ output, wrench.shape[:-1]
        slope, rest = 1.0 - curve**2, 1.0 - np.tanh(bias) ** 2
        by_hidden = np.einsum("ah,...h,...k->...ahk", gains, slope, z).reshape(*shape, 6, -1)
        by_bias = gains * (slope - rest)[..., None, :]
        by_output = np.einsum("ab,...h->...abh", self.to_twist, curve - np.tanh(bias)).reshape(*shape, 6, -1)
        return np.concatenate([by_hidden, by_bias, by_output], axis=-1)

    @cached_property
    def _weights(self) -> tuple[Array, Array, Array]:
        """Return (H, k) hidden weights, (H,) biases, (axes, H) output weights."""
        inner = self.neurons * len(self.components)
        hidden, bias, output = np.split(self.values, [inner, inner + self.neurons])
        return hidden.reshape(self.neurons, -1), bias, output.reshape(-1, self.neurons)


@dataclass(frozen=True, eq=False)
class PolynomialCorrection(Correcting):
    """Terms |z|, z|z|, z^2, z^3 of every component z = load / scale that counts, products of two, radial loads.

    Attributes, beside those of `Correcting`:
        linear: Whether z is among the terms, where no compliance is learned beside them.
    """

    linear: bool = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One group: beforehand all terms are of one size, in parts of the twist of their axis."""
        names = [WRENCH_NAMES[i] for i in self.components]
        kinds = ("{}", *FORMS) if self.linear else FORMS
        terms = [form.format(name, name) for form in kinds for name in names]
        terms += [f"{names[i]}*{names[j]}" for i, j in self._pairs] + [f"radial_{names[i][0]}" for i, _ in self._radial]
        std, axes = TERMS / np.sqrt(max(len(terms), 1)), [TWIST_NAMES[axis] for axis in self.axes]
        return tuple(
            Parameter(f"{axis}:{term}", "1", std, group="terms", sized=True) for axis in axes for term in terms
        )

    @classmethod
    def start(cls, scales: Scales, linear: bool) -> PolynomialCorrection:
        """Return terms of zero: no correction."""
        empty = cls(*scales, np.zeros(0), linear)
        return replace(empty, values=np.zeros(len(empty.parameters)))

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the twist."""
        z = wrench * self._inverse
        size = np.abs(z)
        products = (z[..., :, None] * z[..., None, :]).reshape(*z.shape[:-1], 36)
        lengths = np.hypot(z[..., 0::3], z[..., 1::3])
        terms = np.concatenate([z, size, z * size, z * size * size, products, lengths], axis=-1)
        return terms @ self._gains.twists

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the derivative by the wrench."""
        z = wrench * self._inverse
        lengths = np.hypot(z[..., 0::3], z[..., 1::3])[..., None]
        sides = z.reshape(*z.shape[:-1], 2, 3)[..., :2] / np.where(lengths > 0.0, lengths, 1.0)
        one, sides = np.ones_like(z[..., :1]), sides.reshape(*z.shape[:-1], 4)
        slopes = np.concatenate([one, np.sign(z), np.abs(z), z, z * z, sides], axis=-1)
        return (slopes @ self._gains.tangents).reshape(*z.shape[:-1], 6, 6)

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the derivative by the values."""
        terms = self._terms(wrench)
        return np.einsum("...p,ab->...abp", terms, self.to_twist).reshape(*wrench.shape[:-1], 6, -1)

    def _terms(self, wrench: Array) -> Array:
        z = self.parts_of_typical(wrench)
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

    @cached_property
    def _gains(self) -> _Gains:
        """The twist per term."""
        twists, known, count = (
            self.to_twist @ self.values.reshape(len(self.axes), -1),
            list(self.components),
            len(self._pairs),
        )
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
