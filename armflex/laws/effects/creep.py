"""Creep under load: c tau log(1 + h / t0), h the time that the load has stood."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from armflex.laws.effects.effect import Amplitude, Inner, TwistLaw, Words
from armflex.laws.effects.location import Location
from armflex.laws.effects.scene import Records, Scene
from armflex.laws.effects.shapes import along, at_joints, on_axis


def _places(records: Records) -> list[Location]:
    return at_joints(records, covariate="hold") if "hold" in records.recorded else []


def _times(location: Location, scene: Scene) -> Iterable[float]:
    longest = float(scene.column("hold").max())
    return longest * np.array([0.01, 0.05, 0.2, 1.0])


CREEP = TwistLaw(
    name="creep",
    words=Words("creep", "the joint goes on giving while the load stands", "c τ log(1 + h / t₀)"),
    instead="hold the heaviest payload for an hour and the empty arm as well",
    places=_places,
    amplitudes=(Amplitude("c", "{m}/{w}"),),
    basis=on_axis(
        lambda here, wrench, row, inner: (
            along(here, wrench) * np.log1p(np.maximum(row.covariate("hold"), 0.0) / inner[0]),
        )
    ),
    inner=(Inner("t0", "s", _times),),
    loaded=True,
    linear=True,
)
