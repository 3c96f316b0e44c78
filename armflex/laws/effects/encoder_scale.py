"""Encoder scale: eps (q - q0); q0 is an encoder offset, which calibration has, and is taken as zero."""

from armflex.laws.effects.effect import Amplitude, Plausible, TwistLaw, Words
from armflex.laws.effects.shapes import OVER_ITS_RANGE, SECOND_ENCODER, at_drives, on_drive, own_column, twists
from armflex.laws.terms import powers

ENCODER_SCALE = TwistLaw(
    name="encoder_scale",
    words=Words("encoder scale", "the joint moves further than reported, or less", "scale · (q − q₀)"),
    instead=SECOND_ENCODER,
    level=OVER_ITS_RANGE,
    plausible=Plausible(0.002, 0.005, "a tooth in a thousand, or a belt that stretches"),
    places=lambda records: at_drives(records, "q_{joint}"),
    amplitudes=(Amplitude("scale", "1"),),
    terms=lambda here, inner: twists(here.drive, powers(own_column(here), 1)),
    direction=on_drive,
)
