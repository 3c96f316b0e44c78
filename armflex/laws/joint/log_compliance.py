"""A compliance learned about a declared one: C = R exp(T) R', C0 = R R', T symmetric.

Whatever T is, C stays symmetric (Betti) and positive. On the diagonal of T are logarithms of factors, beside it the
coupling of axes. T may be a polynomial in a joint's position: a mast is softer when it is out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import UnsupportedError
from armflex.laws.law import LEAST, NOWHERE, Compliance, Law, Parameter, Row, SteppedLaw, Transform
from armflex.laws.terms import Factor, Of, Terms, straight

LOOSE = 0.5
"""Prior standard deviation of a factor's logarithm where nothing was declared."""

DEGREES = (8, 16, 32, 64)

COUPLED, BENT = 0.05, 0.3
"""Where the search for the size of couplings and of what depends on position starts."""


@dataclass(frozen=True, eq=False)
class LogCompliance(Compliance):
    """A compliance by the entries of T, zero being the declared one.

    Attributes:
        declared: The law with the compliance C0, constant or of joint positions; axes that are rigid there stay so.
        axes: Those that give.
        std: Prior standard deviation of each axis' factor's logarithm, one for all where they are alike.
        values: Entries of T, those of the lowest power of the position first; the diagonal before the others.
        joint: The joint whose position counts, None where none does.
        middle, reach: Middle and half of the joint's travel [rad or m].
        degree: Of the polynomial in the position, 0 for none.
    """

    declared: Law
    axes: tuple[int, ...]
    std: float | tuple[float, ...]
    values: Array
    joint: str | None = None
    middle: float = 0.0
    reach: float = 1.0
    degree: int = 0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Factors and couplings; then the same for every power of the position."""
        names = ["/".join(dict.fromkeys((TWIST_NAMES[i], TWIST_NAMES[j]))) for i, j in self._entries]
        alike, count = not isinstance(self.std, tuple), len(self.axes)
        stds = self.std if isinstance(self.std, tuple) else (self.std,) * count
        parameters = [
            Parameter(name, "1", std, Transform.LOG, "factors" if alike else f"factor {name}")
            for name, std in zip(names[:count], stds, strict=True)
        ]
        parameters += [Parameter(name, "1", COUPLED, group="couplings", sized=True) for name in names[count:]]
        for power in range(1, self.degree + 1):
            parameters += [
                Parameter(f"{name}@{power}", "1", BENT, group=f"position {power}", sized=True) for name in names
            ]
        return tuple(parameters)

    def at(self, values: Array) -> LogCompliance:
        return replace(self, values=values)

    def compliance(self, row: Row) -> Array:
        size, vectors = self._eigen(row)
        axes = self._slim(row) @ vectors
        return (axes * np.exp(size)[..., None, :]) @ np.swapaxes(axes, -1, -2)

    @cached_property
    def constant(self) -> Array | None:
        """C where no position counts."""
        return None if self.degree or self._same is None else self.compliance(NOWHERE)

    def terms(self) -> Terms:
        """Return the compliance as a polynomial in the joint's position over its travel, to rounding."""
        if self.joint is None or self.constant is not None:
            return super().terms()
        for degree in DEGREES:
            places = np.cos(np.pi * (np.arange(2 * degree) + 0.5) / (2 * degree))
            row = Row((self.middle + self.reach * places)[:, None], {self.joint: 0})
            wanted = self.compliance(row).reshape(len(places), 36)
            values = np.polynomial.chebyshev.chebvander(places, degree)
            coefficients = np.asarray(np.linalg.lstsq(values, wanted, rcond=None)[0], float)
            # Relative error of a compliance as a polynomial in a joint's position; more degrees than these are not
            # tried
            if np.abs(values @ coefficients - wanted).max() <= 1e-13 * np.abs(wanted).max():
                column, parts = f"q_{self.joint}", enumerate(coefficients.reshape(-1, 6, 6))
                numbers = (self.middle, self.reach)
                return [straight(part, Factor(Of.CHEBYSHEV, column, (*numbers, float(n)))) for n, part in parts]
        raise UnsupportedError(f"bends too much with {self.joint} for a polynomial of degree {DEGREES[-1]}")

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the derivative, exp's being known where T is diagonal (Daleckii and Krein)."""
        size, vectors = self._eigen(row)
        axes, turned = self._slim(row) @ vectors, vectors[..., None, :, :]
        units = np.swapaxes(turned, -1, -2) @ self._units @ turned
        load = (np.swapaxes(axes, -1, -2) @ wrench[..., None])[..., 0]
        change = ((_divided(size)[..., None, :, :] * units) @ load[..., None, :, None])[..., 0]
        by_entry = axes @ np.swapaxes(change, -1, -2)
        return np.concatenate([by_entry * power for power in self._powers(row, 2)], axis=-1)

    def scatter(self, wrench: Array, row: Row) -> Array | None:
        return self.declared.scatter(wrench, row)

    def moved(self, step: Array) -> Law:
        """Return the law whose twist is that of a step away, to first order in the entries.

        They are logarithms: far from where they were fitted a law bends in them, and what they do against each other no
        longer cancels. Where no position counts the compliance itself takes the step, softened or stiffened to a point:
        no direction is left with less than `LEAST` of what it gave.
        """
        if self.degree:
            return SteppedLaw(self, step)
        size, vectors = np.linalg.eigh(np.tensordot(self.values, self._units, axes=1))
        half = np.exp(0.5 * size)
        change = _divided(size) * (vectors.T @ np.tensordot(step, self._units, axes=1) @ vectors)
        grown, turned = np.linalg.eigh(change / np.outer(half, half))
        factor = (vectors * half) @ turned
        values, axes = np.linalg.eigh(factor * np.maximum(1.0 + grown, LEAST) @ factor.T)
        logarithm = (axes * np.log(values)) @ axes.T
        places = {axis: place for place, axis in enumerate(self.axes)}
        return self.at(np.array([logarithm[places[i], places[j]] for i, j in self._entries]))

    def _slim(self, row: Row) -> Array:
        """Return the (..., 6, n) columns of R that act."""
        if self._same is not None:
            return self._same
        return root_of(self.declared.tangent(np.zeros(6), row))[..., self.axes]

    @cached_property
    def _same(self) -> Array | None:
        """(6, n) columns of R where the declared compliance is the same everywhere."""
        return None if self.declared.constant is None else root_of(self.declared.constant)[:, self.axes]

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

    def _eigen(self, row: Row) -> tuple[Array, Array]:
        """Return eigenvalues (..., n) and vectors (..., n, n) of T."""
        entries = self.values.reshape(self.degree + 1, -1)
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
