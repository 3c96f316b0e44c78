"""Guides of a telescopic joint: a tube rocks in them by their gap over their overlap, and gives under the moment.

    turn = (g clip(tau / tau0, -1, 1) + c tau) / overlap,    overlap = spare + |q - out|

`out` is the recorded position at which the tubes overlap least, `spare` what is left of the overlap there. A deadband
and a position-dependent compliance are what this looks like at one position, or over a short way.

`GUIDES` is the same of any size: sums over loads that take up the play, and overlaps; see `armflex.trace.families`.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from armflex.laws.effects.context import AXES_TURN
from armflex.laws.effects.effect import Amplitude, DependsOn, Inner, Plausible, Search, TwistLaw, Values, Words
from armflex.laws.effects.location import Here, Location
from armflex.laws.effects.shapes import of_column, on_axis, shares_of_load
from armflex.laws.terms import Curve, Factor, Of, Term, part, straight


def _terms(here: Here, inner: Values) -> list[list[Term]]:
    way, overlap = here.direction, (Factor(Of.OVERLAP, here.location.covariates[0], (inner[1], inner[2])),)
    play = Term(way, features=(part(way / inner[0], Curve.CLIPPED),), factors=overlap)
    return [[play], [straight(np.outer(way, way), *overlap)]]


GUIDE = TwistLaw(
    name="unnamed_guide",
    words=Words(
        "play in the guides",
        "a tube rocks in its guides, the more the less they overlap",
        "(g · clip(τ / τ₀) + c τ) / overlap",
    ),
    plausible=Plausible(0.015, 0.01, "a tenth of a mm of play over some cm of overlap"),
    places=lambda records: [
        Location(joint.name, axis, (f"q_{joint.name}",), terms)
        for joint in records.robot.moving
        if joint.kind == "prismatic" and joint in records.robot.jointed
        for axis in AXES_TURN
        for terms in ((0,), (1,), (0, 1))
    ],
    amplitudes=(Amplitude("g", "rad m", positive=True), Amplitude("c", "rad m/Nm", positive=True)),
    terms=_terms,
    direction=on_axis,
    inner=(
        Inner("tau0", "Nm", partial(shares_of_load, shares=(0.05, 0.2, 0.5))),
        Inner("spare", "m", of_column(lambda q: max(float(np.ptp(q)), 1e-3) * np.array([0.05, 0.15, 0.5]))),
        Inner("out", "m", of_column(lambda q: (float(q.max()), float(q.min()))), positive=False, polished=False),
    ),
    depends_on=DependsOn.COMPLIANCE,
    shape="guide",
)

SHARES, SPARES = (0.05, 0.2, 0.5), (0.15, 0.5)
"""Loads that take play up, in parts of the largest, and overlaps that are left, in parts of the way: of `GUIDES`."""


def _sums(here: Here, inner: Values) -> list[list[Term]]:
    way, (largest, low, high), column = here.direction, inner, here.location.covariates[0]
    return [
        [
            Term(
                way,
                features=(part(way / (share * largest), Curve.CLIPPED),),
                factors=(Factor(Of.OVERLAP, column, (spare * (high - low), out)),),
            )
        ]
        for share in SHARES
        for spare in SPARES
        for out in (low, high)
    ]


GUIDES = TwistLaw(
    name="unnamed_guides",
    words=Words(
        "play in guides of any size",
        "tubes rock in their guides as the load takes up play",
        "Σ gᵢ clip(τ / τᵢ) / overlapᵢ",
    ),
    plausible=GUIDE.plausible,
    places=lambda records: [
        replace(location, terms=tuple(range(len(GUIDES.amplitudes))))
        for location in GUIDE.places(records)
        if location.terms == (0,)
    ],
    amplitudes=tuple(Amplitude(f"g{i + 1}", "rad m") for i in range(2 * len(SHARES) * len(SPARES))),
    terms=_sums,
    direction=on_axis,
    inner=(
        Inner("largest", "Nm", partial(shares_of_load, shares=(1.0,))),
        Inner("low", "m", of_column(lambda q: (float(q.min()),)), positive=False, polished=False),
        Inner("high", "m", of_column(lambda q: (float(q.max()),)), positive=False, polished=False),
    ),
    depends_on=DependsOn.COMPLIANCE,
    physical=False,
    shape="guides",
    search=Search.NOWHERE,
)
