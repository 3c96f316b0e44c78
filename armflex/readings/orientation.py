"""The orientation of a target, as a tracker of six degrees of freedom reads it: the one at the tip, or another."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.readings.end import turned
from armflex.readings.kind import Ends, Kind
from armflex.readings.postures import Postures
from armflex.readings.sensor import MOUNTING


@dataclass(frozen=True, eq=False)
class Orientation(Kind):
    """(N, 3) rotation vectors of the target in the instrument frame [rad]."""

    dimension = 3
    unit, quantity = "rad", "angle"
    channels = ("rx", "ry", "rz")
    framed = True
    nuisances = (MOUNTING,)

    def _turns(self, at: Postures) -> Array:
        """Return the (N, 3, 3) orientations that the instrument would read, dimensionless."""
        return at.axes @ at.end(self.name).axes

    def ideal(self, at: Postures) -> Array:
        return np.array([pin.log3(turn) for turn in self._turns(at)]).reshape(-1, 3)

    def residual(self, at: Postures) -> Array:
        """Return the (N, 3) rotation vector from where the target should be to where it was seen [rad]."""
        turns = [pin.log3(pin.exp3(read) @ turn.T) for read, turn in zip(self.values, self._turns(at), strict=True)]
        return np.where(np.isfinite(self.sigma), np.array(turns).reshape(-1, 3), 0.0)

    def ends(self, at: Postures) -> Ends:
        """Return the target, which turns with its link; its rotation vector changes by that, see `residual`."""
        return {"end": (at.end(self.name), turned(at.axes))}

    def by_frame(self, at: Postures) -> Array:
        """Return (N, 3, 6): it turns with the frame."""
        return turned(at.turns)
