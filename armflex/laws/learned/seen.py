"""The loads that a law was learned under: where a correction counts.

Beyond them it stays as it was there, and slowly fades.
"""

from dataclasses import dataclass, replace

import numpy as np

from armflex.conventions import Array
from armflex.laws.law import Law, Row

OVER = 1.0
"""Furthest that a correction is carried on beyond the observed loads, as a distance: no polynomial runs away."""

UNKNOWN = 2.0
"""Distance from which on nothing is known of a correction any more, whatever is left of it."""


STEEPEST = 1.875
"""Largest slope of the smooth step from 1 to 0 over a unit of distance."""

BREADTH = 0.05
"""Of the force's, and of the moment's largest component that is added to the scatter of all: a component that is small
changes with how the arm gives, and what was seen of it is not a hair's breadth wide."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Loads that a campaign put on a flexure, an ellipsoid; distances are multiples of the furthest one's.

    Fading has a reach of its own, see `energy`: distance counts a hair in a direction that was hardly loaded for as
    much as all of the load in another, and to fade that fast would take more than a stiff axis gives.

    Attributes:
        mean: (6,) [N, Nm].
        precision: (6, 6) inverse of their scatter over the square of the furthest one's distance, zero for components
            that do not count.
        loads: (2, 6) smallest and largest of each component [N, Nm].
        load_scale: (6,) RMS loads [N, Nm], none below a tenth of its kind's largest.
        twist_scale: (6,) RMS twists of the declared law under them [m, rad].
        faded: Reach from which on a correction is nothing, infinite where it never fades.
        energy: (6, 6) matrix whose quadratic form is the square of the reach: the root of what energy a load puts into
            the joint, over the most that one within the ellipsoid does; distance is the reach where it is None.
    """

    mean: Array
    precision: Array
    loads: Array
    load_scale: Array
    twist_scale: Array
    faded: float = np.inf
    energy: Array | None = None

    def distance(self, wrench: Array) -> Array:
        """Return the (...) distance of a (..., 6) wrench, 1 at the furthest that was seen."""
        off = wrench - self.mean
        return np.sqrt(((off @ self.precision) * off).sum(axis=-1))

    def sees(self, wrench: Array) -> bool:
        """Return whether all of (..., 6) wrenches are no further than those seen."""
        if wrench.ndim > 1:
            return bool((self.distance(wrench) <= 1.0).all())
        off = wrench - self.mean
        return bool(off @ self.precision @ off <= 1.0)

    def outreach(self, wrench: Array) -> Array:
        """Return the (...) reach of a (..., 6) wrench that fading depends on: 1 or less at all that were observed."""
        off = wrench - self.mean
        return np.sqrt(((off @ self._form) * off).sum(axis=-1))

    def weight(self, wrench: Array) -> Array:
        """Return (...) what is left of a correction: 1 at loads that were seen, 0 from `faded` on."""
        return _smooth(self._share(self.outreach(wrench)))

    def slope(self, wrench: Array) -> Array:
        """Return the (..., 6) derivative of `weight` by the wrench."""
        reach = self.outreach(wrench)[..., None]
        share = self._share(reach)
        steep = -30.0 * share**2 * (1.0 - share) ** 2 / (self.faded - 1.0)
        return steep * ((wrench - self.mean) @ self._form) / np.maximum(reach, 1e-300)

    def drawn_in(self, wrench: Array) -> Array:
        """Return the (..., 6) load at which a correction is asked: the same where it was seen, else little beyond."""
        distance = self.distance(wrench)[..., None]
        beyond = self.mean + self._carried(distance)[0] / np.maximum(distance, 1e-300) * (wrench - self.mean)
        return np.where(distance <= 1.0, wrench, beyond)  # to the last bit, whatever the other rows are

    def drawing_in(self, wrench: Array) -> Array:
        """Return the (..., 6, 6) derivative of `drawn_in` by the wrench."""
        off, distance = wrench - self.mean, np.maximum(self.distance(wrench), 1e-300)[..., None, None]
        length, slope = self._carried(distance)
        share = length / distance
        along = off[..., :, None] * (off @ self.precision)[..., None, :]
        return share * np.eye(6) + (slope - share) / distance**2 * along

    def directions(self, wrenches: Array) -> Array:
        """Return (N, 6) directions off the mean: those of (M, 6) loads, and all round, many of them drawn."""
        size, axes = np.linalg.eigh(self.precision)
        axes = axes[:, size > 0.0].T / np.sqrt(size[size > 0.0])[:, None]
        # Directions that are drawn where all are meant
        drawn = np.random.default_rng(0).normal(size=(4000, len(axes))) @ axes
        return np.concatenate([wrenches - self.mean, axes, -axes, drawn])

    def furthest(self, off: Array) -> Array:
        """Return (M, 6) loads in (M, 6) directions off the mean, as far out as a correction is carried."""
        length = self.distance(self.mean + off)[:, None]
        return self.mean + (1.0 + OVER) * off / np.where(length > 0.0, length, 1.0)

    def unknown(self, wrench: Array) -> Array:
        """Return the (...) flag about a correction in parts of how large it may be: none at loads that were seen.

        It grows with the load, as a correction would that went on.
        """
        distance = self.distance(wrench)
        return (1.0 - _smooth(np.clip((UNKNOWN - distance) / (UNKNOWN - 1.0), 0.0, 1.0))) * distance

    def _carried(self, distance: Array) -> tuple[Array, Array]:
        """Return how far out a correction is asked at a distance, and the slope of it."""
        bend = np.tanh(np.maximum(distance - 1.0, 0.0) / OVER)
        return np.minimum(distance, 1.0) + OVER * bend, 1.0 - bend**2

    @property
    def _form(self) -> Array:
        return self.precision if self.energy is None else self.energy

    def _share(self, reach: Array) -> Array:
        """Return 1 to 0 for reaches from 1 to `faded`."""
        if np.isinf(self.faded):
            return np.ones_like(reach)
        return np.clip((self.faded - reach) / (self.faded - 1.0), 0.0, 1.0)


def _smooth(share: Array) -> Array:
    """Return 0 to 1 for 0 to 1, both ends flat and without curvature."""
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def seen_in(law: Law, wrenches: Array, row: Row) -> Seen:
    """Return what (M, 6) loads are to a law in M rows; loads of axes in which it does not give do not count."""
    twists = np.sqrt((law.twist(wrenches, row) ** 2).mean(axis=0))
    mean, size = wrenches.mean(axis=0), np.sqrt((wrenches**2).mean(axis=0))
    largest = np.repeat([max(size[:3].max(), 1e-6), max(size[3:].max(), 1e-6)], 3)  # of the force, and of the moment
    scatter = np.cov(wrenches.T, ddof=0) + np.diag((BREADTH * largest) ** 2)
    precision, block = np.zeros((6, 6)), np.ix_(*2 * [np.flatnonzero(twists > 0.0)])
    precision[block] = np.linalg.inv(scatter[block])
    loads = np.array([wrenches.min(axis=0), wrenches.max(axis=0)])
    seen = Seen(mean, precision, loads, np.maximum(size, 0.1 * largest), twists)
    return replace(seen, precision=precision / max(float(seen.distance(wrenches).max()), 1e-9) ** 2)
