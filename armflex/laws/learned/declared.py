"""`learn = true` in an arm.toml: what of a flexure's law is free, and how it is made for the loads of a campaign."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from armflex.declaration import Declaration
from armflex.laws.at_node import AtNode
from armflex.laws.law import Law, Ranges, Row
from armflex.laws.learned.compliance_part import LOOSE, CompliancePart
from armflex.laws.learned.fixed_part import FixedPart
from armflex.laws.learned.law import LearnedLaw
from armflex.laws.learned.network_part import NetworkPart
from armflex.laws.learned.part import Part
from armflex.laws.learned.polynomial_part import PolynomialPart
from armflex.laws.learned.seen import Seen
from armflex.laws.learned.structural_part import StructuralPart
from armflex.laws.linear import LinearLaw
from armflex.laws.position_dependent import PositionDependentLaw
from armflex.laws.structural import StructuralLaw

CORRECTED = ("polynomial", "neural", "bayesian")
"""Models with a correction on top of a compliance; without a file they are declared by the compliance."""

MOST_NEURONS = 64
DEGREE = 2
"""Of the polynomial in the position that a position-dependent law is learned as."""


@dataclass(frozen=True)
class Learning:
    """What is to be learned of a flexure's law.

    Attributes:
        model: Name of the law, a key of `LAWS` or of `CORRECTED`.
        neurons: Hidden neurons of a network.
        reach: Middle and half of the travel of the joint that a position-dependent law looks at.
    """

    model: str
    neurons: int = 6
    reach: tuple[float, float] = (0.0, 1.0)


def read_learning(table: Declaration, model: str, law: Law, ranges: Ranges) -> Learning:
    """Return what `learn = true` frees; `neurons` is a network's size."""
    if isinstance(law, LinearLaw) and not law.compliance.any():
        raise table.fail("compliance", "is zero: there is nothing that could be learned about it, give a rough one")
    if isinstance(law, AtNode) and isinstance(law.law, PositionDependentLaw):
        raise table.fail("node", "a law that depends on a position cannot be learned at a node: give it at the joint")
    neurons = table.number("neurons", 6.0)
    if neurons not in range(1, MOST_NEURONS + 1):
        raise table.fail("neurons", f"expected a whole number from 1 to {MOST_NEURONS}, got {neurons:g}")
    if not isinstance(law, PositionDependentLaw):
        return Learning(model, int(neurons))
    low, high = ranges[law.joint]
    return Learning(model, int(neurons), (0.5 * (low + high), max(0.5 * (high - low), 1e-6)))


def learned_law(law: Law, learning: Learning, seen: Seen) -> LearnedLaw:
    """Return a declared law with its parameters, at values that change nothing but a network's hidden weights."""
    plain = _plain(law, learning)
    correction = CORRECTIONS[learning.model](law, learning, seen) if learning.model in CORRECTIONS else None
    groups = (*plain.groups, *(correction.groups if correction else ()))
    values = np.concatenate([plain.start, correction.start if correction else np.zeros(0)])
    return LearnedLaw(law, plain, correction, seen, values, tuple(group.std for group in groups))


def _plain(law: Law, learning: Learning) -> Part:
    """Return the part that holds under every load."""
    if isinstance(law, StructuralLaw) and law.linear_compliance is not None:
        return StructuralPart(law)
    std = law.relative_std if isinstance(law, LinearLaw | PositionDependentLaw) and law.relative_std else LOOSE
    if isinstance(law, PositionDependentLaw):
        middle, reach = learning.reach
        axes = tuple(np.flatnonzero(np.diag(np.abs(law.coefficients).sum(axis=0)) > 0.0).tolist())
        return CompliancePart(law, axes, std, law.joint, middle, reach, DEGREE)
    tangent = law.tangent(np.zeros(6), Row(np.zeros(0), {}))
    if isinstance(law, LinearLaw) and np.allclose(tangent, tangent.T, rtol=1e-9, atol=0.0):
        return CompliancePart(law, tuple(np.flatnonzero(np.diag(tangent) > 0.0).tolist()), std)
    return FixedPart(law)


def _polynomial(law: Law, learning: Learning, seen: Seen) -> Part:
    axes = _axes(seen)
    return PolynomialPart(axes, axes, seen.load_scale, seen.twist_scale, linear=not isinstance(law, LinearLaw))


def _network(law: Law, learning: Learning, seen: Seen) -> Part:
    axes = _axes(seen)
    return NetworkPart(axes, axes, seen.load_scale, seen.twist_scale, learning.neurons)


def _axes(seen: Seen) -> tuple[int, ...]:
    """Return the axes in which the declared law gives: a correction has no others, and looks at their loads."""
    return tuple(np.flatnonzero(seen.twist_scale > 0.0).tolist())


CORRECTIONS: dict[str, Callable[[Law, Learning, Seen], Part]] = {
    "polynomial": _polynomial,
    "neural": _network,
    "bayesian": _network,
}
"""`model` -> the correction that is learned."""
