"""A dress pack that pulls at a joint: the declared compliance times k (q - q0); q0 is an encoder offset."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.effect import Amplitude, Plausible, TwistLaw, Values, Words
from armflex.laws.effects.location import Here
from armflex.laws.effects.shapes import at_drives, own_position


def _basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    if here.base_law is None:
        return np.zeros((*wrench.shape[:-1], 1, 6))
    given = here.base_law.tangent(wrench, row) @ here.drive
    return (own_position(here, row)[..., None] * given)[..., None, :]


DRESS_PACK = TwistLaw(
    name="dress_pack",
    words=Words("dress pack pull", "cables turn the joint as it moves", "C · k (q − q₀)"),
    instead="repeat a few poses with the dress pack untied",
    plausible=Plausible(0.002, 0.005, "hoses pull with 10 to 200 Nm"),
    places=lambda records: at_drives(records, "q_{joint}"),
    amplitudes=(Amplitude("k", "{w}/{m}"),),
    basis=_basis,
)
