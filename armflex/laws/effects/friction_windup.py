"""Friction wind-up: s (a + b |tau|), the drive train twisted by the friction it had to overcome."""

from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Amplitude, DependsOn, Effect, Manipulator, Plausible, TwistLaw, Words
from armflex.laws.effects.location import with_terms
from armflex.laws.effects.shapes import BY_HAND, at_drives, on_drive, side
from armflex.laws.terms import Curve, Term, part


def _grows(effect: Effect, context: Context, arm: Manipulator) -> bool:
    """Return whether friction grows with the load."""
    a, b = effect.amplitudes
    return a * b >= 0.0


FRICTION_WINDUP = TwistLaw(
    name="friction_windup",
    words=Words("friction wind-up", "the drive is twisted by the friction that it overcame last", "s · (a + b |τ|)"),
    instead=BY_HAND,
    plausible=Plausible(0.001, 0.002, "as lost motion, of which it is a part"),
    places=lambda records: with_terms(at_drives(records, "approach_{joint}"), (0, 1), (1,)),
    amplitudes=(Amplitude("a", "{m}"), Amplitude("b", "{m}/{w}")),
    terms=lambda here, inner: [
        [Term(here.drive, factors=side(here))],
        [Term(here.drive, features=(part(here.drive, Curve.SIZE),), factors=side(here))],
    ],
    direction=on_drive,
    depends_on=DependsOn.LOAD,
    possible=_grows,
)
