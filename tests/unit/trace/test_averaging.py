"""What a traced arm predicts: the average over models, and the calibrated arm where that predicts held-out poses."""

from dataclasses import replace

import numpy as np
import pytest
from support import six_axes

from armflex import calibrate
from armflex.conventions import Array
from armflex.estimate.block import EffectBlock
from armflex.estimate.held_out import held_out, pose_folds
from armflex.estimate.pose_block import Walk
from armflex.estimate.posterior import certainty_of
from armflex.laws.effects.backlash import BACKLASH
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.compliance import COMPLIANCE
from armflex.laws.effects.friction_windup import FRICTION_WINDUP
from armflex.laws.effects.link_mass import LINK_MASS
from armflex.laws.effects.location import Location
from armflex.trace.averaging import Averaged, averaged, beside_calibrated
from armflex.trace.families import Background
from armflex.trace.hypotheses import Hypothesis, hypotheses
from armflex.trace.probabilities import Drawn, bagged
from armflex.trace.resampling import POSES, Resampled
from armflex.trace.screen import Dense
from armflex.trace.search import exchanged, linear, refitted
from armflex.trace.selection import SCALES, Chosen, Model, rivals
from armflex.trace.state import State, begin, refit
from armflex.trace.validate import Folds

SOME = 24
"""Hypotheses that compete."""


@pytest.fixture(scope="module")
def fitted() -> State:
    """Return an arm that lacks nothing, fitted with play of two drives nevertheless."""
    arm, rows = six_axes.campaign(20)
    before = begin(calibrate(arm, rows, as_stated=True))
    here = linear(before, [one for one in hypotheses(before.context) if one.one.law is BACKLASH][:2])
    state = refitted(here, (Chosen(0, 2), Chosen(1, 2)))
    assert state is not None
    return state


def problem(state: State, prior: float) -> tuple[Dense, Model]:
    """Return what is in the arm and some of what else may be, of any size, all of one log prior; the arm's model."""
    every = hypotheses(state.context)
    some: list[Hypothesis] = every[:: len(every) // SOME]
    here = linear(state, some)
    numbers = (*(one.number for one in here.model), *range(SOME))
    priors = np.full((len(numbers), len(SCALES)), -1e3)
    priors[:, -1] = prior
    evidence = here.screen.dense(numbers, priors)
    return evidence, evidence.here(here.model)


def regressors(average: Averaged) -> Array:
    """Return the (n, P) whitened columns of all values, rivals included."""
    fit, context = average.state.fit, average.state.context
    columns = [fit.view.effect_jacobian(block.effect, context) * fit.scale[:, :, None] for block in average.rivals]
    return np.hstack([fit.regressors, *(one.reshape(len(fit.residual), -1) for one in columns)])


def test_one_arm_predicts_what_models_do_on_average(fitted: State) -> None:
    evidence, own = problem(fitted, 0.0)
    other = next(number for number in range(2, SOME + 2) if len(evidence.groups[number].scale) == 1)
    models = [own, (own[0],), (own[0], Chosen(other, 2))]
    drawn, each = [], []
    for model in models:
        beside = evidence.beside(model)
        seen = evidence.columns[:, beside.places] @ beside.values
        rest = evidence.projection.absorbed(evidence.projection.data - seen)
        count = sum(map(len, beside.amplitudes))
        drawn.append(Drawn(model, beside.amplitudes, np.zeros((count, count)), rest))
        each.append(fitted.quiet * (seen + evidence.projection.regressors @ rest))
    alone, average = (averaged(fitted, evidence, own, some, fitted.groups) for some in (drawn[:1], drawn))
    assert not alone.rivals and len(average.rivals) == 1
    assert len(average.setup.arm.effects) == len(average.effects) == 3
    columns = regressors(average)
    change = columns @ average.values - regressors(alone) @ alone.values
    np.testing.assert_allclose(change, np.mean(each, axis=0) - each[0], atol=1e-6 * np.abs(each[0]).max())
    # Readings spread as the models do, whichever parameters they do it by.
    np.testing.assert_allclose(
        np.sqrt(((columns @ average.spread) * columns).sum(axis=1)), np.std(each, axis=0), rtol=1e-3, atol=1e-6
    )
    known = certainty_of(fitted.fit)
    stated = average.certainty(known)
    assert stated.labels == (*known.labels, *(one.label for block in average.rivals for one in block.parameters))
    assert np.all(np.diag(stated.covariance)[: len(known.parameters)] >= np.diag(known.covariance))


def test_a_rival_that_changes_the_model_is_in_the_arm(fitted: State) -> None:
    """What is heavier weighs in the arm that is returned, not only in the file that is written of it."""
    context, first = fitted.context, len(fitted.effects)
    compliance = Candidate(COMPLIANCE, Location("elbow_joint", "ry"), ()).effect(np.zeros(1))
    mass = Candidate(LINK_MASS, Location(context.records.bodies[-1], terms=(0,)), ()).effect(np.zeros(1))
    rivals = tuple(
        EffectBlock(one, (), context, first + i, np.full(1, np.inf)) for i, one in enumerate((compliance, mass))
    )
    values = np.append(fitted.fit.values, [1e-4, 2.5])
    average = Averaged(fitted, rivals, values, np.zeros((len(values),) * 2), np.zeros(len(values)))
    softer = fitted.fit.setup.with_effect(rivals[0].at(values[-2:-1]))
    arms = (average.setup.arm, softer.with_effect(rivals[1].at(values[-1:])).arm, softer.arm)
    came = dict.fromkeys(context.row.covariates, 1.0)
    averaged_arm, heavy, light = (arm.deflection(context.row.q[0], covariates=came).displacement for arm in arms)
    np.testing.assert_allclose(averaged_arm, heavy, rtol=1e-12)
    assert np.linalg.norm(heavy - light) > 1e-4


def test_what_moves_nothing_is_no_hypothesis(fitted: State) -> None:
    """Wind-up by load of a joint that nothing loads: an amplitude that is not known would be no value of a file."""
    windup = Candidate(FRICTION_WINDUP, Location("wrist_3_joint", "ry", ("approach_wrist_3_joint",), (0, 1)), ())
    by_load = Candidate(FRICTION_WINDUP, replace(windup.location, terms=(1,)), ())
    some = [Hypothesis(windup, -3.0), Hypothesis(by_load, -3.0)]
    screen = linear(fitted, some).screen
    screen.extend(some)  # as refined ones are
    possible = [
        one for one in screen.groups if one.hypothesis.prior > -np.inf and one.hypothesis.spot[0] == windup.law.name
    ]
    assert [group.hypothesis.one.location.terms for group in possible] == [(0,), (0,)]
    assert all(screen.columns(group.places).any(axis=0).all() for group in possible)


def test_a_rival_that_does_what_was_found_does_makes_readings_no_less_certain(fitted: State) -> None:
    """Amplitudes of two that are all but exchangeable are open, and what they do together is not."""
    evidence, own = problem(fitted, 0.0)
    number = next(number for number in range(2, SOME + 2) if len(evidence.groups[number].scale) == 1)
    rival, columns = Chosen(number, 2), evidence.columns.copy()
    place, known = evidence.groups[number].places, evidence.groups[own[0].number].places
    chance = np.random.default_rng(0).normal(size=(len(columns), 1))
    columns[:, place] = columns[:, known] + 1e-3 * np.linalg.norm(columns[:, known]) / np.linalg.norm(chance) * chance
    evidence = Dense(evidence.groups, columns, evidence.projection, evidence.priors)
    beside = evidence.beside((*own, rival))
    covariance = beside.noise**2 * beside.inverse.T @ beside.inverse
    left = evidence.projection.left_of(columns[:, beside.places])
    within = np.einsum("nk,kl,nl->n", left, covariance, left)
    alone = evidence.beside(own)
    count = len(alone.places)
    before = beside.noise**2 * alone.inverse.T @ alone.inverse
    within -= np.einsum("nk,kl,nl->n", left[:, :count], before, left[:, :count])

    scale = np.concatenate([evidence.groups[one.number].scale for one in (*own, rival)])
    rest = evidence.projection.absorbed(evidence.projection.data - columns[:, beside.places] @ beside.values)
    drawn = Drawn((*own, rival), beside.amplitudes, covariance * scale * scale[:, None], rest)
    average = averaged(fitted, evidence, own, [drawn], fitted.groups)
    every = np.hstack([fitted.fit.regressors / fitted.quiet, columns[:, place] / evidence.groups[number].scale])
    readings = np.einsum("np,pq,nq->n", every, average.spread, every)
    np.testing.assert_allclose(readings, within, rtol=1e-3, atol=1e-3 * within.max())
    assert readings.max() < 0.1 * covariance.diagonal()[-1] * (columns[:, place] ** 2).max()

    # What few models have is left out, and what it could be is no uncertainty of the rest.
    plain = Drawn(
        own, alone.amplitudes, np.zeros((count, count)), evidence.projection.absorbed(evidence.projection.data)
    )
    rare = averaged(fitted, evidence, own, [drawn, *[plain] * 30], fitted.groups)
    assert not rare.rivals
    both = averaged(fitted, evidence, own, [replace(drawn, spread=0.0 * drawn.spread), *[plain] * 30], fitted.groups)
    np.testing.assert_allclose(rare.spread, both.spread, rtol=1e-9, atol=1e-9 * np.abs(both.spread).max())


def test_numbers_are_as_uncertain_as_parts_of_a_campaign_differ(fitted: State) -> None:
    """By refitting the linear problem without each part in turn; nothing else than what was found is widened."""
    evidence, own = problem(fitted, 0.0)
    parts = fitted.groups % 7
    fit, none = fitted.fit, np.zeros(0, dtype=int)
    found = np.concatenate([none, *map(fit.places, fitted.effects)])
    noise, of_readings = max(fit.noise, 1.0), np.repeat(parts, len(fit.residual) // len(parts))
    columns, data = fit.regressors / noise, (fit.residual + fit.regressors @ fit.values) / noise
    without = []
    for part in range(7):
        left = of_readings != part
        normal = columns[left].T @ columns[left] + np.diag(fit.precision)
        without.append(np.linalg.solve(normal, columns[left].T @ data[left])[found])
    expected = np.var(without, axis=0) * 6.0
    drawn = bagged(evidence, own, np.ones((4, len(evidence.columns)))).drawn
    average = averaged(fitted, evidence, own, drawn, parts)
    np.testing.assert_allclose(average.scatter[found], expected, rtol=1e-4)  # a fit ends a little short
    assert not np.delete(average.scatter, found).any()
    for block in fitted.effects:
        std = average.std_of(block)["gap"]
        assert std >= np.sqrt(average.scatter[fit.places(block)[0]])


@pytest.mark.parametrize(("prior", "kept"), [(30.0, False), (-30.0, True)])
def test_what_held_out_poses_contradict_is_predicted_less(fitted: State, prior: float, kept: bool) -> None:
    """Of columns of chance: all that are believed in beforehand imitate noise; none else leaves the calibrated arm."""
    evidence, own = problem(fitted, prior)
    columns = evidence.columns.copy()
    columns[:, 2:] = np.random.default_rng(0).normal(size=columns[:, 2:].shape)
    evidence = Dense(evidence.groups, columns, evidence.projection, evidence.priors)
    folds = Folds(evidence, pose_folds(fitted.groups))
    resamples = Resampled(POSES, fitted.groups, 1.0, np.ones((50, len(evidence.projection.data))))
    average = averaged(fitted, evidence, own, bagged(evidence, own, resamples.times).drawn, fitted.groups)
    found = beside_calibrated(average, folds, resamples)
    plain = held_out(fitted.calibrated, pose_folds(fitted.groups), judged=fitted.judged).errors
    assert found.errors is not None
    assert np.linalg.norm(found.errors) < 1.01 * np.linalg.norm(plain)
    assert (found.share == 1.0) == kept
    if not kept:
        calibrated = np.zeros(len(average.values))
        calibrated[: len(fitted.first.values)] = fitted.calibrated.values
        np.testing.assert_allclose(found.values, calibrated + found.share * (average.values - calibrated), atol=1e-12)
        assert found.share < 0.5


def test_a_rival_stands_behind_what_wandered(fitted: State) -> None:
    """A walk is an effect of the arm while it is fitted: what a rival does is not read off that."""
    waves = np.random.default_rng(0).normal(size=(len(fitted.measurements), 3))
    walk = Walk("base", "dx", np.full(3, 1e-3), waves)
    background = Background(("wandering",), walks=(walk,), of=("wandering",), amplitudes=np.zeros(3))
    start = np.append(fitted.fit.values, np.zeros(3))
    state = refit(replace(fitted, background=background), fitted.effects, fitted.random, start)
    evidence, own = problem(state, np.log(0.5))
    average = averaged(
        state, evidence, own, bagged(evidence, own, np.ones((4, evidence.columns.shape[0]))).drawn, state.groups
    )
    acting = average.setup.arm.effects
    assert average.rivals
    assert [acting[block.ordinal].name for block in average.rivals] == [block.effect.name for block in average.rivals]


def test_a_rival_that_only_resamples_prefer_is_fitted_before_it_is_believed() -> None:
    """It is less probable in the linear problem: whether it takes a name's place is what comes out of the fit."""
    arm, rows = six_axes.campaign(
        20, effects=[Candidate(COMPLIANCE, Location("elbow_joint", "ry"), ()).effect(np.array([1e-4]))]
    )
    before = begin(calibrate(arm, rows, as_stated=True))
    some = [one for one in hypotheses(before.context) if one.one.law in (COMPLIANCE, BACKLASH)]
    screen = linear(before, some).screen
    best = rivals(screen.beside(()))[0].chosen
    state = refitted(linear(before, some), (best,))
    assert state is not None
    here = linear(state, some)
    ranked = [rival.chosen for rival in rivals(here.screen.beside(()), within=100.0)]
    other = next(one for one in ranked if here.screen.groups[one.number].hypothesis.spot != state.known[0].spot)
    assert here.screen.log_posterior((other,)) < here.value
    after = exchanged(here, [(other,)])
    assert len(here.rejected) == 1 and (after is None or after.value > here.value)
