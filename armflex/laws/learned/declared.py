"""`learn = true` in an arm.toml: what of a flexure's law is free, and how it is made for the loads of a campaign."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.laws.joint.at_node import AtNode
from armflex.laws.joint.linear import LinearLaw
from armflex.laws.joint.position_dependent import PositionDependentLaw
from armflex.laws.joint.structural import StructuralLaw
from armflex.laws.law import Law, Ranges, Row
from armflex.laws.learned.compliance_part import LOOSE, CompliancePart
from armflex.laws.learned.fixed_part import FixedPart
from armflex.laws.learned.law import LearnedLaw
from armflex.laws.learned.network_part import NetworkPart
from armflex.laws.learned.node_part import NodePart
from armflex.laws.learned.part import Part
from armflex.laws.learned.polynomial_part import PolynomialPart
from armflex.laws.learned.seen import Seen
from armflex.laws.learned.structural_part import StructuralPart

CORRECTED = ("polynomial", "neural", "bayesian")
"""Models with a correction on top of a compliance; without a file they are declared by the compliance."""

NETWORKS = ("neural", "bayesian")
"""Those whose correction is a network."""

MOST_NEURONS = 64
FIRMEST = 1e-3
"""Relative standard deviation below which no fit to a bench is taken to know a joint as it is in the arm."""

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
    own = law.law if isinstance(law, AtNode) else law
    if isinstance(own, LinearLaw) and not own.compliance.any():
        raise table.fail("compliance", "is zero: there is nothing that could be learned about it, give a rough one")
    if model not in CORRECTED and isinstance(_plain(law, Learning(model)), FixedPart):
        text = "has no parameters to learn: its compliance is not symmetric, or a structure not linear"
        raise table.fail("model", f"{text}; learn a correction about it: {', '.join(CORRECTED)}")
    if table.has("neurons") and model not in NETWORKS:
        raise table.fail("neurons", f"a {model} law has none: only {' and '.join(NETWORKS)} laws do")
    neurons = table.number("neurons", 6.0)
    if neurons not in range(1, MOST_NEURONS + 1):
        raise table.fail("neurons", f"expected a whole number from 1 to {MOST_NEURONS}, got {neurons:g}")
    if not isinstance(own, PositionDependentLaw):
        return Learning(model, int(neurons))
    low, high = ranges[own.joint]
    return Learning(model, int(neurons), (0.5 * (low + high), max(0.5 * (high - low), 1e-6)))


def learned_law(law: Law, learning: Learning, seen: Seen) -> LearnedLaw:
    """Return a declared law with its parameters, at values that change nothing but a network's hidden weights."""
    plain = _plain(law, learning)
    correction = CORRECTIONS[learning.model](plain, learning, seen) if learning.model in CORRECTIONS else None
    groups = (*plain.groups, *(correction.groups if correction else ()))
    values = np.concatenate([plain.start, correction.start if correction else np.zeros(0)])
    return LearnedLaw(law, plain, correction, seen, values, tuple(group.std for group in groups), about=_scatter(law))


def _plain(law: Law, learning: Learning) -> Part:
    """Return the part that holds under every load."""
    if isinstance(law, AtNode):
        part = _plain(law.law, learning)
        return FixedPart(law) if isinstance(part, FixedPart) else NodePart(law, part)
    if isinstance(law, StructuralLaw) and law.constant is not None:
        return StructuralPart(law)
    if isinstance(law, PositionDependentLaw):
        middle, reach = learning.reach
        axes = tuple(np.flatnonzero(np.diag(np.abs(law.coefficients).sum(axis=0)) > 0.0).tolist())
        return CompliancePart(law, axes, law.relative_std or LOOSE, law.joint, middle, reach, DEGREE)
    tangent = law.tangent(np.zeros(6), Row(np.zeros(0), {}))
    if isinstance(law, LinearLaw) and np.allclose(tangent, tangent.T, rtol=1e-9, atol=0.0):
        axes = tuple(np.flatnonzero(np.diag(tangent) > 0.0).tolist())
        return CompliancePart(law, axes, _fitted_std(law, axes) or law.relative_std or LOOSE)
    return FixedPart(law)


def _fitted_std(law: LinearLaw, axes: tuple[int, ...]) -> tuple[float, ...]:
    """Return how well a fit knows the compliance of each axis, relative to it; nothing where it was not fitted."""
    if law.fit is None:
        return ()
    known = np.sqrt([law.fit.row_covariance[axis, axis, axis] for axis in axes])
    return tuple(np.clip(known / np.diag(law.compliance)[list(axes)], FIRMEST, LOOSE).tolist())


def _scatter(law: Law) -> Array | None:
    """Return the (6, 6) covariance about a law that its parameters do not explain, None where it has none."""
    if isinstance(law, AtNode):
        own = _scatter(law.law)
        return None if own is None else law.action @ own @ law.action.T
    if isinstance(law, StructuralLaw):
        return None if law.noise is None else np.diag(law.noise**2)
    if isinstance(law, LinearLaw) and law.fit is not None:
        return np.diag(np.pad(law.fit.residual_std**2, (0, 6 - len(law.fit.residual_std))))
    return None


def _polynomial(plain: Part, learning: Learning, seen: Seen) -> Part:
    axes = _axes(seen)
    straight = isinstance(plain, FixedPart | StructuralPart)
    return PolynomialPart(axes, axes, seen.load_scale, seen.twist_scale, linear=straight)


def _network(plain: Part, learning: Learning, seen: Seen) -> Part:
    axes = _axes(seen)
    return NetworkPart(axes, axes, seen.load_scale, seen.twist_scale, learning.neurons)


def _axes(seen: Seen) -> tuple[int, ...]:
    """Return the axes in which the declared law gives: a correction has no others, and looks at their loads."""
    return tuple(np.flatnonzero(seen.twist_scale > 0.0).tolist())


CORRECTIONS: dict[str, Callable[[Part, Learning, Seen], Part]] = {
    "polynomial": _polynomial,
    "neural": _network,
    "bayesian": _network,
}
"""`model` -> the correction that is learned."""
