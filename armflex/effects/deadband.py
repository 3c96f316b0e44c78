"""Deadband: play that the load takes up, g clip(tau / tau0, -1, 1), on one axis or about several at once."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from armflex.conventions import Array
from armflex.effects.law import Amplitude, Inner, TwistLaw, Values
from armflex.effects.scene import AXES, AXES_TURN, Scene
from armflex.effects.shapes import TURNS, along, at_joints
from armflex.effects.spot import Here, Spot
from armflex.laws import Row


def _places(scene: Scene) -> list[Spot]:
    several = [Spot(joint, terms=tuple(1 + i for i in turns)) for joint in scene.joints for turns in TURNS]
    return [*at_joints(scene), *several]


def _loads(spot: Spot, scene: Scene) -> Iterable[float]:
    wrench = scene.wrenches[spot.site]
    load = wrench[:, AXES.index(spot.axis)] if spot.axis else wrench[:, [2 + term for term in spot.terms]]
    return max(float(np.abs(load).max()), 1e-9) * np.array([0.03, 0.1, 0.2, 0.4, 0.7])


def _basis(here: Here, wrench: Array, row: Row, inner: Values) -> Array:
    single = np.clip(along(here, wrench) / inner[0], -1.0, 1.0)[..., None, None] * here.direction
    turning = np.clip(wrench / inner[0], -1.0, 1.0)[..., None, :] * np.eye(6)[3:]
    return np.concatenate([single, turning], axis=-2)


DEADBAND = TwistLaw(
    "deadband",
    _places,
    (Amplitude("g", "{m}", positive=True), *(Amplitude(f"g_{axis}", "rad", positive=True) for axis in AXES_TURN)),
    _basis,
    (Inner("tau0", "{w}", _loads),),
    loaded=True,
)
