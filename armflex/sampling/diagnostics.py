"""Whether chains have converged: rank-normalised split R-hat and bulk effective sample size.

Vehtari, Gelman, Simpson, Carpenter and Buerkner (2021), Bayesian Analysis 16(2), as arviz-stats computes them.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import ConvergenceError, ShapeError, UnsupportedError

RHAT_LIMIT = 1.01
ESS_LIMIT = 400.0
FEWEST_DRAWS = 4


@dataclass(frozen=True)
class Diagnostics:
    """How far a sampler can be trusted, judged on predictions and the noise; None where nothing was sampled.

    Attributes:
        rhat_max: Largest split R-hat.
        ess_min: Smallest bulk effective sample size.
        divergences: Transitions that a Hamiltonian sampler lost.
        acceptance: Share of proposals accepted.
        seconds: Time spent on sampling.
    """

    rhat_max: float | None = None
    ess_min: float | None = None
    divergences: int | None = None
    acceptance: float | None = None
    seconds: float | None = None


def rhat(draws: Array) -> Array:
    """Return the (q,) split R-hat of (chains, n, q) draws; infinite for a quantity that one chain never moved.

    Raises:
        ShapeError: Not three axes, fewer than two chains or than four draws.
        UnsupportedError: arviz-stats is not installed.
    """
    return _per_quantity("rhat", draws, np.inf)


def ess(draws: Array) -> Array:
    """Return the (q,) bulk effective sample size of (chains, n, q) draws; 0 for one that a chain never moved.

    Raises:
        ShapeError, UnsupportedError: As `rhat`.
    """
    return _per_quantity("ess", draws, 0.0)


def diagnose(
    draws: Array, divergences: int | None = None, acceptance: float | None = None, seconds: float | None = None
) -> Diagnostics:
    """Return the worst R-hat and effective sample size of (chains, n, q) draws of predictions and noise.

    Raises:
        ShapeError, UnsupportedError: As `rhat`.
    """
    return Diagnostics(float(rhat(draws).max()), float(ess(draws).min()), divergences, acceptance, seconds)


def check_converged(diagnostics: Diagnostics, allow_unconverged: bool = False) -> None:
    """Do nothing where chains can be trusted, where nothing was sampled, or where the caller takes them as they are.

    Raises:
        ConvergenceError: R-hat is 1.01 or more, fewer than 400 draws are effective, or transitions diverged.
    """
    problems = shortcomings(diagnostics)
    if problems and not allow_unconverged:
        text = f"the chains have not converged: {', '.join(problems)}"
        raise ConvergenceError(f"{text}; another sampler or a smaller model may do, allow_unconverged takes them", ())


def shortcomings(diagnostics: Diagnostics) -> list[str]:
    """Return why chains cannot be trusted, nothing where they can."""
    # Written as 'not better than', for NaN is not.
    problems = []
    if diagnostics.rhat_max is not None and not diagnostics.rhat_max < RHAT_LIMIT:
        problems.append(f"R-hat {diagnostics.rhat_max:.4g} (expected below {RHAT_LIMIT})")
    if diagnostics.ess_min is not None and not diagnostics.ess_min >= ESS_LIMIT:
        problems.append(f"effective sample size {diagnostics.ess_min:.0f} (expected at least {ESS_LIMIT:.0f})")
    if diagnostics.divergences:
        problems.append(f"{diagnostics.divergences} divergent transitions (expected none)")
    return problems


def _per_quantity(name: str, draws: Array, stuck: float) -> Array:
    draws = np.asarray(draws, dtype=float)
    if draws.ndim != 3 or draws.shape[0] < 2 or draws.shape[1] < FEWEST_DRAWS or draws.shape[2] < 1:
        raise ShapeError(f"draws: expected (chains > 1, n >= {FEWEST_DRAWS}, q > 0), got {draws.shape}")
    still = (draws == draws[:, :1]).all(axis=1).any(axis=0)
    judged = np.full(draws.shape[2], stuck)
    draws = draws[..., ~still]  # of order one: arviz-stats takes for constant whatever varies by less than 1e-15
    draws = (draws - draws.mean(axis=(0, 1))) / draws.std(axis=(0, 1))
    judged[~still] = getattr(judges(), name)(draws, chain_axis=0, draw_axis=1)
    return judged


def judges() -> Any:
    """Return the module that judges chains; raise `UnsupportedError` where it is not installed."""
    try:
        from arviz_stats.base.array import array_stats
    except ImportError:
        raise UnsupportedError("judging chains needs arviz-stats: pip install 'armflex[bayes]'") from None
    return array_stats
