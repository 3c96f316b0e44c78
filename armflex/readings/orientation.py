"""The orientation of a target at the tip, as a tracker of six degrees of freedom reads it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.readings.instrument import Instrument
from armflex.readings.kind import Kind


@dataclass(frozen=True, eq=False)
class Orientation(Kind):
    """(N, 3) rotation vectors of the target in the instrument frame [rad]."""

    dimension = 3
    unit = "rad"

    def residual(self, instrument: Instrument, tip: Array, sessions: Sequence[str]) -> Array:
        """Return the (N, 3) rotation vector from where the target should be to where it was seen [rad]."""
        predicted = instrument.rotations(tip, sessions)
        turns = [pin.log3(pin.exp3(read) @ one.T) for read, one in zip(self.values, predicted, strict=True)]
        return np.where(np.isfinite(self.sigma), np.array(turns).reshape(-1, 3), 0.0)

    def jacobian(self, instrument: Instrument, tip: Array) -> Array:
        """Return (N, 3, 6): the target turns with the tip."""
        return np.broadcast_to(np.hstack([np.zeros((3, 3)), instrument.pose.rotation]), (len(tip), 3, 6))

    def by_frame(self, points: Array) -> Array:
        """Return (N, 3, 6): it turns with the frame."""
        return np.broadcast_to(np.hstack([np.zeros((3, 3)), np.eye(3)]), (len(points), 3, 6))

    def by_scale(self, instrument: Instrument, points: Array) -> Array:
        """Return nothing: an orientation has no distance."""
        return np.zeros((len(points), 3))

    def by_target(self, instrument: Instrument, tip: Array) -> Array:
        """Return nothing: a target that is shifted is turned as before."""
        return np.zeros((len(tip), 3, 3))

    def by_mounting(self, instrument: Instrument, tip: Array) -> Array:
        """Return (N, 3, 3) the tip's axes as the instrument sees them."""
        return instrument.axes(tip)
