"""An instrument whose distances are wrong by the same share: lambda times the range."""

from dataclasses import replace

import numpy as np

from armflex.laws.effects.effect import Act, Amplitude, ChangeableModel, Effect, ModelLaw, Plausible, Words
from armflex.laws.effects.location import BASE, Location

PPM = 1e-6


def _change(effect: Effect, model: ChangeableModel) -> ChangeableModel:
    scale = model.instrument.scale + PPM * effect.values[0]
    return replace(model, instrument=replace(model.instrument, scale=scale))


TRACKER_SCALE = ModelLaw(
    name="tracker_scale",
    words=Words("instrument scale", "distances are read too long or too short", "λ · range"),
    instead="measure a scale bar or a second instrument's distance with the instrument",
    plausible=Plausible(0.0003, 1, "air 1 ppm/K, a scale bar of the wrong metal 25, photographs and drums 300 ppm"),
    places=lambda records: [Location(BASE)],
    amplitudes=(Amplitude("lambda", "ppm", usual=100.0),),
    act=Act.SCALE,
    made=lambda here, view, context: np.full((len(view.rows), 1, 1), PPM),
    changed=_change,
)
