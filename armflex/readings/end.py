"""Where an instrument takes hold of the arm: a point of a link, with axes there."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.conventions import Array

FIXED = ""
"""What stands for a link where an end is fixed to the base."""


@dataclass(frozen=True, eq=False)
class End:
    """A point of a link, and axes there, in N rows.

    Motions of it are of the point, linear [m] before angular [rad], in base axes.

    Attributes:
        link: Which; None is the tip, `FIXED` the base.
        pose: (N, 4, 4) of the link in the base [m].
        shift: (N, 3) the point in the link's frame [m].
        turn: (N, 3) rotation vectors of the axes in the link's [rad].
    """

    link: str | None
    pose: Array
    shift: Array
    turn: Array

    @cached_property
    def lever(self) -> Array:
        """(N, 3) from the link's origin to the point, base axes [m]."""
        return np.einsum("nij,nj->ni", self.pose[:, :3, :3], self.shift)

    @cached_property
    def place(self) -> Array:
        """(N, 3) the point in the base [m]."""
        return self.pose[:, :3, 3] + self.lever

    @cached_property
    def _turned(self) -> tuple[Array, Array]:
        """(N, 3, 3) rotations by `turn`, and what small rotations in the turned axes come of changes of it."""
        unique, back = np.unique(self.turn, axis=0, return_inverse=True)
        each = [np.array([of(vector) for vector in unique]).reshape(-1, 3, 3) for of in (pin.exp3, pin.Jexp3)]
        return each[0][back.ravel()], each[1][back.ravel()]

    @cached_property
    def axes(self) -> Array:
        """(N, 3, 3) the axes in the base, dimensionless."""
        return self.pose[:, :3, :3] @ self._turned[0]

    def by_link(self, change: Array) -> Array:
        """Return (N, d, 6) a change per motion of the link's origin from that per motion of the point."""
        return np.concatenate([change[:, :, :3], change[:, :, 3:] - change[:, :, :3] @ skew(self.lever)], axis=2)

    def by_shift(self, change: Array) -> Array:
        """Return (N, d, 3) a change per shift of the point in the link's frame [m]."""
        return change[:, :, :3] @ self.pose[:, :3, :3]

    def by_turn(self, change: Array) -> Array:
        """Return (N, d, 3) a change per rotation vector by which the axes are turned in the link's [rad]."""
        return change[:, :, 3:] @ self.axes @ self._turned[1]


def rigid_motion(points: Array) -> Array:
    """Return the (N, 3, 6) change of (N, 3) points per shift [m] and rotation vector [rad] about the origin."""
    return np.concatenate([np.broadcast_to(np.eye(3), (len(points), 3, 3)), -skew(points)], axis=2)


def shifted(change: Array) -> Array:
    """Return (N, d, 6) what changes by (N, d, 3) as a point is shifted [m], and not at all as it turns."""
    return np.concatenate([change, np.zeros_like(change)], axis=2)


def turned(change: Array) -> Array:
    """Return (N, d, 6) what changes by (N, d, 3) as axes turn [rad], and not at all as they are shifted."""
    return np.concatenate([np.zeros_like(change), change], axis=2)


def skew(vectors: Array) -> Array:
    """Return the (N, 3, 3) matrices whose product with another vector is the cross product with (N, 3) vectors."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
