"""Errors on rows that a learner has not seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from armflex.bench.fitted import Learner
from armflex.conventions import Array
from armflex.errors import ConvergenceError, InputError
from armflex.laws.law import NOWHERE, Law
from armflex.measured.joint_data import JointData

BAND = 1.96
"""Standard deviations each side of a 95 % band."""


Step = Callable[[Array], bool | None]


@dataclass(frozen=True)
class HeldOut:
    """Every row as a fit without it saw it.

    Attributes:
        residual: (N, k) measured minus predicted [m, rad].
        std: (N, k) predicted standard deviation, noise included; nan where a law carries none.
        how: How rows were held out.
    """

    residual: Array
    std: Array
    how: str

    @property
    def rms(self) -> Array:
        """(k,) RMS of each column [m, rad]."""
        return np.sqrt((self.residual**2).mean(axis=0))

    @property
    def coverage(self) -> float | None:
        """Share of held-out numbers inside their 95 % band, None where a law carries no uncertainty."""
        if not np.isfinite(self.std).all():
            return None
        return float((np.abs(self.residual) <= BAND * self.std).mean())


def random_folds(count: int, folds: int, seed: int) -> np.ndarray:
    """Return (N,) folds of nearly equal size, drawn by seed."""
    return np.random.default_rng(seed).permutation(count) % min(folds, count)


def hold_out(learner: Learner, data: JointData, fold: np.ndarray, seed: int = 0, step: Step | None = None) -> HeldOut:
    """Return every row's error from a fit without its fold.

    Args:
        learner: What is held out.
        data: The rows.
        fold: (N,) label of each row's fold.
        seed: Of the learner.
        step: Called after every fold with the (N, k) residuals so far, nan where a row has not had its turn; the rest
            is left where it returns False.

    Raises:
        InputError: The other rows do not determine the model.
        ConvergenceError: A chain on the other rows has not converged.
    """
    residual, std = np.full_like(data.deflections, np.nan), np.full_like(data.deflections, np.nan)
    for label in np.unique(fold):
        out = fold == label
        law = _without(learner, data, out, seed)
        residual[out] = data.deflections[out] - predicted(law, data.loads[out])
        std[out] = spread(law, data.loads[out])
        if step and step(residual) is False:
            break
    folds = len(np.unique(fold))
    return HeldOut(residual, std, "leave-one-out" if folds == len(data) else f"{folds}-fold")


def _without(learner: Learner, data: JointData, out: np.ndarray, seed: int) -> Law:
    try:
        return learner(data.loads[~out], data.deflections[~out], seed).law
    except (InputError, ConvergenceError) as error:
        rows = f"data row {int(out.argmax()) + 1}{f' and {out.sum() - 1} others' if out.sum() > 1 else ''}"
        if isinstance(error, ConvergenceError):
            raise ConvergenceError(f"held-out error, without {rows}: {error}", error.history) from None
        raise InputError(f"the held-out error needs more rows: without {rows}, {error}") from None


def predicted(law: Law, loads: Array) -> Array:
    """Return the (N, k) deflections of (N, k) loads."""
    return law.twist(wrenches(loads), NOWHERE)[:, : loads.shape[1]]


def spread(law: Law, loads: Array) -> Array:
    """Return the (N, k) standard deviations of what is predicted, nan where the law carries none."""
    size = loads.shape[1]
    found = np.full(loads.shape, np.nan)
    for i, wrench in enumerate(wrenches(loads)):
        covariance = law.covariance(wrench, NOWHERE)
        if covariance is not None:
            found[i] = np.sqrt(np.diag(covariance)[:size])
    return found


def wrenches(loads: Array) -> Array:
    """Return (N, k) loads as (N, 6) wrenches, moments zero where there are none."""
    return np.hstack([loads, np.zeros((len(loads), 6 - loads.shape[1]))])
