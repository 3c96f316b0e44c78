"""Guards of the whole: poses held out with everything chosen anew, what chance gives, and never worse than before."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from armflex.conventions import Array
from armflex.errors import ArmflexError
from armflex.estimate.fit import ROUGH, Fit, fit
from armflex.estimate.held_out import errors_of, folds_of, held_out, known_of_others, pose_folds
from armflex.estimate.view import look
from armflex.parameters import DOUBT
from armflex.trace.findings import Compared, Proof
from armflex.trace.screen import Dense
from armflex.trace.search import Standing
from armflex.trace.selection import SCALES, Model, climbed, log_likelihood, without
from armflex.trace.state import State

SIGN_FLIPS = 100
"""Tolerance: random signs of the residual that chance is read from."""


class Folds:
    """The linear problem of a state in parts: every fifth of the poses predicted from the others.

    Attributes:
        learned: (n,) readings of all poses but those of a fold, for every fold.
        parts: Evidence of what competes from those.
        readings, judged: What errors are over, and (M,) the rows that have any of it.
    """

    def __init__(self, here: Standing, evidence: Dense) -> None:
        state = here.state
        folds = np.repeat(pose_folds(state.groups), state.fit.view.residual.shape[1])
        self.here, self.whole = here, evidence
        self.learned = [folds != number for number in range(int(folds.max()) + 1)]
        self.parts = [evidence.of_rows(here.screen.projection, learned) for learned in self.learned]
        self.readings = state.fit.view.readings.where(state.judged)
        self.judged = self.readings.foremost_count > 0

    def errors(self, models: Sequence[Model]) -> Array:
        """Return the (M, n) errors of what is read foremost, predicted from the other folds with a model for each."""
        projection = self.here.screen.projection
        left = np.empty(len(projection.data))
        for part, learned, model in zip(self.parts, self.learned, models, strict=True):
            beside = part.beside(model)
            data = projection.data - self.whole.columns[:, beside.places] @ beside.values
            values = part.fitted.solve(projection.regressors.T @ np.where(learned, data, 0.0))
            left[~learned] = (data - projection.regressors @ values)[~learned]
        return errors_of(self.here.state.fit, self.here.screen.quiet * left)

    def squares(self, models: Sequence[Model]) -> Array:
        """Return the (M,) squared errors of every row [m^2], predicted from the other folds with a model for each."""
        return self.readings.row_squares(self.errors(models))

    def rms(self, squares: Array) -> float:
        """Return the RMS of (M,) squared errors over the rows that are judged [m]."""
        return float(np.sqrt(squares[self.judged].mean()))

    def apart(self, before: Array, after: Array) -> float:
        """Return by how many standard errors the mean of (M,) squared errors of a pose rises."""
        rise = np.bincount(self.here.state.groups, np.where(self.judged, after - before, 0.0))
        return float(rise.mean() / (rise.std() / np.sqrt(len(rise)) + 1e-300))


@dataclass(frozen=True, eq=False)
class Validated:
    """How a state predicts held-out poses, and what they say of every hypothesis.

    `errors` are (M, n) of what is read foremost on poses held out, everything chosen and fitted without them [m].
    """

    compared: Compared
    proofs: tuple[Proof, ...]
    errors: Array


def validated(here: Standing, evidence: Dense, null: float) -> Validated:
    """Return how a state predicts poses that were held out, of all that competes; `null` is what chance gives."""
    folds, own = Folds(here, evidence), evidence.here(here.model)
    anew, count = [climbed(part) for part in folds.parts], len(folds.parts)
    whole, chosen, state = folds.squares([own] * count), folds.errors(anew), here.state
    # The calibrated arm in its own linear problem: in that of the traced one it has not the values that it was given.
    poses = pose_folds(state.groups)
    before, exact = (held_out(one, poses, judged=state.judged).squares for one in (state.calibrated, state.fit))
    proofs = []
    for i in range(len(own)):
        share, instead = selected_anew(evidence, own, i, anew)
        less, sessions = folds.squares([without(own, i)] * count), sessions_held_out(state, state.units[i])
        first, last = sessions or (None, None)
        proofs.append(
            Proof(folds.rms(less), folds.rms(whole), first, last, folds.apart(whole, less), null, share, instead)
        )
    ways = [folds.readings.row_squares(chosen), whole]
    if folds.rms(exact) > folds.rms(before) >= max(map(folds.rms, ways)):
        exact = refitted_out(state, poses)
    ways += [] if exact is None else [exact]
    apart = max(folds.apart(before, one) for one in ways)
    first, after, *as_found = map(folds.rms, (before, *ways))
    return Validated(Compared(first, after, max(as_found), apart), tuple(proofs), chosen)


def selected_anew(
    evidence: Dense, own: Model, place: int, anew: Sequence[Model]
) -> tuple[float, tuple[tuple[str, float], ...]]:
    """Return the share of folds that select one hypothesis of a model, and what the others have in its place.

    That is what could explain most of what it explains beside the rest of the model, where that is more than half.
    """
    known, others = {c.number: evidence.groups[c.number].hypothesis for model in (own, *anew) for c in model}, Counter()
    for model in anew:
        if any(known[own[place].number].alike(known[c.number]) for c in model):
            continue
        new = [c for c in model if not any(known[c.number].alike(known[mine.number]) for mine in own)]
        shares = [(evidence.imitated(own, place, c), known[c.number].title) for c in new]
        share, title = max(shares, default=(0.0, ""))
        others[title if share > 0.5 else "nothing like it"] += 1
    return (len(anew) - others.total()) / len(anew), tuple((title, n / len(anew)) for title, n in others.most_common())


def refitted_out(state: State, folds: np.ndarray) -> Array | None:
    """Return the (M,) squared errors of rows [m^2], those of each of (M,) folds predicted by a fit without it.

    The linear problem is far off where few rows say what is inside a law, as where a magnet is that the arm comes near.
    None where no values inside laws are fitted, or a fit without a fold does not settle.
    """
    if state.random is not None or not any(block.free for block in state.effects):
        return None
    left, blocks = np.empty(state.judged.shape), (*state.blocks, *state.effects)
    for number in range(int(folds.max()) + 1):
        own = folds == number
        try:
            others = fit(state.declared, blocks, state.measurements, state.rows[~own], state.fit.values, effort=ROUGH)
            left[own] = look(others.setup, state.measurements, state.rows[own]).residual
        except ArmflexError:
            return None
    return state.fit.view.readings.where(state.judged).row_squares(left)


def chance(here: Standing, seed: int = 0) -> float:
    """Return the best log odds of any hypothesis where the residual of every pose has a random sign.

    Winkler et al. 2014 (NeuroImage 92): signs of exchangeable blocks, reduced-model residuals, maximum statistic. Over
    `SIGN_FLIPS` draws; the largest.
    """
    screen, state = here.screen, here.state
    beside = screen.beside(here.model)
    projection = screen.projection
    residual = projection.residual - projection.left_of(screen.explained(beside))
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (int(state.groups.max()) + 1, SIGN_FLIPS))
    flipped = residual[:, None] * np.repeat(signs[state.groups], len(residual) // len(state.rows), axis=0)
    every, best = screen.scores_of(flipped), -np.inf
    pulls = beside.inverse @ every[beside.places]
    objective = (flipped * projection.left_of(flipped)).sum(axis=0) - (pulls**2).sum(axis=0)
    here_value = log_likelihood(objective, screen.freedom)
    for block, scores in zip(screen.blocks, screen.parted(every), strict=True):
        left = scores - beside.across(block) @ pulls
        for (numbers, at, *_), inside in zip(block.batches, beside.reduced(block)[0], strict=True):
            values, axes = np.linalg.eigh(inside)
            squares = np.einsum("gki,gkf->gif", axes, left[at]) ** 2
            peaks = squares.max(axis=2)
            for tight in (SCALES**-2.0).tolist():  # one after the other, which takes less memory
                held = np.maximum(values, 0.0) + tight
                prior = block.priors[numbers, 0] - 0.5 * np.log(held / tight).sum(axis=1)
                most = (peaks / held).sum(axis=1)
                # No draw gains more than by the steepest slope of the likelihood on its way.
                steepest = 0.5 / np.maximum((objective.min() - most) / screen.freedom, 1.0)
                some = np.flatnonzero(prior + steepest * most > best)
                gain = (squares[some] / held[some, :, None]).sum(axis=1)
                logs = log_likelihood(np.maximum(objective - gain, 1e-9 * objective), screen.freedom) - here_value
                best = max(best, float((logs + prior[some, None]).max(initial=-np.inf)))
    return best


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
