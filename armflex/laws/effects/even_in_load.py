"""A twist that is the same way whichever way the load points: c |w_perp|, or c tau^2."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.law import Amplitude, TwistLaw, Values
from armflex.laws.effects.shapes import along, at_joints, on_axis
from armflex.laws.effects.spot import Here, with_terms


def _shapes(here: Here, wrench: Array, row: Row, inner: Values) -> tuple[Array, ...]:
    across = wrench * (1.0 - here.direction)
    force, moment = np.linalg.norm(across[..., :3], axis=-1), np.linalg.norm(across[..., 3:], axis=-1)
    return force, moment, along(here, wrench) ** 2


EVEN_IN_LOAD = TwistLaw(
    "even_in_load",
    lambda scene: with_terms(at_joints(scene), (0,), (1,), (2,)),
    (Amplitude("c_force", "{m}/N"), Amplitude("c_moment", "{m}/Nm"), Amplitude("c_square", "{m}/{w}^2")),
    on_axis(_shapes),
    loaded=True,
)
