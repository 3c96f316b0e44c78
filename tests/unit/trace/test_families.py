"""What drives have in common: found where all have a little of it, not where one has much, nor where none has any."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.public_campaigns import public

from armflex import calibrate, predict, trace
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from armflex.trace.findings import Trace

SIGMA = 1e-4


@pytest.fixture(scope="module")
def ur5():
    """Return the public UR5 as declared, as calibrated, and every third of its poses."""
    arm, measurements = public("ur5_tsinghua")
    some = measurements.some(np.arange(0, len(measurements), 3))
    return arm, calibrate(arm, some).arm, some


def measured(ur5, amplitudes: dict[str, float]) -> Trace:
    """Return the trace of readings of the UR5 with eccentric encoders [rad], each turned its own way."""
    arm, calibrated, rows = ur5
    rng, effects = np.random.default_rng(3), []
    for joint in arm.robot.moving:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        location = next(one for one in ENCODER_ECCENTRICITY.places(_records(joint, arm)) if one.site == joint.name)
        size = amplitudes.get(joint.name, 0.0)
        effects.append(Effect(ENCODER_ECCENTRICITY, location, (size * np.cos(angle), size * np.sin(angle))))
    true = replace(calibrated, effects=tuple(one for one in effects if any(one.values)), certainty=None)
    position = predict(true, rows).position + rng.normal(0.0, SIGMA, rows.position.shape)
    return trace(arm, replace(rows, position=position))


def _records(joint, arm):
    return type("Records", (), {"robot": arm.robot, "joints": arm.joint_names})


@pytest.mark.slow
def test_a_little_at_every_drive_is_a_family(ur5) -> None:
    found = measured(ur5, dict.fromkeys(ur5[0].joint_names, 2e-3))
    assert [family.members[0][0].law for family in found.at_every_drive] == [ENCODER_ECCENTRICITY]
    assert len(found.at_every_drive[0].members) == 6
    proof = found.at_every_drive[0].proof
    assert proof.after < 0.9 * proof.before and proof.after == pytest.approx(np.sqrt(3.0) * SIGMA, rel=0.05)


@pytest.mark.slow
def test_noise_is_no_family(ur5) -> None:
    assert not measured(ur5, {}).at_every_drive


@pytest.mark.slow
def test_much_at_one_drive_is_no_family(ur5) -> None:
    """The effect by itself is worth more than the same at every drive: it is named."""
    found = measured(ur5, {"shoulder_lift_joint": 4e-3})
    assert not found.at_every_drive
    assert "encoder eccentricity at shoulder_lift_joint (ry)" in [one.effect.title for one in found.found]
