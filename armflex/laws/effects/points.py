"""Points that load effects need: places in space to search from, and where on its link a load acts."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.effect import Inner
from armflex.laws.effects.location import TOOL, Here, Location
from armflex.laws.effects.scene import Scene


def coordinates(name: str, count: int) -> tuple[Inner, ...]:
    """Return the three coordinates of a point in base axes, searched from `count` values each."""

    def grid(axis: int) -> Inner:
        def values(location: Location, scene: Scene) -> Iterable[float]:
            low, high = scene.box[:, axis]
            return np.linspace(low - 0.2 * (high - low), high + 0.2 * (high - low), count)

        return Inner(f"{name}_{'xyz'[axis]}", "m", values, positive=False)

    return tuple(grid(axis) for axis in range(3))


def end_of(here: Here) -> Array:
    """Return the (3,) end of the location's link in the link's frame: its end joint's origin, the tip for the last."""
    if here.location.site == TOOL or here.joint is None:
        return np.zeros(3)
    return here.joint.origin


def middle_of(here: Here) -> Array:
    """Return the (3,) centre of mass of the location's link in its frame; the tip for the last."""
    if here.location.site == TOOL or here.joint is None:
        return np.zeros(3)
    inertial = here.robot.urdf.links[here.joint.parent].inertial
    return np.zeros(3) if inertial is None else inertial.origin


def force_at(force: Array, lever: Array) -> Array:
    """Return the (..., 1, 6) wrench at a link's origin of a force that acts at a lever from it, base axes."""
    return np.concatenate([force, cross(lever, force)], axis=-1)[..., None, :]


def cross(one: Array, other: Array) -> Array:
    """Return (..., 3) cross products; for single vectors a quarter of numpy's time."""
    (a, b, c), (x, y, z) = ([part[..., i] for i in range(3)] for part in (one, other))
    first = np.asarray(b * z - c * y)
    found = np.empty((*first.shape, 3))
    found[..., 0], found[..., 1], found[..., 2] = first, c * x - a * z, a * y - b * x
    return found
