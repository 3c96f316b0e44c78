"""One more effect: the best candidate that chance cannot have made, and that rows which were not used speak for.

Where none is: what is set aside as an unrecorded cause, at last.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armflex.errors import ArmflexError
from armflex.estimate.block import amplitude_prior
from armflex.estimate.robust import robust_limit
from armflex.rows.rows import POSE
from armflex.trace.accept import APART, ENOUGH, MARGIN, Step, null_maximum, prove
from armflex.trace.polish import Polished
from armflex.trace.search import PREFERRED, SHORT, TIE, Round, plainest
from armflex.trace.state import State, add, information, present, refit, sorted_out, with_random, with_starts, without
from armflex.trace.unrecorded import NOTICED, PoseBlock, RandomTwist, as_likely

SOUGHT = 6.0
"""Evidence more for waves, bumps and products: the residual itself chose the places at which they compete."""

SHARE = 0.4
"""Share of the excess that the best candidate must explain; below it an unrecorded cause is thought of first."""

FAR_APART = 4.0
"""Standard errors by which held-out errors must fall where a random twist would explain more."""


def grown(state: State) -> State | None:
    """Return the state with one more effect, None where none is beyond chance."""
    place = unrecorded(state, state.looked)
    return settled(accepted(state, state.looked, APART if place is None else FAR_APART))


def paired(state: State) -> tuple[State, ...]:
    """Return the states with one and two effects more that are proven together, where a random twist explains more.

    Where several causes are missing each of them may explain too little by itself.
    """
    looked = state.looked
    if unrecorded(state, looked) is None:
        return ()
    for candidate, one in _refitted(state, looked, 0.0):
        best = one.looked.best
        null = _beyond_chance(one, one.looked, best)
        if null is not None and candidate.gain + best.gain > SHARE * looked.excess:
            found = settled(_proven(state, looked, _added(one, [best]), null, FAR_APART))
            if found is not None:
                return one, found
    return ()


def set_aside(state: State) -> State | None:
    """Return the state with an unrecorded cause set aside, None where none is as likely."""
    place = unrecorded(state, state.looked)
    if place is None:
        return None
    state.say(f"setting aside a random twist at {place.site} {place.axis}")
    return _with_twist(state, place)


def without_far_rows(state: State) -> State | None:
    """Return the state without rows that stayed because an effect might explain them, though none does."""
    left = sorted_out(replace(state, heed=False)) if state.heed else state
    return None if state.uses(left.rows) else left


def possible(state: State) -> State | None:
    """Return the state without effects that what was found since has made impossible, None where there are none.

    What came first while others were missing made up for them; beside them it would have to be what no machine has.
    """
    alone = [unit[0] for unit in state.units if len(unit) == 1]
    gone = [i for i in alone if not present(state, i)]
    for i in gone:
        state.say(f"dropping {state.effects[i].effect.name}, which is impossible beside the others")
    return without(state, *gone) if gone else None


def loosened(state: State) -> State | None:
    """Return the state where one effect's details move that no search looks for; None where none has to.

    What a law's plainest form leaves of its cause would be taken for another one.
    """
    limit = robust_limit(state.fit.view)
    for i, block in enumerate(state.effects):
        more = tuple(j for j, inner in enumerate(block.effect.law.inner) if inner.spread and j not in block.free)
        if not more:
            continue
        effect, free = state.fitted[i], (*block.free, *more)
        loose = replace(
            block, effect=effect, free=free, prior=amplitude_prior(effect, free, state.fit.view, state.context)
        )
        effects = (*state.effects[:i], loose, *state.effects[i + 1 :])
        starts = [loose.start if one is loose else state.values_of(one) for one in effects]
        state.say(f"fitting details of {effect.name}")
        with contextlib.suppress(ArmflexError):
            trial = refit(state, effects, state.random, with_starts(state, state.fit.values, starts))
            if present(trial, i) and information(trial, limit, True) < information(state, limit, True) - PREFERRED:
                return trial
    return None


def settled(state: State | None) -> State | None:
    """Return a state with something new after what follows from it: rows may come back, a random twist may go.

    What was set aside stays under suspicion: it is withdrawn as soon as it is no longer likelier than every cause that
    has a name; else it is as large as it is now, and where it is likeliest now.
    """
    if state is None:
        return None
    state = sorted_out(replace(state, heed=True))
    if state.random is None:
        return state
    bare = with_random(state, None)
    place = unrecorded(bare, bare.looked)
    if place is None:
        state.say("withdrawing the random twist that was set aside")
        return bare
    return _with_twist(bare, place)


def unrecorded(state: State, looked: Round) -> RandomTwist | None:
    """Return where a random twist, of a size that is possible, explains clearly more than any candidate does.

    None where nowhere.
    """
    place = next((one for one in looked.places if one.ratio < NOTICED or one.plausible), None)
    if state.random is not None or place is None or place.ratio < NOTICED:
        return None
    best = looked.ranking[0]

    def little(gain: float, parameters: int) -> bool:
        # So many parameters explain so much of one random twist per pose by chance.
        chance = min(1.0, parameters / len(set(state.groups.tolist())))
        return gain < (SHARE + (1.0 - SHARE) * chance) * looked.excess

    if not little(best.gain, best.candidate.parameters) or 2.0 * place.ratio <= 1.5 * best.evidence:
        return None
    gain, told = looked.explained
    several = not little(gain, sum(one.candidate.parameters for one in looked.together)) and told > 2.0 * place.ratio
    return None if several else place


def _with_twist(state: State, place: RandomTwist) -> State:
    groups = state.context.column(POSE).astype(int)
    return with_random(state, PoseBlock(place.site, place.axis, place.std, groups, as_likely(state.looked.places)))


def accepted(state: State, looked: Round, apart: float = APART) -> State | None:
    """Return the state with the best candidate in it, None where none is better than chance.

    Held-out errors must fall by `apart` standard errors; where that is more than usual, only the catalogue will do.
    """
    if apart > APART and not looked.best.candidate.law.physical:
        return None
    if looked.together:  # greedy order misleads: what explains most beside the others is looked at first
        found = _tried(state, looked, looked.together[0], apart)
        if found is not None:
            return found
    found = _tried(state, looked, looked.best, apart, shortlist=True)
    if found is None and looked.contender is not None and apart == APART:
        found = _tried(state, looked, looked.contender, apart)
    return found


def _tried(state: State, looked: Round, best: Polished, apart: float, shortlist: bool = False) -> State | None:
    """Return the state with a candidate in it, or with the best of the `shortlist` that it leads; else None."""
    null = _beyond_chance(state, looked, best)
    if null is None:
        return None
    refitted = _refitted(state, looked, null) if shortlist else _added(state, [best])
    return _proven(state, looked, refitted, null, apart)


def _beyond_chance(state: State, looked: Round, best: Polished) -> float | None:
    """Return the best evidence that chance gives; None where a candidate has not clearly more.

    Chance competes with starting values of inner parameters alone; what refining them adds is a part of `MARGIN`.
    """
    if best.evidence < ENOUGH:
        return None
    # Chance gives a few laws less to boast of than all of them; what the best was chosen among is what counts.
    laws = looked.plain if best.candidate.law.name in looked.plain else None
    null = -np.inf
    for number, sifted in enumerate(looked.sifted):
        state.tell("what chance gives", number, len(looked.sifted))
        null = max(null, float(null_maximum(sifted, state.groups, laws).max()))
    return null if best.evidence >= null + _margin(best) else None


def _margin(best: Polished) -> float:
    return MARGIN + SOUGHT * best.candidate.law.sought


def _refitted(state: State, looked: Round, null: float) -> list[tuple[Polished, State]]:
    """Return the shortlist with everything refitted, the best first; a contender alone where it leaves nothing.

    What the data do not tell apart goes by plainness. Where none of them is possible with what the full fit makes of
    it, those come that are next and still beyond chance.
    """
    contender = _added(state, [looked.first]) if looked.could else []
    if contender and contender[0][1].looked.ranking[0].evidence < ENOUGH:
        return contender
    limit = robust_limit(state.fit.view)
    first = looked.shortlist
    known = {id(one) for one in first}
    later = [one for one in looked.eligible if id(one) not in known and one.evidence >= null + _margin(one)]
    found = _added(state, first) or _added(state, later[:SHORT])
    added = [(information(after, limit), one, after) for one, after in found]
    if not added:
        return contender
    added.sort(key=lambda one: one[0])
    plain = plainest([one for worth, one, _ in added if worth <= added[0][0] + TIE])
    return [(one, after) for _, one, after in sorted(added, key=lambda entry: entry[1] is not plain)]


def _added(state: State, candidates: Sequence[Polished]) -> list[tuple[Polished, State]]:
    found, limit = [], robust_limit(state.fit.view)
    for candidate in candidates:
        state.say(f"refitting with {candidate.effect.name}")
        with contextlib.suppress(ArmflexError):  # an arm that buckles or a fit that does not settle is no answer
            after = add(state, candidate)
            new = range(len(state.effects), len(after.effects)) or range(len(after.effects))
            if all(present(after, i) for i in new) and after.fit.cost(limit) < state.fit.cost(limit):
                found.append((candidate, after))
    return found


def _proven(
    state: State, looked: Round, refitted: Sequence[tuple[Polished, State]], null: float, apart: float
) -> State | None:
    """Return the first state that rows it has not seen speak for."""
    for candidate, after in refitted:
        proof = prove(state, after, null, after.effects[len(state.effects) :] or after.effects)
        # The gain is chiefly that parameters no longer strain against their priors.
        by_rows = proof.errors_apart > apart and proof.sessions_agree
        witness = apart == APART and state.strain - after.strain > 0.5 * candidate.gain and proof.errors_apart > -APART
        if by_rows or witness:
            step = Step(looked.ranking, proof, not by_rows)
            # The proof of an effect that it only widens is known.
            return replace(after, steps=tuple(step if one is None else one for one in after.steps))
    return None
