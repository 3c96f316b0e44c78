"""An instrument whose distances are wrong by the same share: lambda times the range."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from armflex.conventions import Array
from armflex.laws.effects.law import Amplitude, Effect, Inner, Values
from armflex.laws.effects.scene import Scene
from armflex.laws.effects.spot import BASE, Spot

if TYPE_CHECKING:
    from armflex.estimate.view import Setup, View


@dataclass(frozen=True)
class TrackerScale:
    """Readings are 1 + 1e-6 lambda times as far away."""

    name: str = "tracker_scale"
    amplitudes: tuple[Amplitude, ...] = (Amplitude("lambda", "ppm"),)
    inner: tuple[Inner, ...] = ()

    def spots(self, scene: Scene) -> Iterable[Spot]:
        """Return the instrument."""
        return [Spot(BASE)]

    def columns(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return (M, d, 1) changes of the readings."""
        return 1e-6 * view.by_scale[:, :, None]

    def apply(self, effect: Effect, setup: Setup) -> Setup:
        """Return the setup with the instrument's scale corrected."""
        scale = setup.instrument.scale + 1e-6 * effect.values[0]
        return replace(setup, instrument=replace(setup.instrument, scale=scale)).with_effect(effect)


TRACKER_SCALE = TrackerScale()
