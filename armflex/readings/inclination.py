"""The inclination of a link, as a two-axis level on it reads it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.readings.kind import Kind, mounted, skew
from armflex.readings.postures import Postures
from armflex.readings.sensor import MOUNTING, Nuisance

STEEPEST = 0.77
"""Sine of the inclination to which levels are made, 50 degrees."""


@dataclass(frozen=True, eq=False)
class Inclination(Kind):
    """(N, 2) angles of the link's x and y axes to the horizontal, positive where they point up [rad]."""

    dimension = 2
    unit, quantity = "rad", "inclination"
    channels = ("x", "y")
    nuisances = (MOUNTING, Nuisance("bias", ("x", "y"), "rad"))

    def _tilts(self, at: Postures) -> tuple[Array, Array, Array, Array]:
        """Return (N, 2) sines and cosines, (N, 3, 3) axes of the level in the base, and how they change by mounting."""
        axes, changes = mounted(at, at.sensors[self.name].link, at.of(self.name, "mounting"))
        sine = np.clip((axes.swapaxes(1, 2) @ self._up(at)[..., None])[:, :2, 0], -1.0, 1.0)
        return sine, np.maximum(np.sqrt(1.0 - sine**2), 1e-6), axes, changes

    def _up(self, at: Postures) -> Array:
        """Return the (N, 3) or (1, 3) vertical in the base."""
        return -at.gravities / np.maximum(np.linalg.norm(at.gravities, axis=1, keepdims=True), 1e-300)

    def predicted(self, at: Postures) -> Array:
        return np.arcsin(self._tilts(at)[0]) + at.of(self.name, "bias")

    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return (N, 2, 6): a turn about what is across axis and vertical tilts the axis."""
        _, cosine, axes, _ = self._tilts(at)
        turned = np.cross(axes.swapaxes(1, 2)[:, :2], self._up(at)[:, None]) / cosine[:, :, None]
        return {at.sensors[self.name].link: np.concatenate([np.zeros_like(turned), turned], axis=2)}

    def by_gravity(self, at: Postures) -> Array:
        sine, cosine, axes, _ = self._tilts(at)
        size = np.maximum(np.linalg.norm(at.gravities, axis=1), 1e-300)
        across = axes.swapaxes(1, 2)[:, :2] - sine[:, :, None] * self._up(at)[:, None]
        return -across / cosine[:, :, None] / size[:, None, None]

    def by_own(self, at: Postures) -> Array:
        _, cosine, axes, changes = self._tilts(at)
        up = (axes.swapaxes(1, 2) @ self._up(at)[..., None])[..., 0]  # the vertical in the level's axes
        mounting = (skew(up) @ changes)[:, :2] / cosine[:, :, None]
        return np.concatenate([mounting, np.broadcast_to(np.eye(2), (len(up), 2, 2))], axis=2)

    def readable(self, at: Postures) -> np.ndarray:
        return np.all(np.abs(self._tilts(at)[0]) < STEEPEST, axis=1)
