"""The measured machine of the other tests is what it says: mechanics, closed forms, sizes, files."""

import csv
import json
import tomllib
from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest
from support.absorbed import visible, visible_each
from support.campaign_files import ARMS, declared_text
from support.campaigns import KINDS, LAGGED, OUTSIDE, SESSIONS, draw
from support.plant import Plant, apply
from support.undeclared import lagged, play

import armflex
from armflex import load_arm, read_measurements

ALL = (*KINDS, *LAGGED, *OUTSIDE, "two")


@pytest.mark.parametrize("arm", ARMS)
def test_plant_and_library_agree_on_the_declared_arm(arm, tmp_path):
    file = tmp_path / "arm.toml"
    file.write_text(declared_text(arm))
    plant, loaded = Plant.read(file), load_arm(file)
    rng = np.random.default_rng(0)
    for name, mass, com in ARMS[arm].payloads:
        q = rng.uniform(
            [0.9 * max(j.lower, -2.5) for j in plant.joints], [0.9 * min(j.upper, 2.5) for j in plant.joints]
        )
        tip = plant.settle(q, mass, np.array(com))[-1]
        np.testing.assert_allclose(loaded.deflection(q, name).pose.homogeneous, tip, rtol=0.0, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "arm"), list(zip(ALL[::5], cycle(ARMS))))
def test_every_effect_moves_the_tip_by_what_was_asked(kind, arm):
    """Of every fifth effect, on the two arms in turn: what sizes an effect knows neither law nor arm."""
    drawn = draw(kind, 11, arm)
    calm = drawn.readings(())
    assert len(drawn.effects) == (2 if kind == "two" else 1)
    for effect, told in zip(drawn.effects, drawn.raw_rms, strict=True):
        moved = (drawn.readings((effect,)) - calm)[drawn.rows.measured]
        raw = np.sqrt((moved**2).sum(axis=1).mean())
        least = 0.0 if effect.amplitude == effect.limit else 0.99 * 4e-4  # hoses pull as much as they can, and no more
        assert least < raw <= 1.01 * 5e-3 and raw == pytest.approx(told, rel=1e-6)
        assert 0.0 < effect.amplitude <= effect.limit


def test_of_several_effects_those_show_that_the_others_and_calibration_leave_evidence_of():
    """A deadband that a softer joint nearly is; beside it a mass and a warm joint: as fits to these readings say."""
    drawn = draw("3 effects", 9501, "boom")
    seen = {effect.name: one for effect, one in zip(drawn.effects, visible_each(drawn), strict=True)}
    assert seen["deadband"].evidence < 10.0 and 30.0 < seen["link_mass"].evidence < 100.0
    assert seen["thermal_softening"].evidence > 1000.0
    quiet = replace(drawn, errors=0.0 * drawn.errors)
    for one, effect in zip(visible_each(quiet), quiet.effects, strict=True):
        count, readings = 1 + len(effect.nearby()), 3 * drawn.rows.measured.sum()
        least = readings / 3 * (one.rms / drawn.noise.sigma) ** 2 - count * np.log(readings)
        assert one.evidence == pytest.approx(least, abs=30.0) and one.strain < 3.0


def test_several_effects_come_to_rest_together():
    assert np.isfinite(draw("6 effects", 9803, "six").readings()).all()


def test_backlash_of_the_mast_moves_the_tip_along_the_mast():
    """Half the gap along the prismatic joint's motion, which is the base's -z; the arm hangs rigidly from it."""
    drawn = next(d for d in (draw("backlash", seed) for seed in range(60)) if d.effects[0].site == "M1")
    effect, rows, plant = drawn.effects[0], drawn.rows, drawn.plant
    shift = plant.points(plant.relax(rows, [effect])) - plant.points(plant.relax(rows))
    half = effect.tell(effect.amplitude)["gap"] / 2
    np.testing.assert_allclose(shift, -half * rows.approach[:, :1] * np.array([0.0, 0.0, 1.0]), atol=1e-12)


def test_tip_force_bends_a_cantilever_by_force_times_compliance():
    """With one compliance only, about a vertical axis, a horizontal force turns the rest of the arm by C r x F."""
    drawn = draw("tip_force", 2)
    plant, rows, effect = drawn.plant, drawn.rows, drawn.effects[0]
    plant.compliance = {"A1": np.diag([0, 0, 0, 0, 0, 1e-9])}
    calm, state = plant.relax(rows), plant.relax(rows, [effect])
    told = effect.tell(effect.amplitude)
    force = np.array([told["fx"], told["fy"], told["fz"]])
    arm = state.frames[:, -1, :3, 3] - state.frames[:, 1, :3, 3]
    angle = 1e-9 * np.cross(arm, force)[:, 2]
    seen = calm.frames[:, 1, :3, :3].swapaxes(1, 2) @ state.frames[:, 1, :3, :3]
    np.testing.assert_allclose(np.arctan2(seen[:, 1, 0], seen[:, 0, 0]), angle, atol=1e-12)


def test_tracker_scale_stretches_the_range():
    drawn = draw("tracker_scale", 4)
    ppm = drawn.effects[0].tell(drawn.effects[0].amplitude)["ppm"]
    unscaled = apply(drawn.station, drawn.plant.points(drawn.plant.relax(drawn.rows)))
    expected = apply(drawn.shifts[drawn.rows.session], unscaled * (1 + 1e-6 * ppm))
    np.testing.assert_allclose(drawn.readings(), expected, atol=1e-12)


def test_play_and_lag_have_their_memory():
    np.testing.assert_allclose(play(np.array([0.5, 3.0, 2.5, 1.0, -4.0, -3.5]), 1.0), [0, 2, 2, 2, -3, -3])
    time = np.linspace(0.0, 7200.0, 400)
    np.testing.assert_allclose(
        lagged(time, 20.0 + time / 1000.0, 1800.0),
        20.0 + (time - 1800.0 * (1 - np.exp(-time / 1800.0))) / 1000.0,
        atol=1e-10,
    )


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS)
def test_the_library_reads_what_is_written(arm, tmp_path):
    truth = draw("creep", 5, arm).write(tmp_path)
    loaded = load_arm(truth.arm)
    train, test = read_measurements(truth.train, loaded), read_measurements(truth.test, loaded)
    assert len(train) == len(test) == len(truth.clean) == 460 and len(set(train.session)) == SESSIONS
    assert 280 <= train.measured.sum() <= 380 and 50 <= test.measured.sum() <= 150
    assert not (train.measured & test.measured).any()
    assert not set(np.array(train.pose)[train.measured]) & set(np.array(test.pose)[test.measured])
    assert set(train.covariates) == {"temperature", "humidity"} and train.hold.min() >= 25.0
    np.testing.assert_array_equal(
        np.sign(np.diff(train.q, axis=0))[1:], np.where(np.diff(train.q, axis=0)[1:] == 0.0, 0.0, train.approach[2:])
    )
    error = (train.position - truth.clean)[train.measured] / truth.sigma
    assert 0.9 < np.sqrt((error**2).mean()) < 1.1 and np.all(np.diff(train.time) > 0.0)
    told = json.loads((tmp_path / "truth.json").read_text())
    assert told["effects"][0]["name"] == "creep" and tomllib.loads(truth.arm.read_text())["prior"]["tool"] == 0.005
    with (tmp_path / "truth.csv").open() as file:
        assert np.allclose([[float(r[a]) for a in "xyz"] for r in csv.DictReader(file)], truth.clean)


@pytest.mark.parametrize(("kind", "sigma"), [("none", 2e-4), ("none_noisier", 3e-4), ("none_quieter", 1e-4)])
def test_empty_campaigns_hold_noise_of_the_stated_truth(kind, sigma, tmp_path):
    truth = draw(kind, 6).write(tmp_path)
    rows = read_measurements(truth.train, load_arm(truth.arm))
    error = (rows.position - truth.clean)[rows.measured]
    assert truth.effects == () and truth.sigma == pytest.approx(sigma) and np.all(rows.sigma[rows.measured] == 2e-4)
    assert np.sqrt((error**2).mean()) == pytest.approx(sigma, rel=0.1)


@pytest.mark.slow
def test_restationed_campaigns_have_heavy_tails_and_lost_beams():
    drawn = [draw("none_restationed", seed) for seed in range(12)]
    errors = np.concatenate([d.errors[~d.lost] for d in drawn]) / 2e-4
    assert 0.005 < np.mean([d.lost for d in drawn]) < 0.02
    assert errors.std() == pytest.approx(1.0, rel=0.25) and (np.abs(errors) > 4.5).mean() > 1e-3


@pytest.mark.slow
def test_same_seed_same_campaign(tmp_path):
    first, again, other = (draw("two", seed, "six").write(tmp_path / str(n)) for n, seed in enumerate((1, 1, 2)))
    assert first.train.read_bytes() == again.train.read_bytes() != other.train.read_bytes()
    assert (tmp_path / "0" / "truth.json").read_text() == (tmp_path / "1" / "truth.json").read_text()


def test_size_scales_the_effect_and_nothing_else():
    whole, quarter = draw("gear_harmonic", 3), draw("gear_harmonic", 3, size=0.25)
    assert quarter.raw_rms[0] == pytest.approx(0.25 * whole.raw_rms[0], rel=3e-3)
    np.testing.assert_array_equal(whole.errors, quarter.errors)


@pytest.mark.slow
def test_what_calibration_may_move_is_hidden_by_it():
    """An encoder offset is a calibration parameter; backlash is none."""
    offset, backlash = draw("encoder_offset", 3, "six"), draw("backlash", 3, "six")
    left = visible(offset)
    assert left.rms < 0.1 * offset.raw_rms[0] and left.strain > 0.1
    assert 0.5 * backlash.raw_rms[0] < visible(backlash).rms <= backlash.raw_rms[0]
    assert visible(draw("session_frame", 3)).strain > 3.0


@pytest.mark.slow
def test_calibration_finds_the_true_machine_when_nothing_is_hidden(tmp_path):
    truth = draw("none", 8, "six").write(tmp_path)
    arm = load_arm(truth.arm)
    found = armflex.calibrate(arm, read_measurements(truth.train, arm))
    error = armflex.predict(found.arm, read_measurements(truth.test, arm)).position - truth.clean
    assert np.sqrt((error[truth.held_out] ** 2).sum(axis=1).mean()) < 0.7 * 2e-4 * np.sqrt(3.0)
