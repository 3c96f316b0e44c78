"""A law measured at a node some way off the joint frame, carried there by the adjoint.

`T exp6(twist) T^-1 = exp6(Ad_T twist)`, so the transport of the twist is exact, and the wrench follows by duality.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.laws.law import Composed, Law, Ranges, Row


@dataclass(frozen=True)
class AtNode(Composed):
    """`law` acts in a frame at `node`, (3,) in the flexure's frame [m], axes parallel to it."""

    law: Law
    node: Array

    @cached_property
    def action(self) -> Array:
        """(6, 6) map of a twist at the node to the same motion's twist at the flexure's origin."""
        return pin.SE3(np.eye(3), self.node).action

    @property
    def laws(self) -> tuple[Law]:
        """The law."""
        return (self.law,)

    def with_laws(self, laws: Sequence[Law]) -> AtNode:
        """Return another law at the same node."""
        return AtNode(laws[0], self.node)

    def shares(self, wrench: Array, row: Row) -> list[tuple[Array, Array]]:
        """Return the adjoint, and the load at the node."""
        return [(self.action, wrench @ self.action)]

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the twist at the flexure's origin."""
        return self.law.twist(wrench @ self.action, row) @ self.action.T

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the transported tangent."""
        return self.action @ self.law.tangent(wrench @ self.action, row) @ self.action.T

    def moved(self, step: Array) -> AtNode:
        """Return the law at the node, moved."""
        return AtNode(self.law.moved(step), self.node)

    @cached_property
    def constant(self) -> Array | None:
        """The transported compliance, as symmetric as it was."""
        known = self.law.constant
        if known is None:
            return None
        moved = self.action @ known @ self.action.T
        return 0.5 * (moved + moved.T) if (known == known.T).all() else moved

    def affine(self, row: Row) -> tuple[Array, Array] | None:
        """Return the transported twist without load and compliance."""
        known = self.law.affine(row)
        return None if known is None else (known[0] @ self.action.T, self.action @ known[1] @ self.action.T)

    def compliance_bound(self, ranges: Ranges) -> Array | None:
        """Return bounds of the transported tangent's blocks."""
        known, carried = self.law.compliance_bound(ranges), np.array([[1.0, np.linalg.norm(self.node)], [0.0, 1.0]])
        return None if known is None else carried @ known @ carried.T

    def learned(self, travel: Ranges) -> AtNode | None:
        """Return what is learned of the law, at the node."""
        free = self.law.learned(travel)
        return None if free is None else AtNode(free, self.node)
