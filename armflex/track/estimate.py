"""The estimate of a filter as its mean and a square root of its covariance, and what changes it.

The root S, with covariance S S', is any square matrix: a reading costs two thin products (Potter 1963; Andrews 1968,
"A square root formulation of the Kalman covariance equations", for several numbers at once), and the covariance can
never lose its sign by rounding. Without drift the result is that of least squares on all readings together.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgeqrf, dpotrf, dtrtri

from armflex.conventions import Array, root_of_covariance
from armflex.estimate.robust import outlier_limit

GROSS = 100.0
"""Mahalanobis distance from which on nothing but a mistake explains a reading: it is left out."""

unit_matrix = cache(np.eye)


class LinearisedReading(NamedTuple):
    """A reading at the point where the arm is linearised, in standard deviations.

    `residual` (d,) is measured minus predicted there, `jacobian` (d, P) its fall per parameter.
    """

    residual: Array
    jacobian: Array


class Innovation(NamedTuple):
    """What a reading says that the estimate did not know.

    Attributes:
        heard: (d, P) columns through the root.
        inverse: (d, d) inverse of the Cholesky factor of the expected covariance.
        factor: (d, d) that factor, lower.
        whitened: (d,) the surprise in standard deviations.
    """

    through_root: Array
    inverse: Array
    factor: Array
    whitened: Array


class Estimate(NamedTuple):
    """Mean (P,) and root (P, P) of the covariance of all parameters, as steps from where the arm is linearised."""

    values: Array
    root: Array

    @property
    def covariance(self) -> Array:
        """(P, P)."""
        return self.root @ self.root.T


def estimate_of(covariance: Array) -> Estimate:
    """Return the estimate of no step with a covariance, which may be singular."""
    root = root_of_covariance(covariance)
    return Estimate(np.zeros(len(root)), np.ascontiguousarray(root))


def innovation(estimate: Estimate, seen: LinearisedReading) -> Innovation:
    """Return what a reading says beyond an estimate."""
    through_root = seen.jacobian.dot(estimate.root)
    factor, _ = dpotrf(through_root.dot(through_root.T) + unit_matrix(len(through_root)), lower=1, clean=1)
    inverse, _ = dtrtri(factor, lower=1)
    surprise = seen.residual - seen.jacobian.dot(estimate.values)
    return Innovation(through_root, inverse, factor, inverse.dot(surprise))


def absorb(estimate: Estimate, gained: Innovation) -> Estimate:
    """Return the estimate that knows a reading, too."""
    gain = estimate.root.dot(gained.through_root.T)
    half, _ = dtrtri(gained.factor + unit_matrix(len(gain.T)), lower=1)
    turned = gain.dot(gained.inverse.T)
    values = estimate.values + turned.dot(gained.whitened)
    return Estimate(values, estimate.root - turned.dot(half.dot(gained.through_root)))


def take(estimate: Estimate, seen: LinearisedReading) -> tuple[Estimate, float, float]:
    """Return the estimate after a reading, what that counted, and its Mahalanobis distance.

    The distance d is by all that was expected, what was not known of the parameters included. Beyond `outlier_limit` a
    reading counts (limit / d)^2: it moves the estimate the less the farther it is, and beyond `GROSS` not at all.
    """
    far, gained = outlier_limit(len(seen.residual)), innovation(estimate, seen)
    distance = float(gained.whitened.dot(gained.whitened)) ** 0.5
    if distance <= far:
        return absorb(estimate, gained), 1.0, distance
    if not distance < GROSS:
        return estimate, 0.0, distance
    # As if it were so noisy that its gain is a part of what it was, however little is known of the parameters.
    weight = (far / distance) ** 2
    expected = gained.factor.dot(gained.factor.T) / weight - gained.through_root.dot(gained.through_root.T)
    noise = np.linalg.cholesky(expected)
    lighter = LinearisedReading(np.linalg.solve(noise, seen.residual), np.linalg.solve(noise, seen.jacobian))
    return absorb(estimate, innovation(estimate, lighter)), weight, distance


def expected_variance(estimate: Estimate, seen: LinearisedReading) -> float:
    """Return the mean variance of what is read that is due to the parameters, by that of the noise."""
    through_root = seen.jacobian.dot(estimate.root)
    return float(np.vdot(through_root, through_root)) / len(through_root)


def widen(estimate: Estimate, variance: Array) -> Estimate:
    """Return the estimate after a random walk: (P,) variances added, the mean as it was."""
    drifting = np.flatnonzero(variance > 0.0)
    steps = np.zeros((len(drifting), len(variance)))
    steps[np.arange(len(drifting)), drifting] = np.sqrt(variance[drifting])
    factored = dgeqrf(np.vstack([estimate.root.T, steps]))[0]
    return Estimate(estimate.values, np.ascontiguousarray(np.tril(factored[: len(variance)].T)))


def recentred(estimate: Estimate, step: Array, factor: Array) -> Estimate:
    """Return an estimate as steps from elsewhere: a (P,) step away, in (P,) times larger units."""
    return Estimate((estimate.values - step) / factor, estimate.root / factor[:, None])
