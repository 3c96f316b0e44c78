"""Variance components: how large each of several kinds of unknown is, by the evidence (restricted maximum likelihood).

Readings y, whitened, are what is fitted anyway, plus columns X (n, K) times unknown amplitudes, plus noise of one size:

    y = A x + X b + e,        b_k ~ N(0, v d_k),        e ~ N(0, v),        d_k = sum_c r_c V_ck

Component c (compliance at every joint, say) gives column k the variance r_c V_ck by the noise's, so that components
may share columns: a smooth curve is one basis, with a spectrum for each length. What is fitted anyway is projected out
with its priors, M = 1 - A N^-1 A' of n degrees of freedom, and G = X'MX, g = X'My and J0 = y'My are made once. Then

    log p(y | r) = -1/2 log|Q| - n/2 log J,    Q = 1 + D^1/2 G D^1/2,    Q z = D^1/2 g,    J = J0 - g'D^1/2 z

is the likelihood of mixed models (Patterson and Thompson 1971, Biometrika 58, 545-554; Harville 1977, JASA 72, 320-338)
at the noise v = J / n that fits best. The amplitudes are b = D^1/2 z, with covariance v D^1/2 Q^-1 D^1/2. Columns of no
variance drop out, so a component that is not there has size zero.

Sizes climb by their logarithms: Newton's steps with the average information (Gilmour, Thompson and Cullis 1995,
Biometrics 51, 1440-1450), damped as Levenberg and Marquardt do. The slope by log r_c is that of the columns, z_k^2 / 2v
- (1 - [Q^-1]_kk) / 2 each, by the share of its variance that is the component's; the average information of two
components is m_b'(G - G D^1/2 Q^-1 D^1/2 G) m_c / 2v with m_c = r_c V_c D^-1/2 z, that is u_b'(1 - Q^-1) u_c / 2v with
u_c = D^-1/2 m_c.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri, dtrtrs

from armflex.conventions import RESOLUTION, Array
from armflex.errors import ConvergenceError
from armflex.estimate.fit import THOROUGH


@dataclass(frozen=True, eq=False)
class MixedModel:
    """Columns with unknown amplitudes beside what is fitted anyway; see the head of this module.

    Attributes:
        gram: (K, K) G, products of the columns beside what is fitted anyway.
        score: (K,) g, their products with the readings.
        objective: J0, the readings' square without any column.
        freedom: n.
        variances: (C, K) V, variance of each column's amplitude per unit of a component's.
        least: Information of the readings on an amplitude, by that of its prior, below which it is left out.
    """

    gram: Array
    score: Array
    objective: float
    freedom: float
    variances: Array
    least: float = RESOLUTION

    @cached_property
    def unit(self) -> Array:
        """(C,) of each component the variance by the noise's that a unit of its own makes of a reading, on average."""
        return self.variances @ np.diag(self.gram) / self.freedom

    @property
    def usual(self) -> Array:
        """(C,) variances by the noise's of which each makes a tenth of the noise's at a reading."""
        return 0.1 / np.where(self.unit > 0.0, self.unit, np.inf)

    def among(self, places: np.ndarray) -> Array:
        """Return the (k, k) products of some columns with one another, held of the last that were asked."""
        if not self._held or not np.array_equal(self._held["places"], places):
            self._held["places"], self._held["gram"] = places, self.gram.take(places, 0).take(places, 1)
        return self._held["gram"]

    @cached_property
    def _held(self) -> dict[str, np.ndarray]:
        return {}

    def at(self, ratios: Array) -> Components:
        """Return the model with (C,) variances of the components by the noise's."""
        return Components(self, np.asarray(ratios, dtype=float))

    def fitted(self, start: Components | None = None, steps: int = THOROUGH.iterations) -> Components:
        """Return the model with the variances that maximise the likelihood; what gains nothing is zero.

        Args:
            start: Variances to begin with; zero ones stay zero. When not given they are the `usual` ones.
            steps: At most.

        Raises:
            ConvergenceError: The columns are not finite.
        """
        here, damping = self.at(self.usual) if start is None else start, 1e-3
        farthest = np.log(100.0)  # a size changes by ten times in one step at most
        for _ in range(steps):
            here = here.without_idle()
            free = here.ratios > 0.0
            if not free.any():
                return here
            slope, curvature, promised = here.slope, here.average_information, 0.0
            while damping < 1e9:
                held = curvature[np.ix_(free, free)] + damping * np.eye(free.sum())
                step = np.zeros(len(free))
                step[free] = np.clip(np.linalg.solve(held, slope[free]), -farthest, farthest)
                promised = float(slope @ step)
                there = self.at(here.ratios * np.exp(step))
                if there.log_likelihood > here.log_likelihood:
                    break
                damping *= 10.0
            else:
                break
            gain = there.log_likelihood - here.log_likelihood
            here, damping = there, max(0.1 * damping, 1e-6)
            if max(gain, promised) < THOROUGH.flat:
                break
        return here.without_idle()

    def fitted_near(self, start: Components) -> Components:
        """Return the model with the variances that maximise the likelihood, sought from others.

        What is not there comes in where the likelihood rises with it, each once.

        Raises:
            ConvergenceError: The columns are not finite.
        """
        here, waiting = self.fitted(start), start.ratios == 0.0
        while (rising := waiting & (here.gains_with > THOROUGH.flat)).any():
            waiting &= ~rising
            here = self.fitted(self.at(np.where(rising, self.usual, here.ratios)))
        return here


@dataclass(frozen=True, eq=False)
class Components:
    """A mixed model with sizes of its components.

    Attributes:
        model: The model.
        ratios: (C,) r, variances by the noise's, 0 where a component is not there.
    """

    model: MixedModel
    ratios: Array

    @cached_property
    def spread(self) -> Array:
        """(K,) D^1/2, standard deviation of each amplitude by the noise."""
        variance = self.ratios @ self.model.variances
        return np.sqrt(np.where(variance * np.diag(self.model.gram) > self.model.least, variance, 0.0))

    @cached_property
    def columns(self) -> np.ndarray:
        """(k,) those that are there."""
        return np.flatnonzero(self.spread)

    @cached_property
    def _root(self) -> Array:
        """(k, k) Cholesky factor L of Q."""
        at = self.columns
        whole = self.model.among(at) * self.spread[at]
        whole *= self.spread[at, None]
        whole[np.diag_indices(len(at))] += 1.0
        if not len(at):
            return whole
        root, failed = dpotrf(whole.T, lower=1, overwrite_a=1)
        if failed:
            raise ConvergenceError("the columns of families are not finite", ())
        return root

    @cached_property
    def _inverse(self) -> Array:
        """(k, k) L^-1."""
        return dtrtri(self._root, lower=1)[0] if len(self.columns) else self._root

    @cached_property
    def _pull(self) -> Array:
        """(k,) L^-1 D^1/2 g."""
        score = self.spread[self.columns] * self.model.score[self.columns]
        return dtrtrs(self._root, score, lower=1)[0] if len(score) else score

    @cached_property
    def scaled(self) -> Array:
        """(k,) z, amplitudes by their standard deviations before anything was read."""
        return dtrtrs(self._root, self._pull, lower=1, trans=1)[0] if len(self._pull) else self._pull

    @cached_property
    def left(self) -> float:
        """J, the readings' square beside what the columns explain."""
        return max(self.model.objective - float(self._pull @ self._pull), 1e-12 * self.model.objective)

    @property
    def noise(self) -> float:
        """Standard deviation of the readings over that by which they were whitened."""
        return float(np.sqrt(self.left / self.model.freedom))

    @cached_property
    def volume(self) -> float:
        """log|Q|."""
        return 2.0 * float(np.log(np.diag(self._root)).sum())

    @cached_property
    def log_likelihood(self) -> float:
        """Logarithm of the restricted likelihood at the noise that fits best, but for a constant."""
        return self._likelihood(self.volume, self.left)

    def _likelihood(self, volume: float, left: float) -> float:
        return -0.5 * volume - 0.5 * self.model.freedom * float(np.log(left / self.model.freedom))

    @cached_property
    def _shares(self) -> Array:
        """(C, k) share of each component in the variance of a column."""
        at = self.columns
        return self.ratios[:, None] * self.model.variances[:, at] / self.spread[at] ** 2

    @cached_property
    def slope(self) -> Array:
        """(C,) change of the log likelihood per logarithm of a ratio."""
        inverse = np.einsum("ik,ik->k", self._inverse, self._inverse)
        return self._shares @ (0.5 * self.scaled**2 / self.noise**2 - 0.5 * (1.0 - inverse))

    @cached_property
    def average_information(self) -> Array:
        """(C, C) average of the observed and the expected information on the logarithms of the ratios.

        The noise is free as well: its part is eliminated.
        """
        variance, shared = self.noise**2, self.scaled[:, None] * self._shares.T  # (k, C): D^-1/2 m_c
        left = self._inverse @ shared
        inside = shared.T @ shared - left.T @ left
        # P y times what noise would be: its cross products with the others are those with the residual.
        by_noise = shared.T @ self.scaled
        shares = 0.5 * inside / variance
        cross = 0.5 * by_noise / variance
        return shares - np.outer(cross, cross) / (0.5 * self.model.freedom)

    @property
    def gains_with(self) -> Array:
        """(C,) nats that a component promises which is not there, by its slope and what it is known by alone."""
        inside = self._inverse @ (self.spread[self.columns, None] * self.model.gram[self.columns])
        score = self.model.score - inside.T @ self._pull
        left = np.diag(self.model.gram) - np.einsum("kK,kK->K", inside, inside)
        slope = 0.5 * self.model.variances @ (score**2 / self.noise**2 - left)
        information = 0.5 * self.model.variances**2 @ left**2
        rises = (self.ratios == 0.0) & (slope > 0.0) & (information > 0.0)
        return np.where(rises, 0.5 * slope**2 / np.where(rises, information, 1.0), 0.0)

    @property
    def promised(self) -> float:
        """Rise of the log likelihood that Newton's next step promises."""
        free = self.ratios > 0.0
        slope, curvature = self.slope[free], self.average_information[np.ix_(free, free)]
        return 0.5 * float(slope @ np.linalg.lstsq(curvature, slope)[0])

    def without_idle(self) -> Components:
        """Return the same without components on whose way to zero nothing is lost.

        One whose size is known to a factor of e is not idle. All are left out together where nothing is lost with them,
        else each half of them, those that fall most first.
        """
        here, unsure = self, np.diag(self.average_information) < 1.0
        falling = np.flatnonzero((self.ratios > 0.0) & (self.slope < 0.0) & unsure)
        waiting = [falling[np.argsort(self.slope[falling])].tolist()]
        while waiting:
            some = waiting.pop()
            if some and (less := here.without(*some)).log_likelihood > here.log_likelihood - THOROUGH.flat:
                here = less
            elif len(some) > 1:
                waiting += [some[len(some) // 2 :], some[: len(some) // 2]]
        return here

    def without(self, *gone: int) -> Components:
        """Return the same without some components, the others as they are."""
        ratios = self.ratios.copy()
        ratios[list(gone)] = 0.0
        return self.model.at(ratios)

    def lost_without(self, *gone: int) -> float:
        """Return the nats that are lost where some components are left out, and the others keep their sizes.

        Where they leave with their columns, L^-1 has what is left: |Q| is divided by |I|, and J grows by z' I^-1 z,
        with I the part of Q^-1 of those columns and z their amplitudes.
        """
        fewer = self.without(*gone)
        before, after = self.spread[self.columns], fewer.spread[self.columns]
        leaving = np.flatnonzero(after == 0.0)
        if not np.array_equal(np.delete(before, leaving), np.delete(after, leaving)):
            return self.log_likelihood - fewer.log_likelihood
        axes, values = self._inverse[:, leaving], self.scaled[leaving]
        inside = axes.T @ axes
        left = self.left + float(values @ np.linalg.solve(inside, values))
        return self.log_likelihood - self._likelihood(self.volume + float(np.linalg.slogdet(inside)[1]), left)

    @cached_property
    def amplitudes(self) -> Array:
        """(K,) most probable amplitudes."""
        sizes = np.zeros(len(self.spread))
        sizes[self.columns] = self.spread[self.columns] * self.scaled
        return sizes
