"""[[effect]] in an arm.toml: read, refused, written, and predicted with, uncertainty included."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st
from support.campaigns import draw
from support.effect_arms import BACKLASH, MECHANICAL, TEXT, arm_and, arm_with, context, locations, plain, quietly

from armflex import Arm, Measurements, Payload, calibrate, predict, read_measurements, trace
from armflex.errors import ArmFileError, ExtrapolationError, Flag, MissingCovariateError, UnsupportedError
from armflex.estimate import Calibration
from armflex.estimate.block import EffectBlock, amplitude_prior
from armflex.estimate.draw import draw_arms
from armflex.estimate.pose_block import PoseBlock
from armflex.estimate.posterior import certainty_of
from armflex.files.effect_file import effect_table
from armflex.laws.effects import CATALOGUE, Effect
from armflex.laws.effects.catalogue import SHAPES
from armflex.laws.effects.in_arm import settled_covariates
from armflex.trace.averaging import alone
from armflex.trace.findings import Found, Trace
from armflex.trace.state import State, begin, refit, with_random
from armflex.trace.validate import Proof

Q = np.array([0.3, -0.4, 0.5, 0.2, 0.6, -0.1])


OF_CHAINS = [law for name, law in CATALOGUE.items() if name not in MECHANICAL]


@st.composite
def effects(draw: st.DrawFn) -> Effect:
    law = draw(st.sampled_from([*OF_CHAINS, *(one for one in SHAPES.values() if not one.physical)]))
    location = draw(st.sampled_from(locations(law)))
    number = st.floats(-1e3, 1e3).filter(bool)
    values = [draw(number) if i in location.terms else 0.0 for i in range(len(law.amplitudes))]
    values = [abs(v) if amplitude.positive else v for v, amplitude in zip(values, law.amplitudes, strict=True)]
    if law.name in ("payload_mass", "link_mass"):
        values[0] = abs(values[0])  # nothing weighs less than nothing
    inner = [draw(st.sampled_from(one.tried) | number if one.tried else number) for one in law.inner]
    inner = [abs(v) if one.positive else v for v, one in zip(inner, law.inner, strict=True)]
    seen = [sorted((draw(number), draw(number))) for _ in location.covariates] if draw(st.booleans()) else []
    ranges = tuple((name, low, high) for name, (low, high) in zip(location.covariates, seen, strict=False))
    return Effect(law, location, (*values, *inner), (), ranges)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("arms")


@pytest.mark.slow
@settings(max_examples=60)
@given(effect=effects(), certain=st.booleans())
def test_any_effect_is_read_as_it_was_written(folder: Path, effect: Effect, certain: bool) -> None:
    std = {name: 0.25 for name in effect.named} if certain else None
    text = tomlkit.dumps({"effect": [effect_table(effect, std)]})
    assert arm_and(folder, f"\n{text}").effects == (effect,)


def test_every_place_of_every_law_is_read_as_it_was_written(folder: Path) -> None:
    every = [
        Effect(
            law,
            location,
            tuple(0.5 * (i in location.terms) for i in range(len(law.amplitudes))) + (2.0,) * len(law.inner),
        )
        for law in CATALOGUE.values()
        for location in locations(law)
    ]
    assert {one.law for one in every} == set(OF_CHAINS)
    found = arm_and(folder, "\n" + tomlkit.dumps({"effect": [effect_table(one) for one in every]})).effects
    assert found == tuple(every)


@pytest.mark.parametrize("side", [-1.0, 0.0, 1.0])
def test_backlash_by_hand_moves_the_joint_by_half_its_gap(folder: Path, side: float) -> None:
    arm, shift = arm_with(folder, BACKLASH), plain().position(J2=1.8e-4 * side)
    found = arm.deflection(Q, "p200", covariates={"approach_J2": side}).pose
    expected = plain().deflection(Q + shift, "p200").pose
    np.testing.assert_allclose(found.homogeneous, expected.homogeneous, atol=2e-7)
    assert side == 0.0 or not np.allclose(found.homogeneous, plain().deflection(Q, "p200").pose.homogeneous, atol=1e-5)


def test_the_axis_of_a_law_that_has_one_and_what_may_be_left_out(folder: Path) -> None:
    backlash, growth = arm_with(
        folder,
        'name = "backlash"\nsite = "J2"\nparameters = { gap = 1e-4 }',
        'name = "thermal_growth"\nsite = "J3"\nparameters = { alpha = 1e-5 }',
    ).effects
    assert (backlash.location.axis, backlash.location.covariates) == ("ry", ("approach_J2",))
    assert (growth.location.site, growth.location.covariates) == ("link:J3", ("temperature",))
    assert growth.named == {"alpha": 1e-5, "reference": 20.0, "lag": 0.0}


def test_effects_that_change_the_model(folder: Path) -> None:
    name = next(iter(plain().payloads))
    arm = arm_with(
        folder,
        f'name = "payload_mass"\nsite = "tool"\npartner = "{name}"\nparameters = {{ mass = 7.5 }}',
        'name = "tracker_scale"\nsite = "base"\nparameters = { lambda = 40.0 }',
        'name = "gravity_tilt"\nsite = "base"\naxis = "rx"\nparameters = { rx = 0.01 }',
    )
    old = plain().payloads[name]
    assert arm.payloads[name].mass == pytest.approx(old.mass + 7.5) and arm.instrument.scale == pytest.approx(4e-5)
    heavier = Payload(old.mass + 7.5, old.com)
    robot = dataclasses.replace(plain().robot, gravity=9.81 * np.array([0.0, np.sin(0.01), -np.cos(0.01)]))
    expected = dataclasses.replace(plain(), robot=robot).deflection(Q, heavier).displacement
    np.testing.assert_allclose(arm.deflection(Q, name).displacement, expected, rtol=1e-9)


def test_a_link_effect_goes_by_the_joint_that_ends_the_link(folder: Path) -> None:
    table = 'name = "link_geometry"\nsite = "{}"\nparameters = {{ dz = 1e-3 }}'
    arm = arm_with(folder, table.format("J3"))
    shift = arm.deflection(Q, "p200").displacement - plain().deflection(Q, "p200").displacement
    np.testing.assert_allclose(np.linalg.norm(shift[:3]), 1e-3, rtol=1e-2)
    with pytest.raises(ArmFileError, match=r"'J1' is no place for link_geometry .*known: J2, J3, J4, J5, J6, tool"):
        arm_with(folder, table.format("J1"))


def test_an_effect_asks_for_its_column(folder: Path) -> None:
    arm = arm_with(folder, BACKLASH)
    with pytest.raises(MissingCovariateError, match="effect 'backlash J2 ry' needs the covariate 'approach_J2'"):
        arm.deflection(Q)


HARMONIC = 'name = "gear_harmonic"\nsite = "J3"\nparameters = { A = 1e-3, B = 5e-4, k = 9 }'

BAD = {
    "law": ('name = "backlsh"', "no effect 'backlsh', did you mean 'backlash'", 1),
    "no law": ('site = "J2"', "needs 'name'", 0),
    "no site": ('name = "backlash"', "needs 'site'", 0),
    "site": (BACKLASH.replace('"J2"', '"J22"'), "'J22' is no place for backlash on this arm, did you mean 'J2'", 2),
    "place": (BACKLASH.replace('"J2"', '"tool"'), "'tool' is no place for backlash", 2),
    "axis": (BACKLASH.replace('"ry"', '"rw"'), "has no axis 'rw' there, did you mean 'ry'", 3),
    "other axis": (BACKLASH.replace('"ry"', '"dx"'), "has no axis 'dx' there.*known: ry", 3),
    "axis of none": (
        'name = "tracker_scale"\nsite = "base"\naxis = "rx"\nparameters = { lambda = 1 }',
        "takes no axis",
        3,
    ),
    "no axis": ('name = "compliance"\nsite = "J2"\nparameters = { C = 1e-9 }', "needs 'axis', one of dx, dy, dz", 0),
    "parameter": (BACKLASH.replace("gap", "gup"), "has no parameter 'gup', did you mean 'gap'", 4),
    "no parameter": (BACKLASH.replace("gap = 3.6e-4", ""), "backlash needs gap", 4),
    "no parameters": ('name = "backlash"\nsite = "J2"', "needs 'parameters'", 0),
    "not finite": (BACKLASH.replace("3.6e-4", "nan"), "not finite", 4),
    "a word": (BACKLASH.replace("3.6e-4", '"wide"'), "expected a number, got 'wide'", 4),
    "inner": ('name = "gear_harmonic"\nsite = "J2"\nparameters = { A = 1e-4 }', r"'k' \[1\] is missing", 3),
    "inner of nothing": (
        'name = "gear_harmonic"\nsite = "J2"\nparameters = { A = 1e-4, k = 0.0 }',
        "k is 0, expected more than 0",
        3,
    ),
    "negative lag": (
        'name = "thermal_growth"\nsite = "J2"\nparameters = { alpha = 1e-5, lag = -1 }',
        "lag is -1, expected 0 or more",
        3,
    ),
    "negative": (
        'name = "link_flexure"\nsite = "J2"\naxis = "ry"\nparameters = { C_ry = -1e-9 }',
        "C_ry is -1e-09, expected 0 or more",
        4,
    ),
    "apart": (
        'name = "link_flexure"\nsite = "J2"\nparameters = { C_dx = 1e-9, C_ry = 1e-9 }',
        "C_dx, C_ry do not act together there",
        3,
    ),
    "covariates": (f'{BACKLASH}\ncovariates = ["approach_J3"]', "depends on 'approach_J2', got 'approach_J3'", 5),
    "two temperatures": (
        'name = "thermal_growth"\nsite = "J2"\ncovariates = ["a", "b"]\nparameters = { alpha = 1e-5 }',
        "depends on 1 of any name, got 'a', 'b'",
        3,
    ),
    "column of no joint": (
        'name = "unnamed"\nshape = "line"\nsite = "J2"\naxis = "rx"\ncovariates = ["q_J9"]\nparameters = { slope = 1 }',
        "the arm has no 'q_J9', did you mean 'q_J",
        5,
    ),
    "shape of nothing": (
        'name = "unnamed"\nshape = "line"\nsite = "J2"\naxis = "rx"\nparameters = { slope = 1, middle = 0 }',
        "needs 'covariates', a column",
        0,
    ),
    "shape": ('name = "unnamed"\nshape = "bumpp"', "'bumpp' is not known, did you mean 'bump'", 2),
    "partner": (
        'name = "cross_coupling"\nsite = "J2"\naxis = "ry"\nparameters = { C = 1e-9 }',
        "needs 'partner', one of",
        0,
    ),
    "partner of none": (f'{BACKLASH}\npartner = "rx"', "takes no partner", 5),
    "payload": (
        'name = "payload_mass"\nsite = "tool"\npartner = "p20"\nparameters = { mass = 1 }',
        "no 'p20', did you mean 'p200'",
        3,
    ),
    "payload of less than nothing": (
        'name = "payload_mass"\nsite = "tool"\npartner = "p200"\nparameters = { mass = -200.5 }',
        "payload 'p200' of 200 kg would weigh -0.5 kg, expected 0 kg or more",
        4,
    ),
    "link of less than nothing": (
        'name = "link_mass"\nsite = "J3"\nparameters = { mass = -1e4 }',
        r"link '.*' of .* kg would weigh -.* kg, expected 0 kg or more",
        3,
    ),
    "session": ('name = "session_frame"\nsite = "base"\nparameters = { dx = 1e-3 }', "needs 'partner'", 0),
    "key": (f"{BACKLASH}\nparametres = {{ gap = 1 }}", "unknown key, did you mean 'parameters'", 5),
    "seen of nothing": (f"{BACKLASH}\nseen = {{ q_J2 = [0, 1] }}", "depends on no 'q_J2' there", 5),
    "seen": (f"{HARMONIC}\nseen = {{ q_J3 = [1, 0] }}", "expected the smaller first, got 1 and 0", 4),
    "std": (f"{BACKLASH}\nstd = {{ gap = -1 }}", "std: of gap is -1, expected 0 or more", 5),
    "std of nothing": (f"{BACKLASH}\nstd = {{ gup = 1 }}", "std: of 'gup', which is no parameter", 5),
}


@pytest.mark.parametrize(("table", "complaint", "line"), BAD.values(), ids=BAD)
def test_a_bad_table_is_refused_with_its_line(folder: Path, table: str, complaint: str, line: int) -> None:
    first = TEXT.count("\n") + 2
    with pytest.raises(ArmFileError, match=complaint) as caught:
        arm_with(folder, table)
    assert caught.value.place.line == first + line and caught.value.place.file.name == "arm.toml"


def test_what_was_fitted_may_be_below_zero(folder: Path) -> None:
    """A stiffer joint than is declared has less compliance; by hand, without a deviation, that is a slip."""
    table = 'name = "link_flexure"\nsite = "J2"\naxis = "ry"\nparameters = { C_ry = -1e-9 }\nstd = { C_ry = 1e-10 }'
    effect = arm_with(folder, table).effects[0]
    assert effect.named == {"C_ry": -1e-9}


@pytest.mark.parametrize("many", [False, True])
def test_beyond_where_an_effect_was_found_it_is_said(folder: Path, many: bool) -> None:
    thermal = 'name = "thermal_growth"\nsite = "J3"\nparameters = { alpha = 1e-5 }\nseen = { temperature = [15, 25] }'
    arm = arm_with(folder, f"{HARMONIC}\nseen = {{ q_J3 = [-0.5, 1.0] }}", thermal)
    inside, beyond = Q.copy(), Q.copy()
    inside[2], beyond[2] = 1.0, 1.5
    asked = (lambda q: np.array([q, q])) if many else (lambda q: q)

    def said(q: np.ndarray, kelvin: float) -> list[str]:
        flags = arm.deflection(asked(q), "p200", covariates={"temperature": kelvin}).flags
        return [flag.text for flag in flags if flag.code == "extrapolating"]

    assert not said(inside, 20.0) and not said(inside, 25.1)  # by a little nothing is said
    assert ["q_J3 = 1.5 is outside the -0.5 to 1 it was found in" in text for text in said(beyond, 20.0)] == [True]
    assert ["temperature = 40 is outside" in text for text in said(inside, 40.0)] == [True]
    with pytest.raises(ExtrapolationError, match="gear harmonic at J3"):
        arm.deflection(asked(beyond), "p200", covariates={"temperature": 20.0}, strict=True)


def campaign(folder: Path, kind: str, seed: int) -> tuple[Path, Arm, Measurements, Measurements, np.ndarray]:
    """Return arm file, arm, rows to fit, held-out rows and where they would be read without noise."""
    drawn = draw(kind, seed, "six").write(folder)
    arm = quietly(drawn.arm)
    return drawn.arm, arm, read_measurements(drawn.train, arm), read_measurements(drawn.test, arm), drawn.clean


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> tuple:
    """A campaign of an arm that lacks nothing, and its calibrations on all of it and on a fifth."""
    file, arm, train, test, clean = campaign(tmp_path_factory.mktemp("calm"), "none", 5)
    measured = np.flatnonzero(train.measured)
    few = calibrate(arm, train, measured[::5])
    return file, calibrate(arm, train), few, test, clean


def first(rows: Measurements, count: int) -> Measurements:
    """Return the first rows of a table."""
    cut = {
        field.name: getattr(rows, field.name)[:count]
        for field in dataclasses.fields(rows)
        if field.name not in ("joint_names", "flags") and isinstance(getattr(rows, field.name), tuple | np.ndarray)
    }
    covariates = {name: values[:count] for name, values in rows.covariates.items()}
    return dataclasses.replace(rows, **cut, covariates=covariates)


def held_out(test: Measurements, values: np.ndarray) -> np.ndarray:
    return values[test.measured]


@pytest.mark.slow
def test_the_stated_uncertainty_of_predictions_is_about_right(calm: tuple) -> None:
    _, found, few, test, clean = calm
    for calibration in (found, few):
        there = predict(calibration.arm, test)
        deviation = held_out(test, (there.position - clean) / there.sigma)
        # Errors of rows go together: one campaign is a few dozen independent numbers, not hundreds.
        assert 0.5 < np.sqrt((deviation**2).mean()) < 1.6
        assert (np.abs(deviation) < 2.0).mean() > 0.8


@pytest.mark.slow
def test_uncertainty_shrinks_with_more_data(calm: tuple) -> None:
    _, found, few, test, _ = calm
    all_rows, fifth = (held_out(test, predict(c.arm, test).sigma).mean() for c in (found, few))
    assert 1.4 < fifth / all_rows < 4.0


@pytest.mark.slow
def test_a_new_session_is_less_certain(calm: tuple) -> None:
    _, found, _, test, _ = calm
    new = dataclasses.replace(test, session=("another",) * len(test))
    known, unknown = predict(found.arm, test), predict(found.arm, new)
    more = unknown.sigma**2 - known.sigma**2
    assert (more > 0.8 * found.arm.prior.session_translation**2).all()
    assert "new_session" in [flag.code for flag in unknown.flags]


@pytest.mark.slow
def test_a_calibrated_file_keeps_the_uncertainty(calm: tuple, tmp_path: Path) -> None:
    _, found, _, test, _ = calm
    written = found.write(tmp_path / "arm.toml")
    there, again = predict(found.arm, test), predict(quietly(written), test)
    np.testing.assert_allclose(again.position, there.position, atol=1e-12)
    np.testing.assert_allclose(again.sigma, there.sigma, rtol=1e-4)


@pytest.mark.slow
def test_a_file_without_covariance_says_that_sigma_leaves_it_out(calm: tuple, tmp_path: Path) -> None:
    _, found, _, test, _ = calm
    written = found.write(tmp_path / "arm.toml")
    document = tomlkit.parse(written.read_text())
    del document["calibration"]["covariance"]
    written.write_text(tomlkit.dumps(document))
    there = predict(quietly(written), test)
    assert there.sigma is None and "no_certainty" in [flag.code for flag in there.flags]
    document["calibration"]["scale"] = 3e-5
    written.write_text(tomlkit.dumps(document))
    assert quietly(written).instrument.scale == 3e-5
    document["calibration"]["covariance"] = [[1.0], [0.5]]
    written.write_text(tomlkit.dumps(document))
    with pytest.raises(ArmFileError, match=r"covariance: expected .* rows of 1, 2"):
        quietly(written)


def refitted(calibration: Calibration, *wanted: tuple[Effect, tuple[int, ...]]) -> Trace:
    """Return what a trace that had found these effects would hold, everything fitted together."""
    state = begin(calibration)
    blocks = [
        EffectBlock(effect, free, state.context, i, amplitude_prior(effect, free, state.fit.view, state.context))
        for i, (effect, free) in enumerate(wanted)
    ]
    state = refit(state, tuple(blocks), None, np.concatenate([state.fit.values, *(one.start for one in blocks)]))
    return told(calibration, state)


def told(calibration: Calibration, state: State) -> Trace:
    values = [(block, state.values_of(block)) for block in state.effects]
    proof = Proof(0.0, 0.0, None, None, 0.0)
    found = tuple(Found(b.at(v), alone(state).std_of(b), 0.0, proof, (), i, 1, 1.0) for i, (b, v) in enumerate(values))
    setup, certainty = state.fit.setup, certainty_of(state.fit)
    effects = tuple(one.effect for one in found)
    arm = dataclasses.replace(setup.arm, effects=effects, instrument=setup.instrument, certainty=certainty)
    return Trace(arm, alone(state), found, None, (), 0.0, 0.0, None)


def named(name: str, site: str, **more: object) -> Effect:
    """Return a law at the first of its locations at a site that has what is asked."""
    law = CATALOGUE[name]
    inner = more.pop("inner", ())
    fits = (s for s in law.places(context().records) if s.place == site)
    location = next(s for s in fits if all(getattr(s, k) == v for k, v in more.items()))
    return Effect(law, location, (0.0,) * len(law.amplitudes) + inner)


@pytest.fixture(scope="module")
def traced(tmp_path_factory: pytest.TempPathFactory) -> tuple:
    """An arm with hysteresis, fitted with it and with whatever changes the model itself, as if all had been found."""
    file, arm, train, test, clean = campaign(tmp_path_factory.mktemp("traced"), "hysteresis", 1)
    session = named("session_frame", "base", partner="a", terms=(0, 1, 2))
    found = refitted(
        calibrate(arm, train),
        (named("hysteresis", "J1", axis="ry", inner=(800.0,)), (0,)),
        (named("payload_mass", "tool", partner=""), ()),
        (named("gravity_tilt", "base", axis=None), ()),
        (named("tracker_scale", "base"), ()),
        (dataclasses.replace(session, location=dataclasses.replace(session.location, partner="s0")), ()),
        (named("thermal_growth", "J3", inner=(20.0, 4000.0)), (1,)),
        (named("link_mass", "J3", terms=(0,)), ()),
    )
    return file, found, found.write(file.parent / "traced.toml"), test, clean


@pytest.mark.slow
def test_a_traced_arm_predicts_the_same_when_read_again(traced: tuple) -> None:
    file, found, written, test, _ = traced
    again = quietly(written)
    assert again.effects == found.arm.effects and again.instrument.scale == found.arm.instrument.scale != 0.0
    there, back = predict(found.arm, test), predict(again, test)
    np.testing.assert_allclose(back.position, there.position, atol=1e-12)
    np.testing.assert_allclose(back.displacement, there.displacement, atol=1e-12)
    np.testing.assert_allclose(back.sigma, there.sigma, rtol=1e-4)
    assert file.read_text().splitlines()[0] in written.read_text()


@pytest.mark.slow
def test_every_effect_matters_to_what_is_predicted(traced: tuple) -> None:
    """Else the test above would not notice one that is lost, or applied twice."""
    found, test = traced[1], first(traced[3], 60)
    there = predict(quietly(traced[2]), test).position
    for i, one in enumerate(found.found):
        text = tomlkit.parse(traced[2].read_text())
        del text["effect"][i]
        (traced[2].parent / "less.toml").write_text(tomlkit.dumps(text))
        moved = predict(quietly(traced[2].parent / "less.toml"), test).position - there
        assert np.abs(moved).max() > 1e-9, one.effect.name


@pytest.mark.slow
def test_what_was_traced_is_as_certain_as_it_says(traced: tuple) -> None:
    _, _, written, test, clean = traced
    there = predict(quietly(written), test)
    deviation = held_out(test, (there.position - clean) / there.sigma)
    assert 0.5 < np.sqrt((deviation**2).mean()) < 1.6


@pytest.mark.slow
def test_the_file_holds_values_and_uncertainties_of_all(traced: tuple) -> None:
    _, found, written, _, _ = traced
    text = tomlkit.parse(written.read_text())
    labels, count = list(text["calibration"]["parameters"]), len(found.state.fit.values)
    assert len(labels) == len(text["calibration"]["covariance"]) == count
    assert "effect hysteresis J1 ry radius" in labels and text["calibration"]["scale"] == 0.0
    first = text["effect"][0]
    assert dict(first["parameters"]) == found.found[0].effect.named
    assert dict(first["std"]) == pytest.approx(dict(found.found[0].std))


@pytest.mark.slow
def test_draws_of_a_traced_arm_move_its_effects(traced: tuple) -> None:
    """All but those of the instrument."""
    arm = quietly(traced[2])
    drawn = draw_arms(arm, 20, seed=2)
    for i, effect in enumerate(arm.effects):
        values = np.array([one.effects[i].values for one in drawn])
        moves = np.ptp(values, axis=0) > 0.0
        assert moves.any() != (effect.name.startswith(("tracker_scale", "session_frame"))), effect.name
        np.testing.assert_allclose(values.mean(axis=0)[~moves], np.array(effect.values)[~moves])


@pytest.mark.slow
def test_draws_of_a_traced_arm_spread_as_its_whole_covariance_says(traced: tuple) -> None:
    """But for hysteresis, whose state the covariance takes to be another than it is told."""
    arm = quietly(traced[2])
    kept = [i for i, label in enumerate(arm.certainty.labels) if not label.startswith("effect hysteresis")]
    known = arm.certainty.part(kept)
    arm = dataclasses.replace(arm, effects=arm.effects[1:], certainty=known)
    q, warm = arm.position(J2=0.3, J3=-0.5), settled_covariates(arm, {"temperature": 22.0})
    found = [one.deflection(q, "p120", covariates=warm).displacement for one in draw_arms(arm, 400, seed=2)]
    expected = arm.total_covariance(q, "p120", covariates=warm)
    # A standard deviation from 400 draws is right to a root of 800, at 4 of them.
    np.testing.assert_allclose(np.std(found, axis=0), np.sqrt(np.diag(expected)), rtol=4.0 / np.sqrt(800))


@pytest.mark.slow
def test_an_arm_is_not_fitted_about_what_its_instrument_was_found_to_do(traced: tuple) -> None:
    with pytest.raises(
        UnsupportedError, match="effects that change how the instrument stands or reads cannot be fitted about"
    ):
        trace(quietly(traced[2]), traced[3])


@pytest.mark.slow
def test_a_traced_arm_is_not_called_worse_than_declared_for_its_calibration(traced: tuple) -> None:
    found = traced[1]
    flag = Flag("worse_than_declared", "of the calibrated arm")
    for declared, codes in ((1.0, []), (-1.0, ["worse_than_declared"])):  # a held-out error above and below the trace's
        doubted = dataclasses.replace(found.calibration, flags=(flag,), held_out=(declared, 2.0))
        state = dataclasses.replace(found.state, calibration=doubted)
        flags = dataclasses.replace(found, predicted=dataclasses.replace(found.predicted, state=state)).flags
        assert [one.code for one in flags if one.code == "worse_than_declared"] == codes and flag not in flags


@pytest.mark.slow
def test_a_twist_that_nobody_can_predict_is_kept_as_uncertainty(calm: tuple, tmp_path: Path) -> None:
    _, found, _, test, _ = calm
    state = begin(found)
    random = PoseBlock("J2", "ry", 4e-4, state.context.column("pose_number").astype(int))
    made = told(found, with_random(state, random))
    written = quietly(made.write(tmp_path / "arm.toml"))
    assert written.certainty.unexplained == (("J2", "ry", 4e-4),) and not written.effects
    there, back = predict(made.arm, test), predict(written, test)
    np.testing.assert_allclose(back.position, there.position, atol=1e-12)
    lever = np.linalg.norm(found.arm.deflection(Q).pose.translation)
    assert 0.2 * 4e-4 * lever < np.median(np.linalg.norm(back.sigma, axis=1)) < 2.0 * 4e-4 * lever


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["backlash", "link_mass", "payload_com"])
def test_an_arm_is_calibrated_about_effects_written_by_hand(kind: str, tmp_path: Path) -> None:
    """Also those that change what the model weighs, and once more by the instrument alone."""
    file, _, train, test, clean = campaign(tmp_path, kind, 1)
    true = json.loads((tmp_path / "truth.json").read_text())["effects"][0]
    names = {amplitude.name for amplitude in CATALOGUE[kind].amplitudes}
    values = ", ".join(f"{name} = {value}" for name, value in true["parameters"].items() if name in names)
    site = "tool" if kind == "payload_com" else true["site"]
    table = f'name = "{kind}"\nsite = "{site}"\nparameters = {{ {values} }}'
    file.write_text(f"{file.read_text()}\n# known from the data sheet\n[[effect]]\n{table}\n")
    found = calibrate(quietly(file), train)
    assert found.rms < 1.05 * found.noise_rms
    written = found.write(tmp_path / "calibrated.toml")
    assert "# known from the data sheet" in written.read_text()
    there, back = predict(found.arm, test), predict(quietly(written), test)
    np.testing.assert_allclose(back.position, there.position, atol=1e-12)
    assert np.sqrt((held_out(test, back.position - clean) ** 2).sum(axis=1).mean()) < 0.3 * found.noise_rms
    kept = calibrate(quietly(written), train, keep=True)
    assert kept.rms == pytest.approx(found.rms, rel=1e-2)
    once_more = kept.write(tmp_path / "kept.toml")
    there, back = predict(kept.arm, test), predict(quietly(once_more), test)
    np.testing.assert_allclose(back.position, there.position, atol=1e-12)


@pytest.mark.slow
def test_what_cannot_be_fitted_about_is_said(folder: Path, calm: tuple) -> None:
    arm = arm_with(folder, 'name = "tracker_scale"\nsite = "base"\nparameters = { lambda = 40.0 }')
    with pytest.raises(UnsupportedError, match="cannot be fitted about: tracker_scale base"):
        calibrate(arm, calm[3])


@pytest.mark.slow
def test_rows_that_lack_a_column_are_named(folder: Path, calm: tuple) -> None:
    table = 'name = "thermal_softening"\nsite = "J2"\ncovariates = ["oil"]\nparameters = { beta = 1e-3 }'
    with pytest.raises(MissingCovariateError, match=r"test\.csv:1: effect 'thermal_softening J2' needs .* 'oil'"):
        predict(arm_with(folder, table), renamed(calm[3]))


def renamed(rows: Measurements) -> Measurements:
    """Return a few rows whose payloads this arm knows."""
    few = first(rows, 3)
    return dataclasses.replace(few, payload=("none",) * 3)


def test_a_link_cannot_lose_twice_what_it_weighs(folder: Path) -> None:
    """One declared and one found beside it: what is possible is what the file can be read with."""
    own = arm_and(folder, "").robot.urdf.links["link4"].inertial.mass
    table = f'name = "link_mass"\nsite = "J5"\nparameters = {{ mass = {-0.6 * own} }}'
    arm, law = arm_with(folder, table), CATALOGUE["link_mass"]
    for share, possible in ((-0.6, False), (-0.3, True)):
        more = Effect(law, arm.effects[0].location, (share * own, 0.0, 0.0, 0.0))
        assert bool(law.possible(more, context(), arm)) is possible
