"""Backlash: (gap / 2) s, s the direction from which the joint came."""

from armflex.laws.effects.effect import Amplitude, Plausible, TwistLaw, Words
from armflex.laws.effects.shapes import BY_HAND, at_drives, on_drive, side, twists

BACKLASH = TwistLaw(
    name="backlash",
    words=Words(
        "backlash",
        "play that is taken up by the side from which the joint came",
        "(gap / 2) · s",
        "s is 1 after the joint moved up and -1 after it moved down: with a gap below 0 the link lags behind its "
        "drive, above 0 it is ahead",
    ),
    instead=BY_HAND,
    plausible=Plausible(0.001, 0.002, "lost motion of gears is 1 to 5 arcmin, of worn ones some more"),
    places=lambda records: at_drives(records, "approach_{joint}"),
    amplitudes=(Amplitude("gap", "{m}"),),
    terms=lambda here, inner: twists(0.5 * here.drive, side(here)),
    direction=on_drive,
)
