"""What a candidate could still explain, once everything already fitted has had its say.

With A the whitened columns of all fitted parameters, P their prior precision and N = A'A + P, a new column x lowers
the fit's objective by (x'e)^2 / (x'x - x'A N^-1 A'x), e the residual: the Frisch-Waugh-Lovell projection, priors
included, see `armflex.linear_gaussian`. Weights are those of the fit. One factorisation serves thousands of candidates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import get_lapack_funcs

from armflex.conventions import Array
from armflex.estimate.fit import Fit
from armflex.linear_gaussian import ROUNDING, LinearGaussian

LEAST_SCATTER = 0.01
"""Prior: standard deviation of readings over that stated below which it is chance: nobody states a hundred times it."""

LEAST_INFORMED = 1e-3
"""Tolerance: information of the readings on an amplitude, by that of its prior, below which it is left out."""


@dataclass(frozen=True, eq=False)
class Projection:
    """A fit, seen by candidates.

    Attributes:
        regressors: (n, P) whitened and weighted columns of the fitted parameters.
        precision: (P,) their prior precision.
        data: (n,) readings that the columns are to explain, whitened and weighted.
        count: Number of readings; places of orientations that were not read are zero in everything, and none.
        random: (P,) which parameters are amplitudes of families, whose size the readings gave: they are components of
            the readings' covariance rather than fitted, and take no degree of freedom. None where there are none.
        axes: (Q, P) changes of Q parameters per unit of these, where it is `condensed`; None where they are the same.
    """

    regressors: Array
    precision: Array
    data: Array
    count: int
    random: np.ndarray | None = None
    axes: Array | None = None

    @cached_property
    def condensed(self) -> Projection:
        """The same with as few amplitudes of families as the readings distinguish: a basis of what they do.

        Sines that are fine enough for every range and every length are many more. The basis is that of as many columns
        as leave nothing of the others, by a Cholesky factorisation with pivots.
        """
        if self.random is None or not self.random.any() or self.axes is not None:
            return self
        std = 1.0 / np.sqrt(self.precision[self.random])
        columns = self.regressors[:, self.random] * std
        (pivoted,) = get_lapack_funcs(("pstrf",), (columns,))
        root, order, rank, _ = pivoted((columns.T @ columns).T, tol=LEAST_INFORMED, lower=1, overwrite_a=1)
        turned = np.empty((len(std), rank))
        turned[order - 1] = np.linalg.qr(np.tril(root)[:, :rank])[0]
        kept, count = np.flatnonzero(~self.random), turned.shape[1]
        axes = np.zeros((len(self.precision), len(kept) + count))
        axes[kept, np.arange(len(kept))] = 1.0
        axes[self.random, len(kept) :] = std[:, None] * turned
        return replace(
            self,
            regressors=np.hstack([self.regressors[:, kept], columns @ turned]),
            precision=np.append(self.precision[kept], np.ones(count)),
            random=np.arange(len(kept) + count) >= len(kept),
            axes=axes,
        )

    @cached_property
    def fitted(self) -> LinearGaussian:
        """Information of readings and priors on the fitted parameters."""
        return LinearGaussian.of(self.regressors, self.precision)

    @cached_property
    def half(self) -> Array:
        """(r, n) R'A', R the root of N^-1 but for the parameters that have no information in common."""
        return self.fitted.shared.T @ self.regressors.T

    @cached_property
    def each(self) -> Any:
        """(m, n) sparse rows of R'A' for those, such as random twists per pose."""
        from scipy.sparse import csr_array  # not needed to import the package

        alone = self.fitted.alone
        return csr_array((self.regressors[:, alone] * self.fitted.scale[alone]).T)

    def with_columns(self, columns: Array, precision: Array) -> Projection:
        """Return the projection of what is fitted and (n, k) further columns with (k,) prior precisions."""
        random = None if self.random is None else np.append(self.random, np.zeros(len(precision), dtype=bool))
        axes = None if self.axes is None else np.pad(self.axes, [(0, 0), (0, len(precision))])
        regressors, precision = np.hstack([self.regressors, columns]), np.append(self.precision, precision)
        return replace(self, regressors=regressors, precision=precision, random=random, axes=axes)

    @cached_property
    def bare(self) -> Projection:
        """The same without families."""
        if self.random is None or not self.random.any():
            return self
        kept = ~self.random
        return Projection(self.regressors[:, kept], self.precision[kept], self.data, self.count)

    @cached_property
    def volume(self) -> float:
        """log|Q| of the families' columns: what their sizes cost; see `estimate.variance_components`."""
        if self.bare is self:
            return 0.0
        columns = self.regressors[:, self.random] / np.sqrt(self.precision[self.random])
        return float(np.linalg.slogdet(np.eye(columns.shape[1]) + self.bare.inside(columns))[1])

    @cached_property
    def freedom(self) -> float:
        """Number of readings less what is fitted to them (the trace of the hat matrix), 1 at least."""
        if self.bare is not self:
            return self.bare.freedom
        return max(self.count - float((self.each.data**2).sum()) - float((self.half**2).sum()), 1.0)

    @cached_property
    def values(self) -> Array:
        """(P,) most probable values.

        A fit stops a little short of them, and along what only priors hold a little is enough to mimic a gain.
        """
        return self.absorbed(self.data)

    @cached_property
    def residual(self) -> Array:
        """(n,) what those leave of the readings."""
        return self.data - self.regressors @ self.values

    @property
    def objective(self) -> float:
        """Sum of squares of residual and prior deviations."""
        return float(self.residual @ self.residual + self.precision @ self.values**2)

    def drawn(self, count: int) -> Array:
        """Return (n, count) readings as they would be by chance: the covariance of X'Mr, r such ones, is X'MX."""
        rng, least = np.random.default_rng(0), 1e-8 * (self.regressors**2).sum(axis=0)
        std = 1.0 / np.sqrt(
            np.maximum(np.maximum(self.precision, least), ROUNDING)
        )  # else rounding is all that is left
        chance = rng.standard_normal((len(self.data), count))
        return chance + self.regressors @ (rng.standard_normal((len(std), count)) * std[:, None])

    def left_of(self, change: Array) -> Array:
        """Return (n, ...) M x of changes x of the readings: what the fitted parameters do not take over."""
        left = change - self.half.T @ (self.half @ change)
        return left - self.each.T @ (self.each @ change) if self.each.shape[0] else left

    def inside(self, columns: Array) -> Array:
        """Return the (k, k) products X'MX of few (n, k) columns, in half the time of `left_of`."""
        shared = self.half @ columns
        left = columns.T @ columns - shared.T @ shared
        if not self.each.shape[0]:
            return left
        apart = self.each @ columns
        return left - apart.T @ apart

    def absorbed(self, change: Array) -> Array:
        """Return the values by which all fitted parameters take over a (n,) change of the readings."""
        return self.fitted.solve(self.regressors.T @ change)

    def whole(self, values: Array) -> Array:
        """Return (P, ...) values as those of the parameters that this is condensed from."""
        return values if self.axes is None else self.axes @ values

    def resampled(self, times: Array) -> Projection:
        """Return the same where each of (n,) readings counts so many times; those of no time are left out."""
        some, root = times > 0.0, np.sqrt(times[times > 0.0])
        regressors, data = self.regressors[some] * root[:, None], self.data[some] * root
        return replace(self, regressors=regressors, data=data, count=round(self.count * float(np.mean(times))))


def project(fit: Fit) -> Projection:
    """Return the projection of a fit."""
    return Projection(fit.regressors, fit.precision, fit.residual + fit.regressors @ fit.values, fit.view.count)
