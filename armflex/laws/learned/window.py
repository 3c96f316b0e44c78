"""Where a correction counts: at the loads that were seen, and not far beyond."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array

FADED = 2.0
"""Distance, as a multiple of the furthest load seen, from which on a correction is nothing."""

BREADTH = 0.05
"""Of the force's, and of the moment's largest component that is added to the scatter of all: a component that is small
changes with how the arm gives, and what was seen of it is not a hair's breadth wide."""


@dataclass(frozen=True, eq=False)
class Window:
    """1 where loads were seen, falling smoothly to 0 at `FADED` times as far.

    Attributes:
        mean: (6,) [N, Nm].
        precision: (6, 6) inverse of their scatter over the square of the furthest one's distance.
        loads: (2, 6) smallest and largest of each component [N, Nm].
    """

    mean: Array
    precision: Array
    loads: Array

    def distance(self, wrench: Array) -> Array:
        """Return the (...) distance of a (..., 6) wrench, 1 at the furthest that was seen."""
        off = wrench - self.mean
        return np.sqrt(((off @ self.precision) * off).sum(axis=-1))

    def __call__(self, wrench: Array) -> Array:
        """Return the (...) weight."""
        share = np.minimum(np.maximum((FADED - self.distance(wrench)) / (FADED - 1.0), 0.0), 1.0)
        return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)

    def slope(self, wrench: Array) -> Array:
        """Return its (..., 6) derivative by the wrench."""
        distance = self.distance(wrench)[..., None]
        if (distance <= 1.0).all():
            return np.zeros(np.shape(wrench))
        share = np.minimum(np.maximum((FADED - distance) / (FADED - 1.0), 0.0), 1.0)
        steep = -30.0 * share**2 * (1.0 - share) ** 2 / (FADED - 1.0)
        return steep * ((wrench - self.mean) @ self.precision) / np.maximum(distance, 1e-300)


def window_of(wrenches: Array) -> Window:
    """Return the window of (M, 6) loads that were seen."""
    mean, size = wrenches.mean(axis=0), np.sqrt((wrenches**2).mean(axis=0))
    breadth = BREADTH * _largest(size)
    precision = np.linalg.inv(np.cov(wrenches.T, ddof=0) + np.diag(breadth**2))
    window = Window(mean, precision, np.array([wrenches.min(axis=0), wrenches.max(axis=0)]))
    furthest = float(window.distance(wrenches).max())
    return Window(mean, precision / max(furthest, 1e-9) ** 2, window.loads)


def load_scale(wrenches: Array) -> Array:
    """Return the (6,) RMS of every component of (M, 6) loads, none below a tenth of its kind's largest."""
    size = np.sqrt((wrenches**2).mean(axis=0))
    return np.maximum(size, 0.1 * _largest(size))


def _largest(size: Array) -> Array:
    """Return the (6,) largest of the force's components, and of the moment's."""
    return np.repeat([max(size[:3].max(), 1e-6), max(size[3:].max(), 1e-6)], 3)
