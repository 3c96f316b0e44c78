"""A pull towards a point that falls with distance: F1 / (d^2 + reach^2), with a small reach F1 is that at one metre."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.effect import Amplitude, Inner, LoadLaw, Plausible, Values, Words
from armflex.laws.effects.location import Here, Location
from armflex.laws.effects.shapes import coordinates, force_at, middle_of, within_reach


def _pull(here: Here, pose: Array, inner: Values) -> Array:
    lever = pose[..., :3, :3] @ middle_of(here)
    way = np.array(inner[:3]) - pose[..., :3, 3] - lever
    distance = np.sqrt((way * way).sum(axis=-1, keepdims=True))
    return force_at(way / np.maximum(distance, 1e-9) / np.maximum(distance**2 + inner[3] ** 2, 1e-6), lever)


REACH = Inner("reach", "m", lambda location, context: (0.0, 0.15 * context.size), default=0.0)

MAGNETIC_PULL = LoadLaw(
    name="magnetic_pull",
    words=Words("magnetic pull", "a force towards a point that falls with distance", "F / (d² + reach²)"),
    instead="measure again with the field off",
    plausible=Plausible(0.35, 0.35, "what pulls as strongly as the arm weighs is known"),
    places=lambda records: [Location(link) for link in records.links],
    amplitudes=(Amplitude("F1", "N m^2", positive=True),),
    pull=_pull,
    inner=(*coordinates("point", 4), REACH),
    possible=within_reach,
    spatial=True,
)
