"""The oil in a cylinder whose valves are closed: twist = C(q) wrench along the cylinder, softest in mid stroke.

With b the bulk modulus and V1 = A1 (q - lower) + V0, V2 = A2 (upper - q) + V0 the oil on either side of the piston,

    stiffness = b A1^2 / V1 + b A2^2 / V2         (Merritt, Hydraulic Control Systems, 1967, section 6-1)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from armflex.conventions import Array
from armflex.laws.law import Compliance, Parameter, Ranges, Row, block_norms
from armflex.laws.terms import Factor, Of, Terms, powers, straight

ALONG = np.diag([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class OilColumn(Compliance):
    """A cylinder's compliance along itself, by its length.

    Attributes:
        cylinder: The cylinder, whose length [m] is its position.
        areas: Of the piston, and of it without the rod [m^2].
        lower, upper: Lengths between the pins at the ends of the stroke [m].
        dead_volume: Oil beside the stroke on each side, in pipes and at the ends [m^3].
        bulk_modulus: [Pa].
        relative_std: Relative standard uncertainty of the bulk modulus; 0 for none.
        factor: What calibration found to multiply the compliance by, dimensionless.
    """

    cylinder: str
    areas: tuple[float, float]
    lower: float
    upper: float
    dead_volume: float
    bulk_modulus: float
    relative_std: float = 0.0
    factor: float = 1.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The bulk modulus."""
        return (Parameter("bulk_modulus", "Pa", self.relative_std * self.bulk_modulus),)

    @property
    def values(self) -> Array:
        """[Pa]."""
        return np.array([self.bulk_modulus])

    def at(self, values: Array) -> OilColumn:
        return replace(self, bulk_modulus=float(values[0]))

    def compliance(self, row: Row) -> Array:
        length = row.position(self.cylinder)
        if length.ndim:
            length = np.clip(length, self.lower, self.upper)
        else:  # a row of a control loop
            length = min(max(float(length), self.lower), self.upper)
        (head, ring), dead = self.areas, self.dead_volume
        first, second = head * (length - self.lower) + dead, ring * (self.upper - length) + dead
        softness = first * second / (self.bulk_modulus * (head**2 * second + ring**2 * first))
        compliance = self.factor * softness
        return (compliance[..., None, None] if isinstance(compliance, np.ndarray) else compliance) * ALONG

    def terms(self) -> Terms:
        """Return the same within the stroke: with u = q - lower, V1 V2 / (A1^2 V2 + A2^2 V1) by polynomial division."""
        (head, ring), dead, stroke, column = self.areas, self.dead_volume, self.upper - self.lower, f"q_{self.cylinder}"
        full, size = ring * stroke + dead, self.factor / self.bulk_modulus * ALONG
        above = -head * ring, head * full - ring * dead, dead * full  # of u^2, u and 1
        below, falls = head**2 * full + ring**2 * dead, head * ring * (head - ring)  # below - falls u
        if falls <= 0.0:  # both sides are as wide: no quotient
            shares = [(above[2] / below, 0), (above[1] / below, 1), (above[0] / below, 2)]
            return [straight(share * size, *powers(column, number, self.lower)) for share, number in shares]
        slope = -above[0] / falls
        level = (slope * below - above[1]) / falls
        rest = (above[2] - level * below) / falls
        nearer = Factor(Of.OVERLAP, column, (below / falls - stroke, self.upper))  # 1 / (below / falls - u)
        return [
            straight(level * size),
            straight(slope * size, *powers(column, 1, self.lower)),
            straight(rest * size, nearer),
        ]

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the change of the twist with the bulk modulus: the less compliant, the more of it."""
        return -(self.compliance(row) @ wrench[..., None]) / self.bulk_modulus

    def compliance_bound(self, ranges: Ranges) -> Array | None:
        """Return the norms of a compliance that both sides full of oil would have."""
        full = [
            self.bulk_modulus * area**2 / (area * (self.upper - self.lower) + self.dead_volume) for area in self.areas
        ]
        return block_norms(self.factor / sum(full) * ALONG)

    def gives(self, row: Row) -> tuple[int, ...]:
        """Return the axis along the cylinder, which gives but at an end of its stroke without dead volume."""
        return (0,)

    def scaled(self, factor: Array) -> OilColumn:
        return replace(self, factor=self.factor * float(factor[0]) ** 2)
