"""The position of a point on one link as another link sees it: a camera on the arm, two targets of one."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.readings.end import shifted, skew
from armflex.readings.kind import Ends, Kind, link_in
from armflex.readings.postures import Postures
from armflex.readings.sensor import ANCHOR, AXES, LOOKS, POINT
from armflex.robot import Robot


@dataclass(frozen=True, eq=False)
class RelativePosition(Kind):
    """(N, 3) coordinates of the point in the axes of what looks at it, at its anchor on another link [m]."""

    dimension = 3
    unit, quantity = "m", "length"
    channels = AXES
    nuisances = (ANCHOR, POINT, LOOKS)

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return the link that the point is on, and that from which it is seen."""
        link = link_in(table, "link", robot)
        return {"link": link, "seen_from": link_in(table, "seen_from", robot, link)}

    def ideal(self, at: Postures) -> Array:
        end, eye = at.end(self.name), at.end(self.name, "eye")
        return np.einsum("nij,ni->nj", eye.axes, end.place - eye.place)

    def ends(self, at: Postures) -> Ends:
        """Return point and eye, whose turning moves what it sees."""
        end, eye = at.end(self.name), at.end(self.name, "eye")
        back = eye.axes.swapaxes(1, 2)
        seen = np.concatenate([-back, back @ skew(end.place - eye.place)], axis=2)
        return {"end": (end, shifted(back)), "eye": (eye, seen)}
