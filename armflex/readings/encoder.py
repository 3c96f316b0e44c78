"""The position of a joint as an encoder on its links reads it: the drive's own compliance and backlash are in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.readings.kind import Kind
from armflex.readings.postures import Postures
from armflex.readings.sensor import SCALE, Nuisance


@dataclass(frozen=True, eq=False)
class Encoder(Kind):
    """(N, 1) angle or way of the joint's link on the one inboard of it [rad or m]."""

    dimension = 1
    unit, quantity = "rad", "angle"
    channels = ("",)
    nuisances = (Nuisance("bias", ("",), "rad"), SCALE)

    def _angle(self, at: Postures) -> tuple[Array, Array]:
        """Return the (N, 1) position [rad or m], and the (N, 3) motion in the base that it is of."""
        sensor, shaft = at.sensors[self.name], at.sensors[self.name].shaft
        assert shaft is not None
        inboard, link = at.pose(shaft.inboard) @ shaft.origin, at.pose(sensor.link)
        back, axis = inboard[:, :3, :3].swapaxes(1, 2), inboard[:, :3, :3] @ shaft.axis
        if shaft.straight:
            away = np.einsum("nij,nj->ni", back, link[:, :3, 3] - inboard[:, :3, 3])
            return away @ shaft.axis[:, None], axis
        # About where the controller has it: a rotation vector is about the axis but for what the joint gives.
        q = at.q[shaft.joint]
        turns = back @ link[:, :3, :3]
        left = [pin.exp3(-value * shaft.axis) @ turn for value, turn in zip(q, turns, strict=True)]
        own = [link[i, :3, :3] @ pin.Jlog3(turn).T @ shaft.axis for i, turn in enumerate(left)]
        angles = np.array([pin.log3(turn) for turn in left]).reshape(-1, 3) @ shaft.axis[:, None]
        return q[:, None] + angles, np.array(own).reshape(-1, 3)

    def predicted(self, at: Postures) -> Array:
        return (1.0 + at.of(self.name, "scale")) * self._angle(at)[0] + at.of(self.name, "bias")

    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return (N, 1, 6): it sees the joint's link turn, or slide, on the one inboard of it."""
        sensor, shaft = at.sensors[self.name], at.sensors[self.name].shaft
        assert shaft is not None
        along = ((1.0 + at.of(self.name, "scale")) * self._angle(at)[1])[:, None]
        none = np.zeros_like(along)
        if not shaft.straight:
            turning = np.concatenate([none, along], axis=2)
            return {sensor.link: turning, shaft.inboard: -turning}
        # The way is along an axis that turns with the inboard link.
        inboard = at.pose(shaft.inboard)
        lever = np.cross(at.pose(sensor.link)[:, :3, 3] - inboard[:, :3, 3], along[:, 0])[:, None]
        return {
            sensor.link: np.concatenate([along, none], axis=2),
            shaft.inboard: -np.concatenate([along, lever], axis=2),
        }

    def by_own(self, at: Postures) -> Array:
        angle = self._angle(at)[0]
        return np.stack([np.ones_like(angle), angle], axis=2)


@dataclass(frozen=True, eq=False)
class SlideEncoder(Encoder):
    """The same of a joint that slides [m]."""

    unit, quantity = "m", "length"
    nuisances = (Nuisance("bias", ("",), "m"), SCALE)
