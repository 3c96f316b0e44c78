"""A part that acts at a node off the flexure: its twist is carried there by the adjoint, its load by duality."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.laws.joint.at_node import AtNode
from armflex.laws.joint.linear import LinearLaw
from armflex.laws.law import Law, Row
from armflex.laws.learned.part import OfPart, Part


@dataclass(frozen=True, eq=False)
class NodePart(OfPart):
    """`part` in a frame at the node of `declared`, axes parallel to the flexure's."""

    declared: AtNode
    part: Part

    def twist(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the twist at the flexure."""
        return self.part.twist(values, wrench @ self._action, row) @ self._action.T

    def tangent(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return its derivative by the wrench."""
        return self._action @ self.part.tangent(values, wrench @ self._action, row) @ self._action.T

    def by_values(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return its derivative by the values."""
        return self._action @ self.part.by_values(values, wrench @ self._action, row)

    def law(self, values: Array) -> Law | None:
        """Return a compliance moved to the flexure, other laws at the node."""
        law = self.part.law(values)
        if isinstance(law, LinearLaw):
            moved = self._action @ law.compliance @ self._action.T
            return LinearLaw(0.5 * (moved + moved.T))
        return None if law is None else AtNode(law, self.declared.node)

    @cached_property
    def _action(self) -> Array:
        return np.asarray(self.declared.action)
