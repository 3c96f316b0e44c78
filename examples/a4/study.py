"""What each model makes of the surrogate bench, and networks of several sizes over many benches."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from a4.surrogate import NOISE, Bench, Rows, bench

from armflex.bench.cross_validation import BAND
from armflex.bench.fit_network import fit_network
from armflex.bench.fitted import NOWHERE, Fitted, Learner, predicted, stated_std, wrenches
from armflex.bench.learners import Options, learner
from armflex.bench.network_problem import GROUPS
from armflex.conventions import Array
from armflex.errors import UnsupportedError
from armflex.laws.joint.network import NetworkLaw
from armflex.laws.law import Law

NEURONS = 20
PARAMETRIC, ANN = "parametric (diagonal)", "ANN, plain LM, 3-20-3"
FOUND, EVIDENCE = "terms as found", "ANN by evidence, 3-20-3"
LAPLACE, NUTS = "Bayesian ANN, Laplace", "Bayesian ANN, NUTS"


def _plain(loads: Array, deflections: Array, seed: int) -> Fitted:
    """Train the paper's way: one start, its damping, at most its 1000 iterations, nothing against following noise."""
    return fit_network(loads, deflections, NEURONS, starts=1, seed=seed, prior=None, iterations=1000)


MODELS: dict[str, Learner] = {
    PARAMETRIC: learner("linear", Options(structure="diagonal")),
    ANN: _plain,
    LAPLACE: learner("bayesian", Options(neurons=NEURONS)),
    NUTS: learner("bayesian", Options(neurons=NEURONS, sampler="nuts", allow_unconverged=True)),
    "full linear": learner("linear", Options()),
    "full + radial + magnitude": learner("polynomial", Options(features=("radial", "magnitude"))),
    FOUND: learner("polynomial", Options(features=("found",))),
    EVIDENCE: learner("neural", Options(neurons=NEURONS)),
}
"""The paper's three kinds first. Evidence and Laplace are one model of 10 and of 3 starts; both know their weights'
covariance."""


@dataclass(frozen=True)
class Score:
    """How a law does on a bench.

    Attributes:
        training, new: (3,) RMS of measured minus predicted [m].
        exact: (3,) RMS of exact minus predicted on many rows without noise [m].
        inside: (3,) share of new readings inside their 95 % band; of a law without uncertainty, of the noise alone.
        density: Mean log density of a new reading, less that of who knows the exact law and noise; 0 is perfect.
    """

    training: Array
    new: Array
    exact: Array
    inside: Array
    density: float


@dataclass(frozen=True)
class Trial:
    """A model trained on one bench."""

    name: str
    seed: int
    fitted: Fitted
    score: Score


def fit_all(at: Bench, seed: int, quick: bool) -> dict[str, Trial]:
    """Return every model trained on one bench; without NUTS where it is not installed, or time is short."""
    trials = {}
    for name, learn in MODELS.items():
        try:
            if not (quick and name == NUTS):
                trials[name] = _trial(name, learn, at, seed)
        except UnsupportedError as error:
            print(f"{name} is left out: {error}")
    return trials


def over_benches(seeds: Sequence[int], sizes: Sequence[int], quick: bool) -> dict[str, list[Trial]]:
    """Return models and Laplace posteriors of networks of several sizes, each trained on a bench of each seed."""
    learners = {name: MODELS[name] for name in (PARAMETRIC, FOUND, ANN, *(() if quick else (EVIDENCE,)))}
    learners |= {sized(size): learner("bayesian", Options(neurons=size)) for size in sizes}
    benches = {seed: bench(seed) for seed in seeds}
    return {name: [_trial(name, learn, at, seed) for seed, at in benches.items()] for name, learn in learners.items()}


def sized(size: int) -> str:
    """Return the name of the Laplace posterior of a network of so many neurons."""
    return f"Bayesian ANN, Laplace, 3-{size}-3"


def _trial(name: str, learn: Learner, at: Bench, seed: int) -> Trial:
    fitted = learn(at.training.loads, at.training.measured, seed)
    return Trial(name, seed, fitted, score(fitted.law, at))


def score(law: Law, at: Bench) -> Score:
    """Return how a law does on a bench."""
    training, new = (rms(rows.measured - predicted(law, rows.loads)) for rows in (at.training, at.new))
    exact = rms(at.many.exact - predicted(law, at.many.loads))
    errors = np.abs(at.new.measured - predicted(law, at.new.loads))
    inside = (errors <= BAND * stated_std(law, at.new.loads)).mean(axis=0)
    return Score(training, new, exact, inside, _density(law, at.new))


def rms(errors: Array) -> Array:
    """Return the RMS of each column."""
    return np.sqrt((errors**2).mean(axis=0))


def _density(law: Law, rows: Rows) -> float:
    known = np.array([law.covariance(wrench, NOWHERE)[:3, :3] for wrench in wrenches(rows.loads)])
    best = np.broadcast_to(np.diag(NOISE**2), known.shape)
    errors = rows.measured - predicted(law, rows.loads)
    return float((_log_normal(errors, known) - _log_normal(rows.measured - rows.exact, best)).mean())


def _log_normal(errors: Array, covariances: Array) -> Array:
    """Return (N,) log densities, less a constant, of (N, 3) errors under (N, 3, 3) covariances."""
    squares = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors)
    return -0.5 * (squares + np.linalg.slogdet(covariances)[1])


def determined(fitted: Fitted) -> Array:
    """Return the share of each weight that the data determine, the largest first: 1 - (posterior / prior deviation)^2.

    They add up to the effective number of weights.
    """
    law: Any = fitted.law
    own = np.array([fitted.parameters["precisions"][name] for name in GROUPS])[_groups(law)]
    return np.sort(1.0 - own * np.diag(law.weight_covariance))[::-1]


def _groups(law: NetworkLaw) -> np.ndarray:
    _, neurons, size = law.hidden.shape
    return np.array(([0] * size + [1]) * neurons + ([2] * neurons + [3]) * size)


def average(trials: Sequence[Trial], of: str) -> Any:
    """Return the mean over benches of a score or of a number that was found."""
    found = [getattr(trial.score, of, None) for trial in trials]
    return np.mean([trial.fitted.parameters[of] for trial in trials] if found[0] is None else found, axis=0)


def precisions(trials: Sequence[Trial]) -> Mapping[str, float]:
    """Return the geometric mean over benches of the precision of each group of weights."""
    logs = {name: [np.log(trial.fitted.parameters["precisions"][name]) for trial in trials] for name in GROUPS}
    return {name: float(np.exp(np.mean(values))) for name, values in logs.items()}
