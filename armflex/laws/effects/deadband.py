"""Deadband: play that the load takes up, g clip(tau / tau0, -1, 1), on one axis or about several at once."""

from functools import partial

from armflex.laws.effects.context import AXES_TURN
from armflex.laws.effects.effect import Amplitude, DependsOn, Inner, Plausible, TwistLaw, Words
from armflex.laws.effects.shapes import about_several, at_joints, shares_of_load
from armflex.laws.terms import UNITS, Curve, Term, part

DEADBAND = TwistLaw(
    name="deadband",
    words=Words("play taken up by the load", "the joint falls to the loaded side", "g · clip(τ / τ₀, ±1)"),
    instead="reverse the load on the joint with a counterweight or with the arm turned over",
    plausible=Plausible(0.001, 0.003, "lost motion of gears, and the play of worn bearings"),
    places=lambda records: [*at_joints(records), *about_several(records, 1)],
    amplitudes=(
        Amplitude("g", "{m}", positive=True),
        *(Amplitude(f"g_{axis}", "rad", positive=True) for axis in AXES_TURN),
    ),
    terms=lambda here, inner: [
        [Term(way, features=(part(way / inner[0], Curve.CLIPPED),))] for way in (here.direction, *UNITS[3:])
    ],
    inner=(Inner("tau0", "{w}", partial(shares_of_load, shares=(0.03, 0.1, 0.2, 0.4, 0.7))),),
    depends_on=DependsOn.COMPLIANCE,
)
