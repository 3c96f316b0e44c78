"""The distance of a point on the arm from an anchor: a draw wire, a ball bar, an interferometer's beam."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.readings.kind import Kind, point_of
from armflex.readings.postures import Postures
from armflex.readings.sensor import ANCHOR, POINT, SCALE, Nuisance, Sensor


@dataclass(frozen=True, eq=False)
class Distance(Kind):
    """(N, 1) lengths [m]: from the anchor, in the base or on another link, to the point; the zero added."""

    dimension = 1
    unit, quantity = "m", "length"
    channels = ("",)
    nuisances = (ANCHOR, Nuisance("length_offset", ("",), "m"), POINT, SCALE)

    def _ends(self, at: Postures) -> tuple[Array, Array, Array, Array, Array | None]:
        """Return lengths (N,) [m], directions (N, 3) from anchor to point, (N, 3, 6) changes of both ends with their
        links' motions, that of the anchor None in the base.
        """
        sensor = at.sensors[self.name]
        there, moved = point_of(at, sensor.link, at.of(self.name, "point"))
        here, carried = at.of(self.name, "anchor"), None
        if sensor.seen_from is not None:
            here, carried = point_of(at, sensor.seen_from, here)
        length = np.maximum(np.linalg.norm(there - here, axis=1), 1e-12)
        return length, (there - here) / length[:, None], there, moved, carried

    def predicted(self, at: Postures) -> Array:
        length = self._ends(at)[0][:, None]
        return (1.0 + at.of(self.name, "scale")) * length + at.of(self.name, "length_offset")

    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return (N, 1, 6): what moves along the wire lengthens it."""
        sensor, (_, towards, _, moved, carried) = at.sensors[self.name], self._ends(at)
        towards = ((1.0 + at.of(self.name, "scale")) * towards)[:, None]
        found: dict[str | None, Array] = {sensor.link: towards @ moved}
        if carried is not None:
            found[sensor.seen_from] = found.get(sensor.seen_from, 0.0) - towards @ carried
        return found

    def by_own(self, at: Postures) -> Array:
        sensor, (length, towards, _, _, _) = at.sensors[self.name], self._ends(at)
        along = ((1.0 + at.of(self.name, "scale")) * towards)[:, None]
        anchor = along if sensor.seen_from is None else along @ at.pose(sensor.seen_from)[:, :3, :3]
        point, one = along @ at.pose(sensor.link)[:, :3, :3], np.ones((len(length), 1, 1))
        return np.concatenate([-anchor, one, point, length[:, None, None]], axis=2)

    @classmethod
    def implausible(cls, sensor: Sensor, read: Array, predicted: Array) -> str | None:
        ratio = float(np.median(read) / max(np.median(predicted), 1e-9))
        for unit, factor in (("mm", 1e3), ("cm", 1e2), ("inches", 39.37)):
            if abs(np.log(ratio / factor)) < 0.3:
                return f"lengths are about {factor:g} times as long as the arm's: in {unit}, not m? (write the unit into the header)"
        return None
