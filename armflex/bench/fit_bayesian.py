"""Posterior of a network (the paper's eqs (20) to (24)): many networks, whose predictions are averaged.

Eq. (24) is printed with the prior ratio inverted; a step is accepted with p(D|w*) p(w*) / (p(D|w) p(w)). The paper
averages weights: that is the prediction of no network, as neurons can change places, so predictions are averaged here,
and convergence is judged on predictions and on the noise, never on weights.

Three ways to find it:
    laplace: a Gaussian about the best maximum, priors and noise by evidence. Fast; its errors are a third larger.
    nuts: hidden layer and noise sampled with the output layer integrated out, which is then drawn exactly.
    metropolis: the paper's adaptive Metropolis on all weights, noise by Gibbs. It does not mix, and says so.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from armflex.bench.collapsed import Collapsed, Prior, maximum, whitening
from armflex.bench.evidence import find_modes
from armflex.bench.fit_network import fit_network, network_law
from armflex.bench.fitted import Fitted
from armflex.bench.network_problem import GROUPS, NetworkProblem, predictions, scaled_problem, start_weights
from armflex.conventions import Array
from armflex.errors import InputError, UnknownNameError
from armflex.parallel import in_order
from armflex.sampling.diagnostics import Diagnostics, check_converged, diagnose, has_converged, judges
from armflex.sampling.nuts import no_u_turn

SAMPLERS = ("laplace", "nuts", "metropolis")
DRAWS = {"nuts": 1000, "metropolis": 50_000}
"""Of each chain unless asked otherwise; what comes before them is not counted."""

STARTS = 3
"""Trainings for a Laplace approximation, which is there to be fast, and for the precisions of a prior."""

TUNE = 300
ATTEMPTS = ({"depth": 5, "accept": 0.9}, {"depth": 8, "accept": 0.97})
"""Trajectories of NUTS, and those of a second attempt where the first has not converged. With noise of 1 % of the
deflections the short ones give three times as many effective predictions a second; with 0.1 %, where the posterior is
far more curved, they do not get around at all, and longer steps diverge now and then."""

NETWORKS = 200
"""Most networks in a law. Their average is within 1/14 of a posterior deviation of that of all."""

FIRST_NOISE = 0.1
PRECISIONS = (1e-2, 1e2)


@dataclass(frozen=True)
class Posterior:
    """Draws of a network and its noise, in scaled units.

    Attributes:
        problem: The data.
        weights: (chains, n, P).
        noise: (chains, n, k).
        diagnostics: On predictions at the training loads and log noise.
        parts: "predictions" and "noise", each judged alone.
    """

    problem: NetworkProblem
    weights: Array
    noise: Array
    diagnostics: Diagnostics
    parts: dict[str, Diagnostics]


def fit_bayesian(
    loads: Array,
    deflections: Array,
    neurons: int = 20,
    sampler: str = "laplace",
    seed: int = 0,
    chains: int = 4,
    draws: int | None = None,
    allow_unconverged: bool = False,
    prior: Prior | None = None,
) -> Fitted:
    """Return a network's posterior as a law that averages the predictions of up to 200 networks drawn from it.

    Args:
        loads: (N, k) [N, Nm], k = 3 or 6.
        deflections: (N, k) [m, rad].
        neurons: Hidden neurons.
        sampler: "laplace", "nuts" (in two attempts, the second with longer trajectories) or "metropolis".
        seed: Of starts and chains.
        chains: Each starts from another maximum.
        draws: Of each chain, after tuning or burn-in; by default 1000 for nuts, 50 000 for metropolis.
        allow_unconverged: Return what was found and its diagnostics even where they say that it is not the posterior.
        prior: Of weights and noise in scaled units for nuts and metropolis; `evident_prior` by default.

    Raises:
        UnknownNameError: No such sampler.
        InputError: The loads do not span their components, or an argument is impossible.
        ConvergenceError: R-hat is 1.01 or more, fewer than 400 draws are effective, or trajectories diverged.
        NotFiniteError: The density is no number where a chain starts.
        UnsupportedError: nutpie or arviz-stats, of the extra `bayes`, is not installed.
    """
    if sampler not in SAMPLERS:
        raise UnknownNameError("sampler", sampler, SAMPLERS)
    if sampler == "laplace":
        found = fit_network(loads, deflections, neurons, starts=STARTS, seed=seed)
        return Fitted(found.law, {**found.parameters, "sampler": sampler})
    problem, scaling = scaled_problem(loads, deflections, neurons)
    prior = prior or evident_prior(problem, seed)
    posterior = sample(problem, sampler, seed, chains, draws or DRAWS[sampler], prior)
    check_converged(posterior.diagnostics, allow_unconverged)
    weights, noise = (part.reshape(-1, part.shape[-1]) for part in (posterior.weights, posterior.noise))
    chosen = np.unique(np.linspace(0, len(weights) - 1, NETWORKS).round().astype(int))
    law = network_law(weights[chosen], np.sqrt((noise**2).mean(axis=0)), scaling, loads)
    return Fitted(law, _parameters(posterior, sampler, prior, law.noise, len(chosen)), posterior.diagnostics)


def evident_prior(problem: NetworkProblem, seed: int) -> Prior:
    """Return the prior whose precisions the data themselves make most likely, within bounds that leave all groups free.

    On 91 rows with quadratic terms they halved the error variance on new loads that unit precisions gave: a network
    that is nearly linear wants small hidden and large output weights.
    """
    return Prior(np.clip(find_modes(problem, STARTS, seed)[0].precisions, *PRECISIONS))


def sample(problem: NetworkProblem, sampler: str, seed: int, chains: int, draws: int, prior: Prior) -> Posterior:
    """Return the draws of "nuts" or "metropolis" with what they are worth, converged or not.

    Chains run where `joblib.parallel_config` says, with the same draws.

    Raises:
        InputError: Fewer than two chains or than four draws.
        NotFiniteError, UnsupportedError: As `fit_bayesian`.
    """
    if chains < 2 or draws < 4:
        raise InputError(f"{chains} chains of {draws} draws: expected at least 2 of 4, to compare them")
    judges()  # where the library for it is missing, say so before hours of work
    began, density = time.perf_counter(), Collapsed(problem, prior)
    noise = np.full(problem.size, FIRST_NOISE)
    starts = [density.start(weights, noise) for weights in start_weights(problem, chains, seed)]
    modes = list(in_order(partial(maximum, density, start) for start in starts))
    for walk in WALKS[sampler]:
        seeds = np.random.SeedSequence(seed).spawn(chains)
        walks = (partial(walk, density, mode, draws, own) for mode, own in zip(modes, seeds, strict=True))
        found = list(in_order(walks))
        posterior = _judged(problem, found, time.perf_counter() - began)
        if has_converged(posterior.diagnostics):
            break
    return posterior


@dataclass(frozen=True)
class Drawn:
    """One chain: (n, P) `weights`, (n, k) `noise`, and how its steps went."""

    weights: Array
    noise: Array
    divergences: int | None
    acceptance: float


def _nuts_chain(density: Collapsed, mode: Array, draws: int, seed: np.random.SeedSequence, **aims: Any) -> Drawn:
    sampling, drawing = seed.spawn(2)
    walk = no_u_turn(density, mode, whitening(density, mode), draws, TUNE, sampling, **aims)
    rng = np.random.default_rng(drawing)
    weights = np.array([density.redraw(theta, rng) for theta in walk.draws])
    return Drawn(weights, density.noise(walk.draws), walk.divergences, walk.acceptance)


def _metropolis_chain(density: Collapsed, mode: Array, draws: int, seed: np.random.SeedSequence) -> Drawn:
    from armflex.bench.paper.network_chain import network_chain  # for the paper's reproduction alone

    return network_chain(density, mode, draws, seed)


WALKS = {"nuts": tuple(partial(_nuts_chain, **aims) for aims in ATTEMPTS), "metropolis": (_metropolis_chain,)}
"""Sampler -> ways to draw a chain, tried in turn until one has converged."""


def _judged(problem: NetworkProblem, chains: list[Drawn], seconds: float) -> Posterior:
    weights, noise = (np.array([getattr(chain, name) for chain in chains]) for name in ("weights", "noise"))
    given = np.array([predictions(problem, each) for each in weights])
    parts = {"predictions": diagnose(given.reshape(*given.shape[:2], -1)), "noise": diagnose(np.log(noise))}
    lost = [chain.divergences for chain in chains if chain.divergences is not None]
    divergences = sum(lost) if len(lost) == len(chains) else None
    acceptance = float(np.mean([chain.acceptance for chain in chains]))
    rhat_max, ess_min = (
        float(worst(np.array([getattr(part, name) for part in parts.values()], dtype=float)))
        for worst, name in ((np.max, "rhat_max"), (np.min, "ess_min"))  # they pass NaN on
    )
    whole = Diagnostics(rhat_max, ess_min, divergences, acceptance, seconds)
    return Posterior(problem, weights, noise, whole, parts)


def _parameters(posterior: Posterior, sampler: str, prior: Prior, noise: Array, networks: int) -> dict[str, object]:
    chains, draws, count = posterior.weights.shape
    judged = {name: {"rhat_max": part.rhat_max, "ess_min": part.ess_min} for name, part in posterior.parts.items()}
    return {
        "neurons": posterior.problem.neurons,
        "weights": count,
        "noise": noise.tolist(),
        "sampler": sampler,
        "chains": chains,
        "draws": draws,
        "networks": networks,
        "precisions": dict(zip(GROUPS, prior.precisions.tolist(), strict=True)),
        "judged": judged,
    }
