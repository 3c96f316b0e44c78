"""Prior precisions and noise of a network from the data alone: MacKay's evidence (1992), by Gauss-Newton matrices."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import get_lapack_funcs

from armflex.bench.levenberg import RELATIVE, Damping, minimise
from armflex.bench.network_problem import GROUPS, NetworkProblem, Weighted, jacobian, predictions, start_weights
from armflex.conventions import Array
from armflex.parallel import in_order

dpotrf, dpotri = get_lapack_funcs(("potrf", "potri"))

PRECISIONS = (1e-6, 1e6)
NOISES = (1e-6, 1e1)
"""Bounds of what is re-estimated, in scaled units: a group that is not needed, or data without noise, has no other."""

FIRST_NOISE = 0.3
"""Scaled, well above what it will be: who begins by following every row stays in a poor maximum."""

STEPS = 20
"""Of Levenberg-Marquardt between two re-estimations."""


@dataclass(frozen=True)
class Mode:
    """One maximum of the posterior, with its Gaussian (Laplace) approximation; all in scaled units.

    Attributes:
        weights: (P,).
        precisions: (4,) prior precision of each of `GROUPS`.
        noise: (k,) standard deviation of scaled deflections.
        covariance: (P, P) of the weights.
        log_evidence: Of the scaled deflections, without the equal modes that changing neurons' places gives.
        effective: Number of weights that the data determine (MacKay's gamma).
    """

    weights: Array
    precisions: Array
    noise: Array
    covariance: Array
    log_evidence: float
    effective: float


def find_modes(
    problem: NetworkProblem,
    starts: int = 10,
    seed: int = 0,
    iterations: int = 160,
    damping: Damping = RELATIVE,
) -> tuple[Mode, ...]:
    """Return the posterior's maxima reached from random starts, that of the highest evidence first."""
    begun = start_weights(problem, starts, seed)
    modes = in_order(partial(find_mode, problem, start, iterations, damping) for start in begun)
    return tuple(sorted(modes, key=lambda mode: -mode.log_evidence))


def find_mode(
    problem: NetworkProblem,
    start: Array,
    iterations: int = 160,
    damping: Damping = RELATIVE,
) -> Mode:
    """Return the maximum near (P,) start weights, precisions and noise re-estimated after every few steps.

    That of the highest evidence on the way is taken: the fixed point is approached, but not always uphill.
    """
    mode = Mode(start, np.full(len(GROUPS), 0.1), np.full(problem.size, FIRST_NOISE), np.empty((0, 0)), -np.inf, 0.0)
    best, mu, before = mode, damping.start, -np.inf
    precisions, noise = mode.precisions, mode.noise
    for _ in range(0, iterations, STEPS):
        mode, mu = _climbed(problem, replace(mode, precisions=precisions, noise=noise), replace(damping, start=mu))
        best = max(best, mode, key=lambda mode: mode.log_evidence)
        if abs(mode.log_evidence - before) < 0.01:
            break
        before, (precisions, noise) = mode.log_evidence, reestimated(problem, mode)
    return _climbed(problem, best, damping)[0]


def _climbed(problem: NetworkProblem, mode: Mode, damping: Damping) -> tuple[Mode, float]:
    """Return the mode some steps further up at its own precisions and noise, and the damping to go on with."""
    objective = Weighted(problem, mode.precisions[problem.groups], mode.noise, solves=True)
    found = minimise(objective, mode.weights, STEPS, 1e-6, damping)
    return laplace(problem, found.weights, mode.precisions, mode.noise), min(found.mu, 1.0)


def laplace(problem: NetworkProblem, weights: Array, precisions: Array, noise: Array) -> Mode:
    """Return the Gaussian approximation about (P,) weights at given precisions and noise."""
    objective = Weighted(problem, precisions[problem.groups], noise)
    point = objective.evaluate(weights)
    lower = np.tril(objective.normal(point)[1]) / objective.unit
    own = precisions[problem.groups]
    covariance, log_determinant = _inverse(lower + np.tril(lower, -1).T, own.min())
    occam = 0.5 * (np.log(own).sum() - log_determinant)
    scale = len(problem.x) * np.log(noise * np.sqrt(2.0 * np.pi)).sum()
    return Mode(
        weights,
        precisions,
        noise,
        covariance,
        float(-point.cost / objective.unit + occam - scale),
        float(len(weights) - own @ np.diag(covariance)),
    )


def _inverse(matrix: Array, least: float) -> tuple[Array, float]:
    """Return the inverse and log determinant of a matrix whose eigenvalues are `least` or more but for rounding."""
    factor, failed = dpotrf(matrix, lower=1)
    if failed:  # data almost without noise: the prior is lost beside them
        values, vectors = np.linalg.eigh(matrix)
        values = np.maximum(values, least)
        return (vectors / values) @ vectors.T, float(np.log(values).sum())
    lower = np.tril(dpotri(factor, lower=1)[0])
    return lower + np.tril(lower, -1).T, 2.0 * float(np.log(np.diag(factor)).sum())


def reestimated(problem: NetworkProblem, mode: Mode) -> tuple[Array, Array]:
    """Return (4,) precisions and (k,) noise by MacKay's fixed point: each group's, each output's determined weights."""
    count = np.bincount(problem.groups)
    left = np.bincount(problem.groups, np.diag(mode.covariance)) * mode.precisions
    squares = np.bincount(problem.groups, mode.weights**2)
    precisions = np.clip((count - left) / np.maximum(squares, 1e-300), *PRECISIONS)
    errors = predictions(problem, mode.weights) - problem.y
    gradient = jacobian(problem, mode.weights)
    used = ((gradient @ mode.covariance) * gradient).sum(axis=(0, 2)) / mode.noise**2
    variance = (errors**2).sum(axis=0) / np.maximum(len(errors) - used, 1e-3 * len(errors))
    return precisions, np.clip(np.sqrt(variance), *NOISES)
