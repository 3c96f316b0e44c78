"""A correction where it counts, and how it ends beyond the loads seen without making a joint look as if it buckled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from armflex.conventions import Array
from armflex.laws.law import Law, Row
from armflex.laws.learned.compliance_part import root_of
from armflex.laws.learned.part import Part
from armflex.laws.learned.window import OVER, STEEPEST, Window

FIRM = 0.3
"""Of the compliance that is to be left in every direction where a correction is carried on, if it is at loads seen."""

TAKEN = 0.5
"""Of what is left there that a correction may take where it fades."""

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


def ending(base: Law, correction: Correction, wrenches: Array, row: Row) -> tuple[float, float]:
    """Return how far a correction is carried on, and the distance at which it may be nothing.

    A polynomial that goes on may give less and less; and a correction that fades is a compliance the other way, its
    size over the length. What is left of the compliance, the smallest eigenvalue of I + R^-1 J R^-T with C = R R', is
    looked at along the loads seen and all round; fading takes half of it at most in every direction, for
    |R^-1 c| |R' slope| bounds what it takes. So the tangent stays positive wherever it is at the loads seen.

    Args:
        base: The law that is corrected.
        correction: As it was learned, not fading.
        wrenches: (M, 6) loads seen.
        row: The M rows.
    """
    axes = np.flatnonzero(np.diag(correction.window.precision) > 0.0)
    tangent = base.tangent(wrenches, row).reshape(-1, 6, 6).mean(axis=0)
    root = root_of(0.5 * (tangent + tangent.T))[np.ix_(axes, axes)]
    inverse = np.linalg.pinv(root, rcond=1e-9)
    among = _left(correction, inverse, axes, wrenches, row)
    for over in OVER * 0.5 ** np.arange(6):
        carried = replace(correction, window=replace(correction.window, over=float(over)))
        left = min(among, _left(carried, inverse, axes, _outside(carried.window, wrenches), row))
        if left >= min(FIRM, TAKEN * among):
            break
    window = carried.window
    twists = carried.part.twist(carried.values, window.furthest(wrenches), row)[:, axes]
    size = np.linalg.norm(twists @ inverse.T, axis=1).max()
    steep = np.sqrt(np.linalg.eigvalsh(root.T @ window.precision[np.ix_(axes, axes)] @ root)[-1])
    taken = TAKEN * min(max(left, 0.1 * FIRM), 1.0)
    return window.over, float(max(NEAREST, 1.0 + STEEPEST * size * steep / taken))


def _outside(window: Window, wrenches: Array) -> Array:
    """Return loads at several distances in the directions of (M, 6) ones, and all round."""
    off = (window.furthest(wrenches) - window.mean) / (1.0 + window.over)
    return np.concatenate([window.mean + distance * off for distance in (1.0, 1.25, 1.5, 2.0, 3.0)])


def _left(correction: Correction, inverse: Array, axes: Array, wrenches: Array, row: Row) -> float:
    """Return the smallest part of the compliance that is left under some loads, in any direction."""
    slopes = inverse @ correction.tangent(wrenches, row)[:, axes][:, :, axes] @ inverse.T
    return 1.0 + float(np.linalg.eigvalsh(0.5 * (slopes + np.swapaxes(slopes, 1, 2)))[:, 0].min())
