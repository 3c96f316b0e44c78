"""The search for what an arm lacks: the most probable model of the linear problem, the arm refitted with it, and again.

A climb finds the model that no addition, deletion, exchange or pair improves. The arm is then fitted exactly with all
of it, and the linear problem is made anew there, with the effects taken out. A state is worth the log posterior of its
own hypotheses in its own linear problem. A state that is worth more replaces one, or one of other rows, whose worth is
no measure: no state is entered twice, and three for each of `MOST_ROUNDS` at most, so the search ends.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.errors import ArmflexError
from armflex.estimate.block import EffectBlock, amplitude_prior
from armflex.estimate.fit import ROUGH, moved
from armflex.estimate.pose_block import PoseBlock
from armflex.estimate.robust import ROWS_AT_ONCE
from armflex.laws.effects.candidate import places_of
from armflex.laws.effects.gear_harmonic import GEAR_HARMONIC
from armflex.laws.effects.location import Location
from armflex.laws.effects.unnamed import BUMP, LEVEL, PRODUCT, WAVE, WAVE_PRODUCT
from armflex.parameters import DOUBT
from armflex.rows.rows import POSE
from armflex.trace.bank import Bank
from armflex.trace.hypotheses import EFFECTS, NAMELESS, Hypothesis, hypotheses, sought
from armflex.trace.refine import anchored_anew, refine
from armflex.trace.screen import Screen
from armflex.trace.selection import (
    BETTER,
    GRID_ERROR,
    MOST_COMPETING,
    MOST_EFFECTS,
    MOST_ROUNDS,
    MOST_TRIED,
    SCALES,
    WITHIN,
    Chosen,
    Model,
    climbed,
    rivals,
    without,
)
from armflex.trace.state import State, of_poses, refit, resized, sorted_out, with_all_of, with_random
from armflex.trace.unrecorded import RandomTwist, as_likely, localise

STEP = replace(ROUGH, iterations=1)
"""Tolerance: how far a fit goes between two that choose families."""

MOST_SHAPED = 10
"""Tolerance: places of free shapes at which waves and bumps are sought."""


@dataclass(frozen=True, eq=False)
class Standing:
    """A state with its linear problem.

    Attributes:
        state: The arm so far.
        screen: All hypotheses at its fit, its own effects taken out.
        model: Its own hypotheses there.
        rejected: Laws and places of models that the arm was fitted with from here, and that came out worth no more.
        visited: What identifies the states that the search has entered, see `State.identity`.
    """

    state: State
    screen: Screen
    model: Model
    rejected: list[Counter] = field(default_factory=list)
    visited: set[tuple] = field(default_factory=set)

    @property
    def value(self) -> float:
        """Its log posterior."""
        return self.screen.log_posterior(self.model)

    def _twists(self, groups: np.ndarray) -> tuple[RandomTwist, ...]:
        """Return where a random twist in every group of rows would explain what its model leaves, the likeliest first.

        By what was stated, as the fit has it.
        """
        screen, beside, left = self.screen, self.screen.beside(self.model), self.screen.projection
        left = left.with_columns(screen.columns(beside.places), beside.held)
        left = replace(left, data=left.data * screen.quiet)
        return localise(screen.fit, screen.context, left, groups)

    @cached_property
    def places(self) -> tuple[RandomTwist, ...]:
        """Random twists from pose to pose."""
        return self._twists(self.state.groups)

    @cached_property
    def changing(self) -> tuple[RandomTwist, ...]:
        """Those from row to row: what comes from a column that changes while the arm is at a pose."""
        rows = np.arange(len(self.state.rows))
        return self.places if len(set(self.state.groups)) == len(rows) else self._twists(rows)

    @property
    def unrecorded(self) -> RandomTwist | None:
        """Where a random twist from pose to pose is credible beside none, None where nowhere."""
        return next((place for place in self.places[:1] if _odds(place, self.places) > -np.log(DOUBT)), None)

    @property
    def scattered(self) -> tuple[RandomTwist, ...]:
        """Where a random twist would explain most, be it from pose to pose or from row to row, the likeliest first."""
        return max(self.places, self.changing, key=lambda places: places[0].ratio)


def standing(state: State, last: Standing | None = None) -> Standing:
    """Return a state with its linear problem; `last` is that before, whose columns are dropped first."""
    if last is not None:
        last.screen.forget()
    state.reporter.stage(f"screening what {len(state.rows)} rows still show")
    # Grids of loads follow the fit.
    here = linear(state, hypotheses(state.context))
    visited = set() if last is None else last.visited
    visited.add(state.identity)
    return replace(here, visited=visited)


def entered(state: State, last: Standing) -> Standing | None:
    """Return a state with its linear problem, None where it was entered before, or as many were as may be."""
    return None if state.identity in last.visited or is_bounded(last) else standing(state, last)


def is_bounded(here: Standing) -> bool:
    """Return whether a search has entered as many states as it may."""
    return len(here.visited) >= 3 * MOST_ROUNDS


def led(state: State, passing: Callable[[Standing], None]) -> Standing:
    """Return a calibrated state with what a search of some of its poses found, refitted to all; of few as it begins.

    Half of `ROWS_AT_ONCE` poses lead a search almost to where all lead.
    """
    with suppress(ArmflexError):  # else it begins with nothing
        if (fewer := of_poses(state, ROWS_AT_ONCE // 2)) is not None:
            state.reporter.stage(f"beginning with {len(set(fewer.groups))} of {len(set(state.groups))} poses")
            leading = search(beginning(fewer), passing).state
            state.reporter.stage(f"refitting with what they show, to {len(state.rows)} rows")
            if leading.known or leading.background.names:
                return standing(with_families(with_all_of(state, leading)))
    return beginning(state)


def beginning(state: State) -> Standing:
    """Return a calibrated state with its linear problem as a search begins: with families, where a few names are less.

    A few are as many as are added before the arm is fitted anew. Nor does it begin with families where a random twist
    explains more than they do: they would imitate it.
    """
    here, common = standing(state), with_families(state)
    if common is state:
        return here
    few = climbed(here.screen, here.model, refine, most=MOST_TRIED)
    scattered = here.value + _odds(here.scattered[0], here.scattered)
    beside_none = max(here.screen.log_posterior(few), scattered)
    return here if beside_none > linear(common).value else standing(common, here)


def with_families(state: State) -> State:
    """Return the state with the families that it needs, itself where the arm does not come to rest with them.

    A linear problem is wrong where much is missing: families are sought again where others came in, after one step.
    """
    begun = state
    with suppress(ArmflexError):
        for _ in range(MOST_TRIED):
            names, state = state.background.names, resized(state, STEP)
            if state.background.names == names:
                break
        return state if state is begun else refit(state, state.effects, state.random, state.fit.values)
    return begun


def linear(state: State, hypotheses: Sequence[Hypothesis] = ()) -> Standing:
    """Return a state with the linear problem of these hypotheses and its own: without any, what a trial is worth."""
    candidates = tuple(hypothesis.one for hypothesis in hypotheses)
    bank = Bank(candidates, state.fit, state.context, state.reporter, state.quiet)
    screen = Screen(hypotheses, bank, state.bare.condensed, state.background.charge)
    return Standing(state, screen, own_model(screen, state.hypotheses))


def own_model(screen: Screen, hypotheses: Sequence[Hypothesis]) -> Model:
    """Return hypotheses as a model of a screen, each at the scale that is most probable beside the others.

    All of them, also where values inside a law have come to where no reading shows it: that may be nothing.
    """
    columns = [(hypothesis, screen.bank.made(hypothesis.one)) for hypothesis in hypotheses]
    model = tuple(Chosen(number, 2) for number in screen.hold(columns, True))
    for i, chosen in enumerate(model):
        odds = screen.beside(without(model, i)).odds_at(chosen.number)
        model = (*model[:i], replace(chosen, scale=int(odds.argmax())), *model[i + 1 :])
    return model


def spots(screen: Screen, model: Model) -> Counter:
    """Return laws and places of a model, and how often each is in it: gears have several harmonics."""
    return Counter(screen.groups[chosen.number].hypothesis.spot for chosen in model)


def _odds(place: RandomTwist, places: Sequence[RandomTwist]) -> float:
    """Return the log odds of a random twist over none."""
    prior = float(np.log(EFFECTS * NAMELESS / max(len(places), 1)))
    return place.ratio + prior if place.plausible else -np.inf


def search(begun: Standing, passing: Callable[[Standing], None] = lambda here: None) -> Standing:
    """Return the state that no proposal improves, with its linear problem.

    A proposal returns a state that is to replace the one it is given, None where it has none. The first that has one is
    taken, `passing` is called with it, and all are asked again.
    """
    here, proposals = begun, (_random_first, *PROPOSALS)
    while not is_bounded(here):
        after = next((proposed for propose in proposals if (proposed := propose(here)) is not None), None)
        if after is None:
            break
        passing(after)
        here, proposals = after, PROPOSALS
    return here


def _random_first(here: Standing) -> Standing | None:
    """Propose what comes first where a few effects explain less than a random twist would.

    That is a product of columns, or else a random twist from pose to pose, set aside.
    """
    place = here.scattered[0]
    if _odds(place, here.scattered) <= 0.0 or not here.state.may_scatter:
        return None
    few = climbed(here.screen, here.model, refine, most=int(EFFECTS))  # more may imitate a random twist
    if here.screen.log_posterior(few) > here.value + _odds(place, here.scattered):
        return None
    return (_with_products(here) if place in here.changing else None) or _set_aside(here)


def _more_probable(here: Standing) -> Standing | None:
    """Propose the most probable model, once several and once a single hypothesis longer; a full one stays as it is."""
    if is_full(here):
        return None
    more = max(MOST_TRIED, len(here.model))  # once there are many, as many as there are
    model = _modelled(here, more)
    if spots(here.screen, model) == spots(here.screen, here.model):
        return None
    return _fitted(here, model) or _fitted(here, _modelled(here, 1))


def _anchored_anew(here: Standing) -> Standing | None:
    """Propose a model with one effect more, or another, for which a hose or a magnet in it has its place anew."""
    if is_full(here) or len(set(here.state.groups)) >= ROWS_AT_ONCE:  # some of its poses were asked
        return None
    worth, spots_before = here.screen.log_posterior, spots(here.screen, here.model)
    near = [model for model in anchored_anew(here.screen.beside(here.model)) if worth(model) > here.value - WITHIN]
    model = max((climbed(here.screen, model, refine) for model in near), key=worth, default=here.model)
    if spots(here.screen, model) == spots_before or worth(model) <= here.value + BETTER:
        return None
    return _fitted(here, model)


def _modelled(here: Standing, more: int) -> Model:
    """Return the most probable model that a climb finds in a state's linear problem, a few hypotheses more at most."""
    return climbed(here.screen, here.model, refine, most=min(len(here.model) + more, MOST_EFFECTS))


def exchanged(here: Standing, models: Iterable[Model]) -> Standing | None:
    """Return the state refitted with the likeliest of some models that is more probable, None where none comes out so.

    Where none is in the linear problem the first of them is tried: resamples prefer it. That problem is about an arm
    that has other effects: what is new and does not come out as it promised is from then on worth there what came out.
    What was fitted in one state is not fitted again in those that follow it.
    """
    ranked = sorted(models, key=here.screen.log_posterior, reverse=True)
    likelier = [model for model in ranked if here.screen.log_posterior(model) > here.value + BETTER]
    for model in likelier or ranked[:1]:
        if len(here.rejected) < MOST_ROUNDS and (after := _fitted(here, model)) is not None:
            return replace(after, rejected=here.rejected)
    return None


def is_full(here: Standing) -> bool:
    """Return whether more is missing than can be named: which of it is then makes little difference."""
    return len(here.model) >= MOST_EFFECTS


def _with_shapes(here: Standing) -> Standing | None:
    """Propose waves and bumps where free shapes explain most.

    One shape may stand for several effects that imitate it: they leave one by one once it is there.
    """
    screen = here.screen
    shaped = [] if is_full(here) else _shaped(screen, here.model)
    if not shaped:
        return None
    here.state.reporter.stage("searching waves and bumps")
    gears = {(place.site, place.axis, place.covariates) for place in GEAR_HARMONIC.places(here.state.context.records)}
    for law in (WAVE, BUMP):
        # A wave over its own drive is what the catalogue has of its gear: no reading could distinguish them.
        places = [place for place in shaped if law is BUMP or (place.site, place.axis, place.covariates) not in gears]
        screen.extend(screen.likeliest(sought(law, places, here.state.context), ((), here.model), MOST_COMPETING))
    model = climbed(screen, here.model, refine)
    if spots(screen, model) == spots(screen, here.model):
        for rival in rivals(screen.beside(()), refine, _is_free)[:1]:
            model = max(model, climbed(screen, (*model, rival.chosen), refine), key=screen.log_posterior)
    return _fitted(here, model)


def _is_free(hypothesis: Hypothesis) -> bool:
    return not hypothesis.one.law.physical


def _shaped(screen: Screen, model: Model) -> list[Location]:
    """Return places at which free shapes explain most of what a model leaves."""
    places: dict[Location, None] = {}
    whole, left = (screen.beside(held).odds.max(axis=1) for held in ((), model))
    for odds, least in ((left, 0.0), (whole, max(screen.beside(()).rough(whole.max()), 0.0))):
        free = [
            i
            for i, group in enumerate(screen.groups)
            if odds[i] > least and _is_free(group.hypothesis) and group.hypothesis.one.law is not LEVEL
        ]
        for i in sorted(free, key=lambda i: -odds[i])[:MOST_SHAPED]:
            location = screen.groups[i].hypothesis.one.location
            if len(location.covariates) == 1:
                places.setdefault(Location(location.site, location.axis, location.covariates))
    return list(places)


def _fitted(here: Standing, model: Model) -> Standing | None:
    """Return the state refitted with a model, None where that is worth no more.

    Where the fit does not come out as the linear problem promised, what is new leaves it one by one: what the problem
    at that fit can spare best. What did not come out so is not fitted from this state again.
    """
    spots_before, count = spots(here.screen, here.model), len(here.state.rows)
    while (asked := spots(here.screen, model)) != spots_before and asked not in here.rejected:
        here.rejected.append(asked)
        state = refitted(here, model)
        if state is None:
            return None
        trial = linear(state)
        better = trial.value > here.value + BETTER or len(state.rows) != count
        sized = with_families(state) if better and state.background.names else state
        if better and (after := entered(sized, here)):
            return after
        places = [here.screen.groups[chosen.number].hypothesis.spot for chosen in model]
        new = [i for i, spot in enumerate(places) if asked[spot] > spots_before[spot]]
        if len(new) == 1 and places[new[0]] not in spots_before:
            here.screen.fall_short(places[new[0]], here.screen.log_posterior(model) - trial.value)
        left = {i: trial.screen.log_posterior(without(trial.model, i)) for i in new}
        spared = max(left, key=left.__getitem__, default=None)
        if spared is None or left[spared] <= here.value:
            return None
        model = without(model, spared)
    return None


def _instead_of_families(here: Standing) -> Standing | None:
    """Propose names instead of a family where they are worth more; see `beginning` for all of them."""
    proposed = list[tuple[float, Standing, Model]]()
    for name in here.state.background.names:
        fewer = _without(here, name)
        worth, most = fewer.screen.log_posterior, min(len(fewer.model) + MOST_TRIED, MOST_EFFECTS)
        on_grid = worth(climbed(fewer.screen, fewer.model, most=most))
        if on_grid + WITHIN + GRID_ERROR * (on_grid - worth(fewer.model)) < here.value:
            continue  # nor would values between those of the grids make up for the family
        model = climbed(fewer.screen, fewer.model, refine, most=most)
        if (value := worth(model)) > here.value + BETTER:
            proposed.append((value, fewer, model))
    for _, fewer, model in sorted(proposed, key=lambda proposal: -proposal[0]):
        state = refitted(fewer, model)
        if state is None or linear(state).value <= here.value + BETTER:
            continue
        if after := entered(with_families(state), here):
            return after
    return None


def _with_families(here: Standing) -> Standing | None:
    """Propose the families that names leave, with their sizes beside those."""
    state = with_families(here.state)
    return entered(state, here) if linear(state).value > here.value + BETTER else None


def _without(here: Standing, family: str) -> Standing:
    """Return the linear problem of a state as it is without a family."""
    state, fewer = here.state, here.state.background.without(family)
    state.reporter.stage(f"screening what names explain without {family}")
    projection = state.bare_without(family).condensed
    screen = Screen(here.screen.known, here.screen.bank, projection, fewer.charge)
    return Standing(replace(state, background=fewer), screen, own_model(screen, state.hypotheses))


def refitted(here: Standing, model: Model) -> State | None:
    """Return the state fitted with a model and nothing else, None where the arm with it does not come to rest."""
    screen, state, beside = here.screen, here.state, here.screen.beside(model)
    groups = [screen.groups[chosen.number] for chosen in model]
    named = tuple(group.hypothesis for group in groups)
    titles = Counter(hypothesis.title for hypothesis in named).items()
    names = ", ".join(f"{title}{f' ({number} times)' if number > 1 else ''}" for title, number in titles)
    state.reporter.stage(f"refitting with {names or 'nothing'}")
    present: dict[tuple, list[Array]] = {}
    for hypothesis, effect in zip(state.known, state.fitted, strict=True):
        present.setdefault(hypothesis.spot, []).append(effect.acting)
    blocks, starts = list[EffectBlock](), list[tuple[Array, Array]]()
    for chosen, group, amplitudes in zip(model, groups, beside.amplitudes, strict=True):
        tau = group.scale * SCALES[chosen.scale] / (beside.noise * screen.quiet)
        candidate, count, now = group.hypothesis.one, len(amplitudes), present.get(group.hypothesis.spot)
        derived = tuple(name for name in candidate.location.covariates if name in state.measurements.derived)
        effect = replace(candidate.effect(amplitudes), derived=derived).seen_in(state.context, state.rows)
        prior = amplitude_prior(effect, candidate.fitted, state.fit.view, state.context)
        prior[:count] = np.minimum(prior[:count], np.where(tau > 0.0, tau, 1e-12))
        number = len(state.declared.arm.effects) + len(blocks)
        blocks.append(EffectBlock(effect, candidate.fitted, state.context, number, prior))
        start, promised = blocks[-1].start, np.zeros(len(prior))
        promised[:count] = start[:count] - (now.pop(0) if now else 0.0)
        starts.append((start, promised))
    projection, rest = screen.projection, sum(len(block.parameters) for block in state.blocks)
    absorbed = projection.whole(projection.absorbed(projection.data - screen.explained(beside)))
    beside_effects = absorbed[rest:]  # families, and a random twist
    if not named:  # of several minima that of the calibration
        absorbed = state.first.values
    after = replace(state, known=named, heed=True)
    for share in (1.0, 0.5, 0.0):  # an arm may buckle where straight lines lead
        declared = moved(state.blocks, state.fit.values[:rest], share * (absorbed[:rest] - state.fit.values[:rest]))
        effects = [start - (1.0 - share) * promised for start, promised in starts]
        with suppress(ArmflexError):  # an arm that buckles or a fit that does not settle is no answer
            begun = np.concatenate([declared, *effects, beside_effects])
            return sorted_out(refit(after, tuple(blocks), state.random, begun))
    return None


def _with_products(here: Standing) -> Standing | None:
    """Propose a product of two columns where a random twist would explain most."""
    if is_full(here) or here.state.random is not None or _odds(here.scattered[0], here.scattered) <= 0.0:
        return None
    screen, context = here.screen, here.state.context
    here.state.reporter.stage("searching products of columns")
    for law in (PRODUCT, WAVE_PRODUCT):
        every = [((location.site, location.axis), location) for location in places_of(law, context)]
        free = {place for place, _ in every}
        likely = [(twist.site, twist.axis) for twist in here.scattered]
        likely = [place for place in likely if place in free][:MOST_TRIED]
        locations = [location for place in likely for there, location in every if there == place]
        screen.extend(screen.likeliest(sought(law, locations, context), ((), here.model), MOST_COMPETING))
    return _fitted(here, climbed(screen, here.model, refine))


def _set_aside(here: Standing) -> Standing | None:
    """Propose a random twist beside the effects."""
    place, state = here.unrecorded, here.state
    if place is None or not state.may_scatter:
        return None
    state.reporter.stage(f"setting aside a random twist at {place.site} {place.axis}")
    groups = state.context.column(POSE).astype(int)
    with suppress(ArmflexError):  # an arm that does not come to rest with it
        twist = PoseBlock(place.site, place.axis, place.std, groups, as_likely(here.places))
        return entered(with_random(state, twist), here)
    return None


def _withdrawn(here: Standing) -> Standing | None:
    """Propose to do without the random twist where none is probable any more."""
    if here.state.random is None:
        return None
    with suppress(ArmflexError):
        bare = with_random(here.state, None)
        if linear(bare).unrecorded is None:
            here.state.reporter.stage("withdrawing the random twist that was set aside")
            return entered(bare, here)
    return None


def _without_far_off(here: Standing) -> Standing | None:
    """Propose to leave out rows that are far off in company, where no random twist explains them."""
    if not here.state.heed or here.state.random is not None or here.unrecorded is not None:
        return None
    left = sorted_out(replace(here.state, heed=False))
    return None if np.array_equal(left.rows, here.state.rows) else entered(left, here)


PROPOSALS = (
    *(_more_probable, _anchored_anew, _with_shapes, _instead_of_families, _with_families),
    *(_with_products, _set_aside, _withdrawn, _without_far_off),
)
"""What may replace a state, in the order in which it is asked for."""
