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
from armflex.measured.measurements import Measurements
from armflex.storage.whole_file import remove
from armflex.trace.afterwards import conclude, so_far
from armflex.trace.checkpoint import Progress, identity, read_checkpoint, restored, write_checkpoint
from armflex.trace.exchange import exchanged
from armflex.trace.findings import Trace
from armflex.trace.grow import grown, paired, set_aside, suspected, unrecorded
from armflex.trace.projection import project
from armflex.trace.state import State, begin
from armflex.trace.telling import Doing, Report, Teller, tell_steps
from armflex.trace.unrecorded import localise

MOST_EFFECTS = 12
"""Effects at which a search ends, though more may be missing."""

MOST_ROUNDS = 100
"""Steps at which it ends, should second thoughts go round in circles."""


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
    while not found.ended and len(found.state.effects) < MOST_EFFECTS and len(found.rounds) < MOST_ROUNDS:
        known, passed = found.state, _round(found.state)
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
        traced = replace(traced, stopped_at=len(found.state.effects))
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


def _round(state: State) -> tuple[State, ...]:
    """Return the states from one to the next, none where nothing is left to be done.

    One more effect is found; else others take the place of some that were; else two more are found together where a
    random twist would explain more than either; else, at last, that is set aside.
    """
    after = grown(state)
    if after is None:
        passed = exchanged(state)
        if passed:
            return *passed, suspected(passed[-1])
        after = (paired(state) if unrecorded(state, state.looked) else None) or set_aside(state)
    return () if after is None else (after,)
