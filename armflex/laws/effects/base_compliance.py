"""A base that gives under the moment on it: C_b times the moment, the same about all axes, or each its own."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.context import AXES_TURN, Records
from armflex.laws.effects.effect import Amplitude, TwistLaw, Values, Words
from armflex.laws.effects.location import BASE, Here, Location


def _places(records: Records) -> list[Location]:
    single = [Location(BASE, axis, terms=(1 + i,)) for i, axis in enumerate(AXES_TURN)]
    return [Location(BASE), *single, Location(BASE, terms=(1, 2)), Location(BASE, terms=(1, 2, 3))]


def _basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    turns = wrench[..., None, :] * np.eye(6)[3:]
    return np.concatenate([turns.sum(axis=-2, keepdims=True), turns], axis=-2)


BASE_COMPLIANCE = TwistLaw(
    name="base_compliance",
    words=Words("base compliance", "the foundation tilts under the load", "C · w"),
    instead="measure a target on the base with and without load",
    places=_places,
    amplitudes=tuple(Amplitude(name, "rad/Nm", positive=True) for name in ("C", "C_rx", "C_ry", "C_rz")),
    basis=_basis,
    loaded=True,
    linear=True,
)
