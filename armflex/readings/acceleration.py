"""Gravity in the axes of a link, as an accelerometer on it reads it at rest."""

from dataclasses import dataclass
from typing import Any

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.readings.end import End, skew, turned
from armflex.readings.kind import Ends, Kind
from armflex.readings.postures import Postures
from armflex.readings.sensor import AXES, MOUNTING, SCALE, zero_of
from armflex.robot import Robot

OPPOSITE = {"gravity": "specific_force", "specific_force": "gravity"}
"""What an accelerometer reads, and what it then does not."""


@dataclass(frozen=True, eq=False)
class Acceleration(Kind):
    """(N, 3) gravity in link axes [m/s^2], or what holds the sensor up against it."""

    dimension = 3
    unit, quantity = "m/s^2", "acceleration"
    channels = AXES
    nuisances = (MOUNTING, zero_of(AXES, "m/s^2"), SCALE)

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return the link, and whether it reads the opposite."""
        return {**super().declared(table, robot), "about": table.choice("reads", tuple(OPPOSITE), "gravity")}

    def _hold(self, at: Postures) -> tuple[End, Array]:
        """Return where it is, and the (N, 3, 3) change of its numbers with gravity."""
        end = at.end(self.name)
        sign = -1.0 if at.sensors[self.name].about == "specific_force" else 1.0
        return end, sign * end.axes.swapaxes(1, 2)

    def ideal(self, at: Postures) -> Array:
        return (self._hold(at)[1] @ at.gravities[..., None])[..., 0]

    def ends(self, at: Postures) -> Ends:
        """Return the sensor: as it turns, gravity turns back in its axes."""
        end, back = self._hold(at)
        return {"end": (end, turned(back @ skew(at.gravities)))}

    def by_gravity(self, at: Postures) -> Array:
        return self.gain(at)[..., None] * self._hold(at)[1]
