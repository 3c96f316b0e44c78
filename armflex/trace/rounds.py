"""`trace`: calibrate, find the residual, trace it to an effect the arm lacks, add it, and say what it was worth."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from armflex.arm import Arm
from armflex.errors import ArmflexError, FileError
from armflex.estimate.calibrate import Calibration, calibrate
from armflex.estimate.effect_block import EffectBlock
from armflex.estimate.fit import Fit
from armflex.estimate.held_out import believed, held_out, pose_folds
from armflex.estimate.learn import settled
from armflex.estimate.robust import robust_limit
from armflex.estimate.spread import certainty_of
from armflex.estimate.view import look
from armflex.laws.effects.effect import Effect
from armflex.measured.measurements import Measurements
from armflex.rows.rows import POSE
from armflex.storage.whole_file import remove
from armflex.trace.accept import improvement, null_maximum, sessions_held_out
from armflex.trace.advice import lacking
from armflex.trace.afterwards import as_likely, not_identifiable, smallest, unexplained
from armflex.trace.checkpoint import Progress, identity, read_checkpoint, restored, write_checkpoint
from armflex.trace.exchange import Exchanged, equivalents, exchanged, worth_of
from armflex.trace.findings import Found, Proof, Step, Trace, Unexplained
from armflex.trace.localise import NOTICED, RandomTwist, localise
from armflex.trace.next_measurement import next_rows
from armflex.trace.polish import Polished
from armflex.trace.pose_block import PoseBlock
from armflex.trace.projection import project
from armflex.trace.search import TIE, Round, plainest
from armflex.trace.state import (
    State,
    add,
    begin,
    fitted_to,
    information,
    lost_rows,
    sorted_out,
    stands,
    with_random,
    without,
)
from armflex.trace.telling import Doing, Report, Teller, tell_steps
from armflex.trace.withdraw import never_worse

MOST_EFFECTS = 12
"""Effects at which a search ends, though more may be missing."""

ENOUGH = 16.0
"""Evidence that an effect must be worth at least: thousands are looked at, and noise gives the best of them 3 to 10.

A large residual of a piece gives far more even with its signs turned at random, which `MARGIN` is counted from.
"""

MARGIN = 3.0
"""Evidence that it must have beyond the best that random signs gave."""

SOUGHT = 6.0
"""Evidence more for waves, bumps and products: the residual itself chose the places at which they compete."""

SHARE = 0.4
"""Share of the excess that the best candidate must explain; below it an unrecorded cause is thought of first."""

APART, FAR_APART = 2.0, 4.0
"""Standard errors by which held-out errors must fall, and by which where a random twist would explain more."""


def trace(
    arm: Arm,
    measurements: Measurements,
    rows: np.ndarray | None = None,
    report: Report | None = None,
    keep: bool = False,
    checkpoint: Path | None = None,
    resume: bool = False,
    account: Callable[[Trace], None] | None = None,
    progress: Callable[[Doing], None] | None = None,
) -> Trace:
    """Return the traced arm and its account; `armflex.trace` says what goes in."""
    teller = Teller(report, progress)
    say = teller.stage
    say("calibrating")
    about = identity(arm, measurements, rows, keep) if checkpoint else {}
    said = read_checkpoint(checkpoint, about) if checkpoint and resume else None
    steps = partial(tell_steps, teller.step)
    calibration = calibrate(arm, measurements, rows, steps, keep=keep, as_stated=True)
    begun = begin(calibration, teller.step)
    first, places = begun.fit, localise(begun.fit, begun.scene, project(begun.fit), begun.groups)
    found = Progress(begun, scenes=(begun.scene,))
    if checkpoint and said is not None:
        found = restored(checkpoint, said, begun)
        say(f"going on with {len(found.state.effects)} effects")
    elif checkpoint and not checkpoint.exists():  # that of another search stays until there is something to keep
        write_checkpoint(checkpoint, about, found)
    _tell_figures(teller, first, found)
    while not found.ended and len(found.steps) < MOST_EFFECTS:
        known = found.state.effects
        found = _next(found, say)
        if checkpoint:
            try:
                write_checkpoint(checkpoint, about, found)
            except FileError as error:  # a full disk: ended here, the search would lose what it just found
                say(f"{error}; the search goes on")
        if found.state.effects != known:
            _tell_figures(teller, first, found)
            if account is not None:
                _pass_on(account, partial(_so_far, calibration, first, found.state, places, found.steps), say)
    traced = _conclude(calibration, first, found.state, places, found.steps, say)
    if not found.ended:
        traced = replace(traced, stopped_at=len(found.steps))
    if account is not None:
        account(traced)
    if checkpoint:
        remove(checkpoint)
    return traced


def _next(found: Progress, say: Report) -> Progress:
    """Return the progress after one more round, ended where nothing is left to be done."""
    state = found.state
    taken = _round(state, _look(state, say), say)
    if taken is None:
        return replace(found, ended=True)
    state, step = taken
    # Else it widened an effect whose proof is known, or set something aside.
    added = step is not None and len(state.effects) > len(found.steps)
    return found.after(state, [*found.steps, step] if step is not None and added else found.steps)


def _pass_on(account: Callable[[Trace], None], so_far: Callable[[], Trace], say: Report) -> None:
    """Hand on the account so far; a search is not ended because there is none yet."""
    try:
        found = so_far()
    except ArmflexError as error:
        say(f"no account so far: {error}")
        return
    account(found)


def _tell_figures(teller: Teller, first: Fit, found: Progress) -> None:
    """Say what there is so far: effects, and the error with them."""
    state, proofs = found.state, [step.proof for step in found.steps]
    unseen = proofs[-1].after if proofs else held_out(first, pose_folds(state.groups)).rms
    teller.has(tuple(block.effect.title for block in state.effects), state.fit.rms, unseen)


def _round(state: State, looked: Round, say: Report) -> tuple[State, Step | None] | None:
    """Return the state with one more effect, else with an unrecorded cause set aside, else without rows far off.

    None where nothing is left to be done.
    """
    place = _unrecorded(state, looked)
    found = _accept(state, looked, say, APART if place is None else FAR_APART)
    if found is not None:
        return sorted_out(replace(found[0], heed=True)), found[1]
    if place is not None:
        return _set_aside(state, looked.places, say), None
    # What is far off together stayed because an effect might explain it: none does.
    left = sorted_out(replace(state, heed=False)) if state.heed else state
    return None if state.uses(left.rows) else (left, None)


def _look(state: State, say: Report) -> Round:
    say(f"searching what {len(state.rows)} rows still show")
    return state.looked


def _excess(looked: Round) -> float:
    return looked.projection.objective - looked.projection.count


def _unrecorded(state: State, looked: Round) -> RandomTwist | None:
    """Return where a random twist explains clearly more than any candidate does, None where nowhere."""
    place, best = looked.places[0], looked.ranking[0]
    # So many parameters explain so much of one random twist per pose by chance.
    chance = min(1.0, best.candidate.parameters / len(set(state.groups.tolist())))
    share = SHARE + (1.0 - SHARE) * chance
    is_random = best.gain < share * _excess(looked) and 2.0 * place.ratio > 1.5 * best.evidence
    return place if is_random and state.random is None and place.ratio >= NOTICED else None


def _set_aside(state: State, places: tuple[RandomTwist, ...], say: Report) -> State:
    """Return the state with a random twist per pose at the likeliest place."""
    place, groups = places[0], state.scene.column(POSE).astype(int)
    say(f"setting aside a random twist at {place.site} {place.axis}")
    return with_random(state, PoseBlock(place.site, place.axis, place.std, groups, as_likely(places)))


def _accept(state: State, looked: Round, say: Report, apart: float = APART) -> tuple[State, Step] | None:
    """Return the state with the best candidate in it, None where none is better than chance.

    Held-out errors must fall by `apart` standard errors; where that is more than usual, only the catalogue will do.
    """
    if apart > APART and not looked.best.candidate.law.physical:
        return None
    null = _beyond_chance(state, looked, looked.best)
    found = None if null is None else _proven(state, looked, _refitted(state, looked, say), null, apart)
    if found is None and looked.contender is not None and apart == APART:
        null = _beyond_chance(state, looked, looked.contender)
        found = None if null is None else _proven(state, looked, _added(state, [looked.contender], say), null, apart)
    return found


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
    margin = MARGIN + SOUGHT * best.candidate.law.sought
    return null if best.evidence >= null + margin else None


def _proven(
    state: State, looked: Round, refitted: Sequence[tuple[Polished, State]], null: float, apart: float
) -> tuple[State, Step] | None:
    """Return the first state that rows it has not seen speak for."""
    for candidate, after in refitted:
        proof = prove(state, after, null, after.effects[len(state.effects) :] or after.effects)
        if proof.errors_apart > apart and _sessions_agree(proof):
            return after, Step(looked.ranking, proof, False)
        if apart == APART and _witnessed(state, after, candidate) and proof.errors_apart > -APART:
            return after, Step(looked.ranking, proof, True)
    return None


def _refitted(state: State, looked: Round, say: Report) -> list[tuple[Polished, State]]:
    """Return the shortlist with everything refitted, the best first; a contender before it where nothing is left."""
    contender = _added(state, [looked.first], say) if looked.could else []
    if contender and _is_settled(contender[0][1]):
        return contender
    return _in_order(_added(state, looked.shortlist, say), robust_limit(state.fit.view)) or contender


def _in_order(added: Sequence[tuple[Polished, State]], limit: float) -> list[tuple[Polished, State]]:
    """Return refitted candidates, the best first; what the data do not tell apart goes by plainness."""
    worths = {id(one): information(after, limit) for one, after in added}
    ordered = sorted(added, key=lambda one: worths[id(one[0])])
    if ordered:
        least = worths[id(ordered[0][0])]
        plain = plainest([one for one, _ in ordered if worths[id(one)] <= least + TIE])
        ordered.sort(key=lambda one: one[0] is not plain)
    return ordered


def _added(state: State, candidates: Sequence[Polished], say: Report) -> list[tuple[Polished, State]]:
    found, limit = [], robust_limit(state.fit.view)
    for candidate in candidates:
        say(f"refitting with {candidate.candidate.effect(candidate.amplitudes).name}")
        with contextlib.suppress(ArmflexError):  # an arm that buckles or a fit that does not settle is no answer
            after = add(state, candidate)
            if stands(after) and after.fit.cost(limit) < state.fit.cost(limit):
                found.append((candidate, after))
    return found


def _is_settled(state: State) -> bool:
    """Return whether nothing is left that would be worth adding."""
    return state.looked.ranking[0].evidence < ENOUGH


def prove(before: State, after: State, null: float, new: Sequence[EffectBlock]) -> Proof:
    """Return the errors of held-out poses and sessions before and after, and with what became `new` between them."""
    folds, judged = pose_folds(before.groups), believed(before.fit, after.fit)
    poses = [held_out(state.fit, folds, judged=judged) for state in (before, after)]
    sessions = sessions_held_out(before.fit, after.fit, new, after.sessions)
    return Proof(poses[0].rms, poses[1].rms, *(sessions or (None, None)), improvement(*poses), null)


def _sessions_agree(proof: Proof) -> bool:
    if proof.sessions_before is None or proof.sessions_after is None:
        return True
    return proof.sessions_after < proof.sessions_before


def _witnessed(before: State, after: State, candidate: Polished) -> bool:
    """Return whether the gain is chiefly that parameters no longer strain against their priors."""
    strain = [float(((state.fit.values / state.fit.prior) ** 2).sum()) for state in (before, after)]
    return strain[0] - strain[1] > 0.5 * candidate.gain


def _so_far(
    calibration: Calibration, first: Fit, state: State, places: tuple[RandomTwist, ...], steps: Sequence[Step]
) -> Trace:
    """Return the account of a search that goes on: what was accepted, with what is known without comparing it."""
    found = []
    for index, step in enumerate(steps):
        found.append(_found(state, index, step, worth_of(state, index), ()))
    left = unexplained(state, localise(state.fit, state.scene, project(state.fit), state.groups))
    return replace(_summed_up(calibration, first, state, places, tuple(found), left), unfinished=True)


def _conclude(
    calibration: Calibration,
    first: Fit,
    state: State,
    places: tuple[RandomTwist, ...],
    steps: Sequence[Step],
    say: Report,
) -> Trace:
    """Return the account of a search that has come to its end, after second thoughts about what it added."""
    say("putting effects in each other's places")
    kept = exchanged(state, say)
    kept = replace(kept, state=sorted_out(kept.state))
    kept, withdrawn, compared = never_worse(first, kept, steps, say)
    state, looked = kept.state, _look(kept.state, say)  # which costs nothing where nothing changed
    say("comparing what else would do")
    found = _account(kept, steps)
    left = unexplained(state, looked.places) or _far_together(state)
    summed = _summed_up(calibration, first, state, places, found, left)
    say("looking what could not be told, and what to measure next")
    rivals = [[rival for rival, _ in one.equivalent] for one in found]
    return replace(
        summed,
        not_identifiable=not_identifiable(looked, state),
        smallest=smallest(looked, state),
        next_measurement=(*next_rows(state, rivals), *lacking(state.measurements)),
        compared=compared,
        withdrawn=withdrawn,
    )


def _summed_up(
    calibration: Calibration,
    first: Fit,
    state: State,
    places: tuple[RandomTwist, ...],
    found: tuple[Found, ...],
    left: Unexplained | None,
) -> Trace:
    """Return the account without what a search for more, and for what else would do, has to tell."""
    before = fitted_to(first, state.measurements, state.rows)
    folds, judged = pose_folds(state.groups), believed(before, state.fit)
    return Trace(
        _traced(calibration, state, found),
        calibration,
        before,
        state,
        found,
        left,
        places,
        (),
        (),
        state.fit.noise,
        held_out(before, folds, judged=judged).rms,
        held_out(state.fit, folds, judged=judged).rms,
        sessions_held_out(before, state.fit, state.effects, state.sessions),
        (),
    )


def _far_together(state: State) -> Unexplained | None:
    """Return rows left out although their neighbours are far off, too, as a residual without a place."""
    together = np.setdiff1d(state.asked[~(lost_rows(state, heed=True) | state.untold)], state.rows)
    if not len(together):
        return None
    view = look(state.fit.setup, state.measurements, together)
    errors = view.residual[:, view.positions]
    return Unexplained(None, None, None, None, float(np.sqrt((errors**2).sum() / len(state.asked))))


def _account(kept: Exchanged, steps: Sequence[Step]) -> tuple[Found, ...]:
    """Return what is to be said about every effect, in the order added."""
    found, state = [], kept.state
    for index, number in enumerate(kept.steps):
        step = steps[number]
        if index in kept.fresh:  # what was proven then was another effect
            step = replace(step, proof=prove(without(state, index), state, step.proof.null, [state.effects[index]]))
        worth, others = equivalents(state, index)
        found.append(_found(state, index, step, worth, others))
    return tuple(found)


def _found(state: State, index: int, step: Step, worth: float, others: tuple[tuple[Effect, float], ...]) -> Found:
    block = state.effects[index]
    values = state.values_of(block)
    std = block.std(values, state.stds_of(block))
    return Found(block.at(values), std, worth, step.proof, others, step.ranking, step.witness)


def _traced(calibration: Calibration, state: State, found: tuple[Found, ...]) -> Arm:
    """Return the arm with everything fitted; a random twist stays behind, because nobody can foresee it."""
    final = state.fit.setup
    effects = (*calibration.arm.effects, *(one.effect for one in found))
    arm = settled(final.arm, state.fit)
    return replace(arm, effects=effects, instrument=final.instrument, certainty=certainty_of(state.fit))
