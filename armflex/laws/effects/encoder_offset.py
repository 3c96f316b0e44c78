"""Encoder offset: the joint is elsewhere than reported, always by the same amount."""

from armflex.laws.effects.effect import Amplitude, DependsOn, Plausible, TwistLaw, Words
from armflex.laws.effects.shapes import IN_THE_BASE, at_drives, on_drive, twists

ENCODER_OFFSET = TwistLaw(
    name="encoder_offset",
    words=Words("encoder offset", "the joint is displaced from its reported position by a constant", "constant"),
    instead=IN_THE_BASE,
    level="level the joint's link with an inclinometer",
    plausible=Plausible(0.005, 0.01, "zeroed at a mark by eye"),
    places=at_drives,
    amplitudes=(Amplitude("offset", "{m}"),),
    terms=lambda here, inner: twists(here.drive, ()),
    direction=on_drive,
    depends_on=DependsOn.NOTHING,
    stands_for=("joint_offset",),
)
