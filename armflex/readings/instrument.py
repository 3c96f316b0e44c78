"""The instrument that measures the tip: where it stands, how each session set it up, and what it looks at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from armflex.conventions import Array


@dataclass(frozen=True)
class Instrument:
    """Frame and target of a measurement.

    Attributes:
        pose: T_instrument_base.
        sessions: (6,) shift [m] and rotation vector [rad] of the frame in each session, about its own origin; a
            session that is not named has none.
        target: (3,) measured point in the tip frame [m].
        scale: Share by which its distances are too long.
        mounting: (3,) rotation vector of the axes whose orientation is read, in the tip frame [rad].
    """

    pose: pin.SE3 = field(default_factory=pin.SE3.Identity)
    sessions: Mapping[str, Array] = field(default_factory=dict)
    target: Array = field(default_factory=lambda: np.zeros(3))
    scale: float = 0.0
    mounting: Array = field(default_factory=lambda: np.zeros(3))

    def in_base(self, tip: Array) -> Array:
        """Return the (N, 3) target in the base frame [m] for (N, 4, 4) tip poses."""
        return tip[:, :3, 3] + tip[:, :3, :3] @ self.target

    def seen(self, points: Array) -> Array:
        """Return (N, 3) points of the base in the instrument frame [m], sessions left out."""
        return (1.0 + self.scale) * (points @ self.pose.rotation.T + self.pose.translation)

    def in_session(self, points: Array, sessions: Sequence[str]) -> Array:
        """Return (N, 3) points of the instrument frame as each session has it [m]."""
        shift = self.session_shifts(sessions)
        return points + shift[:, :3] + np.cross(shift[:, 3:], points)

    def readings(self, tip: Array, sessions: Sequence[str]) -> Array:
        """Return the (N, 3) positions of the target that the instrument would read [m], for (N, 4, 4) tip poses."""
        return self.in_session(self.seen(self.in_base(tip)), sessions)

    def rotations(self, tip: Array, sessions: Sequence[str]) -> Array:
        """Return the (N, 3, 3) orientations of the target that the instrument would read, dimensionless."""
        return self.session_turns(sessions) @ self.axes(tip) @ pin.exp3(self.mounting)

    def axes(self, poses: Array) -> Array:
        """Return the (N, 3, 3) axes of (N, 4, 4) poses in the instrument frame, dimensionless, sessions left out."""
        return self.pose.rotation @ poses[:, :3, :3]

    def session_turns(self, sessions: Sequence[str]) -> Array:
        """Return the (N, 3, 3) rotations of each row's session, dimensionless."""
        turned = {name: pin.exp3(self.sessions.get(name, np.zeros(6))[3:]) for name in set(sessions)}
        return np.array([turned[name] for name in sessions]).reshape(-1, 3, 3)

    def session_shifts(self, sessions: Sequence[str]) -> Array:
        """Return the (N, 6) shift of each row's session [m, rad]."""
        number = {name: i for i, name in enumerate(dict.fromkeys(sessions))}
        shifts = np.array([self.sessions.get(name, np.zeros(6)) for name in number]).reshape(-1, 6)
        return shifts[[number[name] for name in sessions]]


def fit_frame(points: Array, measured: Array) -> pin.SE3:
    """Return the T_instrument_base that takes (N, 3) points in the base to measured positions best (Kabsch 1976)."""
    centre, seen = points.mean(axis=0), measured.mean(axis=0)
    left, _, right = np.linalg.svd((measured - seen).T @ (points - centre))
    proper = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    rotation = left @ proper @ right
    return pin.SE3(rotation, seen - rotation @ centre)


def fit_mounting(axes: Array, rotation: Array) -> Array:
    """Return the rotation vector of the target in the tip frame that fits best (chordal mean; Hartley 2013).

    Args:
        axes: (N, 3, 3) axes of the tip in the instrument frame.
        rotation: (N, 3) rotation vectors read [rad].
    """
    turns = [one.T @ pin.exp3(vector) for one, vector in zip(axes, rotation, strict=True)]
    left, _, right = np.linalg.svd(np.sum(turns, axis=0))
    return pin.log3(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)
