"""`trace`: calibrate, find the residual, trace it to an effect the arm lacks, add it, and say what it was worth."""

from __future__ import annotations

from collections.abc import Callable
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
from armflex.storage.whole_file import remove
from armflex.trace.checkpoint import Kept, Progress, identity, read_checkpoint, restored, write_checkpoint
from armflex.trace.exchange import exchanged
from armflex.trace.families import with_families
from armflex.trace.findings import Trace, conclude, so_far
from armflex.trace.grow import grown, loosened, paired, possible, set_aside, settled, without_far_rows
from armflex.trace.projection import project
from armflex.trace.search import TIE
from armflex.trace.state import State, begin, information
from armflex.trace.telling import Doing, Report, Teller, tell_steps
from armflex.trace.unrecorded import localise

MOST_EFFECTS = 12
"""Effects at which a search ends, though more may be missing."""


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
        known, passed = found.state, _round(found.state, partial(_goes_round, found))
        found = replace(found, ended=not passed)
        for state in passed:
            found = found.after(state)
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
    teller.say(effects=effects, rms=state.fit.rms, held_out=unseen, unit=state.fit.view.readings.unit)


def _round(state: State, again: Callable[[State], bool]) -> tuple[State, ...]:
    """Return the states from one to the next, none where nothing is left to be done or all would be done `again`."""
    related = partial(_related, again=again)
    for step in (possible, loosened, related, grown, exchanged, paired, set_aside, _among_all, without_far_rows):
        after = step(state)
        if after:
            passed = after if isinstance(after, tuple) else (after,)
            return () if again(passed[-1]) else passed
    return ()


def _goes_round(found: Progress, state: State) -> bool:
    """Return whether second thoughts that lead to a state would go round in circles."""
    return any(_alike(state, one) for one in found.rounds) and not _better(state, found.state)


def _better(state: State, known: State) -> bool:
    """Return whether a state has what the one before it had, at the same places, and explains clearly more."""
    limit, names = robust_limit(known.fit.view), [[one.name for one in some.fitted] for some in (state, known)]
    if names[0] != names[1] or state.random is not None or not state.uses(known.rows):
        return False
    return information(state, limit, below=True) < information(known, limit, below=True) - TIE


def _alike(state: State, kept: Kept) -> bool:
    """Return whether a state has the effects that one before it had."""
    names = [[(block.effect.name, block.free) for block in one.effects] for one in (state, kept)]
    alike = (state.random is None, state.heed) == (kept.random is None, kept.heed)
    return names[0] == names[1] and alike and len(kept.left_out) == len(state.asked) - len(state.rows)


def _related(state: State, again: Callable[[State], bool]) -> State | tuple[State, ...] | None:
    """Return the state with what all drives have in common where it explains more than any effect would by itself.

    That would explain some of what an effect of another kind or at another place leaves, too: such are exchanged first.
    """
    state.say(f"searching what {len(state.rows)} rows still show")
    found = settled(with_families(state, state.looked.best))
    better = () if found is None else exchanged(state)
    return better if better and not again(better[-1]) else found


def _among_all(state: State) -> State | None:
    """Return the state with what all drives have in common though no drive's shows by itself."""
    return settled(with_families(state, None))
