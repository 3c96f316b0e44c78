"""Tracing names what was hidden; and its parts are what they say, against brute force."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import null_space
from studies.named import CASES, Case
from support.campaigns import draw

import armflex
from armflex.conventions import TWIST_NAMES, Array
from armflex.estimate.calibrate import calibrate
from armflex.estimate.fit import Fit
from armflex.estimate.held_out import folds_of, held_out, pose_folds
from armflex.laws.effects import CATALOGUE
from armflex.laws.effects.candidate import Candidate, candidates_of
from armflex.laws.effects.catalogue import EVERY
from armflex.trace.bank import Bank
from armflex.trace.hypotheses import hypotheses
from armflex.trace.projection import Projection, project
from armflex.trace.screen import Screen
from armflex.trace.selection import SCALES, Chosen, log_likelihood
from armflex.trace.state import State, begin
from armflex.trace.unrecorded import localise, noticed_from

KEPT = [case for case in CASES if case.kept]


@pytest.mark.slow
@pytest.mark.parametrize("case", KEPT, ids=str)
def test_an_account_is_what_it_must_be(case: Case):
    """The others are traced by `python tests/studies/named.py`."""
    found = case.scored()
    assert case.holds(found), found


@pytest.fixture(scope="module")
def backlash(campaign, before) -> Candidate:
    law = CATALOGUE["backlash"]
    return next(
        Candidate(law, location, ()) for location in law.places(before.context.records) if location.site == "J4"
    )


def least_squares(regressors: Array, prior: Array, data: Array) -> tuple[Array, float]:
    """Return values and objective of a linear problem with priors, by a stacked solve."""
    stacked = np.vstack([regressors, np.diag(1.0 / prior)])
    target = np.concatenate([data, np.zeros(len(prior))])
    scale = np.linalg.norm(stacked, axis=0)
    values = np.linalg.lstsq(stacked / scale, target, rcond=None)[0] / scale
    return values, float(((stacked @ values - target) ** 2).sum())


def data_of(fit: Fit) -> Array:
    return fit.residual + fit.regressors @ fit.values


NAMES = ("stiffening", "link_geometry", "gear_harmonic", "thermal_growth", "tip_force", "tracker_scale", "backlash")


@pytest.fixture(scope="module")
def everything(before) -> Bank:
    """The catalogue and the shapes, every third candidate of them."""
    laws = [law for law in EVERY.values() if law.name not in ("unnamed_bump", "unnamed_wave")]
    return Bank(tuple(candidates_of(laws, before.context))[::3], before.fit, before.context)


def test_a_bank_has_every_candidates_columns(everything):
    """What is computed once for a site, or for all of them, is what each candidate has by itself."""
    starts = everything.starts
    some = np.random.default_rng(1).normal(size=(everything.fit.residual.size, 8))
    products = everything.products(some)
    assert np.isfinite(products).all() and len({candidate.law.name for candidate in everything.candidates}) > 30
    for index in range(0, len(everything.candidates), 4):
        alone, found = everything.group(index), products[starts[index] : starts[index + 1]]
        np.testing.assert_allclose(found, alone.T @ some, atol=1e-10 * np.linalg.norm(alone), rtol=0.0)


def test_columns_of_many_rows_are_kept_in_24_bits(everything, monkeypatch):
    some, others = everything.candidates[::7], np.random.default_rng(1).normal(size=(everything.fit.residual.size, 3))
    exact, rounded = (Bank(some, everything.fit, everything.context) for _ in range(2))
    whole, squares, near = exact.products(others), list(exact.squares()), 1e-7 * np.linalg.norm(others)
    monkeypatch.setattr(sys.modules[Bank.__module__], "BANK_HELD", whole.shape[0] * len(everything.fit.view.rows) - 1)
    assert {part.shapes.dtype for part in rounded.parts} == {np.dtype(np.float32)}
    for (groups, one, _), (same, other, _) in zip(squares, rounded.squares(), strict=True):
        assert (groups == same).all()
        np.testing.assert_allclose(np.einsum("gkk->gk", other), np.einsum("gkk->gk", one), rtol=1e-6)
        lengths = np.sqrt(np.einsum("gkk->gk", one))[:, :, None]
        places = exact.starts[groups][:, None] + np.arange(one.shape[1])
        assert (np.abs(rounded.products(others) - whole)[places] <= near * lengths).all()


@pytest.fixture(scope="module")
def restationed(tmp_path_factory) -> State:
    """With an instrument that was set up 70 times: of what is eliminated first each is of many poses."""
    drawn = draw("none", 3, "six").write(tmp_path_factory.mktemp("restationed"))
    arm = armflex.load_arm(drawn.arm)
    rows = armflex.read_measurements(drawn.train, arm)
    order = np.argsort(np.argsort(rows.time, kind="stable"), kind="stable")
    session = tuple(f"t{i * 70 // len(rows)}" for i in order.tolist())
    return begin(calibrate(arm, replace(rows, session=session), as_stated=True))


def test_absorbed_is_what_the_other_parameters_take_over(before, backlash):
    fit, projection = before.fit, project(before.fit)
    change = Bank((backlash,), fit, before.context).group(0)[:, 0]
    values, _ = least_squares(fit.regressors, fit.prior, change)
    np.testing.assert_allclose(projection.absorbed(change), values, rtol=1e-5, atol=1e-6 * np.abs(values).max())


def test_some_of_the_rows_are_a_problem_of_their_own(restationed):
    """Also where a parameter that is eliminated first is of rows in either part."""
    whole = restationed.bare
    part = whole.resampled(np.repeat(np.arange(len(restationed.rows)) % 2 == 0, 3).astype(float))
    assert min(whole.each.shape[0], part.each.shape[0]) > 64
    with np.errstate(divide="ignore"):
        _, objective = least_squares(part.regressors, 1.0 / np.sqrt(part.precision), part.data)
    assert part.objective == pytest.approx(objective, rel=1e-9)
    assert part.data @ part.left_of(part.data) == pytest.approx(objective, rel=1e-6)


def screened(state: State, every: int = 1) -> Screen:
    """Return every so manieth hypothesis of a state in its linear problem."""
    known = hypotheses(state.context)[::every]
    return Screen(known, Bank(tuple(one.one for one in known), state.fit, state.context, quiet=state.quiet), state.bare)


def test_a_column_that_moves_nothing_has_no_scale(before):
    """Its square underflows, and the square of its scale would be no number; one inside a law may decay so far."""
    screen = screened(before, 400)
    assert screen.scale_of(np.full((9, 1), 1e-107)) == 0.0 < screen.scale_of(np.full((9, 1), 1e-9))


def test_the_evidence_on_a_screen_is_that_of_gaussian_readings(before):
    """Of the whole covariance of the readings, of parameters and effects alike, by its determinant."""
    screen, projection = screened(before, 41), before.bare
    free = [i for i, one in enumerate(screen.groups) if not one.hypothesis.positive and one.scale.all()]
    loose = projection.precision == 0.0  # frames, which have no prior: only what they cannot move says anything
    rest = null_space(projection.regressors[:, loose].T)
    data, held = rest.T @ projection.data, rest.T @ projection.regressors[:, ~loose]
    none = np.eye(len(data)) + held / projection.precision[~loose] @ held.T
    for pair in ((free[3], free[20]), (free[7], free[-5])):
        model = (Chosen(pair[0], 2), Chosen(pair[1], 1))
        whole, priors = none, 0.0
        for one, amplitudes in zip(model, screen.beside(model).amplitudes, strict=True):
            group = screen.groups[one.number]
            columns = rest.T @ screen.columns(group.places) * SCALES[one.scale]
            whole = whole + columns @ columns.T
            sized = screen.priors[one.number] + screen.sized(one.number)
            priors += float(sized[one.scale]) - screen.charge(one.number, amplitudes)
        left = [data @ np.linalg.solve(each, data) for each in (whole, none)]
        volume = np.linalg.slogdet(whole)[1] - np.linalg.slogdet(none)[1]
        fit = log_likelihood(np.array(left), screen.freedom)
        found = screen.log_posterior(model) - screen.log_posterior(())
        assert found == pytest.approx(fit[0] - fit[1] - 0.5 * volume + priors, abs=1e-3)


def test_a_scan_is_the_evidence_of_every_model_with_one_more(before):
    screen = screened(before, 41)
    model = (Chosen(5, 2),)
    odds = screen.beside(model).odds
    for number in range(20, len(screen.groups), 37):
        more = (*model, Chosen(number, 3))
        charge = sum(screen.charge(one.number, a) for one, a in zip(more, screen.beside(more).amplitudes, strict=True))
        own = screen.charge(5, screen.beside(model).amplitudes[0])
        found = screen.log_posterior(more) - screen.log_posterior(model) + charge - own
        assert screen.beside(model).odds_at(number)[3] == pytest.approx(found, abs=1e-4)
        assert odds[number, 3] == pytest.approx(found - np.broadcast_to(screen.sized(number), len(SCALES))[3], abs=1e-4)


def test_a_few_hypotheses_alone_have_the_evidence_that_they_have_among_all(before):
    screen = screened(before, 41)
    some = (3, 11, 40)
    dense = screen.dense(some, screen.priors[list(some)])
    here, there = screen.beside((Chosen(3, 2),)).odds[list(some[1:])], dense.beside((Chosen(0, 2),)).odds[1:]
    np.testing.assert_allclose(here, there, atol=1e-5)


def errors_of(fit: Fit, folds: np.ndarray, follow: list[np.ndarray] | None = None) -> Array:
    """Return the squared errors of rows left out, each fold by a solve of its own."""
    size, data = fit.view.residual.shape[1], data_of(fit)
    squares = np.empty(len(folds))
    for number in np.unique(folds):
        own = np.repeat(folds == number, size)
        values, _ = least_squares(fit.regressors[~own], fit.prior, data[~own])
        error = data[own] - fit.regressors[own] @ values
        if follow is not None:
            some = follow[number]
            error -= (
                fit.regressors[own][:, some] @ least_squares(fit.regressors[own][:, some], fit.prior[some], error)[0]
            )
        metres = error.reshape(-1, size) / np.sqrt(fit.weights[folds == number])
        squares[folds == number] = ((metres * fit.view.sigma[folds == number]) ** 2).sum(axis=1)
    return squares


def test_held_out_poses_against_refits(before):
    folds = pose_folds(before.groups)
    assert set(folds) == set(range(5)) and all(len(set(folds[before.groups == g])) == 1 for g in set(before.groups))
    np.testing.assert_allclose(held_out(before.fit, folds).squares, errors_of(before.fit, folds), rtol=1e-4)


def test_held_out_sessions_against_refits(before):
    folds, frames = folds_of(before.fit, before.sessions)
    assert len(frames) == 5 and all(len(frame) == 6 for frame in frames)
    expected = errors_of(before.fit, folds, frames)
    np.testing.assert_allclose(held_out(before.fit, folds, frames).squares, expected, rtol=1e-4)


def noisy(projection: Projection, seed: int) -> Projection:
    """Return the same problem with nothing but noise in it."""
    noise = np.random.default_rng(seed).normal(size=len(projection.residual))
    return Projection(projection.regressors, projection.precision, noise, projection.count)


@pytest.mark.parametrize(("site", "axis", "std"), [("J3", "ry", 1e-3), ("link:J5", "dx", 1e-3), ("base", "dz", 8e-4)])
def test_a_random_twist_is_found_where_it_is(before, site, axis, std):
    fit, known, groups = before.fit, project(before.fit), before.groups
    twists = std * np.random.default_rng(2).normal(size=groups.max() + 1)[groups]
    moved = fit.view.to_twist(site)[:, :, TWIST_NAMES.index(axis)] * twists[:, None]
    data = (moved / fit.view.sigma * np.sqrt(fit.weights)).ravel()
    noise = np.random.default_rng(3).normal(size=len(data))
    projection = Projection(known.regressors, known.precision, data + noise, known.count)
    places = localise(fit, before.context, projection, groups)
    true = next(place for place in places if (place.site, place.axis) == (site, axis))
    assert true.ratio > 100.0 and true.ratio > places[0].ratio - 3.0  # a lift is a lift anywhere along the column
    assert true.std == pytest.approx(std, rel=0.25)  # of some seventy twists, a few of which are fitted away


def test_noise_is_nowhere(before):
    known = project(before.fit)
    found = [localise(before.fit, before.context, noisy(known, seed), before.groups) for seed in range(8)]
    assert max(places[0].ratio / noticed_from(len(places)) for places in found) < 0.7
