"""A payload that is heavier than declared: one of them, each by the same mass, or all by the same share.

By the same share, the kilograms are those of the heaviest.
"""

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


EACH = "each"
"""Partner of a spot whose mass is added to every payload that weighs."""


@dataclass(frozen=True)
class PayloadMass:
    """Extra mass at the declared centre of mass."""

    name: str = "payload_mass"
    amplitudes: tuple[Amplitude, ...] = (Amplitude("mass", "kg"),)
    inner: tuple[Inner, ...] = ()

    def spots(self, scene: Scene) -> Iterable[Spot]:
        """Return all payloads together and, where there are several, each by itself."""
        names = loaded_names(scene)
        return [Spot(TOOL, partner=name) for name in ((*names, EACH) if len(names) > 1 else names)]

    def columns(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return (M, d, 1) changes of the readings."""
        arm, gravity = view.setup.arm, view.setup.arm.robot.gravity
        shares = _shares(spot, {name: arm.payload(name).mass for name in set(scene.payloads)})
        share = np.array([shares.get(scene.payloads[row], 0.0) for row in view.rows])
        lever = np.array([arm.payload(scene.payloads[row]).com for row in view.rows])
        moment = np.cross(np.einsum("nij,nj->ni", view.line.tip[:, :3, :3], lever), gravity)
        wrench = np.concatenate([np.broadcast_to(gravity, moment.shape), moment], axis=1) * share[:, None]
        return tip_wrenches(view, wrench[:, :, None])

    def apply(self, effect: Effect, setup: Setup) -> Setup:
        """Return the setup with the payloads' masses corrected."""
        payloads = setup.arm.payloads
        shares = _shares(effect.spot, {name: payload.mass for name, payload in payloads.items()})
        changed = {
            name: replace(payload, mass=max(payload.mass + shares.get(name, 0.0) * effect.values[0], 0.0))
            for name, payload in payloads.items()
        }
        return replace(setup, arm=replace(setup.arm, payloads=changed)).with_effect(effect)


def _shares(spot: Spot, masses: dict[str, float]) -> dict[str, float]:
    """Return what part of the extra mass each payload has."""
    if spot.partner == EACH:
        return {name: 1.0 for name, mass in masses.items() if mass > 0.0}
    if spot.partner:
        return {spot.partner: 1.0}
    heaviest = max(masses.values(), default=0.0) or 1.0
    return {name: mass / heaviest for name, mass in masses.items()}


PAYLOAD_MASS = PayloadMass()
