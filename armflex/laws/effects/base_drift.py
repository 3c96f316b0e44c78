"""A base (or an instrument) that drifts: v t, along or about one axis, or any."""

from armflex.laws.effects.context import AXES
from armflex.laws.effects.effect import Afterwards, Amplitude, Plausible, TwistLaw, Words
from armflex.laws.effects.location import BASE
from armflex.laws.effects.shapes import ON_THE_FLOOR, singly_and_together
from armflex.laws.terms import UNITS, Term, powers

BASE_DRIFT = TwistLaw(
    name="base_drift",
    words=Words("base drift", "the foundation or the instrument wanders with time", "v · t"),
    instead=ON_THE_FLOOR,
    plausible=Plausible(0.003, 0.003, "a machine that wanders further is bolted down again"),
    places=lambda records: (
        singly_and_together((BASE,), (0, 1, 2), (3, 4, 5), covariates=("time",)) if records.timed else []
    ),
    amplitudes=tuple(Amplitude(f"v_{axis}", "m/s" if axis[0] == "d" else "rad/s") for axis in AXES),
    terms=lambda here, inner: [[Term(unit, factors=powers("time", 1))] for unit in UNITS],
    afterwards=Afterwards.WANDERS,
)
