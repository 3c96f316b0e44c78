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

from armflex.conventions import Array
from armflex.estimate.fit import Fit
from armflex.linear_gaussian import MANY, ROUNDING, LinearGaussian


@dataclass(frozen=True, eq=False)
class Apart:
    """Parameters without information in common, such as a random twist per pose: they are eliminated first.

    What is left of a column is *cleared* of them: (1 - E'E) x, E their own columns with `scale` (see the arrowheads
    of `armflex.linear_gaussian`).

    Attributes:
        which: (P,) which of all parameters.
        each: (m, n) sparse E.
        scale: (m,) of their columns in E.
    """

    which: np.ndarray
    each: Any
    scale: Array

    @staticmethod
    def of(regressors: Array, precision: Array) -> Apart | None:
        """Return those of (n, P) columns with (P,) prior precisions, None where too few are."""
        known = LinearGaussian.of(regressors, precision) if regressors.shape[1] > MANY else None
        if known is None or not known.alone.any():
            return None
        from scipy.sparse import csr_array  # not needed to import the package

        scale = known.scale[known.alone]
        return Apart(known.alone, csr_array((regressors[:, known.alone] * scale).T), scale)

    def cleared(self, columns: Array) -> Array:
        """Return (n, ...) columns cleared of what they would take."""
        return columns - self.each.T @ (self.each @ columns)


@dataclass(frozen=True, eq=False)
class Projection:
    """A fit, seen by candidates.

    Attributes:
        regressors: (n, P) whitened and weighted columns of the fitted parameters but those apart.
        precision: (P,) prior precision of those.
        apart: What is eliminated first, None where nothing is.
        data: (n,) readings that the columns are to explain, whitened and weighted.
        residual: (n,) what the most probable values leave of them.
        objective: Sum of squares of residual and prior deviations.
        count: Number of readings; places of orientations that were not read are zero in everything, and none.
    """

    regressors: Array
    precision: Array
    apart: Apart | None
    data: Array
    residual: Array
    objective: float
    count: int

    def cleared(self, columns: Array) -> Array:
        """Return (n, ...) columns cleared of the parameters apart."""
        return columns if self.apart is None else self.apart.cleared(columns)

    @cached_property
    def shared(self) -> Array:
        """(n, P) cleared columns of the others."""
        return self.cleared(self.regressors)

    @cached_property
    def fitted(self) -> LinearGaussian:
        """Information of readings and priors on the fitted parameters but those apart."""
        information = self.regressors.T @ self.shared + np.diag(self.precision)
        if self.apart is not None:  # of a column that those apart can make up nothing is left but rounding
            whole = (self.regressors**2).sum(axis=0) + self.precision
            lost = np.diag(information) < ROUNDING * whole
            information[lost], information[:, lost] = 0.0, 0.0
        return LinearGaussian(information)

    @cached_property
    def freedom(self) -> float:
        """Number of readings less what is fitted to them (the trace of the hat matrix), 1 at least."""
        alone = 0.0 if self.apart is None else float((self.apart.each.data**2).sum())
        return max(self.count - alone - float((self.half**2).sum()), 1.0)

    @cached_property
    def half(self) -> Array:
        """(r, n) R'A' of the cleared columns, R a root of N^-1: so much of a cleared column is not fitted by others."""
        return self.fitted.root.T @ self.shared.T

    def drawn(self, count: int) -> Array:
        """Return (n, count) readings as they would be by chance: the covariance of X'Mr, r such ones, is X'MX."""
        rng, least = np.random.default_rng(0), 1e-8 * (self.regressors**2).sum(axis=0)
        std = 1.0 / np.sqrt(
            np.maximum(np.maximum(self.precision, least), ROUNDING)
        )  # else rounding is all that is left
        chance = rng.standard_normal((len(self.residual), count))
        return chance + self.regressors @ (rng.standard_normal((len(std), count)) * std[:, None])

    def left_of(self, change: Array) -> Array:
        """Return (n, ...) M x of changes x of the readings: what the fitted parameters do not take over."""
        return self.cleared(change) - self.half.T @ (self.half @ change)

    def of_rows(self, some: np.ndarray) -> Projection:
        """Return the same of (n,) some of the readings alone: those of a parameter apart are all in or all out."""
        apart = self.apart and replace(self.apart, each=self.apart.each[:, some])
        count, data = round(self.count * float(np.mean(some))), self.data[some]
        return replace(self, apart=apart, data=data, count=count).with_fitted(self.regressors[some], self.precision)

    def absorbed(self, change: Array) -> Array:
        """Return the values by which all fitted parameters take over a (n,) change of the readings."""
        shared = self.fitted.solve(self.shared.T @ change)
        if self.apart is None:
            return shared
        values = np.empty(len(self.apart.which))
        values[~self.apart.which] = shared
        values[self.apart.which] = self.apart.scale * (self.apart.each @ (change - self.regressors @ shared))
        return values

    def with_fitted(self, regressors: Array, precision: Array) -> Projection:
        """Return the projection, at its exact solution, where these (n, P) columns are fitted beside those apart.

        A fit stops a little short of it, and along what only priors hold a little is enough to mimic a gain.
        """
        beside = replace(self, regressors=regressors, precision=precision)
        values = beside.fitted.solve(beside.shared.T @ self.data)
        left = self.data - regressors @ values
        residual = self.cleared(left)
        objective = float(left @ residual + (precision * values**2).sum())
        return replace(beside, residual=residual, objective=objective)


def project(fit: Fit) -> Projection:
    """Return the projection of a fit."""
    data = fit.residual + fit.regressors @ fit.values
    return projected(fit.regressors, fit.precision, data, fit.view.count)


def projected(regressors: Array, precision: Array, data: Array, count: int) -> Projection:
    """Return the projection of (n,) readings on (n, P) columns with (P,) prior precisions."""
    apart = Apart.of(regressors, precision)
    if apart is not None:
        regressors, precision = regressors[:, ~apart.which], precision[~apart.which]
    return Projection(regressors, precision, apart, data, data, 0.0, count).with_fitted(regressors, precision)
