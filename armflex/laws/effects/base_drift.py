"""A base (or an instrument) that drifts: v t, along or about one axis, or any."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.effect import Amplitude, TwistLaw, Values, Words
from armflex.laws.effects.location import BASE, Here, Location
from armflex.laws.effects.scene import AXES, Records
from armflex.laws.effects.shapes import ON_THE_FLOOR, at_base


def _places(records: Records) -> list[Location]:
    if not records.timed:
        return []
    single = [Location(BASE, location.axis, ("time",), (AXES.index(str(location.axis)),)) for location in at_base()]
    return single + [Location(BASE, None, ("time",), terms) for terms in ((0, 1, 2), (3, 4, 5))]


def _basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    return np.asarray(row.covariate("time"))[..., None, None] * np.eye(6)


BASE_DRIFT = TwistLaw(
    name="base_drift",
    words=Words("base drift", "the foundation or the instrument wanders with time", "v · t"),
    instead=ON_THE_FLOOR,
    places=_places,
    amplitudes=tuple(Amplitude(f"v_{axis}", "m/s" if axis[0] == "d" else "rad/s") for axis in AXES),
    basis=_basis,
    timed=True,
)
