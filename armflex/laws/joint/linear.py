"""Linear law: twist = C wrench, C a constant compliance, diagonal or full (the paper's eq. (7), inverted)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import TWIST_NAMES, WRENCH_NAMES, Array
from armflex.declaration import Declaration
from armflex.errors import Flag, LawError
from armflex.laws.law import Law, Ranges, Row, block_norms

SYMMETRY = 1e-9
NOTHING = np.zeros(6)
UNLOADED = np.zeros((6, 6))
NOTHING.flags.writeable = UNLOADED.flags.writeable = False
DIAGONAL = np.arange(6)
ROUNDING = 1e-9
"""Part of a load [Nm per N] below which a moment is none."""

SOFTEST = (1e-5, 1e-3)
"""m/N and rad/Nm beyond which a single joint of steel is not believed; a hint at a wrong unit, no more."""


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
    """Constant compliance.

    Attributes:
        compliance: (6, 6) [m/N, rad/Nm and mixed].
        relative_std: Relative standard uncertainty of every entry, independent of the others but that the compliance
            stays symmetric; 0 for none.
        fit: Uncertainty of a compliance fitted to data, None for a declared one.
    """

    compliance: Array
    relative_std: float = 0.0
    fit: LinearFit | None = None

    def twist(self, wrench: Array, row: Row) -> Array:
        """Return C w."""
        return wrench @ self.compliance.T

    def tangent(self, wrench: Array, row: Row) -> Array:
        """Return C."""
        return np.broadcast_to(self.compliance, (*wrench.shape[:-1], 6, 6))

    def affine(self, row: Row) -> tuple[Array, Array]:
        """Return no twist and C, the same in every row."""
        return NOTHING, self.compliance

    def steepest(self, ranges: Ranges) -> Array:
        """Return the norms of C's blocks."""
        return block_norms(self.compliance)

    def covariance(self, wrench: Array, row: Row) -> Array | None:
        """Return the (6, 6) covariance of C w: the fit's prediction variance, or that of the relative entries."""
        if self.fit is not None:
            return _fit_covariance(self.fit, wrench)
        if self.relative_std == 0.0:
            return None
        return entry_covariance(self.compliance, wrench, self.relative_std)

    def draw(self, rng: np.random.Generator) -> LinearLaw:
        """Return the law with other entries: rows as fitted, or pairs of entries off by the relative error."""
        if self.fit is None:
            factor = 1.0 + self.relative_std * symmetric_normal(rng)
            return LinearLaw(self.compliance * factor)
        size = len(self.fit.residual_std)
        drawn = self.compliance.copy()
        for i, covariance in enumerate(self.fit.row_covariance):
            drawn[i, :size] = rng.multivariate_normal(drawn[i, :size], covariance, method="eigh")
        return LinearLaw(drawn)

    @property
    def trained(self) -> bool:
        """Whether the compliance was fitted."""
        return self.fit is not None

    def doubts(self, wrench: Array, row: Row) -> tuple[Flag, ...]:
        """Return a flag for every component of the load that the fit has not seen."""
        return () if self.fit is None else beyond(self.fit.loads, wrench)


def symmetric_normal(rng: np.random.Generator) -> Array:
    """Return (6, 6) standard normal numbers, those above the diagonal the same as below."""
    upper = np.triu(rng.normal(size=(6, 6)))
    return upper + np.triu(upper, 1).T


def entry_covariance(compliance: Array, wrench: Array, relative_std: float) -> Array:
    """Return the (..., 6, 6) covariance of C w when every entry of C has its own relative error, but C_ij = C_ji."""
    squares, pairs = compliance**2, wrench[..., :, None] * wrench[..., None, :]
    shared = squares * pairs  # C_ij times w_j moves component i, times w_i component j
    shared[..., DIAGONAL, DIAGONAL] = np.einsum("...ij,...j->...i", squares, wrench**2)
    return relative_std**2 * shared


def beyond(seen: Array, wrench: Array) -> tuple[Flag, ...]:
    """Return a flag for every component of a (6,) wrench outside the (2, k) smallest and largest loads seen.

    A law of forces alone does not turn: a moment on it is one flag more.
    """
    flags, slack = [], 1e-9 * float(np.abs(seen).max(initial=0.0))
    for name, low, high, load in zip(WRENCH_NAMES, *seen, wrench, strict=False):  # a fit may be of forces only
        if not low - slack <= load <= high + slack:
            unit = "N" if name[0] == "f" else "Nm"
            here, start, end = _told_apart(load, low, high)
            text = f"load {name} = {here} {unit} is outside the {start} to {end} {unit} it was trained on"
            size = max(low - load, load - high) / max(high - low, slack, 1e-300)
            flags.append(Flag("extrapolating", text, size=float(size)))
    return (*flags, *unturned(len(seen[0]), wrench))


def _told_apart(load: float, low: float, high: float) -> tuple[str, str, str]:
    """Return a load and the ends of what was seen in three digits, or as many as tell it from the end it is beyond."""
    for digits in range(3, 16):
        here, start, end = (f"{float(f'{value:.{digits}g}'):.{digits}g}" for value in (load, low, high))
        if (float(here) < float(start)) if load < low else (float(here) > float(end)):
            break
    return tuple(f"{float(text):.15g}" for text in (here, start, end))  # 15300, not 1.53e+04


def unturned(size: int, wrench: Array) -> tuple[Flag, ...]:
    """Return a flag where a law of `size` components has no answer to the moment in a (6,) wrench."""
    moment = float(np.linalg.norm(wrench[size:]))
    if moment <= ROUNDING * float(np.linalg.norm(wrench)):
        return ()
    text = f"carries a moment of {moment:.3g} Nm, but was trained on forces alone: it does not turn under any load"
    return (Flag("does_not_turn", text),)


def _fit_covariance(fit: LinearFit, wrench: Array) -> Array:
    size = len(fit.residual_std)
    load = wrench[:size]
    variance = np.einsum("i,nij,j->n", load, fit.row_covariance, load) + fit.residual_std**2
    return np.diag(np.concatenate([variance, np.zeros(6 - size)]))


def check_compliance(compliance: Array) -> tuple[Flag, ...]:
    """Return the doubts about a (6, 6) compliance.

    Raises:
        LawError: Not symmetric to 1e-9 (Betti), or not positive semi-definite, so that loading it gains energy.
    """
    scale = np.sqrt(np.outer(np.diag(compliance), np.diag(compliance)).clip(0.0)) + 1e-300
    skew = np.abs(compliance - compliance.T) / np.maximum(scale, np.abs(compliance) + 1e-300)
    if skew.max() > SYMMETRY:
        i, j = np.unravel_index(np.argmax(skew), (6, 6))
        pair = f"C[{i}][{j}] = {compliance[i, j]:g}, C[{j}][{i}] = {compliance[j, i]:g}"
        raise LawError(f"compliance is not symmetric: {pair}")
    _check_definite(compliance)
    return softness(compliance)


def _check_definite(compliance: Array) -> None:
    diagonal = np.diag(compliance)
    if diagonal.min() < 0.0:
        raise LawError(f"compliance of {TWIST_NAMES[int(diagonal.argmin())]} is negative: {diagonal.min():g}")
    # Scaled to a unit diagonal first: m/N and rad/Nm differ by orders of magnitude.
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    scaled = compliance * np.outer(scale, scale)
    if np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0] < -1e-9:
        raise LawError("compliance is not positive semi-definite: some load would gain energy")


def softness(compliance: Array) -> tuple[Flag, ...]:
    """Return a flag where a compliance is softer than any steel joint: a stiffness, or a wrong unit."""
    diagonal = np.abs(np.diag(compliance))
    worst = (diagonal[:3].max(), diagonal[3:].max())
    if worst[0] <= SOFTEST[0] and worst[1] <= SOFTEST[1]:
        return ()
    text = f"compliance up to {worst[0]:.3g} m/N and {worst[1]:.3g} rad/Nm: a stiffness, or mm/kN read wrongly?"
    return (Flag("soft", text),)


def declared_matrix(table: Declaration, key: str) -> Array:
    """Return a (6, 6) matrix given as 6 numbers of its diagonal or in full."""
    values = table.numbers(key, (6,), (6, 6))
    return np.diag(values) if values.ndim == 1 else values


def read_linear(table: Declaration, joint: str, ranges: Ranges) -> LinearLaw:
    """Return the linear law that an arm.toml declares: `compliance`, and optionally `relative_std`."""
    compliance = declared_matrix(table, "compliance")
    try:
        check_compliance(compliance)
    except LawError as error:
        raise table.fail("compliance", str(error)) from None
    return LinearLaw(compliance, declared_std(table))


def declared_std(table: Declaration) -> float:
    """Return `relative_std`, 0 when absent."""
    value = table.number("relative_std", 0.0)
    if value < 0.0:
        raise table.fail("relative_std", f"a standard deviation cannot be negative, got {value:g}")
    if value > 1.0:
        raise table.fail("relative_std", f"a fraction, 0.2 means 20 %, got {value:g}")
    return value
