"""From a calibrated arm's residual to the effect that it lacks; scipy is imported when it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.errors import ConventionError, InputError
from armflex.measured.measurements import Measurements, as_measurements
from armflex.measured.table import Tabular

if TYPE_CHECKING:
    from armflex.trace.findings import Trace
    from armflex.trace.telling import Doing


METHODS = ("steps", "posterior")


@checked_kinds
def trace(
    arm: Arm,
    measurements: Measurements | Tabular,
    rows: np.ndarray | None = None,
    report: Callable[[str], None] | None = None,
    keep: bool = False,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    account: Callable[[Trace], None] | None = None,
    progress: Callable[[Doing], None] | None = None,
    anyway: bool = False,
    method: Literal["steps", "posterior"] = "steps",
) -> Trace:
    """Return the arm with the effects that a campaign shows it lacks, and an account of them.

    The arm predicts held-out poses no worse than the calibrated one: effects with which it would are withdrawn.

    Args:
        arm: The arm as declared; its prior says what calibration may move.
        measurements: The campaign, rows in the order driven; unmeasured rows count for effects with a memory.
        rows: (M,) numbers of the measured rows to use; all when not given.
        report: Called with what is being done, in words, once for every stage.
        keep: Keep what an earlier campaign was fitted to: only the instrument's and the sessions' frames are fitted;
            see `calibrate`.
        checkpoint: File that is written after every round of the search, so that one that was interrupted can go on;
            it is removed at the end.
        resume: Go on from the checkpoint instead of beginning anew. The result is that of a search that was not
            interrupted, to rounding.
        account: Called after every accepted effect with the account so far, marked `unfinished`, and at the end with
            the finished one; the checkpoint is removed once it has returned.
        progress: Called with how far the search has come within a stage, thousands of times.
        anyway: Take the campaign as it is, also where it is plausible only in another convention.
        method: How effects are chosen: in steps, or by the posterior over sets of effects, with probabilities; the
            latter keeps no checkpoint.

    Raises:
        ConventionError: The campaign is implausible for this arm, and plausible in another convention; or readings
            scatter a hundred times as far as they state, whatever was found.
        InputError: Too few rows were measured, or there is no checkpoint to resume from.
        FileError: The checkpoint cannot be written at first, does not exist, is damaged, or belongs to another arm,
            campaign, version or other options, which it names. Where it cannot be written later on, `report` is told,
            and the last one stays.
        ConvergenceError: The calibration did not settle.
    """
    measurements = as_measurements(measurements, arm)
    if resume and checkpoint is None:
        raise InputError("resume needs the checkpoint to go on from")
    from armflex.estimate.misread import check_scatter

    path = None if checkpoint is None else Path(checkpoint)

    def write(found: Trace) -> None:
        try:
            check_scatter(found.state.fit)
        except ConventionError:
            if not (found.unfinished or anyway):
                if path is not None:
                    path.unlink(missing_ok=True)
                raise
            if not anyway:
                return  # more effects may explain it
        if account is not None:
            account(found)

    if not (isinstance(method, str) and method in METHODS):
        raise InputError(f"method is {method!r}: expected one of {', '.join(METHODS)}")
    if method == "posterior":
        from armflex.trace.posterior.run import trace as by_posterior

        if resume:
            raise InputError("a search by the posterior keeps no checkpoint to go on from")
        return by_posterior(arm, measurements, rows, report, keep, write, progress, anyway)
    from armflex.trace.rounds import trace as run

    return run(arm, measurements, rows, report, keep, path, resume, write, progress, anyway)
