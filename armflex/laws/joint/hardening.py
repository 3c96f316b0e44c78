"""Hardening law: a compliance that falls with the load, as of preloaded rollers, whose contacts grow.

    twist = C w / sqrt(1 + e),   e = w' C w / (2 energy)

It is the gradient of an energy in the load, so that no round trip gains any, and its tangent, exact, is symmetric,
positive and never more than C.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.declaration import Declaration
from armflex.laws.joint.carried import scaled
from armflex.laws.joint.linear import declared_std, read_compliance
from armflex.laws.joint.log_compliance import LOOSE
from armflex.laws.law import Law, Parameter, Ranges, Row, Transform, block_norms, sole_axis
from armflex.laws.terms import Term, Terms, power

EXAMPLE = """
model = "hardening"
compliance = [1e-8, 2e-8, 1e-8, 1e-6, 2e-6, 1e-6]  # under a small load: the diagonal [m/N, rad/Nm], or 6 x 6
energy = 0.5  # w' C w / 2 [J] at which it has fallen to 1/sqrt(2)
relative_std = 0.05  # of every axis' compliance and of the energy; optional
"""


@dataclass(frozen=True)
class HardeningLaw(Law):
    """A compliance that falls with the load. Its values are logarithms: of every axis' compliance, and of the energy.

    Attributes:
        compliance: (6, 6) C under a small load [m/N, rad/Nm and mixed].
        energy: w' C w / 2 [J] at which the compliance has fallen to 1/sqrt(2).
        relative_std: Relative standard uncertainty of all parameters; 0 for none.
    """

    compliance: Array
    energy: float
    relative_std: float = 0.0

    @cached_property
    def sole_axis(self) -> int | None:
        """Of the compliance under a small load."""
        return sole_axis(self.compliance)

    @property
    def _axes(self) -> list[int]:
        return [axis for axis in self.projections if self.compliance[axis, axis] > 0.0]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """A factor on every compliant axis (C becomes S C S), or on a hinge as a whole, and one on the energy."""
        names = (*(TWIST_NAMES[axis] for axis in self._axes), "energy")
        return tuple(Parameter(name, "1", self.relative_std, Transform.LOG) for name in names)

    @property
    def values(self) -> Array:
        return np.log([*np.diag(self.compliance)[self._axes], self.energy])

    def at(self, values: Array) -> HardeningLaw:
        root = np.ones(6)
        root[self._axes] = np.exp(0.5 * (values - self.values)[:-1])
        softer = cast(HardeningLaw, scaled(self, root))
        return replace(softer, energy=float(np.exp(values[-1])))

    def terms(self) -> Terms:
        """Return C w (1 + e)^-1/2."""
        falls = power(self.compliance / (2.0 * self.energy), -0.5, 1.0)
        return (Term(np.zeros(6), self.compliance, features=(falls,)),)

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return half of E f + J E w for every axis, f being the twist and J its tangent; and f e / (2 (1 + e))."""
        twist, tangent = self.twist(wrench, row), self.tangent(wrench, row)
        by_axes = self.by_factors(self._axes, wrench, twist, tangent)
        share = (wrench * (wrench @ self.compliance)).sum(axis=-1, keepdims=True) / (2.0 * self.energy)
        return np.concatenate([by_axes, (twist * 0.5 * share / (1.0 + share))[..., None]], axis=-1)

    def compliance_bound(self, ranges: Ranges) -> Array:
        """Return the norms of C's blocks on the diagonal, their geometric mean beside it: J is positive, C - J, too."""
        root = np.sqrt(np.diag(block_norms(self.compliance)))
        return np.outer(root, root)

    def learned(self, travel: Ranges) -> HardeningLaw:
        """Return the law, all of it as uncertain as declared."""
        return replace(self, relative_std=self.relative_std or LOOSE)

    def scaled(self, factor: Array) -> HardeningLaw:
        """Return the law of S C S: the energy that it is compared with is the same."""
        return replace(self, compliance=self.compliance * np.outer(factor, factor))


def read_hardening(table: Declaration, joint: str, ranges: Ranges) -> HardeningLaw:
    """Return the law that an arm.toml declares: `compliance`, `energy`, and optionally `relative_std`."""
    compliance, energy = read_compliance(table), table.number("energy")
    if energy <= 0.0:
        raise table.fail("energy", f"expected more than 0 J, got {energy:g}")
    return HardeningLaw(compliance, energy, declared_std(table))
