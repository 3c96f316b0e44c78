"""What data and priors together tell of parameters, and in which directions they tell nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array

ROUNDING = 1e-13
"""Share of a parameter's own information below which a direction has none."""

PART = 1e-6
"""Share of an undetermined direction, by the parameters' own information, from which one has a part in it."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """What is known of P parameters.

    Attributes:
        covariance: (P, P) of what is determined: right for every combination of parameters that the undetermined
            directions do not change, such as the readings themselves.
        undetermined: (k, P) directions in which neither data nor priors hold the parameters.
    """

    covariance: Array
    undetermined: Array

    @property
    def std(self) -> Array:
        """(P,) standard deviations, infinite where a parameter has a part in an undetermined direction."""
        return np.where(self.undetermined.any(axis=0), np.inf, np.sqrt(np.diag(self.covariance)))


def posterior_of(columns: Array, prior: Array) -> Posterior:
    """Return what (n, P) whitened columns and (P,) prior standard deviations tell, infinite ones nothing."""
    normal = columns.T @ columns + np.diag(prior**-2.0)
    own = np.diag(normal)
    scale = np.where(own > 0.0, 1.0 / np.sqrt(np.where(own > 0.0, own, 1.0)), 1.0)
    information, directions = np.linalg.eigh(normal * np.outer(scale, scale))
    told = information > ROUNDING
    found, left = scale[:, None] * directions[:, told], directions[:, ~told].T
    return Posterior(found / information[told] @ found.T, np.where(np.abs(left) > PART, left, 0.0) * scale)


def root_of_covariance(covariance: Array) -> Array:
    """Return R with R R' a (P, P) covariance, which may be singular; units may differ by orders of magnitude."""
    scale = np.sqrt(np.diag(covariance))
    unit = np.where(scale > 0.0, scale, 1.0)
    size, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return unit[:, None] * vectors * np.sqrt(np.maximum(size, 0.0))
