"""Sizes of components by the evidence: the likelihood is that of a normal distribution, what was drawn comes back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armflex.estimate.variance_components import MixedModel

ROWS, COLUMNS = 60, 14


def drawn(seed: int, ratios: tuple[float, ...], rows: int = ROWS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return readings, columns and variances: the components share the first columns, each has some of its own."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(rows, COLUMNS))
    variances = np.zeros((len(ratios), COLUMNS))
    variances[0, :8], variances[1, 4:11], variances[2, 11:] = 1.0, np.linspace(2.0, 0.5, 7), 1.0
    amplitudes = rng.normal(size=COLUMNS) * np.sqrt(np.array(ratios) @ variances)
    return columns @ amplitudes + rng.normal(size=rows), columns, variances


def model_of(readings: np.ndarray, columns: np.ndarray, variances: np.ndarray) -> MixedModel:
    return MixedModel(
        columns.T @ columns, columns.T @ readings, float(readings @ readings), float(len(readings)), variances
    )


def log_density(readings: np.ndarray, columns: np.ndarray, variance: np.ndarray) -> float:
    """Return the log density of the normal distribution at the noise that fits best, but for a constant."""
    covariance = np.eye(len(readings)) + columns * variance @ columns.T
    noise = readings @ np.linalg.solve(covariance, readings) / len(readings)
    return float(-0.5 * np.linalg.slogdet(covariance)[1] - 0.5 * len(readings) * np.log(noise))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.tuples(*[st.sampled_from([0.0, 1e-3, 0.3, 20.0])] * 3))
def test_the_likelihood_is_that_of_the_normal_distribution(seed: int, ratios: tuple[float, ...]) -> None:
    readings, columns, variances = drawn(seed, (0.5, 0.5, 0.5))
    here = model_of(readings, columns, variances).at(np.array(ratios))
    assert here.log_likelihood == pytest.approx(log_density(readings, columns, np.array(ratios) @ variances), rel=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_the_slope_is_that_of_difference_quotients(seed: int, logs: tuple[float, ...]) -> None:
    model = model_of(*drawn(seed, (0.5, 0.5, 0.5)))

    def at(change: np.ndarray) -> float:
        return model.at(np.exp(np.array(logs) + change)).log_likelihood

    quotients = [(at(step) - at(-step)) / 2e-5 for step in 1e-5 * np.eye(3)]
    assert model.at(np.exp(np.array(logs))).slope == pytest.approx(quotients, rel=1e-4, abs=1e-5)


def test_sizes_maximise_the_likelihood_and_come_back() -> None:
    truth = (0.5, 0.0, 4.0)
    sizes = np.array([model_of(*drawn(seed, truth, 400)).fitted().ratios for seed in range(40)])
    fitted = model_of(*drawn(1, truth, 400)).fitted()
    assert np.abs(fitted.slope[fitted.ratios > 0.0]).max() < 0.1
    assert np.median(sizes[:, 2]) == pytest.approx(4.0, rel=0.5)
    assert np.median(sizes[:, 0] * 8 + sizes[:, 1] * 4) == pytest.approx(0.5 * 8, rel=0.5)
    assert (sizes[:, 1] == 0.0).mean() > 0.4  # nothing is there, and half of the time the likelihood is largest at zero


def test_noise_alone_has_no_component() -> None:
    lost = []
    for seed in range(40):
        fitted = model_of(*drawn(seed, (0.0, 0.0, 0.0))).fitted()
        lost.append(fitted.log_likelihood - fitted.model.at(np.zeros(3)).log_likelihood)
    assert max(lost) < 6.0 and np.mean(np.array(lost) > 3.0) <= 0.05


def test_amplitudes_are_the_most_probable_ones() -> None:
    readings, columns, variances = drawn(3, (0.5, 1.0, 2.0))
    ratios = np.array([0.5, 1.0, 2.0])
    direct = np.linalg.solve(columns.T @ columns + np.diag(1.0 / (ratios @ variances)), columns.T @ readings)
    assert model_of(readings, columns, variances).at(ratios).amplitudes == pytest.approx(direct, rel=1e-9)
