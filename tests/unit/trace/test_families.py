"""What drives have in common: found where all have a little of it, not where one has much, nor where none has any."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.campaigns import draw
from support.public_campaigns import public

from armflex import load_arm, predict, read_measurements
from armflex.estimate.calibrate import calibrate
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from armflex.trace.families import with_families
from armflex.trace.state import State, add, begin

SIGMA = 1e-4


@pytest.fixture(scope="module")
def ur5():
    """Return the public UR5 as declared, as calibrated, and every third of its poses."""
    arm, measurements = public("ur5_tsinghua")
    some = measurements.some(np.arange(0, len(measurements), 3))
    return arm, calibrate(arm, some).arm, some


def measured(ur5, amplitudes: dict[str, float]) -> State:
    """Return the search's beginning on readings of the UR5 with eccentric encoders [rad], each turned its own way."""
    arm, calibrated, rows = ur5
    rng, effects = np.random.default_rng(3), []
    for joint in arm.robot.moving:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        location = next(one for one in ENCODER_ECCENTRICITY.places(_records(joint, arm)) if one.site == joint.name)
        size = amplitudes.get(joint.name, 0.0)
        effects.append(Effect(ENCODER_ECCENTRICITY, location, (size * np.cos(angle), size * np.sin(angle))))
    true = replace(calibrated, effects=tuple(one for one in effects if any(one.values)), certainty=None)
    position = predict(true, rows).position + rng.normal(0.0, SIGMA, rows.position.shape)
    return begin(calibrate(arm, replace(rows, position=position), as_stated=True))


def _records(joint, arm):
    return type("Records", (), {"robot": arm.robot, "joints": arm.joint_names})


@pytest.mark.slow
def test_a_little_at_every_drive_is_a_family(ur5) -> None:
    state = measured(ur5, dict.fromkeys(ur5[0].joint_names, 2e-3))
    after = with_families(state, state.looked.best)
    assert after is not None
    (unit,) = after.units
    assert {after.effects[i].effect.law for i in unit} == {ENCODER_ECCENTRICITY} and len(unit) == len(after.steps) == 6
    proof = after.steps[unit[0]].proof
    assert proof.after < 0.9 * proof.before and proof.after == pytest.approx(np.sqrt(3.0) * SIGMA, rel=0.05)


def test_noise_is_no_family(ur5) -> None:
    assert with_families(measured(ur5, {}), None) is None


@pytest.mark.slow
def test_what_several_causes_leave_is_no_family(tmp_path) -> None:
    """A drive's scale, a pull and a drift: bending at every drive explains much of them, and each by itself more."""
    truth = draw("4 effects", 9101, "six").write(tmp_path)
    arm = load_arm(truth.arm)
    state = begin(calibrate(arm, read_measurements(truth.train, arm), as_stated=True))
    for law, axis in (("tip_force", None), ("base_drift", "rz")):
        named = [one for one in state.looked.ranking if one.candidate.law.name == law]
        state = add(state, next(one for one in named if one.candidate.location.axis == axis))
    assert with_families(state, state.looked.best) is None


@pytest.mark.slow
def test_much_at_one_drive_is_no_family(ur5) -> None:
    """The effect by itself is worth more than the same at every drive: it is left to be named."""
    state = measured(ur5, {"shoulder_lift_joint": 4e-3})
    assert state.looked.best.candidate.location.place == "shoulder_lift_joint"
    assert with_families(state, state.looked.best) is None
