"""From a calibrated arm's residual to the effect that it lacks; scipy is imported when it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from armflex.arm import Arm
from armflex.measured.measurements import Measurements

if TYPE_CHECKING:
    from armflex.trace.result import Trace


def trace(
    arm: Arm,
    measurements: Measurements,
    rows: np.ndarray | None = None,
    report: Callable[[str], None] | None = None,
    keep: bool = False,
) -> Trace:
    """Return the arm with the effects that a campaign shows it lacks, and an account of them.

    Args:
        arm: The arm as declared; its prior says what calibration may move.
        measurements: The campaign, rows in the order driven; unmeasured rows count for effects with a memory.
        rows: Measured rows to use; all when not given.
        report: Called with what is being done, in words.
        keep: Keep what an earlier campaign was fitted to: only the instrument's and the sessions' frames are fitted;
            see `calibrate`.

    Raises:
        InputError: Too few rows were measured.
        ConvergenceError: The calibration did not settle.
    """
    from armflex.trace.trace import trace as run

    return run(arm, measurements, rows, report, keep)
