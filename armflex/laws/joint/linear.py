"""Linear law: twist = C wrench, C a constant compliance, diagonal or full (the paper's eq. (7), inverted)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.declaration import Declaration
from armflex.errors import Flag, LawError, did_you_mean
from armflex.laws.joint.carried import ScaledLaw
from armflex.laws.joint.log_compliance import LOOSE, LogCompliance
from armflex.laws.law import Law, Parameter, Ranges, Row, block_diagonal, check_ordered, embed
from armflex.storage.schema import Numbers

SYMMETRY = 1e-9


SOFTEST = (1e-5, 1e-3)
"""m/N and rad/Nm beyond which a single joint of steel is implausible; a hint at a wrong unit, no more."""

EXAMPLE = """
model = "linear"
compliance = [1e-8, 2e-8, 1e-8, 1e-6, 2e-6, 1e-6]  # of dx dy dz [m/N], rx ry rz [rad/Nm]; or 6 x 6; or `stiffness`
relative_std = 0.05  # of every entry, of a single hinge as a whole; optional
"""


ARRAYS = {
    "compliance": Numbers(("k", "k")),
    "row_covariance": Numbers(("k", "k", "k"), covariance=True),
    "residual_std": Numbers(("k",), least=0.0),
    "loads": Numbers((2, "k")),
}
SIZES = {"k": (3, 6)}
"""Arrays of a fitted law's file."""

UPPER = tuple((i, j) for i in range(6) for j in range(i, 6))
"""Entries of a symmetric matrix."""

SYMMETRIC = np.array([(np.outer(a, b) + np.outer(b, a)) > 0.0 for a, b in np.eye(6)[np.array(UPPER)]], dtype=float)
"""(21, 6, 6) where each stands."""


@dataclass(frozen=True)
class LinearFit:
    """What a fitted compliance does not know.

    Attributes:
        row_covariance: (k, k, k) covariance of each row of coefficients, k = 3 or 6.
        residual_std: (k,) scatter about the fit [m, rad].
        loads: (2, k) smallest and largest load of each component that was seen [N, Nm].
    """

    row_covariance: Array
    residual_std: Array
    loads: Array


@dataclass(frozen=True)
class LinearLaw(Law):
    """Constant compliance. Its parameters are the 21 entries of a declared one, the k rows of k of a fitted one.

    A declared one along one direction alone, as of a drive, has one, however its link's frame is drawn.

    Attributes:
        compliance: (6, 6) [m/N, rad/Nm and mixed].
        relative_std: Relative standard uncertainty of every parameter; 0 for none. Entries are independent but that
            the compliance stays symmetric.
        fit: Uncertainty of a compliance fitted to data, None for a declared one.
    """

    compliance: Array
    relative_std: float = 0.0
    fit: LinearFit | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """An entry each."""
        if self._sole is not None:
            size = self.relative_std * float(self.compliance[self._sole, self._sole])
            named = f"{TWIST_NAMES[self._sole]}:{WRENCH_NAMES[self._sole]}"
            return (Parameter(named, _unit(self._sole, self._sole), size),)
        if self.fit is None:
            return entries(self.compliance, self.relative_std)
        size, stds = len(self.fit.residual_std), np.sqrt(self.fit.row_covariance.diagonal(axis1=1, axis2=2))
        places = [(i, j) for i in range(size) for j in range(size)]
        return tuple(Parameter(f"{TWIST_NAMES[i]}:{WRENCH_NAMES[j]}", _unit(i, j), stds[i, j]) for i, j in places)

    @property
    def values(self) -> Array:
        """Entries [m/N, rad/Nm and mixed]."""
        if self._sole is not None:
            return self.compliance[self._sole, self._sole, None]
        if self.fit is None:
            return self.compliance[np.triu_indices(6)]
        size = len(self.fit.residual_std)
        return self.compliance[:size, :size].ravel()

    @cached_property
    def _sole(self) -> int | None:
        """The axis of a declared compliance that is one number."""
        return None if self.fit is not None else self.sole_axis

    def at(self, values: Array) -> LinearLaw:
        if self._sole is not None:
            return replace(self, compliance=self.compliance * (values[0] / self.values[0]))
        if self.fit is None:
            return replace(self, compliance=self.compliance + np.tensordot(values - self.values, SYMMETRIC, axes=1))
        size, compliance = len(self.fit.residual_std), self.compliance.copy()
        compliance[:size, :size] = np.reshape(values, (size, size))
        return LinearLaw(compliance, fit=self.fit)

    @property
    def values_covariance(self) -> Array | None:
        """Of the rows as fitted, or of entries that are known to some of their size."""
        return super().values_covariance if self.fit is None else block_diagonal(*self.fit.row_covariance)

    def twist(self, wrench: Array, row: Row) -> Array:
        return wrench @ self.compliance.T

    def tangent(self, wrench: Array, row: Row) -> Array:
        if wrench.ndim == 1:  # as nearly always; a broadcast takes longer than the whole answer
            return self.compliance
        return np.broadcast_to(self.compliance, (*wrench.shape[:-1], 6, 6))

    def by_values(self, wrench: Array, row: Row) -> Array:
        """Return the load that each entry multiplies, at the axis that it moves."""
        if self._sole is not None:
            return self.twist(wrench, row)[..., None] / self.values
        if self.fit is None:
            return np.swapaxes((SYMMETRIC @ wrench[..., None, :, None])[..., 0], -1, -2)
        size = len(self.fit.residual_std)
        by_entries = np.zeros((*wrench.shape, size, size))
        by_entries[..., range(size), range(size), :] = wrench[..., None, :size]
        return by_entries.reshape(*wrench.shape, -1)

    def scatter(self, wrench: Array, row: Row) -> Array | None:
        return None if self.fit is None else embed(np.diag(self.fit.residual_std**2))

    @property
    def constant(self) -> Array:
        return self.compliance

    @property
    def trained_on(self) -> Array | None:
        return None if self.fit is None else self.fit.loads

    def certain(self) -> LinearLaw:
        fit = self.fit
        fit_without_scatter = None if fit is None else replace(fit, row_covariance=np.zeros_like(fit.row_covariance))
        return replace(self, relative_std=0.0, fit=fit_without_scatter)

    def freed(self, row: Row) -> tuple[int, ...]:
        """Return the axes that give, of a fitted compliance, too: it is one all the same."""
        return self.gives(row) if self._sole is None else (self._sole,)

    def learned(self, travel: Ranges) -> Law | None:
        """Return the compliance by factors and couplings about this one, as uncertain as declared or fitted."""
        axes, std = tuple(np.flatnonzero(np.diag(self.compliance) > 0.0).tolist()), self.relative_std or LOOSE
        if not np.allclose(self.compliance, self.compliance.T, rtol=1e-9, atol=0.0):
            return None
        if self.fit is not None:
            stds = np.sqrt([self.fit.row_covariance[axis, axis, axis] for axis in axes])
            # Relative standard deviation below which no fit to a bench is taken to know a joint as it is in the arm
            std = tuple(np.clip(stds / np.diag(self.compliance)[list(axes)], 1e-3, LOOSE).tolist())
        elif self._sole is not None and len(axes) > 1:
            return ScaledLaw(self.certain(), np.zeros(6), (self._sole,), self.relative_std or LOOSE)
        return LogCompliance(self, axes, std, np.zeros(len(axes) * (len(axes) + 1) // 2))

    def scaled(self, factor: Array) -> LinearLaw:
        """Return the law of S C S; readings scatter as before."""
        square, fit = np.outer(factor, factor), self.fit
        if fit is not None:
            rows = square[: len(fit.residual_std), : len(fit.residual_std)]
            fit = replace(fit, row_covariance=fit.row_covariance * rows[:, :, None] * rows[:, None, :])
        return replace(self, compliance=self.compliance * square, fit=fit)


def entries(compliance: Array, relative_std: float, suffix: str = "") -> tuple[Parameter, ...]:
    """Return the parameters of a symmetric (6, 6) compliance's entries."""
    return tuple(
        Parameter(f"{TWIST_NAMES[i]}:{WRENCH_NAMES[j]}{suffix}", _unit(i, j), relative_std * abs(compliance[i, j]))
        for i, j in UPPER
    )


def _unit(i: int, j: int) -> str:
    return f"{'m' if i < 3 else 'rad'}/{'N' if j < 3 else 'Nm'}"


def check_compliance(compliance: Array) -> tuple[Flag, ...]:
    """Return the flags about a (6, 6) compliance.

    Raises:
        LawError: Not finite, not symmetric to 1e-9 (Betti), or not positive semi-definite, so that loading it gains
            energy.
    """
    if not np.isfinite(compliance).all():
        i, j = np.argwhere(~np.isfinite(compliance))[0]
        raise LawError(f"compliance is not finite: C[{i}][{j}] = {compliance[i, j]:g}")
    scale = np.sqrt(np.outer(np.diag(compliance), np.diag(compliance)).clip(0.0)) + 1e-300
    skew = np.abs(compliance - compliance.T) / np.maximum(scale, np.abs(compliance) + 1e-300)
    if skew.max() > SYMMETRY:
        i, j = np.unravel_index(np.argmax(skew), (6, 6))
        pair = f"C[{i}][{j}] = {compliance[i, j]:g}, C[{j}][{i}] = {compliance[j, i]:g}"
        raise LawError(f"compliance is not symmetric: {pair}")
    diagonal = np.diag(compliance)
    if diagonal.min() < 0.0:
        raise LawError(f"compliance of {TWIST_NAMES[int(diagonal.argmin())]} is negative: {diagonal.min():g}")
    # Scaled to a unit diagonal first: m/N and rad/Nm differ by orders of magnitude.
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    with np.errstate(over="ignore"):
        scaled = scale[:, None] * compliance * scale
    if not np.isfinite(scaled).all() or np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0] < -1e-9:
        raise LawError("compliance is not positive semi-definite: some load would gain energy")
    return softness(compliance)


def softness(compliance: Array) -> tuple[Flag, ...]:
    """Return a flag where a compliance is softer than any steel joint: a stiffness, or a wrong unit."""
    diagonal = np.abs(np.diag(compliance))
    worst = (diagonal[:3].max(), diagonal[3:].max())
    if worst[0] <= SOFTEST[0] and worst[1] <= SOFTEST[1]:
        return ()
    text = f"compliance up to {worst[0]:.3g} m/N and {worst[1]:.3g} rad/Nm: a stiffness, or mm/kN read wrongly?"
    return (Flag("soft", text),)


def declared_matrix(table: Declaration, key: str) -> Array:
    """Return a (6, 6) matrix given as 6 numbers of its diagonal or in full; a `compliance` by a `stiffness`, too."""
    if key == "compliance" and table.has("stiffness"):
        if table.has(key):
            raise table.fail("stiffness", "stands beside a compliance, of which it is the inverse: give one of them")
        return _inverted(table)
    if not table.has(key):
        for name in table.table.keys() - table.known:
            if hint := did_you_mean(name, ("stiffness", "joint_stiffness")):
                raise table.fail(name, f"unknown key{hint}")
    values = table.numbers(key, (6,), (6, 6))
    return np.diag(values) if values.ndim == 1 else values


def _inverted(table: Declaration) -> Array:
    """Return the compliance of a declared `stiffness` [N/m, Nm/rad]."""
    values = table.numbers("stiffness", (6,), (6, 6))
    matrix = np.diag(values) if values.ndim == 1 else values
    diagonal = np.diag(matrix)
    if diagonal.min() <= 0.0:
        axis = TWIST_NAMES[int(diagonal.argmin())]
        text = f"of {axis} is {diagonal.min():g}, expected more than 0"
        raise table.fail("stiffness", f"{text}; of an axis that does not give, the compliance is 0")
    root = np.sqrt(np.outer(diagonal, diagonal))  # scaled first: N/m and Nm/rad differ by orders of magnitude
    scaled = matrix / root
    if (skew := np.abs(scaled - scaled.T)).max() > SYMMETRY:
        i, j = np.unravel_index(np.argmax(skew), (6, 6))
        pair = f"K[{i}][{j}] = {matrix[i, j]:g}, K[{j}][{i}] = {matrix[j, i]:g}"
        raise table.fail("stiffness", f"is not symmetric: {pair}")
    # Least eigenvalue of a stiffness, its diagonal 1, of which an inverse has digits that mean something
    if np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0] < 1e-12:
        raise table.fail("stiffness", "is not positive definite: some load would move it without bound")
    inverse = np.linalg.inv(0.5 * (scaled + scaled.T)) / root
    return 0.5 * (inverse + inverse.T)


def read_linear(table: Declaration, joint: str, ranges: Ranges) -> LinearLaw:
    """Return the linear law that an arm.toml declares: `compliance`, and optionally `relative_std`."""
    return LinearLaw(read_compliance(table), declared_std(table))


def read_compliance(table: Declaration) -> Array:
    """Return the (6, 6) `compliance` of a table; raise `ArmFileError` where no structure gives so."""
    compliance = declared_matrix(table, "compliance")
    try:
        check_compliance(compliance)
    except LawError as error:
        raise table.fail("compliance", str(error)) from None
    return compliance


def declared_std(table: Declaration) -> float:
    """Return `relative_std`, 0 when absent."""
    value = table.std("relative_std", 0.0)
    if value > 1.0:
        raise table.fail("relative_std", f"a fraction, 0.2 means 20 %, got {value:g}")
    return value


def to_tensors(law: LinearLaw) -> dict[str, Array]:
    """Return a fitted law's arrays."""
    assert law.fit is not None
    size = len(law.fit.residual_std)
    arrays = {"compliance": law.compliance[:size, :size], **vars(law.fit)}
    return {name: np.ascontiguousarray(value) for name, value in arrays.items()}


def from_tensors(tensors: Mapping[str, Array]) -> LinearLaw:
    """Return the law of arrays as declared; raise `LawError` where their loads are not ordered."""
    check_ordered(tensors["loads"])
    fit = LinearFit(*(tensors[name] for name in ("row_covariance", "residual_std", "loads")))
    return LinearLaw(embed(tensors["compliance"]), fit=fit)
