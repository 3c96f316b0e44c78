"""What is predicted: the average over the models that resamples of a campaign give.

Readings are linear in amplitudes and, about a fit, in all that is fitted anyway, so that the mean of what some models
predict is what one arm predicts that has all their effects, each with the mean of its amplitude over the models, zero
in those that lack it (Hoeting, Madigan, Raftery and Volinsky 1999, "Bayesian model averaging: a tutorial", Statistical
Science 14). Loads times compliances are not linear: the values are then moved to where the arm does predict that mean.
The covariance of values has two parts, what each model leaves uncertain and how values x differ between models,

    Cov(x) = E[Cov(x | model)] + Cov(E[x | model]).

Where effects were measured the models agree: what one lacks another has. Elsewhere they need not, the mean is the
smaller, nearer to what the calibrated arm predicts, for it, and sigma has in it how far they are apart.

That is right where one of the models is. Poses that are held out, with everything chosen anew without them, say whether
the average predicts them better than the calibrated arm: where it does not, the calibrated arm is one more of those
over which is averaged, with the weight by which both together predict them best (Yao, Vehtari, Simpson and Gelman 2018,
"Using stacking to average Bayesian predictive distributions", Bayesian Analysis 13).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve
from scipy.special import ndtri

from armflex.arm import Setup
from armflex.conventions import Array
from armflex.errors import ArmflexError
from armflex.estimate.block import Block, EffectBlock, parameters_of, places_of
from armflex.estimate.fit import ROUGH, THOROUGH, looked_at, moved, realise
from armflex.estimate.held_out import POSE_FOLDS, errors_of, held_out, pose_folds
from armflex.estimate.robust import whitened_regressors, whitened_residual
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.shapes import ROUNDING
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import DOUBT, Certainty, numbers_of
from armflex.trace.probabilities import Drawn, bagged
from armflex.trace.resampling import Resampled
from armflex.trace.screen import Dense
from armflex.trace.selection import Model
from armflex.trace.state import State
from armflex.trace.validate import Folds


@dataclass(frozen=True, eq=False)
class Averaged:
    """An arm as it is predicted with.

    Attributes:
        state: What was found, and families.
        rivals: Effects that some models have in the place of what was found, or beside it.
        values: (P,) of what is fitted, in its order, and then of the rivals.
        spread: (P, P) covariance of the values between models.
        scatter: (P,) variance of the values of what was found as parts of the campaign differ.
        errors: (M, n) of what is read foremost on poses held out, everything chosen and fitted without them [m]; None
            where none were.
        share: Weight of what was found and of families, 1 less that of the calibrated arm.
        shares: Of the models that have each rival.
    """

    state: State
    rivals: tuple[EffectBlock, ...]
    values: Array
    spread: Array
    scatter: Array
    errors: Array | None = None
    share: float = 1.0
    shares: tuple[float, ...] = ()

    @property
    def blocks(self) -> tuple[Block, ...]:
        """All that has values."""
        return (*self.state.fit.blocks, *self.rivals)

    @property
    def setup(self) -> Setup:
        """Arm and instrument at the values, with all that effects change in the model."""
        return realise(self.state.declared, self.blocks, self.values)

    @property
    def added(self) -> tuple[EffectBlock, ...]:
        """Everything that the arm has beside what was declared."""
        return (*self.state.effects, *self.state.background.effects, *self.rivals)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The same with its values."""
        return tuple(block.at(self.values[places_of(block, self.blocks)]) for block in self.added)

    def std_of(self, block: EffectBlock) -> dict[str, float]:
        """Return the standard uncertainties of what was found, by name: of the fit, or between parts if larger."""
        fit = self.state.fit
        places = fit.places(block)
        return block.std(fit.values[places], np.maximum(fit.posterior.std[places], np.sqrt(self.scatter[places])))

    def stated(self, certainty: Certainty) -> list[tuple[Effect, dict[str, float]]]:
        """Return what is added with the standard uncertainty of its values by name, where that is known."""
        stated = []
        for block, effect in zip(self.added, self.effects, strict=True):
            covariance = certainty.among(block.parameters)
            places = places_of(block, self.blocks)
            std = np.full(len(places), np.inf) if covariance is None else np.sqrt(np.diag(covariance))
            sizes = block.std(self.values[places], np.maximum(std, np.sqrt(self.scatter[places])))
            stated.append((effect, {name: size for name, size in sizes.items() if np.isfinite(size)}))
        return stated

    def certainty(self, of_fit: Certainty) -> Certainty:
        """Return what is known of the values, from what a fit with what was found alone leaves behind."""
        every = (*of_fit.parameters, *parameters_of(self.rivals))
        place = {parameter: i for i, parameter in enumerate(parameters_of(self.blocks))}
        shared = [i for i, parameter in enumerate(every) if parameter in place]
        among_values = [place[every[i]] for i in shared]
        covariance = np.zeros((len(every),) * 2)
        covariance[: len(of_fit.parameters), : len(of_fit.parameters)] = of_fit.covariance
        covariance[np.ix_(shared, shared)] += self.spread[np.ix_(among_values, among_values)]
        directions = of_fit.directions
        if directions is not None:
            directions = np.pad(directions, ((0, 0), (0, len(every) - len(of_fit.parameters))))
        return replace(of_fit, parameters=every, covariance=covariance, directions=directions)


def alone(state: State) -> Averaged:
    """Return a state as the only model."""
    count = len(state.fit.values)
    return Averaged(state, (), state.fit.values, np.zeros((count, count)), np.zeros(count))


def averaged(state: State, evidence: Dense, own: Model, drawn: Sequence[Drawn], parts: np.ndarray) -> Averaged:
    """Return the average over models that were drawn in place of a state's own.

    Rivals that are in fewer of them than `DOUBT` are predicted by what is fitted anyway, as far as that can.

    Args:
        state: Which.
        evidence: What competes.
        own: The state's model, of `evidence`.
        drawn: Those in place of it.
        parts: (M,) part of every row that resamples were drawn of.
    """
    fit, mine = state.fit, [chosen.number for chosen in own]
    shares = Counter(number for draw in drawn for number in {chosen.number for chosen in draw.model} - {*mine})
    kept = [number for number, count in shares.items() if count >= DOUBT * len(drawn)]
    rare = [number for number in shares if number not in kept]
    rivals = _blocks(state, evidence, kept)
    sizes = [len(evidence.groups[number].scale) for number in (*mine, *kept, *rare)]
    ends = np.cumsum([0, *sizes])
    slots = {number: slice(a, b) for number, a, b in zip((*mine, *kept, *rare), ends[:-1], ends[1:], strict=True)}
    amplitudes, within = np.zeros((len(drawn), ends[-1])), np.zeros((ends[-1],) * 2)
    none = np.zeros(0, dtype=int)
    for i, draw in enumerate(drawn):
        acting = np.concatenate([none, *(np.r_[slots[chosen.number]] for chosen in draw.model)])
        amplitudes[i, acting] = np.concatenate([np.zeros(0), *draw.amplitudes])
        # The fit knows how uncertain what was found is beside none of the rivals: to that each adds, and others follow.
        # One that is left out is as it is.
        std = np.sqrt(np.maximum(np.diag(draw.spread), np.finfo(float).tiny))
        left_out, is_rival = acting >= ends[len(mine) + len(kept)], acting >= ends[len(mine)]
        spread = _given(draw.spread / std / std[:, None], left_out)
        added = (spread - _given(spread, is_rival)) * std * std[:, None]
        within[np.ix_(acting, acting)] += added / len(drawn)
    # What is fitted anyway as it takes over what is predicted by it.
    columns = np.hstack([np.zeros((len(fit.residual), 0)), *(_columns(evidence, n) for n in (*mine, *kept, *rare))])
    projection = evidence.projection
    taken = projection.whole(projection.absorbed(columns))
    is_rare = np.arange(ends[-1]) >= ends[len(mine) + len(kept)]
    rest = projection.whole(np.array([draw.rest for draw in drawn]).T).T + amplitudes[:, is_rare] @ taken[:, is_rare].T
    samples = np.hstack([rest, amplitudes[:, ~is_rare]])
    follows = np.vstack([-taken, np.eye(ends[-1])[~is_rare]])
    between = samples - samples.mean(axis=0)
    spread = between.T @ between / len(drawn) + follows @ within @ follows.T

    beside = evidence.beside(own)
    begun = projection.whole(projection.absorbed(projection.data - evidence.columns[:, beside.places] @ beside.values))
    begun = np.concatenate([begun, *beside.amplitudes, np.zeros(sum(sizes[len(mine) : len(mine) + len(kept)]))])
    places = np.concatenate([_rest_of(state), _acting_of(state), len(fit.values) + np.arange(len(begun))])
    places = places[: len(begun)]
    count = len(fit.values) + sum(len(block.parameters) for block in rivals)
    whole, step = np.zeros((count, count)), np.zeros(count)
    whole[np.ix_(places, places)] = spread
    step[places] = samples.mean(axis=0) - begun
    blocks = (*fit.blocks, *rivals)
    start = np.concatenate([fit.values, np.zeros(count - len(fit.values))])
    view, weights = looked_at(fit, blocks, start), fit.weights
    wanted = whitened_residual(view, weights) - whitened_regressors(blocks, view, weights) @ step
    scatter = np.zeros(count)
    scatter[: len(fit.values)] = _scatter(state, parts)
    average = Averaged(state, rivals, moved(blocks, start, step), whole, scatter)
    return replace(_settled(average, wanted), shares=tuple(shares[number] / len(drawn) for number in kept))


def _scatter(state: State, parts: np.ndarray) -> Array:
    """Return the (P,) variance of the values of what was found as (M,) parts of a campaign differ; zero of all else.

    That of the jackknife: each part is left out in turn, in the linear problem (Miller 1974, "The jackknife - a
    review", Biometrika 61). Readings that are off together show in it, also in values inside a law.
    """
    fit, count = state.fit, int(parts.max()) + 1
    variance, none = np.zeros(len(fit.values)), np.zeros(0, dtype=int)
    places = np.concatenate([none, *map(fit.places, state.effects)])
    places = places[np.isfinite(fit.posterior.std[places])]
    if not len(places) or count < POSE_FOLDS:
        return variance
    noise, root = max(fit.noise, 1.0), fit.posterior.root
    half, residual = fit.regressors @ (root / noise), fit.residual / noise
    of_readings, moved_by = np.repeat(parts, len(residual) // len(parts)), np.empty((count, len(places)))
    for part in range(count):
        rows = np.flatnonzero(of_readings == part)
        rest = (1.0 + ROUNDING) * np.eye(len(rows)) - half[rows] @ half[rows].T
        left = solve(rest, residual[rows], assume_a="pos", check_finite=False)
        moved_by[part] = root[places] @ (half[rows].T @ left)
    variance[places] = (count - 1) * moved_by.var(axis=0)
    return variance


def _settled(average: Averaged, wanted: Array) -> Averaged:
    """Return an average whose arm predicts what it is to: (n,) whitened residuals, as the models leave on average.

    Loads times compliances are not linear: half a compliance beside half a mass is a quarter of what they do together.
    What is fitted anyway, and families, take over what the arm lacks; where it does not come to rest it is as it was.
    """
    fit, rest = average.state.fit, _rest_of(average.state)
    best, values, least = average, average.values, np.inf
    with suppress(ArmflexError):
        for _ in range(ROUGH.iterations):
            view = looked_at(fit, average.blocks, values)
            beyond = whitened_residual(view, fit.weights) - wanted
            if not (lacking := float(beyond @ beyond)) < least:
                break
            best, least = replace(average, values=values), lacking
            if lacking < THOROUGH.flat:
                break
            columns = whitened_regressors(fit.blocks, view, fit.weights)[:, rest]
            step, values = np.zeros(len(fit.values)), values.copy()
            step[rest] = LinearGaussian.of(columns, fit.precision[rest]).solve(columns.T @ beyond)
            values[: len(step)] = moved(fit.blocks, values[: len(step)], step)
    return best


def beside_calibrated(average: Averaged, folds: Folds, resamples: Resampled) -> Averaged:
    """Return an average with the calibrated arm in it as far as held-out poses are predicted better so.

    Args:
        average: Over models.
        folds: The problem in folds of poses.
        resamples: Of the campaign, over which it is an average.
    """
    state = average.state
    errors = errors_of(state.fit, state.quiet * _predicted(state, folds, resamples.times))
    plain = held_out(state.calibrated, pose_folds(state.groups), judged=state.judged).errors
    share = _share(state, plain, errors)
    if share == 1.0:
        return replace(average, errors=errors)
    # Inner values are those of the laws of what was found, whatever its amplitudes are.
    values, rest = average.values, _rest_of(state)
    calibrated = np.zeros(len(values))
    calibrated[: len(state.first.values)] = state.calibrated.values
    inner = np.setdiff1d(np.arange(len(state.fit.values)), np.concatenate([rest, _acting_of(state)]))
    calibrated[inner] = values[inner]
    apart = values - calibrated
    spread = share * average.spread + share * (1.0 - share) * np.outer(apart, apart)
    views = [looked_at(state.fit, average.blocks, each) for each in (calibrated, values)]
    left = [whitened_residual(view, state.fit.weights) for view in views]
    mixed = replace(average, values=calibrated + share * apart, spread=spread)
    mixed = _settled(mixed, (1.0 - share) * left[0] + share * left[1])
    return replace(mixed, errors=plain + share * (errors - plain), share=share)


def _predicted(state: State, folds: Folds, times: Array) -> Array:
    """Return the (n,) whitened errors of readings predicted from the other folds by the average over models there.

    Those of as many resamples in each fold as there are folds: fewer leave it a little worse than it is. What wanders
    without a clock stays behind in the campaign, and is in no prediction.
    """
    whole, count = folds.evidence.projection, len(folds.parts)
    places = np.concatenate([np.zeros(0, dtype=int), *map(state.fit.places, state.background.walks)])
    behind, numbers = state.fit.regressors[:, places] / state.quiet, np.searchsorted(_rest_of(state), places)
    left, each = np.empty(len(whole.data)), np.array_split(times[: count**2], count)
    for part, learned, model, counts in zip(folds.parts, folds.learned, folds.anew, each, strict=True):
        drawn = bagged(part, model, counts[:, learned]).drawn
        data = whole.data[~learned]
        for draw in drawn:
            seen = whole.regressors[~learned] @ draw.rest - behind[~learned] @ whole.whole(draw.rest)[numbers]
            for chosen, values in zip(draw.model, draw.amplitudes, strict=True):
                seen += _columns(folds.evidence, chosen.number)[~learned] @ values
            data = data - seen / len(drawn)
        left[~learned] = data
    return left


def _share(state: State, plain: Array, errors: Array) -> float:
    """Return the weight of one prediction of poses held out beside a plain one, from their (M, n) errors.

    1 where no weight predicts them better than by chance.
    """
    where = state.fit.view.foremost
    weight = np.where(state.judged[:, where], 1.0 / state.fit.view.sigma[:, where], 0.0)
    apart, plain, errors = weight * (errors - plain), weight * plain, weight * errors
    share = float(np.clip(-(plain * apart).sum() / max(float((apart**2).sum()), 1e-300), 0.0, 1.0))
    fall = (errors**2 - (plain + share * apart) ** 2).sum(axis=1)
    fall = np.bincount(state.groups, fall)
    return share if fall.sum() > ndtri(1.0 - DOUBT) * np.sqrt(len(fall)) * fall.std() else 1.0


def _given(covariance: Array, given: np.ndarray) -> Array:
    """Return the (K, K) covariance of values of which (K,) some are given."""
    across = covariance[:, given]
    return covariance - across @ np.linalg.pinv(across[given], hermitian=True) @ across.T


def _columns(evidence: Dense, number: int) -> Array:
    """Return the (n, k) columns of a hypothesis per unit of its amplitudes."""
    group = evidence.groups[number]
    return evidence.columns[:, group.places] / np.where(group.scale > 0.0, group.scale, np.inf)


def _rest_of(state: State) -> np.ndarray:
    """Return the places of what is fitted beside what was found among the values of the fit."""
    effects = [state.fit.places(block) for block in state.effects]
    return np.setdiff1d(np.arange(len(state.fit.values)), np.concatenate([np.zeros(0, dtype=int), *effects]))


def _acting_of(state: State) -> np.ndarray:
    """Return the places of the amplitudes of what was found."""
    acting = [state.fit.places(block)[: len(block.effect.location.terms)] for block in state.effects]
    return np.concatenate([np.zeros(0, dtype=int), *acting])


def _blocks(state: State, evidence: Dense, numbers: Sequence[int]) -> tuple[EffectBlock, ...]:
    """Return rivals as blocks of values, after all other effects."""
    before = (*state.declared.arm.effects, *state.fitted, *state.common)
    effects = []
    for candidate in (evidence.groups[number].hypothesis.one for number in numbers):
        derived = tuple(name for name in candidate.location.covariates if name in state.measurements.derived)
        effect = replace(candidate.effect(np.zeros(len(candidate.location.terms))), derived=derived)
        effects.append(effect.seen_in(state.context, state.rows))
    ends = zip(effects, numbers_of((*before, *effects))[len(before) :], strict=True)
    first = len(state.fit.setup.arm.effects)  # with what wanders, which stays behind
    return tuple(
        EffectBlock(effect, (), state.context, first + i, np.full(len(effect.location.terms), np.inf), number)
        for i, (effect, number) in enumerate(ends)
    )
