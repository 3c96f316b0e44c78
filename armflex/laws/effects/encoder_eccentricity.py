"""Eccentric encoder disc or bearing: A sin q + B cos q."""

from armflex.laws.effects.context import Records
from armflex.laws.effects.effect import Amplitude, Plausible, TwistLaw, Words
from armflex.laws.effects.location import Location, with_terms
from armflex.laws.effects.shapes import OVER_ITS_RANGE, SECOND_ENCODER, at_drives, on_drive, own_column, twists
from armflex.laws.terms import waves


def _places(records: Records) -> list[Location]:
    turning = [location for location in at_drives(records, "q_{joint}") if str(location.axis).startswith("r")]
    return with_terms(turning, (0, 1))


ENCODER_ECCENTRICITY = TwistLaw(
    name="encoder_eccentricity",
    words=Words("encoder eccentricity", "the error turns with the joint", "A sin q + B cos q"),
    instead=SECOND_ENCODER,
    level=OVER_ITS_RANGE,
    plausible=Plausible(0.001, 0.003, "a disc that is 0.05 mm off its axis at 20 mm of radius"),
    places=_places,
    amplitudes=(Amplitude("A", "rad"), Amplitude("B", "rad")),
    terms=lambda here, inner: twists(here.drive, *([wave] for wave in waves(own_column(here), 1.0))),
    direction=on_drive,
)
