"""What every learner of a joint takes, loads and deflections, and what it gives: a law, which answers on a bench."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from armflex.conventions import WRENCH_NAMES, Array
from armflex.errors import IdentifiabilityError
from armflex.laws.law import NOWHERE, Law
from armflex.sampling.diagnostics import Diagnostics


@dataclass(frozen=True)
class Fitted:
    """A learned law.

    Attributes:
        law: Answers loads in SI with twists in SI; knows the loads it was trained on.
        parameters: What was found, by name, for people and JSON.
        diagnostics: Of the sampler, if one ran.
    """

    law: Law
    parameters: Mapping[str, Any]
    diagnostics: Diagnostics = field(default_factory=Diagnostics)


Learner = Callable[[Array, Array, int], Fitted]
"""(N, k) loads [N, Nm], (N, k) deflections [m, rad], seed -> what was learned; k = 3 or 6. Raises InputError."""


def wrenches(loads: Array) -> Array:
    """Return (N, k) loads as (N, 6) wrenches, moments zero where there are none."""
    return np.pad(loads, ((0, 0), (0, 6 - loads.shape[1])))


def predicted(law: Law, loads: Array) -> Array:
    """Return the (N, k) deflections of (N, k) loads."""
    return law.twist(wrenches(loads), NOWHERE)[:, : loads.shape[1]]


def stated_std(law: Law, loads: Array) -> Array:
    """Return the (N, k) standard deviations of what is predicted, nan where the law carries none."""
    stds = np.full(loads.shape, np.nan)
    for std, wrench in zip(stds, wrenches(loads), strict=True):
        if (covariance := law.covariance(wrench, NOWHERE)) is not None:
            std[:] = np.sqrt(np.diag(covariance)[: len(std)])
    return stds


def seen_loads(loads: Array) -> Array:
    """Return the (2, k) smallest and largest of (N, k) loads: what a law remembers of its training."""
    return np.array([loads.min(axis=0), loads.max(axis=0)])


def check_span(loads: Array) -> None:
    """Raise `IdentifiabilityError` where (N, k) loads [N, Nm] do not determine their k components."""
    size = loads.shape[1]
    check_determined(loads, WRENCH_NAMES[:size], f"loads do not span their {size} components")


def check_determined(columns: Array, names: Sequence[str], problem: str) -> None:
    """Raise `IdentifiabilityError` where a mixture of (N, P) columns is as good as zero on all rows, by name."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    _, values, directions = np.linalg.svd(scaled, full_matrices=False)
    # Of columns of equal length; beyond it some mixture of them is as good as zero on all rows.
    lost = values * 1e6 <= values[0]
    if lost.any():
        free = np.abs(directions[lost]).max(axis=0) > 0.1  # share from which a column counts among those of a mixture
        left = [name for name, each in zip(names, free, strict=True) if each]
        # Part of the largest singular value below which a smallest one is none
        condition = float(values[0] / values[-1]) if values[-1] > 1e-15 * values[0] else np.inf
        raise IdentifiabilityError(problem, int((~lost).sum()), condition, left)
