"""A chain of the paper's over the weights of a network: adaptive Metropolis on all of them, noise by Gibbs.

It does not mix, and its diagnostics say so; what does is NUTS with the output layer integrated out.
"""

from __future__ import annotations

import numpy as np

from armflex.bench.collapsed import Collapsed
from armflex.bench.evidence import laplace
from armflex.bench.fit_bayesian import Drawn
from armflex.bench.network_problem import predictions
from armflex.bench.paper.metropolis import Adaptation, adaptive_metropolis_gibbs, scale_of
from armflex.conventions import Array

KEPT = 1000
"""Most draws of a chain that are looked at: a random walk's neighbours say the same."""

ADAPT_EVERY = 100


def network_chain(density: Collapsed, mode: Array, draws: int, seed: np.random.SeedSequence) -> Drawn:
    """Return a chain that starts better than the paper's, from a maximum and the covariance there.

    Args:
        density: Of hidden layer and noise; its problem and prior are those of the chain.
        mode: (d,) a maximum of it.
        draws: Steps after as many of burn-in.
        seed: The same seed gives the same chain.
    """
    problem, prior = density.problem, density.prior
    own = prior.precisions[problem.groups]
    start, noise = density.mean(mode), density.noise(mode)
    covariance = scale_of(problem.count) * laplace(problem, start, prior.precisions, noise).covariance
    chain = adaptive_metropolis_gibbs(
        lambda weights: ((predictions(problem, weights) - problem.y) ** 2).sum(axis=0),
        len(problem.x),
        start,
        2 * draws,
        seed,
        Adaptation(covariance, after=10 * problem.count, every=ADAPT_EVERY),
        burn_in=draws,
        log_prior=lambda weights: -0.5 * float(own @ weights**2),
        noise_prior=(prior.noise_shape, prior.noise_scale),
    )
    stride = -(-draws // KEPT)
    return Drawn(chain.draws[::stride], np.sqrt(chain.variances[::stride]), None, chain.acceptance)
