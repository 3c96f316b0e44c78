"""Following error: a drive that moves lags behind its command, in proportion to its speed.

The campaign has the speeds in columns `speed_J1`, `speed_J2` .. [rad/s, m/s], as the controller logged them.
"""

from armflex.laws.effects import TwistLaw
from armflex.laws.effects.context import Records
from armflex.laws.effects.effect import Amplitude, Plausible, Words
from armflex.laws.effects.location import Location
from armflex.laws.effects.shapes import at_drives, on_drive, twists
from armflex.laws.terms import powers


def _places(records: Records) -> list[Location]:
    """Every drive whose speed was recorded and varies."""
    drives = at_drives(records, "speed_{joint}")
    return [drive for drive in drives if drive.covariates[0] in records.recorded]


FOLLOWING_ERROR = TwistLaw(
    name="following_error",
    words=Words(
        "following error",
        "the drive lags behind its command while it moves",
        "lag · speed",
    ),
    instead="stop before each reading",
    plausible=Plausible(0.001, 0.002, "controllers report some mrad of following error"),
    places=_places,
    amplitudes=(Amplitude("lag", "s"),),
    terms=lambda here, inner: twists(here.drive, powers(here.location.covariates[0], 1)),
    direction=on_drive,
)
