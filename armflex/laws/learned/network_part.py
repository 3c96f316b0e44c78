"""A correction by a network of one hidden layer, all its weights learned; no load, no correction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.laws.law import Row
from armflex.laws.learned.correcting import Correcting
from armflex.laws.learned.part import Group

START = 0.3
"""Where the search for the output's size starts, as a part of the declared law's own twist."""

STEEP = 1.5
"""Prior standard deviation of a hidden neuron's net value at a typical load."""


@dataclass(frozen=True, eq=False)
class NetworkPart(Correcting):
    """twist = scale W (tanh(V z + b) - tanh(b)), z = load / scale.

    Attributes, beside those of `Correcting`:
        neurons: Number of hidden neurons.
        seed: Of the hidden weights that learning starts from.
    """

    neurons: int
    seed: int = 0

    @property
    def groups(self) -> tuple[Group, ...]:
        """Hidden weights, biases, output weights."""
        hidden = [f"n{h}:{WRENCH_NAMES[i]}" for h in range(self.neurons) for i in self.components]
        bias = [f"n{h}:bias" for h in range(self.neurons)]
        std, axes = START / np.sqrt(self.neurons), [TWIST_NAMES[axis] for axis in self.axes]
        output = tuple(f"{axis}:n{h}" for axis in axes for h in range(self.neurons))
        return (
            Group("hidden", tuple(hidden), STEEP / np.sqrt(len(self.components)), False),
            Group("bias", tuple(bias), 1.0, False),
            Group("output", output, std, True),
        )

    @property
    def start(self) -> Array:
        """Drawn hidden weights and biases, and an output of zero: no correction."""
        rng = np.random.default_rng(self.seed)
        drawn = [rng.normal(0.0, group.std, len(group.labels)) for group in self.groups[:2]]
        return np.concatenate([*drawn, np.zeros(len(self.axes) * self.neurons)])

    def twist(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the twist."""
        hidden, bias, output = self._weights(values)
        return (np.tanh(self.scaled(wrench) @ hidden.T + bias) - np.tanh(bias)) @ (self.spread @ output).T

    def tangent(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the derivative by the wrench."""
        hidden, bias, output = self._weights(values)
        slope = 1.0 - np.tanh(self.scaled(wrench) @ hidden.T + bias) ** 2
        whole = np.zeros((*wrench.shape[:-1], 6, 6))
        into = hidden / self.typical
        whole[..., self.components] = (self.spread @ output) @ (slope[..., None] * into)
        return whole

    def by_values(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the derivative by the values."""
        hidden, bias, output = self._weights(values)
        z = self.scaled(wrench)
        curve = np.tanh(z @ hidden.T + bias)
        gains, shape = self.spread @ output, wrench.shape[:-1]
        slope, rest = 1.0 - curve**2, 1.0 - np.tanh(bias) ** 2
        by_hidden = np.einsum("ah,...h,...k->...ahk", gains, slope, z).reshape(*shape, 6, -1)
        by_bias = gains * (slope - rest)[..., None, :]
        by_output = np.einsum("ab,...h->...abh", self.spread, curve - np.tanh(bias)).reshape(*shape, 6, -1)
        return np.concatenate([by_hidden, by_bias, by_output], axis=-1)

    def _weights(self, values: Array) -> tuple[Array, Array, Array]:
        """Return (H, k) hidden weights, (H,) biases, (axes, H) output weights."""
        inner = self.neurons * len(self.components)
        hidden, bias, output = np.split(values, [inner, inner + self.neurons])
        return hidden.reshape(self.neurons, -1), bias, output.reshape(-1, self.neurons)
