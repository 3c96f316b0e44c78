"""A polynomial law from joint data: least squares over named features of the load, with its uncertainty.

The loads are taken as exact and every deflection column has its own noise, found from the residuals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armflex.bench.cross_validation import wrenches
from armflex.bench.fit_linear import least_squares, scatter_of, seen_loads
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
    if len(values) <= len(names):
        problem = f"{len(values)} rows of loads do not determine {len(names)} features"
        raise IdentifiabilityError(problem, min(values.shape), np.inf, names)
    check_determined(values, names, "loads do not tell the features of a polynomial apart")
    coefficients = least_squares(values, deflections)
    scatter = scatter_of(deflections, deflections - values @ coefficients, len(names))
    covariance = scatter[:, None, None] ** 2 * LinearGaussian.of(values, np.zeros(len(names))).covariance
    return PolynomialLaw(names, coefficients, covariance, scatter, seen_loads(loads))
