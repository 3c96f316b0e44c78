"""Any law made softer or stiffer along its axes, as [prior] compliance frees it: f(w) becomes S f(S w).

Of a compliance C that makes S C S. S = exp(v / 2), v the logarithm of a factor on each axis' own compliance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.laws.law import Composed, Law, Ranges, Row, block_norms
from armflex.laws.parameter import Parameter, Transform


@dataclass(frozen=True, eq=False)
class ScaledLaw(Composed):
    """A law scaled along some axes. Its parameters are the factors' logarithms; what the law does not know stays its.

    Attributes:
        law: What is scaled.
        logarithms: (6,) of the factors.
        axes: Those whose factors are parameters.
        std: Standard deviation of each.
    """

    law: Law
    logarithms: Array
    axes: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    std: float = 0.0

    @property
    def laws(self) -> tuple[Law]:
        """The law."""
        return (self.law,)

    def with_laws(self, laws: Sequence[Law]) -> ScaledLaw:
        """Return another law so scaled."""
        return replace(self, law=laws[0])

    def shares(self, wrench: Array, row: Row) -> list[tuple[Array, Array]]:
        """Return S, and the scaled load."""
        return [(np.diag(self._root_factor), wrench * self._root_factor)]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """A factor on each axis."""
        return tuple(Parameter(TWIST_NAMES[axis], "1", self.std, Transform.LOG) for axis in self.axes)

    @property
    def values(self) -> Array:
        """Logarithms."""
        return self.logarithms[list(self.axes)]

    def at(self, values: Array) -> ScaledLaw:
        """Return the law with other factors."""
        logarithms = self.logarithms.copy()
        logarithms[list(self.axes)] = values
        return replace(self, logarithms=logarithms)

    @property
    def values_covariance(self) -> Array | None:
        """That of the factors."""
        return np.diag(np.full(len(self.axes), self.std**2)) if self.std else None

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return half of E f + J E w for every axis, f being the scaled law and J its tangent."""
        twist, tangent = self.twist(wrench, row), self.tangent(wrench, row)
        change = 0.5 * (np.eye(6) * twist[..., None, :] + tangent * wrench[..., None, :])
        return change[..., list(self.axes)]

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return S f(S w)."""
        return self._root_factor * self.law.twist(wrench * self._root_factor, row)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return S J(S w) S."""
        return self._square * self.law.tangent(wrench * self._root_factor, row)

    @cached_property
    def constant(self) -> Array | None:
        """S C S where there is a C."""
        return None if self.law.constant is None else self._square * self.law.constant

    def affine(self, row: Row) -> tuple[Array, Array] | None:
        """Return the scaled twist without load and S C S."""
        known = self.law.affine(row)
        return None if known is None else (self._root_factor * known[0], self._square * known[1])

    def compliance_bound(self, ranges: Ranges) -> Array | None:
        """Return the bounds of the law times the largest factors."""
        known, most = self.law.compliance_bound(ranges), self._root_factor.reshape(2, 3).max(axis=1)
        if self.constant is not None:
            return block_norms(self.constant)
        return None if known is None else np.outer(most, most) * known

    @cached_property
    def _root_factor(self) -> Array:
        """(6,) diagonal of S."""
        return np.exp(0.5 * self.logarithms)

    @cached_property
    def _square(self) -> Array:
        return np.outer(self._root_factor, self._root_factor)


def scaled(law: Law, factor: Array) -> Law:
    """Return S f(S w), S = diag of (6,) factors, as a law of the same kind where there is one."""
    known = law.scaled(factor)
    return ScaledLaw(law, 2.0 * np.log(factor)) if known is None else known
