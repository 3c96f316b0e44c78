"""Joint data as a network sees them, and the sums of squares that training it makes small.

All weights are those of scaled loads and deflections, in the order of `armflex.laws.joint.network`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armflex.bench.levenberg import ROUNDING, Point, damped_step
from armflex.bench.span import check_span
from armflex.conventions import Array
from armflex.errors import InputError
from armflex.laws.joint.network import hidden_values, layers, weight_count, weight_jacobian

GROUPS = ("hidden weights", "hidden biases", "output weights", "offsets")
"""What has a prior precision of its own."""


@dataclass(frozen=True)
class Scaling:
    """Mean and standard deviation of loads [N, Nm] and deflections [m, rad], each (k,)."""

    input_mean: Array
    input_scale: Array
    output_mean: Array
    output_scale: Array


@dataclass(frozen=True)
class NetworkProblem:
    """Joint data as a network sees them.

    Attributes:
        x: (N, k) scaled loads.
        y: (N, k) scaled deflections.
        neurons: Hidden neurons H.
    """

    x: Array
    y: Array
    neurons: int

    @property
    def size(self) -> int:
        """Number of components k."""
        return self.x.shape[1]

    @property
    def count(self) -> int:
        """Number of weights P."""
        return weight_count(self.size, self.neurons)

    @cached_property
    def groups(self) -> np.ndarray:
        """(P,) index into `GROUPS` of each weight."""
        size, neurons = self.size, self.neurons
        hidden, output = [0] * size + [1], [2] * neurons + [3]
        return np.array(hidden * neurons + output * size)

    @cached_property
    def inputs(self) -> Array:
        """(N, k + 1) scaled loads with the ones that biases multiply."""
        return np.hstack([self.x, np.ones((len(self.x), 1))])


@dataclass(frozen=True)
class Weighted:
    """Half the squared errors over their noise plus half the squared weights times their precision, an `Objective`.

    Multiplied by `unit`, so that the damping has the same meaning with and without a noise.

    Attributes:
        problem: The data.
        precisions: (P,) of the weights' Gaussian prior, 0 for none.
        noise: (k,) standard deviation of scaled deflections.
        solves: Whether the output layer, which is linear, is always the best one for the hidden weights (Golub and
            Pereyra 1973): as good a maximum in a tenth of the steps. Needs a prior, or more rows than neurons.
    """

    problem: NetworkProblem
    precisions: Array
    noise: Array
    solves: bool = False

    @cached_property
    def unit(self) -> float:
        """The least noise, squared."""
        return float(self.noise.min() ** 2)

    @property
    def solved(self) -> int:
        """Number of weights of the output layer where it is solved for, else 0."""
        return self.problem.size * (self.problem.neurons + 1) if self.solves else 0

    def evaluate(self, weights: Array) -> Point:
        """Return the cost, with hidden values and one (N, H + 1) and errors (N, k)."""
        values = hidden_values(self.problem.x, layers(weights, self.problem.size)[0])
        basis = np.hstack([values, np.ones((len(values), 1))])
        if self.solves:
            weights = self._with_output(weights, basis)
        errors = basis @ layers(weights, self.problem.size)[1].T - self.problem.y
        squares = ((errors / self.noise) ** 2).sum() + self.precisions @ weights**2
        return Point(weights, 0.5 * self.unit * float(squares), (basis, errors))

    def _with_output(self, weights: Array, basis: Array) -> Array:
        """Return the weights with the output layer that fits best under its prior."""
        size, width = self.problem.size, basis.shape[1]
        gram, right = basis.T @ basis, basis.T @ self.problem.y
        ridges = np.outer(self.noise**2, self.precisions[-width:])  # the same prior for every output
        rows = [damped_step(right[:, i], gram + np.diag(ridges[i]), ROUNDING * gram.max()) for i in range(size)]
        return np.concatenate([weights[: -size * width], *rows])

    def normal(self, point: Point) -> tuple[Array, Array]:
        """Return gradient and J^T J; blocks of the latter are one Gram matrix times products of output weights."""
        basis, errors = point.rest
        problem, parts = self.problem, self.unit / self.noise**2
        gains = layers(point.weights, problem.size)[1][:, :-1]
        slopes = basis[:, :-1] * (1.0 - basis[:, :-1])
        inner = (slopes[:, :, None] * problem.inputs[:, None, :]).reshape(len(basis), -1)
        weighted = errors * parts
        first = ((weighted @ gains) * slopes).T @ problem.inputs
        gradient = np.concatenate([first.ravel(), (weighted.T @ basis).ravel()])
        columns = np.hstack([inner, basis])
        matrix = _blocks(columns.T @ columns, gains, parts)
        prior = self.unit * self.precisions
        matrix.flat[:: len(matrix) + 1] += prior
        return gradient + prior * point.weights, matrix


def _blocks(gram: Array, gains: Array, parts: Array) -> Array:
    """Return the lower triangle of J^T J (the rest is not all filled).

    Args:
        gram: (H (k + 1) + H + 1,) squared, of hidden slopes times inputs, hidden values and one.
        gains: (k, H) output weights.
        parts: (k,) weight of each output's errors.
    """
    size, neurons = gains.shape
    split, width = neurons * (size + 1), neurons + 1
    matrix = np.zeros((split + size * width,) * 2)
    repeated = np.repeat(gains, size + 1, axis=1)
    matrix[:split, :split] = gram[:split, :split] * ((repeated.T * parts) @ repeated)
    for i in range(size):
        own = slice(split + i * width, split + (i + 1) * width)
        matrix[own, :split] = gram[split:, :split] * (parts[i] * repeated[i])
        matrix[own, own] = gram[split:, split:] * parts[i]
    return matrix


def scaled_problem(loads: Array, deflections: Array, neurons: int) -> tuple[NetworkProblem, Scaling]:
    """Return (N, k) loads and deflections at zero mean and unit deviation, and how they became so.

    Raises:
        InputError: Shapes differ, k is not 3 or 6, a number is not finite, or there are too few rows.
        IdentifiabilityError: The loads, less their mean, do not span their components.
    """
    if neurons < 1:
        raise InputError(f"a network needs at least one neuron, got {neurons}")
    if loads.shape != deflections.shape or loads.ndim != 2 or loads.shape[1] not in (3, 6):
        raise InputError(f"loads {loads.shape} and deflections {deflections.shape} are not both (rows, 3 or 6)")
    if not (np.isfinite(loads).all() and np.isfinite(deflections).all()):
        raise InputError("loads and deflections must be finite")
    if len(loads) <= loads.shape[1] + 1:
        raise InputError(f"{len(loads)} rows of loads do not determine {loads.shape[1]} components and an offset")
    check_span(_varying(loads))
    spread = deflections.std(axis=0)
    moves = spread > 1e-12 * np.abs(deflections).max(axis=0)
    scale = np.where(moves, spread, spread.max() or 1.0)  # a column may be constant: the offset holds it
    scaling = Scaling(loads.mean(axis=0), loads.std(axis=0), deflections.mean(axis=0), scale)
    x = (loads - scaling.input_mean) / scaling.input_scale
    return NetworkProblem(x, (deflections - scaling.output_mean) / scaling.output_scale, neurons), scaling


def _varying(loads: Array) -> Array:
    """Return (N, k) loads less their mean; a constant load leaves zeros, not the mean's rounding."""
    off = loads - loads.mean(axis=0)
    return np.where(np.abs(off).max(axis=0) > 1e-12 * np.abs(loads).max(axis=0), off, 0.0)


def start_weights(problem: NetworkProblem, starts: int, seed: int) -> Array:
    """Return (starts, P) random weights: neurons spread over the loads, small output weights."""
    if starts < 1:
        raise InputError(f"training needs at least one start, got {starts}")
    rng = np.random.default_rng(seed)
    deviations = np.array([1.0 / np.sqrt(problem.size), 1.0, 1.0 / np.sqrt(problem.neurons), 0.1])
    return rng.normal(size=(starts, problem.count)) * deviations[problem.groups]


def least_squares(problem: NetworkProblem) -> Weighted:
    """Return the plain sum of squared scaled errors."""
    return Weighted(problem, np.zeros(problem.count), np.ones(problem.size))


def predictions(problem: NetworkProblem, weights: Array) -> Array:
    """Return the (..., N, k) scaled deflections that (..., P) weights give."""
    hidden, output = layers(weights, problem.size)
    net = problem.x @ np.swapaxes(hidden[..., :-1], -1, -2) + hidden[..., None, :, -1]
    values = 0.5 + 0.5 * np.tanh(0.5 * net)
    return values @ np.swapaxes(output[..., :-1], -1, -2) + output[..., None, :, -1]


def jacobian(problem: NetworkProblem, weights: Array) -> Array:
    """Return the (N, k, P) derivative of `predictions`."""
    return weight_jacobian(problem.x, weights, problem.size)
