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
from armflex.estimate.calibrate import calibrate
from armflex.estimate.held_out import held_out, pose_folds
from armflex.estimate.robust import robust_limit
from armflex.measured.measurements import Measurements
from armflex.rows.rows import POSE
from armflex.storage.whole_file import remove
from armflex.trace.accept import APART, ENOUGH, MARGIN, Step, null_maximum, prove
from armflex.trace.afterwards import conclude, so_far
from armflex.trace.checkpoint import Progress, identity, read_checkpoint, restored, write_checkpoint
from armflex.trace.families import with_families
from armflex.trace.findings import Trace
from armflex.trace.polish import Polished
from armflex.trace.projection import project
from armflex.trace.search import TIE, Round, plainest
from armflex.trace.state import State, add, begin, information, sorted_out, stands, with_random
from armflex.trace.telling import Doing, Report, Teller, tell_steps
from armflex.trace.unrecorded import NOTICED, PoseBlock, RandomTwist, as_likely, localise

MOST_EFFECTS = 12
"""Effects at which a search ends, though more may be missing."""

SOUGHT = 6.0
"""Evidence more for waves, bumps and products: the residual itself chose the places at which they compete."""

SHARE = 0.4
"""Share of the excess that the best candidate must explain; below it an unrecorded cause is thought of first."""

FAR_APART = 4.0
"""Standard errors by which held-out errors must fall where a random twist would explain more."""


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
    anyway: bool = False,
) -> Trace:
    """Return the traced arm and its account; `armflex.trace` says what goes in."""
    teller = Teller(report, progress)
    say = teller.stage
    say("calibrating")
    about = identity(arm, measurements, rows, keep) if checkpoint else {}
    said = read_checkpoint(checkpoint, about) if checkpoint and resume else None
    steps = partial(tell_steps, teller.step)
    calibration = calibrate(arm, measurements, rows, steps, keep=keep, as_stated=True, anyway=anyway)
    begun = begin(calibration, teller.step, say)
    places = localise(begun.fit, begun.context, project(begun.fit), begun.groups)
    found = Progress(begun, contexts=(begun.context,))
    if checkpoint and said is not None:
        found = restored(checkpoint, said, begun)
        say(f"going on with {len(found.state.effects)} effects")
    elif checkpoint and not checkpoint.exists():  # that of another search stays until there is something to keep
        write_checkpoint(checkpoint, about, found)
    _tell_figures(teller, found.state)
    while not found.ended and found.state.alone < MOST_EFFECTS:
        known, after = found.state, _round(found.state)
        found = replace(found, ended=True) if after is None else found.after(after)
        if checkpoint:
            try:
                write_checkpoint(checkpoint, about, found)
            except FileError as error:  # a full disk: ended here, the search would lose what it just found
                say(f"{error}; the search goes on")
        if found.state.effects != known.effects:
            _tell_figures(teller, found.state)
            if account is not None:
                try:
                    passing = so_far(found.state, places)
                except ArmflexError as error:  # a search is not ended because there is no account yet
                    say(f"no account so far: {error}")
                else:
                    account(passing)
    traced = conclude(found.state, places)
    if not found.ended:
        traced = replace(traced, stopped_at=found.state.alone)
    if account is not None:
        account(traced)
    if checkpoint:
        remove(checkpoint)
    return traced


def _tell_figures(teller: Teller, state: State) -> None:
    """Say what there is so far: effects, and the error with them."""
    *_, last = (None, *state.steps)
    unseen = held_out(state.first, pose_folds(state.groups)).rms if last is None else last.proof.after
    effects = tuple(block.effect.title for block in state.effects)
    teller.say(effects=effects, rms=state.fit.rms, held_out=unseen)


def _round(state: State) -> State | None:
    """Return the state with one more effect, else with an unrecorded cause set aside, else without rows far off.

    None where nothing is left to be done.
    """
    state.say(f"searching what {len(state.rows)} rows still show")
    looked = state.looked
    related = with_families(state, looked.best)
    if related is not None:
        return sorted_out(replace(related, heed=True))
    place = _unrecorded(state, looked)
    found = _accept(state, looked, APART if place is None else FAR_APART)
    if found is not None:
        return sorted_out(replace(found, heed=True))
    if place is not None:
        state.say(f"setting aside a random twist at {place.site} {place.axis}")
        groups = state.context.column(POSE).astype(int)
        return with_random(state, PoseBlock(place.site, place.axis, place.std, groups, as_likely(looked.places)))
    related = with_families(state, None)
    if related is not None:
        return sorted_out(replace(related, heed=True))
    # What is far off together stayed because an effect might explain it: none does.
    left = sorted_out(replace(state, heed=False)) if state.heed else state
    return None if state.uses(left.rows) else left


def _unrecorded(state: State, looked: Round) -> RandomTwist | None:
    """Return where a random twist explains clearly more than any candidate does, None where nowhere."""
    place, best = looked.places[0], looked.ranking[0]
    # So many parameters explain so much of one random twist per pose by chance.
    chance = min(1.0, best.candidate.parameters / len(set(state.groups.tolist())))
    share = SHARE + (1.0 - SHARE) * chance
    is_random = best.gain < share * looked.excess and 2.0 * place.ratio > 1.5 * best.evidence
    return place if is_random and state.random is None and place.ratio >= NOTICED else None


def _accept(state: State, looked: Round, apart: float) -> State | None:
    """Return the state with the best candidate in it, None where none is better than chance.

    Held-out errors must fall by `apart` standard errors; where that is more than usual, only the catalogue will do.
    """
    if apart > APART and not looked.best.candidate.law.physical:
        return None
    null = _beyond_chance(state, looked, looked.best)
    found = None if null is None else _proven(state, looked, _refitted(state, looked), null, apart)
    if found is None and looked.contender is not None and apart == APART:
        null = _beyond_chance(state, looked, looked.contender)
        found = None if null is None else _proven(state, looked, _added(state, [looked.contender]), null, apart)
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


def _refitted(state: State, looked: Round) -> list[tuple[Polished, State]]:
    """Return the shortlist with everything refitted, the best first; a contender alone where it leaves nothing.

    What the data do not tell apart goes by plainness.
    """
    contender = _added(state, [looked.first]) if looked.could else []
    if contender and contender[0][1].looked.ranking[0].evidence < ENOUGH:
        return contender
    limit = robust_limit(state.fit.view)
    added = [(information(after, limit), one, after) for one, after in _added(state, looked.shortlist)]
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
            if stands(after) and after.fit.cost(limit) < state.fit.cost(limit):
                found.append((candidate, after))
    return found


def _proven(
    state: State, looked: Round, refitted: Sequence[tuple[Polished, State]], null: float, apart: float
) -> State | None:
    """Return the first state that rows it has not seen speak for."""
    for candidate, after in refitted:
        proof = prove(state, after, null, after.effects[len(state.effects) :] or after.effects)
        # The gain is chiefly that parameters no longer strain against their priors.
        strain, left = (float(((one.fit.values / one.fit.prior) ** 2).sum()) for one in (state, after))
        by_rows = proof.errors_apart > apart and proof.sessions_agree
        witness = apart == APART and strain - left > 0.5 * candidate.gain and proof.errors_apart > -APART
        if by_rows or witness:
            step = Step(looked.ranking, proof, not by_rows)
            # The proof of an effect that it only widens is known.
            return replace(after, steps=tuple(step if one is None else one for one in after.steps))
    return None
