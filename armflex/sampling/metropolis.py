"""Adaptive Metropolis: a random walk whose steps are shaped like all that the chain has seen so far.

Haario, Saksman and Tamminen (2001), An adaptive Metropolis algorithm, Bernoulli 7(2); the paper's eqs (12) to (14).
Eq. (13) is printed with a running mean where the current draw belongs, see `updated`. Noise variances are drawn from
their exact conditional before every step (Gibbs).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf  # numpy's wrapper takes eight times as long on ten parameters

from armflex.conventions import Array
from armflex.errors import InputError, NotFiniteError, ShapeError


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
        densities = np.empty(1 + len(sums))
        densities[0], densities[1:] = log_prior(theta) if log_prior else 0.0, sums
        return densities

    theta, density, factor = start, terms(start), _factor(covariance)
    if not np.isfinite(density).all():
        raise NotFiniteError(f"a chain cannot start at {start}, where its log density is {density}")
    draws = rng.standard_normal((steps, size))  # holds the proposals' normals until draws take their place
    log_uniforms = np.log1p(-rng.random(steps))
    weights = np.ones((steps, density.size))
    running = Running(1, start, np.zeros((size, size)))
    for first in range(0, steps, adaptation.every):
        block = slice(first, first + adaptation.every)
        for row, log_uniform, weight in zip(draws[block], log_uniforms[block], weights[block], strict=True):
            weight[1:] = rng.standard_gamma(shape + 0.5 * rows, density.size - 1) / (-2.0 * scale - density[1:])
            candidate = theta + factor @ row
            there = terms(candidate)
            gain = float(weight @ (there - density))
            if not gain < np.inf:  # or NaN
                raise NotFiniteError(f"log density at {candidate}: expected a number or -inf, got {there}")
            if log_uniform < gain:  # the paper's eq. (14)
                theta, density = candidate, there
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
