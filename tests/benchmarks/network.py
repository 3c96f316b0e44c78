"""Training a 3-20-3 network on 91 rows: armflex beside torch with `jacrev` and scipy; then what asking it costs.

OPENBLAS_NUM_THREADS=1 python tests/benchmarks/network.py
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares as scipy_least_squares

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine, medians_us

from armflex.bench.fit_network import fit_network, network_law
from armflex.bench.network_problem import (
    PAPER,
    NetworkProblem,
    jacobian,
    minimise,
    predictions,
    scaled_problem,
    start_weights,
    sum_of_squares,
)
from armflex.conventions import Array
from armflex.laws import LinearLaw, Row

ROWS, STEPS, SEEDS, ROUNDS = 91, 200, 5, 3
NOISE = 1e-5
LARGEST = np.array([2e3, 1e3, 2.5e3])
COMPLIANCE = np.array([[1.3, 0.0, 1.3], [0.0, 12.5, -0.3], [0.6, -0.4, 47.1]]) * 1e-6
Trace = Callable[[NetworkProblem, Array], tuple[Array, Array]]
"""Problem and first weights -> costs, never rising, and seconds since the start, one of each per step."""


def bench(seed: int) -> tuple[Array, Array, Array, Array]:
    """Return loads and noisy deflections to train on, and loads and exact deflections to judge by [N, m]."""
    rng = np.random.default_rng(seed)
    curvature = 3e-11 * rng.normal(size=(3, 3, 3))
    loads = rng.uniform(-1.0, 1.0, size=(ROWS + 2000, 3)) * LARGEST
    exact = loads @ COMPLIANCE.T + np.einsum("cij,ni,nj->nc", curvature, loads, loads)
    measured = exact[:ROWS] + NOISE * rng.normal(size=(ROWS, 3))
    return loads[:ROWS], measured, loads[ROWS:], exact[ROWS:]


def own(problem: NetworkProblem, start: Array) -> tuple[Array, Array]:
    """The paper's damping schedule."""
    begun = time.perf_counter()
    costs = minimise(sum_of_squares(problem), start, STEPS).costs
    return costs, np.linspace(0.0, time.perf_counter() - begun, len(costs))


def with_torch(problem: NetworkProblem, start: Array) -> tuple[Array, Array]:
    """The same schedule, the Jacobian by reverse-mode automatic differentiation."""
    import torch
    from torch.func import jacrev

    torch.set_num_threads(1)
    errors, weights, mu = torch_errors(problem), torch.tensor(start), PAPER.start
    begun, error, derivative = time.perf_counter(), errors(weights), jacrev(errors)
    slopes, costs, seconds = derivative(weights), [0.5 * float(error @ error)], [0.0]
    for _ in range(STEPS):
        factor = torch.linalg.cholesky(slopes.T @ slopes + mu * torch.eye(len(weights), dtype=weights.dtype))
        trial = weights - torch.cholesky_solve((slopes.T @ error)[:, None], factor)[:, 0]
        other = errors(trial)
        if 0.5 * float(other @ other) < costs[-1]:
            weights, error, slopes, mu = trial, other, derivative(trial), max(mu / PAPER.factor, PAPER.floor)
        else:
            mu *= PAPER.factor
        costs.append(0.5 * float(error @ error))
        seconds.append(time.perf_counter() - begun)
    return np.array(costs), np.array(seconds)


def torch_errors(problem: NetworkProblem) -> Callable:
    """Return the (N k,) errors as a function of a tensor of weights."""
    import torch

    x, y, k, split = torch.tensor(problem.x), torch.tensor(problem.y), problem.size, 4 * problem.neurons

    def errors(weights: torch.Tensor) -> torch.Tensor:
        hidden, output = weights[:split].reshape(-1, k + 1), weights[split:].reshape(k, -1)
        values = torch.sigmoid(x @ hidden[:, :-1].T + hidden[:, -1])
        return (values @ output[:, :-1].T + output[:, -1] - y).reshape(-1)

    return errors


def with_scipy(problem: NetworkProblem, start: Array) -> tuple[Array, Array]:
    """MINPACK's Levenberg-Marquardt with the same analytic Jacobian."""
    costs, seconds, begun = [], [], time.perf_counter()

    def errors(weights: Array) -> Array:
        error = (predictions(problem, weights) - problem.y).ravel()
        costs.append(0.5 * error @ error)
        seconds.append(time.perf_counter() - begun)
        return error

    slopes = lambda weights: jacobian(problem, weights).reshape(-1, problem.count)  # noqa: E731
    scipy_least_squares(errors, start, slopes, method="lm", max_nfev=STEPS, ftol=1e-15, xtol=1e-15, gtol=1e-15)
    return np.minimum.accumulate(costs), np.array(seconds)


METHODS: dict[str, Trace] = {"armflex": own, "torch jacrev": with_torch, "scipy lm": with_scipy}


def rms(cost: float) -> float:
    """Return the error of a cost as a multiple of the scaled deflections' deviation."""
    return float(np.sqrt(2.0 * cost / (3 * ROWS)))


def training() -> None:
    runs: dict[str, list[tuple]] = {name: [] for name in METHODS}
    for seed in range(SEEDS):
        problem, _ = scaled_problem(*bench(seed)[:2], neurons=20)
        start = start_weights(problem, 1, seed)[0]
        for _ in range(ROUNDS):
            found = {name: method(problem, start) for name, method in METHODS.items()}
            goal = 1.001 * found["armflex"][0][-1]
            for name, (costs, seconds) in found.items():
                reached = int(np.argmax(costs <= goal)) if costs[-1] <= goal else -1
                ratio = seconds[-1] / found["armflex"][1][-1]
                to_goal = seconds[reached] if reached >= 0 else np.nan
                runs[name].append((seconds[-1], ratio, rms(costs[-1]), reached, to_goal))
    print(f"Levenberg-Marquardt, at most {STEPS} steps from the same weights, medians of {SEEDS} seeds x {ROUNDS}:")
    print(f"{'':>16} {'ms':>7} {'x armflex':>9} {'RMS':>10} {'steps to its RMS':>17} {'ms to it':>9}")
    for name, rows in runs.items():
        seconds, ratio, error, steps, to_goal = np.median(np.array(rows), axis=0)
        print(f"{name:>16} {seconds * 1e3:7.0f} {ratio:9.2f} {error:10.3e} {steps:17.0f} {to_goal * 1e3:9.0f}")
    print("(-1: not within these steps)")


def variants() -> None:
    print(f"\n{'one start':>16} {'ms':>7} {'train RMS / noise':>18} {'new loads, exact / noise':>25}")
    for prior in (None, "evidence"):
        rows = []
        for seed in range(SEEDS):
            loads, measured, new, exact = bench(seed)
            begun = time.perf_counter()
            law = fit_network(loads, measured, starts=1, seed=seed, prior=prior).law
            seconds = time.perf_counter() - begun
            errors = [(given, wanted) for given, wanted in ((loads, measured), (new, exact))]
            rows.append((seconds * 1e3, *(error(law, *pair) for pair in errors)))
        elapsed, trained, held_out = np.median(rows, axis=0)
        print(f"{prior or 'plain':>16} {elapsed:7.0f} {trained:18.2f} {held_out:25.2f}")


def error(law: object, loads: Array, wanted: Array) -> float:
    """Return the RMS error of a law as a multiple of the noise."""
    twists = law.twist(np.pad(loads, ((0, 0), (0, 3))), Row(np.zeros(0), {}))
    return float(np.sqrt(((twists[:, :3] - wanted) ** 2).mean()) / NOISE)


def asking() -> None:
    loads, measured, _, _ = bench(0)
    problem, scaling = scaled_problem(loads, measured, 20)
    row, wrench = Row(np.zeros(0), {}), np.array([300.0, -200.0, 500.0, 0.0, 0.0, 0.0])
    laws: dict[str, object] = {"linear": LinearLaw(np.eye(6))}
    for draws in (1, 200):
        laws[f"network x {draws}"] = network_law(start_weights(problem, draws, 0), np.ones(3), scaling, loads)
    calls = {
        f"{name} {what}": lambda law=law, what=what: getattr(law, what)(wrench, row)
        for name, law in laws.items()
        for what in ("twist", "tangent")
    }
    times = medians_us(calls)
    print(f"\n{'one load':>21} {'us':>7} {'x linear':>9}")
    for name, value in times.items():
        print(f"{name:>21} {value:7.1f} {value / times[f'linear {name.split()[-1]}']:9.1f}")


def main() -> None:
    print(machine())
    training()
    variants()
    asking()


if __name__ == "__main__":
    main()
