"""A compliance learned about a declared one: C = R exp(T) R', C0 = R R', T symmetric.

Whatever T is, C stays symmetric (Betti) and positive. On the diagonal of T are logarithms of factors, beside it the
coupling of axes. T may be a polynomial in a joint's position: a mast is softer when it is out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.laws.joint.linear import LinearLaw
from armflex.laws.joint.position_dependent import PositionDependentLaw
from armflex.laws.law import Law, Row
from armflex.laws.learned.part import Group

LOOSE = 0.5
"""Prior standard deviation of a factor's logarithm where nothing was declared."""

LEAST = 0.1
"""What a step leaves at least of what an axis gave: a compliance stays one."""

NOWHERE = Row(np.zeros(0), {})
"""For laws that are the same everywhere."""

COUPLED, BENT = 0.05, 0.3
"""Where the search for the size of couplings and of what depends on position starts."""


@dataclass(frozen=True, eq=False)
class CompliancePart:
    """A compliance of parameters.

    Attributes:
        declared: The law with the compliance C0, constant or of joint positions; axes that are rigid there stay so.
        axes: Those that give.
        std: Prior standard deviation of each axis' factor's logarithm, one for all where they are alike.
        joint: The joint whose position counts, None where none does.
        middle, reach: Middle and half of the joint's travel [rad or m].
        degree: Of the polynomial in the position, 0 for none.
    """

    declared: Law
    axes: tuple[int, ...]
    std: float | tuple[float, ...] = LOOSE
    joint: str | None = None
    middle: float = 0.0
    reach: float = 1.0
    degree: int = 0

    @property
    def groups(self) -> tuple[Group, ...]:
        """Factors and couplings; then the same for every power of the position."""
        names = ["/".join(dict.fromkeys((TWIST_NAMES[i], TWIST_NAMES[j]))) for i, j in self._entries]
        own, count = tuple(names), len(self.axes)
        groups = [*self._factors(own[:count]), Group("couplings", own[count:], COUPLED, True)]
        powers = [tuple(f"{name}@{power}" for name in names) for power in range(1, self.degree + 1)]
        return tuple(group for group in groups if group.labels) + tuple(
            Group(f"position {power}", labels, BENT, True) for power, labels in enumerate(powers, 1)
        )

    def _factors(self, names: tuple[str, ...]) -> list[Group]:
        if isinstance(self.std, float):
            return [Group("factors", names, self.std, False)]
        return [Group(f"factor {name}", (name,), std, False) for name, std in zip(names, self.std, strict=True)]

    @property
    def start(self) -> Array:
        """Zero: the declared compliance."""
        return np.zeros(len(self._entries) * (self.degree + 1))

    def twist(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return C w."""
        return (self.tangent(values, wrench, row) @ wrench[..., None])[..., 0]

    def tangent(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return C."""
        size, vectors = self._eigen(values, row)
        own = self._slim(row) @ vectors
        compliance = (own * np.exp(size)[..., None, :]) @ np.swapaxes(own, -1, -2)
        return np.broadcast_to(compliance, (*wrench.shape[:-1], 6, 6))

    def by_values(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the derivative, exp's being known where T is diagonal (Daleckii and Krein)."""
        size, vectors = self._eigen(values, row)
        own, turned = self._slim(row) @ vectors, vectors[..., None, :, :]
        units = np.swapaxes(turned, -1, -2) @ self._units @ turned
        load = (np.swapaxes(own, -1, -2) @ wrench[..., None])[..., 0]
        change = ((_divided(size)[..., None, :, :] * units) @ load[..., None, :, None])[..., 0]
        by_entry = own @ np.swapaxes(change, -1, -2)
        return np.concatenate([by_entry * power for power in self._powers(row, 2)], axis=-1)

    def stepped(self, values: Array, step: Array) -> Array:
        """Return values whose compliance is that of a step away to first order, softened or stiffened to a point.

        No direction is left with less than `LEAST` of what it gave. For a compliance that no position counts in.
        """
        size, vectors = np.linalg.eigh(np.tensordot(values, self._units, axes=1))
        half = np.exp(0.5 * size)
        change = _divided(size) * (vectors.T @ np.tensordot(step, self._units, axes=1) @ vectors)
        grown, turned = np.linalg.eigh(change / np.outer(half, half))
        factor = (vectors * half) @ turned
        told, axes = np.linalg.eigh(factor * np.maximum(1.0 + grown, LEAST) @ factor.T)
        logarithm = (axes * np.log(told)) @ axes.T
        places = {axis: place for place, axis in enumerate(self.axes)}
        return np.array([logarithm[places[i], places[j]] for i, j in self._entries])

    def law(self, values: Array) -> Law | None:
        """Return a linear law where no position counts."""
        if self.degree or self._constant is None:
            return None
        return LinearLaw(self.tangent(values, np.zeros(6), NOWHERE).copy())

    def _slim(self, row: Row) -> Array:
        """Return the (..., 6, n) columns of R that act."""
        if self._constant is not None:
            return self._constant
        return root_of(self.declared.tangent(np.zeros(6), row))[..., self.axes]

    @cached_property
    def _constant(self) -> Array | None:
        """(6, n) columns of R where the declared compliance is one."""
        if isinstance(self.declared, PositionDependentLaw):
            return None
        return root_of(self.declared.tangent(np.zeros(6), NOWHERE))[:, self.axes]

    @cached_property
    def _entries(self) -> list[tuple[int, int]]:
        """Entries of T, the diagonal first."""
        pairs = [(i, j) for place, i in enumerate(self.axes) for j in self.axes[place + 1 :]]
        return [*((i, i) for i in self.axes), *pairs]

    @cached_property
    def _units(self) -> Array:
        """(e, n, n) symmetric matrix of each entry."""
        units = np.zeros((len(self._entries), 6, 6))
        for unit, (i, j) in zip(units, self._entries, strict=True):
            unit[i, j] = unit[j, i] = 1.0
        return units[:, self.axes][:, :, self.axes]

    def _eigen(self, values: Array, row: Row) -> tuple[Array, Array]:
        """Return eigenvalues (..., n) and vectors (..., n, n) of T."""
        entries = values.reshape(self.degree + 1, -1)
        total = sum(power * part for power, part in zip(self._powers(row, 1), entries, strict=True))
        return np.linalg.eigh(np.tensordot(total, self._units, axes=1))

    def _powers(self, row: Row, further: int) -> list[Array]:
        """Return the powers of the scaled position from 0 on, with as many axes more."""
        if not self.degree or self.joint is None:
            return [np.ones(1)]
        position = (np.asarray(row.position(self.joint)) - self.middle) / self.reach
        position = position.reshape(*position.shape, *(1,) * further)
        return [position**power for power in range(self.degree + 1)]


def root_of(compliance: Array) -> Array:
    """Return R with C = R R' for positive semi-definite (..., 6, 6) compliances, diagonal where C is."""
    scale = np.sqrt(np.diagonal(compliance, axis1=-2, axis2=-1))
    unit = np.where(scale > 0.0, scale, 1.0)
    size, vectors = np.linalg.eigh(compliance / (unit[..., :, None] * unit[..., None, :]))
    root = (vectors * np.sqrt(np.maximum(size, 0.0))[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return scale[..., :, None] * root


def _divided(size: Array) -> Array:
    """Return the (..., n, n) divided differences of exp at (..., n) numbers."""
    half = 0.5 * (size[..., :, None] - size[..., None, :])
    mean = 0.5 * (size[..., :, None] + size[..., None, :])
    far = np.where(np.abs(half) < 1e-6, 1.0, half)
    return np.exp(mean) * np.where(np.abs(half) < 1e-6, 1.0 + half**2 / 6.0, np.sinh(far) / far)
