"""Gravity in the axes of a link, as an accelerometer on it reads it at rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.readings.kind import Kind, mounted, skew
from armflex.readings.postures import Postures
from armflex.readings.sensor import AXES, MOUNTING, SCALE, Nuisance

OPPOSITE = 'reads = "specific_force"', 'reads = "gravity"'


@dataclass(frozen=True, eq=False)
class Acceleration(Kind):
    """(N, 3) gravity in link axes [m/s^2], or what holds the sensor up against it."""

    dimension = 3
    unit, quantity = "m/s^2", "acceleration"
    channels = AXES
    nuisances = (MOUNTING, Nuisance("bias", AXES, "m/s^2"), SCALE)

    def _felt(self, at: Postures) -> tuple[Array, Array, Array]:
        """Return (N, 3) gravity in the sensor's axes, those in the base (N, 3, 3), and how they change by mounting."""
        sensor = at.sensors[self.name]
        axes, changes = mounted(at, sensor.link, at.of(self.name, "mounting"))
        gain = sensor.sign * (1.0 + at.of(self.name, "scale"))
        back = gain[:, :, None] * axes.swapaxes(1, 2)
        return (back @ at.gravities[..., None])[..., 0], back, changes

    def predicted(self, at: Postures) -> Array:
        return self._felt(at)[0] + at.of(self.name, "bias")

    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return (N, 3, 6): as the link turns, gravity turns back in its axes."""
        turned = self._felt(at)[1] @ skew(at.gravities)
        return {at.sensors[self.name].link: np.concatenate([np.zeros_like(turned), turned], axis=2)}

    def by_gravity(self, at: Postures) -> Array:
        return self._felt(at)[1]

    def by_own(self, at: Postures) -> Array:
        felt, _, changes = self._felt(at)
        one = np.broadcast_to(np.eye(3), (len(felt), 3, 3))
        return np.concatenate(
            [skew(felt) @ changes, one, (felt / (1.0 + at.of(self.name, "scale")))[:, :, None]], axis=2
        )
