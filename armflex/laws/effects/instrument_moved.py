"""The instrument, or the base, was moved once and stayed there: another frame from a moment on.

A campaign that says so has sessions, which have frames of their own; this is for one that does not.
"""

from armflex.laws.effects.context import AXES
from armflex.laws.effects.effect import Afterwards, Amplitude, Inner, Plausible, TwistLaw, Words
from armflex.laws.effects.location import BASE, Location
from armflex.laws.effects.shapes import ON_THE_FLOOR
from armflex.laws.effects.slip_step import times
from armflex.laws.terms import UNITS, Factor, Of, Term

INSTRUMENT_MOVED = TwistLaw(
    name="instrument_moved",
    words=Words("instrument moved", "the instrument or the base moved once and stayed there", "a frame from then on"),
    instead=ON_THE_FLOOR,
    plausible=Plausible(0.005, 0.005, "an instrument that somebody knocked"),
    places=lambda records: [
        Location(BASE, None, ("time",), terms) for terms in ((0, 1, 2), tuple(range(6))) if records.timed
    ],  # nobody knocks it along a single axis
    amplitudes=tuple(Amplitude(axis, "m" if axis[0] == "d" else "rad") for axis in AXES),
    terms=lambda here, inner: [[Term(unit, factors=(Factor(Of.STEP, "time", (inner[0],)),))] for unit in UNITS],
    inner=(Inner("at", "s", times, positive=False, smooth=False),),
    afterwards=Afterwards.STAYS,
)
