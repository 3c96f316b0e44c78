"""A linear problem with Gaussian noise and a Gaussian prior: its normal equations, and what is read from them.

Readings y (n,) in units of their own standard deviations are y = J x + e, with e ~ N(0, 1): J (n, P) is their Jacobian
(the design matrix; a column of it is the regressor of one parameter). Before them each parameter x_i ~ N(0, 1 / p_i),
with a prior precision p_i = 0 where nothing was known. Minus twice the logarithm of the posterior density is

    |y - J x|^2 + x' diag(p) x + const,

so the posterior is Gaussian, with

    information N = J'J + diag(p),        covariance N^-1,        most probable values N^-1 J'y.

*Scaling.* Parameters are metres, radians and logarithms, and diag(N) spans tens of orders of magnitude. With
S = diag(N)^-1/2 the matrix S N S has a unit diagonal; no other diagonal scaling has a condition more than P times
better (van der Sluis 1969, "Condition numbers and equilibration of matrices"). What is small is then small beside the
parameters' own information, whatever their units.

*Null space.* S N S = V diag(l) V'. A direction S v with l = 0 changes no reading and has no prior: the posterior is
flat along it. A sum of products rounds an l of zero to some 1e-16 times P, so l counts as zero up to `ROUNDING`. The
others make a root of the covariance R = S V diag(l)^-1/2 (P, r), with

    R R' = N^-1 where there is no null space,        R' N R = 1,

and N^-1 means R R' from here on: right for every combination of parameters that the null space does not change. Along
the null space values stay at zero, in an arrowhead those of the others. This is the only guard: a `ridge` in a caller
is a prior that it means, and says so.

*Projection* (Frisch and Waugh 1933; Lovell 1963; with priors it is block elimination). A further regressor X (n, k),
fitted together with all that is here, has the information

    N_X = X'X - X'J N^-1 J'X = X'X - W'W,        W = R' J'X,

on its amplitudes, whose prior precision is added to it. With the score s = X'(y - J N^-1 J'y) its amplitudes are
N_X^-1 s, and the objective falls by s' N_X^-1 s.

*Arrowheads.* Where parameters have no information in common with one another, only with the others (an unknown twist in
every pose, each moving its own rows), the matrix is an arrowhead: scaled,

    S N S = [[B, C], [C', 1]],

and block elimination leaves B - C C' of the few others, whose axes V diag(l) V' are found instead. Then
R = S [[V l^-1/2, 0], [-C' V l^-1/2, 1]]. A thousand poses cost a product instead of a decomposition.

*Adding rows.* Further readings with the Jacobian Z (d, P) add Z'Z to N: one after the other they give what they give
together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.errors import NotFiniteError, ShapeError

ROUNDING = 1e-13
"""Information along a direction, by the parameters' own, up to which there is none."""

MANY = 64
"""Parameters without information in common from which they are eliminated first, or multiplied as sparse columns."""

PART = 1e-6
"""Share of a direction of the null space, by the parameters' own information, from which one has a part in it."""


@dataclass(frozen=True, eq=False)
class LinearGaussian:
    """Information of readings and priors on P parameters; see the head of this module.

    Attributes:
        information: (P, P) N = J'J + diag(p), in one over the units of both its parameters.

    Raises:
        ShapeError: The information is not square.
        NotFiniteError: It is not finite.
    """

    information: Array

    def __post_init__(self) -> None:
        if self.information.ndim != 2 or len(set(self.information.shape)) != 1:
            raise ShapeError(f"information of shape {self.information.shape}, expected (P, P)")
        if not np.isfinite(self.information).all():
            raise NotFiniteError("information on parameters is not finite")

    @staticmethod
    def of(jacobian: Array, precision: Array) -> LinearGaussian:
        """Return the information of (n, P) whitened regressors and (P,) prior precisions, 0 where nothing was known."""
        return LinearGaussian(squared(jacobian) + np.diag(precision))

    @cached_property
    def scale(self) -> Array:
        """(P,) S, in the parameters' units: one over the root of a parameter's own information, 1 where it has none."""
        diagonal = np.diag(self.information)
        return np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 1.0)

    @cached_property
    def alone(self) -> np.ndarray:
        """(P,) which parameters have no information in common with one another, where many: those of an arrowhead."""
        alone, shared = np.zeros(len(self.information), dtype=bool), self.information != 0.0
        if np.count_nonzero(shared.sum(axis=0) <= len(alone) - MANY + 1) < MANY:
            return alone  # each of them shares nothing with all the others
        taken = np.zeros(len(alone), dtype=bool)
        for i in np.argsort(shared.sum(axis=0), kind="stable"):  # those that share least first
            if shared[i, i] and not taken[i]:
                alone[i] = True
                taken |= shared[i]
        return alone & (alone.sum() >= MANY)

    @cached_property
    def _axes(self) -> tuple[Array, Array, Array]:
        """(r,) information and (P, r) axes of what is determined, (P, k) axes of the null space; all scaled by S.

        Of the parameters that are not eliminated first. Where all is determined, axes are those of a triangular root.
        """
        scaled = self.information * self.scale * self.scale[:, None]
        alone = self.alone
        if alone.any():
            shared = scaled[np.ix_(~alone, alone)]
            scaled = scaled[np.ix_(~alone, ~alone)] - shared @ shared.T
        if (axes := _inverse_root(scaled)) is not None:
            return np.ones(len(axes)), self._with_alone(axes), np.empty((len(alone), 0))
        try:
            size, axes = np.linalg.eigh(scaled)
        except np.linalg.LinAlgError:  # now and then LAPACK's fast driver does not settle where the plain one does
            from scipy.linalg import eigh  # not needed to import the package

            size, axes = eigh(scaled, driver="ev")
        determined = size > ROUNDING
        return size[determined], self._with_alone(axes[:, determined]), self._with_alone(axes[:, ~determined])

    def _with_alone(self, axes: Array) -> Array:
        """Return (P, k) scaled axes of all parameters from those of all but the ones that are eliminated."""
        alone = self.alone
        if not alone.any():
            return axes
        whole = np.empty((len(alone), axes.shape[1]))
        whole[~alone] = axes
        shared = self.information[np.ix_(alone, ~alone)] * self.scale[~alone] * self.scale[alone, None]
        whole[alone] = -shared @ axes
        return whole

    @property
    def shared(self) -> Array:
        """(P, r) R with R R' the covariance, in the parameters' units; those that are `alone` have `scale` beside."""
        size, axes, _ = self._axes
        return self.scale[:, None] * axes / np.sqrt(size)

    @property
    def root(self) -> Array:
        """(P, r) the whole R."""
        return np.hstack([self.shared, np.diag(self.scale)[:, self.alone]])

    @cached_property
    def covariance(self) -> Array:
        """(P, P) posterior covariance of what is determined."""
        size, axes, _ = self._axes
        factor = self.scale[:, None] * axes
        return factor / size @ factor.T + np.diag(np.where(self.alone, self.scale**2, 0.0))

    @cached_property
    def null_space(self) -> Array:
        """(k, P) directions in which neither readings nor priors hold the parameters, in their units."""
        left = self._axes[2].T
        return np.where(np.abs(left) > PART, left, 0.0) * self.scale

    @property
    def std(self) -> Array:
        """(P,) posterior standard deviations, infinite where a parameter has a part in the null space."""
        return np.where(self.null_space.any(axis=0), np.inf, np.sqrt(np.diag(self.covariance)))

    def variance(self, rows: Array) -> Array:
        """Return the (n,) squares of (n, P) rows by the covariance, which is not formed; most may be zero in them."""
        moving = rows.any(axis=0)
        size, axes, _ = self._axes
        scaled = rows[:, moving] * self.scale[moving]
        return ((scaled @ axes[moving]) ** 2 / size).sum(axis=1) + (scaled[:, self.alone[moving]] ** 2).sum(axis=1)

    def solve(self, score: Array) -> Array:
        """Return N^-1 times a (P,) score J'y: the most probable values, in the parameters' units; or of (P, k) each."""
        if score.ndim == 1:
            return self.solve(score[:, None])[:, 0]
        size, axes, _ = self._axes
        scaled = self.scale[:, None] * score
        alone = np.where(self.alone[:, None], scaled, 0.0)
        return self.scale[:, None] * (axes @ ((axes.T @ scaled) / size[:, None]) + alone)

    def conditional(self, places: np.ndarray) -> LinearGaussian:
        """Return what is known of the parameters at `places` places when the values of all others are known."""
        return LinearGaussian(self.information[np.ix_(places, places)])

    def with_rows(self, rows: Array) -> LinearGaussian:
        """Return what is known after further readings, from their whitened Jacobian (..., P)."""
        flat = rows.reshape(-1, len(self.information))
        return LinearGaussian(self.information + flat.T @ flat)

    def with_precision(self, precision: Array) -> LinearGaussian:
        """Return what is known where (P,) precisions are added to the prior: other experience, a ridge, a damping."""
        return LinearGaussian(self.information + np.diag(precision))


def _inverse_root(scaled: Array) -> Array | None:
    """Return (P, P) V with V V' the inverse of a scaled matrix; None where it has a null space, or almost.

    The eigenvalues of the inverse are at most its trace, which is the sum of squares of V.
    """
    from scipy.linalg.lapack import dpotrf, dtrtri  # not needed to import the package

    root, failed = dpotrf(scaled, lower=1, clean=1)
    if not len(root):  # LAPACK complains of a triangle of nothing
        return root
    inverse = None if failed else dtrtri(root, lower=1)[0].T
    return None if inverse is None or not (inverse**2).sum() < 0.1 / ROUNDING else inverse


def depend_on(jacobian: Array, directions: Array) -> np.ndarray:
    """Return (N, d) which of (N, d, P) changes per unit of a parameter depend on one of (k, P) directions."""
    # What parameters do against each other cancels but for rounding, which is by the largest of the d numbers.
    size = (np.abs(jacobian) @ np.abs(directions.T)).max(axis=1, keepdims=True)
    # Share of what parameters do one by one that is left of it where they cancel each other
    return (np.abs(jacobian @ directions.T) > 1e-5 * size).any(axis=-1)


def squared(jacobian: Array) -> Array:
    """Return the (P, P) products J'J of (n, P) regressors; many that move few readings are multiplied as what they are.

    Their products are exactly zero where no reading moves with both, as `LinearGaussian` looks for.
    """
    rows, count = jacobian.shape
    few = np.zeros(count, dtype=bool)
    if count > MANY:
        few = np.count_nonzero(jacobian, axis=0) * MANY < rows
    if few.sum() < MANY:
        return jacobian.T @ jacobian
    from scipy.sparse import csr_array  # not needed to import the package

    sparse, dense, squares = csr_array(jacobian[:, few].T), jacobian[:, ~few], np.empty((count, count))
    squares[np.ix_(~few, ~few)] = dense.T @ dense
    between = sparse @ dense
    squares[np.ix_(few, ~few)], squares[np.ix_(~few, few)] = between, between.T
    squares[np.ix_(few, few)] = (sparse @ sparse.T).toarray()
    return squares


def most_probable(jacobian: Array, precision: Array, readings: Array) -> Array:
    """Return the (P,) most probable values.

    Args:
        jacobian: (n, P) whitened regressors.
        precision: (P,) prior precisions, 0 where nothing was known.
        readings: (n,) in their standard deviations.
    """
    return LinearGaussian.of(jacobian, precision).solve(jacobian.T @ readings)
