"""Never worse: effects are withdrawn until held-out poses are predicted no worse than by the calibrated arm.

For every fold of the poses what was chosen is chosen again without it: for one effect after the other the law and its
place, among those that competed when it was added, and from the beginning the values inside the law that are not
linear. All else is refitted in the linear problem about the final fit. Only how many effects there are, and what
competed at last, was decided with every reading in sight.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from armflex.conventions import Array
from armflex.errors import ArmflexError
from armflex.estimate.effect_block import EffectBlock, amplitude_prior
from armflex.estimate.fit import THOROUGH, Fit
from armflex.estimate.held_out import believed, held_out, near, pose_folds
from armflex.estimate.robust import huber_weights
from armflex.estimate.view import look
from armflex.linear_gaussian import most_probable
from armflex.measured.measurements import Measurements
from armflex.trace.candidates import Candidate, bank, candidate_columns, grid, sift
from armflex.trace.exchange import Exchanged
from armflex.trace.findings import Compared, Step, Withdrawn
from armflex.trace.polish import polish
from armflex.trace.projection import projected, ridge_for
from armflex.trace.search import searched
from armflex.trace.state import State, fitted_to, scene_at, sorted_out, with_random, without


def never_worse(
    first: Fit, kept: Exchanged, steps: Sequence[Step], say: Callable[[str], None]
) -> tuple[Exchanged, tuple[Withdrawn, ...], Compared | None]:
    """Return the effects that are left, those withdrawn, and how the arm with the others compares.

    Args:
        first: The calibration, before anything was added.
        kept: The effects after second thoughts.
        steps: In which effects were added, with what competed.
        say: Called with what is being done.
    """
    withdrawn: list[Withdrawn] = []
    while kept.state.effects or kept.state.random:
        say("predicting held-out poses, with what is chosen and fitted without them")
        rivals = [tuple(one.candidate for one in steps[number].ranking) for number in kept.steps]
        found = compared(first, kept.state, rivals)
        if not found.worse:
            return kept, tuple(withdrawn), found
        index, state = _best_without(first, kept.state)
        blocks = kept.state.effects[index : index + 1]  # none: the random twist
        effects = [block.at(kept.state.values_of(block)) for block in blocks]
        withdrawn.append(Withdrawn(effects[0] if effects else None, None if effects else kept.state.random, found))
        say(f"withdrawing {withdrawn[-1].title}: held-out poses are predicted worse with it")
        kept = _gone(kept, index, state)
        if not kept.state.effects and not kept.state.random:
            kept = replace(kept, state=_bare(first, kept.state))
    return kept, tuple(withdrawn), None


def compared(first: Fit, state: State, rivals: Sequence[Sequence[Candidate]]) -> Compared:
    """Return the errors of the calibrated arm and of a state on held-out poses.

    Every row asked for that tells what the effects depend on is judged, also those that no fit uses, where either comes
    near it.

    Args:
        first: The calibration, before anything was added.
        state: The state.
        rivals: For every effect, what competed with it.
    """
    rows = state.asked[~state.untold]
    folds = pose_folds(state.measurements.pose_number[rows])
    calibrated = fitted_to(first, state.measurements, state.rows)
    before, after = (_seen(fit, state.measurements, rows) for fit in (calibrated, state.fit))
    judged, used = near(before.view, after.view), np.isin(rows, state.rows)
    left: list[list[Array]] = [[], []]
    for number in range(int(folds.max()) + 1):
        state.tell("without some poses", number, int(folds.max()) + 1)
        learned, asked = used & (folds != number), judged & (folds == number)
        problems = (before.columns, before.prior, _readings(before, ())), _chosen_again(after, state, rivals, learned)
        for errors, fit, problem in zip(left, (before, after), problems, strict=True):
            errors.append(_errors(fit, *problem, learned)[asked])
    refitted = [float(np.sqrt((np.concatenate(errors) ** 2).sum(axis=1).mean())) for errors in left]
    groups, both = pose_folds(state.groups), believed(calibrated, state.fit)
    linear = [held_out(fit, groups, judged=both).rms for fit in (calibrated, state.fit)]
    return Compared(refitted[0], refitted[1], linear[0], linear[1])


def _seen(fit: Fit, measurements: Measurements, rows: np.ndarray) -> Fit:
    """Return a fit with its values as other rows see them."""
    if np.array_equal(rows, fit.view.rows):
        return fit
    view = look(fit.setup, measurements, rows)
    return replace(fit, view=view, weights=huber_weights(view))


def _readings(fit: Fit, effects: Sequence[EffectBlock]) -> Array:
    """Return the (n,) whitened readings that a linear problem explains; inner values of effects are none of its own."""
    values = fit.values.copy()
    for block in effects:
        values[fit.places(block)[len(block.effect.location.terms) :]] = 0.0
    return fit.residual + fit.columns @ values


def _chosen_again(
    fit: Fit, state: State, rivals: Sequence[Sequence[Candidate]], learned: np.ndarray
) -> tuple[Array, Array, Array]:
    """Return columns, prior and readings of the linear problem about a fit, its effects found anew from some rows.

    One effect after the other is chosen in the order added; one that these rows speak against is left out.

    Args:
        fit: The state's, as all rows see it.
        state: The state.
        rivals: For every effect, what competed with it.
        learned: (M,) rows to learn from.
    """
    masked = replace(fit, weights=np.where(learned, fit.weights, 0.0))
    own = np.concatenate([np.zeros(0, dtype=int), *(fit.places(block) for block in state.effects)])
    rest = np.setdiff1d(np.arange(len(fit.values)), own)
    columns, prior, data = fit.columns[:, rest], fit.prior[rest], _readings(fit, state.effects)
    mask, count = np.repeat(learned, len(data) // len(learned)), int(np.isfinite(fit.view.sigma[learned]).sum())
    for block, others in zip(state.effects, rivals, strict=True):
        problem = projected(columns * mask[:, None], prior**-2.0, data * mask, ridge_for(fit), count)
        places = dict.fromkeys(
            [(block.effect.law, block.effect.location), *((one.law, one.location) for one in others)]
        )
        tried = (Candidate(law, location, i) for law, location in places for i in grid(law, location, state.scene))
        found = searched(sift(bank(tried, masked, state.scene, state.tell), problem), masked, state.scene, len(places))
        best = polish(found.first.candidate, masked, state.scene, problem) if found.ranking else None
        if best is not None and best.gain > 0.0:
            ridge = amplitude_prior(best.candidate.effect(best.amplitudes), (), fit.view, state.scene)
            columns = np.hstack([columns, candidate_columns(best.candidate, fit, state.scene)])
            prior = np.concatenate([prior, ridge])
    return columns, prior, data


def _errors(fit: Fit, columns: Array, prior: Array, data: Array, learned: np.ndarray) -> Array:
    """Return the (M, 3) errors [m] of a linear problem solved for some (M,) rows alone."""
    mask = np.repeat(learned, len(data) // len(learned))
    error = data - columns @ most_probable(columns[mask], prior**-2.0, data[mask])
    where = fit.view.positions
    return error.reshape(len(learned), -1)[:, where] / np.sqrt(fit.weights)[:, None] * fit.view.sigma[:, where]


def _best_without(first: Fit, state: State) -> tuple[int, State]:
    """Return which effect (after the last: the random twist) is best left out, and the state without it."""
    trials: list[tuple[float, int, State]] = []
    folds, calibrated = pose_folds(state.groups), fitted_to(first, state.measurements, state.rows)
    judged = believed(calibrated, state.fit)
    for index in range(len(state.effects) + (state.random is not None)):
        with contextlib.suppress(ArmflexError):
            trial = without(state, index) if index < len(state.effects) else with_random(state, None)
            trials.append((held_out(trial.fit, folds, judged=judged).rms, index, trial))
    if not trials:
        return len(state.effects) - 1 if state.effects else 0, _bare(first, state)
    _, index, trial = min(trials, key=lambda one: one[:2])
    with contextlib.suppress(ArmflexError):
        trial = sorted_out(trial)
    return index, trial


def _gone(kept: Exchanged, index: int, state: State) -> Exchanged:
    """Return what is kept with the state after one of its effects, or the random twist, was taken out."""
    if not state.effects:
        return Exchanged(state, ())
    if index >= len(kept.steps):
        return replace(kept, state=state)
    steps = tuple(step for i, step in enumerate(kept.steps) if i != index)
    return Exchanged(state, steps, frozenset(i - (i > index) for i in kept.fresh if i != index))


def _bare(first: Fit, state: State) -> State:
    """Return the calibration itself as a state: just the values that it has for the rows in use."""
    bare = sorted_out(_at(first, state), THOROUGH)
    return _at(fitted_to(first, bare.measurements, bare.rows), bare)


def _at(fitted: Fit, state: State) -> State:
    scene = scene_at(fitted, state.measurements)
    return replace(state, rows=fitted.view.rows, effects=(), random=None, fit=fitted, scene=scene)
