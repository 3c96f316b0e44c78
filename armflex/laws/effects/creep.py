"""Creep under load: c tau log(1 + h / t0), h the time that the load has stood."""

import numpy as np

from armflex.laws.effects.effect import Afterwards, Amplitude, DependsOn, Inner, Plausible, TwistLaw, Words
from armflex.laws.effects.shapes import at_joints, compliances, of_column, on_axis
from armflex.laws.terms import Factor, Of

CREEP = TwistLaw(
    name="creep",
    words=Words("creep", "the deflection of the joint grows while the load stands", "c τ log(1 + h / t₀)"),
    instead="hold the heaviest payload for an hour and the empty arm as well",
    plausible=Plausible(0.005, 0.005, "at most a tenth of the immediate deflection"),
    places=lambda records: at_joints(records, covariate="hold") if "hold" in records.recorded else [],
    amplitudes=(Amplitude("c", "{m}/{w}"),),
    terms=lambda here, inner: compliances(here.direction, (Factor(Of.CREEP, "hold", (inner[0],)),)),
    direction=on_axis,
    inner=(Inner("t0", "s", of_column(lambda hold: float(hold.max()) * np.array([0.01, 0.05, 0.2, 1.0]))),),
    depends_on=DependsOn.COMPLIANCE,
    afterwards=Afterwards.ANEW,
)
