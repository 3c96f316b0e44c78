"""Gravity does not point where the frame says: turned about base x and y."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.laws.effects.law import Amplitude, Effect, Inner, Values
from armflex.laws.effects.scene import Scene
from armflex.laws.effects.spot import BASE, Spot

if TYPE_CHECKING:
    from armflex.estimate.view import Setup, View


@dataclass(frozen=True)
class GravityTilt:
    """A small rotation of gravity in the base."""

    name: str = "gravity_tilt"
    amplitudes: tuple[Amplitude, ...] = (Amplitude("rx", "rad", most=0.1), Amplitude("ry", "rad", most=0.1))
    inner: tuple[Inner, ...] = ()

    def spots(self, scene: Scene) -> Iterable[Spot]:
        """Return either axis, and both."""
        return [Spot(BASE, "rx", terms=(0,)), Spot(BASE, "ry", terms=(1,)), Spot(BASE, terms=(0, 1))]

    def columns(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return (M, d, k) changes of the readings."""
        turned = np.cross(np.eye(3)[:2], view.setup.arm.robot.gravity)[list(spot.terms)]
        return view.answer(view.line.gravity @ turned.T)

    def apply(self, effect: Effect, setup: Setup) -> Setup:
        """Return the setup with gravity turned."""
        rotation = pin.exp3(np.array([*effect.values, 0.0]))
        robot = replace(setup.arm.robot, gravity=rotation @ setup.arm.robot.gravity)
        return replace(setup, arm=replace(setup.arm, robot=robot)).with_effect(effect)


GRAVITY_TILT = GravityTilt()
