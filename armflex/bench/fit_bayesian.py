"""Posterior of a network (the paper's eqs (20) to (24)): many networks, whose predictions are averaged.

Eq. (24) is printed with the prior ratio inverted; a step is accepted with p(D|w*) p(w*) / (p(D|w) p(w)). The paper
averages weights: that is the prediction of no network, as neurons can change places, so predictions are averaged here,
and convergence is judged on predictions and on the noise, never on weights.

Three ways to find it:
    laplace: a Gaussian about the best maximum, priors and noise by evidence. Fast; its errors are a third larger.
    nuts: hidden layer and noise sampled with the output layer integrated out, which is then drawn exactly.
    metropolis: the paper's adaptive Metropolis on all weights, noise by Gibbs. It does not mix, and says so.

The output layer is integrated out as follows, all in scaled units: y = B v + noise, B the hidden values and a column of
ones. Given the hidden layer and the noise s_k, output k's weights v_k have a Gaussian prior of precision P, so that

    p(y_k | hidden, s_k) = N(0, s_k^2 I + B P^-1 B^T),    v_k | y_k, hidden, s_k = N(m_k, G_k^-1),
    G_k = B^T B / s_k^2 + P,    G_k m_k = B^T y_k / s_k^2.

What is left to sample is small and far less curved than the whole; v_k is drawn exactly afterwards. The determinant
lemma gives |s^2 I + B P^-1 B^T| = s^2N |G| / |P|, and the quadratic form is the least of a sum of squares, written
as |y - B m|^2 / s^2 + m P m rather than as a difference of large numbers.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri  # several small factors: numpy's wrappers take longer than the work
from scipy.optimize import minimize
from scipy.special import gammaln

from armflex.bench.fit_network import find_modes, fit_network, laplace, network_law
from armflex.bench.fitted import Fitted
from armflex.bench.learners import SAMPLERS as SAMPLERS
from armflex.bench.network_problem import GROUPS, NetworkProblem, predictions, scaled_problem, start_weights
from armflex.conventions import Array
from armflex.errors import InputError, NotFiniteError, UnknownNameError
from armflex.parallel import in_order
from armflex.sampling.diagnostics import Diagnostics, check_converged, diagnose, judges, shortcomings
from armflex.sampling.nuts import no_u_turn

DRAWS = {"nuts": 1000, "metropolis": 50_000}
"""Of each chain unless asked otherwise; what comes before them is not counted."""

STARTS = 3
"""Trainings for a Laplace approximation, which is there to be fast, and for the precisions of a prior."""

TUNE = 300
ATTEMPTS = ({"depth": 5, "accept": 0.9}, {"depth": 8, "accept": 0.97})
"""Trajectories of NUTS, and those of a second attempt where the first has not converged. With noise of 1 % of the
deflections the short ones give three times as many effective predictions a second; with 0.1 %, where the posterior is
far more curved, they do not get around at all, and longer steps diverge now and then."""


@dataclass(frozen=True)
class NetworkPrior:
    """The prior of the parameters, in scaled units.

    Attributes:
        precisions: (4,) of the Gaussian prior of each of `GROUPS`, all with mean zero.
        noise_shape, noise_scale: Of the inverse gamma prior of each s_k^2. As they stand they are worth one reading
            with an error of 1/1000 of its column's spread, so that data without noise still have a posterior.
    """

    precisions: Array = field(default_factory=lambda: np.ones(len(GROUPS)))
    noise_shape: float = 0.5
    noise_scale: float = 0.5e-6

    def __post_init__(self) -> None:
        positive = np.append(self.precisions, [self.noise_shape, self.noise_scale])
        if np.shape(self.precisions) != (len(GROUPS),) or not (positive > 0.0).all() or np.isinf(positive).any():
            raise InputError(f"prior of a network: expected {len(GROUPS)} precisions, a shape and a scale above 0")


@dataclass(frozen=True)
class ChainDraws:
    """One chain: (n, P) `weights`, (n, k) `noise`, and how its steps went."""

    weights: Array
    noise: Array
    divergences: int | None
    acceptance: float


@dataclass(frozen=True)
class Posterior:
    """Draws of a network and its noise, in scaled units.

    Attributes:
        weights: (chains, n, P).
        noise: (chains, n, k).
        diagnostics: On predictions at the training loads and log noise.
        parts: "predictions" and "noise", each judged alone.
    """

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
    prior: NetworkPrior | None = None,
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
        network = fit_network(loads, deflections, neurons, starts=STARTS, seed=seed)
        return Fitted(network.law, {**network.parameters, "sampler": sampler})
    problem, scaling = scaled_problem(loads, deflections, neurons)
    prior = prior or evident_prior(problem, seed)
    posterior = sample(problem, sampler, seed, chains, draws or DRAWS[sampler], prior)
    check_converged(posterior.diagnostics, allow_unconverged)
    weights, noise = (part.reshape(-1, part.shape[-1]) for part in (posterior.weights, posterior.noise))
    # Most networks in a law. Their average is within 1/14 of a posterior deviation of that of all.
    chosen = np.unique(np.linspace(0, len(weights) - 1, 200).round().astype(int))
    law = network_law(weights[chosen], np.sqrt((noise**2).mean(axis=0)), scaling, loads)
    parts = posterior.parts.items()
    parameters = {
        "neurons": neurons,
        "weights": problem.count,
        "noise": law.noise.tolist(),
        "sampler": sampler,
        "chains": chains,
        "draws": posterior.weights.shape[1],
        "networks": len(chosen),
        "precisions": dict(zip(GROUPS, prior.precisions.tolist(), strict=True)),
        "judged": {name: {"rhat_max": part.rhat_max, "ess_min": part.ess_min} for name, part in parts},
    }
    return Fitted(law, parameters, posterior.diagnostics)


def evident_prior(problem: NetworkProblem, seed: int) -> NetworkPrior:
    """Return the prior whose precisions the data themselves make most likely, within bounds that leave all groups free.

    On 91 rows with quadratic terms they halved the error variance on new loads that unit precisions gave: a network
    that is nearly linear wants small hidden and large output weights.
    """
    return NetworkPrior(np.clip(find_modes(problem, STARTS, seed)[0].precisions, 1e-2, 1e2))


def sample(problem: NetworkProblem, sampler: str, seed: int, chains: int, draws: int, prior: NetworkPrior) -> Posterior:
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
    noise = np.full(problem.size, 0.1)
    starts = [density.start(weights, noise) for weights in start_weights(problem, chains, seed)]
    modes = list(in_order(partial(maximum, density, start) for start in starts))
    for walk in WALKS[sampler]:
        seeds = np.random.SeedSequence(seed).spawn(chains)
        pairs = zip(modes, seeds, strict=True)
        walks = list(in_order(partial(walk, density, mode, draws, sequence) for mode, sequence in pairs))
        posterior = _judged(problem, walks, time.perf_counter() - began)
        if not shortcomings(posterior.diagnostics):
            break
    return posterior


def _judged(problem: NetworkProblem, chains: list[ChainDraws], seconds: float) -> Posterior:
    weights, noise = (np.array([getattr(chain, name) for chain in chains]) for name in ("weights", "noise"))
    given = np.array([predictions(problem, each) for each in weights])
    parts = {"predictions": diagnose(given.reshape(*given.shape[:2], -1)), "noise": diagnose(np.log(noise))}
    lost = [chain.divergences for chain in chains if chain.divergences is not None]
    divergences = sum(lost) if len(lost) == len(chains) else None
    acceptance = float(np.mean([chain.acceptance for chain in chains]))
    judged = np.array([(part.rhat_max, part.ess_min) for part in parts.values()], dtype=float)
    rhat_max, ess_min = float(np.max(judged[:, 0])), float(np.min(judged[:, 1]))  # they pass NaN on
    return Posterior(weights, noise, Diagnostics(rhat_max, ess_min, divergences, acceptance, seconds), parts)


def _nuts_chain(density: Collapsed, mode: Array, draws: int, seed: np.random.SeedSequence, **aims: Any) -> ChainDraws:
    sampling, drawing = seed.spawn(2)
    walk = no_u_turn(density, mode, whitening(density, mode), draws, TUNE, sampling, **aims)
    rng = np.random.default_rng(drawing)
    weights = np.array([density.redraw(theta, rng) for theta in walk.draws])
    return ChainDraws(weights, density.noise(walk.draws), walk.divergences, walk.acceptance)


def _metropolis_chain(density: Collapsed, mode: Array, draws: int, seed: np.random.SeedSequence) -> ChainDraws:
    """Return a chain that starts better than the paper's, from a maximum and the covariance there.

    As many steps of burn-in come before its draws.
    """
    from armflex.sampling.metropolis import (  # for the paper's reproduction alone
        Adaptation,
        adaptive_metropolis,
        scale_of,
    )

    problem, prior = density.problem, density.prior
    precisions, start = prior.precisions[problem.groups], density.mean(mode)
    covariance = scale_of(problem.count) * laplace(problem, start, prior.precisions, density.noise(mode)).covariance
    chain = adaptive_metropolis(
        lambda weights: ((predictions(problem, weights) - problem.y) ** 2).sum(axis=0),
        len(problem.x),
        start,
        2 * draws,
        seed,
        Adaptation(covariance, after=10 * problem.count, every=100),
        burn_in=draws,
        log_prior=lambda weights: -0.5 * float(precisions @ weights**2),
        noise_prior=(prior.noise_shape, prior.noise_scale),
    )
    # Most draws of a Metropolis chain that are looked at: a random walk's neighbours say the same.
    stride = -(-draws // 1000)
    return ChainDraws(chain.draws[::stride], np.sqrt(chain.variances[::stride]), None, chain.acceptance)


WALKS = {"nuts": tuple(partial(_nuts_chain, **aims) for aims in ATTEMPTS), "metropolis": (_metropolis_chain,)}
"""Sampler -> ways to draw a chain, tried in turn until one has converged."""


@dataclass(frozen=True)
class Collapsed:
    """Density of theta, d = H (k + 1) + k numbers: the hidden layer in the order of `layers`, then k log s."""

    problem: NetworkProblem
    prior: NetworkPrior = field(default_factory=NetworkPrior)

    @cached_property
    def _split(self) -> int:
        return self.problem.neurons * (self.problem.size + 1)

    @cached_property
    def _precisions(self) -> tuple[Array, Array]:
        """(H (k + 1),) of the hidden layer; (H + 1,) of one output's weights and offset, the diagonal of P."""
        hidden = self.prior.precisions[self.problem.groups[: self._split]]
        return hidden, self.prior.precisions[[2] * self.problem.neurons + [3]]

    @cached_property
    def _data(self) -> tuple[Array, Array]:
        """(k + 1, N) loads with ones and (k, N) deflections, both scaled and with rows last as the sums want them."""
        return np.ascontiguousarray(self.problem.inputs.T), np.ascontiguousarray(self.problem.y.T)

    @cached_property
    def _constant(self) -> float:
        """Logarithm of every factor that depends on the data's and the priors' numbers alone."""
        shape, scale, (hidden, output) = self.prior.noise_shape, self.prior.noise_scale, self._precisions
        noise = np.log(2.0) + shape * np.log(scale) - gammaln(shape)
        each = noise + 0.5 * (np.log(output).sum() - len(self.problem.x) * np.log(2.0 * np.pi))
        return float(self.problem.size * each + 0.5 * np.log(hidden / (2.0 * np.pi)).sum())

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Return log p(y, theta) and its (d,) gradient; NaN where a number overflows, for samplers to turn back."""
        with np.errstate(all="ignore"):
            return self._density(theta)

    def _density(self, theta: Array) -> tuple[float, Array]:
        log_noise, weights, (of_weights, output) = theta[self._split :], theta[: self._split], self._precisions
        basis, parts, means, halves = self._conditional(theta)
        errors = self._data[1] - means @ basis
        squares = np.einsum("kn,kn->k", errors, errors)
        log_roots = np.log(np.diagonal(halves, 0, 1, 2)).sum()  # of 1 / |G_k|, all outputs
        rows, pulls = len(self.problem.x) + 2.0 * self.prior.noise_shape, squares + 2.0 * self.prior.noise_scale
        cost = pulls @ parts + (means**2 @ output).sum() + weights @ (of_weights * weights)
        taken = np.einsum("kij,kij,j->k", halves, halves, output)  # tr(G^-1 P)
        # By the basis B it is sum_k ((y - B m) m^T - B G^-1) / s^2.
        scaled, hidden = (halves * np.sqrt(parts)[:, None, None]).reshape(-1, len(basis)), basis[:-1]
        slope = (means * parts[:, None])[:, :-1].T @ errors - (scaled[:, :-1].T @ scaled) @ basis
        slope *= hidden * (1.0 - hidden)
        pull = (slope @ self._data[0].T).ravel() - of_weights * weights
        gradient = np.concatenate([pull, pulls * parts + len(basis) - taken - rows])
        return float(self._constant + log_roots - rows * log_noise.sum() - 0.5 * cost), gradient

    def _conditional(self, theta: Array) -> tuple[Array, Array, Array, Array]:
        """Return B^T (H + 1, N), (k,) 1 / s_k^2, (k, H + 1) m_k, (k, H + 1, H + 1) inverse lower factors of G_k."""
        basis = np.ones((self.problem.neurons + 1, len(self.problem.x)))
        weights = theta[: self._split].reshape(self.problem.neurons, -1)
        basis[:-1] = 0.5 + 0.5 * np.tanh(0.5 * (weights @ self._data[0]))
        parts = np.exp(-2.0 * theta[self._split :])
        wanted = np.multiply.outer(parts, basis @ basis.T) + np.diag(self._precisions[1])
        halves = np.empty_like(wanted)
        for half, matrix in zip(halves, wanted, strict=True):
            factor, failed = dpotrf(matrix.T, lower=1, overwrite_a=1)  # transposed: LAPACK's own order, no copy
            half[:] = np.nan if failed else dtrtri(factor, lower=1, overwrite_c=1)[0]
        right = (self._data[1] @ basis.T) * parts[:, None]
        return basis, parts, ((halves @ right[:, :, None]).transpose(0, 2, 1) @ halves)[:, 0], halves

    def redraw(self, theta: Array, rng: np.random.Generator) -> Array:
        """Return (P,) weights of the whole network: those of theta, with an output layer drawn from its conditional."""
        *_, means, halves = self._conditional(theta)
        drawn = means + (halves.swapaxes(1, 2) @ rng.standard_normal((*means.shape, 1)))[..., 0]
        return np.concatenate([theta[: self._split], drawn.ravel()])

    def mean(self, theta: Array) -> Array:
        """Return (P,) weights of the whole network: those of theta, with the mean of the output layer."""
        return np.concatenate([theta[: self._split], self._conditional(theta)[2].ravel()])

    def noise(self, theta: Array) -> Array:
        """Return the (..., k) scaled noise in (..., d) thetas."""
        return np.exp(theta[..., self._split :])

    def start(self, weights: Array, noise: Array) -> Array:
        """Return the theta of (P,) weights of a whole network and (k,) scaled noise."""
        return np.concatenate([weights[: self._split], np.log(noise)])


def maximum(density: Collapsed, start: Array) -> Array:
    """Return the (d,) maximum of the density near a start, by quasi-Newton steps (L-BFGS).

    Raises:
        NotFiniteError: The density is not finite at the start, or where the search ends.
    """

    def falling(theta: Array) -> tuple[float, Array]:
        value, gradient = density(theta)
        return (-value, -gradient) if np.isfinite(value) else (1e300, np.zeros_like(gradient))

    if not np.isfinite(density(start)[0]):
        raise NotFiniteError("log density of a network is not finite where the search for its maximum starts")
    options = {"maxiter": 400, "maxcor": 30}
    weights = minimize(falling, start, jac=True, method="L-BFGS-B", options=options).x
    if not np.isfinite(density(weights)[0]):
        raise NotFiniteError("log density of a network is not finite where the search for its maximum ended")
    return weights


def whitening(density: Collapsed, theta: Array) -> Array:
    """Return the (d, d) W for which theta + W z has about unit curvature in every direction of z.

    The Hessian comes from central differences of the gradient. Curvatures of the wrong sign, as a search that ended
    early leaves them, count by their size.
    """
    step = 1e-5
    moves = step * np.eye(len(theta))
    hessian = np.array([density(theta - move)[1] - density(theta + move)[1] for move in moves]) / (2.0 * step)
    values, vectors = np.linalg.eigh(0.5 * (hessian + hessian.T))
    # Least curvature along which whitening believes the Hessian; a prior of precision 1 alone gives 1.
    return vectors / np.sqrt(np.maximum(np.abs(values), 0.5))
