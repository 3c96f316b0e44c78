"""The height of a point on the arm above a table: a ruler, a dial gauge on a stand, a probe to a surface plate."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from armflex.conventions import SMALLEST_STD, Array
from armflex.declaration import Declaration
from armflex.readings.end import End, shifted
from armflex.readings.kind import Ends, Kind
from armflex.readings.plane import Plane
from armflex.readings.postures import Postures
from armflex.readings.sensor import POINT, SCALE, Nuisance
from armflex.robot import Robot


@dataclass(frozen=True, eq=False)
class Height(Kind):
    """(N, 1) heights [m] of the point above a table, square to it; the table's own height and tilt may be unknown."""

    dimension = 1
    unit, quantity = "m", "length"
    channels = ("",)
    nuisances = (Nuisance("table", ("",), "m"), Nuisance("tilt", ("x", "y"), "rad"), POINT, SCALE)

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return the link, and the table that heights are over: level unless `up` says where it faces, in the base."""
        up = table.numbers("up", (3,)) if table.has("up") else -robot.gravity
        if np.linalg.norm(up) < SMALLEST_STD:
            raise table.fail("up", "needs to be given, a direction in the base: there is no gravity to be level to")
        return {**super().declared(table, robot), "about": Plane(up)}

    def _over(self, at: Postures) -> tuple[End, Array]:
        """Return the point, and (N, 6): its height [m] as it is, and the changes of that with the point (3) and with
        the tilt (2).
        """
        end = at.end(self.name)
        normal, tilted = at.about(self.name, Plane).tilted(at.of(self.name, "tilt"))
        height = np.einsum("ni,ni->n", end.place, normal)
        return end, np.column_stack([height, normal, np.einsum("ni,nij->nj", end.place, tilted)])

    def ideal(self, at: Postures) -> Array:
        return self._over(at)[1][:, :1] - at.of(self.name, "table")

    def ends(self, at: Postures) -> Ends:
        """Return the point: it is read as it rises."""
        end, heights = self._over(at)
        return {"end": (end, shifted(heights[:, None, 1:4]))}

    def others(self, at: Postures) -> Mapping[str, Array]:
        gain = self.gain(at)[:, None]
        return {"table": -gain, "tilt": gain * self._over(at)[1][:, None, 4:]}
