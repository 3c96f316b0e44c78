"""Linear law whose compliance depends on a joint's position: twist = (C + C1 q + C2 q^2 + C3 q^3) wrench.

A mast gets softer as it extends: a cantilever's compliance is a cubic in its length, so this form holds it exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.errors import LawError, did_you_mean
from armflex.laws.joint.linear import (
    NOTHING,
    check_compliance,
    declared_matrix,
    declared_std,
    entry_covariance,
    symmetric_normal,
)
from armflex.laws.law import Law, Ranges, Row, block_norms

COEFFICIENTS = ("compliance", "compliance_q1", "compliance_q2", "compliance_q3")


@dataclass(frozen=True)
class PositionDependentLaw(Law):
    """Compliance polynomial in the position of `joint`.

    Attributes:
        joint: The joint whose position counts.
        coefficients: (d, 6, 6), lowest power first [m/N, rad/Nm and mixed, per m^k or rad^k].
        relative_std: Relative standard uncertainty of every entry of C(q); 0 for none.
    """

    joint: str
    coefficients: Array
    relative_std: float = 0.0

    def compliance(self, row: Row) -> Array:
        """Return the (..., 6, 6) compliance at the row's joint position."""
        position = np.asarray(row.position(self.joint))[..., None, None]
        total = self.coefficients[-1]
        for coefficient in self.coefficients[-2::-1]:
            total = total * position + coefficient
        return total

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return C(q) w."""
        return np.einsum("...ij,...j->...i", self.compliance(row), wrench)

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return C(q)."""
        return self.compliance(row)

    def affine(self, row: Row) -> tuple[Array, Array]:
        """Return no twist and C(q)."""
        return NOTHING, self.compliance(row)

    def steepest(self, ranges: Ranges) -> Array | None:
        """Return the sum of the coefficients' norms, each at the largest power that the joint's range allows."""
        largest = np.abs(ranges[self.joint]).max()
        if not np.isfinite(largest):
            return None
        return sum(largest**power * block_norms(part) for power, part in enumerate(self.coefficients))

    def draw(self, rng: np.random.Generator) -> PositionDependentLaw:
        """Return the law with every pair of entries off by its relative error, the same at all positions."""
        factor = 1.0 + self.relative_std * symmetric_normal(rng)
        return PositionDependentLaw(self.joint, self.coefficients * factor)

    def covariance(self, wrench: Array, row: Row) -> Array | None:
        """Return the (6, 6) covariance of C(q) w, None when the law is declared certain."""
        if self.relative_std == 0.0:
            return None
        return entry_covariance(self.compliance(row), wrench, self.relative_std)


def read_position_dependent(table: Declaration, joint: str, ranges: Ranges) -> PositionDependentLaw:
    """Return the law that an arm.toml declares: `compliance` at zero, `compliance_q1` to `_q3`, `depends_on`."""
    given = [key for key in COEFFICIENTS if table.has(key)]
    coefficients = np.zeros((4, 6, 6))
    for key in given or ["compliance"]:
        coefficients[COEFFICIENTS.index(key)] = declared_matrix(table, key)
    law = PositionDependentLaw(table.text("depends_on", joint), coefficients, declared_std(table))
    if law.joint not in ranges:
        raise table.fail(
            "depends_on", f"{law.joint!r} is no moving joint of the chain{did_you_mean(law.joint, ranges)}"
        )
    try:
        check_range(law, *ranges[law.joint])
    except LawError as error:
        raise table.fail("compliance", str(error)) from None
    return law


def check_range(law: PositionDependentLaw, lower: float, upper: float) -> None:
    """Raise `LawError` where the compliance stops being symmetric or positive anywhere in the joint's range."""
    for position in np.linspace(lower, upper, 33):
        try:
            check_compliance(law.compliance(Row(np.array([position]), {law.joint: 0})))
        except LawError as error:
            raise LawError(f"at {law.joint} = {position:.4g}: {error}") from None
