"""Deadband: play that the load takes up, g clip(tau / tau0, -1, 1)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from armflex.effects.law import Amplitude, Inner, TwistLaw
from armflex.effects.scene import AXES, Scene
from armflex.effects.shapes import along, at_joints, on_axis
from armflex.effects.spot import Spot


def _loads(spot: Spot, scene: Scene) -> Iterable[float]:
    load = np.abs(scene.wrenches[spot.site][:, AXES.index(str(spot.axis))])
    return max(float(load.max()), 1e-9) * np.array([0.03, 0.1, 0.2, 0.4, 0.7])


DEADBAND = TwistLaw(
    "deadband",
    at_joints,
    (Amplitude("g", "{m}"),),
    lambda here, wrench, row, inner: on_axis(here, np.clip(along(here, wrench) / inner[0], -1.0, 1.0)),
    (Inner("tau0", "{w}", _loads),),
    loaded=True,
)
