"""A compliance by the paper's sampler: flat priors of its entries, Jeffreys' of the noise variances.

For a full or a diagonal compliance the posterior is known: each row is multivariate t with its mean at the least
squares of `armflex.bench.fit_linear`, which referees the chains. Rows that share no entry are independent of each other
and have chains of their own, which mix faster for being smaller.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from armflex.bench.fit_linear import FittedCompliance, basis_of, fit_compliance, least_scatter
from armflex.bench.fitted import Fitted
from armflex.conventions import Array
from armflex.parallel import in_order
from armflex.sampling.diagnostics import Diagnostics, check_converged, diagnose
from armflex.sampling.metropolis import Adaptation, adaptive_metropolis, scale_of


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


def fit_linear_chain(
    loads: Array,
    deflections: Array,
    structure: str = "full",
    *,
    seed: int = 0,
    draws: int | None = None,
    allow_unconverged: bool = False,
) -> Fitted:
    """Return the compliance of (N, k) loads and deflections as the mean of its posterior; see `sample_compliance`.

    Raises:
        InputError: The loads do not span the components.
        ConvergenceError: The chains have not converged, and `allow_unconverged` is not set.
    """
    posterior = sample_compliance(loads, deflections, structure, seed=seed, draws=draws)
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
    """Return draws of the compliance of (N, k) loads and deflections.

    Chains run where `joblib.parallel_config` says, with the same draws.

    Args:
        loads, deflections, structure: See `armflex.bench.fit_linear.fit_compliance`.
        seed: The same seed gives the same draws.
        chains: Number of chains, from starts drawn wider than the posterior.
        draws: Kept draws of each chain; None for as many as the parameters need.

    Raises:
        InputError: The loads do not span the components.
    """
    begun = time.perf_counter()
    closed = fit_compliance(loads, deflections, structure)
    basis = basis_of(loads.shape[1], structure)
    # Parameters of order one about the closed form: each entry's steps are its standard deviation there.
    stds = np.sqrt(np.array([np.diag(row) for row in closed.row_covariance]))
    entries = [np.unravel_index(matrix.argmax(), matrix.shape) for matrix in basis]
    moves = basis * np.array([stds[entry] for entry in entries])[:, None, None]
    tasks = [
        partial(_chain, closed.compliance, moves, loads, deflections, own, draws)
        for own in np.random.SeedSequence(seed).spawn(chains)
    ]
    found = list(in_order(tasks))
    parameters, variances = (np.array(each) for each in zip(*(one[:2] for one in found), strict=True))
    judged = np.concatenate([parameters, np.log(variances)], axis=2)
    acceptance = float(np.mean([one[2] for one in found]))
    diagnostics = diagnose(judged, acceptance=acceptance, seconds=time.perf_counter() - begun)
    return LinearPosterior(closed.compliance + np.tensordot(parameters, moves, axes=1), variances, diagnostics)


def _chain(
    centre: Array, moves: Array, loads: Array, deflections: Array, seed: np.random.SeedSequence, draws: int | None
) -> tuple[Array, Array, float]:
    """Return (n, P) parameters, (n, k) variances and the acceptance of one chain of every group of rows.

    Args:
        centre: (k, k) compliance where the parameters are zero.
        moves: (P, k, k) what each parameter adds.
        loads, deflections: (N, k).
        seed: Of the chain.
        draws: Kept draws, see `sample_compliance`.
    """
    rows = list(range(len(centre)))
    shared = (moves.any(axis=2).sum(axis=1) > 1).any()
    groups = [rows] if shared else [[row] for row in rows]
    found = []
    for own, stream in zip(groups, seed.spawn(len(groups)), strict=True):
        mine = moves[:, own].any(axis=(1, 2))
        size = int(mine.sum())
        squares = _squares(centre[own], moves[mine][:, own], loads, deflections[:, own], least_scatter(deflections))
        kept, burn_in = draws or 2000 + 1500 * size, 1000 + 200 * size
        start = 2.0 * np.random.default_rng(stream).standard_normal(size)
        # A tenth of the closed form's variance: entries are correlated, which the chain has yet to learn.
        adaptation = Adaptation(0.1 * scale_of(size) * np.eye(size), after=20 * size, every=10)
        chain = adaptive_metropolis(squares, len(loads), start, kept + burn_in, stream, adaptation, burn_in)
        found.append((mine, own, chain))
    count = len(found[0][2].draws)
    parameters, variances = np.empty((count, len(moves))), np.empty((count, len(centre)))
    for mine, own, chain in found:
        parameters[:, mine], variances[:, own] = chain.draws, chain.variances
    return parameters, variances, float(np.mean([chain.acceptance for *_, chain in found]))


def _squares(centre: Array, moves: Array, loads: Array, deflections: Array, floor: float) -> Callable[[Array], Array]:
    """Return parameters -> (r,) sums of squared residuals of r rows, each at least of a scatter `floor`.

    From the triangle R of the loads' QR: |y - F c| is |R (c - c')| but for what no row c of a compliance follows.
    """
    orthogonal, triangle = np.linalg.qr(loads)
    least = np.linalg.solve(triangle, orthogonal.T @ deflections).T
    rest = ((deflections - loads @ least.T) ** 2).sum(axis=0) + len(loads) * floor**2
    matrix = (moves @ triangle.T).reshape(len(moves), -1).T
    offset = ((centre - least) @ triangle.T).reshape(-1)

    def squares(parameters: Array) -> Array:
        off = (matrix @ parameters + offset).reshape(centre.shape)
        return np.add.reduce(off * off, axis=1) + rest

    return squares
