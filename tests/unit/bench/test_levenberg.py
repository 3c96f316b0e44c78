"""Levenberg-Marquardt: the normal equations by the plain Jacobian, scipy's minimum, the schedule of the damping."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import least_squares as scipy_least_squares

from armflex.bench.network_problem import (
    RELATIVE,
    Damping,
    NetworkPoint,
    NetworkProblem,
    Weighted,
    damped_step,
    jacobian,
    minimise,
    predictions,
    start_weights,
    sum_of_squares,
)


def small_problem(size: int = 3, neurons: int = 2, rows: int = 40, seed: int = 0) -> NetworkProblem:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(rows, size))
    exact = NetworkProblem(x, np.zeros((rows, size)), neurons)
    y = predictions(exact, 2.0 * rng.normal(size=exact.count)) + 0.05 * rng.normal(size=(rows, size))
    return NetworkProblem(x, y, neurons)


@pytest.mark.parametrize("size", [3, 6])
def test_normal_equations_are_those_of_the_jacobian(size: int) -> None:
    problem, rng = small_problem(size, 5), np.random.default_rng(1)
    precisions, noise = rng.uniform(0.1, 2.0, size=problem.count), rng.uniform(0.1, 0.5, size=size)
    objective, weights = Weighted(problem, precisions, noise), rng.normal(size=problem.count)
    point = objective.evaluate(weights)
    gradient, matrix = objective.normal(point)
    slopes = (jacobian(problem, weights) / noise[:, None]).reshape(-1, problem.count)
    errors = ((predictions(problem, weights) - problem.y) / noise).ravel()
    unit = noise.min() ** 2
    assert point.cost == pytest.approx(0.5 * unit * (errors @ errors + precisions @ weights**2), rel=1e-12)
    np.testing.assert_allclose(gradient, unit * (slopes.T @ errors + precisions * weights), rtol=1e-9, atol=1e-12)
    expected = unit * (slopes.T @ slopes + np.diag(precisions))
    np.testing.assert_allclose(np.tril(matrix), np.tril(expected), rtol=1e-9, atol=1e-12)


def test_same_minimum_as_scipy() -> None:
    problem = small_problem()
    for start in start_weights(problem, 3, 0):
        found = minimise(sum_of_squares(problem), start, 2000, 1e-15)
        referee = scipy_least_squares(
            lambda w: (predictions(problem, w) - problem.y).ravel(),
            found.weights + 1e-3 * np.random.default_rng(0).normal(size=problem.count),
            lambda w: jacobian(problem, w).reshape(-1, problem.count),
            method="lm",
            ftol=1e-15,
            xtol=1e-15,
            gtol=1e-15,
        )
        assert found.cost == pytest.approx(referee.cost, rel=1e-8)
        assert (np.diff(found.costs) <= 0.0).all() and found.costs[-1] == found.cost


def test_an_output_layer_solved_for_is_the_best_for_its_hidden_one() -> None:
    problem, noise = small_problem(neurons=4), np.array([0.1, 0.2, 0.3])
    precisions = np.array([0.5, 0.6, 0.7, 0.8])[problem.groups]
    start = start_weights(problem, 1, 0)[0]
    solving = Weighted(problem, precisions, noise, solves=True)
    point = solving.evaluate(start)
    split = 4 * problem.neurons
    np.testing.assert_array_equal(point.weights[:split], start[:split])
    np.testing.assert_allclose(solving.normal(point)[0][split:], 0.0, atol=1e-8)
    solved = minimise(solving, start, 500, 1e-12, RELATIVE)
    plain = minimise(Weighted(problem, precisions, noise), solved.weights, 500, 1e-12, RELATIVE)
    assert solved.converged and solved.cost == pytest.approx(plain.cost, rel=1e-8)  # a minimum without solving too


@dataclass(frozen=True)
class Never:
    """An objective on which only the first `helpful` steps help."""

    helpful: int
    solved: int = 0

    def evaluate(self, weights: np.ndarray) -> NetworkPoint:
        steps = int(weights[0])
        return NetworkPoint(weights, float(max(self.helpful - steps, 0) if steps <= self.helpful else 1e9), None)

    def normal(self, point: NetworkPoint) -> tuple[np.ndarray, np.ndarray]:
        return -np.ones(1), np.zeros((1, 1))


def test_schedule_of_the_damping(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[float] = []

    def one_step(gradient: np.ndarray, matrix: np.ndarray, mu: float, relative: bool, solved: int) -> np.ndarray:
        seen.append(mu)
        return gradient

    monkeypatch.setattr("armflex.bench.network_problem.damped_step", one_step)
    found = minimise(Never(4), np.zeros(1), 100, damping=Damping(ceiling=1e-3))
    np.testing.assert_allclose(seen, [1e-3, 1e-4, 1e-5, 1e-5, 1e-5, 1e-4, 1e-3], rtol=1e-9)
    assert found.converged and found.mu == pytest.approx(1e-2) and found.cost == 0.0
    seen.clear()
    minimise(Never(9), np.zeros(1), 4, damping=Damping(start=1e-2, factor=4.0, floor=1e-3))
    np.testing.assert_allclose(seen, [1e-2, 2.5e-3, 1e-3, 1e-3], rtol=1e-9)


@dataclass(frozen=True)
class Gains:
    """An objective whose every step helps, by these parts of the cost in turn."""

    parts: tuple[float, ...]
    solved: int = 0

    def evaluate(self, weights: np.ndarray) -> NetworkPoint:
        return NetworkPoint(weights, float(np.prod(1.0 - np.array(self.parts[: round(float(weights[0]))]))), None)

    def normal(self, point: NetworkPoint) -> tuple[np.ndarray, np.ndarray]:
        return -np.ones(1), np.zeros((1, 1))


@pytest.mark.parametrize(
    ("parts", "steps", "converged"),
    [
        ((0.5, 1e-4, 1e-4, 1e-4, 0.5, 0.5), 4, True),
        ((0.5, 1e-4, 1e-4, 0.5, 1e-4, 1e-4, 1e-4, 0.5), 7, True),  # in a row: a large gain counts anew
        ((0.5, 1e-4, 1e-4, 0.5, 1e-4, 1e-4), 6, False),
    ],
)
def test_ends_after_three_small_gains_in_a_row(
    parts: tuple[float, ...], steps: int, converged: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armflex.bench.network_problem.damped_step", lambda gradient, *_: gradient)
    found = minimise(Gains(parts), np.zeros(1), len(parts), tolerance=1e-3)
    assert len(found.costs) == steps + 1 and found.converged == converged
    assert minimise(Gains(parts), np.zeros(1), len(parts)).converged is False  # no tolerance, no end


@pytest.mark.slow
def test_damped_step() -> None:
    rng = np.random.default_rng(0)
    root, gradient = rng.normal(size=(5, 5)), rng.normal(size=5)
    matrix = root @ root.T
    np.testing.assert_allclose(
        damped_step(gradient, np.tril(matrix), 0.3), np.linalg.solve(matrix + 0.3 * np.eye(5), gradient)
    )
    scaled = np.linalg.solve(matrix + 0.3 * np.diag(np.diag(matrix)), gradient)
    np.testing.assert_allclose(damped_step(gradient, np.tril(matrix), 0.3, relative=True), scaled)
    assert np.isnan(damped_step(gradient, -np.eye(5), 0.0)).all()
