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
from armflex.estimate.block import largest_motion
from armflex.estimate.fit import Fit
from armflex.linear_gaussian import LinearGaussian


@dataclass(frozen=True, eq=False)
class Projection:
    """A fit, seen by candidates.

    Attributes:
        regressors: (n, P) whitened and weighted columns of the fitted parameters.
        precision: (P,) prior precision.
        data: (n,) readings that the columns are to explain, whitened and weighted.
        residual: (n,) what the most probable values leave of them.
        objective: Sum of squares of residual and prior deviations.
        ridge: Prior precision of a candidate's amplitudes, relative to the square of its column: an effect that would
            have to move the tip by more than `largest_motion` to be seen is not believed.
        count: Number of readings; places of orientations that were not read are zero in everything, and none.
    """

    regressors: Array
    precision: Array
    data: Array
    residual: Array
    objective: float
    ridge: float
    count: int

    @cached_property
    def fitted(self) -> LinearGaussian:
        """What readings and priors tell of the fitted parameters."""
        return LinearGaussian.of(self.regressors, self.precision)

    @cached_property
    def each(self) -> Any:
        """(m, n) sparse E of parameters with no reading in common, a random twist per pose: those are eliminated first.

        Columns scaled so that E'E is the part of A N^-1 A' that is theirs alone.
        """
        from scipy.sparse import csr_array  # not needed to import the package

        alone = self.fitted.alone
        return csr_array((self.regressors[:, alone] * self.fitted.scale[alone]).T)

    def cleared(self, columns: Array) -> Array:
        """Return (n, k) columns less what those parameters would take of them."""
        return columns - self.each.T @ (self.each @ columns) if self.fitted.alone.any() else columns

    @cached_property
    def shared(self) -> Array:
        """(n, p) cleared columns of all other parameters."""
        return self.cleared(self.regressors[:, ~self.fitted.alone])

    @cached_property
    def root(self) -> Array:
        """(p, r) root of the covariance of those."""
        return self.fitted.root[~self.fitted.alone, : -self.fitted.alone.sum() or None]

    @cached_property
    def half(self) -> Array:
        """(r, n) H with H'H + E'E = A N^-1 A'."""
        return self.root.T @ self.shared.T

    def absorbed(self, change: Array) -> Array:
        """Return the (P,) values by which fitted parameters take over a (n,) change of the readings."""
        return self.fitted.solve(self.regressors.T @ change)

    def information(self, regressors: Array) -> tuple[Array, Array]:
        """Return (k, k) X'X - X'A N^-1 A'X of (n, k) columns, and the diagonal of X'X."""
        seen = self.half @ regressors
        whole = regressors.T @ regressors
        return regressors.T @ self.cleared(regressors) - seen.T @ seen, np.diag(whole)

    def beside(self, regressors: Array) -> Projection:
        """Return the projection where the amplitudes of (n, k) columns are fitted, too."""
        held = np.append(self.precision, self.ridge * (regressors**2).sum(axis=0))
        return projected(np.hstack([self.regressors, regressors]), held, self.data, self.ridge, self.count)

    def gain(self, regressors: Array) -> tuple[float, Array]:
        """Return what (n, k) columns lower the objective by together, and their (k,) amplitudes."""
        inside, whole = self.information(regressors)
        score = regressors.T @ self.residual
        amplitudes = LinearGaussian(inside).with_precision(self.ridge * whole).solve(score)
        return float(score @ amplitudes), amplitudes


def project(fit: Fit) -> Projection:
    """Return the projection of a fit."""
    data = fit.residual + fit.regressors @ fit.values
    return projected(fit.regressors, fit.precision, data, ridge_for(fit), fit.view.count)


def ridge_for(fit: Fit) -> float:
    """Return the `ridge` of a fit's projections."""
    sigma = fit.view.sigma[:, fit.view.foremost]
    return float((sigma[np.isfinite(sigma)] ** 2).mean()) / largest_motion(fit.view) ** 2 / len(fit.view.rows)


def projected(regressors: Array, precision: Array, data: Array, ridge: float, count: int) -> Projection:
    """Return the projection of a linear problem at its exact solution.

    A fit stops a little short of it, and along what only priors hold a little is enough to mimic a gain.
    """
    rough = Projection(regressors, precision, data, data, 0.0, ridge, count)
    values = rough.absorbed(data)
    residual = data - regressors @ values
    objective = float(residual @ residual + (precision * values**2).sum())
    return replace(rough, residual=residual, objective=objective)


def evidence(gain: Array | float, objective: float, count: int, parameters: Array | float) -> Array | float:
    """Return the fall of the Bayesian information criterion: n log(J / (J - gain)) - k log n; noise size unknown."""
    # Noise smaller than stated must not make more of a strained prior than it is.
    objective = max(objective, float(count))
    left = np.where(gain < objective, objective - gain, objective)  # more than all there is can only be rounding
    return count * np.log(objective / left) - parameters * np.log(count)
