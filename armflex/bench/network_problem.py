"""Joint data as a network sees them, the sum of squares that training makes small, and the steps that do so.

All weights are those of scaled loads and deflections, in the order of `armflex.laws.joint.network`. Levenberg-Marquardt
has the paper's damping schedule (its eq. (19) and the paragraph below it). It is our own because J^T J of a network is
made of one Gram matrix of its neurons: MINPACK, which factors the whole Jacobian, takes 15 times as long on a 3-20-3
network (`tests/benchmarks/network.py`), and 5 to 8 times where the output layer is solved for.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg.lapack import dposv

from armflex.bench.fitted import check_span
from armflex.conventions import Array
from armflex.errors import InputError
from armflex.laws.joint.network import hidden_values, layers, weight_count, weight_jacobian

GROUPS = ("hidden weights", "hidden biases", "output weights", "offsets")
"""What has a prior precision of its own."""

ROUNDING = 1e-12
"""Part of the largest diagonal entry that keeps a matrix positive definite in 64 bits."""


@dataclass(frozen=True)
class Scaling:
    """Mean and standard deviation of loads [N, Nm] and deflections [m, rad], each (k,)."""

    input_mean: Array
    input_scale: Array
    output_mean: Array
    output_scale: Array


@dataclass(frozen=True)
class NetworkProblem:
    """Joint data as a network with H hidden `neurons` sees them: scaled loads (N, k) and deflections (N, k)."""

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
        hidden, output = [0] * self.size + [1], [2] * self.neurons + [3]
        return np.array(hidden * self.neurons + output * self.size)

    @cached_property
    def inputs(self) -> Array:
        """(N, k + 1) scaled loads with the ones that biases multiply."""
        return np.hstack([self.x, np.ones((len(self.x), 1))])


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
    off = loads - loads.mean(axis=0)
    varies = np.abs(off).max(axis=0) > 1e-12 * np.abs(loads).max(axis=0)  # else it is the mean's rounding
    check_span(np.where(varies, off, 0.0))
    std = deflections.std(axis=0)
    moves = std > 1e-12 * np.abs(deflections).max(axis=0)
    scale = np.where(moves, std, std.max() or 1.0)  # a column may be constant: the offset holds it
    scaling = Scaling(loads.mean(axis=0), loads.std(axis=0), deflections.mean(axis=0), scale)
    return NetworkProblem(off / scaling.input_scale, (deflections - scaling.output_mean) / scale, neurons), scaling


def start_weights(problem: NetworkProblem, starts: int, seed: int) -> Array:
    """Return (starts, P) random weights: neurons spread over the loads, small output weights."""
    if starts < 1:
        raise InputError(f"training needs at least one start, got {starts}")
    rng = np.random.default_rng(seed)
    deviations = np.array([1.0 / np.sqrt(problem.size), 1.0, 1.0 / np.sqrt(problem.neurons), 0.1])
    return rng.normal(size=(starts, problem.count)) * deviations[problem.groups]


def predictions(problem: NetworkProblem, weights: Array) -> Array:
    """Return the (..., N, k) scaled deflections that (..., P) weights give."""
    hidden, output = layers(weights, problem.size)
    net = problem.x @ np.swapaxes(hidden[..., :-1], -1, -2) + hidden[..., None, :, -1]
    values = 0.5 + 0.5 * np.tanh(0.5 * net)
    return values @ np.swapaxes(output[..., :-1], -1, -2) + output[..., None, :, -1]


def jacobian(problem: NetworkProblem, weights: Array) -> Array:
    """Return the (N, k, P) derivative of `predictions`."""
    return weight_jacobian(problem.x, weights, problem.size)


@dataclass(frozen=True)
class NetworkPoint:
    """A sum of squares at one place.

    Attributes:
        weights: (P,) where it was asked for, or better ones where an objective can find some of them exactly.
        cost: Half the sum of squares.
        rest: What the objective can use again for its derivatives.
    """

    weights: Array
    cost: float
    rest: Any


@dataclass(frozen=True)
class Weighted:
    """Half the squared errors over their noise plus half the squared weights times their precision.

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
        """How many weights, the last ones, `evaluate` finds by itself, so that they need no damping."""
        return self.problem.size * (self.problem.neurons + 1) if self.solves else 0

    def evaluate(self, weights: Array) -> NetworkPoint:
        """Return the cost at (P,) weights, with hidden values and one (N, H + 1) and errors (N, k)."""
        problem = self.problem
        values = hidden_values(problem.x, layers(weights, problem.size)[0])
        basis = np.hstack([values, np.ones((len(values), 1))])
        if self.solves:  # each output's best weights under its prior
            gram, right, width = basis.T @ basis, basis.T @ problem.y, basis.shape[1]
            ridges = np.outer(self.noise**2, self.precisions[-width:])  # the same prior for every output
            rounding = ROUNDING * gram.max()
            rows = [damped_step(right[:, i], gram + np.diag(ridge), rounding) for i, ridge in enumerate(ridges)]
            weights = np.concatenate([weights[: -self.solved], *rows])
        errors = basis @ layers(weights, problem.size)[1].T - problem.y
        squares = ((errors / self.noise) ** 2).sum() + self.precisions @ weights**2
        return NetworkPoint(weights, 0.5 * self.unit * float(squares), (basis, errors))

    def normal(self, point: NetworkPoint) -> tuple[Array, Array]:
        """Return the (P,) gradient J^T e and the (P, P) matrix J^T J, of which the lower triangle is right.

        Blocks of the matrix are one Gram matrix, of hidden slopes times inputs, hidden values and one, times products
        of output weights.
        """
        (basis, errors), problem, parts = point.rest, self.problem, self.unit / self.noise**2
        gains = layers(point.weights, problem.size)[1][:, :-1]
        slopes = basis[:, :-1] * (1.0 - basis[:, :-1])
        weighted = errors * parts
        first = ((weighted @ gains) * slopes).T @ problem.inputs
        gradient = np.concatenate([first.ravel(), (weighted.T @ basis).ravel()])
        inner = (slopes[:, :, None] * problem.inputs[:, None, :]).reshape(len(basis), -1)
        columns, split, width = np.hstack([inner, basis]), inner.shape[1], basis.shape[1]
        gram, matrix = columns.T @ columns, np.zeros((problem.count, problem.count))
        repeated = np.repeat(gains, problem.size + 1, axis=1)
        matrix[:split, :split] = gram[:split, :split] * ((repeated.T * parts) @ repeated)
        for i in range(problem.size):
            block = slice(split + i * width, split + (i + 1) * width)
            matrix[block, :split] = gram[split:, :split] * (parts[i] * repeated[i])
            matrix[block, block] = gram[split:, split:] * parts[i]
        prior = self.unit * self.precisions
        matrix.flat[:: len(matrix) + 1] += prior
        return gradient + prior * point.weights, matrix


def sum_of_squares(problem: NetworkProblem) -> Weighted:
    """Return the plain sum of squared scaled errors."""
    return Weighted(problem, np.zeros(problem.count), np.ones(problem.size))


@dataclass(frozen=True)
class Damping:
    """How the combination coefficient mu changes.

    The paper prints "10e-5" for its floor, which is 1e-4 as written and probably 1e-5 as meant.

    Attributes:
        start: First mu.
        factor: What mu is divided by after a step that helped and multiplied by after one that did not.
        floor: mu does not go below this.
        ceiling: Beyond this no step helps and the search ends.
        relative: Whether mu multiplies the diagonal of J^T J (Marquardt) instead of the identity (the paper).
    """

    start: float = 1e-3
    factor: float = 10.0
    floor: float = 1e-5
    ceiling: float = 1e10
    relative: bool = False


PAPER = Damping()
RELATIVE = Damping(start=1e-2, floor=1e-10, relative=True)


@dataclass(frozen=True)
class Minimum:
    """Where a search ended.

    Attributes:
        weights: (P,).
        cost: Half the sum of squares there.
        costs: The cost at the start and after every step tried, never rising.
        mu: The combination coefficient that the next step would have had.
        converged: Whether it ended because nothing was to be gained any more.
    """

    weights: Array
    cost: float
    costs: Array
    mu: float
    converged: bool


def minimise(
    objective: Weighted, start: Array, iterations: int = 200, tolerance: float = 0.0, damping: Damping = PAPER
) -> Minimum:
    """Return a local minimum of a sum of squares.

    Args:
        objective: What is made small.
        start: (P,) first weights.
        iterations: Most steps to try.
        tolerance: Ends after three helpful steps in a row that each gained less than this part of the cost.
        damping: Schedule of mu.
    """
    here, mu, small = objective.evaluate(start), damping.start, 0
    costs, normal = [here.cost], objective.normal(here)
    while len(costs) <= iterations and mu <= damping.ceiling and small < 3:
        trial = objective.evaluate(here.weights - damped_step(*normal, mu, damping.relative, objective.solved))
        if trial.cost < here.cost:
            small = small + 1 if here.cost - trial.cost < tolerance * here.cost else 0
            here, mu = trial, max(mu / damping.factor, damping.floor)
            normal = objective.normal(here)
        else:
            mu *= damping.factor
        costs.append(here.cost)
    return Minimum(here.weights, here.cost, np.array(costs), mu, small == 3 or mu > damping.ceiling)


def damped_step(gradient: Array, matrix: Array, mu: float, relative: bool = False, solved: int = 0) -> Array:
    """Return (J^T J + mu D)^-1 J^T e, nan where that is singular to rounding.

    Args:
        gradient: (P,) J^T e.
        matrix: (P, P) J^T J; its lower triangle is read.
        mu: See `Damping`.
        relative: Whether D is the diagonal of J^T J rather than the identity.
        solved: Number of last weights for which D is nothing but what rounding asks for.
    """
    damped, diagonal = matrix.copy(), matrix.diagonal()
    added = mu * diagonal if relative else np.full(len(matrix), mu)
    if solved:
        added[-solved:] = ROUNDING * diagonal[-solved:].max()
    damped.flat[:: len(damped) + 1] += added
    _, step, info = dposv(damped.T, gradient, lower=0, overwrite_a=1)  # transposed: LAPACK's own order, no copy
    return step if info == 0 else np.full_like(gradient, np.nan)  # nan is below no cost: mu grows
