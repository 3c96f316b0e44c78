"""A step of a learned law's values to first order in the twist, as their covariance means it.

Values are logarithms and weights: far from where they were fitted a law bends in them, and what they do against each
other no longer cancels. Draws are steps of the twist instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.laws.law import Law, Row
from armflex.laws.learned.compliance_part import CompliancePart
from armflex.laws.learned.node_part import NodePart
from armflex.laws.learned.part import OfPart, Part

STEP = 1e-4
"""Relative step of the load for derivatives: they steer Newton's steps and do not enter the solution."""


@dataclass(frozen=True, eq=False)
class Linearised(OfPart):
    """A part that is straight in its values, as it is at a point of them."""

    part: Part
    point: Array

    def twist(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the twist at the point, and what a step of the values makes of it."""
        return self.part.twist(self.point, wrench, row) + self._step(values, wrench, row)

    def tangent(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return its derivative by the wrench, that of the step by central differences."""
        size = STEP * np.maximum(np.abs(wrench), 1e-3 * max(float(np.abs(wrench).max(initial=0.0)), 1.0))
        columns = []
        for i, unit in enumerate(np.eye(6)):
            ends = [self._step(values, wrench + side * size[..., i, None] * unit, row) for side in (1.0, -1.0)]
            columns.append((ends[0] - ends[1]) / (2.0 * size[..., i, None]))
        return self.part.tangent(self.point, wrench, row) + np.stack(columns, axis=-1)

    def by_values(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the derivative at the point."""
        return self.part.by_values(self.point, wrench, row)

    def law(self, values: Array) -> Law | None:
        """Return None: solvers know no such law."""
        return None

    def _step(self, values: Array, wrench: Array, row: Row) -> Array:
        return self.part.by_values(self.point, wrench, row) @ (values - self.point)


def moved(part: Part, values: Array, step: Array) -> tuple[Part, Array]:
    """Return a part and values that give the twist of `part` a step of its values away, to first order."""
    if isinstance(part, CompliancePart) and not part.degree:
        return part, part.stepped(values, step)
    if isinstance(part, NodePart):
        inner, there = moved(part.part, values, step)
        return NodePart(part.declared, inner), there
    return Linearised(part, values), values + step
