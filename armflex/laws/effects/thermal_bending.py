"""A link that bends as it warms: beta (T - Tref), a rotation of its end about a point of it.

A bend at its root turns it about its root, an even one about its middle.
"""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.law import Along, Amplitude, Inner, TwistLaw, Values
from armflex.laws.effects.scene import AXES_TURN
from armflex.laws.effects.shapes import LAGGED, WARM, at_links, warmth, with_temperature
from armflex.laws.effects.spot import Here


def _direction(here: Here, inner: Values) -> Array:
    turn = here.direction[3:]
    return np.concatenate([np.cross(turn, (1.0 - inner[0]) * here.length), turn])


THERMAL_BENDING = TwistLaw(
    "thermal_bending",
    lambda scene: with_temperature(lambda name: at_links(scene, AXES_TURN, name), scene),
    (Amplitude("beta", "rad/K"),),
    Along(lambda here, wrench, row, inner: (warmth(here, row, *inner[1:]),), _direction),
    (Inner("along", "1", lambda spot, scene: (1.0, 0.5, 0.0), polished=False, usual=1.0), *WARM),
    memory=LAGGED,
)
