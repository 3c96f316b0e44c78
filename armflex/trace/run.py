"""`trace` by the posterior over sets of effects."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from armflex.arm import Arm
from armflex.errors import ArmflexError, ConventionError
from armflex.estimate.calibrate import calibrate
from armflex.estimate.misread import check_scatter
from armflex.measured.measurements import Measurements
from armflex.trace.account import conclude, so_far
from armflex.trace.asking import Ask
from armflex.trace.findings import Trace
from armflex.trace.search import Standing, search, standing
from armflex.trace.state import begin
from armflex.trace.telling import Doing, Report, Teller, tell_steps


def trace(
    arm: Arm,
    measurements: Measurements,
    rows: np.ndarray | None = None,
    report: Report | None = None,
    keep: bool = False,
    account: Callable[[Trace], None] | None = None,
    progress: Callable[[Doing], None] | None = None,
    anyway: bool = False,
    ask: Ask | None = None,
) -> Trace:
    """Return the traced arm and its account; `armflex.trace` says what goes in."""
    teller = Teller(report, progress)
    teller.stage("calibrating")
    steps = partial(tell_steps, teller.step)
    calibration = calibrate(arm, measurements, rows, steps, keep=keep, as_stated=True, anyway=anyway)
    begun = standing(begin(calibration, teller.step, teller.stage))
    places = begun.places

    def passing(here: Standing) -> None:
        effects = tuple(one.title for one in here.state.fitted)
        teller.say(effects=effects, rms=here.state.fit.rms, unit=here.state.fit.view.readings.unit)
        if account is None:
            return
        try:
            if not anyway:
                check_scatter(here.state.fit)  # more effects may explain it
            account(so_far(here, places))
        except ConventionError:
            return
        except ArmflexError as error:  # a search is not ended because there is no account yet
            teller.stage(f"no account so far: {error}")

    traced = conclude(search(begun, passing), places, ask)
    if not anyway:
        check_scatter(traced.state.fit)
    if account is not None:
        account(traced)
    return traced
