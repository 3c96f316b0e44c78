"""What a tracker makes of mistakes: gross first readings, absurd numbers, and directions that nobody determined."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from support.small_arms import ROBOTS
from support.tracking import SIGMA, error, followed, shifted

from armflex import Arm, Tracker, load_arm
from armflex.arm import Prior
from armflex.errors import InputError, JointLimitError, UnknownNameError
from armflex.parameters import Certainty
from armflex.track.estimate import LinearisedReading, absorb, estimate_of, innovation, take, widen
from armflex.track.state_space import model_of

NOISE = np.sqrt(3.0) * SIGMA


@pytest.mark.slow
@pytest.mark.parametrize(
    "shifts",
    [
        {0: [0.0, 0.0, 0.05]},
        {2: [0.0, 5e-3, 0.0]},
        {1: [0.03, 0.0, 0.0], 3: [0.03, 0.0, 0.0], 6: [0.1, 0.0, -0.3]},
    ],
)
def test_gross_readings_among_the_first_of_a_declared_arm(machine, shifts):
    """Priors are so wide that some could be true when they come."""
    readings = machine.readings(5, 150)
    tracker = followed(Tracker(machine.arm), shifted(readings, shifts))
    clean = followed(Tracker(machine.arm), [one for i, one in enumerate(readings) if i not in shifts])
    assert not tracker.changes and tracker.outliers == clean.outliers + len(shifts)
    assert np.abs((tracker.values - clean.values) / clean.std).max() < 0.05
    assert error(tracker.arm, machine) < 1.1 * NOISE


@pytest.mark.slow
def test_a_reading_in_the_wrong_unit_is_left_out(known, machine):
    for arm in (machine.arm, known):
        tracker, readings = Tracker(arm), machine.readings(6, 40)
        readings[2] = replace(readings[2], position=1e3 * readings[2].position)
        weights = [tracker.update(reading).weight for reading in readings]
        assert weights[2] == 0.0 and min(weights[:2] + weights[3:]) > 0.5 and not tracker.changes


@pytest.mark.slow
def test_readings_of_machines_far_from_what_was_declared(machine):
    """Wide priors: what bends more than it was declared is no reason to drop readings, which are looked at anew."""
    wide = replace(machine.arm, prior=replace(machine.arm.prior, compliance=0.6, joint_offset=5e-3))
    rng, counted = np.random.default_rng(3), []
    for seed in range(5):
        compliance = {name: c * rng.uniform(0.6, 1.6) for name, c in machine.plant.compliance.items()}
        offset = {name: rng.normal(0.0, 5e-3) for name in machine.plant.offset}
        far = replace(machine, plant=replace(machine.plant, compliance=compliance, offset=offset))
        tracker = followed(Tracker(wide), shifted(far.readings(1500 + 10 * seed, 120), {3: [0.0, 0.0, 0.2]}))
        assert error(tracker.arm, far) < 1.1 * NOISE
        counted.append(tracker.outliers)
    assert np.mean(counted) < 3.0


def test_a_gross_first_reading_of_a_session_moves_nothing(known, machine):
    prior = replace(known.prior, session_translation=5e-4, session_rotation=5e-5)
    readings = [replace(one, session=str(i // 20)) for i, one in enumerate(machine.readings(7, 60))]
    clean, tracker = Tracker(replace(known, prior=prior)), Tracker(replace(known, prior=prior))
    for i, reading in enumerate(readings):
        if i % 20:
            clean.update(reading)
        else:
            reading = replace(reading, position=reading.position + np.array([0.0, 2e-3, 0.5]))
        assert (tracker.update(reading).weight == 1.0) == bool(i % 20)
    assert np.abs((tracker.values - clean.values) / clean.std).max() < 1.0 and not tracker.changes


def test_how_much_a_far_reading_moves_an_estimate():
    """Along its own direction, the less the farther, whether the parameters or the noise are what is not known."""
    rng = np.random.default_rng(0)
    for width in (1e-3, 1.0, 1e3):
        before = estimate_of(width**2 * np.diag(rng.uniform(0.5, 2.0, 5)))
        columns, away = rng.normal(size=(3, 5)), rng.normal(size=3)
        root = np.linalg.cholesky(columns @ before.covariance @ columns.T + np.eye(3))
        away = root @ away / np.linalg.norm(away)
        whole = absorb(before, innovation(before, LinearisedReading(away, columns))).values
        for distance in (3.9, 6.0, 20.0, 99.0, 101.0):
            after, weight, told = take(before, LinearisedReading(distance * away, columns))
            expected = 1.0 if distance < 4.0 else (4.0 / distance) ** 2 if distance < 100.0 else 0.0
            assert told == pytest.approx(distance) and weight == pytest.approx(expected)
            assert after.values == pytest.approx(weight * distance * whole, rel=1e-6, abs=1e-12 * width)
            gone = before.covariance - after.covariance
            assert np.linalg.eigvalsh(gone).min() > -1e-9 * width**2


def test_bad_readings_leave_everything_as_it_was(known, machine):
    tracker, (good,) = Tracker(known), machine.readings(3, 1)
    tracker.update(replace(good, time=5.0))
    before = tracker.values, tracker.covariance
    bad = [
        (JointLimitError, {"q": np.full(7, 9.0)}),
        (InputError, {"q": good.q[:3]}),
        (InputError, {"position": [0.0, np.nan, 0.0]}),
        (InputError, {"position": [0.0, 1.0]}),
        (InputError, {"position": ["a", "b", "c"]}),
        (InputError, {"sigma": 0.0}),
        (InputError, {"sigma": [1e-4, np.nan, 1e-4]}),
        (InputError, {"rotation": np.zeros(3)}),
        (UnknownNameError, {"payload": "p6000"}),
        (InputError, {"time": 4.0}),
        (InputError, {"time": None}),
    ]
    for kind, change in bad:
        with pytest.raises(kind):
            tracker.update(replace(good, **{"time": 6.0, **change}))
    assert (tracker.values == before[0]).all() and (tracker.covariance == before[1]).all() and tracker.readings == 1


def test_what_cannot_be_tracked_is_said(known, machine):
    with pytest.raises(UnknownNameError, match="compliance A4"):
        Tracker(known, {"compliance A44": 1e-3})
    with pytest.raises(InputError, match="rate of 'tool'"):
        Tracker(known, {"tool": -1.0})
    with pytest.raises(InputError, match="calibrate the arm"):
        Tracker(load_arm(ROBOTS / "tarm_like" / "measured.toml"))
    with pytest.raises(InputError, match="nothing may move"):
        Tracker(replace(machine.arm, prior=Prior()))


@pytest.mark.parametrize("rate", [-1e-3, np.nan, np.inf, 1e3, "fast", True, None])
def test_absurd_rates_are_refused(known, rate):
    with pytest.raises(InputError, match="rate of 'joint_offset'"):
        Tracker(known, {"joint_offset": rate})


@pytest.mark.parametrize("rates", [1e-3, 0.0, {1: 1e-3}, ["joint_offset"]])
def test_rates_are_by_label(known, rates):
    with pytest.raises(InputError, match="rates: expected a mapping such as"):
        Tracker(known, rates)


@pytest.mark.parametrize("time", [np.nan, np.inf])
def test_a_first_reading_has_a_finite_time(known, machine, time):
    tracker, (reading,) = Tracker(known), machine.readings(3, 1)
    with pytest.raises(InputError, match="time: expected a finite number of seconds"):
        tracker.update(replace(reading, time=time))
    assert tracker.readings == 0


@pytest.mark.parametrize("sigma", [0.0, -1e-4, np.nan, np.inf, 2000.0, "2e-4", [2e-4, 0.0, 2e-4], [2e-4, 2e-4], 1e-30])
def test_absurd_standard_deviations_are_refused(known, machine, sigma):
    tracker, (reading,) = Tracker(known), machine.readings(3, 1)
    with pytest.raises(InputError, match="sigma"):
        tracker.update(replace(reading, sigma=sigma))
    assert tracker.readings == 0
    if sigma != 0.0:
        with pytest.raises(InputError, match="sigma"):
            Tracker(known, sigma=sigma)


def with_open(arm: Arm, directions: np.ndarray) -> Arm:
    """Return the arm as if a calibration had left directions open."""
    left = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    others = np.eye(len(arm.certainty.labels)) - left.T @ left
    covariance = others @ arm.certainty.covariance @ others.T
    return replace(arm, certainty=Certainty(arm.certainty.parameters, covariance, directions=directions))


def test_directions_that_a_calibration_left_open_are_unknown(known, machine):
    """The tool stands 20 mm elsewhere along an axis that was never determined: it is found, and known from then on."""
    place = known.certainty.labels.index("tool dx")
    arm = with_open(known, 1e-3 * np.eye(len(known.certainty.labels))[[place]])
    moved = replace(machine, plant=replace(machine.plant, target=machine.plant.target + np.array([0.02, 0.0, 0.0])))
    tracker = Tracker(arm)
    assert tracker.std[place] > 1.0 and tracker.arm.certainty.undetermined == ("tool dx",)
    followed(tracker, moved.readings(9, 60))
    assert not tracker.changes and tracker.outliers == 0
    assert tracker.values[place] == pytest.approx(0.02, abs=5.0 * tracker.std[place])
    assert tracker.std[place] < 1e-4 and tracker.arm.certainty.directions is None
    assert error(tracker.arm, moved) < 1.1 * NOISE


def test_an_instrument_that_stands_nobody_knows_where(known, machine):
    """Its whole frame was left open, and it stands half a metre and 50 mrad from where the arm's file has it."""
    count, axes = len(known.certainty.labels), ("dx", "dy", "dz", "rx", "ry", "rz")
    labels = (*(f"instrument {axis}" for axis in axes), *known.certainty.labels)
    covariance = np.pad(known.certainty.covariance, ((6, 0), (6, 0)))
    open_frame = Certainty(known.named(labels), covariance, directions=np.eye(6, count + 6))
    tracker = Tracker(replace(known, certainty=open_frame))
    stands = pin.SE3(pin.exp3(np.array([0.01, -0.02, 0.05])), np.array([0.3, -0.4, 0.1]))
    readings = [replace(one, position=stands.act(one.position)) for one in machine.readings(11, 60)]
    readings[1] = replace(readings[1], position=readings[1].position + np.array([0.0, 0.5, 0.0]))
    followed(tracker, readings)
    assert not tracker.changes and tracker.arm.certainty.directions is None
    off = stands.actInv(tracker.arm.instrument.pose)
    assert np.abs(off.translation).max() < 5e-4 and np.abs(pin.log3(off.rotation)).max() < 5e-5
    assert tracker.std[:3].max() < 5e-4 and tracker.std[3:6].max() < 5e-5 and tracker.outliers == 1


def test_directions_of_which_no_reading_tells_stay_open(known, machine):
    """How the target is turned on the tool, which readings without an orientation do not say."""
    certainty, axes = known.certainty, ("rx", "ry", "rz")
    count = len(certainty.labels)
    labels = (*certainty.labels[:3], *(f"mounting {axis}" for axis in axes), *certainty.labels[3:])
    covariance = np.insert(np.insert(certainty.covariance, [3] * 3, 0.0, axis=0), [3] * 3, 0.0, axis=1)
    arm = replace(known, certainty=Certainty(known.named(labels), covariance, directions=np.eye(count + 3)[3:6]))
    tracker, plain = followed(Tracker(arm), machine.readings(9, 40)), followed(Tracker(known), machine.readings(9, 40))
    assert tracker.arm.certainty.undetermined == tuple(f"mounting {axis}" for axis in axes)
    assert (tracker.std[3:6] > 1.0).all()
    kept = np.delete(np.arange(count + 3), [3, 4, 5])
    left = tracker.arm.certainty.covariance
    assert left[np.ix_(kept, kept)] == pytest.approx(plain.covariance, rel=1e-6, abs=1e-15)
    assert np.abs(left[3:6]).max() < 1e-12
    again = Tracker(tracker.arm)
    assert (again.std[3:6] > 1.0).all() and again.std[kept] == pytest.approx(plain.std, rel=1e-6)


def test_drift_of_a_logarithm_is_the_same_wherever_the_arm_is_linearised(known, machine):
    """The estimate is far from where the arm was linearised: drift by the logarithm's rate, not by its factor's."""
    rate, waited = 2e-3, 2500.0
    softer = {"softer": {"A2": 1.3, "A4": 1.3}}
    readings = [replace(one, time=float(i)) for i, one in enumerate(machine.readings(10, 60, **softer))]
    tracker = Tracker(known, {"compliance": rate})
    for reading in readings:
        tracker.update(reading)
    assert tracker.stale and np.abs(tracker.values).max() > 0.2
    logs, before = [label.startswith("compliance") for label in tracker.labels], tracker.covariance
    tracker.update(replace(readings[-1], time=readings[-1].time + waited, sigma=10.0))
    grown = np.diag(tracker.covariance - before)[logs]
    assert grown == pytest.approx(np.full(len(grown), rate**2 * waited), rel=1e-3)
    now = tracker.covariance
    tracker.relinearise()
    assert tracker.covariance == pytest.approx(now, rel=1e-9, abs=1e-18)


def test_a_random_walk_widens_by_its_variances():
    before = estimate_of(np.diag([1.0, 4.0, 0.25]))
    assert widen(before, np.array([0.0, 1.0, 2.0])).covariance == pytest.approx(np.diag([1.0, 5.0, 2.25]))


@pytest.mark.slow
def test_sizes_of_a_change_are_those_declared(machine):
    prior = replace(machine.arm.prior, geometry=3e-5, joint_offset=2e-3, tool=7e-3, compliance=0.3)
    model = model_of(replace(machine.arm, prior=prior))
    sizes = {str(one.group.kind): set(one.sizes) for one in model.changeables}
    assert sizes == {"tool": {7e-3}, "joint_offset": {2e-3}, "geometry": {3e-5}, "compliance": {0.3}}
