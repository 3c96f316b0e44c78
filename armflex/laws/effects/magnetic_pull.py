"""A pull towards a point that falls with distance: F1 / (d^2 + reach^2), with a small reach F1 is that at one metre."""

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Amplitude, Effect, Inner, LoadLaw, Manipulator, Plausible, Search, Values, Words
from armflex.laws.effects.location import Here, Location
from armflex.laws.effects.shapes import coordinates, force_at, middle_of

NEAR = 0.5
"""Part of the diagonal of where an arm was, beyond which nothing pulls it towards a point."""


def _pull(here: Here, pose: Array, inner: Values | Array) -> Array:
    inner, lever = np.asarray(inner), pose[..., :3, :3] @ middle_of(here)
    way = inner[..., :3] - pose[..., :3, 3] - lever
    distance = np.sqrt((way * way).sum(axis=-1, keepdims=True))
    return force_at(way / np.maximum(distance, 1e-9) / np.maximum(distance**2 + inner[..., 3:] ** 2, 1e-6), lever)


def _within_reach(effect: Effect, context: Context, arm: Manipulator) -> bool:
    """Return whether the point in space that an effect's first three inner values are is near where the arm was.

    From further off than the arm reaches, a pull towards a point is one in a fixed direction.
    """
    beyond = np.clip(effect.inner[:3], *context.box) - effect.inner[:3]
    return float(np.linalg.norm(beyond)) <= NEAR * context.size


REACH = Inner("reach", "m", lambda location, context: (0.0, 0.15 * context.size), default=0.0)

MAGNETIC_PULL = LoadLaw(
    name="magnetic_pull",
    words=Words("magnetic pull", "a force towards a point that falls with distance", "F / (d² + reach²)"),
    instead="measure again with the field off",
    plausible=Plausible(0.35, 0.35, "what pulls as strongly as the arm weighs is known"),
    places=lambda records: [Location(link) for link in records.bodies],
    amplitudes=(Amplitude("F1", "N m^2", positive=True),),
    pull=_pull,
    inner=(*coordinates("point", 4), REACH),
    possible=_within_reach,
    search=Search.SPACE,
)
