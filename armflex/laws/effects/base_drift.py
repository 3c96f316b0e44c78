"""A base (or an instrument) that drifts: v t, along or about one axis, or any."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.law import Amplitude, TwistLaw, Values
from armflex.laws.effects.scene import AXES, Scene
from armflex.laws.effects.shapes import at_base
from armflex.laws.effects.spot import BASE, Here, Spot


def _places(scene: Scene) -> list[Spot]:
    if not scene.timed:
        return []
    single = [Spot(BASE, spot.axis, ("time",), (AXES.index(str(spot.axis)),)) for spot in at_base()]
    return single + [Spot(BASE, None, ("time",), terms) for terms in ((0, 1, 2), (3, 4, 5))]


def _basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    return np.asarray(row.covariate("time"))[..., None, None] * np.eye(6)


BASE_DRIFT = TwistLaw(
    "base_drift",
    _places,
    tuple(Amplitude(f"v_{axis}", "m/s" if axis[0] == "d" else "rad/s") for axis in AXES),
    _basis,
)
