"""A compliance from joint data in closed form: least squares through the origin, with its uncertainty.

The loads are taken as exact and every deflection column has its own noise, found from the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.bench.span import check_span
from armflex.conventions import Array
from armflex.errors import InputError, did_you_mean
from armflex.laws.joint.linear import LinearFit, LinearLaw
from armflex.laws.law import embed
from armflex.linear_gaussian import LinearGaussian

ROUNDS = 100
"""Most reweightings by the rows' own scatter."""

STRUCTURES = ("full", "symmetric", "diagonal")


@dataclass(frozen=True)
class FittedCompliance:
    """A (k, k) compliance [m/N, ...] with the (k, k, k) covariance of its rows and (k,) residual scatter."""

    compliance: Array
    row_covariance: Array
    residual_std: Array

    def law(self, loads: Array) -> LinearLaw:
        """Return the law, remembering the (N, k) loads it was fitted on."""
        fit = LinearFit(self.row_covariance, self.residual_std, seen_loads(loads))
        return LinearLaw(embed(self.compliance), fit=fit)


def fit_compliance(loads: Array, deflections: Array, structure: str = "full") -> FittedCompliance:
    """Return the compliance of (N, k) loads and deflections.

    Args:
        loads: (N, k) [N, N m].
        deflections: (N, k) [m, rad].
        structure: "full", "symmetric" (Betti) or "diagonal" (the paper's eq. (7)).

    Raises:
        InputError: No such structure, or no more rows than components.
        IdentifiabilityError: The loads do not span the components, so that some entries are not determined.
    """
    basis = basis_of(loads.shape[1], structure)
    if len(loads) <= loads.shape[1]:
        raise InputError(f"{len(loads)} rows of loads do not determine {loads.shape[1]} components")
    check_span(loads)
    regressors, count, scatter = np.einsum("pik,nk->nip", basis, loads), len(basis), np.ones(loads.shape[1])
    for _ in range(ROUNDS if structure == "symmetric" else 1):  # rows share parameters: weigh them by their own scatter
        before, weighted = scatter, regressors / scatter[:, None]
        theta = least_squares(weighted.reshape(-1, count), (deflections / scatter).ravel())
        scatter = scatter_of(deflections, deflections - regressors @ theta, count / loads.shape[1])
        if np.allclose(scatter, before, rtol=1e-9, atol=0.0):
            break
    covariance = LinearGaussian.of((regressors / scatter[:, None]).reshape(-1, count), np.zeros(count)).covariance
    compliance = np.tensordot(theta, basis, axes=1)
    rows = np.einsum("pik,pq,qil->ikl", basis, covariance, basis)
    return FittedCompliance(compliance, rows, scatter)


def seen_loads(loads: Array) -> Array:
    """Return the (2, k) smallest and largest of (N, k) loads: what a law remembers of its training."""
    return np.array([loads.min(axis=0), loads.max(axis=0)])


def least_squares(regressors: Array, readings: Array) -> Array:
    """Return the (F, ...) coefficients of (N, F) regressors that fit (N, ...) readings best."""
    scale = np.maximum(np.linalg.norm(regressors, axis=0), 1e-300)
    return (np.linalg.lstsq(regressors / scale, readings, rcond=None)[0].T / scale).T


def scatter_of(deflections: Array, residual: Array, parameters: float) -> Array:
    """Return the standard deviation of each column of (N, ...) residuals, of which so many parameters were fitted."""
    freedom = max(len(residual) - parameters, 1.0)
    return np.maximum(np.sqrt((residual**2).sum(axis=0) / freedom), least_scatter(deflections))


def least_scatter(deflections: Array) -> float:
    """Return the scatter that a fit has at least: a column may be followed exactly."""
    return max(1e-12 * float(np.abs(deflections).max()), 1e-30)


def basis_of(size: int, structure: str) -> Array:
    """Return the (P, k, k) matrices that the compliance is a sum of."""
    if structure not in STRUCTURES:
        hint = did_you_mean(str(structure), STRUCTURES)
        raise InputError(f"structure {structure!r} is not known{hint} (known: {', '.join(STRUCTURES)})")
    pairs = [(i, j) for i in range(size) for j in range(size)]
    if structure == "diagonal":
        pairs = [(i, i) for i in range(size)]
    if structure == "symmetric":
        pairs = [(i, j) for i, j in pairs if i <= j]
    basis = np.zeros((len(pairs), size, size))
    for matrix, (i, j) in zip(basis, pairs, strict=True):
        matrix[i, j] = 1.0
        if structure == "symmetric":
            matrix[j, i] = 1.0
    return basis
