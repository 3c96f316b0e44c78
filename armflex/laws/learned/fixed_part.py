"""A law taken as it was trained, about which only a correction is learned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.laws.law import Law, Row
from armflex.laws.learned.part import Group


@dataclass(frozen=True, eq=False)
class FixedPart:
    """A law without parameters."""

    declared: Law
    groups: tuple[Group, ...] = ()

    @property
    def start(self) -> Array:
        """Nothing."""
        return np.zeros(0)

    def twist(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the law's twist."""
        return self.declared.twist(wrench, row)

    def tangent(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the law's tangent."""
        return self.declared.tangent(wrench, row)

    def by_values(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the derivative by no values."""
        return np.zeros((*wrench.shape, 0))

    def law(self, values: Array) -> Law | None:
        """Return the law."""
        return self.declared
