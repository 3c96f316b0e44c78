"""A base that moves as it warms: beta (T - Tref), along or about one axis, or any."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.effect import Amplitude, TwistLaw, Values, Words
from armflex.laws.effects.location import BASE, Here, Location
from armflex.laws.effects.scene import AXES, Records
from armflex.laws.effects.shapes import LAGGED, WARM, at_base, warmth, with_temperature


def _places(records: Records) -> list[Location]:
    return with_temperature(_of, records)


def _of(name: str) -> list[Location]:
    single = [Location(BASE, location.axis, (name,), (AXES.index(str(location.axis)),)) for location in at_base()]
    return single + [Location(BASE, None, (name,), terms) for terms in ((0, 1, 2), (3, 4, 5))]


def _basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    return np.asarray(warmth(here, row, *inner))[..., None, None] * np.eye(6)


BASE_THERMAL = TwistLaw(
    name="base_thermal",
    words=Words("thermal base motion", "the foundation follows the weather", "β (T − T₀)"),
    instead="measure a target on the base at two temperatures",
    places=_places,
    amplitudes=tuple(Amplitude(f"beta_{axis}", "m/K" if axis[0] == "d" else "rad/K") for axis in AXES),
    basis=_basis,
    inner=WARM,
    memory=LAGGED,
)
