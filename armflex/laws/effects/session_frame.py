"""The instrument was set up again: a frame of its own for one session, beyond what its prior allows.

Its values are shift and rotation vector of the instrument's frame in the session that the location's partner names: a
point that would be read as p there is read as exp(w) p + t.
"""

from dataclasses import replace

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import AXES, Context, Records
from armflex.laws.effects.effect import (
    Act,
    Afterwards,
    Amplitude,
    ChangeableModel,
    Effect,
    ModelLaw,
    Plausible,
    Solved,
    Words,
)
from armflex.laws.effects.location import BASE, Here, Location
from armflex.laws.effects.shapes import ON_THE_FLOOR


def _places(records: Records) -> list[Location]:
    """Return every session where there are several: a shift, or a shift and a turn."""
    sessions = records.sessions if len(records.sessions) > 1 else ()
    return [Location(BASE, terms=terms, partner=name) for name in sessions for terms in ((0, 1, 2), tuple(range(6)))]


def _response(here: Here, view: Solved, context: Context) -> Array:
    in_session = np.array([context.sessions[row] == here.location.partner for row in view.rows])
    return in_session[:, None, None] * np.eye(6)


def _change(effect: Effect, model: ChangeableModel) -> ChangeableModel:
    instrument = model.instrument.with_session(effect.location.partner, np.array(effect.values))
    return replace(model, instrument=instrument)


SESSION_FRAME = ModelLaw(
    name="session_frame",
    words=Words("session frame", "the frame of one session differs", "a frame per session"),
    instead=ON_THE_FLOOR,
    plausible=Plausible(0.005, 0.005, "an instrument set up again at its marks"),
    places=_places,
    amplitudes=tuple(Amplitude(axis, "m" if axis[0] == "d" else "rad") for axis in AXES),
    act=Act.FRAME,
    made=_response,
    changed=_change,
    afterwards=Afterwards.OVER,
)
