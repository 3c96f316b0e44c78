"""The position of a target, as a laser tracker reads it: the one at the tip, or another anywhere on the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.readings.end import rigid_motion, shifted
from armflex.readings.kind import Ends, Kind
from armflex.readings.postures import Postures
from armflex.readings.sensor import POINT

UNREAD = 1000.0
"""Tolerance: times as uncertain as the best coordinate of its row one is stated that nobody read, as of a height."""


@dataclass(frozen=True, eq=False)
class Position(Kind):
    """(N, 3) coordinates of the target in the instrument frame [m]."""

    dimension = 3
    unit, quantity = "m", "length"
    channels = ("x", "y", "z")
    framed = True
    nuisances = (POINT,)

    @property
    def read(self) -> np.ndarray:
        """(N, 3) coordinates that were read, in rows where any was."""
        return self.sigma <= UNREAD * self.sigma.min(axis=1, keepdims=True)

    def _points(self, at: Postures) -> Array:
        return at.instrument.seen(at.end(self.name).place)

    def ideal(self, at: Postures) -> Array:
        return at.instrument.in_session(self._points(at), at.sessions)

    def ends(self, at: Postures) -> Ends:
        """Return the target."""
        return {"end": (at.end(self.name), shifted((1.0 + at.instrument.scale) * at.axes))}

    def by_frame(self, at: Postures) -> Array:
        """Return (N, 3, 6): the points move as one body."""
        return at.turns @ rigid_motion(self._points(at))

    def by_scale(self, at: Postures) -> Array:
        """Return (N, 3) the points by the scale that they have now."""
        return np.einsum("nij,nj->ni", at.turns, self._points(at)) / (1.0 + at.instrument.scale)
