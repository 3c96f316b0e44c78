"""A base that gives under the moment on it: C_b times the moment, the same about all axes or about one."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array
from armflex.effects.law import Amplitude, TwistLaw, Values
from armflex.effects.scene import AXES_TURN, Scene
from armflex.effects.shapes import at_base
from armflex.effects.spot import BASE, Here, Spot
from armflex.laws import Row


def _places(scene: Scene) -> list[Spot]:
    return [Spot(BASE, None), *at_base(AXES_TURN)]


def _basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    acting = np.abs(here.direction) if here.spot.axis else np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    return (wrench * acting)[..., None, :]


BASE_COMPLIANCE = TwistLaw("base_compliance", _places, (Amplitude("C", "rad/Nm", positive=True),), _basis, loaded=True)
