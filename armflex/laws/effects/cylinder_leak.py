"""A cylinder that leaks: oil passes its piston or valve, so it yields to its load with time, c F h."""

from armflex.laws.effects.effect import Afterwards, Amplitude, DependsOn, Plausible, TwistLaw, Words
from armflex.laws.effects.location import Location
from armflex.laws.effects.shapes import compliances, on_axis
from armflex.laws.terms import powers

CYLINDER_LEAK = TwistLaw(
    name="cylinder_leak",
    words=Words("leaking cylinder", "the cylinder yields to its load while that stands", "c · F · h"),
    instead="close the valves under load and watch the rod with a dial gauge",
    plausible=Plausible(0.005, 0.005, "a boom that sinks by centimetres while it is measured is repaired"),
    places=lambda records: [
        Location(cylinder.name, "dx", ("hold",))
        for cylinder in records.robot.linkage.cylinders
        if "hold" in records.recorded
    ],
    amplitudes=(Amplitude("c", "m/(N s)", positive=True),),
    terms=lambda here, inner: compliances(here.direction, powers("hold", 1)),
    direction=on_axis,
    depends_on=DependsOn.COMPLIANCE,
    afterwards=Afterwards.ANEW,
)
