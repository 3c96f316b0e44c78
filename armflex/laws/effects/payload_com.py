"""A payload whose centre of mass is elsewhere than declared, in the tip frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.law import Amplitude, Effect, Inner, Values
from armflex.laws.effects.payloads import loaded_names, tip_wrenches
from armflex.laws.effects.scene import Scene
from armflex.laws.effects.spot import TOOL, Spot

if TYPE_CHECKING:
    from armflex.estimate.view import Setup, View


@dataclass(frozen=True)
class PayloadCom:
    """A shift of the centre of mass of one payload, or of all."""

    name: str = "payload_com"
    amplitudes: tuple[Amplitude, ...] = tuple(Amplitude(axis, "m", most=1.0) for axis in ("dx", "dy", "dz"))
    inner: tuple[Inner, ...] = ()

    def spots(self, scene: Scene) -> Iterable[Spot]:
        """Return each direction and any, for all payloads together and each by itself."""
        choices = (("dx", (0,)), ("dy", (1,)), ("dz", (2,)), (None, (0, 1, 2)))
        return [Spot(TOOL, axis, (), terms, name) for name in loaded_names(scene) for axis, terms in choices]

    def columns(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return (M, d, k) changes of the readings."""
        arm = view.setup.arm
        names = [scene.payloads[row] for row in view.rows]
        mass = np.array([arm.payload(name).mass * (spot.partner in ("", name)) for name in names])
        rotation = view.line.tip[:, :3, :3].transpose(0, 2, 1)
        moments = np.cross(rotation, arm.robot.gravity) * mass[:, None, None]
        wrenches = np.concatenate([np.zeros_like(moments), moments], axis=2)[:, list(spot.terms)]
        return tip_wrenches(view, wrenches.transpose(0, 2, 1))

    def apply(self, effect: Effect, setup: Setup) -> Setup:
        """Return the setup with the payloads' centres corrected."""
        shift = np.array(effect.amplitudes)
        changed = {
            name: replace(payload, com=payload.com + shift) if effect.spot.partner in ("", name) else payload
            for name, payload in setup.arm.payloads.items()
        }
        return replace(setup, arm=replace(setup.arm, payloads=changed)).with_effect(effect)


PAYLOAD_COM = PayloadCom()
