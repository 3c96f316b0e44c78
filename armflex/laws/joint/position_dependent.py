"""Linear law whose compliance depends on a joint's position: twist = (C + C1 q + C2 q^2 + ...) wrench.

A mast gets softer as it extends: a cantilever's compliance is a cubic in its length, so this form holds it exactly.
Nested stages give the faster the less they overlap, which takes higher powers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.errors import LawError
from armflex.laws.joint.carried import ScaledLaw
from armflex.laws.joint.linear import SYMMETRIC, UPPER, check_compliance, declared_matrix, declared_std, entries
from armflex.laws.joint.log_compliance import LOOSE, LogCompliance
from armflex.laws.law import (
    NOWHERE,
    ONE_NUMBER,
    Compliance,
    Law,
    Parameter,
    Ranges,
    Row,
    block_norms,
    driver_of,
    sole_axis,
)
from armflex.laws.terms import Terms, powers, straight

EXAMPLE = """
model = "position_dependent"
compliance = [1e-8, 2e-8, 1e-8, 1e-6, 2e-6, 1e-6]
compliance_q1 = [1e-10, 0.0, 0.0, 1e-7, 1e-7, 0.0]  # per rad or m of the joint's position; _q2 to _q8 of its powers
relative_std = 0.05
"""

DEGREE = 2
"""Of the polynomial in the position that the law is learned as."""

COEFFICIENTS = ("compliance", *(f"compliance_q{power}" for power in range(1, 9)))
"""Keys of the coefficients, lowest power first."""


@dataclass(frozen=True)
class PositionDependentLaw(Compliance):
    """Compliance polynomial in the position of `joint`.

    Attributes:
        joint: The joint whose position counts.
        coefficients: (d, 6, 6), lowest power first [m/N, rad/Nm and mixed, per m^k or rad^k].
        relative_std: Relative standard uncertainty of every entry of C(q); 0 for none.
    """

    joint: str
    coefficients: Array
    relative_std: float = 0.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """An entry of each coefficient's symmetric matrix."""
        named = [entries(part, self.relative_std, f"@{power}") for power, part in enumerate(self.coefficients)]
        return tuple(of_power[UPPER.index(place)] for of_power in named for place in self._places)

    @property
    def values(self) -> Array:
        """Entries, those of the lowest power first."""
        return np.array([part[place] for part in self.coefficients for place in self._places])

    def at(self, values: Array) -> PositionDependentLaw:
        change = np.reshape(values - self.values, (len(self.coefficients), -1))
        return replace(self, coefficients=self.coefficients + np.tensordot(change, self._basis, axes=1))

    @cached_property
    def sole_axis(self) -> int | None:
        """Of the coefficients where all are one number times the same matrix."""
        sizes = np.trace(self.coefficients, axis1=1, axis2=2)
        of_one = self.coefficients[np.abs(sizes).argmax()] * np.sign(sizes[np.abs(sizes).argmax()])
        if (axis := sole_axis(of_one)) is None:
            return None
        shares = self.coefficients[:, axis, axis] / of_one[axis, axis]
        return (
            axis
            if np.allclose(self.coefficients, np.multiply.outer(shares, of_one), rtol=ONE_NUMBER, atol=0.0)
            else None
        )

    @property
    def _places(self) -> Sequence[tuple[int, int]]:
        """Entries of a coefficient that are numbers of their own."""
        return UPPER if self.sole_axis is None else ((self.sole_axis, self.sole_axis),)

    @cached_property
    def _basis(self) -> Array:
        """(n, 6, 6) what each of them adds to a coefficient."""
        if (axis := self.sole_axis) is None:
            return SYMMETRIC
        of_one = self.coefficients[np.abs(self.coefficients[:, axis, axis]).argmax()]
        return of_one[None] / of_one[axis, axis]

    @property
    def values_covariance(self) -> Array | None:
        """An entry is off by the same part of it at all positions."""
        if self.relative_std == 0.0:
            return None
        along = np.reshape(self.values, (len(self.coefficients), 1, -1)) * np.eye(len(self._basis))
        along = self.relative_std * along.reshape(-1, len(self._basis))
        return along @ along.T

    def compliance(self, row: Row) -> Array:
        position = np.asarray(row.position(self.joint))[..., None, None]
        total = self.coefficients[-1]
        for coefficient in self.coefficients[-2::-1]:
            total = total * position + coefficient
        return total

    def terms(self) -> Terms:
        """Return a term of every power of the position."""
        column = f"q_{self.joint}"
        return [straight(part, *powers(column, exponent)) for exponent, part in enumerate(self.coefficients)]

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the load that each entry multiplies, times the power of the position."""
        position = np.asarray(row.position(self.joint))[..., None, None]
        once = np.swapaxes((self._basis @ wrench[..., None, :, None])[..., 0], -1, -2)
        return np.concatenate([once * position**power for power in range(len(self.coefficients))], axis=-1)

    def compliance_bound(self, ranges: Ranges) -> Array | None:
        """Return the sum of the coefficients' norms, each at the largest power that the joint's range allows."""
        largest = np.abs(ranges[self.joint]).max()
        if not np.isfinite(largest):
            return None
        return np.sum([largest**power * block_norms(part) for power, part in enumerate(self.coefficients)], axis=0)

    def gives(self, row: Row) -> tuple[int, ...]:
        """Return the axes that give anywhere."""
        return tuple(np.flatnonzero(np.diag(np.abs(self.coefficients).sum(axis=0)) > 0.0).tolist())

    def learned(self, travel: Ranges) -> Law:
        """Return the compliance by factors and couplings that are polynomials in the position, over its travel."""
        low, high = travel[self.joint]
        axes, reach = self.gives(NOWHERE), max(0.5 * (high - low), 1e-6)
        start = np.zeros((DEGREE + 1) * len(axes) * (len(axes) + 1) // 2)
        std = self.relative_std or LOOSE
        if self.sole_axis is not None and len(axes) > 1:
            return ScaledLaw(self.certain(), np.zeros(6), (self.sole_axis,), std)
        return LogCompliance(self, axes, std, start, self.joint, 0.5 * (low + high), reach, DEGREE)

    def scaled(self, factor: Array) -> PositionDependentLaw:
        return replace(self, coefficients=self.coefficients * np.outer(factor, factor))


def read_position_dependent(table: Declaration, joint: str, ranges: Ranges) -> PositionDependentLaw:
    """Return the law that an arm.toml declares: `compliance` at zero, `compliance_q1` to `_q8`, `depends_on`."""
    given = [key for key in COEFFICIENTS if table.has(key) or (key == "compliance" and "stiffness" in table.table)]
    powers_of = [COEFFICIENTS.index(key) for key in given or ["compliance"]]
    coefficients = np.zeros((max(3, *powers_of) + 1, 6, 6))
    for power in powers_of:
        coefficients[power] = declared_matrix(table, COEFFICIENTS[power])
    driver, factor, offset = driver_of(table, joint, ranges)
    law = PositionDependentLaw(driver, by_driver(coefficients, factor, offset), declared_std(table))
    for position in np.linspace(*ranges[law.joint], 33):
        try:
            check_compliance(law.compliance(Row(np.array([position]), {law.joint: 0})))
        except LawError as error:
            raise table.fail("compliance", f"at {law.joint} = {position:.4g}: {error}") from None
    return law


def by_driver(coefficients: Array, factor: float, offset: float) -> Array:
    """Return (d, ...) coefficients of a polynomial in x as those in q, x = factor q + offset."""
    position, by_power = np.polynomial.Polynomial((offset, factor)), np.zeros_like(coefficients)
    for power, coefficient in enumerate(coefficients):
        for k, share in enumerate((position**power).coef):
            by_power[k] += share * coefficient
    return by_power
