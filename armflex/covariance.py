"""What a covariance must be wherever one is read: finite, symmetric, positive semidefinite to rounding; its root."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array

ROUNDING = 1e-7
"""Of a covariance in units of its own diagonal: what ten digits of text and the sums of a fit may leave below zero."""


def covariance_fault(covariance: Array, rounding: float = ROUNDING) -> str:
    """Return what a (P, P) matrix has that no covariance has, '' where it may be one.

    `rounding`, in units of its own diagonal, is how far its halves may differ and an eigenvalue may lie below zero.
    """
    variance = np.diag(covariance)
    if not np.isfinite(covariance).all():
        return "is not finite"
    if (variance < 0.0).any():
        place = int(variance.argmin())
        return f"has a negative variance, {variance[place]:g} in row {place + 1}"
    sure = variance == 0.0
    if covariance[sure].any() or covariance[:, sure].any():
        return f"has numbers beside the zero variance in row {int(sure.argmax()) + 1}"
    unit = np.sqrt(np.where(sure, 1.0, variance))
    with np.errstate(over="ignore", invalid="ignore"):  # beside a tiny variance: refused below
        scaled = covariance / unit[:, None] / unit
        skew = np.abs(scaled - scaled.T)
    if not (skew <= rounding).all():
        row, column = np.unravel_index(int(skew.argmax()), scaled.shape)
        return f"is not symmetric: rows {row + 1} and {column + 1}"
    try:
        np.linalg.cholesky(scaled + rounding * np.eye(len(scaled)))
    except np.linalg.LinAlgError:
        return "is not positive semidefinite: some combination of the parameters would have a negative variance"
    return ""


def root_of_covariance(covariance: Array) -> Array:
    """Return R with R R' a (P, P) covariance, which may be singular; units may differ by orders of magnitude."""
    scale = np.sqrt(np.diag(covariance))
    unit = np.where(scale > 0.0, scale, 1.0)
    size, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return scale[:, None] * vectors * np.sqrt(np.maximum(size, 0.0))  # what is sure stays so: rounding has no unit
