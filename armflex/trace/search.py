"""The search for what an arm lacks: the most probable model of the linear problem, the arm refitted with it, and again.

A climb finds the model that no addition, deletion, exchange or pair improves. The arm is then fitted exactly with all
of it, and the linear problem is made anew there, with the effects taken out. A state is worth the log posterior of its
own hypotheses in its own linear problem, and only a state that is worth more replaces one: so the search ends.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from armflex.errors import ArmflexError
from armflex.estimate.pose_block import PoseBlock
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.gear_harmonic import GEAR_HARMONIC
from armflex.laws.effects.location import Location
from armflex.laws.effects.unnamed import BUMP, LEVEL, PRODUCT, WAVE, WAVE_PRODUCT
from armflex.parameters import DOUBT
from armflex.rows.rows import POSE
from armflex.trace.bank import Bank
from armflex.trace.hypotheses import EFFECTS, NAMELESS, Hypothesis, families, hypotheses, sought
from armflex.trace.refine import Refiner
from armflex.trace.screen import Screen
from armflex.trace.selection import (
    BETTER,
    MOST_COMPETING,
    MOST_EFFECTS,
    MOST_ROUNDS,
    MOST_TRIED,
    SCALES,
    Chosen,
    Model,
    climbed,
    rivals,
)
from armflex.trace.state import Added, State, sorted_out, with_hypotheses, with_random
from armflex.trace.unrecorded import RandomTwist, as_likely, localise

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
    """

    state: State
    screen: Screen
    model: Model
    rejected: list[Counter] = field(default_factory=list)

    @property
    def value(self) -> float:
        """Its log posterior."""
        return self.screen.log_posterior(self.model)

    def _twists(self, groups: np.ndarray) -> tuple[RandomTwist, ...]:
        """Return where a random twist in every group of rows would explain what its model leaves, the likeliest first.

        By what was stated, as the fit has it.
        """
        screen, beside, left = self.screen, self.screen.beside(self.model), self.screen.projection
        if self.model:
            columns = np.hstack([left.regressors, screen.columns(beside.places) * beside.scale])
            left = left.with_fitted(columns, np.concatenate([left.precision, beside.held]))
        left = replace(left, residual=left.residual * screen.quiet)
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
        return next((one for one in self.places[:1] if _odds(one, self.places) > -np.log(DOUBT)), None)

    @property
    def scattered(self) -> tuple[RandomTwist, ...]:
        """Where a random twist would explain most, be it from pose to pose or from row to row, the likeliest first."""
        return max(self.places, self.changing, key=lambda places: places[0].ratio)


def standing(state: State, last: Standing | None = None) -> Standing:
    """Return a state with its linear problem; `last` is that before, whose columns are dropped first."""
    if last is not None:
        last.screen.forget()
    state.reporter.stage(f"screening what {len(state.rows)} rows still show")
    known = hypotheses(state.context)  # grids of loads follow the fit
    columns = Bank(tuple(one.one for one in known), state.fit, state.context, state.reporter)
    screen = Screen(known, columns, state.bare, state.quiet)
    screen.extend(families(state.fit.view, state.context))
    return Standing(state, screen, own_model(screen, state.hypotheses))


def alone(state: State) -> tuple[Screen, Model]:
    """Return the linear problem of a state's own hypotheses alone, and its model: what a trial is worth."""
    screen = Screen((), Bank((), state.fit, state.context), state.bare, state.quiet)
    return screen, own_model(screen, state.hypotheses)


def own_model(screen: Screen, known: Sequence[Hypothesis]) -> Model:
    """Return hypotheses as a model of a screen, each at the scale that is most probable beside the others."""
    first = len(screen.groups)
    screen.extend(known)
    numbers = list(range(first, len(screen.groups)))
    model = tuple(Chosen(number, 2) for number in numbers)
    for i, number in enumerate(numbers):
        rest = (*model[:i], *model[i + 1 :])
        scale = int(screen.beside(rest).odds_at(number).argmax())
        model = (*model[:i], Chosen(number, scale), *model[i + 1 :])
    return model


def spots(screen: Screen, model: Model) -> Counter:
    """Return laws and places of a model, and how often each is in it: gears have several harmonics."""
    return Counter(screen.groups[one.number].hypothesis.spot for one in model)


def _odds(place: RandomTwist, places: Sequence[RandomTwist]) -> float:
    """Return the log odds of a random twist over none."""
    prior = float(np.log(EFFECTS * NAMELESS / max(len(places), 1)))
    return place.ratio + prior if place.plausible else -np.inf


def search(begun: Standing, passing: Callable[[Standing], None] = lambda here: None) -> Standing:
    """Return the state that is most probable, with its linear problem.

    Args:
        begun: Where to begin.
        passing: Called after every state that is accepted.
    """
    here = _settled(_begun(begun, passing), passing)
    for _ in range(MOST_ROUNDS):
        after = _rethought(here, passing)
        if after is None:
            break
        here = after
    return here


def _begun(here: Standing, passing: Callable[[Standing], None]) -> Standing:
    """Return the state with what comes first where a few effects explain less than a random twist would.

    That is a product of columns, or else a random twist from pose to pose, set aside.
    """
    place = here.scattered[0]
    if _odds(place, here.scattered) <= 0.0 or here.state.random is not None:
        return here
    few = climbed(here.screen, here.model, Refiner(here.screen), most=int(EFFECTS))  # more may imitate a random twist
    if here.screen.log_posterior(few) > here.value + _odds(place, here.scattered):
        return here
    after = _with_products(here, passing) if place in here.changing else None
    if after is not None or here.unrecorded is None:
        return after or here
    with contextlib.suppress(ArmflexError):
        return standing(_with_twist(here.state, here.places[0], here.places), here)
    return here


def _settled(here: Standing, passing: Callable[[Standing], None]) -> Standing:
    """Return the state that no further model of its own linear problem improves; a full one stays as it is."""
    for _ in range(MOST_ROUNDS):
        if is_full(here):
            return here
        model = modelled(here)
        after = _fitted(here, model)
        if after is None and spots(here.screen, model) != spots(here.screen, here.model):
            after = _fitted(here, modelled(here, 1))
        if after is None:
            return here
        here = after
        passing(here)
    return here


def exchanged(here: Standing, models: Sequence[Model]) -> Standing | None:
    """Return the state refitted with the likeliest of some models that is more probable, None where none comes out so.

    The linear problem is about an arm that has other effects: what is new and does not come out as it promised is from
    then on worth there what came out. What was fitted in one state is not fitted again in those that follow it.
    """
    for model in sorted(models, key=here.screen.log_posterior, reverse=True):
        if len(here.rejected) >= MOST_ROUNDS or here.screen.log_posterior(model) <= here.value + BETTER:
            continue
        if (after := _fitted(here, model)) is not None:
            return replace(after, rejected=here.rejected)
    return None


def is_full(here: Standing) -> bool:
    """Return whether more is missing than can be named: which of it is then makes little difference."""
    return len(here.model) >= MOST_EFFECTS


def modelled(here: Standing, more: int = 0) -> Model:
    """Return the most probable model that a climb finds in a state's linear problem, a few hypotheses more at most."""
    more = more or max(MOST_TRIED, len(here.model))  # once there are many, as many as there are
    return climbed(here.screen, here.model, Refiner(here.screen), most=min(len(here.model) + more, MOST_EFFECTS))


def _with_shapes(here: Standing, passing: Callable[[Standing], None]) -> Standing | None:
    """Return the state with waves and bumps where free shapes explain most; None where none is more probable.

    One shape may stand for several effects that imitate it: they leave one by one once it is there.
    """
    screen, refiner = here.screen, Refiner(here.screen)
    shaped = _shaped(screen, here.model)
    if not shaped:
        return None
    here.state.reporter.stage("searching waves and bumps")
    gears = {(one.site, one.axis, one.covariates) for one in GEAR_HARMONIC.places(here.state.context.records)}
    for law in (WAVE, BUMP):
        # A wave over its own drive is what the catalogue has of its gear: no reading could distinguish them.
        places = [one for one in shaped if law is BUMP or (one.site, one.axis, one.covariates) not in gears]
        screen.extend(screen.likeliest(sought(law, places, here.state.context), ((), here.model), MOST_COMPETING))
    model = climbed(screen, here.model, refiner)
    if spots(screen, model) == spots(screen, here.model):
        for rival in rivals(screen.beside(()), refiner, _is_free)[:1]:
            model = max(model, climbed(screen, (*model, rival.chosen), refiner), key=screen.log_posterior)
    return _accepted(here, model, passing)


def _accepted(here: Standing, model: Model, passing: Callable[[Standing], None]) -> Standing | None:
    """Return where a model leads to, None where it is no more probable than the state."""
    after = None if spots(here.screen, model) == spots(here.screen, here.model) else _fitted(here, model)
    if after is None:
        return None
    passing(after)
    return _settled(after, passing)


def _is_free(hypothesis: Hypothesis) -> bool:
    return not hypothesis.one.law.physical


def _shaped(screen: Screen, model: Model) -> list[Location]:
    """Return places at which free shapes explain most of what a model leaves."""
    found: dict[Location, None] = {}
    whole, left = (screen.beside(one).odds.max(axis=1) for one in ((), model))
    for odds, least in ((left, 0.0), (whole, max(screen.beside(()).rough(whole.max()), 0.0))):
        free = [
            i
            for i, group in enumerate(screen.groups)
            if odds[i] > least and _is_free(group.hypothesis) and group.hypothesis.one.law is not LEVEL
        ]
        for i in sorted(free, key=lambda i: -odds[i])[:MOST_SHAPED]:
            location = screen.groups[i].hypothesis.one.location
            if len(location.covariates) == 1:
                found.setdefault(Location(location.site, location.axis, location.covariates))
    return list(found)


def _fitted(here: Standing, model: Model) -> Standing | None:
    """Return the state refitted with a model, None where that is worth no more.

    Where the fit does not come out as the linear problem promised, what is new leaves it one by one: what the problem
    at that fit can spare best. What did not come out so is not fitted from this state again.
    """
    known, count = spots(here.screen, here.model), len(here.state.rows)
    while (asked := spots(here.screen, model)) != known and asked not in here.rejected:
        here.rejected.append(asked)
        state = refitted(here, model)
        if state is None:
            return None
        screen, own = alone(state)
        if screen.log_posterior(own) > here.value + BETTER or len(state.rows) != count:
            return standing(state, here)
        places = [here.screen.groups[one.number].hypothesis.spot for one in model]
        new = [i for i, spot in enumerate(places) if asked[spot] > known[spot]]
        if len(new) == 1 and places[new[0]] not in known:
            here.screen.fall_short(places[new[0]], here.screen.log_posterior(model) - screen.log_posterior(own))
        left = {i: screen.log_posterior((*own[:i], *own[i + 1 :])) for i in new}
        spared = max(left, key=left.__getitem__, default=None)
        if spared is None or left[spared] <= here.value:
            return None
        model = (*model[:spared], *model[spared + 1 :])
    return None


def refitted(here: Standing, model: Model) -> State | None:
    """Return the state fitted with a model, None where the arm with it does not come to rest."""
    screen, state = here.screen, here.state
    beside, added = screen.beside(model), list[Added]()
    for one, amplitudes in zip(model, beside.amplitudes, strict=True):
        group = screen.groups[one.number]
        std = np.where(group.scale > 0.0, SCALES[one.scale] * group.scale / (beside.noise * screen.quiet), 1e-12)
        added.append(Added(group.hypothesis, amplitudes, std))
    names = ", ".join(one.hypothesis.one.name + " everywhere" * one.hypothesis.family for one in added)
    state.reporter.stage(f"refitting with {names or 'nothing'}")
    try:
        return sorted_out(with_hypotheses(replace(state, heed=True), added, screen.explained(beside)))
    except ArmflexError:  # an arm that buckles or a fit that does not settle is no answer
        return None


def _rethought(here: Standing, passing: Callable[[Standing], None]) -> Standing | None:
    """Return the state after what comes last: products, a random twist, rows far off; None where nothing changes."""
    state = here.state
    after = None if is_full(here) else _with_shapes(here, passing)
    if after is not None:
        return after
    if state.random is not None:
        return _withdrawn(here, passing)
    if _odds(here.scattered[0], here.scattered) > 0.0:
        after = None if is_full(here) else _with_products(here, passing)
        if after is not None:
            return after
    if here.unrecorded is not None:
        return _set_aside(here, passing)
    if state.heed:
        left = sorted_out(replace(state, heed=False))
        if not np.array_equal(left.rows, state.rows):
            return _settled(standing(left, here), passing)
    return None


def _with_products(here: Standing, passing: Callable[[Standing], None]) -> Standing | None:
    """Return the state with a product of two columns where a random twist would explain most; None where none does."""
    screen, context = here.screen, here.state.context
    here.state.reporter.stage("searching products of columns")
    for law in (PRODUCT, WAVE_PRODUCT):
        every = [((one.site, one.axis), one) for one in law.places(context.records)]
        free = {place for place, _ in every}
        likely = [place for one in here.scattered if (place := (one.site, one.axis)) in free][:MOST_TRIED]
        locations = [one for place in likely for own, one in every if own == place]
        screen.extend(screen.likeliest(sought(law, locations, context), ((), here.model), MOST_COMPETING))
    return _accepted(here, climbed(screen, here.model, Refiner(screen)), passing)


def _set_aside(here: Standing, passing: Callable[[Standing], None]) -> Standing | None:
    """Return the state with a random twist beside its effects; None where the arm with it does not come to rest."""
    place = here.unrecorded
    assert place is not None
    try:
        after = standing(_with_twist(here.state, place, here.places), here)
    except ArmflexError:
        return None
    passing(after)
    return _settled(after, passing)


def _withdrawn(here: Standing, passing: Callable[[Standing], None]) -> Standing | None:
    """Return the state without its random twist where none is probable any more, None where it stays."""
    try:
        bare = standing(with_random(here.state, None), here)
    except ArmflexError:
        return None
    if bare.unrecorded is not None:
        return None
    here.state.reporter.stage("withdrawing the random twist that was set aside")
    passing(bare)
    return _settled(bare, passing)


def _with_twist(state: State, place: RandomTwist, places: tuple[RandomTwist, ...]) -> State:
    state.reporter.stage(f"setting aside a random twist at {place.site} {place.axis}")
    groups = state.context.column(POSE).astype(int)
    return with_random(state, PoseBlock(place.site, place.axis, place.std, groups, as_likely(places)))


def resumed(begun: Standing, accepted: Sequence[Effect]) -> Standing:
    """Return the state with effects that an earlier search of this campaign had accepted, if it can have them."""
    screen, left, known = begun.screen, list(accepted), list[Hypothesis]()
    every = [group.hypothesis for group in screen.groups]
    for family in (one for one in every if one.family):
        own = [one for one in left if any(_is(one, member) for member in family.members)]
        if len(own) == len(family.members) and all(one.inner == own[0].inner for one in own):
            known.append(family)
            left = [one for one in left if one not in own]
    for one in left:
        candidate = Candidate(one.law, one.location, one.inner)
        like = [each for each in every if not each.family and _is(one, each.one)]
        like += sought(one.law, [one.location], begun.state.context) if one.law.sought else []
        known += [replace(each, members=(candidate,)) for each in like[:1]]
    after = refitted(begun, own_model(screen, known))
    return begun if after is None else standing(after, begun)


def _is(effect: Effect, candidate: Candidate) -> bool:
    """Return whether an effect is a candidate's law at its place, with the same terms."""
    there = (effect.location.site, effect.location.axis, effect.location.partner, effect.location.terms)
    own = candidate.location
    return effect.law is candidate.law and there == (own.site, own.axis, own.partner, own.terms)
