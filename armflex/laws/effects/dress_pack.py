"""A dress pack that pulls at a joint: the declared compliance times k (q - q0); q0 is an encoder offset."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.law import Amplitude, TwistLaw, Values
from armflex.laws.effects.scene import Scene
from armflex.laws.effects.shapes import at_drives, own_position
from armflex.laws.effects.spot import Here, Spot


def _places(scene: Scene) -> list[Spot]:
    return at_drives(scene, "q_{joint}")


def _basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    if here.base_law is None:
        return np.zeros((*wrench.shape[:-1], 1, 6))
    given = here.base_law.tangent(wrench, row) @ here.drive
    return (own_position(here, row)[..., None] * given)[..., None, :]


DRESS_PACK = TwistLaw("dress_pack", _places, (Amplitude("k", "{w}/{m}"),), _basis)
