"""A link that grows as it warms: alpha L (T - Tref) along the link."""

from armflex.laws.effects.effect import Afterwards, Amplitude, Plausible, TwistLaw, Words
from armflex.laws.effects.location import Location
from armflex.laws.effects.shapes import LAGGED, ON_THE_LINK, WARM, shows_lag, twists, warm

THERMAL_GROWTH = TwistLaw(
    name="thermal_growth",
    words=Words("thermal growth", "the link grows as it warms", "α L (T − T₀)"),
    instead=f"{ON_THE_LINK} at two temperatures",
    plausible=Plausible(0.003, 0.005, "10 um/m K of steel, 100 of plastics"),
    places=lambda records: [Location(link, None, (name,)) for link in records.links for name in records.temperatures],
    amplitudes=(Amplitude("alpha", "1/K", usual=5e-5),),
    terms=lambda here, inner: twists(here.stretch, warm(here, *inner)),
    direction=lambda here, inner: here.stretch,
    inner=WARM,
    memory=LAGGED,
    afterwards=Afterwards.ANEW,
    possible=shows_lag,
)
