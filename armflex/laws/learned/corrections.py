"""Corrections about a law: by named terms of the load (even ones are contacts, odd ones stiffening), or by a network.

Loads and twists are in parts of what is typical of the flexure, so that values are of size 1 or less where they make
sense. No load, no correction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.laws.joint.polynomial import FeatureMap, feature_values
from armflex.laws.law import Law, Row
from armflex.laws.parameter import Parameter

Scales = tuple[tuple[int, ...], tuple[int, ...], Array, Array]
"""Components, axes and scales of a `Correcting`."""

FORMS = {"|{}|": "|{}|", "{}|{}|": "{}|{}|", "{}^2": "{}*{}", "{}^3": "{}^3"}
"""Terms of one component, and the features that they are."""

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

    @cached_property
    def _terms(self) -> dict[str, str]:
        """The feature of every term."""
        names = [WRENCH_NAMES[i] for i in self.components]
        forms = {"{}": "{}", **FORMS} if self.linear else FORMS
        terms = {
            form.format(name, name): feature.format(name, name) for form, feature in forms.items() for name in names
        }
        terms |= {f"{one}*{other}": f"{one}*{other}" for one, other in combinations(names, 2)}
        both = {"f": {"fx", "fy"}, "m": {"mx", "my"}}
        radial = {"radial_f": "radial_force", "radial_m": "radial_moment"}
        return terms | {term: feature for term, feature in radial.items() if both[term[-1]] <= set(names)}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One group: beforehand all terms are of one size, in parts of the twist of their axis."""
        std = TERMS / np.sqrt(max(len(self._terms), 1))
        names = [f"{TWIST_NAMES[axis]}:{term}" for axis in self.axes for term in self._terms]
        return tuple(Parameter(name, "1", std, group="terms", sized=True) for name in names)

    @classmethod
    def start(cls, scales: Scales, linear: bool) -> PolynomialCorrection:
        """Return terms of zero: no correction."""
        empty = cls(*scales, np.zeros(0), linear)
        return replace(empty, values=np.zeros(len(empty.parameters)))

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the twist."""
        return self._map.values(wrench * self._inverse)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the derivative by the wrench."""
        return self._map.slopes(wrench * self._inverse) * self._inverse

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the derivative by the values."""
        terms = feature_values(wrench * self._inverse)[..., self._map.places]
        return np.einsum("...p,ab->...abp", terms, self.to_twist).reshape(*wrench.shape[:-1], 6, -1)

    @cached_property
    def _map(self) -> FeatureMap:
        """The twist by the terms."""
        return FeatureMap.of(list(self._terms.values()), (self.to_twist @ self.values.reshape(len(self.axes), -1)).T)

    @cached_property
    def _inverse(self) -> Array:
        """(6,) what a load is multiplied with, zero for components that do not count."""
        inverse = np.zeros(6)
        inverse[list(self.components)] = 1.0 / self.typical
        return inverse
