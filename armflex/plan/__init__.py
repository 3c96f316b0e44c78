"""What to measure next: poses, payloads and approaches that add most to what matters; matplotlib only for a picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from armflex.arm import Arm
from armflex.measured.measurements import Measurements
from armflex.trajectory import Trajectory

if TYPE_CHECKING:
    from armflex.plan.result import Plan


def plan(
    arm: Arm,
    rows: int = 20,
    *,
    after: Measurements | None = None,
    along: Trajectory | None = None,
    between: tuple[str, str] | None = None,
    payloads: Sequence[str] | None = None,
    covariates: Mapping[str, Sequence[float]] | None = None,
    sigma: float | None = None,
    floor: float = -np.inf,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Plan:
    """Return the rows to measure next, in the order to drive them, and what they are expected to tell.

    Without `along` or `between` the rows make the parameters that [prior] frees, and those of the arm's effects, as
    certain as can be, wherever the instrument stands.

    Args:
        arm: The arm, declared or calibrated; of a calibrated one the stored covariance is what is known before.
        rows: How many positions will be read.
        after: What was measured already; an arm that is not calibrated is calibrated with it.
        along: Make the predicted readings along this trajectory as certain as can be instead.
        between: Tell these two effects apart instead, each spelled LAW:SITE[:AXIS[:PARTNER]], as `trace` names them;
            the second effect of the arm with such a spelling ends in #2.
        payloads: What may be carried; every payload of the arm, and nothing, when not given.
        covariates: Values that can be set of what effects depend on, by name.
        sigma: Standard deviation of a position read [m]; that of `after`, else 0.2 mm, when not given.
        floor: Lowest height of the tip in the base frame [m].
        seed: Of the rows that are offered.
        progress: Called with (steps done, steps in all).

    Raises:
        InputError: Nothing is free, no row is possible, a number is out of its range, or no values are given of what an
            effect depends on.
        UnknownNameError: No such payload, effect or site.
        UnsupportedError: What an effect in question does depends on the rows before.
        ArmflexError: The campaign cannot be that of this arm, see `calibrate`.
    """
    from armflex.plan.planning import make  # scipy takes a while
    from armflex.plan.question import Question

    asked = Question(rows, along, between, payloads, covariates or {}, sigma, floor, seed)
    return make(arm, after, asked, progress)


def write_plan(found: Plan, path: str | Path) -> Path:
    """Write the rows as a measurements.csv whose positions are still empty; whole or not at all."""
    from armflex.plan.poses_file import write_plan as write

    return write(found, path)


def draw_plan(found: Plan, path: str | Path) -> Path:
    """Write a picture of certainty against readings, and of where the arm is well known and where not."""
    from armflex.plan.picture import draw_plan as draw

    return draw(found, path)
