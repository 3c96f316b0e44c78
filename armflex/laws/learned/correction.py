"""A correction where it counts, and how it ends beyond the loads seen without making a joint look as if it buckled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.laws.joint.log_compliance import root_of
from armflex.laws.law import Law, Row
from armflex.laws.learned.window import STEEPEST, Window
from armflex.laws.parameter import Parameter

TAKEN = 0.25
"""Of the compliance that a correction may take where it fades."""

NEAREST = 2.0
"""Reach, see `Window`, before which no correction is nothing."""

CLIMBS = 4
"""Steps uphill to the load under which a correction is largest."""


@dataclass(frozen=True, eq=False)
class Correction(Law):
    """A law where it counts: as it is at loads that were seen, further out carried on.

    It fades with the energy that a load puts into the joint, over a few times the most that was seen where it is small
    beside the law that is corrected, more slowly where it is large.
    """

    law: Law
    window: Window

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the law."""
        return self.law.parameters

    @property
    def values(self) -> Array:
        """Those of the law."""
        return self.law.values

    def at(self, values: Array) -> Correction:
        """Return the correction at other values."""
        return Correction(self.law.at(values), self.window)

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the twist."""
        window = self.window
        if window.sees(wrench):
            return self.law.twist(wrench, row)
        return window.weight(wrench)[..., None] * self.law.twist(window.drawn_in(wrench), row)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the derivative by the wrench."""
        window = self.window
        if window.sees(wrench):
            return self.law.tangent(wrench, row)
        within = window.drawn_in(wrench)
        carried = self.law.tangent(within, row) @ window.drawing_in(wrench)
        along = self.law.twist(within, row)[..., :, None] * window.slope(wrench)[..., None, :]
        return window.weight(wrench)[..., None, None] * carried + along

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the derivative by the values."""
        by_law = self.law.by_values(self.window.drawn_in(wrench), row)
        return by_law * self.window.weight(wrench)[..., None, None]


def fading(base: Law, correction: Correction, wrenches: Array, row: Row) -> tuple[float, Array | None]:
    """Return the reach at which a correction may be nothing, and the (6, 6) matrix of reaches; see `Window`.

    A correction c that fades is a compliance the other way, c times the slope of its weight: too steep a one takes all
    that the joint gives, or gives too much, and the arm looks as if it buckled. With C = R R' it changes no more of C
    than |R^-1 c| |R^-1 slope| in any direction of the load. The second factor is the same in all directions, and least,
    where the weight goes by the energy w' C w; the reach is such that the product is `TAKEN` at most in
    the many directions that are looked at.

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
    root = root_of(0.5 * (tangent + tangent.T))[own]
    most = np.linalg.eigvalsh(root.T @ np.linalg.inv(window.precision[own]) @ root)[-1]
    if not most > 0.0:
        return NEAREST, None
    energy = np.zeros((6, 6))
    energy[own] = root @ root.T / most
    inverse = np.zeros((6, 6))
    inverse[own] = np.linalg.pinv(root, rcond=1e-9)
    size = _largest(correction, inverse, wrenches, row)
    return float(max(NEAREST, 1.0 + STEEPEST * size / np.sqrt(most) / TAKEN)), energy


def _largest(correction: Correction, inverse: Array, wrenches: Array, row: Row) -> float:
    """Return the largest |R^-1 c| as far out as a correction is carried: in many directions, each followed uphill."""
    window, law = correction.window, correction.law
    spread = np.linalg.pinv(window.precision, rcond=1e-15)
    loads, largest = window.furthest(window.directions(wrenches)), 0.0
    for _ in range(CLIMBS):
        twists = law.twist(loads, row) @ inverse.T
        largest = max(largest, float(np.linalg.norm(twists, axis=1).max()))
        uphill = np.einsum("na,nai->ni", twists, inverse @ law.tangent(loads, row))
        loads = window.furthest(uphill @ spread)
    return largest
