"""The position of a point on one link as another link sees it: a camera on the arm, two targets of one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.readings.kind import Kind, mounted, point_of, skew
from armflex.readings.postures import Postures
from armflex.readings.sensor import ANCHOR, AXES, MOUNTING, POINT


@dataclass(frozen=True, eq=False)
class RelativePosition(Kind):
    """(N, 3) coordinates of the point in the axes of what looks at it, at its anchor on another link [m]."""

    dimension = 3
    unit, quantity = "m", "length"
    channels = AXES
    nuisances = (ANCHOR, POINT, MOUNTING)

    def _seen(self, at: Postures) -> tuple[Array, Array, Array, Array, Array]:
        """Return (N, 3) vector from eye to point in the base [m], (N, 3, 3) axes of the eye, their change by mounting,
        and (N, 3, 6) changes of point and eye with their links' motions.
        """
        sensor = at.sensors[self.name]
        there, moved = point_of(at, sensor.link, at.of(self.name, "point"))
        here, carried = point_of(at, sensor.seen_from, at.of(self.name, "anchor"))
        axes, changes = mounted(at, sensor.seen_from, at.of(self.name, "mounting"))
        return there - here, axes, changes, moved, carried

    def predicted(self, at: Postures) -> Array:
        away, axes, *_ = self._seen(at)
        return np.einsum("nij,ni->nj", axes, away)

    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return (N, 3, 6) of both links: the eye's turning moves what it sees."""
        sensor, (away, axes, _, moved, carried) = at.sensors[self.name], self._seen(at)
        back = axes.swapaxes(1, 2)
        turned = np.concatenate([np.zeros((len(away), 3, 3)), back @ skew(away)], axis=2)
        return {sensor.link: back @ moved, sensor.seen_from: turned - back @ carried}

    def by_own(self, at: Postures) -> Array:
        sensor, (away, axes, changes, _, _) = at.sensors[self.name], self._seen(at)
        back = axes.swapaxes(1, 2)
        anchor, point = (back @ at.pose(link)[:, :3, :3] for link in (sensor.seen_from, sensor.link))
        return np.concatenate([-anchor, point, skew(np.einsum("nij,nj->ni", back, away)) @ changes], axis=2)
