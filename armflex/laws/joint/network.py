"""Network law: one hidden layer of sigmoids, linear output (the paper's eqs. (14) to (18)), one network or many draws.

Weights of one network stand in this order, P = H (k + 1) + k (H + 1) of them: for each hidden neuron its k input
weights and its bias, then for each output its H weights and its offset. They belong to scaled loads and deflections.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag, LawError
from armflex.laws.law import Law, Parameter, Ranges, Row, embed
from armflex.laws.terms import Neurons, Term, Terms
from armflex.storage.schema import LARGEST, Numbers, check_arrays

NEARBY = 1e-4
"""Largest step of a weight over which a network is taken as straight: its cube against rounding divided by it."""

ARRAYS = {
    "hidden": Numbers(("networks", "neurons", "k")),
    "bias": Numbers(("networks", "neurons")),
    "output": Numbers(("networks", "k", "neurons")),
    "offset": Numbers(("networks", "k")),
    "input_mean": Numbers(("k",)),
    "input_scale": Numbers(("k",), least=1.0 / LARGEST),
    "output_mean": Numbers(("k",)),
    "output_scale": Numbers(("k",), least=1.0 / LARGEST),
    "noise": Numbers(("k",), least=0.0),
    "weight_covariance": Numbers(("weights", "weights"), covariance=True, optional=True),
    "seen": Numbers((2, "k")),
    "load_mean": Numbers(("k",)),
    "load_precision": Numbers(("k", "k"), covariance=True),
    "furthest": Numbers((1,), least=1.0 / LARGEST),
}
SIZES = {"k": (3, 6), "networks": range(1, 1_000_000), "neurons": range(1, 10_000), "weights": range(1, 4000)}
"""Arrays of a law's file. Weights are as many as a covariance is proven positive of within seconds."""


@dataclass(frozen=True)
class NetworkLaw(Law):
    """S networks of H neurons for k = 3 or 6 components, answering with the average of their predictions.

    Averaging weights instead, as the paper does, would give the answer of no network: neurons can change places.

    Attributes:
        hidden: (S, H, k) weights of the scaled load.
        bias: (S, H).
        output: (S, k, H).
        offset: (S, k).
        input_mean, input_scale: (k,) [N, Nm]; a network sees (load - mean) / scale.
        output_mean, output_scale: (k,) [m, rad]; its answer is mean + scale times what it gives.
        noise: (k,) standard deviation of a measured deflection [m, rad].
        weight_covariance: (P, P) Laplace covariance of the weights of a single network, or None.
        seen: (2, k) smallest and largest load of each component in training [N, Nm].
        load_mean: (k,) [N, Nm].
        load_precision: (k, k) inverse covariance of the loads in training.
        furthest: Largest Mahalanobis distance of a load in training.
    """

    hidden: Array
    bias: Array
    output: Array
    offset: Array
    input_mean: Array
    input_scale: Array
    output_mean: Array
    output_scale: Array
    noise: Array
    weight_covariance: Array | None
    seen: Array
    load_mean: Array
    load_precision: Array
    furthest: float

    @property
    def size(self) -> int:
        """Number of components k, 3 or 6."""
        return self.hidden.shape[2]

    @cached_property
    def _units(self) -> tuple[Array, Array]:
        """(k, S H) and (S H,): loads in SI to half the net value of every neuron of every network."""
        slopes = self.hidden.reshape(-1, self.size) / self.input_scale
        return np.ascontiguousarray(0.5 * slopes.T), 0.5 * (self.bias.ravel() - slopes @ self.input_mean)

    @cached_property
    def _answers(self) -> tuple[Array, Array]:
        """(S H, k) and (k,): tanh of half the net values to the average twist in SI; sigmoid(x) = (1 + tanh(x/2))/2."""
        halves = 0.5 * self.output * self.output_scale[:, None]
        constant = self.offset * self.output_scale + halves.sum(axis=2)
        gains = np.moveaxis(halves, 1, 2).reshape(-1, self.size) / len(halves)
        return np.ascontiguousarray(gains), self.output_mean + constant.mean(axis=0)

    def compliance_bound(self, ranges: Ranges) -> Array:
        """Return the sum over all neurons of what each gives where it is steepest."""
        (units, _), (gains, _) = self._units, self._answers
        norms = np.zeros((2, 2))
        for i, out in enumerate(np.split(gains, self.size // 3, axis=1)):
            for j, into in enumerate(np.split(units, self.size // 3, axis=0)):
                norms[i, j] = np.linalg.norm(out, axis=1) @ np.linalg.norm(into, axis=0)
        return norms

    def terms(self) -> Terms:
        """Return the neurons of all networks together, and a constant."""
        (units, bias), (gains, constant) = self._units, self._answers
        return Neurons(embed(units.T, axes=1), bias, embed(gains, axes=1)), Term(embed(constant, axes=1))

    def draws(self, load: Array) -> Array:
        """Return the (..., S, k) answers [m, rad] of the single networks to (..., k) loads."""
        units, bias = self._units
        curves = np.tanh(load @ units + bias).reshape(*load.shape[:-1], *self.bias.shape)
        values = self.offset + (self.output @ (0.5 + 0.5 * curves)[..., None])[..., 0]
        return self.output_mean + self.output_scale * values

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The weights of a single network; several are a posterior by themselves, which `draw` takes one of."""
        if len(self.hidden) > 1:
            return ()
        stds = np.zeros(weight_count(self.size, self.hidden.shape[1]))
        if self.weight_covariance is not None:
            stds = np.sqrt(np.diag(self.weight_covariance))
        return tuple(Parameter(f"w{i}", "1", float(std)) for i, std in enumerate(stds))

    @property
    def values(self) -> Array:
        """Weights in the order of `pack`."""
        return pack(self)[0] if len(self.hidden) == 1 else np.zeros(0)

    def at(self, values: Array) -> NetworkLaw:
        return replace(self, **unpack(values, self.size)) if len(self.hidden) == 1 else self

    @property
    def values_covariance(self) -> Array | None:
        """Laplace's, of the weights."""
        return self.weight_covariance

    def certain(self) -> NetworkLaw:
        return replace(self, weight_covariance=None)

    def by_values(self, wrench: Array, row: Row) -> Array:
        by_value = np.zeros((*wrench.shape, len(self.values)))
        if by_value.size:
            scaled = (wrench[..., : self.size] - self.input_mean) / self.input_scale
            by_weights = weight_jacobian(scaled, self.values, self.size)
            by_value[..., : self.size, :] = self.output_scale[:, None] * by_weights
        return by_value

    def scatter(self, wrench: Array, row: Row) -> Array:
        """Return the noise, and by what the answers of several networks differ."""
        scatter = np.diag(self.noise**2)
        if len(self.hidden) > 1:
            off = self.draws(wrench[..., : self.size])
            off = off - off.mean(axis=-2, keepdims=True)
            scatter = scatter + np.swapaxes(off, -1, -2) @ off / (len(self.hidden) - 1)
        return embed(scatter)

    def widening(self, wrench: Array, row: Row) -> Array:
        """Return the square of `reach` beyond the loads trained on: a network says nothing there."""
        return np.maximum(1.0, self.reach(wrench[..., : self.size])) ** 2

    def draw(self, rng: np.random.Generator) -> Law:
        """Return one of several networks, or the only one moved by weights drawn, as `covariance` has it."""
        if len(self.hidden) == 1:
            return self if self._root is None else self.straight(self._root @ rng.normal(size=self._root.shape[1]))
        chosen = slice(i := int(rng.integers(len(self.hidden))), i + 1)
        return replace(self, **{name: getattr(self, name)[chosen] for name in ("hidden", "bias", "output", "offset")})

    def straight(self, step: Array) -> NetworkLaw:
        """Return a single network moved by its weights' (P,) step as if answers were linear in them: f + J step.

        Laplace's covariance is of that linearised network (Immer, Korzepa and Bauer 2021); a network whose weights are
        themselves drawn so far out fits nothing. J step is the difference of two networks close to either side, which
        stand beside this one as neurons of one more than three times as wide.
        """
        width = NEARBY / max(float(np.abs(step).max(initial=0.0)), NEARBY)
        ends = [unpack(self.values + sign * width * step, self.size) for sign in (1.0, -1.0)]
        shares = (1.0, 0.5 / width, -0.5 / width)
        parts = [
            (share, part) for share, part in zip(shares, ({n: getattr(self, n) for n in ends[0]}, *ends), strict=True)
        ]
        return replace(
            self,
            hidden=np.concatenate([part["hidden"] for _, part in parts], axis=1),
            bias=np.concatenate([part["bias"] for _, part in parts], axis=1),
            output=np.concatenate([share * part["output"] for share, part in parts], axis=2),
            offset=sum((share * part["offset"] for share, part in parts), np.zeros(self.size)),
            weight_covariance=None,
        )

    def distance(self, load: Array) -> Array:
        """Return the (...) Mahalanobis distance of (..., k) loads from the mean of those trained on."""
        off = load - self.load_mean
        return np.sqrt(np.einsum("...i,ij,...j->...", off, self.load_precision, off))

    def reach(self, load: Array) -> Array:
        """Return how far out (..., k) loads are, 1 at the edge of those trained on: by distance or one component."""
        low, high = self.seen
        single = np.abs(2.0 * load - low - high) / (high - low)
        return np.maximum(self.distance(load) / self.furthest, single.max(axis=-1))

    @property
    def trained_on(self) -> Array:
        return self.seen

    def flags(self, wrench: Array, row: Row) -> tuple[Flag, ...]:
        """Return a flag for every component beyond those trained on, or one for a combination of them that is."""
        load, flags = wrench[: self.size], super().flags(wrench, row)
        times = float(self.distance(load)) / self.furthest
        if times <= 1.0 + 1e-9 or any(flag.code == "extrapolating" for flag in flags):
            return flags
        text = f"load is outside the loads it was trained on: {times:.3g} times as far from their mean as any of them"
        return (*flags, Flag("extrapolating", text, size=0.5 * (times - 1.0)))


def weight_count(size: int, neurons: int) -> int:
    """Return P, the number of weights of a network with k inputs and outputs."""
    return neurons * (size + 1) + size * (neurons + 1)


def layers(weights: Array, size: int) -> tuple[Array, Array]:
    """Return views of (..., P) weights: (..., H, k + 1) hidden with biases last, (..., k, H + 1) output and offsets."""
    neurons = (weights.shape[-1] - size) // (2 * size + 1)
    split = neurons * (size + 1)
    hidden = weights[..., :split].reshape(*weights.shape[:-1], neurons, size + 1)
    return hidden, weights[..., split:].reshape(*weights.shape[:-1], size, neurons + 1)


def pack(law: NetworkLaw) -> Array:
    """Return the (S, P) weights of a law's networks."""
    hidden = np.concatenate([law.hidden, law.bias[..., None]], axis=2)
    output = np.concatenate([law.output, law.offset[..., None]], axis=2)
    return np.concatenate([hidden.reshape(len(hidden), -1), output.reshape(len(output), -1)], axis=1)


def unpack(weights: Array, size: int) -> dict[str, Array]:
    """Return `hidden`, `bias`, `output` and `offset` of a `NetworkLaw` from (S, P) weights."""
    hidden, output = (np.ascontiguousarray(layer) for layer in layers(np.atleast_2d(weights), size))
    parts = {"hidden": hidden[..., :-1], "bias": hidden[..., -1], "output": output[..., :-1], "offset": output[..., -1]}
    return {name: np.ascontiguousarray(part) for name, part in parts.items()}


def hidden_values(x: Array, hidden: Array) -> Array:
    """Return (..., H) sigmoids of (..., k) scaled loads under (H, k + 1) hidden weights, the paper's eq. (15)."""
    return 0.5 + 0.5 * np.tanh(0.5 * (x @ hidden[:, :-1].T + hidden[:, -1]))


def weight_jacobian(x: Array, weights: Array, size: int) -> Array:
    """Return the (..., k, P) derivative of the scaled answer to (..., k) scaled loads by a network's (P,) weights."""
    hidden, output = layers(weights, size)
    values = hidden_values(x, hidden)
    ones = np.ones((*values.shape[:-1], 1))
    inner = output[:, :-1] * (values * (1.0 - values))[..., None, :]  # (..., k, H)
    inner = inner[..., None] * np.concatenate([x, ones], axis=-1)[..., None, None, :]
    outer = np.einsum("cd,...h->...cdh", np.eye(size), np.concatenate([values, ones], axis=-1))
    flat = (*values.shape[:-1], size, -1)
    return np.concatenate([inner.reshape(flat), outer.reshape(flat)], axis=-1)


def to_tensors(law: NetworkLaw) -> dict[str, Array]:
    """Return the law as named arrays, for a file; `weight_covariance` is left out where there is none."""
    arrays = {name: getattr(law, name) for name in ARRAYS}
    return {
        name: np.ascontiguousarray(np.atleast_1d(value), dtype=np.float64)
        for name, value in arrays.items()
        if value is not None
    }


def from_tensors(tensors: Mapping[str, Array]) -> NetworkLaw:
    """Return the law that `to_tensors` wrote.

    Raises:
        LawError: An array is missing, unknown, of a wrong shape or kind, not finite, or impossible.
    """
    try:
        check_arrays(tensors, ARRAYS, SIZES)
    except ValueError as error:
        raise LawError(str(error)) from None
    draws, neurons, k = tensors["hidden"].shape
    if "weight_covariance" in tensors:
        if draws != 1:
            raise LawError(f"'weight_covariance' belongs to a single network, not to {draws}")
        if len(tensors["weight_covariance"]) != weight_count(k, neurons):
            count = len(tensors["weight_covariance"])
            raise LawError(f"'weight_covariance' is of {count} weights, not of the network's")
    if (tensors["seen"][0] >= tensors["seen"][1]).any():
        raise LawError("'seen' has a smallest load that is not below the largest")
    if not np.diag(tensors["load_precision"]).all():
        raise LawError("'load_precision' has loads that did not vary")
    fields = dict(tensors) | {"furthest": float(tensors["furthest"][0])}
    return NetworkLaw(**{"weight_covariance": None, **fields})
