"""Air that bends lines of sight: a tracker's or theodolite's beam by the square of its length, a star's by tan z.

    height read too high by (k + k_T (T - 20)) d^2,    star lower by (A + A_T (T - 20)) tan z than the axis points

at a distance d and a zenith distance z. A temperature that falls by 1 K per metre of height makes k of 5e-7 per metre
(Ciddor 1996: the refractivity of air falls by 1 ppm per K).
"""

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.context import Records
from armflex.laws.effects.effect import Amplitude, Plausible, SightLaw, Words
from armflex.laws.effects.location import BASE, Location
from armflex.laws.effects.shapes import REFERENCE

PPM = 1e-6


def _places(records: Records) -> list[Location]:
    """Return it as it is, and with each temperature; of stars where one is read."""
    locations = []
    for first in (0, 1) if records.stars else (0,):
        locations.append(Location(BASE, terms=(first,)))
        for name in records.temperatures:
            locations += [Location(BASE, None, (name,), terms) for terms in ((first + 2,), (first, first + 2))]
    return locations


def _weights(location: Location, row: Row) -> tuple[Array | float, ...]:
    warm = row.column(location.covariates[0]) - REFERENCE if location.covariates else 0.0
    return 1.0, PPM, warm, PPM * warm


REFRACTION = SightLaw(
    name="refraction",
    words=Words(
        "refraction",
        "the air bends the line of sight: far points are read too high or too low, stars stand lower than they seem",
        "k d², A tan z",
    ),
    instead="measure with the beam at another height above the floor, or in the morning and at noon",
    plausible=Plausible(3e-6, 6e-4, "air that is warmer by some K per metre; all that the air bends of a star's light"),
    places=_places,
    amplitudes=(
        Amplitude("k", "1/m", usual=1e-6),
        Amplitude("A", "ppm", usual=100.0),
        Amplitude("k_T", "1/m/K", usual=1e-7),
        Amplitude("A_T", "ppm/K", usual=10.0),
    ),
    weights=_weights,
)
