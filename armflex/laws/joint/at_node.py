"""A law measured at a node some way off the joint frame, carried there by the adjoint.

`T exp6(twist) T^-1 = exp6(Ad_T twist)`, so the transport of the twist is exact, and the wrench follows by duality.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.laws.law import Law, Ranges, Row


@dataclass(frozen=True)
class AtNode(Law):
    """`law` acts in a frame at `node`, (3,) in the flexure's frame [m], axes parallel to it."""

    law: Law
    node: Array

    @cached_property
    def action(self) -> Array:
        """(6, 6) map of a twist at the node to the same motion's twist at the flexure's origin."""
        return pin.SE3(np.eye(3), self.node).action

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the twist at the flexure's origin."""
        return self.law.twist(wrench @ self.action, row) @ self.action.T

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return the transported tangent."""
        return self.action @ self.law.tangent(wrench @ self.action, row) @ self.action.T

    def affine(self, row: Row) -> tuple[Array, Array] | None:
        """Return the transported twist without load and compliance."""
        known = self.law.affine(row)
        return None if known is None else (known[0] @ self.action.T, self.action @ known[1] @ self.action.T)

    def steepest(self, ranges: Ranges) -> Array | None:
        """Return bounds of the transported tangent's blocks."""
        known, carried = self.law.steepest(ranges), np.array([[1.0, np.linalg.norm(self.node)], [0.0, 1.0]])
        return None if known is None else carried @ known @ carried.T

    def covariance(self, wrench: Array, row: Row) -> Array | None:
        """Return the transported covariance."""
        at_node = self.law.covariance(wrench @ self.action, row)
        return None if at_node is None else self.action @ at_node @ self.action.T

    def draw(self, rng: np.random.Generator) -> AtNode:
        """Return a draw of the law, at the same node."""
        return AtNode(self.law.draw(rng), self.node)

    @property
    def trained(self) -> bool:
        """Whether the law at the node was trained."""
        return self.law.trained

    def doubts(self, wrench: Array, row: Row) -> tuple[Flag, ...]:
        """Return the doubts about the load at the node."""
        return self.law.doubts(wrench @ self.action, row)
