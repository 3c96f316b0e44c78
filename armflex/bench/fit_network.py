"""One hidden layer of sigmoids trained on joint data: plainly as the paper does, or weighed by evidence."""

from __future__ import annotations

from typing import Any

import numpy as np

from armflex.bench.evidence import find_modes
from armflex.bench.fit_linear import seen_loads
from armflex.bench.fitted import Fitted
from armflex.bench.levenberg import PAPER, RELATIVE, Damping, minimise
from armflex.bench.network_problem import (
    GROUPS,
    NetworkProblem,
    Scaling,
    least_squares,
    scaled_problem,
    start_weights,
)
from armflex.conventions import Array
from armflex.errors import InputError, did_you_mean
from armflex.laws.joint.network import NetworkLaw, unpack

PRIORS = ("evidence",)
ITERATIONS, PLAIN_ITERATIONS = 160, 200


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
    if prior is None:
        return _fit_plain(
            problem,
            scaling,
            loads,
            start_weights(problem, starts, seed),
            iterations or PLAIN_ITERATIONS,
            damping or PAPER,
        )
    if prior not in PRIORS:
        raise InputError(f"prior {prior!r} is not known{did_you_mean(prior, PRIORS)} (known: evidence, None)")
    best = find_modes(problem, starts, seed, iterations or ITERATIONS, damping or RELATIVE)[0]
    law = network_law(best.weights, best.noise, scaling, loads, best.covariance)
    found = {"effective": best.effective, "log_evidence": best.log_evidence}
    precisions = dict(zip(GROUPS, best.precisions.tolist(), strict=True))
    return Fitted(law, _described(problem, law) | found | {"prior": prior, "precisions": precisions})


def _described(problem: NetworkProblem, law: NetworkLaw) -> dict[str, Any]:
    return {"neurons": problem.neurons, "weights": problem.count, "noise": law.noise.tolist()}


def _fit_plain(
    problem: NetworkProblem, scaling: Scaling, loads: Array, starts: Array, iterations: int, damping: Damping
) -> Fitted:
    objective = least_squares(problem)
    found = min((minimise(objective, start, iterations, 1e-9, damping) for start in starts), key=lambda m: m.cost)
    squares = (objective.evaluate(found.weights).rest[1] ** 2).sum(axis=0)
    freedom = len(loads) - problem.count / problem.size
    # Fewer data than weights are followed exactly and say nothing of their noise: as doubtful as the data are wide.
    noise = np.sqrt(squares / freedom) if freedom >= 1.0 else np.ones(problem.size)
    law = network_law(found.weights, noise, scaling, loads)
    none = {"effective": float(problem.count), "log_evidence": None, "prior": None, "precisions": None}
    return Fitted(law, _described(problem, law) | none)


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
