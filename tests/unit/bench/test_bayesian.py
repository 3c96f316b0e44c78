"""Posterior of a network: the collapsed density against other ways to compute it, and what the samplers claim."""

import sys
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import invgamma, multivariate_normal, norm

from armflex import InputError
from armflex.bench import fit_bayesian as bayesian
from armflex.bench.fit_bayesian import Collapsed, NetworkPrior, fit_bayesian, maximum, whitening
from armflex.bench.fitted import Fitted
from armflex.bench.network_problem import NetworkProblem, predictions
from armflex.errors import ConvergenceError, NotFiniteError, UnknownNameError, UnsupportedError
from armflex.laws.joint.network import layers
from armflex.laws.law import Row
from armflex.sampling.nuts import no_u_turn

pytestmark = pytest.mark.slow

NOISE = 1e-5
NOWHERE = Row(np.zeros(0), {})
UNEQUAL = NetworkPrior(np.array([1.3, 0.7, 2.0, 0.1]), 0.7, 1e-3)


def bench(seed: int, rows: int = 91) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return loads [N] as the paper's, deflections [m] with 10 um of noise, and without."""
    rng = np.random.default_rng(seed)
    loads = np.stack([rng.uniform(*ends, rows) for ends in ((1.0, 2.8), (-1.1, 1.1), (-2.5, -0.6))], axis=1)
    compliance = np.array([[0.5, 0.05, 0.2], [0.03, 0.8, -0.1], [0.15, -0.1, 0.9]])
    off, bent = loads - [1.9, 0.0, -1.5], 0.06 * np.random.default_rng(0).normal(size=(3, 3, 3))
    exact = 1e-3 * (loads @ compliance.T + np.einsum("kij,ni,nj->nk", bent, off, off))
    return 1e3 * loads, exact + NOISE * rng.normal(size=exact.shape), exact


def small(rows: int = 7, size: int = 3, neurons: int = 2, outputs: int | None = None) -> NetworkProblem:
    rng = np.random.default_rng(3)
    return NetworkProblem(rng.normal(size=(rows, size)), rng.normal(size=(rows, outputs or size)), neurons)


def dimension(density: Collapsed) -> int:
    return len(density.start(np.zeros(density.problem.count), np.ones(density.problem.size)))


def somewhere(density: Collapsed, seed: int = 1) -> np.ndarray:
    theta = np.random.default_rng(seed).normal(size=dimension(density))
    theta[-density.problem.size :] -= 1.0
    return theta


@pytest.mark.parametrize(("size", "neurons"), [(3, 2), (3, 20), (6, 5)])
def test_gradient_against_finite_differences(size: int, neurons: int) -> None:
    density = Collapsed(small(40, size, neurons), UNEQUAL)
    theta = somewhere(density)
    gradient = density(theta)[1]
    moves = 1e-5 * np.eye(dimension(density))
    numerical = [(density(theta + move)[0] - density(theta - move)[0]) / 2e-5 for move in moves]
    np.testing.assert_allclose(gradient, numerical, rtol=1e-6, atol=1e-6 * np.abs(gradient).max())


def one_neuron(rows: int) -> NetworkProblem:
    """Return a problem of one load, one neuron and one deflection."""
    rng = np.random.default_rng(5)
    x = rng.normal(size=(rows, 1))
    return NetworkProblem(x, 0.8 * np.tanh(x) + 0.3 * rng.normal(size=(rows, 1)), 1)


def prior_of(theta: np.ndarray, prior: NetworkPrior) -> float:
    """Return the log prior of one neuron's weight, bias and log noise."""
    deviations = 1.0 / np.sqrt(prior.precisions[:2])
    variance = invgamma.logpdf(np.exp(2.0 * theta[2]), prior.noise_shape, scale=prior.noise_scale)
    return norm.logpdf(theta[:2], 0.0, deviations).sum() + variance + np.log(2.0) + 2.0 * theta[2]


def test_density_is_that_of_a_multivariate_normal() -> None:
    """One neuron, one output: y ~ N(0, s^2 I + B P^-1 B^T), with every constant."""
    problem = one_neuron(9)
    theta = np.array([0.9, -0.3, -0.8])
    hidden = 1.0 / (1.0 + np.exp(-(theta[0] * problem.x + theta[1])))
    basis = np.hstack([hidden, np.ones_like(hidden)])
    covariance = np.exp(2.0 * theta[2]) * np.eye(9) + basis / UNEQUAL.precisions[2:] @ basis.T
    expected = multivariate_normal.logpdf(problem.y[:, 0], np.zeros(9), covariance) + prior_of(theta, UNEQUAL)
    np.testing.assert_allclose(Collapsed(problem, UNEQUAL)(theta)[0], expected, rtol=1e-10)


def test_density_is_the_integral_over_the_output_weight() -> None:
    """By quadrature, with the offset's prior so narrow that it is zero."""
    problem, prior = one_neuron(4), NetworkPrior(np.array([1.3, 0.7, 2.0, 1e12]), 0.7, 1e-3)
    theta = np.array([0.9, -0.3, -0.8])
    hidden = 1.0 / (1.0 + np.exp(-(theta[0] * problem.x[:, 0] + theta[1])))

    def joint(weight: float) -> float:
        errors = norm.logpdf(problem.y[:, 0], weight * hidden, np.exp(theta[2])).sum()
        return float(np.exp(errors + norm.logpdf(weight, 0.0, 1.0 / np.sqrt(2.0))))

    integral = quad(joint, -10.0, 10.0, epsabs=1e-14, limit=200)[0]
    expected = np.log(integral) + prior_of(theta, prior)
    np.testing.assert_allclose(Collapsed(problem, prior)(theta)[0], expected, rtol=1e-8)


@pytest.mark.parametrize("noise", [1e-2, 1e-5])
def test_density_keeps_its_digits_where_noise_is_small(noise: float) -> None:
    """The quadratic form is the least of a sum of squares, here found by orthogonal factors of [B / s; 1]."""
    problem = small(30, 3, 4)
    density, silent = Collapsed(problem), Collapsed(NetworkProblem(problem.x, 0.0 * problem.y, 4))
    theta = somewhere(density)
    theta[-3:] = np.log(noise)
    hidden = layers(density.mean(theta), 3)[0]
    basis = np.hstack([1.0 / (1.0 + np.exp(-(problem.inputs @ hidden.T))), np.ones((30, 1))])
    stacked, target = np.vstack([basis / noise, np.eye(5)]), np.vstack([problem.y / noise, np.zeros((5, 3))])
    quadratic = np.linalg.lstsq(stacked, target, rcond=None)[1].sum()
    np.testing.assert_allclose(density(theta)[0] - silent(theta)[0], -0.5 * quadratic, rtol=1e-9)
    assert np.isfinite(density(theta)[1]).all()


def test_redraw_has_the_conditionals_mean_and_covariance() -> None:
    problem = small(12, 3, 2)
    density, rng = Collapsed(problem, UNEQUAL), np.random.default_rng(0)
    theta = somewhere(density)
    weights = np.array([density.redraw(theta, rng) for _ in range(20_000)])
    hidden, output = layers(weights, 3)
    assert (hidden == hidden[0]).all() and (hidden[0].ravel() == theta[:8]).all()
    basis = np.hstack([1.0 / (1.0 + np.exp(-(problem.inputs @ hidden[0].T))), np.ones((12, 1))])
    for k, noise in enumerate(density.noise(theta)):
        precision = basis.T @ basis / noise**2 + np.diag(UNEQUAL.precisions[[2, 2, 3]])
        covariance = np.linalg.inv(precision)
        mean = covariance @ basis.T @ problem.y[:, k] / noise**2
        deviations = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(layers(density.mean(theta), 3)[1][k], mean)
        np.testing.assert_allclose((output[:, k].mean(axis=0) - mean) / deviations, 0.0, atol=4.0 / np.sqrt(20_000))
        scaled = np.cov(output[:, k], rowvar=False) / np.outer(deviations, deviations)
        np.testing.assert_allclose(scaled, covariance / np.outer(deviations, deviations), atol=0.05)


def test_maximum_and_whitening() -> None:
    density = Collapsed(small(30, 3, 2))
    mode = maximum(density, somewhere(density))
    assert np.abs(density(mode)[1]).max() < 0.1 and density(mode)[0] > density(somewhere(density))[0]
    whiten = whitening(density, mode)
    step, at = 1e-4, lambda z: density(mode + whiten @ z)[0]
    for direction in np.eye(dimension(density))[-4:]:  # the best determined; elsewhere the floor counts
        curvature = (2.0 * at(0.0 * direction) - at(step * direction) - at(-step * direction)) / step**2
        np.testing.assert_allclose(curvature, 1.0, rtol=0.02)


def test_answers_are_the_networks() -> None:
    problem = small(5, 3, 4)
    weights = np.random.default_rng(0).normal(size=(2, problem.count))
    hidden, output = layers(weights[1], 3)
    values = 1.0 / (1.0 + np.exp(-(problem.inputs @ hidden.T)))
    expected = values @ output[:, :-1].T + output[:, -1]
    np.testing.assert_allclose(predictions(problem, weights)[1], expected, rtol=1e-12)
    np.testing.assert_allclose(predictions(problem, weights[1]), expected, rtol=1e-12)


def test_laplace_is_quick_and_single() -> None:
    loads, deflections, exact = bench(1)
    fitted = fit_bayesian(loads, deflections, neurons=5)
    assert fitted.diagnostics.rhat_max is None and fitted.parameters["sampler"] == "laplace"
    assert len(fitted.law.hidden) == 1 and fitted.law.weight_covariance is not None
    wrenches = np.hstack([loads, np.zeros((91, 3))])
    assert np.sqrt(((fitted.law.twist(wrenches, NOWHERE)[:, :3] - exact) ** 2).mean()) < NOISE


def first_attempts(patch: pytest.MonkeyPatch) -> None:
    """Leave samplers no second attempt, which short runs would always need."""
    patch.setattr(bayesian, "WALKS", {name: walks[:1] for name, walks in bayesian.WALKS.items()})


@pytest.fixture
def once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bayesian, "TUNE", 50)
    first_attempts(monkeypatch)


@pytest.fixture(scope="module")
def sampled() -> Fitted:
    pytest.importorskip("nutpie")
    with pytest.MonkeyPatch.context() as patch:
        first_attempts(patch)
        return fit_bayesian(*bench(1)[:2], sampler="nuts", chains=2, draws=400, allow_unconverged=True)


def test_nuts_mixes_and_follows_the_data(sampled: Fitted) -> None:
    judged = sampled.parameters["judged"]
    assert judged["predictions"]["rhat_max"] < 1.03 and judged["predictions"]["ess_min"] > 200
    assert judged["noise"]["rhat_max"] < 1.03
    assert sampled.diagnostics.rhat_max == max(part["rhat_max"] for part in judged.values())
    assert sampled.diagnostics.ess_min == min(part["ess_min"] for part in judged.values())
    np.testing.assert_allclose(sampled.law.noise, NOISE, rtol=0.25)
    assert len(sampled.law.hidden) == 200 and sampled.parameters["draws"] == 400


def test_nuts_covers_what_it_claims(sampled: Fitted) -> None:
    """The 95 % band of the posterior against the exact deflection under new loads."""
    loads, _, exact = bench(2, 300)
    inside = []
    for load, truth in zip(loads, exact, strict=True):
        wrench = np.concatenate([load, np.zeros(3)])
        known = sampled.law.draws(load).std(axis=0)
        inside.append(np.abs(sampled.law.twist(wrench, NOWHERE)[:3] - truth) < 1.96 * known)
    assert 0.85 < np.mean(inside) < 0.995


def test_seeds_reproduce(once: None) -> None:
    pytest.importorskip("nutpie")
    loads, deflections, _ = bench(1, 30)
    options = {"neurons": 2, "chains": 2, "draws": 20, "allow_unconverged": True}
    for sampler in ("nuts", "metropolis", "laplace"):
        first, again, other = (
            fit_bayesian(loads, deflections, sampler=sampler, seed=seed, **options).law for seed in (0, 0, 7)
        )
        assert (first.hidden == again.hidden).all() and (first.output == again.output).all()
        assert first.noise.tobytes() == again.noise.tobytes()
        assert sampler == "laplace" or first.hidden.tobytes() != other.hidden.tobytes()


@pytest.mark.parametrize("sampler", ["nuts", "metropolis"])
def test_unconverged_is_an_error_unless_asked_for(sampler: str, once: None) -> None:
    pytest.importorskip("nutpie" if sampler == "nuts" else "arviz_stats")
    loads, deflections, _ = bench(1, 30)
    options = {"neurons": 2, "sampler": sampler, "chains": 2, "draws": 40}
    with pytest.raises(ConvergenceError, match=r"have not converged: .*effective sample size"):
        fit_bayesian(loads, deflections, **options)
    taken = fit_bayesian(loads, deflections, **options, allow_unconverged=True)
    assert taken.diagnostics.ess_min < 400 and taken.diagnostics.seconds > 0.0
    assert (taken.diagnostics.divergences is None) == (sampler == "metropolis")
    assert 0.0 < taken.diagnostics.acceptance < 1.0


def test_second_attempt_walks_further(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("nutpie")
    walks, tried = bayesian.WALKS["nuts"], []

    def noted(walk: partial) -> Callable:
        return lambda *given: tried.append(walk.keywords["depth"]) or walk(*given)

    monkeypatch.setattr(bayesian, "TUNE", 20)
    monkeypatch.setitem(bayesian.WALKS, "nuts", tuple(noted(walk) for walk in walks))
    loads, deflections, _ = bench(1, 30)
    fit_bayesian(loads, deflections, 2, "nuts", chains=2, draws=10, allow_unconverged=True)
    assert tried == [aims["depth"] for aims in bayesian.ATTEMPTS for _ in range(2)]


def test_sampler_finds_a_known_density() -> None:
    """A correlated normal: mean and covariance, from a wrong start, whitened wrongly."""
    pytest.importorskip("nutpie")
    covariance, mean = np.array([[4.0, 1.5], [1.5, 1.0]]), np.array([2.0, -1.0])
    precision = np.linalg.inv(covariance)

    def density(point: np.ndarray) -> tuple[float, np.ndarray]:
        pull = precision @ (mean - point)
        return -0.5 * float((point - mean) @ precision @ (point - mean)), pull

    walk = no_u_turn(density, np.zeros(2), np.diag([1.0, 3.0]), 4000, 300, np.random.SeedSequence(0), 5)
    np.testing.assert_allclose(walk.draws.mean(axis=0), mean, atol=0.15)
    np.testing.assert_allclose(np.cov(walk.draws, rowvar=False), covariance, rtol=0.15)
    assert walk.divergences == 0 and 0.5 < walk.acceptance <= 1.0


def test_density_that_is_no_number() -> None:
    pytest.importorskip("nutpie")
    seed = np.random.SeedSequence(0)
    with pytest.raises(NotFiniteError, match="a chain cannot start where its log density is nan"):
        no_u_turn(lambda point: (np.nan, point), np.zeros(2), np.eye(2), 10, 10, seed)
    half = no_u_turn(lambda p: (-0.5 * p @ p if p[0] < 0.3 else np.nan, -p), np.zeros(2), np.eye(2), 50, 50, seed)
    assert half.divergences > 0
    density = Collapsed(small())
    theta = somewhere(density)
    theta[-1] = -400.0  # 1 / s^2 is infinite
    assert not np.isfinite(density(theta)[0])
    with pytest.raises(NotFiniteError, match="where the search for its maximum starts"):
        maximum(density, theta)


def test_bad_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    loads, deflections, _ = bench(1, 30)
    with pytest.raises(UnknownNameError, match="no sampler named 'nut', did you mean 'nuts'"):
        fit_bayesian(loads, deflections, sampler="nut")
    for wrong in ({"chains": 1}, {"draws": 2}):
        with pytest.raises(InputError, match="expected at least 2 of 4, to compare them"):
            fit_bayesian(loads, deflections, sampler="nuts", neurons=2, **wrong)
    for precisions in (np.ones(3), np.array([1.0, 0.0, 1.0, 1.0]), np.array([1.0, np.nan, 1.0, 1.0])):
        with pytest.raises(InputError, match="prior of a network: expected 4 precisions"):
            NetworkPrior(precisions)
    monkeypatch.setitem(sys.modules, "nutpie", None)
    with pytest.raises(UnsupportedError, match=r"needs .*: pip install 'armflex\[bayes\]'"):
        fit_bayesian(loads, deflections, neurons=2, sampler="nuts")
