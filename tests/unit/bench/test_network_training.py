"""Training networks: with and without a prior, the evidence, its Gaussian approximation, what cannot be trained on."""

import numpy as np
import pytest

from armflex.bench.fit_network import find_modes, fit_network, laplace
from armflex.bench.network_problem import GROUPS, jacobian, predictions, scaled_problem, start_weights
from armflex.errors import InputError
from armflex.laws import Row
from armflex.laws.joint.network import NetworkLaw, layers, pack, weight_jacobian

NOWHERE = Row(np.zeros(0), {})
LARGEST = np.array([2e3, 1e3, 2.5e3, 5e2, 5e2, 3e2])
COMPLIANCE = np.array([[1.3, 0.1, 1.3], [0.1, 12.5, -0.3], [0.6, -0.4, 47.1]]) * 1e-6
NOISE = 1e-5


def quadratic_bench(seed: int, rows: int = 91) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return loads and noisy deflections [N, m] to train on, and 500 loads and exact deflections to judge by."""
    rng = np.random.default_rng(seed)
    curvature = 3e-11 * rng.normal(size=(3, 3, 3))
    loads = rng.uniform(-1.0, 1.0, size=(rows + 500, 3)) * LARGEST[:3]
    exact = loads @ COMPLIANCE.T + np.einsum("cij,ni,nj->nc", curvature, loads, loads)
    measured = exact[:rows] + NOISE * rng.normal(size=(rows, 3))
    return loads[:rows], measured, loads[rows:], exact[rows:]


def six(loads: np.ndarray) -> np.ndarray:
    return np.concatenate([loads, np.zeros((*loads.shape[:-1], 6 - loads.shape[-1]))], axis=-1)


def held_out(law: NetworkLaw, loads: np.ndarray, exact: np.ndarray) -> float:
    return float(np.sqrt(((law.twist(six(loads), NOWHERE)[:, :3] - exact) ** 2).mean()) / NOISE)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_evidence_beats_plain_least_squares_on_new_loads(seed: int) -> None:
    loads, measured, new, exact = quadratic_bench(seed)
    plain = fit_network(loads, measured, starts=3, seed=seed, prior=None)
    weighed = fit_network(loads, measured, starts=3, seed=seed)
    assert held_out(weighed.law, new, exact) < 0.9  # times the noise
    assert held_out(plain.law, new, exact) > 1.5 * held_out(weighed.law, new, exact)
    np.testing.assert_allclose(weighed.parameters["noise"], NOISE, rtol=0.3)
    assert 20.0 < weighed.parameters["effective"] < 100.0 < plain.parameters["effective"] == 143.0


def test_laplace_intervals_hold_what_they_claim() -> None:
    inside = []
    for seed in range(4):
        loads, measured, new, exact = quadratic_bench(seed)
        law = fit_network(loads, measured, starts=2, seed=seed).law
        near = [i for i in range(200) if law.reach(new[i]) <= 1.0]
        variance = np.array([np.diag(law.covariance(w, NOWHERE))[:3] for w in six(new[near])]) - law.noise**2
        error = law.twist(six(new[near]), NOWHERE)[:, :3] - exact[near]
        inside.append(np.mean(np.abs(error) < 1.96 * np.sqrt(variance)))
    assert 0.88 < np.mean(inside) < 0.995


def test_training_is_the_same_for_the_same_seed_and_describes_itself() -> None:
    loads, measured, _, _ = quadratic_bench(0)
    first, again, other = (fit_network(loads, measured, 6, 2, seed, iterations=40) for seed in (7, 7, 8))
    np.testing.assert_array_equal(pack(first.law), pack(again.law))
    assert np.abs(pack(first.law) - pack(other.law)).max() > 0.0
    assert first.parameters["neurons"] == 6 and first.parameters["weights"] == 45
    assert set(first.parameters["precisions"]) == set(GROUPS)
    np.testing.assert_array_equal(first.law.seen, [loads.min(axis=0), loads.max(axis=0)])
    assert max(first.law.distance(loads)) == pytest.approx(first.law.furthest)


def test_six_components_data_without_noise_and_a_column_that_never_moves() -> None:
    rng = np.random.default_rng(9)
    loads = rng.uniform(-1.0, 1.0, size=(80, 6)) * LARGEST
    compliance = np.diag([1e-6, 2e-6, 0.0, 4e-6, 5e-6, 6e-6])
    with np.errstate(all="raise", under="ignore"):
        law = fit_network(loads, loads @ compliance, 8, 1).law
    error = law.twist(loads, NOWHERE) - loads @ compliance
    assert np.abs(error).max() < 1e-2 * np.abs(loads @ compliance).max()
    np.testing.assert_allclose(law.twist(loads, NOWHERE)[:, 2], 0.0, atol=1e-8)


def test_more_weights_than_data_claim_nothing_without_a_prior() -> None:
    loads, measured, _, _ = quadratic_bench(0, rows=20)
    law = fit_network(loads, measured, 20, 1, prior=None).law
    np.testing.assert_allclose(law.noise, measured.std(axis=0))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"loads": np.ones((30, 3))}, "span"),
        ({"loads": np.ones((30, 4))}, "3 or 6"),
        ({"deflections": np.ones((29, 3))}, "3 or 6"),
        ({"deflections": np.full((30, 3), np.nan)}, "finite"),
        ({"neurons": 0}, "neuron"),
        ({"starts": 0}, "start"),
        ({"prior": "evidenc"}, "did you mean 'evidence'"),
    ],
)
def test_what_cannot_be_trained_on(change: dict, match: str) -> None:
    rng = np.random.default_rng(0)
    given = {"loads": rng.normal(size=(30, 3)), "deflections": rng.normal(size=(30, 3)), "neurons": 3}
    with pytest.raises(InputError, match=match):
        fit_network(**(given | change))
    with pytest.raises(InputError, match="do not determine"):
        fit_network(given["loads"][:4], given["deflections"][:4])


def test_log_posterior_and_evidence_by_hand() -> None:
    loads, measured, _, _ = quadratic_bench(1, rows=12)
    problem, _ = scaled_problem(loads, measured, 1)
    weights, noise, precisions = start_weights(problem, 1, 0)[0], np.array([0.5, 0.2, 0.3]), np.array([1.0, 2, 3, 4])
    hidden, output = layers(weights, 3)
    expected = output[:, 0] / (1.0 + np.exp(-(problem.x @ hidden[0, :3] + hidden[0, 3])))[:, None] + output[:, 1]
    np.testing.assert_allclose(predictions(problem, weights), expected, rtol=1e-12)
    np.testing.assert_array_equal(jacobian(problem, weights), weight_jacobian(problem.x, weights, 3))
    density = -0.5 * ((expected - problem.y) / noise) ** 2 - np.log(noise * np.sqrt(2 * np.pi))
    own = precisions[[0, 0, 0, 1, 2, 3, 2, 3, 2, 3]]
    prior = np.sum(0.5 * np.log(own / (2 * np.pi)) - 0.5 * own * weights**2)
    mode = laplace(problem, weights, precisions, noise)
    peak = density.sum() + prior + 0.5 * np.linalg.slogdet(2 * np.pi * mode.covariance)[1]
    assert mode.log_evidence == pytest.approx(peak, rel=1e-10)


@pytest.mark.slow
def test_modes_are_maxima_the_best_first() -> None:
    loads, measured, _, _ = quadratic_bench(2)
    problem, _ = scaled_problem(loads, measured, 8)
    modes = find_modes(problem, starts=3, iterations=400)
    assert [mode.log_evidence for mode in modes] == sorted((mode.log_evidence for mode in modes), reverse=True)
    for mode in modes:
        errors = (predictions(problem, mode.weights) - problem.y) / mode.noise**2
        slope = np.einsum("nc,ncp->p", errors, jacobian(problem, mode.weights))
        slope += mode.precisions[problem.groups] * mode.weights
        assert np.sqrt(slope @ mode.covariance @ slope) < 0.7  # of a posterior standard deviation
