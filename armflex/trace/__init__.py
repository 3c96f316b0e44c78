"""From a calibrated arm's residual to the effect that it lacks; scipy is imported when it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.errors import ArmflexError, ConventionError, InputError
from armflex.measured.joined import as_campaign
from armflex.measured.measurements import Measurements
from armflex.measured.table import Tabular
from armflex.plan import MOST_ASKED

if TYPE_CHECKING:
    from armflex.laws.effects.effect import Effect
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
    account: Callable[[Trace], None] | None = None,
    progress: Callable[[Doing], None] | None = None,
    anyway: bool = False,
    ask: int = 0,
    covariates: Mapping[str, Sequence[float]] | None = None,
    accepted: Sequence[Effect] = (),
) -> Trace:
    """Return the arm with the effects that a campaign shows it lacks, and an account of them.

    Effects with which the arm predicts held-out poses worse than the calibrated one, beyond chance, are withdrawn.

    Args:
        arm: The arm as declared; its prior says what calibration may move.
        measurements: The campaign, rows in the order driven; unmeasured rows count for effects with a memory. A list of
            several campaigns of this machine is traced together, the instrument and its target anew in each.
        rows: (M,) numbers of the measured rows to use; all when not given.
        report: Called with what is being done, in words, once for every stage.
        keep: Keep what an earlier campaign was fitted to: only the instrument's and the sessions' frames are fitted;
            see `calibrate`.
        account: Called after every state that the search accepts with the account so far, marked `unfinished`, and at
            the end with the finished one.
        progress: Called with how far the search has come within a stage, thousands of times.
        anyway: Take the campaign as it is, also where it is plausible only in another convention.
        ask: How many rows are wanted that decide what is in question, in `asked` of what is returned; see
            `armflex.plan.drive.write_plan`.
        covariates: For those rows, values that can be set of recorded columns by name; others stay as they were last.
        accepted: Effects that an earlier search of the same campaign had accepted: this one begins with them.

    Raises:
        ConventionError: The campaign is implausible for this arm, and plausible in another convention; or readings
            scatter a hundred times as far as they state, whatever was found.
        InputError: Too few rows were measured.
        ConvergenceError: The calibration did not settle.
    """
    from armflex.estimate.calibrate import calibrate
    from armflex.estimate.misread import check_scatter
    from armflex.progress import Reporter
    from armflex.trace.account import conclude, so_far
    from armflex.trace.search import led, linear, resumed, search, standing
    from armflex.trace.state import begin

    if not 0 <= ask <= MOST_ASKED:
        raise InputError(f"ask is {ask}, expected 0 to {MOST_ASKED}")
    reporter = Reporter(report, progress)
    reporter.stage("calibrating")
    campaign = as_campaign(measurements, arm)
    calibration = calibrate(arm, campaign, rows, reporter.steps, keep=keep, as_stated=True, anyway=anyway)

    def leading(here: Standing) -> None:
        effects = tuple(one.title for one in here.state.fitted)
        reporter.say(effects=effects, rms=here.state.fit.rms, unit=here.state.fit.view.readings.unit)

    begun = begin(calibration, reporter)
    places = linear(begun).places

    def passing(here: Standing) -> None:
        leading(here)
        if account is None:
            return
        try:
            if not anyway:
                check_scatter(here.state.fit)  # more effects may explain it
            account(so_far(here, places))
        except ConventionError:
            return
        except ArmflexError as error:  # a search is not ended because there is no account yet
            reporter.stage(f"no account so far: {error}")

    here = resumed(standing(begun), accepted) if accepted else standing(led(begun, leading))
    if here.state.known:
        passing(here)
    traced = conclude(search(here, passing), places, ask, covariates)
    if not anyway:
        check_scatter(traced.state.fit)
    if account is not None:
        account(traced)
    return traced
