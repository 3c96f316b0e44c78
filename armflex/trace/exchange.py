"""Second thoughts: is every effect still worth its number beside the others, and what else would do as well?"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from itertools import combinations, islice

import numpy as np

from armflex.errors import ArmflexError
from armflex.estimate.robust import robust_limit
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.effect import Effect, Values
from armflex.laws.effects.unnamed import shaped_places
from armflex.linear_gaussian import LinearGaussian
from armflex.trace.candidates import Candidate, bank, best_per_spot, candidate_regressors, candidates_of, sift
from armflex.trace.grow import accepted, loosened, settled
from armflex.trace.polish import Polished, polish, unusual
from armflex.trace.projection import evidence, ridge_for
from armflex.trace.search import CLOSE, PREFERRED, SHARE, SHORT, TIE, one_by_one, plainness
from armflex.trace.state import (
    State,
    add,
    candidate_of,
    information,
    leave_out,
    places_of_effects,
    stands,
    without,
)

Spots = frozenset[tuple[str, str]]
"""Laws and sites of some effects."""

SAME = 14.0
"""Evidence within which two candidates are not told apart."""

PART = 0.5
"""Share of the evidence of a pair that another effect must have for it to be tried in their place, with one more."""

PAIRS = 3
"""Pairs that are taken out together."""

SEVERAL = 2
"""Effects that may come beside the one that takes an effect's place."""

TRIALS, LEAST_TRIALS = 8000, 4
"""Rows times how often effects are taken out at most, and how often at least: each time is a search of its own."""

COMPARED = 12
"""Best hypotheses whose inner parameters are refined."""


def worth_of(state: State, *indices: int) -> float:
    """Return the evidence of some effects beside the others, by the normal equations.

    They are charged for all that the search chose, like the other hypotheses: also a moment or a number of waves, which
    no fit moves.
    """
    fit, (told, score, left) = state.fit, state.normal
    values, precision = fit.values[: len(score)], fit.precision[: len(score)]
    own, amplitudes = places_of_effects(state, indices)
    rest = np.setdiff1d(np.arange(len(score)), own)
    # The readings as they would be without the effects, in what the fit leaves of them.
    back = values[amplitudes]
    left += float(back @ (2.0 * score[amplitudes] + told[np.ix_(amplitudes, amplitudes)] @ back))
    score = score + told[:, amplitudes] @ back
    pull = score[rest] - precision[rest] * values[rest]
    root = LinearGaussian(told[np.ix_(rest, rest)] + np.diag(precision[rest])).root
    pull, seen = root.T @ pull, root.T @ told[np.ix_(rest, own)]
    objective = left + float(precision[rest] @ values[rest] ** 2 - pull @ pull)
    score, ridge = score[own] - seen.T @ pull, ridge_for(fit) * np.diag(fit.told)[own]
    gain = score @ LinearGaussian(told[np.ix_(own, own)] - seen.T @ seen).with_precision(ridge).solve(score)
    themselves = [candidate_of(state.fitted[index]) for index in indices]
    sizes = sum(
        unusual(one, state.fitted[index].acting, fit.view, state.context)
        for one, index in zip(themselves, indices, strict=True)
    )
    return float(evidence(gain, objective, fit.view.count, sum(one.parameters for one in themselves))) - sizes


def hypotheses_of(state: State, *indices: int, anew: bool = False) -> tuple[float, tuple[Polished, ...]]:
    """Return the evidence of some effects beside the others, and the best candidates that could take their place.

    Those are of the catalogue, and for a shape without a name the same shape at every other place. They themselves are
    among them only where what is inside them is found `anew`: one of a pair, or one by itself with another choice or a
    better value than it has.
    """
    themselves = [candidate_of(state.fitted[index]) for index in indices]
    worth, projection = worth_of(state, *indices), leave_out(state, *indices)[0]
    shapes = [one for one in themselves if one.law.shape]

    def tried() -> Iterator[Candidate]:
        yield from candidates_of(CATALOGUE.values(), state.context)
        for one in shapes:
            for site, axis in shaped_places(state.context.records):
                yield replace(one, location=replace(one.location, site=site, axis=axis))

    def spot(one: Candidate) -> tuple[str, str, str | None, str]:
        return one.law.name, one.location.site, one.location.axis, one.location.partner

    # What the search has looked at is looked at again, all but shapes without a name.
    sifted = sift(bank(tried(), state.fit, state.context, state.tell) if shapes else state.physical, projection)
    found = (sifted.bank.candidates[i] for i in best_per_spot(sifted, len(sifted.bank.candidates)))
    taken, hypotheses = {spot(one) for one in themselves}, []
    for number, candidate in enumerate(islice((one for one in found if shapes or not one.law.shape), COMPARED + 1)):
        state.tell(f"refining {candidate.name}", number, COMPARED + 1)
        if spot(candidate) not in taken:
            hypotheses.append(polish(candidate, state.fit, state.context, projection))
    for own in themselves if anew else ():
        inside: dict[Values, int] = {}
        for i in np.argsort(-sifted.evidence, kind="stable").tolist():
            candidate = sifted.bank.candidates[i]
            if own.law.inner and (candidate.law, candidate.location) == (own.law, own.location):
                inside.setdefault(_chosen(candidate), i)
        for i in inside.values():
            one = polish(sifted.bank.candidates[i], state.fit, state.context, projection)
            if len(indices) > 1 or _chosen(one.candidate) != _chosen(own) or one.evidence > worth + TIE:
                hypotheses.append(one)
    return worth, tuple(sorted(hypotheses, key=lambda one: -one.evidence))


def _chosen(candidate: Candidate) -> Values:
    """Return the inner values that are chosen among few rather than refined or fitted."""
    pairs = zip(candidate.law.inner, candidate.inner, strict=True)
    return tuple(value for inner, value in pairs if not inner.polished and not inner.spread)


def equivalents(state: State, index: int) -> tuple[float, tuple[tuple[Effect, float], ...]]:
    """Return an effect's evidence beside the others, and every other candidate within `SAME` of it, once per place."""
    worth, hypotheses = hypotheses_of(state, index)
    found: dict[str, tuple[Effect, float]] = {}
    for one in hypotheses:
        if one.gain > 0.0 and one.evidence > worth - SAME:
            found.setdefault(one.effect.title, (one.effect, worth - one.evidence))
    return worth, tuple(found.values())


def exchanged(state: State) -> tuple[State, ...]:
    """Return the states from one to another whose effects are better together, none where there is no such.

    Where several were added one by one, the first were chosen while the others were missing. So each of them, and pairs
    that stand in for each other, are taken out, and what explains most without them is tried in their place.
    """
    passed, tried = pruned(state), set[tuple[Spots, Spots]]()
    trials = max(LEAST_TRIALS, TRIALS // len(state.rows))
    again = True
    while again:
        here, again = passed[-1] if passed else state, False
        for some in _suspects(here):
            key = _spots(here, some), _spots(here, range(len(here.effects)))
            if key in tried or len(tried) >= trials:
                continue
            tried.add(key)
            better = _instead(here, some)
            if better and stands(better[-1]):  # what would be dropped at once would be found again, and so on
                passed, again = (*passed, *better, *pruned(better[-1])), True
                break
    after = settled(passed[-1]) if passed else None
    return passed if after is None else (*passed, after)


Trial = Callable[[Polished, float], tuple[State, ...]]
"""From a candidate to the states without some effects and with it in their place, as `in_place` gives them."""


def in_place(state: State, indices: tuple[int, ...]) -> Trial:
    """Return what tries candidates in the place of some effects, each of them refitted once.

    It gives the states without the effects and with the candidate; none where it cannot stand there, or where the
    information criterion falls by less than a margin.
    """
    names = " and ".join(state.effects[index].effect.name for index in indices)
    known: dict[int, tuple[Polished, tuple[State, ...]]] = {}

    @cache
    def rest() -> State:
        return without(state, *indices)

    def tried(one: Polished) -> tuple[State, ...]:
        state.say(f"trying {one.effect.name} for {names}")
        try:
            trial = add(rest(), one, indices[0])
            trial = loosened(trial) or trial
        except ArmflexError:  # an arm that buckles
            return ()
        step = state.steps[indices[0]]
        if not stands(trial) or len(trial.effects) != len(rest().effects) + 1 or step is None:
            return ()
        before, after = trial.steps[: indices[0]], trial.steps[indices[0] + 1 :]
        return rest(), replace(trial, steps=(*before, replace(step, exchanged=True), *after))

    def trial(one: Polished, margin: float) -> tuple[State, ...]:
        if id(one) not in known:
            known[id(one)] = one, tried(one)
        _, passed = known[id(one)]
        worse = passed and _information(passed[-1], state) > _information(state, state) - margin
        return () if worse else passed

    return trial


def pruned(state: State) -> tuple[State, ...]:
    """Return the states without one effect and another that is no longer worth `SAME`, none where all are.

    One without which another would have to be what no machine has stays.
    """
    passed = list[State]()
    again = True
    while again:
        state, again = passed[-1] if passed else state, False
        worths = {unit[0]: worth_of(state, unit[0]) for unit in state.units if len(unit) == 1}
        for i in sorted((i for i in worths if worths[i] < SAME), key=lambda i: worths[i]):
            trial = without(state, i)
            # The linear estimate misses how much the rest must bend.
            if _information(trial, state) <= _information(state, state) + SAME and stands(trial):
                state.say(f"dropping {state.effects[i].effect.name}")
                passed.append(trial)
                again = True
                break
    return tuple(passed)


def _spots(state: State, indices: Iterable[int]) -> Spots:
    return frozenset(candidate_of(state.fitted[i]).spot for i in indices)


def _suspects(state: State) -> tuple[tuple[int, ...], ...]:
    """Return each effect, those first that the others could do without most easily, then pairs that share most."""
    alone = [unit[0] for unit in state.units if len(unit) == 1]
    if len(alone) < 2:
        return ()
    worths = {i: worth_of(state, i) for i in alone}
    # What a pair is worth beyond what its members are: either takes over when the other goes.
    shared = {pair: worth_of(state, *pair) - worths[pair[0]] - worths[pair[1]] for pair in combinations(alone, 2)}
    pairs = sorted((pair for pair in shared if shared[pair] > SAME), key=lambda pair: -shared[pair])
    return (*((i,) for i in sorted(alone, key=lambda i: worths[i])), *pairs[:PAIRS])


def _instead(state: State, indices: tuple[int, ...]) -> tuple[State, ...]:
    """Return the states from one without some effects to one with better ones in their place, none where none is.

    What is plainer may be a little worse, what bends more must be clearly better; for a pair one effect may come, or
    another pair, for one effect several.
    """
    (worth, hypotheses), trial = hypotheses_of(state, *indices, anew=True), in_place(state, indices)
    best: tuple[State, ...] = ()
    if len(indices) == 1:
        law, own = state.fitted[indices[0]].law, plainness(candidate_of(state.fitted[indices[0]]))
        tried = [one for one in hypotheses if one.evidence > worth - max(CLOSE, SHARE * worth)][:SHORT]
        if any(inner.spread for inner in law.inner):  # what it has in details is not yet in its like elsewhere
            like = [one for one in hypotheses if one.candidate.law is law and one.evidence > PART * worth][:1]
            tried += [one for one in like if all(one is not other for other in tried)]
        for one in tried:
            kind = plainness(one.candidate)
            passed = trial(one, -TIE if kind < own else TIE if kind == own else PREFERRED)
            if passed and (not best or _information(passed[-1], state) < _information(best[-1], state)):
                best = passed
    fair = [one for one in hypotheses if one.evidence > PART * worth]
    return best or (_several_instead(state, indices, worth, fair[0], trial) if fair else ())


def _several_instead(
    state: State, indices: tuple[int, ...], worth: float, first: Polished, trial: Trial
) -> tuple[State, ...]:
    """Return the states to one with a candidate, and what shows beside it, in place of effects.

    What stands for several causes explains some of each, and hides them from one another: none of them takes its place
    by itself. None where they explain no more together, as the linear problem says or the fits.
    """
    most = SEVERAL if len(indices) == 1 else 1
    problem = leave_out(state, *indices)[0]
    beside = problem.beside(candidate_regressors(first.candidate, state.fit, state.context))
    named = first.evidence + sum(one.evidence for one in one_by_one(state.physical, beside, most))
    if len(indices) == 1 and named < worth + PREFERRED:
        return ()
    passed, now = trial(first, -np.inf), _information(state, state)
    for _ in range(most):
        if not passed or _information(passed[-1], state) < now:
            break
        more = accepted(passed[-1], passed[-1].looked)
        if more is None:
            return ()
        passed = (*passed, more)
    # What was not the best by itself must be clearly better with others.
    least = PREFERRED if len(passed) > 2 or len(indices) == 1 else 0.0
    return passed if passed and _information(passed[-1], state) < now - least else ()


def _information(trial: State, state: State) -> float:
    return information(trial, robust_limit(state.fit.view), below=True)
