"""Corrections about a law: by named terms of the load (even ones are contacts, odd ones stiffening), or by a network.

Loads and twists are in parts of what is typical of the flexure, so that values are of size 1 or less where they make
sense. No load, no correction. It counts where loads were seen, and ends beyond them without making a joint look as if
it buckled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.laws.joint.log_compliance import root_of
from armflex.laws.joint.polynomial import FeatureMap, feature_values
from armflex.laws.law import Law, Parameter, Row
from armflex.laws.learned.seen import STEEPEST, Seen
from armflex.laws.terms import Neurons, Term, Terms

TAKEN = 0.25
"""Of the compliance that a correction may take where it fades."""

NEAREST = 2.0
"""Reach, see `Seen`, before which no correction is nothing."""

FORMS = {"|{}|": "|{}|", "{}|{}|": "{}|{}|", "{}^2": "{}*{}", "{}^3": "{}^3"}
"""Terms of one component, and the features that they are."""

TERMS = START = 0.3
"""Where the search starts for the size of all terms together, and of a network's output: as a part of the declared
law's own twist."""

STEEP = 1.5
"""Prior standard deviation of a hidden neuron's net value at a typical load."""


@dataclass(frozen=True, eq=False)
class Correction(Law):
    """A law where it counts: as it is at loads that were seen, further out carried on.

    It fades with the energy that a load puts into the joint, over a few times the most that was seen where it is small
    beside the law that is corrected, more slowly where it is large.
    """

    law: Law
    seen: Seen

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.law.parameters

    @property
    def values(self) -> Array:
        return self.law.values

    def at(self, values: Array) -> Correction:
        return Correction(self.law.at(values), self.seen)

    def twist(self, wrench: Array, row: Row) -> Array:
        if self.seen.sees(wrench):
            return self.law.twist(wrench, row)
        return self.seen.weight(wrench)[..., None] * self.law.twist(self.seen.drawn_in(wrench), row)

    def tangent(self, wrench: Array, row: Row) -> Array:
        if self.seen.sees(wrench):
            return self.law.tangent(wrench, row)
        within = self.seen.drawn_in(wrench)
        carried = self.law.tangent(within, row) @ self.seen.drawing_in(wrench)
        along = self.law.twist(within, row)[..., :, None] * self.seen.slope(wrench)[..., None, :]
        return self.seen.weight(wrench)[..., None, None] * carried + along

    def terms(self) -> Terms:
        return [replace(term, window=self.seen) for term in self.law.terms()]

    def by_values(self, wrench: Array, row: Row) -> Array:
        by_law = self.law.by_values(self.seen.drawn_in(wrench), row)
        return by_law * self.seen.weight(wrench)[..., None, None]


def fading(base: Law, correction: Correction, wrenches: Array, row: Row) -> tuple[float, Array | None]:
    """Return the reach at which a correction may be nothing, and the (6, 6) matrix of reaches; see `Seen`.

    A correction c that fades is a compliance the other way, c times the slope of its weight: too steep a one takes all
    that the joint gives, or gives too much, and the arm looks as if it buckled. With C = R R' it changes no more of C
    than |R^-1 c| |R^-1 slope| in any direction of the load. The second factor is the same in all directions, and least,
    where the weight is a function of the energy w' C w; the reach is such that the product is `TAKEN` at most in
    the many directions that are looked at.

    Args:
        base: The law that is corrected.
        correction: As it was learned, not fading.
        wrenches: (M, 6) observed loads.
        row: The M rows.
    """
    seen = correction.seen
    axes = np.flatnonzero(np.diag(seen.precision) > 0.0)
    block = np.ix_(axes, axes)
    tangent = base.tangent(wrenches, row).reshape(-1, 6, 6).mean(axis=0)
    root = root_of(0.5 * (tangent + tangent.T))[block]
    most = np.linalg.eigvalsh(root.T @ np.linalg.inv(seen.precision[block]) @ root)[-1]
    if not most > 0.0:
        return NEAREST, None
    energy = np.zeros((6, 6))
    energy[block] = root @ root.T / most
    inverse = np.zeros((6, 6))
    inverse[block] = np.linalg.pinv(root, rcond=1e-9)
    # The largest |R^-1 c| as far out as a correction is carried: in many directions, each followed uphill.
    form, size, spread = correction.law, 0.0, np.linalg.pinv(seen.precision, rcond=1e-15)
    loads = seen.furthest(seen.directions(wrenches))
    for _ in range(4):  # steps uphill to the load under which a correction is largest
        twists = form.twist(loads, row) @ inverse.T
        size = max(size, float(np.linalg.norm(twists, axis=1).max()))
        loads = seen.furthest(np.einsum("na,nai->ni", twists, inverse @ form.tangent(loads, row)) @ spread)
    return float(max(NEAREST, 1.0 + STEEPEST * size / np.sqrt(most) / TAKEN)), energy


@dataclass(frozen=True, eq=False)
class Correcting(Law):
    """A correction in parts of what is typical.

    Attributes:
        seen: The loads and twists that are typical; other axes than those in which the declared law gives do not
            count, neither of the load nor of the twist.
        values: (k,) values of the parameters.
    """

    seen: Seen
    values: Array

    def at(self, values: Array) -> Law:
        return replace(self, values=values)

    @cached_property
    def axes(self) -> list[int]:
        """Components of the load that count and axes of the twist that answer, 0 to 5."""
        return np.flatnonzero(self.seen.twist_scale > 0.0).tolist()

    @cached_property
    def typical(self) -> Array:
        """(a,) typical loads of the components that count."""
        return self.seen.load_scale[self.axes]

    @cached_property
    def to_twist(self) -> Array:
        """(6, a) typical twist at the place of every axis that answers."""
        return np.diag(self.seen.twist_scale)[:, self.axes]


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
        hidden = [f"n{h}:{WRENCH_NAMES[i]}" for h in range(self.neurons) for i in self.axes]
        output = [f"{TWIST_NAMES[axis]}:n{h}" for axis in self.axes for h in range(self.neurons)]
        steep, std = STEEP / np.sqrt(len(self.axes)), START / np.sqrt(self.neurons)
        return (
            *(Parameter(name, "1", steep, group="hidden") for name in hidden),
            *(Parameter(f"n{h}:bias", "1", 1.0, group="bias") for h in range(self.neurons)),
            *(Parameter(name, "1", std, group="output", sized=True) for name in output),
        )

    @classmethod
    def start(cls, seen: Seen, neurons: int) -> NetworkCorrection:
        """Return drawn hidden weights and biases, and an output of zero: no correction."""
        rng, inputs = np.random.default_rng(0), np.count_nonzero(seen.twist_scale)
        hidden = rng.normal(0.0, STEEP / np.sqrt(inputs), neurons * inputs)
        values = [hidden, rng.normal(0.0, 1.0, neurons), np.zeros(inputs * neurons)]
        return cls(seen, np.concatenate(values), neurons)

    def terms(self) -> Terms:
        hidden, bias, output = self._weights
        units, gains = np.zeros((len(bias), 6)), self.to_twist @ output
        units[:, self.axes] = hidden / self.typical
        return Neurons(units, bias, gains.T), Term(-gains @ np.tanh(bias))

    def by_values(self, wrench: Array, row: Row) -> Array:
        hidden, bias, output = self._weights
        z = wrench[..., self.axes] / self.typical
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
        inner = self.neurons * len(self.axes)
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
        names = [WRENCH_NAMES[i] for i in self.axes]
        forms = {"{}": "{}", **FORMS} if self.linear else FORMS
        terms = {
            form.format(name, name): feature.format(name, name) for form, feature in forms.items() for name in names
        }
        terms |= {f"{name}*{other}": f"{name}*{other}" for name, other in combinations(names, 2)}
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
    def start(cls, seen: Seen, linear: bool) -> PolynomialCorrection:
        """Return terms of zero: no correction."""
        empty = cls(seen, np.zeros(0), linear)
        return replace(empty, values=np.zeros(len(empty.parameters)))

    def twist(self, wrench: Array, row: Row) -> Array:
        return self._map.values(wrench * self._inverse)

    def terms(self) -> Terms:
        return self._map.terms(self._inverse)

    def tangent(self, wrench: Array, row: Row) -> Array:
        return self._map.slopes(wrench * self._inverse) * self._inverse

    def by_values(self, wrench: Array, row: Row) -> Array:
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
        inverse[self.axes] = 1.0 / self.typical
        return inverse
