"""One hidden layer of sigmoids trained on joint data: plainly as the paper does, or weighed by evidence.

Prior precisions and noise come from the data alone then: MacKay's evidence (1992), by Gauss-Newton matrices.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import get_lapack_funcs
from scipy.linalg.lapack import dpotrf

from armflex.bench.fitted import Fitted, seen_loads
from armflex.bench.network_problem import (
    GROUPS,
    PAPER,
    RELATIVE,
    Damping,
    NetworkProblem,
    Scaling,
    Weighted,
    jacobian,
    minimise,
    predictions,
    scaled_problem,
    start_weights,
    sum_of_squares,
)
from armflex.conventions import Array
from armflex.errors import InputError, did_you_mean
from armflex.laws.joint.network import NetworkLaw, unpack
from armflex.parallel import in_order

PRIORS = ("evidence",)


STEPS = 20
"""Of Levenberg-Marquardt between two re-estimations."""


def fit_network(
    loads: Array,
    deflections: Array,
    neurons: int = 20,
    starts: int = 10,
    seed: int = 0,
    prior: str | None = "evidence",
    iterations: int | None = None,
    damping: Damping | None = None,
) -> Fitted:
    """Return a network trained on loads and deflections from the best of many starts.

    Args:
        loads: (N, k) [N, Nm], k = 3 or 6.
        deflections: (N, k) [m, rad].
        neurons: Hidden neurons.
        starts: Random first weights to begin from.
        seed: Of those.
        prior: "evidence" for Gaussian priors whose precisions, like the noise, are found from the data; the law then
            has the weights' covariance. None for least squares as the paper does it, which follows noise too.
        iterations: Most steps of Levenberg-Marquardt per start; 160 with a prior and 200 without where not given.
        damping: Its schedule; with a prior `RELATIVE`, without `PAPER` where not given.

    Raises:
        InputError: The loads do not span their components, or an argument is impossible.
    """
    problem, scaling = scaled_problem(loads, deflections, neurons)
    if prior is not None and prior not in PRIORS:
        raise InputError(f"prior {prior!r} is not known{did_you_mean(prior, PRIORS)} (known: evidence, None)")
    if prior:
        best = find_modes(problem, starts, seed, iterations or 160, damping or RELATIVE)[0]
        law = network_law(best.weights, best.noise, scaling, loads, best.covariance)
        precisions = dict(zip(GROUPS, best.precisions.tolist(), strict=True))
        evidence = {"effective": best.effective, "log_evidence": best.log_evidence}
    else:
        objective, most = sum_of_squares(problem), iterations or 200
        begun = start_weights(problem, starts, seed)
        minima = (minimise(objective, start, most, 1e-9, damping or PAPER) for start in begun)
        weights = min(minima, key=lambda minimum: minimum.cost).weights
        squares = (objective.evaluate(weights).rest[1] ** 2).sum(axis=0)
        freedom = len(loads) - problem.count / problem.size
        # Fewer data than weights are followed exactly and say nothing of their noise: as doubtful as the data are wide.
        noise = np.sqrt(squares / freedom) if freedom >= 1.0 else np.ones(problem.size)
        law, precisions = network_law(weights, noise, scaling, loads), None
        evidence = {"effective": float(problem.count), "log_evidence": None}
    described = {"neurons": neurons, "weights": problem.count, "noise": law.noise.tolist()}
    return Fitted(law, described | evidence | {"prior": prior, "precisions": precisions})


def network_law(
    weights: Array, noise: Array, scaling: Scaling, loads: Array, covariance: Array | None = None
) -> NetworkLaw:
    """Return the law of (P,) or (S, P) weights, with the (N, k) loads they were trained on and (k,) scaled noise."""
    mean, precision = loads.mean(axis=0), np.linalg.inv(np.cov(loads, rowvar=False))
    off = loads - mean
    distances = np.sqrt(np.einsum("ni,ij,nj->n", off, precision, off))
    return NetworkLaw(
        **unpack(weights, len(mean)),
        **vars(scaling),
        noise=noise * scaling.output_scale,
        weight_covariance=covariance,
        seen=seen_loads(loads),
        load_mean=mean,
        load_precision=0.5 * (precision + precision.T),
        furthest=float(distances.max()),
    )


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
    problem: NetworkProblem, starts: int = 10, seed: int = 0, iterations: int = 160, damping: Damping = RELATIVE
) -> tuple[Mode, ...]:
    """Return the posterior's maxima reached from random starts, that of the highest evidence first."""
    begun = start_weights(problem, starts, seed)
    modes = in_order(partial(_find_mode, problem, start, iterations, damping) for start in begun)
    return tuple(sorted(modes, key=lambda mode: -mode.log_evidence))


def _find_mode(problem: NetworkProblem, start: Array, iterations: int, damping: Damping) -> Mode:
    """Return the maximum near (P,) start weights, precisions and noise re-estimated after every few steps.

    That of the highest evidence on the way is taken: the fixed point is approached, but not always uphill.
    """

    def climbed(weights: Array, precisions: Array, noise: Array, mu: float) -> tuple[Mode, float]:
        objective = Weighted(problem, precisions[problem.groups], noise, solves=True)
        minimum = minimise(objective, weights, STEPS, 1e-6, replace(damping, start=mu))
        return laplace(problem, minimum.weights, precisions, noise), min(minimum.mu, 1.0)

    met: list[Mode] = []
    mu, before, weights = damping.start, -np.inf, start
    # Scaled, well above what it will be: who begins by following every row stays in a poor maximum.
    precisions, noise = np.full(len(GROUPS), 0.1), np.full(problem.size, 0.3)
    for _ in range(0, iterations, STEPS):
        mode, mu = climbed(weights, precisions, noise, mu)
        met.append(mode)
        if abs(mode.log_evidence - before) < 0.01:
            break
        before, weights, (precisions, noise) = mode.log_evidence, mode.weights, _reestimated(problem, mode)
    best = max(met, key=lambda mode: mode.log_evidence)
    return climbed(best.weights, best.precisions, best.noise, damping.start)[0]


def laplace(problem: NetworkProblem, weights: Array, precisions: Array, noise: Array) -> Mode:
    """Return the Gaussian approximation about (P,) weights at given precisions and noise."""
    precision = precisions[problem.groups]
    objective = Weighted(problem, precision, noise)
    point = objective.evaluate(weights)
    lower = np.tril(objective.normal(point)[1]) / objective.unit
    information = lower + np.tril(lower, -1).T
    factor, failed = dpotrf(information, lower=1)
    if failed:  # data almost without noise: the prior is lost beside them
        values, vectors = np.linalg.eigh(information)
        values = np.maximum(values, precision.min())
        covariance, log_determinant = (vectors / values) @ vectors.T, np.log(values).sum()
    else:
        (invert,) = get_lapack_funcs(("potri",), (factor,))
        lower = np.tril(invert(factor, lower=1)[0])
        covariance, log_determinant = lower + np.tril(lower, -1).T, 2.0 * np.log(np.diag(factor)).sum()
    occam = 0.5 * (np.log(precision).sum() - log_determinant)
    scale = len(problem.x) * np.log(noise * np.sqrt(2.0 * np.pi)).sum()
    evidence = float(occam - scale - point.cost / objective.unit)
    effective = float(len(weights) - precision @ np.diag(covariance))
    return Mode(weights, precisions, noise, covariance, evidence, effective)


def _reestimated(problem: NetworkProblem, mode: Mode) -> tuple[Array, Array]:
    """Return (4,) precisions and (k,) noise by MacKay's fixed point: each group's, each output's determined weights."""
    count = np.bincount(problem.groups)
    left = np.bincount(problem.groups, np.diag(mode.covariance)) * mode.precisions
    squares = np.bincount(problem.groups, mode.weights**2)
    precisions = np.clip((count - left) / np.maximum(squares, 1e-300), 1e-6, 1e6)
    errors = predictions(problem, mode.weights) - problem.y
    gradient = jacobian(problem, mode.weights)
    used = ((gradient @ mode.covariance) * gradient).sum(axis=(0, 2)) / mode.noise**2
    variance = (errors**2).sum(axis=0) / np.maximum(len(errors) - used, 1e-3 * len(errors))
    # Bounds of what is re-estimated, in scaled units: a group that is not needed, or data without noise, has no other
    return precisions, np.clip(np.sqrt(variance), 1e-6, 1e1)
