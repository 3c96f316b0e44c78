"""The inclination of a link, as a two-axis level on it reads it."""

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.readings.end import End, turned
from armflex.readings.kind import Ends, Kind
from armflex.readings.postures import Postures
from armflex.readings.sensor import MOUNTING, zero_of


@dataclass(frozen=True, eq=False)
class Inclination(Kind):
    """(N, 2) angles of the link's x and y axes to the horizontal, positive where they point up [rad]."""

    dimension = 2
    unit, quantity = "rad", "inclination"
    channels = ("x", "y")
    nuisances = (MOUNTING, zero_of(("x", "y"), "rad"))

    def _tilts(self, at: Postures) -> tuple[End, Array, Array, Array]:
        """Return where it is, (N, 2, 3) its axes and the (N, 3) or (1, 3) vertical in the base, and (N, 2) sines."""
        end, up = at.end(self.name), at.up
        axes = end.axes.swapaxes(1, 2)[:, :2]
        return end, axes, up, np.clip((axes @ up[..., None])[..., 0], -1.0, 1.0)

    def ideal(self, at: Postures) -> Array:
        return np.arcsin(self._tilts(at)[3])

    def ends(self, at: Postures) -> Ends:
        """Return the level: a turn about what is across axis and vertical tilts the axis."""
        end, axes, up, sine = self._tilts(at)
        return {"end": (end, turned(np.cross(axes, up[:, None]) / _cosine(sine)[..., None]))}

    def by_gravity(self, at: Postures) -> Array:
        _, axes, up, sine = self._tilts(at)
        size = np.maximum(np.linalg.norm(at.gravities, axis=1), 1e-300)
        across = axes - sine[:, :, None] * up[:, None]
        return -across / _cosine(sine)[..., None] / size[:, None, None]

    def readable(self, at: Postures) -> np.ndarray:
        # Sine of the inclination to which levels are made, 50 degrees
        return np.all(np.abs(self._tilts(at)[3]) < 0.77, axis=1)


def _cosine(sine: Array) -> Array:
    return np.maximum(np.sqrt(1.0 - sine**2), 1e-6)
