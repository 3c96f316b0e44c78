"""Never worse: effects are withdrawn until held-out poses are predicted no worse than by the calibrated arm.

For every fold of the poses what was chosen is chosen again without it: for one effect after the other the law and its
place, among those that competed when it was added, and from the beginning the values inside the law that are not
linear. All else is refitted in the linear problem about the final fit. Only how many effects there are, and what
competed at last, was decided with every reading in sight.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import numpy as np

from armflex.conventions import Array
from armflex.errors import ArmflexError
from armflex.estimate.effect_block import amplitude_prior
from armflex.estimate.fit import THOROUGH, Fit
from armflex.estimate.held_out import believed, errors_of, held_out, near, pose_folds
from armflex.estimate.robust import huber_weights
from armflex.estimate.view import look
from armflex.laws.effects.effect import Effect
from armflex.linear_gaussian import most_probable
from armflex.trace.candidates import Candidate, bank, candidate_regressors, grid, sift
from armflex.trace.polish import polish
from armflex.trace.projection import projected, ridge_for
from armflex.trace.search import searched
from armflex.trace.state import State, context_at, sorted_out, with_random, without
from armflex.trace.unrecorded import PoseBlock


@dataclass(frozen=True)
class Compared:
    """RMS of the 3-D error on held-out poses, of the calibrated arm and with what was found [m].

    Attributes:
        before, after: Laws, places and values inside laws chosen, and all fitted, without the poses; over every row
            that either comes near.
        linear_before, linear_after: Values inside laws as they are, all else fitted without the poses; over the rows
            that the fits use.
    """

    before: float
    after: float
    linear_before: float
    linear_after: float

    @property
    def worse(self) -> bool:
        """Whether what was found makes it worse, in either way."""
        return self.after > self.before or self.linear_after > self.linear_before


@dataclass(frozen=True, eq=False)
class Withdrawn:
    """What was accepted and taken out again, because held-out poses were predicted worse with it.

    Attributes:
        effect: With the values that it had; None where it was a random twist.
        random: The random twist.
        compared: The errors with it.
    """

    effect: Effect | None
    random: PoseBlock | None
    compared: Compared

    @property
    def title(self) -> str:
        """What it is in words."""
        if self.effect is not None:
            return self.effect.title
        assert self.random is not None
        return f"random twist at {self.random.site} ({self.random.axis})"

    @property
    def errors(self) -> tuple[float, float]:
        """RMS on held-out poses of the calibrated arm and with it [m], as it is worse."""
        found = self.compared
        if found.after > found.before:
            return found.before, found.after
        return found.linear_before, found.linear_after


def never_worse(state: State) -> tuple[State, tuple[Withdrawn, ...], Compared | None]:
    """Return the state with the effects that are left, those withdrawn, and how the arm with the others compares."""
    withdrawn: list[Withdrawn] = []
    while state.effects or state.random:
        state.say("predicting held-out poses, with what is chosen and fitted without them")
        found = compared(state)
        if not found.worse:
            return state, tuple(withdrawn), found
        index, rest = _best_without(state)
        effect = state.fitted[index] if index < len(state.effects) else None
        withdrawn.append(Withdrawn(effect, state.random if effect is None else None, found))
        state.say(f"withdrawing {withdrawn[-1].title}: held-out poses are predicted worse with it")
        state = rest if rest.effects or rest.random else _bare(rest)
    return state, tuple(withdrawn), None


def compared(state: State) -> Compared:
    """Return the errors of the calibrated arm and of a state on held-out poses.

    Every row asked for that tells what the effects depend on is judged, also those that no fit uses, where either comes
    near it.
    """
    rows = state.asked[~state.untold]
    folds = pose_folds(state.measurements.pose_number[rows])
    before, after = (_seen(fit, state, rows) for fit in (state.calibrated, state.fit))
    judged, used = near(before.view, after.view), np.isin(rows, state.rows)
    plain = before.regressors, before.prior, before.residual + before.regressors @ before.values
    left: tuple[list[Array], list[Array]] = ([], [])
    for number in range(int(folds.max()) + 1):
        state.tell("without some poses", number, int(folds.max()) + 1)
        learned, asked = used & (folds != number), judged & (folds == number)
        for errors, fit, problem in (
            (left[0], before, plain),
            (left[1], after, _chosen_again(after, state, learned)),
        ):
            regressors, prior, data = problem
            mask = np.repeat(learned, len(data) // len(learned))
            error = data - regressors @ most_probable(regressors[mask], prior**-2.0, data[mask])
            errors.append(errors_of(fit, error)[asked])
    refitted = [float(np.sqrt((np.concatenate(errors) ** 2).sum(axis=1).mean())) for errors in left]
    groups, both = pose_folds(state.groups), believed(state.calibrated, state.fit)
    linear = [held_out(fit, groups, judged=both).rms for fit in (state.calibrated, state.fit)]
    return Compared(refitted[0], refitted[1], linear[0], linear[1])


def _seen(fit: Fit, state: State, rows: np.ndarray) -> Fit:
    """Return a fit with its values as other rows see them."""
    if np.array_equal(rows, fit.view.rows):
        return fit
    view = look(fit.setup, state.measurements, rows)
    return replace(fit, view=view, weights=huber_weights(view))


def _chosen_again(fit: Fit, state: State, learned: np.ndarray) -> tuple[Array, Array, Array]:
    """Return columns, prior and readings of the linear problem about a fit, its effects found anew from some rows.

    One effect after the other is chosen in the order added, among what competed with it; one that these rows speak
    against is left out.

    Args:
        fit: The state's, as all rows see it.
        state: The state.
        learned: (M,) rows to learn from.
    """
    masked = replace(fit, weights=np.where(learned[:, None], fit.weights, 0.0))
    values, own = fit.values.copy(), [np.zeros(0, dtype=int)]
    for block in state.effects:
        places = fit.places(block)
        own.append(places)
        values[places[len(block.effect.location.terms) :]] = 0.0  # inner values are none of a linear problem's own
    rest = np.setdiff1d(np.arange(len(values)), np.concatenate(own))
    regressors, prior, data = fit.regressors[:, rest], fit.prior[rest], fit.residual + fit.regressors @ values
    mask, count = np.repeat(learned, len(data) // len(learned)), int(np.isfinite(fit.view.sigma[learned]).sum())
    for block, step in zip(state.effects, state.steps, strict=True):
        problem = projected(regressors * mask[:, None], prior**-2.0, data * mask, ridge_for(fit), count)
        hypotheses = [one.candidate for one in step.ranking] if step is not None else []
        places = dict.fromkeys([(one.law, one.location) for one in (block.effect, *hypotheses)])
        tried = (Candidate(law, location, i) for law, location in places for i in grid(law, location, state.context))
        found = searched(
            sift(bank(tried, masked, state.context, state.tell), problem), masked, state.context, len(places)
        )
        best = polish(found.first.candidate, masked, state.context, problem) if found.ranking else None
        if best is not None and best.gain > 0.0:
            ridge = amplitude_prior(best.effect, (), fit.view, state.context)
            regressors = np.hstack([regressors, candidate_regressors(best.candidate, fit, state.context)])
            prior = np.concatenate([prior, ridge])
    return regressors, prior, data


def _best_without(state: State) -> tuple[int, State]:
    """Return which effect (after the last: the random twist) is best left out, and the state without it."""
    trials: list[tuple[float, int, State]] = []
    folds, judged = pose_folds(state.groups), believed(state.calibrated, state.fit)
    for index in range(len(state.effects) + (state.random is not None)):
        with contextlib.suppress(ArmflexError):
            trial = without(state, index) if index < len(state.effects) else with_random(state, None)
            trials.append((held_out(trial.fit, folds, judged=judged).rms, index, trial))
    if not trials:
        return len(state.effects) - 1 if state.effects else 0, _bare(state)
    _, index, trial = min(trials, key=lambda one: one[:2])
    with contextlib.suppress(ArmflexError):
        trial = sorted_out(trial)
    return index, trial


def _bare(state: State) -> State:
    """Return the calibration itself as a state: just the values that it has for the rows in use."""

    def at(fitted: Fit) -> State:
        context = context_at(fitted, state.measurements)
        return replace(state, rows=fitted.view.rows, effects=(), steps=(), random=None, fit=fitted, context=context)

    return at(sorted_out(at(state.first), THOROUGH).calibrated)
