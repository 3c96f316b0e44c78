"""The orientation of a target, as a tracker of six degrees of freedom reads it: the one at the tip, or another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.readings.kind import Kind, mounted
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

    def _mounted(self, at: Postures) -> tuple[str | None, Array]:
        """Return the link that the target is on, and the (N, 3) rotation vector by which it is turned there [rad]."""
        if self.name:
            return at.sensors[self.name].link, at.of(self.name, "mounting")
        return None, at.instrument.mounting_in(at.sessions)

    def _turns(self, at: Postures) -> Array:
        """Return the (N, 3, 3) orientations that the instrument would read, dimensionless."""
        return at.axes @ mounted(at, *self._mounted(at))[0]

    def predicted(self, at: Postures) -> Array:
        return np.array([pin.log3(turn) for turn in self._turns(at)]).reshape(-1, 3)

    def residual(self, at: Postures) -> Array:
        """Return the (N, 3) rotation vector from where the target should be to where it was seen [rad]."""
        turns = [pin.log3(pin.exp3(read) @ one.T) for read, one in zip(self.values, self._turns(at), strict=True)]
        return np.where(np.isfinite(self.sigma), np.array(turns).reshape(-1, 3), 0.0)

    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return (N, 3, 6): the target turns with its link."""
        return {self._mounted(at)[0]: np.concatenate([np.zeros((len(self.values), 3, 3)), at.axes], axis=2)}

    def by_frame(self, at: Postures) -> Array:
        """Return (N, 3, 6): it turns with the frame."""
        return np.concatenate([np.zeros((len(self.values), 3, 3)), at.turns], axis=2)

    def by_mounting(self, at: Postures) -> Array:
        """Return (N, 3, 3) the tip's axes as the instrument sees them, nothing of another target."""
        return np.zeros((len(self.values), 3, 3)) if self.name else at.axes @ at.pose(None)[:, :3, :3]

    def by_own(self, at: Postures) -> Array:
        """Return (N, 3, 3) the target's axes as the instrument sees them."""
        axes, changes = mounted(at, *self._mounted(at))
        return at.axes @ axes @ changes
