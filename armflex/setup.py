"""An arm and the instrument that looks at it: everything that measurements depend on."""

from __future__ import annotations

from dataclasses import dataclass, replace

from armflex.arm import Arm
from armflex.laws.effects.law import Effect
from armflex.readings.instrument import Instrument


@dataclass(frozen=True)
class Setup:
    """An arm and the instrument that looks at it: everything a fit may move."""

    arm: Arm
    instrument: Instrument

    def with_effect(self, effect: Effect) -> Setup:
        """Return the setup with an effect added to its arm's list."""
        return replace(self, arm=replace(self.arm, effects=(*self.arm.effects, effect)))
