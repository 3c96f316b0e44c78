"""An arm and the instrument that looks at it: everything that measurements depend on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pinocchio as pin

from armflex.arm import Arm
from armflex.laws.effects.effect import Effect, Model
from armflex.readings.instrument import Instrument


@dataclass(frozen=True)
class Setup:
    """An arm and the instrument that looks at it: everything a fit may move."""

    arm: Arm
    instrument: Instrument

    def placed(self, pose: pin.SE3) -> Setup:
        """Return the setup with its instrument at another T_instrument_base [m].

        `Robot.gravity` is in base axes. Where gravity is known in the frame of a level instrument it follows that: it
        is turned by what the pose turns, whatever place it was turned to before.
        """
        arm, robot = self.arm, self.arm.robot
        if arm.measurement.gravity_in == "measurement":
            level = self.instrument.pose.rotation @ robot.gravity
            arm = replace(arm, robot=replace(robot, gravity=pose.rotation.T @ level))
        return Setup(arm, replace(self.instrument, pose=pose))

    def with_effect(self, effect: Effect) -> Setup:
        """Return the setup with one more effect in it, and with what the effect changes of the model."""
        arm = self.arm
        model = effect.law.change(effect, Model(arm.robot, arm.corrections, arm.payloads, self.instrument))
        parts = {name: getattr(model, name) for name in ("robot", "corrections", "payloads")}
        return Setup(replace(arm, effects=(*arm.effects, effect), **parts), model.instrument)
