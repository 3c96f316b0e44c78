"""A compliance from joint data the paper's way: adaptive Metropolis on its entries, Gibbs on the noise variances.

Entries have flat priors, variances Jeffreys'. For a full or a diagonal compliance the posterior is known: each row is
multivariate t with its mean at the least squares of `armflex.bench.fit_linear`, which referees the chains. Rows that
share no entry are independent of each other and have chains of their own, which mix faster for being smaller.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from armflex.bench.fit_linear import FittedCompliance, basis_of, fit_compliance, least_scatter
from armflex.bench.fitted import Fitted
from armflex.bench.paper.metropolis import Adaptation, Chain, adaptive_metropolis_gibbs, scale_of
from armflex.conventions import Array
from armflex.parallel import in_order
from armflex.sampling.diagnostics import Diagnostics, check_converged, diagnose


@dataclass(frozen=True)
class LinearPosterior:
    """Draws of a compliance and of the noise.

    Attributes:
        compliances: (chains, n, k, k) [m/N, ...].
        variances: (chains, n, k) of the noise [m^2, rad^2].
        diagnostics: On the free entries, which are the predictions of unit loads, and the logarithms of the variances.
    """

    compliances: Array
    variances: Array
    diagnostics: Diagnostics

    def fitted(self) -> FittedCompliance:
        """Return the posterior's mean, the covariance of each row, and the root of the mean noise variance."""
        size = self.compliances.shape[-1]
        draws = self.compliances.reshape(-1, size, size)
        rows = np.array([np.cov(draws[:, i], rowvar=False) for i in range(size)])
        return FittedCompliance(draws.mean(axis=0), rows, np.sqrt(self.variances.reshape(-1, size).mean(axis=0)))


@dataclass(frozen=True)
class _Scaled:
    """A compliance as (P,) parameters of order one about the closed form: C = centre + sum_p u_p steps_p.

    Attributes:
        centre: (k, k).
        steps: (P, k, k), each parameter's basis times its closed-form standard deviation.
    """

    centre: Array
    steps: Array

    def compliances(self, draws: Array) -> Array:
        """Return the (..., k, k) compliances of (..., P) parameters."""
        return self.centre + np.tensordot(draws, self.steps, axes=1)


def fit_linear_chain(
    loads: Array,
    deflections: Array,
    structure: str = "full",
    *,
    seed: int = 0,
    chains: int = 4,
    draws: int | None = None,
    allow_unconverged: bool = False,
) -> Fitted:
    """Return the compliance of (N, k) loads and deflections as the mean of its posterior.

    Args:
        loads, deflections, structure: See `armflex.bench.fit_linear.fit_compliance`.
        seed: The same seed gives the same law.
        chains: Number of chains, from starts drawn wider than the posterior.
        draws: Kept draws of each chain; None for as many as the parameters need.
        allow_unconverged: Return what chains found that have not converged.

    Raises:
        InputError: The loads do not span the components.
        ConvergenceError: The chains have not converged.
    """
    posterior = sample_compliance(loads, deflections, structure, seed=seed, chains=chains, draws=draws)
    check_converged(posterior.diagnostics, allow_unconverged)
    found = posterior.fitted()
    parameters = {
        "structure": structure,
        "compliance": found.compliance.tolist(),
        "unit": "m/N, rad/Nm",
        "noise_std": found.residual_std.tolist(),
    }
    return Fitted(found.law(loads), parameters, posterior.diagnostics)


def sample_compliance(
    loads: Array,
    deflections: Array,
    structure: str = "full",
    *,
    seed: int = 0,
    chains: int = 4,
    draws: int | None = None,
) -> LinearPosterior:
    """Return draws of the compliance of (N, k) loads and deflections; see `fit_linear_chain`.

    Chains run where `joblib.parallel_config` says, with the same draws.
    """
    begun = time.perf_counter()
    scaled = _scaled(loads, deflections, structure)
    seeds = np.random.SeedSequence(seed).spawn(chains)
    found = list(in_order(partial(_chain, scaled, loads, deflections, each, draws) for each in seeds))
    parameters, variances = (np.array(each) for each in zip(*(one[:2] for one in found), strict=True))
    judged = np.concatenate([parameters, np.log(variances)], axis=2)
    acceptance = float(np.mean([one[2] for one in found]))
    diagnostics = diagnose(judged, acceptance=acceptance, seconds=time.perf_counter() - begun)
    return LinearPosterior(scaled.compliances(parameters), variances, diagnostics)


def _scaled(loads: Array, deflections: Array, structure: str) -> _Scaled:
    closed = fit_compliance(loads, deflections, structure)
    basis = basis_of(loads.shape[1], structure)
    stds = np.sqrt(np.array([np.diag(row) for row in closed.row_covariance]))
    entry = [np.unravel_index(matrix.argmax(), matrix.shape) for matrix in basis]
    return _Scaled(closed.compliance, basis * np.array([stds[i] for i in entry])[:, None, None])


def _chain(
    scaled: _Scaled, loads: Array, deflections: Array, seed: np.random.SeedSequence, draws: int | None
) -> tuple[Array, Array, float]:
    """Return (n, P) parameters, (n, k) variances and the acceptance of one chain of every group of rows."""
    groups = _groups(scaled.steps)
    floor = least_scatter(deflections)
    parts = []
    for rows, own in zip(groups, seed.spawn(len(groups)), strict=True):
        mine = scaled.steps[:, rows].any(axis=(1, 2))
        squares = _squares(scaled.centre[rows], scaled.steps[mine][:, rows], loads, deflections[:, rows], floor)
        parts.append((mine, rows, _walk(squares, int(mine.sum()), len(loads), own, draws)))
    count = len(parts[0][2].draws)
    parameters, variances = np.empty((count, len(scaled.steps))), np.empty((count, loads.shape[1]))
    for mine, rows, chain in parts:
        parameters[:, mine], variances[:, rows] = chain.draws, chain.variances
    return parameters, variances, float(np.mean([chain.acceptance for _, _, chain in parts]))


def _groups(steps: Array) -> list[list[int]]:
    """Return the rows of the compliance in groups that share no parameter: each alone, or all where any is shared."""
    rows = list(range(steps.shape[1]))
    shared = (steps.any(axis=2).sum(axis=1) > 1).any()
    return [rows] if shared else [[row] for row in rows]


def _walk(
    squares: Callable[[Array], Array], size: int, rows: int, seed: np.random.SeedSequence, draws: int | None
) -> Chain:
    draws, burn_in = draws or 2000 + 1500 * size, 1000 + 200 * size
    start = 2.0 * np.random.default_rng(seed).standard_normal(size)
    # A tenth of the closed form's variance: entries are correlated, which the chain has yet to learn.
    adaptation = Adaptation(0.1 * scale_of(size) * np.eye(size), after=20 * size, every=10)
    return adaptive_metropolis_gibbs(squares, rows, start, draws + burn_in, seed, adaptation, burn_in)


def _squares(centre: Array, steps: Array, loads: Array, deflections: Array, floor: float) -> Callable[[Array], Array]:
    """Return parameters -> (r,) sums of squared residuals of r rows, from the triangle R of the loads' QR.

    Args:
        centre: (r, k) rows of the compliance where the parameters are zero.
        steps: (P, r, k) what each parameter adds.
        loads: (N, k).
        deflections: (N, r).
        floor: Scatter that every residual has at least.
    """
    orthogonal, triangle = np.linalg.qr(loads)
    least = np.linalg.solve(triangle, orthogonal.T @ deflections).T
    rest = ((deflections - loads @ least.T) ** 2).sum(axis=0) + len(loads) * floor**2
    matrix = (steps @ triangle.T).reshape(len(steps), -1).T
    offset = ((centre - least) @ triangle.T).reshape(-1)

    def squares(parameters: Array) -> Array:
        off = (matrix @ parameters + offset).reshape(centre.shape)
        return np.add.reduce(off * off, axis=1) + rest

    return squares
