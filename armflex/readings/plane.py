"""A plane near a declared one: tilted a little about axes across its normal."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armflex.conventions import Array


@dataclass(frozen=True, eq=False)
class Plane:
    """Where a plane is declared to face: its (3,) normal in the base, of any length but none."""

    normal: Array

    @cached_property
    def axes(self) -> Array:
        """(3, 3) axes of it in the base by columns, the last its declared unit normal."""
        normal = np.asarray(self.normal, dtype=float) / np.linalg.norm(self.normal)
        first = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
        first = first / np.linalg.norm(first)
        return np.column_stack([first, np.cross(normal, first), normal])

    def tilted(self, tilt: Array) -> tuple[Array, Array]:
        """Return the (..., 3) unit normals at (..., 2) slopes along the first axes, and their (..., 3, 2) change."""
        across = self.axes[:, :2]
        normal = self.axes[:, 2] + tilt @ across.T
        size = np.linalg.norm(normal, axis=-1, keepdims=True)
        normal = normal / size
        return normal, (across - normal[..., None] * (normal @ across)[..., None, :]) / size[..., None]
