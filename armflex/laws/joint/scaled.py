"""Any law made softer or stiffer along its axes, as [prior] compliance frees it: f(w) becomes S f(S w).

Of a compliance C that makes S C S. S = exp(v / 2), v the logarithm of a factor on each axis' own compliance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.laws.joint.at_node import Carried
from armflex.laws.law import Law, Parameter, Row, Transform


@dataclass(frozen=True, eq=False)
class ScaledLaw(Carried):
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
        """S."""
        return np.diag(np.exp(0.5 * self.logarithms))

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


def scaled(law: Law, factor: Array) -> Law:
    """Return S f(S w), S = diag of (6,) factors, as a law of the same kind where there is one."""
    known = law.scaled(factor)
    return ScaledLaw(law, 2.0 * np.log(factor)) if known is None else known
