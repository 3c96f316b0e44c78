"""MAP least squares: Gauss-Newton on whitened residuals with physical priors, robust to lost-beam outliers."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from math import tau

import numpy as np

from armflex.arm import Setup
from armflex.conventions import Array
from armflex.errors import FEW, ArmflexError, ConvergenceError
from armflex.estimate.block import Block, parameters_of, places_of
from armflex.estimate.robust import (
    BY_CHANCE,
    EVEN,
    chi_squared,
    huber_weights,
    median_scatter,
    objective,
    outlier_limit,
    robust_limit,
    whitened_regressors,
    whitened_residual,
)
from armflex.estimate.view import View, look
from armflex.linear_gaussian import LinearGaussian, squared
from armflex.measured.measurements import Measurements
from armflex.parameters import ArmParameter
from armflex.progress import Progress

LIGHT = 1e-4
"""Tolerance: least damping, relative to a parameter's own information."""


@dataclass(frozen=True)
class Effort:
    """How far a fit goes.

    Attributes:
        iterations: Steps at most.
        flat: Fall of the cost (-2 log posterior density) below which there is nothing left to gain: a step that
            promises no more is not tried, and one that gains no more at noise as stated is the last.
        content: Whether what is reached is taken where it does not settle, rather than an error raised.
    """

    iterations: int
    flat: float
    content: bool


THOROUGH = Effort(200, 1e-2, content=False)
ROUGH = Effort(10, 0.3, content=True)
"""Tolerances, of which the second compares candidates: a fall of 0.3 is a tenth of what distinguishes two, and some
laws have kinks."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A setup with values applied: where a fit is, or has come to.

    Attributes:
        declared: The setup before any value is applied.
        blocks: What was free.
        values: (P,) deviations from the declared values in the parameters' units, all blocks in order.
        view: The campaign's fitted rows at these values.
        history: Objective after each step; none while it goes on.
        left: Fall of the cost that was still to be had where the steps ended unsettled, over that which noise as stated
            would make of 1; 0 where they settled.
        factors: (G,) on the stated standard deviations of what each instrument read; none where all are 1.
    """

    declared: Setup
    blocks: tuple[Block, ...]
    values: Array
    view: View
    history: tuple[float, ...] = ()
    left: float = 0.0
    factors: tuple[float, ...] = ()

    @property
    def setup(self) -> Setup:
        """The arm and the instrument at these values."""
        return self.view.setup

    @cached_property
    def weights(self) -> Array:
        """(M, d) robust weight of each number, dimensionless, 1 for most."""
        return huber_weights(self.view)

    @cached_property
    def labels(self) -> tuple[tuple[str, str], ...]:
        """(block, label) of every parameter."""
        return tuple((parameter.group.block, parameter.rest) for parameter in self.parameters)

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """What was free, in its order."""
        return parameters_of(self.blocks)

    @cached_property
    def prior(self) -> Array:
        """(P,) prior standard deviations in the parameters' units."""
        return prior_of(self.blocks)

    @cached_property
    def precision(self) -> Array:
        """(P,) prior precisions in the parameters' units, 0 where nothing was known."""
        return self.prior**-2.0

    @cached_property
    def scale(self) -> Array:
        """(M, d) factors that whiten and weight readings, in one over their units."""
        return np.sqrt(self.weights) / self.view.sigma

    @cached_property
    def regressors(self) -> Array:
        """(M, P) whitened and weighted change of M readings per unit of a parameter, dimensionless."""
        return whitened_regressors(self.blocks, self.view, self.weights)

    @cached_property
    def residual(self) -> Array:
        """(M,) whitened and weighted residuals of M readings, dimensionless."""
        return whitened_residual(self.view, self.weights)

    @cached_property
    def information(self) -> Array:
        """(P, P) information of the readings alone on the values, in their units: products of the columns."""
        return squared(self.regressors)

    @cached_property
    def freedom(self) -> float:
        """Number of readings less what was fitted to them: a parameter that its prior holds takes nothing."""
        held = np.diag(self._as_stated.covariance) * self.precision
        taken = (1.0 - held).sum() - len(self._as_stated.null_space)
        return max(float(self.view.count - taken), 1.0)

    @property
    def noise(self) -> float:
        """Standard deviation of the readings over that by which they were weighed, if the residual is nothing else.

        A reading that is far off counts as one at the limit (Huber's proposal 2), so that a lost beam is no noise.
        """
        within = self.residual * np.sqrt(self.weights.ravel())
        return float(np.sqrt(within @ within / self.freedom))

    @cached_property
    def scatters(self) -> tuple[float, ...]:
        """(G,) standard deviation of what each instrument read over the stated one, if the residual is nothing else."""
        factors = self.factors or (1.0,) * len(self.view.readings.groups)
        return tuple(factor * noise for factor, (noise, _) in zip(factors, self.noises, strict=True))

    @cached_property
    def noises(self) -> tuple[tuple[float, float], ...]:
        """(G, 2) of each instrument: `noise` of what it read alone, and its share of `freedom`.

        What is fitted to it is the trace of its part of the hat matrix. Where so much of it is far off that `noise`
        would be of that, the median determines it.
        """
        groups = self.view.readings.groups
        if len(groups) == 1:
            return ((self._by_most(0, self.noise, self.freedom), self.freedom),)
        within = (self.residual * np.sqrt(self.weights.ravel())).reshape(self.view.residual.shape)
        columns, noises = self.regressors.reshape(*self.view.residual.shape, -1), []
        for number, (place, count) in enumerate(zip(groups, self.view.counts, strict=True)):
            part = columns[:, place].reshape(-1, columns.shape[2])
            taken = float((self._as_stated.covariance * (part.T @ part)).sum())
            freedom = max(count - taken, 1.0)
            noise = float(np.sqrt((within[:, place] ** 2).sum() / freedom))
            noises.append((self._by_most(number, noise, freedom), freedom))
        return tuple(noises)

    def _by_most(self, number: int, noise: float, freedom: float) -> float:
        """Return the noise of an instrument, from the median where readings far off would make up most of it.

        Each of those adds the square of the limit to a sum that is to be one a number, and weighing by what comes of it
        would add more: where they make up most of it proposal 2 soon has no finite answer (Huber 1981, 6.6).
        """
        place = self.view.readings.groups[number]
        count = np.isfinite(self.view.sigma[:, place]).sum(axis=1)
        far = ((self.weights[:, place] < 1.0) & np.isfinite(self.view.sigma[:, place])).sum(axis=1)
        limits = np.array(
            [outlier_limit(max(int(size), 1)) ** 2 / max(int(size), 1) for size in range(count.max() + 1)]
        )
        if 2.0 * (far * limits[count]).sum() < count.sum():
            return noise
        return median_scatter(self.view, number) * float(np.sqrt(count.sum() / freedom))

    @property
    def stated(self) -> Array:
        """(M, d) standard deviation of each number as it was stated, in its unit."""
        sigma = self.view.sigma.copy()
        for place, factor in zip(self.view.readings.groups, self.factors, strict=False):
            sigma[:, place] /= factor
        return sigma

    @property
    def scatter_by_number(self) -> Array:
        """(d,) `noise` of the instrument that each number of a row is read by."""
        scatter = np.ones(self.view.readings.size)
        for place, (noise, _) in zip(self.view.readings.groups, self.noises, strict=True):
            scatter[place] = noise
        return scatter

    @property
    def misfit(self) -> float:
        """Standard deviation of each coordinate [m] beyond the stated one, 0 where the readings scatter as stated.

        Of pictures it is the shift of what they show that makes as many pixels.
        """
        pairs = zip(self.scatters, self.noises, strict=True)
        if self.view.readings.unit not in ("m", "px") or all(
            by_chance(scatter, freedom) for scatter, (_, freedom) in pairs
        ):
            return 0.0
        now, before = (
            sigma[:, self.view.foremost] for sigma in (self.view.sigma * self.scatter_by_number, self.stated)
        )
        read = np.isfinite(now)
        stated, judged = (float((sigma[read] ** 2).mean()) for sigma in (before, now))
        per_metre = float((self.view.by_shift[:, self.view.foremost][read] ** 2).mean())
        return float(np.sqrt(max(judged - stated, 0.0) / per_metre))

    @cached_property
    def posterior(self) -> LinearGaussian:
        """What is known of the values; readings that scatter more than was stated count that much less."""
        noise = self.noise
        information = LinearGaussian(self.information / noise**2)
        return information.with_precision(self.precision) if noise > 1.0 else self._as_stated

    @cached_property
    def _as_stated(self) -> LinearGaussian:
        """What is known if the readings scatter as was stated."""
        return LinearGaussian(self.information).with_precision(self.precision)

    @property
    def rms(self) -> float:
        """RMS of the 3-D position error over the fitted rows [m]; see `View.rms`."""
        return self.view.rms(self.view.residual)

    def cost(self, limit: Array | float) -> float:
        """Return -2 log posterior density but for a constant; rows beyond `limit` times the noise count less.

        `limit` is (G,) of every instrument, or one for all, dimensionless.
        """
        return objective(self.view, self.values, self.prior, limit)

    def places(self, block: Block) -> np.ndarray:
        """Return the (k,) places of one block's parameters among all."""
        return places_of(block, self.blocks)

    def value(self, block: str) -> Array:
        """Return the (k,) values of the block of a name, in their parameters' units."""
        named = {candidate.name: candidate for candidate in reversed(self.blocks)}
        return self.values[self.places(named[block])]


@dataclass(frozen=True, eq=False)
class WeighedReadings:
    """Readings with (G,) factors on the stated standard deviations of every instrument, 1 or more; none is 1 of all.

    Each is weighed by its own scatter: one that states too little would else make all others count less.
    """

    stated: Measurements
    factors: tuple[float, ...] = ()

    @cached_property
    def measurements(self) -> Measurements:
        """The readings with these standard deviations."""
        if not self.factors:
            return self.stated
        return replace(self.stated, readings=self.stated.readings.scaled(*self.factors))

    def again(self, fitted: Fit) -> WeighedReadings:
        """Return the readings weighed by how they scatter about a fit to these."""
        factors = []
        for before, (noise, freedom) in zip(self.factors or (1.0,) * len(fitted.noises), fitted.noises, strict=True):
            scatter = before * noise
            factors.append(1.0 if by_chance(scatter, freedom) else max(float(scatter), 1.0))
        return replace(self, factors=tuple(factors) if max(factors, default=1.0) > 1.0 else ())

    def close_to(self, other: WeighedReadings) -> bool:
        """Return whether nothing is gained by one after the other."""
        pairs = zip_longest(self.factors, other.factors, fillvalue=1.0)
        return all(abs(np.log(factor / before)) <= EVEN for factor, before in pairs)


def by_chance(scatter: float, freedom: float) -> bool:
    """Return whether so many readings scatter by chance so many times as much as they state; see `BY_CHANCE`."""
    return scatter**2 * freedom <= chi_squared(freedom, BY_CHANCE)


def prior_of(blocks: Sequence[Block]) -> Array:
    """Return the (P,) prior standard deviations of all blocks."""
    return np.concatenate([np.zeros(0), *(block.prior for block in blocks)])


def moved(blocks: Sequence[Block], values: Array, step: Array) -> Array:
    """Return the (P,) values after a step that is meant to first order.

    A factor's logarithm follows as the factor itself would in a straight line: exp(4) times is never meant by a column.
    """
    return values + np.where(_logarithmic(blocks), np.sign(step) * np.log1p(np.abs(step)), step)


def _logarithmic(blocks: Sequence[Block]) -> np.ndarray:
    """Return (P,) whether a value is the logarithm of a factor."""
    return np.array([block.logarithmic for block in blocks for _ in block.parameters], dtype=bool)


def realise(declared: Setup, blocks: Sequence[Block], values: Array) -> Setup:
    """Return the declared setup with all (P,) values applied."""
    setup, start = declared, 0
    for block in blocks:
        count = len(block.parameters)
        setup = block.apply(setup, values[start : start + count])
        start += count
    return setup


def looked_at(here: Fit, blocks: Sequence[Block], values: Array) -> View:
    """Return the rows of a fit at (P,) values of these blocks, its own or others."""
    return look(realise(here.declared, blocks, values), here.view.driven, here.view.rows)


def fit(
    declared: Setup,
    blocks: Sequence[Block],
    measurements: Measurements,
    rows: np.ndarray | None = None,
    start: Array | None = None,
    progress: Progress | None = None,
    effort: Effort = THOROUGH,
) -> Fit:
    """Return the most probable values of all blocks.

    Args:
        declared: Arm and instrument before the fit.
        blocks: What is free.
        measurements: The campaign.
        rows: Row numbers to use; all measured rows when not given.
        start: (P,) values to start from; zero when not given.
        progress: Called with (steps done, steps at most).
        effort: When to stop, and whether to be content with what is reached.

    Raises:
        ConvergenceError: The steps did not settle.
        ArmflexError: The arm has no equilibrium at the first guess.
    """
    used = np.flatnonzero(measurements.measured) if rows is None else rows
    values = np.zeros(len(parameters_of(blocks))) if start is None else start
    view = look(realise(declared, blocks, values), measurements, used)
    here, history = Fit(declared, tuple(blocks), values, view), list[float]()
    damping, limit, fall = 0.0, np.inf, np.inf
    for iteration in range(effort.iterations):
        # A limit that rose and fell with the residuals' median could keep the fit going round in circles.
        limit = np.minimum(limit, robust_limit(here.view))
        before, problem = here.cost(limit), _problem(here, limit)
        unit = max(1.0, before / here.view.count)  # while the model is wrong the residual is many times the noise
        descended = _descended(here, problem, limit, effort.flat, damping)
        if descended is None:
            left = problem.promised(problem.step(max(damping, LIGHT))) / unit
            if effort.content or left < effort.flat:  # a step that promises nothing need not keep anything
                return replace(here, history=tuple(history), left=left if effort.content else 0.0)
            raise _resisting("calibration finds no better values along its step", here, problem, [before])
        here, damping = descended
        history.append(here.cost(limit))
        if progress:
            progress(iteration + 1, effort.iterations)
        fall = (before - history[-1]) / unit
        # A step that damping halves is short because it must be, not because it has arrived.
        if fall < effort.flat and (damping < 1.0 or not effort.content):
            return replace(here, history=tuple(history))
    if not effort.content:
        raise _resisting("calibration did not settle", here, _problem(here, limit), history)
    return replace(here, history=tuple(history), left=fall)


@dataclass(frozen=True)
class _Problem:
    """The linear problem about an iterate.

    Attributes:
        known: Information of rows and priors there.
        gradient: (P,) minus half the gradient of the cost.
        bend: (P,) what Gauss and Newton leave out of a logarithm's curvature: its column is its second derivative, too.
        turning: (P,) precision of a step, 0 but of angles that no prior holds, of which a turn is the standard
            deviation: they mean nothing beyond. Readings that hardly depend on such an angle would let rounding turn it
            without end. What is known of it is not changed.
        regressors, residual: (M, P) and (M,) of the readings, weighted by `weights`, which are (N, d).
    """

    known: LinearGaussian
    gradient: Array
    bend: Array
    turning: Array
    regressors: Array
    residual: Array
    weights: Array

    def step(self, damping: float) -> Array:
        """Return the Gauss-Newton step, damped as Levenberg and Marquardt do, by a share of a parameter's information.

        A compliance that is drawn towards zero would go past it and back for ever without its `bend`; where steps keep
        their promises it is only in the way.
        """
        return self._damped(damping).solve(self.gradient)

    def bent(self, step: Array, damping: float, after: View) -> Array:
        """Return a step that follows how readings bend along it, measured where it led: one more with the same columns.

        Where valleys of the cost are narrow and bend, straight steps must be short (Transtrum and Sethna 2012).
        """
        beyond = whitened_residual(after, self.weights) - (self.residual - self.regressors @ step)
        return step + self._damped(damping).solve(self.regressors.T @ beyond)

    def _damped(self, damping: float) -> LinearGaussian:
        if not damping and not self.turning.any():
            return self.known
        if damping not in self._factored:  # once for a step and for how it bends
            damped = damping * np.diag(self.known.information) + self.bend if damping else 0.0
            self._factored.clear()
            self._factored[damping] = self.known.with_precision(damped + self.turning)
        return self._factored[damping]

    @cached_property
    def _factored(self) -> dict[float, LinearGaussian]:
        return {}

    def promised(self, step: Array) -> float:
        """Return the fall of the cost that the linear problem promises of a step."""
        return float(step @ (2.0 * self.gradient - self.known.information @ step))


def _problem(here: Fit, limit: Array | float) -> _Problem:
    """Return the linear problem about an iterate."""
    weights = huber_weights(here.view, limit)
    regressors = whitened_regressors(here.blocks, here.view, weights)
    residual = whitened_residual(here.view, weights)
    pull = regressors.T @ residual
    gradient = pull - here.precision * np.where(np.isfinite(here.prior), here.values, 0.0)
    bend = np.where(_logarithmic(here.blocks), np.maximum(-pull, 0.0), 0.0)
    turns = np.array([parameter.unit == "rad" for parameter in here.parameters], bool)
    turning = np.where(turns & np.isinf(here.prior), tau**-2.0, 0.0)
    posterior = LinearGaussian.of(regressors, here.precision)
    return _Problem(posterior, gradient, bend, turning, regressors, residual, weights)


def _descended(
    here: Fit, problem: _Problem, limit: Array | float, least: float, damping: float
) -> tuple[Fit, float] | None:
    """Return the iterate after a step, damped until the cost falls or is flat, and the next damping.

    None where steps that promise `least` are none. Laws have kinks, and along some directions only priors hold: a full
    step may be far too long in a few of them.
    """

    def stepped(step: Array) -> tuple[Fit, float]:
        values = moved(here.blocks, here.values, step)
        there = replace(here, values=values, view=looked_at(here, here.blocks, values))
        return there, there.cost(limit)

    before, start, promised = here.cost(limit), damping, np.inf
    while promised > least:
        step = problem.step(damping)
        promised = problem.promised(step)
        more = max(10.0 * damping, LIGHT)
        with contextlib.suppress(ArmflexError):
            trial, after = stepped(step)
            if 2.0 * (before - after) < promised:
                bent = stepped(problem.bent(step, damping, trial.view))
                trial, after = min((trial, after), bent, key=lambda pair: pair[1])
            if after <= before + 1e-9 * abs(before):
                if 2.0 * (before - after) < promised:  # a step too long may fall, and fall back
                    return trial, more
                # What had to be damped more just now is not asked with less at once: it would fail again.
                less = damping / 10.0
                return trial, damping if damping > start else less
        damping = more
    return None


def _resisting(text: str, here: Fit, problem: _Problem, history: Sequence[float]) -> ConvergenceError:
    """Return the error of a fit that ended unsettled, with the parameters and rows that keep it from settling."""
    step, names, view = problem.step(LIGHT) / problem.known.std, here.parameters, here.view
    most = [int(i) for i in np.argsort(-np.abs(step))[:FEW] if np.isfinite(step[i]) and step[i] != 0.0]
    moving = ", ".join(f"{names[i].label} by {abs(step[i]):.2g} of its uncertainty" for i in most)
    squares, places = (np.nan_to_num(view.residual / view.sigma) ** 2).sum(axis=1), view.driven.places
    worst = np.argsort(-squares)[:FEW]
    far = ", ".join(str(places[view.rows[i]] if places else f"row {view.rows[i]}") for i in worst)
    share = squares[worst].sum() / (float(squares.sum()) or 1.0)
    still = f"still moving: {moving or 'nothing'}"
    return ConvergenceError(f"{text}; {still}; {share:.0%} of what is left is at {far}", history)
