"""A telescopic joint gives as a beam that is as long as the joint is out.

    twist = bending (B(L) - B(L_d)) w + torsion (L - L_d) (b . m) b,    L = length0 + s q
    B(L) = [[L^3/3 P, -L^2/2 X], [L^2/2 X, L P]],    L_d = length0 + s declared_at

of a wrench w with the moment m at the end of a uniform Euler-Bernoulli cantilever along the unit vector b (Timoshenko,
Strength of Materials I, ch. 5): bending is 1/EI, torsion 1/GJ, P = 1 - b b', X = [b]x. `length0` is what is out at
position 0; s is +1 where positive positions drive the beam out (partner `out`), -1 where they drive it in (`in`). A
constant compliance that was declared is right at `declared_at`; where none was, L_d is 0.
"""

from collections.abc import Iterable

import numpy as np

from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import (
    Amplitude,
    DependsOn,
    Effect,
    Inner,
    Manipulator,
    Plausible,
    TwistLaw,
    Values,
    Words,
)
from armflex.laws.effects.location import Here, Location
from armflex.laws.effects.shapes import of_column, own_column
from armflex.laws.joint.telescope import bending
from armflex.laws.law import block_diagonal
from armflex.laws.terms import Term, powers, straight

WAYS = {"out": 1.0, "in": -1.0}
SPARE = (0.1, 0.5, 1.5)
"""What is out where least is, as shares of the travel: to begin a search with."""

MOST = 5.0
"""Prior: no telescope is built of which more stays out, as a share of the travel that was measured."""


def _length0(location: Location, context: Context) -> Iterable[float]:
    out = WAYS[location.partner] * context.column(location.covariates[0])
    return -out.min() + max(float(np.ptp(out)), 1e-3) * np.array(SPARE)


def _is_built(effect: Effect, context: Context, arm: Manipulator) -> bool:
    """Return whether what stays out, and where a constant was declared, are those of a machine.

    A cubic far from its origin is a straight line: any slow drift along the travel would be a beam without this.
    """
    out = WAYS[effect.location.partner] * context.column(effect.location.covariates[0])
    travel, values = float(np.ptp(out)), effect.named
    least = values["length0"] + float(out.min())
    declared = WAYS[effect.location.partner] * values["declared_at"]
    return 0.0 <= least <= MOST * travel and out.min() - travel <= declared <= out.max() + travel


def _terms(here: Here, inner: Values) -> list[list[Term]]:
    """Return the beam's compliance as a polynomial in the joint's position, less what it is where declared."""
    side = WAYS[here.location.partner]
    along, length = side * here.drive[:3], np.polynomial.Polynomial((inner[0], side))
    declared = 0.0 if here.base_law is None else inner[0] + side * inner[1]
    parts = np.zeros((4, 4))  # by the power of L, and of q
    for k in range(4):
        parts[k, : k + 1] = (length**k - declared**k).coef
    twist = block_diagonal(np.zeros((3, 3)), np.outer(along, along))
    each = (np.einsum("kn,kij->nij", parts, bending(along)), np.einsum("n,ij->nij", parts[1], twist))
    return [[straight(matrix, *powers(own_column(here), n)) for n, matrix in enumerate(matrices)] for matrices in each]


TELESCOPE_BENDING = TwistLaw(
    name="unnamed_telescope",
    words=Words(
        "bending of a telescope",
        "a telescopic joint gives as a beam that is as long as it is out; a compliance that was declared holds at one "
        "length, beyond which this adds to it and short of which it takes away from it",
        "(B(L) − B(L_d)) w / EI",
    ),
    instead="hang the same weight on the joint's link with the joint in, half out and out",
    plausible=Plausible(0.05, 0.02, "slender booms sag by a hundredth of their length"),
    places=lambda records: [
        Location(joint.name, None, (f"q_{joint.name}",), terms, way)
        for joint in records.robot.moving
        if joint.kind == "prismatic" and joint in records.robot.jointed
        for way in WAYS
        for terms in ((0,), (0, 1))
    ],
    amplitudes=(Amplitude("bending", "1/(N m^2)", positive=True), Amplitude("torsion", "1/(N m^2)", positive=True)),
    terms=_terms,
    possible=_is_built,
    inner=(
        Inner("length0", "m", _length0, positive=False),
        Inner("declared_at", "m", of_column(lambda q: (float(q.mean()),)), positive=False),
    ),
    depends_on=DependsOn.COMPLIANCE,
    shape="telescope",
)
