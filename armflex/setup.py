"""An arm and the instrument that looks at it: everything that measurements depend on."""

from __future__ import annotations

from dataclasses import dataclass, replace

from armflex.arm import Arm
from armflex.laws.effects.effect import Effect, Model
from armflex.readings.instrument import Instrument


@dataclass(frozen=True)
class Setup:
    """An arm and the instrument that looks at it: everything a fit may move."""

    arm: Arm
    instrument: Instrument

    def with_effect(self, effect: Effect) -> Setup:
        """Return the setup with one more effect in it, and with what the effect changes of the model."""
        arm = self.arm
        model = effect.law.change(effect, Model(arm.robot, arm.corrections, arm.payloads, self.instrument))
        parts = {name: getattr(model, name) for name in ("robot", "corrections", "payloads")}
        return Setup(replace(arm, effects=(*arm.effects, effect), **parts), model.instrument)
