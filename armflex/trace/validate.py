"""Errors of what was held out: poses, with everything chosen anew without them, and whole sessions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtri

from armflex.conventions import Array
from armflex.estimate.fit import Fit
from armflex.estimate.held_out import errors_of, folds_of, held_out, known_of_others, pose_folds
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import DOUBT
from armflex.trace.screen import Dense
from armflex.trace.search import Standing
from armflex.trace.selection import Model, climbed, without
from armflex.trace.state import State


@dataclass(frozen=True)
class Proof:
    """Errors of rows that were not used, before and after an effect [m].

    Attributes:
        before, after: RMS of the 3-D error, poses held out.
        sessions_before, sessions_after: The same with whole sessions held out, over those without which it
            still shows; None where there are none.
        errors_apart: Standard errors by which the mean squared error falls.
    """

    before: float
    after: float
    sessions_before: float | None
    sessions_after: float | None
    errors_apart: float


@dataclass(frozen=True)
class Compared:
    """RMS of the 3-D error on held-out poses, of the calibrated arm and with what was found [m].

    Attributes:
        before: Of the calibrated arm, fitted without the poses.
        after: Laws, places and scales chosen, and all fitted, without them.
    """

    before: float
    after: float


class Folds:
    """A linear problem in folds, each predicted from the others.

    Attributes:
        learned: (n,) readings of all rows but those of a fold, for every fold.
        parts: Evidence of what competes from those.
        anew: The model that a climb finds there.
    """

    def __init__(self, evidence: Dense, folds: np.ndarray, begun: Model = ()) -> None:
        """Take (M,) folds of the rows; each climb is `begun` with a model."""
        of_readings = np.repeat(folds, len(evidence.projection.data) // len(folds))
        self.evidence = evidence
        self.learned = [of_readings != number for number in range(int(folds.max()) + 1)]
        self.parts = [evidence.of_rows(learned.astype(float)) for learned in self.learned]
        self.anew = [climbed(part, begun) for part in self.parts]

    def left(self, models: Sequence[Model]) -> Array:
        """Return the (n,) whitened errors of readings predicted from the other folds with a model for each."""
        whole = self.evidence.projection
        left = np.empty(len(whole.data))
        for part, learned, model in zip(self.parts, self.learned, models, strict=True):
            beside = part.beside(model)
            data = whole.data - self.evidence.columns[:, beside.places] @ beside.values
            values = part.projection.fitted.solve(whole.regressors.T @ np.where(learned, data, 0.0))
            left[~learned] = (data - whole.regressors @ values)[~learned]
        return left

    @cached_property
    def spread(self) -> list[tuple[np.ndarray, Array]]:
        """Places (k,) of the readings of every fold, and (k, r) R with R R' their variance as the others know them.

        By the model that each has, in units of the variance of a reading.
        """
        found, whole = [], self.evidence.projection
        for part, learned, model in zip(self.parts, self.learned, self.anew, strict=True):
            beside = part.beside(model)
            columns = np.hstack([whole.regressors, self.evidence.columns[:, beside.places]])
            known = LinearGaussian.of(columns[learned], np.concatenate([whole.precision, beside.held]))
            found.append((np.flatnonzero(~learned), columns[~learned] @ known.root))
        return found


@dataclass(frozen=True, eq=False)
class Validated:
    """How a state predicts held-out poses, and what they say of every hypothesis."""

    compared: Compared
    proofs: tuple[Proof, ...]


def validated(here: Standing, folds: Folds, predicted: Array) -> Validated:
    """Return how a state predicts poses that were held out, in folds of all that competes.

    `predicted` are (M, n) errors of what is read foremost, everything chosen and fitted without the poses [m].
    """
    own, state, count = folds.evidence.here(here.model), here.state, len(folds.parts)
    judged = state.fit.view.readings.where(state.judged)

    def errors(models: Sequence[Model]) -> Array:
        return errors_of(state.fit, state.quiet * folds.left(models))

    def rms(squares: Array) -> float:
        return float(np.sqrt(squares[judged.foremost_count > 0].mean()))

    whole, proofs = judged.row_squares(errors([own] * count)), []
    for i in range(len(own)):
        less = judged.row_squares(errors([without(own, i)] * count))
        rise = np.bincount(state.groups, np.where(judged.foremost_count > 0, less - whole, 0.0))
        apart = float(rise.mean() / (rise.std() / np.sqrt(len(rise)) + 1e-300))
        sessions = sessions_held_out(state, (i,)) or (None, None)
        proofs.append(Proof(rms(less), rms(whole), *sessions, apart))
    # The calibrated arm in its own linear problem: in that of the traced one it has not the values that it was given.
    before = held_out(state.calibrated, pose_folds(state.groups), judged=state.judged).squares
    return Validated(Compared(rms(before), rms(judged.row_squares(predicted))), tuple(proofs))


def sessions_held_out(state: State, new: Sequence[int]) -> tuple[float, float] | None:
    """Return the RMS of the 3-D error with whole sessions held out, before and after some effects came in [m].

    Over the sessions without which the others still show what is new: whether a tool slipped before the second of two
    sessions that no reading distinguishes from one of them. None where there are no such sessions.
    """
    before, after, judged = state.calibrated, state.fit, state.judged
    if len(set(state.sessions)) < 2 or not new:
        return None
    folds, frames = folds_of(after, state.sessions)
    able = _showing(after, np.concatenate([after.places(state.effects[i]) for i in new]), folds)
    if not (able & (before.view.readings.where(judged).foremost_count > 0)).any():
        return None
    first = held_out(before, *folds_of(before, state.sessions), judged=judged)
    return first.rms_of(able), held_out(after, folds, frames, judged).rms_of(able)


def _showing(fit: Fit, some: np.ndarray, folds: np.ndarray) -> np.ndarray:
    """Return (M,) whether the rows of other folds than a row's own still show some parameters."""
    values, able = fit.values[some], np.zeros(len(folds), bool)
    for number, left in enumerate(known_of_others(fit, folds)):
        determined = np.isfinite(left.std[some])  # what nothing determines without them shows nothing
        known, own = left.covariance[np.ix_(some[determined], some[determined])], values[determined]
        far = own @ np.linalg.pinv(known, hermitian=True) @ own if len(own) else 0.0
        able[folds == number] = far > chdtri(max(len(own), 1), DOUBT)  # than by chance
    return able
