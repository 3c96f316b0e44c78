"""What readings tell about parameters, and what one more row would add to each of three goals.

Everything is linear in the parameters about what is known now, and Gaussian. A row of the campaign is X (d, P), its
readings' change per parameter in standard deviations; rows add X'X to the information N, whose inverse is the
covariance (`armflex.linear_gaussian`). With S = 1 + X N^-1 X' one row

    makes a block of parameters' covariance smaller by the factor  |S - X K X'| / |S|        (Fedorov 1972)
    makes the trace of W N^-1 smaller by                           tr(S^-1 X N^-1 W N^-1 X')
    adds to the chi-square between an effect and its best imitation  e' S^-1 e, e its departure from it here
                                                              (Atkinson and Fedorov 1975; Hunter and Reiner 1965)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from armflex.conventions import Array
from armflex.linear_gaussian import LinearGaussian


class Goal(Protocol):
    """What a plan is to make as large as it can."""

    def value(self, known: LinearGaussian) -> float:
        """Return what is reached with what is known of P parameters."""
        ...

    def gains(self, known: LinearGaussian, rows: Array) -> Array:
        """Return (N,) rises of the value by each of (N, d, P) rows."""
        ...

    @property
    def title(self) -> str:
        """What is shown of it, with its unit."""
        ...

    def shown(self, value: Array | float) -> Array | float:
        """Return what people look at."""
        ...


@dataclass(frozen=True, eq=False)
class DsOptimal:
    """D_s-optimality: minus the mean logarithm of the standard deviations of the parameters at `places`.

    Of a covariance that is not diagonal the determinant is meant: the volume of what is left possible.
    """

    places: np.ndarray
    title: str = "standard deviation over the prior one, geometric mean"

    def shown(self, value: Array | float) -> Array | float:
        """Return the geometric mean of the standard deviations, in the units of the parameters."""
        return np.exp(-np.asarray(value))

    def value(self, known: LinearGaussian) -> float:
        """Return minus the logarithm of the geometric mean of the standard deviations."""
        block = known.covariance[np.ix_(self.places, self.places)]
        return -0.5 * float(np.linalg.slogdet(block)[1]) / len(self.places)

    def gains(self, known: LinearGaussian, rows: Array) -> Array:
        """Return (N,) rises; see the top of this module."""
        covariance = known.covariance
        seen = rows @ covariance
        whole = _spread(seen, rows)
        own = seen[:, :, self.places]
        told = own @ np.linalg.inv(covariance[np.ix_(self.places, self.places)]) @ _transposed(own)
        fall = np.linalg.slogdet(whole)[1] - np.linalg.slogdet(whole - told)[1]
        return 0.5 * fall / len(self.places)


@dataclass(frozen=True, eq=False)
class IOptimal:
    """I-optimality: minus the mean variance of predictions, whose (P, P) mean of squares `weight` is."""

    weight: Array
    title: str = "standard deviation of predicted readings in mm, RMS in 3-D"

    def shown(self, value: Array | float) -> Array | float:
        """Return the RMS of the standard deviations in 3-D [mm]."""
        return 1e3 * np.sqrt(np.maximum(-np.asarray(value), 0.0))

    def value(self, known: LinearGaussian) -> float:
        """Return minus the mean variance."""
        return -float((self.weight * known.covariance).sum())

    def gains(self, known: LinearGaussian, rows: Array) -> Array:
        """Return (N,) rises; see the top of this module."""
        covariance = known.covariance
        seen = rows @ covariance
        less = np.linalg.solve(_spread(seen, rows), seen @ self.weight @ _transposed(seen))
        return np.trace(less, axis1=1, axis2=2)


@dataclass(frozen=True, eq=False)
class Truth:
    """One effect taken as true, to be told from everything that could imitate it.

    Attributes:
        own: (P,) its amplitudes, zero elsewhere.
        others: Places of what is refitted in its stead.
        held: What a prior of its own puts into the information: no evidence.
    """

    own: Array
    others: np.ndarray
    held: float = 0.0

    def apart(self, known: LinearGaussian, rows: Array) -> tuple[float, Array]:
        """Return the chi-square between the effect and its best imitation so far, and what (N, d, P) rows add each."""
        there, departure = rows[:, :, self.others], self.departure(known)
        left = rows @ departure
        seen = there @ known.conditional(self.others).covariance
        more = np.linalg.solve(_spread(seen, there), left[:, :, None])[:, :, 0]
        return max(float(departure @ known.information @ self.own) - self.held, 0.0), (left * more).sum(axis=1)

    def departure(self, known: LinearGaussian) -> Array:
        """Return the (P,) values of the effect less those of its best imitation."""
        departure = self.own.copy()
        departure[self.others] = -known.conditional(self.others).solve(known.information[self.others] @ self.own)
        return departure


@dataclass(frozen=True, eq=False)
class TOptimal:
    """T-optimality: the smallest of the expected chi-squares, as any of the effects may be the true one."""

    truths: tuple[Truth, ...]
    title: str = "standard deviations between the two effects"

    def shown(self, value: Array | float) -> Array | float:
        """Return the root of the chi-square: standard deviations apart."""
        return np.sqrt(np.maximum(value, 0.0))

    def value(self, known: LinearGaussian) -> float:
        """Return the chi-square by which the wrong effect fits worse."""
        return min(truth.apart(known, np.zeros((0, 1, len(truth.own))))[0] for truth in self.truths)

    def gains(self, known: LinearGaussian, rows: Array) -> Array:
        """Return (N,) rises; see the top of this module."""
        both = [truth.apart(known, rows) for truth in self.truths]
        return np.min([now + more for now, more in both], axis=0) - min(now for now, _ in both)


def _spread(seen: Array, rows: Array) -> Array:
    """Return (N, d, d) covariance of readings in standard deviations: their noise, and what is not known."""
    return np.eye(rows.shape[1]) + seen @ _transposed(rows)


def _transposed(matrices: Array) -> Array:
    return np.swapaxes(matrices, -1, -2)
