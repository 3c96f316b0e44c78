"""The instrument was set up again: a frame of its own for one session, beyond what its prior allows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.law import Amplitude, Effect, Inner, Values
from armflex.laws.effects.scene import Scene
from armflex.laws.effects.spot import BASE, Spot

if TYPE_CHECKING:
    from armflex.estimate.view import Setup, View


@dataclass(frozen=True)
class SessionFrame:
    """Shift and rotation vector of the instrument frame in the session that the spot's partner names."""

    name: str = "session_frame"
    amplitudes: tuple[Amplitude, ...] = tuple(
        Amplitude(axis, "m" if axis[0] == "d" else "rad") for axis in ("dx", "dy", "dz", "rx", "ry", "rz")
    )
    inner: tuple[Inner, ...] = ()

    def spots(self, scene: Scene) -> Iterable[Spot]:
        """Return every session where there are several: a shift, or a shift and a turn."""
        sessions = dict.fromkeys(scene.sessions)
        choices = ((0, 1, 2), tuple(range(6)))
        return [Spot(BASE, terms=terms, partner=name) for name in sessions for terms in choices if len(sessions) > 1]

    def columns(self, spot: Spot, inner: Values, view: View, scene: Scene) -> Array:
        """Return (M, d, k) changes of the readings."""
        own = np.array([scene.sessions[row] == spot.partner for row in view.rows])
        return (view.by_frame * own[:, None, None])[:, :, list(spot.terms)]

    def apply(self, effect: Effect, setup: Setup) -> Setup:
        """Return the setup with the session's frame moved."""
        sessions, name = setup.instrument.sessions, effect.spot.partner
        moved = {**sessions, name: sessions.get(name, np.zeros(6)) + np.array(effect.values)}
        return replace(setup, instrument=replace(setup.instrument, sessions=moved)).with_effect(effect)


SESSION_FRAME = SessionFrame()
