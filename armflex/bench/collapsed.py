"""Posterior of a network's hidden layer and noise with the linear output layer integrated out, in scaled units.

The paper's model (its eqs (20) to (22)): y = B v + noise, B the hidden values and a column of ones. Given the hidden
layer and the noise s_k, output k's weights v_k have a Gaussian prior of precision P, so that

    p(y_k | hidden, s_k) = N(0, s_k^2 I + B P^-1 B^T),    v_k | y_k, hidden, s_k = N(m_k, G_k^-1),
    G_k = B^T B / s_k^2 + P,    G_k m_k = B^T y_k / s_k^2.

What is left to sample is small and far less curved than the whole; v_k is drawn exactly afterwards. The determinant
lemma gives |s^2 I + B P^-1 B^T| = s^2N |G| / |P|, and the quadratic form is the least of a sum of squares, written
as |y - B m|^2 / s^2 + m P m rather than as a difference of large numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import get_lapack_funcs
from scipy.optimize import minimize
from scipy.special import gammaln

from armflex.bench.network_problem import GROUPS, NetworkProblem
from armflex.conventions import Array
from armflex.errors import InputError, NotFiniteError

dpotrf, dtrtri = get_lapack_funcs(("potrf", "trtri"))
# Several small factors: numpy's wrappers take longer than the work.

FLOOR = 0.5
"""Least curvature along which whitening believes the Hessian; a prior of precision 1 alone gives 1."""


@dataclass(frozen=True)
class Prior:
    """What is believed before any data, in scaled units.

    Attributes:
        precisions: (4,) of the Gaussian prior of each of `GROUPS`, all with mean zero.
        noise_shape, noise_scale: Of the inverse gamma prior of each s_k^2. As they stand they are worth one reading
            with an error of 1/1000 of its column's spread, so that data without noise still have a posterior.
    """

    precisions: Array = field(default_factory=lambda: np.ones(len(GROUPS)))
    noise_shape: float = 0.5
    noise_scale: float = 0.5e-6

    def __post_init__(self) -> None:
        positive = np.append(self.precisions, [self.noise_shape, self.noise_scale])
        if np.shape(self.precisions) != (len(GROUPS),) or not (positive > 0.0).all() or np.isinf(positive).any():
            raise InputError(f"prior of a network: expected {len(GROUPS)} precisions, a shape and a scale above 0")


@dataclass(frozen=True)
class Collapsed:
    """Density of theta, d = H (k + 1) + k numbers: the hidden layer in the order of `layers`, then k log s.

    Attributes:
        problem: The data.
        prior: Of weights and noise.
    """

    problem: NetworkProblem
    prior: Prior = field(default_factory=Prior)

    @property
    def dimension(self) -> int:
        """d."""
        return self._split + self.problem.size

    @property
    def _split(self) -> int:
        return self.problem.neurons * (self.problem.size + 1)

    @cached_property
    def _hidden_precision(self) -> Array:
        """(H (k + 1),) of the hidden layer."""
        return self.prior.precisions[self.problem.groups[: self._split]]

    @cached_property
    def _output_precision(self) -> Array:
        """(H + 1,) of one output's weights and offset, the diagonal of P."""
        return self.prior.precisions[[2] * self.problem.neurons + [3]]

    @cached_property
    def _data(self) -> tuple[Array, Array]:
        """(k + 1, N) loads with ones and (k, N) deflections, both scaled and with rows last as the sums want them."""
        return np.ascontiguousarray(self.problem.inputs.T), np.ascontiguousarray(self.problem.y.T)

    @cached_property
    def _constant(self) -> float:
        """Logarithm of every factor that depends on the data's and the priors' numbers alone."""
        shape, scale, size = self.prior.noise_shape, self.prior.noise_scale, self.problem.size
        noise = np.log(2.0) + shape * np.log(scale) - gammaln(shape)
        output = 0.5 * (np.log(self._output_precision).sum() - len(self.problem.x) * np.log(2.0 * np.pi))
        return float(size * (noise + output) + 0.5 * np.log(self._hidden_precision / (2.0 * np.pi)).sum())

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Return log p(y, theta) and its (d,) gradient; NaN where a number overflows, for samplers to turn back."""
        with np.errstate(all="ignore"):
            return self._density(theta)

    def _density(self, theta: Array) -> tuple[float, Array]:
        log_noise, weights = theta[self._split :], theta[: self._split]
        basis, parts = self._basis(weights), np.exp(-2.0 * log_noise)
        means, halves = self._conditional(basis, parts)
        errors = self._data[1] - means @ basis
        squares = np.einsum("kn,kn->k", errors, errors)
        log_roots = np.log(np.diagonal(halves, 0, 1, 2)).sum()  # of 1 / |G_k|, all outputs
        rows, pulls = len(self.problem.x) + 2.0 * self.prior.noise_shape, squares + 2.0 * self.prior.noise_scale
        cost = pulls @ parts + means**2 @ self._output_precision @ np.ones(len(means))
        cost += weights @ (self._hidden_precision * weights)
        gradient = np.empty(len(theta))
        taken = np.einsum("kij,kij,j->k", halves, halves, self._output_precision)  # tr(G^-1 P)
        gradient[self._split :] = pulls * parts + len(basis) - taken - rows
        gradient[: self._split] = self._pull(basis, parts, means, halves, errors) - self._hidden_precision * weights
        return float(self._constant + log_roots - rows * log_noise.sum() - 0.5 * cost), gradient

    def _basis(self, weights: Array) -> Array:
        """Return B^T, (H + 1, N)."""
        basis = np.ones((self.problem.neurons + 1, len(self.problem.x)))
        basis[:-1] = 0.5 + 0.5 * np.tanh(0.5 * (weights.reshape(self.problem.neurons, -1) @ self._data[0]))
        return basis

    def _conditional(self, basis: Array, parts: Array) -> tuple[Array, Array]:
        """Return (k, H + 1) means m_k and (k, H + 1, H + 1) inverse lower factors of G_k, under (k,) 1 / s_k^2."""
        wanted = np.multiply.outer(parts, basis @ basis.T) + np.diag(self._output_precision)
        halves = np.empty_like(wanted)
        for half, matrix in zip(halves, wanted, strict=True):
            factor, failed = dpotrf(matrix.T, lower=1, overwrite_a=1)  # transposed: LAPACK's own order, no copy
            half[:] = np.nan if failed else dtrtri(factor, lower=1, overwrite_c=1)[0]
        right = (self._data[1] @ basis.T) * parts[:, None]
        return ((halves @ right[:, :, None]).transpose(0, 2, 1) @ halves)[:, 0], halves

    def _pull(self, basis: Array, parts: Array, means: Array, halves: Array, errors: Array) -> Array:
        """Return the (H (k + 1),) gradient of log p(y | hidden, s): d/dB is sum_k ((y - B m) m^T - B G^-1) / s^2."""
        scaled = (halves * np.sqrt(parts)[:, None, None]).reshape(-1, len(basis))
        hidden = basis[:-1]
        slope = (means * parts[:, None])[:, :-1].T @ errors - (scaled[:, :-1].T @ scaled) @ basis
        slope *= hidden * (1.0 - hidden)
        return (slope @ self._data[0].T).ravel()

    def conditional(self, theta: Array) -> tuple[Array, Array]:
        """Return the (k, H + 1) means of the output layer at a theta, offsets last, and its covariances' roots.

        The (k, H + 1, H + 1) root R_k is upper triangular, with R_k R_k^T = G_k^-1 the covariance.
        """
        basis, parts = self._basis(theta[: self._split]), np.exp(-2.0 * theta[self._split :])
        means, halves = self._conditional(basis, parts)
        return means, np.swapaxes(halves, 1, 2)

    def redraw(self, theta: Array, rng: np.random.Generator) -> Array:
        """Return (P,) weights of the whole network: those of theta, with an output layer drawn from its conditional."""
        means, roots = self.conditional(theta)
        output = means + (roots @ rng.standard_normal((*means.shape, 1)))[..., 0]
        return np.concatenate([theta[: self._split], output.ravel()])

    def mean(self, theta: Array) -> Array:
        """Return (P,) weights of the whole network: those of theta, with the mean of the output layer."""
        return np.concatenate([theta[: self._split], self.conditional(theta)[0].ravel()])

    def noise(self, theta: Array) -> Array:
        """Return the (..., k) scaled noise in (..., d) thetas."""
        return np.exp(theta[..., self._split :])

    def start(self, weights: Array, noise: Array) -> Array:
        """Return the theta of (P,) weights of a whole network and (k,) scaled noise."""
        return np.concatenate([weights[: self._split], np.log(noise)])


def maximum(density: Collapsed, start: Array, iterations: int = 400) -> Array:
    """Return the (d,) maximum of the density near a start, by quasi-Newton steps (L-BFGS).

    Raises:
        NotFiniteError: The density is not finite at the start, or where the search ends.
    """

    def falling(theta: Array) -> tuple[float, Array]:
        value, gradient = density(theta)
        return (-value, -gradient) if np.isfinite(value) else (1e300, np.zeros_like(gradient))

    if not np.isfinite(density(start)[0]):
        raise NotFiniteError("log density of a network is not finite where the search for its maximum starts")
    options = {"maxiter": iterations, "maxcor": 30}
    found = minimize(falling, start, jac=True, method="L-BFGS-B", options=options).x
    if not np.isfinite(density(found)[0]):
        raise NotFiniteError("log density of a network is not finite where the search for its maximum ended")
    return found


def whitening(density: Collapsed, theta: Array, step: float = 1e-5) -> Array:
    """Return the (d, d) W for which theta + W z has about unit curvature in every direction of z.

    The Hessian comes from central differences of the gradient. Curvatures of the wrong sign, as a search that ended
    early leaves them, count by their size.
    """
    moves = step * np.eye(len(theta))
    hessian = np.array([density(theta - move)[1] - density(theta + move)[1] for move in moves]) / (2.0 * step)
    values, vectors = np.linalg.eigh(0.5 * (hessian + hessian.T))
    return vectors / np.sqrt(np.maximum(np.abs(values), FLOOR))
