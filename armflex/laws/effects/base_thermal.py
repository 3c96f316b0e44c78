"""A base that moves as it warms: beta (T - Tref), along or about one axis, or any."""

from armflex.laws.effects.context import AXES
from armflex.laws.effects.effect import Afterwards, Amplitude, Plausible, TwistLaw, Words
from armflex.laws.effects.location import BASE
from armflex.laws.effects.shapes import LAGGED, WARM, shows_lag, singly_and_together, warm, with_temperature
from armflex.laws.terms import UNITS, Term

BASE_THERMAL = TwistLaw(
    name="base_thermal",
    words=Words("thermal base motion", "the foundation follows the weather", "β (T − T₀)"),
    instead="measure a target on the base at two temperatures",
    plausible=Plausible(0.005, 0.005, "steel and concrete move by 10 um/m K, a stand warm on one side by some mrad"),
    places=lambda records: with_temperature(
        lambda name: singly_and_together((BASE,), (0, 1, 2), (3, 4, 5), covariates=(name,)), records
    ),
    amplitudes=tuple(Amplitude(f"beta_{axis}", "m/K" if axis[0] == "d" else "rad/K") for axis in AXES),
    terms=lambda here, inner: [[Term(unit, factors=warm(here, *inner))] for unit in UNITS],
    inner=WARM,
    memory=LAGGED,
    afterwards=Afterwards.ANEW,
    possible=shows_lag,
)
