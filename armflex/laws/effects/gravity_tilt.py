"""Gravity does not point where the frame says: turned about base x and y."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Act, Amplitude, ChangeableModel, Effect, ModelLaw, Plausible, Solved, Words
from armflex.laws.effects.location import BASE, Here
from armflex.laws.effects.shapes import singly_and_together


def _turned(here: Here, view: Solved, context: Context) -> Array:
    return view.gravity(np.cross(np.eye(3)[:2], view.arm.robot.gravity))


def _change(effect: Effect, model: ChangeableModel) -> ChangeableModel:
    rotation = pin.exp3(np.array([*effect.values, 0.0]))
    return replace(model, robot=replace(model.robot, gravity=rotation @ model.robot.gravity))


GRAVITY_TILT = ModelLaw(
    name="gravity_tilt",
    words=Words("gravity tilt", "the direction of gravity differs from the declared one", "rotation of gravity"),
    instead="measure a plumb line in the base frame",
    level="put an inclinometer on the base",
    plausible=Plausible(1, 0.05, "a floor that leans by more is repaired"),
    places=lambda records: singly_and_together((BASE,), (0, 1), axes=("rx", "ry")),
    amplitudes=(Amplitude("rx", "rad", most=0.1, usual=0.01), Amplitude("ry", "rad", most=0.1, usual=0.01)),
    act=Act.GRAVITY,
    made=_turned,
    changed=_change,
)
