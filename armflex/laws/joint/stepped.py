"""A step of a law's values to first order in the twist, as their covariance means it."""

from __future__ import annotations

from dataclasses import dataclass

from armflex.conventions import Array
from armflex.laws.law import Law, Row, WithoutParameters, by_wrench


@dataclass(frozen=True, eq=False)
class SteppedLaw(WithoutParameters):
    """A law as if it were straight in its values, a (k,) step of them away. Draws are such steps where a law is not."""

    law: Law
    step: Array

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return the twist, and what the step makes of it."""
        return self.law.twist(wrench, row) + self._change(wrench, row)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return its derivative by the wrench, that of the step by central differences."""
        return self.law.tangent(wrench, row) + by_wrench(self._change, wrench, row)

    def scatter(self, wrench: Array, row: Row) -> Array | None:
        """Return the law's."""
        return self.law.scatter(wrench, row)

    def _change(self, wrench: Array, row: Row) -> Array:
        return self.law.by_values(wrench, row) @ self.step
