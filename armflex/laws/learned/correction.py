"""A correction where it counts, and how it ends beyond the loads seen without making a joint look as if it buckled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.laws.law import Law, Row
from armflex.laws.learned.compliance_part import root_of
from armflex.laws.learned.part import Part
from armflex.laws.learned.window import STEEPEST, Window

TAKEN = 0.25
"""Of the compliance that a correction may take where it fades."""

NEAREST = 2.0
"""Distance before which no correction is nothing."""


@dataclass(frozen=True, eq=False)
class Correction(Law):
    """The correction of a learned law alone: as it was learned at loads that were seen, further out carried on."""

    part: Part
    values: Array
    window: Window

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the twist."""
        window = self.window
        if window.sees(wrench):
            return self.part.twist(self.values, wrench, row)
        return window.weight(wrench)[..., None] * self.part.twist(self.values, window.drawn_in(wrench), row)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the derivative by the wrench."""
        window = self.window
        if window.sees(wrench):
            return self.part.tangent(self.values, wrench, row)
        within = window.drawn_in(wrench)
        carried = self.part.tangent(self.values, within, row) @ window.drawing_in(wrench)
        twist = self.part.twist(self.values, within, row)
        return (
            window.weight(wrench)[..., None, None] * carried + twist[..., :, None] * window.slope(wrench)[..., None, :]
        )


def fading(base: Law, correction: Correction, wrenches: Array, row: Row) -> float:
    """Return the distance at which a correction may be nothing.

    A correction that fades is a compliance the other way, its size over the length: too short a one takes all that the
    joint gives, and the arm looks as if it buckled. With C = R R' it takes no more of C than |R^-1 c| |R^-1 slope| in
    any direction of the load, and the length is such that this is `TAKEN` at most.

    Args:
        base: The law that is corrected.
        correction: As it was learned, not fading.
        wrenches: (M, 6) loads seen.
        row: The M rows.
    """
    window = correction.window
    axes = np.flatnonzero(np.diag(window.precision) > 0.0)
    own = np.ix_(axes, axes)
    tangent = base.tangent(wrenches, row).reshape(-1, 6, 6).mean(axis=0)
    inverse = np.linalg.pinv(root_of(0.5 * (tangent + tangent.T))[own], rcond=1e-9)
    twists = correction.part.twist(correction.values, window.furthest(wrenches), row)[:, axes]
    size = np.linalg.norm(twists @ inverse.T, axis=1).max()
    steep = np.sqrt(np.linalg.eigvalsh(inverse @ window.precision[own] @ inverse.T)[-1])
    return float(max(NEAREST, 1.0 + STEEPEST * size * steep / TAKEN))
