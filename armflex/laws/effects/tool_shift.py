"""The target or the tool moved: for the whole campaign, or from some time on."""

from collections.abc import Iterable

import numpy as np

from armflex.laws.effects.context import Context, Records
from armflex.laws.effects.effect import Afterwards, Amplitude, Inner, Plausible, TwistLaw, Values, Words
from armflex.laws.effects.location import TOOL, Here, Location
from armflex.laws.terms import UNITS, Factor, Of, Term

ALWAYS = -np.inf
"""A start before every row, which needs no time."""


def _places(records: Records) -> list[Location]:
    single = [Location(TOOL, axis, terms=(i,)) for i, axis in enumerate(("dx", "dy", "dz"))]
    return [*single, *([Location(TOOL, None, ("time",), (0, 1, 2))] if records.timed else [])]


def _starts(location: Location, context: Context) -> Iterable[float]:
    """Return always, and the first moment of every later session where time is known."""
    if not context.timed:
        return (ALWAYS,)
    time = context.column("time")
    first = {name: min(time[i] for i, s in enumerate(context.sessions) if s == name) for name in set(context.sessions)}
    return (ALWAYS, *sorted(first.values())[1:])


def _terms(here: Here, inner: Values) -> list[list[Term]]:
    since = () if inner[0] == ALWAYS else (Factor(Of.STEP, "time", (inner[0],)),)
    return [[Term(unit, factors=since)] for unit in UNITS[:3]]


TOOL_SHIFT = TwistLaw(
    name="tool_shift",
    words=Words("tool shift", "the place of the target differs from the declared one, or it moved", "constant shift"),
    instead="measure a second target on the tool",
    plausible=Plausible(0.01, 0.01, "a target put back by hand"),
    places=_places,
    amplitudes=tuple(Amplitude(axis, "m") for axis in ("dx", "dy", "dz")),
    terms=_terms,
    inner=(Inner("since", "s", _starts, positive=False, polished=False, default=ALWAYS),),
    afterwards=Afterwards.STAYS,
    stands_for=("tool", "session_target"),
)
