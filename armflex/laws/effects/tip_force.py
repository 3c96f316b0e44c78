"""A constant force from outside on the tool, in base axes."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.effect import Amplitude, LoadLaw, Values, Words
from armflex.laws.effects.location import TOOL, Here, Location
from armflex.laws.effects.scene import Records


def _places(records: Records) -> list[Location]:
    single = [Location(TOOL, axis, terms=(i,)) for i, axis in enumerate(("dx", "dy", "dz"))]
    return [*single, Location(TOOL, None, terms=(0, 1, 2))]


def _pull(here: Here, pose: Array, inner: Values) -> Array:
    return np.broadcast_to(np.eye(3, 6), (*pose.shape[:-2], 3, 6))


TIP_FORCE = LoadLaw(
    name="tip_force",
    words=Words("tip force", "something pulls at the tip", "constant force"),
    instead="measure again with whatever pulls on the tool taken off",
    places=_places,
    amplitudes=tuple(Amplitude(f"f{axis}", "N") for axis in "xyz"),
    pull=_pull,
)
