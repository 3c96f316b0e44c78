"""A link that bends as it warms: beta (T - Tref), a rotation of its end about a point of it.

An even bend turns its end about its middle. One at its root is one at the end of the link before.
"""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import AXES_TURN
from armflex.laws.effects.effect import Along, Amplitude, Inner, Plausible, TwistLaw, Values, Words
from armflex.laws.effects.location import Here, Location
from armflex.laws.effects.shapes import LAGGED, ON_THE_LINK, WARM, twists, warm, warmth


def _direction(here: Here, inner: Values) -> Array:
    (x, y, z), (u, v, w) = here.direction[3:].tolist(), ((1.0 - inner[0]) * here.length).tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u, x, y, z])  # numpy takes its time to cross two vectors


THERMAL_BENDING = TwistLaw(
    name="thermal_bending",
    words=Words("thermal bending", "the link bends as it warms", "β (T − T₀)"),
    instead=f"{ON_THE_LINK} at two temperatures",
    plausible=Plausible(0.003, 0.005, "one side warmer by 10 K bends a metre of steel by 1 mrad"),
    places=lambda records: [
        Location(link, axis, (name,)) for name in records.temperatures for link in records.links for axis in AXES_TURN
    ],
    amplitudes=(Amplitude("beta", "rad/K"),),
    terms=lambda here, inner: twists(_direction(here, inner), warm(here, *inner[1:])),
    basis=Along(lambda here, wrench, row, inner: (warmth(here, row, *inner[1:]),), _direction),
    inner=(
        Inner("along", "1", lambda location, context: (1.0, 0.5), polished=False, usual=1.0, default=1.0),
        *WARM,
    ),
    memory=LAGGED,
)
