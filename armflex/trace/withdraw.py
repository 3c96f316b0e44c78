"""Never worse: effects are withdrawn until held-out poses are predicted no worse than by the calibrated arm.

For every fold of the poses what was chosen is chosen again without it: for one effect after the other the law and its
place, among those that competed when it was added and the other effects, from the beginning the values inside the law
that are not linear, and whether it is added at all. All else is refitted in the linear problem about the final fit.
Only what competed at last, and which families there are, was decided with every reading in sight. How often the other
poses alone lead to the same law at the same place is how often a name survives resampling; a name that another clearly
outlives gives way.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from armflex.conventions import Array
from armflex.errors import ArmflexError
from armflex.estimate.block import amplitude_prior
from armflex.estimate.fit import THOROUGH, Fit
from armflex.estimate.held_out import errors_of, held_out, judged_by, near, pose_folds
from armflex.estimate.robust import huber_weights, robust_limit
from armflex.estimate.view import look
from armflex.laws.effects.effect import Effect, EffectLaw, Values
from armflex.laws.effects.location import Location
from armflex.linear_gaussian import most_probable
from armflex.trace.candidates import Candidate, bank, candidate_regressors, grid, sift
from armflex.trace.exchange import SAME, in_place
from armflex.trace.polish import polish
from armflex.trace.projection import projected, ridge_for
from armflex.trace.search import TIE, searched
from armflex.trace.state import State, context_at, information, sorted_out, with_random, without
from armflex.trace.unrecorded import PoseBlock

SURVIVES = 0.5
"""Share of the folds below which a name is doubted."""


@dataclass(frozen=True)
class Compared:
    """RMS of the 3-D error on held-out poses, of the calibrated arm and with what was found [m].

    Attributes:
        before, after: Laws, places and values inside laws chosen, and all fitted, without the poses; over every row
            that either comes near.
        linear_before, linear_after: Values inside laws as they are, all else fitted without the poses; over the rows
            that the fits use.
        names: For every effect what was chosen in its stead without each fold of the poses: law, site and axis, or ''
            for nothing; empty for members of families, which are not chosen again.
    """

    before: float
    after: float
    linear_before: float
    linear_after: float
    names: tuple[tuple[str, ...], ...] = ()

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
        family: Whether the effect is the first of a family.
    """

    effect: Effect | None
    random: PoseBlock | None
    compared: Compared
    family: bool = False

    @property
    def title(self) -> str:
        """What it is in words."""
        if self.effect is not None:
            return f"{self.effect.law.name.replace('_', ' ')} at every drive" if self.family else self.effect.title
        assert self.random is not None
        return f"random twist at {self.random.site} ({self.random.axis})"

    @property
    def errors(self) -> tuple[float, float]:
        """RMS on held-out poses of the calibrated arm and with it [m], as it is worse."""
        found = self.compared
        if found.after > found.before:
            return found.before, found.after
        return found.linear_before, found.linear_after


Kept = tuple[State, tuple[Withdrawn, ...], Compared | None]


def never_worse(state: State, known: Compared | None = None) -> Kept:
    """Return the state with the effects that are left, those withdrawn, and how the arm with the others compares.

    A name that fewer than half of the folds lead to goes too, or gives way to one that they do, where poses held out
    are then predicted as well, chosen again without them; and where the readings themselves speak for the name, also
    with laws, places and what is inside laws as they are. What is `known` of how the state compares is not worked out
    again.
    """
    withdrawn: list[Withdrawn] = []
    while state.effects or state.random:
        if known is None:
            state.say("predicting held-out poses, with what is chosen and fitted without them")
        found, known = known or compared(state), None
        if not found.worse:
            trials = [partial(_outlived, state, found)]
            trials += [partial(without, state, index) for index in _doubtful(state, found)]
            for trial in trials:
                with contextlib.suppress(ArmflexError):
                    after = trial()
                    if after is None or not after.effects or after.strain > state.strain + SAME:
                        continue  # what only priors speak for, poses held out cannot speak against
                    again = compared(after)
                    alike = again.linear_after <= found.linear_after or _as_likely(after, state)
                    if again.after <= found.after and alike and not again.worse:
                        state.say("continuing without an effect that other poses do not select")
                        return _joined(withdrawn, never_worse(after, again))
            return state, tuple(withdrawn), found
        unit, rest = _best_without(state)
        effect = state.fitted[unit[0]] if unit else None
        withdrawn.append(Withdrawn(effect, state.random if effect is None else None, found, len(unit) > 1))
        state.say(f"withdrawing {withdrawn[-1].title}: held-out poses are predicted worse with it")
        state = rest if rest.effects or rest.random else _bare(rest)
    return state, tuple(withdrawn), None


def _as_likely(after: State, state: State) -> bool:
    """Return whether the readings do not tell a state from another, as little as they tell two candidates apart."""
    limit = robust_limit(state.fit.view)
    return information(after, limit, below=True) <= information(state, limit, below=True) + SAME


def _joined(withdrawn: list[Withdrawn], rest: Kept) -> Kept:
    return rest[0], (*withdrawn, *rest[1]), rest[2]


def _doubtful(state: State, found: Compared) -> list[int]:
    """Return the places of effects that fewer than half of the folds lead to, the least often found first."""
    shares = [
        (names.count(effect.name) / len(names), index)
        for index, (effect, names) in enumerate(zip(state.fitted, found.names, strict=True))
        if names
    ]
    return [index for share, index in sorted(shares) if share < SURVIVES]


def compared(state: State) -> Compared:
    """Return the errors of the calibrated arm and of a state on held-out poses.

    Every row asked for that tells what the effects depend on is judged, also those that no fit uses, where either comes
    near it.
    """
    rows = state.asked[~state.untold]
    folds = pose_folds(state.measurements.pose_number[rows])
    before, after = (_seen(fit, state, rows) for fit in (state.calibrated, state.fit))
    judged, used = near(before.view, after.view), np.isin(rows, state.rows)
    readings = before.view.readings.where(judged)
    read = readings.foremost_count > 0
    plain = before.regressors, before.prior, before.residual + before.regressors @ before.values
    left: tuple[list[Array], list[Array]] = ([], [])
    names: list[list[str]] = [[] for _ in state.effects]
    for number in range(int(folds.max()) + 1):
        state.tell("without some poses", number, int(folds.max()) + 1)
        learned, asked = used & (folds != number), read & (folds == number)
        again, best = _chosen_again(after, state, learned)
        for own, one in zip(names, best, strict=True):
            own.extend([] if one is None else [one])
        for errors, fit, problem in ((left[0], before, plain), (left[1], after, again)):
            regressors, prior, data = problem
            mask = np.repeat(learned, len(data) // len(learned))
            error = data - regressors @ most_probable(regressors[mask], prior**-2.0, data[mask])
            errors.append(readings.row_squares(errors_of(fit, error))[asked])
    refitted = [float(np.sqrt(np.concatenate(squares).mean())) for squares in left]
    groups, both = pose_folds(state.groups), judged_by(state.calibrated, state.fit)
    linear = [held_out(fit, groups, judged=both).rms for fit in (state.calibrated, state.fit)]
    return Compared(refitted[0], refitted[1], linear[0], linear[1], tuple(tuple(one) for one in names))


def _seen(fit: Fit, state: State, rows: np.ndarray) -> Fit:
    """Return a fit with its values as other rows see them."""
    if np.array_equal(rows, fit.view.rows):
        return fit
    view = look(fit.setup, state.measurements, rows)
    return replace(fit, view=view, weights=huber_weights(view, robust_limit(fit.view)))


def _chosen_again(fit: Fit, state: State, learned: np.ndarray) -> tuple[tuple[Array, Array, Array], list[str | None]]:
    """Return columns, prior and readings of the linear problem about a fit, its effects found anew from some rows.

    One effect after the other is chosen among what competed when one was added and all the others, because other rows
    may show first what all of them showed later; one that these rows speak against is left out. With the name of each,
    whenever it was chosen: '' where it is left out, None for a member of a family, which stays.

    Args:
        fit: The state's, as all rows see it.
        state: The state.
        learned: (M,) rows to learn from.
    """
    masked = replace(fit, weights=np.where(learned[:, None], fit.weights, 0.0))
    values, own = fit.values.copy(), [np.zeros(0, dtype=int)]
    alone = {unit[0] for unit in state.units if len(unit) == 1}
    for block in (state.effects[i] for i in sorted(alone)):
        places = fit.places(block)
        own.append(places)
        values[places[len(block.effect.location.terms) :]] = 0.0  # inner values are none of a linear problem's own
    rest = np.setdiff1d(np.arange(len(values)), np.concatenate(own))
    regressors, prior, data = fit.regressors[:, rest], fit.prior[rest], fit.residual + fit.regressors @ values
    mask, count = np.repeat(learned, len(data) // len(learned)), int(np.isfinite(fit.view.sigma[learned]).sum())
    problem = projected(regressors * mask[:, None], prior**-2.0, data * mask, ridge_for(fit), count)
    details = {_place_of(one): one.inner for one in state.fitted}
    names: list[str | None] = [None for _ in state.effects]
    chosen: list[str] = []
    for index in sorted(alone):
        block, step = state.effects[index], state.steps[index]
        hypotheses = [one.candidate for one in step.ranking] if step is not None else []
        others = [state.effects[i].effect for i in sorted(alone - {index})]
        places = dict.fromkeys([_place_of(one) for one in (block.effect, *others, *hypotheses)])
        tried = (
            Candidate(law, location, _detailed(law, i, details.get((law, location), i)))
            for law, location in places
            for i in grid(law, location, state.context)
        )
        found = searched(
            sift(bank(tried, masked, state.context, state.tell), problem), masked, state.context, len(places)
        )
        best = polish(found.first.candidate, masked, state.context, problem) if found.ranking else None
        same = [one.candidate for one in found.ranking if _place_of(one.candidate) == _place_of(block.effect)]
        if best is not None and same and _place_of(best.candidate) != _place_of(block.effect):
            own = polish(same[0], masked, state.context, problem)
            best = own if own.evidence >= best.evidence - TIE else best
        chosen.append("")
        if best is not None and best.evidence > 0.0:
            chosen[-1] = best.candidate.name
            ridge = amplitude_prior(best.effect, (), fit.view, state.context)
            more = candidate_regressors(best.candidate, fit, state.context)
            regressors, prior = np.hstack([regressors, more]), np.concatenate([prior, ridge])
            columns = np.hstack([problem.regressors, more * mask[:, None]])
            problem = problem.with_fitted(columns, np.concatenate([problem.precision, ridge**-2.0]))
    for index in sorted(alone):
        if state.fitted[index].name in chosen:
            names[index] = chosen.pop(chosen.index(state.fitted[index].name))
    for index in sorted(alone):
        names[index] = chosen.pop(0) if names[index] is None else names[index]
    return (regressors, prior, data), names


def _detailed(law: EffectLaw, inner: Values, fitted: Values) -> Values:
    """Return inner values with those that no search looks for as a fit has them."""
    return tuple(b if one.spread else a for one, a, b in zip(law.inner, inner, fitted, strict=True))


def _place_of(one: Candidate | Effect) -> tuple[EffectLaw, Location]:
    return one.law, one.location


def _outlived(state: State, found: Compared) -> State | None:
    """Return the state without names that another outlives in most folds, but with that one; None where there is none.

    The other must do as well with all rows as data tell two apart.
    """
    after = state
    for index, names in enumerate(found.names):
        own, step = state.fitted[index].name, state.steps[index]
        best, times = Counter(names).most_common(1)[0] if names else ("", 0)
        if best and best != own and 2 * times > len(names) and step is not None:
            physical = state.fitted[index].law.physical
            others = [one for one in step.ranking if one.candidate.name == best]
            others = [one for one in others if one.candidate.law.physical >= physical]
            *_, after = (after, *(in_place(after, (index,))(others[0], -SAME) if others else ()))
    return None if after is state else after


def _best_without(state: State) -> tuple[tuple[int, ...], State]:
    """Return which effect or family (none: the random twist) is best left out, and the state without it."""
    trials: list[tuple[float, tuple[int, ...], State]] = []
    folds, judged = pose_folds(state.groups), judged_by(state.calibrated, state.fit)
    for unit in (*state.units, *(() if state.random is None else ((),))):
        with contextlib.suppress(ArmflexError):
            trial = without(state, *unit) if unit else with_random(state, None)
            trials.append((held_out(trial.fit, folds, judged=judged).rms, unit, trial))
    if not trials:
        return (len(state.effects) - 1,) if state.effects else (), _bare(state)
    _, unit, trial = min(trials, key=lambda one: one[:2])
    with contextlib.suppress(ArmflexError):
        trial = sorted_out(trial)
    return unit, trial


def _bare(state: State) -> State:
    """Return the calibration itself as a state: just the values that it has for the rows in use."""

    def at(fitted: Fit) -> State:
        context = context_at(fitted, state.measurements)
        return replace(state, rows=fitted.view.rows, effects=(), steps=(), random=None, fit=fitted, context=context)

    return at(sorted_out(at(state.first), THOROUGH).calibrated)
