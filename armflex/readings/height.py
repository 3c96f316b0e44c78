"""The height of a point on the arm above a table: a ruler, a dial gauge on a stand, a probe to a surface plate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armflex.conventions import SMALLEST_STD, Array
from armflex.declaration import Declaration
from armflex.readings.kind import Kind, point_of
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
    def declared(cls, table: Declaration, robot: Robot) -> tuple[None, Plane]:
        """Return the table that heights are over: level unless `up` says where it faces, in the base."""
        up = table.numbers("up", (3,)) if table.has("up") else -robot.gravity
        if np.linalg.norm(up) < SMALLEST_STD:
            raise table.fail("up", "needs to be given, a direction in the base: there is no gravity to be level to")
        return None, Plane(up)

    def _over(self, at: Postures) -> tuple[Array, Array, Array, Array]:
        """Return (N,) heights [m] as they are, (N, 1, 3) and (N, 2) their changes with the point and the tilt, and
        (N, 3, 6) that of the point with its link.
        """
        sensor = at.sensors[self.name]
        plane = sensor.about
        assert isinstance(plane, Plane)
        points, moved = point_of(at, sensor.link, at.of(self.name, "point"))
        tilt, found = at.of(self.name, "tilt"), np.zeros((len(points), 6))
        for one in np.unique(tilt, axis=0):
            own = (tilt == one).all(axis=1)
            normal, turned = plane.tilted(one)
            found[own] = np.column_stack([points[own] @ normal, np.tile(normal, (own.sum(), 1)), points[own] @ turned])
        return found[:, 0] - at.of(self.name, "table")[:, 0], found[:, None, 1:4], found[:, 4:], moved

    def predicted(self, at: Postures) -> Array:
        return (1.0 + at.of(self.name, "scale")) * self._over(at)[0][:, None]

    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return (N, 1, 6): what rises with its link."""
        _, normal, _, moved = self._over(at)
        return {at.sensors[self.name].link: (1.0 + at.of(self.name, "scale"))[:, None] * normal @ moved}

    def by_own(self, at: Postures) -> Array:
        height, normal, tilt, _ = self._over(at)
        scale = 1.0 + at.of(self.name, "scale")
        point = scale * (normal @ at.pose(at.sensors[self.name].link)[:, :3, :3])[:, 0]
        return np.hstack([-scale, scale * tilt, point, height[:, None]])[:, None]
