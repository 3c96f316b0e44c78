"""The tracker against least squares on all readings, the batch calibration, and a machine that shares no code."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from support.tracking import SIGMA, error, followed, in_base, measured

from armflex import Arm, Reading, Tracker, calibrate
from armflex.errors import MissingCovariateError
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.location import Location
from armflex.parameters import Certainty
from armflex.readings.instrument import Instrument
from armflex.track.state_space import LinearisedView, StateSpace, model_of


@pytest.mark.slow
def test_same_as_least_squares_on_all_readings_together(known, machine):
    """By LAPACK's least squares on the stacked rows, prior included; to rounding."""
    model, readings = model_of(known), machine.readings(3, 150)
    tracker, sight = Tracker(known), LinearisedView(model.declared, model.blocks, (), 0.0)
    assert all(tracker.update(reading).weight == 1.0 for reading in readings)
    seen = [sight(reading) for reading in readings]
    prior = np.linalg.cholesky(np.linalg.inv(known.certainty.covariance)).T
    rows = np.vstack([*(one.jacobian for one in seen), prior])
    values = np.concatenate([*(one.residual for one in seen), np.zeros(len(prior))])
    scale = np.sqrt((rows**2).sum(axis=0))
    inverse = np.linalg.pinv(rows / scale)
    solved, logs = inverse @ values / scale, model.logarithmic
    spread = inverse @ inverse.T / np.outer(scale, scale)
    steps = np.where(logs, np.expm1(tracker.values), tracker.values)  # least squares is for a compliance's factor
    std, factor = np.sqrt(np.diag(spread)), np.where(logs, 1.0 + solved, 1.0)
    assert np.abs((steps - solved) / std).max() < 1e-8
    assert np.abs((tracker.covariance * np.outer(factor, factor) - spread) / np.outer(std, std)).max() < 1e-8


@pytest.mark.slow
def test_columns_are_what_readings_change_by(known, machine):
    assert_derivatives(model_of(known), machine.readings(4, 3))


def test_columns_where_a_law_depends_on_position_and_the_instrument_stands_elsewhere(tarm):
    arm, readings = elsewhere(tarm)
    assert_derivatives(model_of(arm), readings[:3])


def elsewhere(tarm: Arm) -> tuple[Arm, list[Reading]]:
    """Return the boom seen from outside: M1's compliance is a full matrix that grows as the mast goes down."""
    rng, pose = np.random.default_rng(3), pin.SE3(pin.exp3(np.array([0.3, -0.2, 2.0])), np.array([5.0, -3.0, 1.0]))
    instrument = Instrument(pose=pose, target=np.array([0.1, -0.05, 0.2]))
    axes = ("dx", "dy", "dz", "rx", "ry", "rz")
    labels = [*(f"instrument {axis}" for axis in axes), *(f"tool {axis}" for axis in axes[:3])]
    labels += [f"joint_offset {joint}" for joint in tarm.joint_names]
    labels += [f"compliance {joint} {axis}" for joint in ("M1", "A4") for axis in axes]
    arm = replace(tarm, instrument=instrument, certainty=Certainty(tarm.named(labels), 1e-6 * np.eye(len(labels))))
    readings = [
        Reading(rng.uniform(arm.robot.lower, arm.robot.upper) * 0.5, rng.normal(0.0, 5.0, 3), SIGMA, "p300")
        for _ in range(8)
    ]
    return arm, readings


def assert_derivatives(model: StateSpace, readings: list[Reading]) -> None:
    """Compare columns with central differences of the residuals, every parameter by itself."""
    here, size = LinearisedView(model.declared, model.blocks), 1e-4
    for step in size * np.eye(len(model.point)):
        ends = [LinearisedView(model.setup(model.point + side * step), model.blocks) for side in (1.0, -1.0)]
        for reading in readings:
            change = (ends[1](reading).residual - ends[0](reading).residual) / (2.0 * size)
            jacobian = here(reading).jacobian
            np.testing.assert_allclose(jacobian @ (step / size), change, rtol=0, atol=1e-5 * np.abs(jacobian).max())


def test_close_to_the_batch_calibration(machine):
    """From the declared arm in one pass, linearised anew as it learns, against the converged fit."""
    readings = machine.readings(5, 200)
    batch = calibrate(machine.arm, measured(machine, readings, "campaign.csv"))
    tracker = followed(Tracker(machine.arm), readings)
    off = np.abs(tracker.values - batch.fit.values) / tracker.std
    assert tracker.labels == batch.arm.certainty.labels and not tracker.changes
    assert off.max() < 0.5 and np.sqrt((off**2).mean()) < 0.15
    assert tracker.std == pytest.approx(np.sqrt(np.diag(batch.fit.posterior.covariance)), rel=0.15)


@pytest.mark.slow
def test_values_are_within_their_uncertainties(machine):
    """Ten machines drawn from [prior], 52 parameters each, 150 readings."""
    inside = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        factors = {name: rng.normal(0.0, 0.2, 6) for name in machine.plant.compliance}
        declared = {one.name: np.diag(one.law.compliance) for one in machine.arm.flexures}
        compliance = {name: np.diag(np.exp(factors[name]) * declared[name]) for name in factors}
        offset = {name: rng.normal(0.0, 1e-3) for name in machine.arm.joint_names}
        target = rng.normal(0.0, 5e-3, 3)
        drawn = replace(machine, plant=replace(machine.plant, compliance=compliance, offset=offset, target=target))
        tracker = followed(Tracker(machine.arm), drawn.readings(1000 + 10 * seed, 150))
        truth = np.concatenate([target, list(offset.values()), *factors.values()])
        inside.extend(np.abs(tracker.values - truth) < 1.96 * tracker.std)
        assert not tracker.changes
    assert 0.92 < np.mean(inside) < 0.98


@pytest.mark.slow
def test_goes_on_where_a_calibration_ended_as_if_it_had_seen_all(machine):
    """A calibration with half of the readings, the others one by one: against the converged fit to all of them."""
    readings = machine.readings(5, 300)
    first = calibrate(machine.arm, measured(machine, readings[:150], "first.csv"))
    both = calibrate(machine.arm, measured(machine, readings, "both.csv"))
    tracker = followed(Tracker(first.arm), readings[150:])
    assert tracker.labels == both.arm.certainty.labels
    off = np.abs(first.fit.values + tracker.values - both.fit.values) / tracker.std
    assert off.max() < 0.3 and np.sqrt((off**2).mean()) < 0.1
    assert tracker.std == pytest.approx(np.sqrt(np.diag(both.fit.posterior.covariance)), rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("compliance A4", {"softer": {"A4": 1.2}}),
        ("compliance A2", {"softer": {"A2": 1.1}}),
        ("joint_offset A3", {"moved": {"A3": 1e-3}}),
    ],
)
def test_a_change_is_announced_within_few_readings(known, machine, name, changes):
    delays, names = [], Counter()
    for seed in range(200, 240, 10):
        tracker = followed(Tracker(known), machine.readings(seed, 20))
        assert not tracker.changes
        for count, reading in enumerate(machine.readings(seed + 5, 15, **changes), 1):  # noqa: B007
            if (change := tracker.update(reading).change) is not None:
                break
        delays.append(count)
        names[change.name] += 1
        assert change.probability > 0.9 and abs(change.since - 21) <= 4 and change.reading == 20 + count
    assert names == {name: 4} and np.median(delays) <= 7 and max(delays) <= 12


def test_the_size_of_a_change_is_told_and_followed(known, machine):
    tracker = followed(Tracker(known), machine.readings(300, 20))
    before = tracker.arm
    followed(tracker, machine.readings(305, 40, softer={"A4": 1.2}))
    (change,) = tracker.changes
    assert change.labels[3:] == ("compliance A4 rx", "compliance A4 ry", "compliance A4 rz")
    assert np.abs((change.size[3:] - np.log(1.2)) / change.std[3:]).max() < 4.0
    assert f"ry {100.0 * (np.exp(change.size[4]) - 1.0):+.3g} ± " in repr(change) and repr(change).count(" %") == 6
    assert error(before, machine, softer={"A4": 1.2}) > 1e-3
    assert error(tracker.arm, machine, softer={"A4": 1.2}) < 1.15 * np.sqrt(3.0) * SIGMA


@pytest.mark.slow
def test_no_alarm_while_nothing_changes(known, machine):
    """Of 20 000 readings `python tests/studies/tracked.py --quiet 20000` counts the alarms."""
    tracker = followed(Tracker(known), machine.readings(400, 600))
    assert not tracker.changes and tracker.outliers < 10


@pytest.mark.slow
def test_lost_beams_are_survived(known, machine):
    """One reading in twenty is off by 5 mm to half a metre, sometimes two in a row."""
    rng, tracker = np.random.default_rng(5), Tracker(known)
    for reading in machine.readings(500, 400):
        far = rng.random() < 0.05
        away = np.exp(rng.uniform(np.log(5e-3), np.log(0.5))) * rng.normal(size=3)
        step = tracker.update(replace(reading, position=reading.position + far * away))
        assert step.weight < 0.5 if far else step.weight > 0.5
    assert not tracker.changes
    assert error(tracker.arm, machine) < 1.05 * np.sqrt(3.0) * SIGMA


@pytest.mark.slow
def test_drift_is_followed_at_its_declared_rate(known, machine):
    """A4 softens by 20 % over 300 readings: no change to a tracker that expects as much, one to another."""
    still, drifting = Tracker(known), Tracker(known, {"compliance A4": 0.01})
    for part in range(1, 11):
        readings = machine.readings(600 + 10 * part, 30, softer={"A4": 1.0 + 0.02 * part})
        followed(still, readings), followed(drifting, readings)
    assert still.changes and not drifting.changes
    assert error(known, machine, softer={"A4": 1.2}) > 1e-3
    assert error(drifting.arm, machine, softer={"A4": 1.2}) < 1.15 * np.sqrt(3.0) * SIGMA
    place = drifting.labels.index("compliance A4 rz")
    off = drifting.values[place] - np.log(1.2)
    assert abs(off) < 3.0 * drifting.std[place] and drifting.std[place] < 0.05


def test_drift_widens_by_its_rate_alone(known, machine):
    readings = [replace(one, time=float(i)) for i, one in enumerate(machine.readings(3, 30))]
    tracker = followed(Tracker(known, {"tool": 1e-6, "tool dx": 1e-5}), readings)
    place, before = tracker.labels.index("tool dx"), tracker.covariance
    tracker.update(replace(readings[-1], time=readings[-1].time + 1e4, sigma=10.0))
    grown = np.diag(tracker.covariance - before)
    assert grown[place : place + 3] == pytest.approx([1e-6, 1e-8, 1e-8], rel=1e-3)
    assert np.abs(np.delete(grown, range(place, place + 3))).max() < 1e-9


def test_a_new_session_loosens_the_instruments_frame_alone(known, machine):
    prior = replace(known.prior, session_translation=5e-4, session_rotation=5e-5)
    tracker, readings = Tracker(replace(known, prior=prior)), machine.readings(3, 60)
    followed(tracker, readings[:-1])
    before = tracker.covariance
    tracker.update(replace(readings[-1], session="next", sigma=10.0))
    grown = np.diag(tracker.covariance - before)
    assert tracker.labels[:6] == tuple(f"instrument {axis}" for axis in ("dx", "dy", "dz", "rx", "ry", "rz"))
    assert grown[:6] == pytest.approx(np.repeat([5e-4, 5e-5], 3) ** 2, rel=1e-3)
    assert np.abs(grown[6:]).max() < 1e-12


def test_an_orientation_counts_as_in_a_calibration(known, machine):
    """An orientation of which nothing is known tells nothing."""
    readings = machine.readings(3, 10)
    plain, turned = followed(Tracker(known), readings), Tracker(known)
    for reading in readings:
        turned.update(replace(reading, rotation=[0.0, 0.0, 0.0], sigma_r=1e9))
    assert np.abs((plain.values - turned.values) / plain.std).max() < 1e-6


@pytest.mark.slow
def test_a_learned_law_is_tracked(machine, tmp_path):
    """A4's compliance was learned with its couplings; then it softens."""
    arm = in_base(tmp_path, "learn = true\n")
    learned = calibrate(arm, measured(machine, machine.readings(800, 120), "learned.csv")).arm
    tracker = followed(Tracker(learned), machine.readings(810, 30))
    assert "law A4" in tracker.groups and sum(label.startswith("law A4") for label in tracker.labels) == 21
    assert_derivatives(model_of(learned), machine.readings(3, 1))
    followed(tracker, machine.readings(820, 40, softer={"A4": 1.2}))
    assert [change.name for change in tracker.changes] == ["law A4"]
    assert error(tracker.arm, machine, softer={"A4": 1.2}) < 1.2 * np.sqrt(3.0) * SIGMA


@pytest.mark.slow
def test_an_arm_with_an_effect_is_tracked(machine):
    """Effects stay as they are; what they depend on comes with the reading, and a row of a campaign is one."""
    warm = Effect(EVERY["thermal_growth"], Location("link:A4", None, ("temperature",)), (1.2e-5, 20.0, 0.0))
    tracker, plain = Tracker(replace(machine.arm, effects=(warm,))), Tracker(machine.arm)
    rows = measured(machine, machine.readings(900, 5), "warm.csv")
    with pytest.raises(MissingCovariateError, match="temperature"):
        tracker.update(Reading.of(rows, 0))
    for i in range(len(rows)):
        reading = Reading.of(rows, i)
        plain.update(reading)
        tracker.update(replace(reading, covariates={**reading.covariates, "temperature": 20.0}))
    assert np.abs((tracker.values - plain.values) / plain.std).max() < 0.02
    assert tracker.arm.effects == (warm,)
