"""The position of a target, as a laser tracker reads it: the one at the tip, or another anywhere on the arm."""

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.readings.end import rigid_motion, shifted
from armflex.readings.kind import Ends, Kind
from armflex.readings.postures import Postures
from armflex.readings.sensor import POINT

LENGTH_ALIKE, FEWEST_ALIKE = 0.1, 8
"""Tolerance: scatter of the lengths of positions, over their standard deviation, below which all have one length
exactly, and how many show that: they are directions, written as unit vectors."""


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
        # Times as uncertain as the best coordinate of its row one is stated that nobody read, as of a height
        return self.sigma <= 1000.0 * self.sigma.min(axis=1, keepdims=True)

    @property
    def exact(self) -> int:
        """The lengths of unit vectors: as readings without an error they would show that all others have none."""
        read = np.isfinite(self.sigma).all(axis=1)
        lengths, std = np.linalg.norm(self.values[read], axis=1), self.sigma[read]
        alike = len(std) >= FEWEST_ALIKE and lengths.std() < LENGTH_ALIKE * np.sqrt((std**2).mean())
        return int(read.sum()) if alike else 0

    def _points(self, at: Postures) -> Array:
        points = self._straight(at)
        return points + at.bend[:, :1] * _lifted(points, at) if at.bend[:, 0].any() else points

    def _straight(self, at: Postures) -> Array:
        """Return (N, 3) where the target is in the instrument frame [m], as if no beam were bent."""
        return at.instrument.seen(at.end(self.name).place)

    def ideal(self, at: Postures) -> Array:
        return at.instrument.in_session(self._points(at), at.sessions)

    def ends(self, at: Postures) -> Ends:
        """Return the target."""
        return {"end": (at.end(self.name), shifted((1.0 + at.instrument.scale) * at.axes))}

    def by_frame(self, at: Postures) -> Array:
        """Return (N, 3, 6): the points move as one body."""
        return at.turns @ rigid_motion(self._points(at))

    def by_bend(self, at: Postures) -> Array:
        """Return (N, 3, 2): a beam that bends downwards lifts what is seen by the square of its length."""
        change = np.zeros((len(self.values), 3, 2))
        change[:, :, 0] = np.einsum("nij,nj->ni", at.turns, _lifted(self._straight(at), at))
        return change

    def by_scale(self, at: Postures) -> Array:
        """Return (N, 3) the points by the scale that they have now."""
        return np.einsum("nij,nj->ni", at.turns, self._points(at)) / (1.0 + at.instrument.scale)


def _lifted(points: Array, at: Postures) -> Array:
    """Return (N, 3) the square of the distance [m^2] of (N, 3) points in the instrument frame, against gravity."""
    return (points**2).sum(axis=1, keepdims=True) * (at.up @ at.instrument.pose.rotation.T)
