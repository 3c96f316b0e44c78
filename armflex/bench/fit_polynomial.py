"""A polynomial law from joint data: least squares over named features of the load, with its uncertainty.

The loads are taken as exact and every deflection column has its own noise, found from the residuals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armflex.bench.cross_validation import wrenches
from armflex.bench.fit_linear import least_scatter, seen_loads
from armflex.bench.fitted import Fitted, Learner
from armflex.bench.span import check_determined
from armflex.conventions import Array
from armflex.errors import IdentifiabilityError
from armflex.laws.joint.polynomial import FEATURES, PolynomialLaw, feature_values, features_of
from armflex.linear_gaussian import LinearGaussian

PLAIN = ("linear+radial", "linear+radial+magnitude", "quadratic")
"""The features that any network has to beat to be worth having."""


def learner(features: str | Sequence[str]) -> Learner:
    """Return the function that fits a polynomial law over some features; see `laws.joint.polynomial.features_of`."""

    def learn(loads: Array, deflections: Array, seed: int) -> Fitted:
        law = fit_polynomial(loads, deflections, features)
        coefficients = dict(zip(law.features, law.coefficients.tolist(), strict=True))
        units = "m, rad per N, Nm or their product"
        return Fitted(law, {"features": list(law.features), "coefficients": coefficients, "unit": units})

    return learn


def fit_polynomial(loads: Array, deflections: Array, features: str | Sequence[str]) -> PolynomialLaw:
    """Return the polynomial law of (N, k) loads [N, Nm] and deflections [m, rad].

    Args:
        loads: (N, k), k = 3 or 6.
        deflections: (N, k).
        features: What the deflection is linear in besides the components; see `features_of`.

    Raises:
        UnknownNameError: No such feature.
        IdentifiabilityError: The loads do not determine a coefficient for every feature.
    """
    names = features_of(features, loads.shape[1])
    values = feature_values(wrenches(loads))[:, [FEATURES.index(name) for name in names]]
    scale = np.maximum(np.linalg.norm(values, axis=0), 1e-300)
    scaled = values / scale
    _check_determined(scaled, names)
    coefficients = np.linalg.lstsq(scaled, deflections, rcond=None)[0] / scale[:, None]
    scatter = _scatter(deflections, deflections - values @ coefficients, len(names))
    covariance = scatter[:, None, None] ** 2 * LinearGaussian.of(values, np.zeros(len(names))).covariance
    return PolynomialLaw(names, coefficients, covariance, scatter, seen_loads(loads))


def _scatter(deflections: Array, residual: Array, count: int) -> Array:
    found = np.sqrt((residual**2).sum(axis=0) / (len(residual) - count))
    return np.maximum(found, least_scatter(deflections))


def _check_determined(scaled: Array, names: Sequence[str]) -> None:
    count = scaled.shape[1]
    if len(scaled) <= count:
        problem = f"{len(scaled)} rows of loads do not determine {count} features"
        raise IdentifiabilityError(problem, min(len(scaled), count), np.inf, names)
    check_determined(scaled, names, "loads do not tell the features of a polynomial apart")
