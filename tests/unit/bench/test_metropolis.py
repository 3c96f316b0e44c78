"""Adaptive Metropolis: its recursion, known densities, known posteriors, and chains that must be refused."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import digamma, ndtri
from scipy.stats import rankdata

from armflex.bench.fit_linear import fit_compliance
from armflex.errors import ConvergenceError, InputError, NotFiniteError, ShapeError
from armflex.sampling.diagnostics import Diagnostics, check_converged, diagnose, ess, rhat
from armflex.sampling.metropolis import Adaptation, Chain, Running, adaptive_metropolis, scale_of, updated

EPSILON = 1e-3


def chain_of(density: Callable[[np.ndarray], float], *given: object, **options: object) -> Chain:
    """Return a chain whose draws are distributed as a density says: a prior without any residuals."""
    return adaptive_metropolis(lambda theta: np.zeros(0), 0, *given, **options, log_prior=density)


def like_table_1(rows: int = 20, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return loads [N] as the paper's bench has them and deflections [m] of the compliance found there."""
    rng = np.random.default_rng(seed)
    side = rng.choice([-1.0, 1.0], rows)
    loads = 1e3 * np.column_stack(
        [rng.uniform(1.0, 2.8, rows), side * rng.uniform(0.3, 1.1, rows), -rng.uniform(0.6, 2.5, rows)]
    )
    compliance = 1e-6 * np.array([[1.3, 0.0, 1.3], [0.0, 12.5, -0.35], [0.6, -0.4, 47.0]])
    noise = 1e-3 * np.array([0.15, 0.1, 0.4])
    return loads, loads @ compliance.T + noise * rng.normal(size=(rows, 3))


def mean_error(draws: np.ndarray) -> np.ndarray:
    """Return the (q,) Monte Carlo standard error of the mean of (chains, n, q) draws."""
    return draws.std(axis=(0, 1)) / np.sqrt(ess(draws))


def assert_mean(draws: np.ndarray, expected: np.ndarray, sigmas: float = 4.0) -> None:
    """Assert that (chains, n, q) draws have a mean, within their own Monte Carlo error."""
    score = (draws.mean(axis=(0, 1)) - expected) / mean_error(draws)
    assert np.abs(score).max() < sigmas, score


def assert_variance(draws: np.ndarray, expected: np.ndarray, sigmas: float = 4.0) -> None:
    assert_mean((draws - draws.mean(axis=(0, 1))) ** 2, expected, sigmas)


@pytest.mark.parametrize("every", [1, 2, 7])
def test_recursion_is_the_covariance_of_all_draws(every: int) -> None:
    """Eq. (12), far from zero, where products of means would cancel."""
    draws = 1e4 + np.random.default_rng(1).normal(size=(43, 3)) @ np.diag([1.0, 10.0, 0.1])
    running = Running(1, draws[0], np.zeros((3, 3)))
    for first in range(1, 43, every):
        running = updated(running, draws[first : first + every], EPSILON)
        seen = draws[: first + every]
        expected = scale_of(3) * (np.cov(seen, rowvar=False) + EPSILON * np.eye(3))
        np.testing.assert_allclose(running.covariance, expected, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(running.mean, seen.mean(axis=0), rtol=1e-14)
    assert running.count == 43


def test_recursion_is_eq_13_put_right() -> None:
    """(i-1)/i C_i + s_d/i (i m_{i-1} m_{i-1}^T - (i+1) m_i m_i^T + x_i x_i^T + e I)."""
    x = np.random.default_rng(2).normal(size=(9, 4))
    running = Running(1, x[0], np.zeros((4, 4)))
    for i in range(1, 9):
        before, now = x[:i].mean(axis=0), x[: i + 1].mean(axis=0)
        products = i * np.outer(before, before) - (i + 1) * np.outer(now, now) + np.outer(x[i], x[i])
        expected = (i - 1) / i * running.covariance + scale_of(4) / i * (products + EPSILON * np.eye(4))
        running = updated(running, x[i : i + 1], EPSILON)
        np.testing.assert_allclose(running.covariance, expected, rtol=1e-12, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 10])
def test_normal_density(every: int) -> None:
    """Mean and covariance of a stretched, turned normal density, and the acceptance that its dimension allows."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 4)) * np.array([3.0, 1.0, 1.0, 0.3])
    mean, covariance, precision = rng.normal(size=4), root @ root.T, np.linalg.inv(root @ root.T)
    adaptation = Adaptation(0.1 * np.eye(4), after=100, every=every)
    chains = [
        chain_of(lambda x: -0.5 * (x - mean) @ precision @ (x - mean), mean, 8000, seed, adaptation)
        for seed in range(4)
    ]
    draws = np.array([chain.draws for chain in chains])
    assert draws.shape == (4, 4000, 4) and chains[0].variances.shape == (4000, 0)
    check_converged(diagnose(draws))
    assert_mean(draws, mean)
    assert_mean((draws - mean) ** 2, np.diag(covariance))
    assert_mean((draws[..., :1] - mean[0]) * (draws[..., 1:] - mean[1:]), covariance[0, 1:])
    for chain in chains:
        assert 0.2 < chain.acceptance < 0.45
        np.testing.assert_allclose(chain.covariance, scale_of(4) * covariance, rtol=0, atol=0.5 * covariance.max())


def test_zero_density_is_never_entered() -> None:
    """Exponential, -inf below zero: mean and variance one."""
    draws = np.array(
        [chain_of(lambda x: -x[0] if x[0] > 0.0 else -np.inf, np.ones(1), 6000, seed).draws for seed in range(4)]
    )
    assert draws.min() > 0.0
    assert_mean(draws, np.ones(1))
    assert_mean((draws - 1.0) ** 2, np.ones(1))


def test_same_seed_same_chain() -> None:
    first, again, other = (chain_of(lambda x: -x @ x, np.zeros(2), 400, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.draws, again.draws)
    assert first.acceptance == again.acceptance and not np.array_equal(first.draws, other.draws)


def test_burn_in_is_left_out_and_first_steps_keep_their_covariance() -> None:
    """Steps of a millionth, for nothing is adapted before the thousandth."""
    small = Adaptation(1e-12 * np.eye(3), after=1000)
    chain = chain_of(lambda x: -0.5 * x @ x, np.ones(3), 500, 0, small, burn_in=100)
    assert chain.draws.shape == (400, 3) and chain.acceptance > 0.99
    assert np.abs(chain.draws - 1.0).max() < 1e-3


@pytest.mark.parametrize(
    ("density", "start", "error", "complaint"),
    [
        (lambda x: math.nan if x[0] > 1.0 else 0.0, 0.0, NotFiniteError, "expected a number or -inf, got .nan"),
        (lambda x: math.inf if x[0] > 1.0 else 0.0, 0.0, NotFiniteError, "expected a number or -inf, got .inf"),
        (lambda x: math.nan, 0.0, NotFiniteError, "a chain cannot start at"),
        (lambda x: -math.inf, 0.0, NotFiniteError, "a chain cannot start at"),
    ],
)
def test_densities_that_are_no_numbers(density: object, start: float, error: type, complaint: str) -> None:
    with pytest.raises(error, match=complaint):
        chain_of(density, np.array([start]), 1000, 0)


def test_bad_arguments() -> None:
    def flat(x: np.ndarray) -> float:
        return 0.0

    for start in (np.zeros(0), np.zeros((2, 2))):
        with pytest.raises(ShapeError, match="start of a chain"):
            chain_of(flat, start, 10, 0)
    with pytest.raises(InputError, match="10 steps with a burn-in of 9"):
        chain_of(flat, np.zeros(1), 10, 0, burn_in=9)
    with pytest.raises(ShapeError, match=r"start covariance: expected \(2, 2\)"):
        chain_of(flat, np.zeros(2), 10, 0, Adaptation(np.eye(3)))
    with pytest.raises(InputError, match="not positive definite"):
        chain_of(flat, np.zeros(2), 10, 0, Adaptation(-np.eye(2)))
    for wrong in ({"after": 0}, {"every": 0}, {"epsilon": 0.0}, {"epsilon": np.nan}):
        with pytest.raises(InputError, match="expected more than 0"):
            Adaptation(**wrong)


@pytest.mark.slow
def test_gibbs_noise_of_a_mean() -> None:
    """The mean of N readings is Student's t about theirs, the variance inverse gamma: textbook."""
    readings = np.random.default_rng(7).normal(3.0, 0.5, 12)
    total = ((readings - readings.mean()) ** 2).sum()
    chains = [
        adaptive_metropolis(
            lambda theta: np.array([((readings - theta[0]) ** 2).sum()]), 12, np.array([3.0]), 6000, seed
        )
        for seed in range(4)
    ]
    means, variances = np.array([c.draws for c in chains]), np.array([c.variances for c in chains])
    assert_mean(means, readings.mean())
    assert_variance(means, total / 12 / 9)
    assert_mean(variances, total / 9)
    assert_mean(np.log(variances), np.log(total / 2) - digamma(5.5))


def test_gibbs_with_priors_alone() -> None:
    """Without residuals to speak of, parameters and variances follow their priors."""
    chains = [
        adaptive_metropolis(
            lambda theta: np.zeros(2),
            0,
            np.zeros(1),
            6000,
            seed,
            log_prior=lambda theta: -0.5 * (theta[0] - 1.0) ** 2 / 4.0,
            noise_prior=(6.0, 10.0),
        )
        for seed in range(4)
    ]
    assert_mean(np.array([chain.draws for chain in chains]), 1.0)
    assert_variance(np.array([chain.draws for chain in chains]), 4.0)
    assert_mean(np.array([chain.variances for chain in chains]), np.full(2, 2.0))


@pytest.mark.slow
def test_a_row_of_a_compliance_is_that_in_closed_form() -> None:
    """The paper's own use: Student's t, its mean least squares, its variance that of these times f / (f - 2)."""
    loads, deflections = like_table_1()
    closed = fit_compliance(loads, deflections, "full")
    row, size = closed.compliance[2], np.sqrt(np.diag(closed.row_covariance[2]))

    def squares(steps: np.ndarray) -> np.ndarray:
        return np.array([((deflections[:, 2] - loads @ (row + size * steps)) ** 2).sum()])

    adaptation = Adaptation(0.1 * scale_of(3) * np.eye(3), after=60, every=10)
    chains = [adaptive_metropolis(squares, len(loads), np.zeros(3), 12_000, seed, adaptation) for seed in range(4)]
    draws, variances = np.array([c.draws for c in chains]), np.array([c.variances for c in chains])
    check_converged(diagnose(draws))
    assert_mean(draws, np.zeros(3))
    assert_variance(draws, np.full(3, 17.0 / 15.0))
    assert_mean(variances, 17.0 / 15.0 * closed.residual_std[2] ** 2)


def test_rhat_catches_chains_in_different_modes() -> None:
    """Two narrow modes ten apart: each chain is content where it is, together they are not."""

    def two_modes(x: np.ndarray) -> float:
        return float(np.logaddexp(-0.5 * ((x[0] + 5.0) / 0.2) ** 2, -0.5 * ((x[0] - 5.0) / 0.2) ** 2))

    draws = np.array(
        [chain_of(two_modes, np.array([start]), 4000, seed).draws for seed, start in enumerate([-5.0, 5.0])]
    )
    with pytest.raises(ConvergenceError, match="R-hat"):
        check_converged(diagnose(draws))


def test_rhat_catches_drift_and_unequal_spread() -> None:
    rng = np.random.default_rng(0)
    good = rng.normal(size=(4, 1000, 1))
    assert rhat(good)[0] < 1.01 and 3000 < ess(good)[0] < 5000
    assert rhat(good + np.linspace(0.0, 2.0, 1000)[:, None])[0] > 1.05
    assert rhat(good * np.array([1.0, 1.0, 1.0, 3.0])[:, None, None])[0] > 1.05
    slow = np.cumsum(good, axis=1)
    assert rhat(slow)[0] > 1.05 and ess(slow)[0] < 50


def test_rhat_by_hand() -> None:
    """Split R-hat of rank-normalised draws and of their distance from the median, whichever is larger."""
    draws = np.random.default_rng(1).gamma(1.0, size=(3, 40)).cumsum(axis=1)
    halves = draws.reshape(6, 20)

    def plain(values: np.ndarray) -> float:
        z = ndtri((rankdata(values).reshape(6, 20) - 0.375) / (values.size + 0.25))
        within, between = z.var(axis=1, ddof=1).mean(), 20 * z.mean(axis=1).var(ddof=1)
        return math.sqrt((19 / 20 * within + between / 20) / within)

    expected = max(plain(halves), plain(np.abs(halves - np.median(halves))))
    np.testing.assert_allclose(rhat(draws[..., None]), expected, rtol=1e-12)


def test_units_do_not_matter_to_diagnostics() -> None:
    draws = np.random.default_rng(2).normal(size=(4, 200, 2))
    for judge in (rhat, ess):
        np.testing.assert_allclose(judge(1e-17 * draws), judge(draws), rtol=1e-9)
        np.testing.assert_allclose(judge(1e3 * draws - 7.0), judge(draws), rtol=1e-9)


@pytest.mark.parametrize("still", [1, 2])
def test_a_chain_that_never_moved_is_refused(still: int) -> None:
    draws = np.random.default_rng(3).normal(size=(2, 1000, 3))
    draws[:still, :, 1] = 4.0
    assert rhat(draws)[1] == np.inf and ess(draws)[1] == 0.0
    with pytest.raises(ConvergenceError, match=r"R-hat inf .*, effective sample size 0 \(expected at least 400\)"):
        check_converged(diagnose(draws))


@pytest.mark.slow
def test_what_is_refused() -> None:
    check_converged(Diagnostics())
    check_converged(Diagnostics(1.0099, 400.0, 0))
    for bad in (Diagnostics(1.01, 1e4), Diagnostics(1.0, 399.0), Diagnostics(1.0, 1e4, 1), Diagnostics(np.nan, 1e4)):
        with pytest.raises(ConvergenceError, match="have not converged"):
            check_converged(bad)
        check_converged(bad, allow_unconverged=True)
    for shape in ((1, 100, 1), (4, 3, 1), (4, 100), (4, 100, 0)):
        with pytest.raises(ShapeError, match="draws: expected"):
            rhat(np.zeros(shape))
