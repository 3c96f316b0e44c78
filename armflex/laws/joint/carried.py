"""A law in other axes: f(w) becomes A f(A' w), as of a law measured at a node some way off the joint frame.

`T exp6(twist) T^-1 = exp6(Ad_T twist)`, so the transport of the twist is exact, and the wrench follows by duality.
Any law made softer or stiffer along its axes, as [prior] compliance frees it, is one, too: f(w) becomes S f(S w), and a
compliance C becomes S C S. S = exp(v / 2), v the logarithm of a factor on each axis' own compliance, or on what one
number of the law bears (`Law.projections`), so that a hinge keeps its direction.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.conventions import TWIST_NAMES, Array
from armflex.laws.law import Composed, Law, Parameter, Ranges, Row, Transform, block_norms
from armflex.laws.terms import Terms


@dataclass(frozen=True, eq=False)
class CarriedLaw(Composed):
    """`law` as it is seen in other axes."""

    law: Law

    @property
    @abstractmethod
    def action(self) -> Array:
        """(6, 6) map A of the law's twist to the same motion's twist here."""

    @property
    def laws(self) -> tuple[Law]:
        return (self.law,)

    def with_laws(self, laws: Sequence[Law]) -> CarriedLaw:
        return replace(self, law=laws[0])

    def shares(self, wrench: Array, row: Row) -> list[tuple[Array, Array]]:
        """Return A, and the load that the law sees."""
        return [(self.action, wrench @ self.action)]

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return A f(A' w)."""
        return self.law.twist(wrench @ self.action, row) @ self.action.T

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return A J(A' w) A'."""
        return self.action @ self.law.tangent(wrench @ self.action, row) @ self.action.T

    @cached_property
    def constant(self) -> Array | None:
        """A C A' where there is a C, as symmetric as that."""
        constant = self.law.constant
        if constant is None:
            return None
        moved = self.action @ constant @ self.action.T
        return 0.5 * (moved + moved.T) if (constant == constant.T).all() else moved

    def terms(self) -> Terms:
        return [term.carried(self.action) for term in self.law.terms()]

    def affine(self, row: Row) -> tuple[Array, Array] | None:
        affine = self.law.affine(row)
        return None if affine is None else (affine[0] @ self.action.T, self.action @ affine[1] @ self.action.T)

    def compliance_bound(self, ranges: Ranges) -> Array | None:
        """Return bounds of the transported tangent's blocks, by those of A where the compliance is not constant."""
        if self.constant is not None:
            return block_norms(self.constant)
        bound = self.law.compliance_bound(ranges)
        carried = np.linalg.norm(self.action.reshape(2, 3, 2, 3), ord=2, axis=(1, 3))
        return None if bound is None else carried @ bound @ carried.T


@dataclass(frozen=True)
class AtNode(CarriedLaw):
    """`law` acts in a frame at `node`, (3,) in the flexure's frame [m], axes parallel to it."""

    node: Array

    @cached_property
    def action(self) -> Array:
        """(6, 6) map of a twist at the node to the same motion's twist at the flexure's origin."""
        return pin.SE3(np.eye(3), self.node).action

    def moved(self, step: Array) -> AtNode:
        return AtNode(self.law.moved(step), self.node)

    def learned(self, travel: Ranges) -> AtNode | None:
        free = self.law.learned(travel)
        return None if free is None else AtNode(free, self.node)


@dataclass(frozen=True, eq=False)
class ScaledLaw(CarriedLaw):
    """A law scaled along some axes. Its parameters are the factors' logarithms; what the law does not know stays its.

    Attributes:
        logarithms: (6,) of the factors.
        axes: Those whose factors are parameters.
        std: Standard deviation of each.
    """

    logarithms: Array
    axes: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    std: float = 0.0

    @cached_property
    def action(self) -> Array:
        return self.law.scaling(np.exp(0.5 * self.logarithms))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """A factor on each axis."""
        return tuple(Parameter(TWIST_NAMES[axis], "1", self.std, Transform.LOG) for axis in self.axes)

    @property
    def values(self) -> Array:
        return self.logarithms[list(self.axes)]

    def at(self, values: Array) -> ScaledLaw:
        logarithms = self.logarithms.copy()
        logarithms[list(self.axes)] = values
        return replace(self, logarithms=logarithms)

    @property
    def values_covariance(self) -> Array | None:
        return np.diag(np.full(len(self.axes), self.std**2)) if self.std else None

    def by_values(self, wrench: Array, row: Row) -> Array:
        return self.law.by_factors(self.axes, wrench, self.twist(wrench, row), self.tangent(wrench, row))


def scaled(law: Law, factor: Array) -> Law:
    """Return S f(S w), S of (6,) factors as in `Law.scaling`, as a law of the same kind where there is one."""
    alike = factor if law.sole_axis is None else np.full(6, factor[law.sole_axis])
    scaled_law = law.scaled(alike)
    return ScaledLaw(law, 2.0 * np.log(factor)) if scaled_law is None else scaled_law
