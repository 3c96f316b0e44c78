"""Adaptive Metropolis: a random walk whose steps are shaped like all that the chain has seen so far.

Haario, Saksman and Tamminen (2001), An adaptive Metropolis algorithm, Bernoulli 7(2); the paper's eqs (12) to (14).
Eq. (13) is printed with a running mean where the current draw belongs, see `updated`. Noise variances are drawn from
their exact conditional before every step (Gibbs).

The paper samples a compliance so. Its entries have flat priors, the noise variances Jeffreys'. For a full or a diagonal
compliance the posterior is known: each row is multivariate t with its mean at the least squares of
`armflex.bench.fit_linear`, which referees the chains. Rows that share no entry are independent of each other and have
chains of their own, which mix faster for being smaller.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg.lapack import dpotrf  # numpy's wrapper takes eight times as long on ten parameters

from armflex.bench.fit_linear import FittedCompliance, basis_of, fit_compliance, least_scatter
from armflex.bench.fitted import Fitted
from armflex.conventions import Array
from armflex.errors import InputError, NotFiniteError, ShapeError
from armflex.parallel import in_order
from armflex.sampling.diagnostics import Diagnostics, check_converged, diagnose


@dataclass(frozen=True)
class Adaptation:
    """How proposals are made; parameters are best scaled to be of order one, for `epsilon` counts alike in all.

    Attributes:
        covariance: (d, d) C_0 of the first proposals; None for s_d times the identity.
        after: i_0, the number of steps that keep C_0.
        epsilon: e, what keeps the covariance from becoming singular.
        every: Steps between two adaptations; 1 as in the paper, more saves time where there are many parameters.
    """

    covariance: Array | None = None
    after: int = 200
    epsilon: float = 1e-6
    every: int = 1

    def __post_init__(self) -> None:
        if self.after < 1 or self.every < 1 or not self.epsilon > 0.0:
            raise InputError(f"after {self.after}, every {self.every}, epsilon {self.epsilon:g}: expected more than 0")


@dataclass(frozen=True)
class Chain:
    """What a chain found after its burn-in.

    Attributes:
        draws: (n, d), one row a step.
        acceptance: Share of proposals accepted.
        covariance: (d, d) of the proposals at the end, s_d Cov + s_d e I.
        variances: (n, k) noise variances.
    """

    draws: Array
    acceptance: float
    covariance: Array
    variances: Array


@dataclass(frozen=True)
class Running:
    """What the draws so far say: their `count`, (d,) `mean` and (d, d) proposal `covariance` (C_i for i draws)."""

    count: int
    mean: Array
    covariance: Array


def adaptive_metropolis(
    squares: Callable[[Array], Array],
    rows: int,
    start: Array,
    steps: int,
    seed: int | np.random.SeedSequence,
    adaptation: Adaptation | None = None,
    burn_in: int | None = None,
    log_prior: Callable[[Array], float] | None = None,
    noise_prior: tuple[float, float] = (0.0, 0.0),
) -> Chain:
    """Return a chain of parameters and of the noise variances of k columns of normal residuals.

    The density is p(theta) prod_k (2 pi s_k^2)^(-n/2) exp(-squares_k / (2 s_k^2)) p(s_k^2): the paper's eq. (10), with
    its factor once per datum. Given theta, s_k^2 is inverse gamma and is drawn exactly. Without residuals, k = 0, it is
    the prior's.

    Args:
        squares: (d,) parameters -> (k,) sums of squared residuals.
        rows: n, residuals in each sum.
        start: (d,) where the density is not zero.
        steps: Number of steps, burn-in included.
        seed: The same seed gives the same chain.
        adaptation: How proposals are made.
        burn_in: Steps that are not kept; half of them by default.
        log_prior: Of the parameters, up to a constant, -inf where there is none; None for a flat one.
        noise_prior: Shape and scale of the inverse gamma prior of each variance; (0, 0) is Jeffreys' 1 / s^2.

    Raises:
        NotFiniteError: The density is NaN or infinite somewhere.
        InputError: `start` has no density; sizes or counts do not fit.
    """
    start, adaptation = np.asarray(start, dtype=float), adaptation or Adaptation()
    burn_in = steps // 2 if burn_in is None else burn_in
    if start.ndim != 1 or start.size == 0:
        raise ShapeError(f"start of a chain: expected (d,), got {start.shape}")
    if not 0 <= burn_in <= steps - 2:
        raise InputError(f"{steps} steps with a burn-in of {burn_in}: expected at least two steps to keep")
    size, rng, (shape, scale) = start.size, np.random.default_rng(seed), noise_prior
    covariance = scale_of(size) * np.eye(size) if adaptation.covariance is None else adaptation.covariance
    if covariance.shape != (size, size):
        raise ShapeError(f"start covariance: expected {(size, size)}, got {covariance.shape}")

    def terms(theta: Array) -> Array:
        """Return what the log density is a sum of, with weights that Gibbs steps change: prior and squares."""
        sums = squares(theta)
        found = np.empty(1 + len(sums))
        found[0], found[1:] = log_prior(theta) if log_prior else 0.0, sums
        return found

    theta, found, factor = start, terms(start), _factor(covariance)
    if not np.isfinite(found).all():
        raise NotFiniteError(f"a chain cannot start at {start}, where its log density is {found}")
    draws = rng.standard_normal((steps, size))  # holds the proposals' normals until draws take their place
    log_uniforms = np.log1p(-rng.random(steps))
    weights = np.ones((steps, found.size))
    running = Running(1, start, np.zeros((size, size)))
    for first in range(0, steps, adaptation.every):
        block = slice(first, first + adaptation.every)
        for row, log_uniform, weight in zip(draws[block], log_uniforms[block], weights[block], strict=True):
            weight[1:] = rng.standard_gamma(shape + 0.5 * rows, found.size - 1) / (-2.0 * scale - found[1:])
            candidate = theta + factor @ row
            there = terms(candidate)
            gain = float(weight @ (there - found))
            if not gain < np.inf:  # or NaN
                raise NotFiniteError(f"log density at {candidate}: expected a number or -inf, got {there}")
            if log_uniform < gain:  # the paper's eq. (14)
                theta, found = candidate, there
            row[:] = theta
        running = updated(running, draws[block], adaptation.epsilon)
        if running.count > adaptation.after:
            factor = _factor(running.covariance)
    kept = draws[burn_in:]
    moved = float((kept[1:] != kept[:-1]).any(axis=1).mean())  # a chain that stays repeats itself to the last digit
    return Chain(kept, moved, running.covariance, -0.5 / weights[burn_in:, 1:])


def updated(running: Running, block: Array, epsilon: float) -> Running:
    """Return what is known after (b, d) further draws.

    With one draw this is C_{i+1} = (i-1)/i C_i + s_d/i (i m_{i-1} m_{i-1}^T - (i+1) m_i m_i^T + x_i x_i^T + e I), m the
    running mean and x_i the draw. The three products are i/(i+1) (x_i - m_{i-1}) (x_i - m_{i-1})^T, which is how they
    are computed: a mean far from zero would cancel in them.
    """
    added, dimension = block.shape
    count, total = running.count, running.count + added
    middle = np.add.reduce(block) / added
    shift, about = middle - running.mean, block - middle
    scatter = about.T @ about + (count * added / total) * (shift[:, None] * shift)
    scatter.flat[:: dimension + 1] += added * epsilon
    old, new = (count - 1) / (total - 1), scale_of(dimension) / (total - 1)
    return Running(total, running.mean + (added / total) * shift, old * running.covariance + new * scatter)


def scale_of(dimension: int) -> float:
    """Return s_d = 2.4^2 / d, the best for a normal density (Gelman, Roberts and Gilks 1996)."""
    return 2.4**2 / dimension


def _factor(covariance: Array) -> Array:
    factor, info = dpotrf(covariance, lower=1)
    if info:
        raise InputError("the covariance of the proposals is not positive definite: scale the parameters to order one")
    return factor


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
