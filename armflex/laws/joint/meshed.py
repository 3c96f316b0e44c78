"""A condensed mesh as a law: its compliance times one factor, as Young's modulus, welds and bolts leave it open."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.fem.part import Drawing
from armflex.laws.joint.log_compliance import LOOSE
from armflex.laws.law import Compliance, Parameter, Ranges, Row, Transform


@dataclass(frozen=True, eq=False)
class MeshedLaw(Compliance):
    """A constant compliance with one parameter, the logarithm of a factor on all of it.

    Attributes:
        meshed: (6, 6) compliance as the mesh has it [m/N, rad/Nm and mixed].
        relative_std: Relative standard uncertainty of the factor; 0 for none.
        drawing: The mesh, as pages draw it; None for none.
        logarithm: Of the factor.
    """

    meshed: Array
    relative_std: float = 0.0
    drawing: Drawing | None = None
    logarithm: float = 0.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The factor."""
        return (Parameter("young", "1", self.relative_std, Transform.LOG),)

    @property
    def values(self) -> Array:
        """(1,) logarithm of the factor, dimensionless."""
        return np.array([self.logarithm])

    def at(self, values: Array) -> MeshedLaw:
        return replace(self, logarithm=float(values[0]))

    @cached_property
    def constant(self) -> Array:
        return np.exp(self.logarithm) * self.meshed

    def compliance(self, row: Row) -> Array:
        """Return the mesh's, times the factor: (6, 6) [m/N, rad/Nm and mixed]."""
        return self.constant

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the twist: it grows as the factor does."""
        return self.twist(wrench, row)[..., None]

    def learned(self, travel: Ranges) -> MeshedLaw:
        """Return the law, its factor as uncertain as declared."""
        return replace(self, relative_std=self.relative_std or LOOSE)

    def scaled(self, factor: Array) -> MeshedLaw:
        return replace(self, meshed=self.meshed * np.outer(factor, factor))
