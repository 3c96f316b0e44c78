"""The distance of a point of the arm from a wall, read by a laser on the arm that shines along -x of the base."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.readings.end import shifted
from armflex.readings.kind import Ends, Kind, link_in
from armflex.readings.postures import Postures
from armflex.readings.sensor import POINT, zero_of
from armflex.robot import Robot

ALONG = np.array([1.0, 0.0, 0.0])
"""Away from the wall, axes of the base."""


@dataclass(frozen=True, eq=False)
class WallDistance(Kind):
    """(N, 1) x of the point in the base, over that of the wall [m]; where the wall stands is found."""

    dimension = 1
    unit, quantity = "m", "length"
    channels = ("",)
    nuisances = (POINT, zero_of(("",), "m", "wall"))

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return what an [instrument.NAME] table says: the link that the laser is on."""
        return {"link": link_in(table, "link", robot)}

    def ideal(self, at: Postures) -> Array:
        """Return what would be read of a wall at x = 0."""
        return at.end(self.name).place @ ALONG[:, None]

    def ends(self, at: Postures) -> Ends:
        """Return how that changes as the point moves."""
        end = at.end(self.name)
        return {"end": (end, shifted(np.broadcast_to(ALONG, (len(end.place), 1, 3))))}
