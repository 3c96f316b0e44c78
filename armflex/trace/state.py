"""The arm so far: what is declared, what was added to it, and the fit of everything together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from armflex.arm import Setup
from armflex.conventions import Array
from armflex.errors import ArmflexError
from armflex.estimate.block import Block, EffectBlock, amplitude_prior
from armflex.estimate.calibrate import Calibration
from armflex.estimate.fit import ROUGH, THOROUGH, Effort, Fit, fit, moved
from armflex.estimate.outliers import lost_readings
from armflex.estimate.view import look
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.context import Context, survey
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.in_arm import without_direction
from armflex.laws.effects.location import Location
from armflex.measured.measurements import Measurements
from armflex.mechanics.history import known_rows
from armflex.mechanics.response import respond
from armflex.parameters import numbers_of
from armflex.rows.rows import POSE
from armflex.trace.accept import Step
from armflex.trace.candidates import Bank, Candidate, bank, candidate_regressors, candidates_of
from armflex.trace.polish import Polished, sensible, unusual
from armflex.trace.projection import Projection, project, projected, ridge_for
from armflex.trace.search import Round, search
from armflex.trace.telling import Report, Tell, silent, tell_steps
from armflex.trace.unrecorded import PoseBlock


@dataclass(frozen=True, eq=False)
class State:
    """A fit of the declared parameters, the effects added so far, and a random twist where a cause is unknown.

    Attributes:
        calibration: Before anything was added, lost beams and all.
        first: The same without lost beams.
        measurements: The campaign.
        asked: Rows that were to be used.
        rows: Those of them in use: all but lost beams, and rows that do not tell what an added effect depends on.
        declared: Arm and instrument before any fit.
        blocks: Declared blocks.
        effects: Added effects, in the order added.
        random: Random twist per pose, None where there is none.
        fit: All of them together.
        context: The campaign as the catalogue sees it, at this fit.
        steps: For each effect how it, or what it stands for, was added; None of one that is yet to be proven.
        heed: Whether rows that are far off in company stay in use; see `lost_readings`.
        tell: Called with how far a search or a fit has come.
        say: Called with what is being done.
    """

    calibration: Calibration
    first: Fit
    measurements: Measurements
    asked: np.ndarray
    rows: np.ndarray
    declared: Setup
    blocks: tuple[Block, ...]
    effects: tuple[EffectBlock, ...]
    random: PoseBlock | None
    fit: Fit
    context: Context
    steps: tuple[Step | None, ...] = ()
    heed: bool = True
    tell: Tell = silent
    say: Report = silent

    @cached_property
    def calibrated(self) -> Fit:
        """The calibration, fitted to the rows in use."""
        first = self.first
        if np.array_equal(self.rows, first.view.rows):
            return first
        return fit(first.declared, first.blocks, self.measurements, self.rows, first.values)

    @cached_property
    def groups(self) -> np.ndarray:
        """(M,) pose number of every fitted row."""
        return np.unique(self.measurements.pose_number[self.rows], return_inverse=True)[1]

    @cached_property
    def untold(self) -> np.ndarray:
        """(A,) which of the rows asked for do not tell the direction that an added effect depends on.

        The search takes them as halfway, as what may be either; once the effect is there `predict` refuses such rows.
        """
        return without_direction([block.effect for block in self.effects], self.measurements)[self.asked]

    @property
    def alone(self) -> int:
        """Number of effects that were added by themselves, not with a family."""
        return sum(len(unit) == 1 for unit in self.units)

    @property
    def units(self) -> tuple[tuple[int, ...], ...]:
        """Places of the effects that came together: one, or all members of a family."""
        kin = [None if step is None or step.kin is None else step.kin.number for step in self.steps]
        numbers = dict.fromkeys(number for number in kin if number is not None)
        together = [tuple(i for i, one in enumerate(kin) if one == number) for number in numbers]
        return (*((i,) for i, one in enumerate(kin) if one is None), *together)

    @property
    def sessions(self) -> tuple[str, ...]:
        """Session of every fitted row."""
        return tuple(self.measurements.session[row] for row in self.rows)

    def uses(self, rows: np.ndarray) -> bool:
        """Return whether just these rows are in use."""
        return np.array_equal(rows, self.rows)

    @property
    def strain(self) -> float:
        """Sum of squares of the prior deviations of all that is fitted."""
        return float(((self.fit.values / self.fit.prior) ** 2).sum())

    def values_of(self, block: Block) -> Array:
        """Return the fitted values of one block."""
        return self.fit.values[self.fit.places(block)]

    def stds_of(self, block: Block) -> Array:
        """Return the standard uncertainties of one block's values."""
        return self.fit.posterior.std[self.fit.places(block)]

    @cached_property
    def fitted(self) -> tuple[Effect, ...]:
        """The added effects with the values that the fit gave them."""
        return tuple(block.at(self.values_of(block)) for block in self.effects)

    @cached_property
    def normal(self) -> tuple[Array, Array, float]:
        """(P, P) information that the readings have on all that is fitted but a random twist, which is eliminated.

        With it the (P,) score of what is left of the readings, and the square of that.
        """
        fit = self.fit
        told, score, left = fit.told, fit.regressors.T @ fit.residual, float(fit.residual @ fit.residual)
        if self.random is None:
            return told, score, left
        own = fit.places(self.random)
        rest = np.setdiff1d(np.arange(len(score)), own)
        values, precision = fit.values[own], fit.precision[own]
        held, pull = np.diag(told)[own] + precision, score[own] - precision * values
        between = told[np.ix_(rest, own)]
        score, left = score[rest] - between @ (pull / held), left + float(precision @ values**2 - pull @ (pull / held))
        return told[np.ix_(rest, rest)] - between / held @ between.T, score, left

    @cached_property
    def looked(self) -> Round:
        """What the catalogue and free shapes could still explain."""
        return search(self.physical, self.groups)

    @cached_property
    def physical(self) -> Bank:
        """Every candidate that is physics rather than a free shape."""
        laws = (law for law in EVERY.values() if law.physical)
        return bank(candidates_of(laws, self.context), self.fit, self.context, self.tell)


def begin(calibration: Calibration, tell: Tell = silent, say: Report = silent) -> State:
    """Return the state after a calibration `as_stated`: nothing added, lost beams left out."""
    fitted, measurements = calibration.fit, calibration.measurements
    state = State(
        calibration=calibration,
        first=fitted,
        measurements=measurements,
        asked=fitted.view.rows,
        rows=fitted.view.rows,
        declared=fitted.declared,
        blocks=fitted.blocks,
        effects=(),
        random=None,
        fit=fitted,
        context=context_at(fitted, measurements),
        tell=tell,
        say=say,
    )
    state = sorted_out(state, THOROUGH)
    return replace(state, first=state.fit)


def sorted_out(state: State, effort: Effort = ROUGH) -> State:
    """Return the state with the question put anew of which readings are lost beams, refitted where the answer changed.

    While an effect is missing, readings that it moves may look lost; once it is there, others stand out that did not.
    Rows before a joint's first motion leave with the first effect that must know its direction.
    """
    lost = lost_of(state, state.heed)
    used = ~(only_lost(state, lost) | state.untold)
    if state.uses(state.asked[used]) and np.array_equal(lost[used], lost_in(state)[used]):
        return state
    changed = replace(state, rows=state.asked[used], measurements=without_readings(state, lost & used[:, None]))
    return refit(changed, state.effects, state.random, state.fit.values, effort)


def lost_of(state: State, heed: bool) -> np.ndarray:
    """Return (A, G) which readings of the rows that were to be used are lost beams at a fit; see `lost_readings`."""
    asked, whole = state.asked, state.calibration.measurements
    same = state.uses(asked) and state.measurements is whole
    view = state.fit.view if same else look(state.fit.setup, whole, asked)
    return lost_readings(view, [whole.session[row] for row in asked], whole.pose_number[asked], heed)


def only_lost(state: State, lost: np.ndarray) -> np.ndarray:
    """Return (A,) which rows hold nothing but (A, G) lost readings."""
    whole = state.calibration.measurements.readings
    read = np.array([np.isfinite(whole.sigma[state.asked][:, place]).any(axis=1) for place in whole.groups]).T
    return np.all(lost | ~read, axis=1)


def without_readings(state: State, lost: np.ndarray) -> Measurements:
    """Return the campaign without (A, G) readings of the rows that were to be used."""
    whole = state.calibration.measurements
    kept = np.ones((len(whole), whole.readings.size), bool)
    for own, place in zip(lost.T, whole.readings.groups, strict=True):
        kept[state.asked[own], place] = False
    return whole if kept.all() else replace(whole, readings=whole.readings.where(kept))


def lost_in(state: State) -> np.ndarray:
    """Return (A, G) which readings of the rows that were to be used are left out of their rows by now."""
    whole, now = state.calibration.measurements.readings, state.measurements.readings
    pairs = [(whole.sigma[state.asked][:, place], now.sigma[state.asked][:, place]) for place in whole.groups]
    return np.array([(np.isfinite(one) & np.isinf(other)).any(axis=1) for one, other in pairs]).T


def lost_rows(state: State, heed: bool) -> np.ndarray:
    """Return which of the rows that were to be used hold nothing but lost beams at a fit; see `lost_of`."""
    return only_lost(state, lost_of(state, heed))


def context_at(fitted: Fit, measurements: Measurements) -> Context:
    """Return the campaign as the catalogue sees it at a fit: loads at every site of every driven row."""
    arm, view = fitted.setup.arm, fitted.view
    known = known_rows(arm, measurements) | {POSE: measurements.pose_number.astype(float)}
    wrenches = {site: np.empty((len(measurements), 6)) for site in view.line.sites}
    lines, rest = [(view.rows, view.line)], np.setdiff1d(np.arange(len(measurements)), view.rows)
    if len(rest):
        given = {name: values[rest] for name, values in known.items()}
        some = measurements.some(rest)
        lines.append((rest, respond(arm, some.q, some.payload, given, wrenches=some.wrenches)))
    for rows, line in lines:
        for site in wrenches:
            wrenches[site][rows] = line.load_at(site)
    return survey(measurements, arm, known, wrenches, view.line.links[:, :, :3, 3])


def add(state: State, found: Polished, place: int | None = None) -> State:
    """Return the state with a candidate added, or joined to the effect that it widens, and everything refitted.

    One effect with more terms are two of the same law and place, where nothing is searched between them. A new one
    comes at a `place` among the others, last when none is given.
    """
    fit, what = state.fit, found.effect
    # What is fitted already moves to make room.
    change = candidate_regressors(found.candidate, fit, state.context) @ found.amplitudes
    values = moved(fit.blocks, fit.values, -project(fit).absorbed(change))
    what = replace(what, derived=tuple(name for name in what.location.covariates if name in state.measurements.derived))
    what = what.seen_in(state.context, state.rows)
    starts = [values[fit.places(block)] for block in state.effects]
    place = len(starts) if place is None else place
    after, steps = place, (*state.steps[:place], None, *state.steps[place:])
    for i, block in enumerate(state.effects):
        if _without_terms(block.effect) == _without_terms(what) and not block.effect.law.inner:
            known, place, after, steps = block.at(starts[i]), i, i + 1, state.steps
            terms = tuple(sorted({*known.location.terms, *what.location.terms}))
            sums = tuple(a + b for a, b in zip(known.values, what.values, strict=True))
            what = replace(known, location=replace(known.location, terms=terms), values=sums)
            break
    prior = amplitude_prior(what, found.free, fit.view, state.context)
    block, known = EffectBlock(what, found.free, state.context, 0, prior), len(state.declared.arm.effects)
    effects = (*state.effects[:place], block, *state.effects[after:])
    effects = tuple(replace(one, ordinal=known + i) for i, one in enumerate(effects))
    starts[place:after] = [block.start]
    return refit(replace(state, steps=steps), effects, state.random, with_starts(state, values, starts))


def _without_terms(effect: Effect) -> tuple[str, Location]:
    return effect.law.name, replace(effect.location, terms=())


def places_of_effects(state: State, indices: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of some effects' values in the fit, and of their amplitudes alone."""
    places = [state.fit.places(state.effects[index]) for index in indices]
    terms = (len(state.effects[index].effect.location.terms) for index in indices)
    return np.concatenate(places), np.concatenate([one[:count] for one, count in zip(places, terms, strict=True)])


def leave_out(state: State, *indices: int) -> tuple[Projection, np.ndarray]:
    """Return the projection of the fit with some effects' columns and values taken out, and those columns' places."""
    fit, (own, amplitudes) = state.fit, places_of_effects(state, indices)
    rest = np.setdiff1d(np.arange(len(fit.values)), own)
    # The readings as they would be without the effect: linear in its amplitudes, so exact for them.
    data = (
        fit.residual
        + fit.regressors[:, amplitudes] @ fit.values[amplitudes]
        + fit.regressors[:, rest] @ fit.values[rest]
    )
    return projected(fit.regressors[:, rest], fit.precision[rest], data, ridge_for(fit), fit.view.count), own


def without(state: State, *indices: int) -> State:
    """Return the state with some effects taken out, and everything else, which takes over, refitted."""
    projection, own = leave_out(state, *indices)
    rest = np.setdiff1d(np.arange(len(state.fit.values)), own)
    change = np.zeros(len(state.fit.values))
    change[rest] = projection.absorbed(projection.data) - state.fit.values[rest]
    left = [i for i in range(len(state.effects)) if i not in indices]
    steps, first = tuple(state.steps[i] for i in left), len(state.declared.arm.effects)

    def refitted(values: Array) -> State:
        found = (state.effects[i].at(values[state.fit.places(state.effects[i])]) for i in left)
        pairs = enumerate(zip(left, found, strict=True))
        effects = tuple(replace(state.effects[i], effect=one, ordinal=first + place) for place, (i, one) in pairs)
        starts = with_starts(state, values, [block.start for block in effects])
        return refit(replace(state, steps=steps), effects, state.random, starts)

    try:
        return refitted(moved(state.fit.blocks, state.fit.values, change))
    except ArmflexError:  # the arm buckles where straight lines lead
        return refitted(state.fit.values)


def with_starts(state: State, values: Array, starts: Sequence[Array]) -> Array:
    """Return the values of declared blocks and of the random twist, and between them where the effects start."""
    declared = sum(len(block.labels) for block in state.blocks)
    random = values[state.fit.places(state.random)] if state.random else np.zeros(0)
    return np.concatenate([values[:declared], *starts, random])


def with_random(state: State, random: PoseBlock | None) -> State:
    """Return the state with a random twist per pose (or without one) and everything refitted."""
    count = 0 if state.random is None else len(state.random.labels)
    start = state.fit.values[: len(state.fit.values) - count]
    added = np.zeros(0 if random is None else len(random.labels))
    return refit(state, state.effects, random, np.concatenate([start, added]))


def refit(
    state: State,
    effects: tuple[EffectBlock, ...],
    random: PoseBlock | None,
    start: Array,
    effort: Effort = ROUGH,
) -> State:
    """Return the state with these effects, everything fitted together and the campaign looked at again."""
    known = state.declared.arm.effects
    numbers = numbers_of((*known, *(block.effect for block in effects)))[len(known) :]
    effects = tuple(replace(block, number=number) for block, number in zip(effects, numbers, strict=True))
    blocks = (*state.blocks, *effects, *(() if random is None else (random,)))
    tell = partial(tell_steps, state.tell)
    fitted = fit(state.declared, blocks, state.measurements, state.rows, start, tell, effort)
    context = context_at(fitted, state.measurements)
    return replace(state, effects=effects, random=random, fit=fitted, context=context)


def information(state: State, limit: Array | float, below: bool = False) -> float:
    """Return n log J + k log n of a state, and what the sizes of its effects count against it: the smaller the better.

    J is what the fit reached, not what its linear problem promises; not less than n, or where also what is `below`
    counts, J itself from there: noise is no smaller than stated. States are compared at one `limit` of lengths beyond
    which rows count less (`robust_limit`).
    """
    count = state.fit.view.count
    searched = sum(candidate_of(effect).parameters for effect in state.fitted)
    sizes = sum(unusual(candidate_of(one), one.acting, state.fit.view, state.context) for one in state.fitted)
    cost = state.fit.cost(limit)
    misfit = count * float(np.log(max(cost, count))) + (min(cost - count, 0.0) if below else 0.0)
    return misfit + searched * float(np.log(count)) + sizes


def candidate_of(effect: Effect) -> Candidate:
    """Return the candidate that an effect is."""
    return Candidate(effect.law, effect.location, effect.inner)


def present(state: State, index: int) -> bool:
    """Return whether an effect is still possible with what the fit made of it."""
    effect = state.fitted[index]
    return sensible(candidate_of(effect), effect.acting, state.fit, state.context, present=True)


def stands(state: State) -> bool:
    """Return whether every effect is still possible with what the fit made of it."""
    return all(present(state, index) for index in range(len(state.fitted)))
