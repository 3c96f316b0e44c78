"""Families in a fit: their evidence is that of Gaussian readings, walks move their rows, and an arm keeps them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import six_axes
from support.campaigns import draw

from armflex import Arm, calibrate, load_arm, predict, read_measurements
from armflex.conventions import Array
from armflex.estimate.learn import with_posteriors
from armflex.estimate.pose_block import Walk
from armflex.estimate.posterior import certainty_of
from armflex.estimate.view import look
from armflex.laws.effects.backlash import BACKLASH
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.drive_curve import DRIVE_CURVE, MOST_SINES
from armflex.laws.effects.effect import Effect, full
from armflex.laws.effects.location import Location
from armflex.measured.measurements import Measurements
from armflex.readings import Readings
from armflex.trace.hypotheses import ODD_PLACE
from armflex.trace.projection import Projection
from armflex.trace.search import linear, standing, with_families
from armflex.trace.selection import Chosen
from armflex.trace.state import State, begin


def drawn(seed: int) -> tuple[Projection, Array]:
    """Return 50 readings of three fitted parameters and of eight amplitudes of families, and their covariance."""
    rng = np.random.default_rng(seed)
    fitted, family = rng.normal(size=(50, 3)), rng.normal(size=(50, 8))
    precision = rng.uniform(0.2, 5.0, 11)
    columns = np.hstack([fitted, family])
    readings = columns @ (rng.normal(size=11) / np.sqrt(precision)) + rng.normal(size=50)
    return Projection(columns, precision, readings, 50, np.arange(11) >= 3), columns / precision @ columns.T + np.eye(
        50
    )


@pytest.mark.parametrize("seed", range(3))
def test_families_cost_what_components_of_a_covariance_do(seed: int) -> None:
    projection, covariance = drawn(seed)
    assert projection.objective == pytest.approx(projection.data @ np.linalg.solve(covariance, projection.data))
    fitted = projection.regressors[:, :3]
    bare = fitted / projection.precision[:3] @ fitted.T + np.eye(50)
    assert projection.volume == pytest.approx(np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(bare)[1])
    assert projection.freedom == pytest.approx(50 - np.trace(np.eye(50) - np.linalg.inv(bare)))


def test_what_is_fitted_beside_families_takes_degrees_of_freedom() -> None:
    projection, covariance = drawn(0)
    more = np.random.default_rng(1).normal(size=(50, 2))
    beside = projection.with_columns(more, np.array([0.5, 2.0]))
    whole = covariance + more / np.array([0.5, 2.0]) @ more.T
    assert beside.objective == pytest.approx(beside.data @ np.linalg.solve(whole, beside.data))
    fitted, precision = np.hstack([projection.regressors[:, :3], more]), np.append(projection.precision[:3], [0.5, 2.0])
    bare = fitted / precision @ fitted.T + np.eye(50)
    assert beside.freedom == pytest.approx(50 - np.trace(np.eye(50) - np.linalg.inv(bare)))


def test_what_readings_cannot_tell_apart_is_one_amplitude() -> None:
    projection, _ = drawn(2)
    twins = projection.regressors[:, 3:] @ np.random.default_rng(2).normal(size=(8, 40))
    random = np.append(projection.random, np.ones(40, dtype=bool))
    regressors, precision = np.hstack([projection.regressors, twins]), np.append(projection.precision, np.ones(40))
    many = Projection(regressors, precision, projection.data, 50, random)
    few = many.condensed
    assert few.regressors.shape[1] == 3 + 8
    assert few.objective == pytest.approx(many.objective)
    assert few.volume == pytest.approx(many.volume)
    assert few.freedom == pytest.approx(many.freedom)
    assert few.inside(projection.regressors) == pytest.approx(many.inside(projection.regressors))
    assert few.whole(few.values) == pytest.approx(many.values)
    few, many = (one.with_columns(twins, np.ones(40)) for one in (few, many))
    assert few.whole(few.values) == pytest.approx(many.values[:51])


def curves() -> list[Effect]:
    """Return a curve of each drive: sines that fall with their number."""
    arm, rng, effects = six_axes.declared(), np.random.default_rng(5), []
    terms = tuple(range(24))
    for joint, axis in zip(arm.robot.moving, DRIVE_AXES, strict=True):
        location, number = Location(joint.name, axis, (f"q_{joint.name}",), terms), np.array(terms) + 1.0
        sizes = 1.5e-3 * rng.normal(size=24) / (1.0 + (number / 6.0) ** 2)
        place = arm.joint_names.index(joint.name)
        span = six_axes.LOWER[place] - 1.5, six_axes.UPPER[place] + 1.5
        effects.append(Effect(DRIVE_CURVE, location, (*full(sizes, location, MOST_SINES), *map(float, span))))
    return effects


DRIVE_AXES = ("rz", "ry", "ry", "ry", "rz", "ry")


def errors(arm: Arm, rows: Measurements) -> Array:
    return np.linalg.norm(predict(arm, rows).position - rows.position, axis=1)


@pytest.fixture(scope="module")
def curved() -> tuple[State, State]:
    """Return a calibrated arm whose drives err by curves, and the same with its families."""
    state = begin(calibrate(*six_axes.campaign(334, effects=curves()), as_stated=True))
    return state, with_families(state)


def test_what_all_drives_have_is_in_the_fit_and_in_the_arm(curved: tuple[State, State]) -> None:
    before, after = curved
    assert after.background.names == ("curve of the drives",)
    assert len(after.background.effects) == 6 and not after.effects
    assert linear(after).value > linear(before).value + 100.0
    _, other = six_axes.campaign(200, seed=1, effects=curves())
    setup = after.fit.setup
    arm = replace(setup.arm, effects=after.common, instrument=setup.instrument)
    plainly = replace(before.fit.setup.arm, instrument=before.fit.setup.instrument)
    rms = [float(np.sqrt((errors(one, other) ** 2).mean())) for one in (plainly, arm)]
    assert rms[1] < 0.4 * rms[0]


def test_values_are_those_of_generalised_least_squares(curved: tuple[State, State]) -> None:
    """Of the last linear problem: with the families' covariance the other parameters are as the fit has them."""
    fit = curved[1].fit
    common = np.concatenate([fit.places(block) for block in curved[1].background.blocks])
    rest = np.setdiff1d(np.arange(len(fit.values)), common)
    columns = fit.regressors
    readings = fit.residual + columns @ fit.values
    covariance = columns[:, common] * fit.prior[common] ** 2 @ columns[:, common].T + np.eye(len(readings))
    weighed = np.linalg.solve(covariance, columns[:, rest])
    values = np.linalg.solve(columns[:, rest].T @ weighed + np.diag(fit.precision[rest]), weighed.T @ readings)
    std = fit.posterior.std[rest]
    known = np.isfinite(std)
    assert np.abs((values - fit.values[rest])[known] / std[known]).max() < 0.2  # a fit stops that near


def test_a_random_twist_is_localised_beside_families_and_names(curved: tuple[State, State]) -> None:
    here = standing(curved[1])
    number = next(i for i, one in enumerate(here.screen.groups) if one.hypothesis.one.law.name == "compliance")
    there = replace(here, model=(Chosen(number, 2),))
    assert all(np.isfinite(place.ratio) for place in there.scattered)


def test_a_first_row_that_no_row_leads_to_is_predicted_halfway() -> None:
    """Of play by approach, where no column says from which side a drive came: it is as uncertain as both are apart."""
    sizes, effects = (2e-3, 1e-3, 2e-3, 3e-3, 2e-3, 3e-3), []
    for joint, axis, size in zip(six_axes.declared().joint_names, DRIVE_AXES, sizes, strict=True):
        place = Location(joint, axis, (f"approach_{joint}",))
        effects.append(replace(Candidate(BACKLASH, place, ()).effect(np.array([size])), derived=place.covariates))
    arm, rows = six_axes.campaign(120)
    true = six_axes.true_arm()
    moved = predict(replace(true, effects=tuple(effects)), rows).position - predict(true, rows).position
    position = rows.readings.kinds[0]
    rows = replace(rows, readings=Readings(len(rows), (replace(position, values=position.values + moved),)))
    state = with_families(begin(calibrate(arm, rows, as_stated=True)))
    assert state.background.names == ("play by approach",)
    arm = with_posteriors(state.fit.setup.arm, state.fit, certainty_of(state.fit))
    predicted = predict(replace(arm, effects=state.common, instrument=state.fit.setup.instrument), rows)
    assert predicted.sigma is not None
    assert predicted.sigma[0].max() > 2.0 * predicted.sigma[1:].max()
    assert np.linalg.norm(predicted.position[1:] - rows.position[1:], axis=1).mean() < 3.0 * six_axes.SIGMA


def test_an_instrument_that_wandered_is_where_it_was_on_its_clock_and_on_average_elsewhere() -> None:
    arm, rows = six_axes.campaign(150)
    walk = np.cumsum(np.random.default_rng(3).normal(0.0, 1e-4, len(rows)))
    position, along = rows.readings.kinds[0], np.array([0.6, 0.0, 0.8])
    moved = replace(position, values=position.values + walk[:, None] * along)
    rows = replace(rows, readings=Readings(len(rows), (moved,)))
    state = with_families(begin(calibrate(arm, rows, as_stated=True)))
    assert state.background.names == ("wandering of the instrument",)
    arm = with_posteriors(state.fit.setup.arm, state.fit, certainty_of(state.fit))
    arm = replace(arm, effects=state.common, instrument=state.fit.setup.instrument)
    errors = predict(arm, rows).position - rows.position
    assert np.sqrt((errors**2).mean()) < 1.2 * six_axes.SIGMA
    another = replace(rows, sha256="of another day")
    left = predict(arm.left(), another)
    errors = left.position - rows.position + (walk - walk.mean())[:, None] * along
    assert np.sqrt((errors**2).mean()) < 1.5 * six_axes.SIGMA
    assert left.sigma is not None
    assert np.median(left.sigma @ along) == pytest.approx(walk.std(), rel=0.35)


def test_where_nothing_is_hidden_no_family_is_fitted(tmp_path) -> None:
    """However noisy; `python tests/studies/kinds.py` counts forty such machines."""
    files = draw("none_noisier", 7001, "six").write(tmp_path)
    arm = load_arm(files.arm)
    state = begin(calibrate(arm, read_measurements(files.train, arm), as_stated=True))
    assert with_families(state) is state


def test_a_walk_moves_the_rows_of_its_session(curved: tuple[State, State]) -> None:
    state = curved[0]
    rng, every = np.random.default_rng(0), len(state.measurements)
    waves = rng.normal(size=(every, 3)) * (np.arange(every) < 100)[:, None]
    sites: Sequence[tuple[str, str]] = (("base", "dy"), (state.context.joints[2], "ry"))
    for site, axis in sites:
        walk = Walk(site, axis, np.ones(3), waves)
        values = 1e-5 * rng.normal(size=3)
        moved = [
            look(walk.apply(state.fit.setup, side * values), state.measurements, state.rows).residual
            for side in (1.0, -1.0)
        ]
        done = -0.5 * (moved[0] - moved[1])
        np.testing.assert_allclose(walk.columns(state.fit.view) @ values, done, atol=1e-4 * np.abs(done).max())
        assert not np.abs(done[state.rows >= 100]).max() and np.abs(done).max() > 1e-6


def test_laws_that_no_reading_distinguishes_are_as_likely() -> None:
    """A link that bends about the axis of the drive at its end is that drive's compliance; one of them is one-sided."""
    arm, rows = six_axes.campaign(20)
    screen = standing(begin(calibrate(arm, rows, as_stated=True))).screen
    likely: dict[str, list[np.ndarray]] = {}
    for number, group in enumerate(screen.groups):
        law, place = group.hypothesis.spot
        if law in ("compliance", "link_flexure") and len(place.terms) == 1 and place.axis in ("rx", "ry", "rz"):
            one_sided = np.log(2.0) * group.hypothesis.positive
            likely.setdefault(f"{place.place} {place.axis}", []).append(screen.prior(number) + one_sided)
    pairs = [pair for pair in likely.values() if len(pair) == 2]
    tied = [pair for pair in pairs if np.allclose(*pair, rtol=0.0, atol=1e-9)]
    assert len(tied) >= 3
    assert len(tied) < len(pairs)


def test_a_slip_that_may_be_along_another_axis_is_likelier_one_of_the_drive() -> None:
    """Also where no reading distinguishes the two: a turn of a wrist moves its one target along a line."""
    arm, rows = six_axes.campaign(20)
    screen = standing(begin(calibrate(arm, rows, as_stated=True))).screen
    likely = dict[str, float]()
    for number, group in enumerate(screen.groups):
        law, place = group.hypothesis.spot
        if (law, place.site) == ("slip_step", "wrist_2_joint"):
            mass = float(screen.prior(number)[0])  # as large as machines have either
            likely[str(place.axis)] = np.logaddexp(likely.get(str(place.axis), -np.inf), mass)
    assert len(likely) == 6 and likely["rz"] == max(likely.values())
    assert all(likely["rz"] > likely[across] - 0.9 * np.log(ODD_PLACE) for across in ("dx", "dy", "dz"))


def test_a_hose_at_a_joint_and_the_scale_of_its_encoder_are_as_likely(tmp_path: Path) -> None:
    """Their columns are the same, and their units are not: each has a size that machines have."""
    drawn = draw("dress_pack", 250002, arm="boom")
    files = drawn.write(tmp_path)
    arm = load_arm(files.arm)
    here = standing(begin(calibrate(arm, read_measurements(files.train, arm), as_stated=True)))
    numbers = {
        group.hypothesis.spot[0]: number
        for number, group in enumerate(here.screen.groups)
        if group.hypothesis.spot[0] in ("dress_pack", "encoder_scale") and group.hypothesis.one.location.site == "A4"
    }
    beside = here.screen.beside(here.model)
    odds = {law: beside.odds_at(number) for law, number in numbers.items()}
    assert odds["dress_pack"].max() == pytest.approx(odds["encoder_scale"].max(), abs=1e-3)
