"""From a calibrated arm's residual to the effect that it lacks; scipy is imported when it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.errors import InputError
from armflex.measured.joined import as_campaign
from armflex.measured.measurements import Measurements
from armflex.measured.table import Tabular
from armflex.plan import MOST_ASKED
from armflex.progress import MOST_MINUTES

if TYPE_CHECKING:
    from armflex.progress import Doing
    from armflex.trace.findings import Trace
    from armflex.trace.search import Standing


@checked_kinds
def trace(
    arm: Arm,
    measurements: Measurements | Tabular | Sequence[Measurements | Tabular],
    rows: np.ndarray | None = None,
    report: Callable[[str], None] | None = None,
    keep: bool = False,
    progress: Callable[[Doing], None] | None = None,
    anyway: bool = False,
    ask: int = 0,
    covariates: Mapping[str, Sequence[float]] | None = None,
    minutes: float = MOST_MINUTES,
    halves: int = 0,
) -> Trace:
    """Return the arm with the effects that a campaign shows it lacks, and an account of them.

    Probabilities are averages over resamples of the campaign (`armflex.trace.resampling`). An effect that is likelier
    than all else that it may be, and than nothing, is named.
    A search ends where nothing is more probable, after as many states as it may enter, or after `minutes`; then `ended`
    says which, and what there is is weighed, which may take as long again. Once the arm is calibrated
    Ctrl-C (KeyboardInterrupt), or weighing that takes longer, ends it at once with what was accepted, `unfinished`.

    Args:
        arm: The arm as declared; its prior says what calibration may move.
        measurements: The campaign, rows in the order driven; unmeasured rows count for effects with a memory. A list of
            several campaigns of this machine is traced together, the instrument and its target anew in each.
        rows: (M,) numbers of the measured rows to use; all when not given.
        report: Called with what is being done, in words, once for every stage.
        keep: Keep what an earlier campaign was fitted to: only the instrument's and the sessions' frames are fitted;
            see `calibrate`.
        progress: Called with how far the search has come within a stage, thousands of times.
        anyway: Take the campaign as it is, also where it is plausible only in another convention.
        ask: How many rows are wanted that decide what is in question, in `asked` of what is returned; see
            `armflex.plan.drive.write_plan`.
        covariates: For those rows, values that can be set of recorded columns by name; others stay as they were last.
        minutes: CPU time that the search may take once the arm is calibrated [min]; as much for each half.
        halves: Trace so many random halves of the campaign, and as many by parts of joint space, each beside the
            other half: how often what one names is in the other is in `halves` of what is returned.

    Raises:
        ConventionError: The campaign is implausible for this arm, and plausible in another convention; or readings
            scatter a hundred times as far as they state, whatever was found.
        InputError: Too few rows were measured, of halves too few poses.
        ConvergenceError: The calibration did not settle, or that of a half.
    """
    from armflex.estimate.calibrate import calibrate
    from armflex.estimate.misread import check_scatter
    from armflex.progress import OutOfTimeError, Reporter
    from armflex.trace.account import conclude, so_far
    from armflex.trace.halves import in_halves
    from armflex.trace.search import is_bounded, led, linear, search, standing
    from armflex.trace.state import begin

    if halves < 0:
        raise InputError(f"halves is {halves}, expected 0 or more")
    if not 0 <= ask <= MOST_ASKED:
        raise InputError(f"ask is {ask}, expected 0 to {MOST_ASKED}")
    if not minutes > 0.0:
        raise InputError(f"minutes is {minutes:g}, expected more than 0")
    reporter = Reporter(report, progress)
    reporter.stage("calibrating")
    campaign = as_campaign(measurements, arm)
    calibration = calibrate(arm, campaign, rows, reporter.steps, keep=keep, as_stated=True, anyway=anyway)

    begun, ended = begin(calibration, reporter), ""
    places, latest = linear(begun).places, begun

    def passing(here: Standing) -> None:
        nonlocal latest
        if len(here.state.asked) == len(begun.asked):  # not of some poses, which lead
            latest = here.state
        effects = tuple(one.title for one in here.state.fitted)
        reporter.say(effects=effects, rms=here.state.fit.rms, unit=here.state.fit.view.readings.unit)

    try:
        reporter.limit(60.0 * minutes)
        try:
            here = led(begun, passing)
            passing(here)
            here = search(here, passing)
            if is_bounded(here):
                ended = f"after {len(here.visited)} states, the most that a search enters"
        except OutOfTimeError:
            ended = f"after {minutes:g} min of CPU time, the most that `minutes` allows"
            reporter.limit(60.0 * minutes)
            here = standing(latest)  # it was in the midst of something
        reporter.limit(60.0 * minutes)
        traced = conclude(here, places, ask, covariates, ended, begun)
    except OutOfTimeError:
        ended = ended or f"after {minutes:g} min of CPU time in which what was found was weighed, see `minutes`"
    except KeyboardInterrupt:
        ended = "by an interrupt"
    else:
        if not anyway:
            check_scatter(traced.state.fit)
        if halves:
            reporter.limit(float("inf"))

            def half(arm: Arm, campaign: Measurements, rows: np.ndarray) -> Trace:
                return trace(arm, campaign, rows, keep=keep, anyway=True, minutes=minutes)

            with suppress(KeyboardInterrupt):  # what was traced stands
                traced = replace(traced, halves=in_halves(arm, campaign, begun.asked, halves, half, reporter.stage))
        return traced
    reporter.limit(float("inf"))
    reporter.stage("ending with what was accepted so far")
    return so_far(latest, places, ended, begun)
