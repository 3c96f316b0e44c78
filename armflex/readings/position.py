"""The position of a target, as a laser tracker reads it: the one at the tip, or another anywhere on the arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.readings.kind import Kind, point_of, rigid_motion
from armflex.readings.postures import Postures
from armflex.readings.sensor import POINT


@dataclass(frozen=True, eq=False)
class Position(Kind):
    """(N, 3) coordinates of the target in the instrument frame [m]."""

    dimension = 3
    unit, quantity = "m", "length"
    channels = ("x", "y", "z")
    framed = True
    nuisances = (POINT,)

    def _target(self, at: Postures) -> tuple[str | None, Array]:
        """Return the link that it is on, and its (N, 3) place there [m]."""
        if self.name:
            return at.sensors[self.name].link, at.of(self.name, "point")
        return None, at.instrument.target_in(at.sessions)

    def _points(self, at: Postures) -> Array:
        return at.instrument.seen(point_of(at, *self._target(at))[0])

    def predicted(self, at: Postures) -> Array:
        return at.instrument.in_session(self._points(at), at.sessions)

    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return (N, 3, 6): the target moves with its link, and by its lever as the link turns."""
        link, own = self._target(at)
        return {link: at.axes @ point_of(at, link, own)[1]}

    def by_frame(self, at: Postures) -> Array:
        """Return (N, 3, 6): the points move as one body."""
        return at.turns @ rigid_motion(self._points(at))

    def by_scale(self, at: Postures) -> Array:
        """Return (N, 3) the points by the scale that they have now."""
        return np.einsum("nij,nj->ni", at.turns, self._points(at)) / (1.0 + at.instrument.scale)

    def by_target(self, at: Postures) -> Array:
        """Return (N, 3, 3) the tip's axes as the instrument sees them, nothing of another target."""
        return np.zeros((len(self.values), 3, 3)) if self.name else at.axes @ at.pose(None)[:, :3, :3]

    def by_own(self, at: Postures) -> Array:
        """Return (N, 3, 3) the link's axes as the instrument sees them."""
        return at.axes @ at.pose(self._target(at)[0])[:, :3, :3]
