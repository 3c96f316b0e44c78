"""The position of a target at the tip, as a laser tracker reads it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.readings.instrument import Instrument
from armflex.readings.kind import Kind


@dataclass(frozen=True, eq=False)
class Position(Kind):
    """(N, 3) coordinates of the target in the instrument frame [m]."""

    dimension = 3
    unit = "m"

    def residual(self, instrument: Instrument, tip: Array, sessions: Sequence[str]) -> Array:
        """Return the (N, 3) difference of coordinates [m]."""
        return self.values - instrument.readings(tip, sessions)

    def jacobian(self, instrument: Instrument, tip: Array) -> Array:
        """Return (N, 3, 6): the target moves with the tip, and by its lever as the tip turns."""
        lever = tip[:, :3, :3] @ instrument.target
        return instrument.pose.rotation @ rigid_motion(lever)

    def by_frame(self, points: Array) -> Array:
        """Return (N, 3, 6): the points move as one body."""
        return rigid_motion(points)

    def by_scale(self, instrument: Instrument, points: Array) -> Array:
        """Return (N, 3) the points by the scale that they have now."""
        return points / (1.0 + instrument.scale)

    def by_target(self, instrument: Instrument, tip: Array) -> Array:
        """Return (N, 3, 3) the tip's axes as the instrument sees them."""
        return instrument.axes(tip)

    def by_mounting(self, instrument: Instrument, tip: Array) -> Array:
        """Return nothing: a point that is turned stays where it is."""
        return np.zeros((len(tip), 3, 3))


def rigid_motion(points: Array) -> Array:
    """Return the (N, 3, 6) change of (N, 3) points per shift [m] and rotation vector [rad] about the origin."""
    x, y, z = points.T
    zero = np.zeros(len(points))
    crossed = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    return np.concatenate([np.broadcast_to(np.eye(3), crossed.shape), -crossed], axis=2)
