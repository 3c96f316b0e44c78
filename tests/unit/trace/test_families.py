"""What drives have in common: found where all have a little of it, not where one has much, nor where none has any."""

from typing import Any

import numpy as np
import pytest
from support import six_axes

from armflex import load_arm, predict, trace
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.drive_curve import DRIVE_CURVE
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from armflex.laws.effects.location import Location, drive_axis
from armflex.trace.findings import Trace


def eccentric(amplitudes: dict[str, float]) -> list[Effect]:
    """Return eccentric encoders [rad], each turned its own way."""
    arm, rng, effects = six_axes.declared(), np.random.default_rng(3), []
    for joint in arm.robot.moving:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        location = next(one for one in ENCODER_ECCENTRICITY.places(_records(joint, arm)) if one.site == joint.name)
        size = amplitudes.get(joint.name, 0.0)
        effects.append(Effect(ENCODER_ECCENTRICITY, location, (size * np.cos(angle), size * np.sin(angle))))
    return [one for one in effects if any(one.values)]


def measured(amplitudes: dict[str, float], count: int) -> Trace:
    """Return the trace of so many readings of a simulated arm with eccentric encoders [rad]."""
    return trace(*six_axes.campaign(count, effects=eccentric(amplitudes)))


def _records(joint, arm) -> Any:
    return type("Records", (), {"robot": arm.robot, "joints": arm.joint_names})


LITTLE = dict.fromkeys(six_axes.declared().joint_names, 2e-3)


@pytest.fixture(scope="module")
def little() -> Trace:
    return measured(LITTLE, 334)


@pytest.mark.slow
def test_a_little_at_every_drive_is_a_family(little: Trace) -> None:
    assert little.state.background.names == ("eccentricity of the encoders",) and not little.found
    assert {one.law for one in little.arm.effects} == {ENCODER_ECCENTRICITY}
    assert len(little.arm.effects) >= 5  # one drive may show too little of it
    assert little.families is not None and little.families.found[0].name == "eccentricity of the encoders"
    before, after = little.held_out
    assert after < 0.9 * before and after == pytest.approx(np.sqrt(3.0) * six_axes.SIGMA, rel=0.05)


@pytest.mark.slow
def test_a_file_has_what_all_drives_do(little: Trace, tmp_path) -> None:
    again = load_arm(little.write(tmp_path / "traced.toml"))
    _, other = six_axes.campaign(50, seed=2, effects=eccentric(LITTLE))
    np.testing.assert_allclose(predict(again, other).position, predict(little.arm, other).position, atol=1e-9)
    sigma = predict(again, other).sigma
    np.testing.assert_allclose(sigma, predict(little.arm, other).sigma, rtol=1e-3)


@pytest.mark.slow
def test_what_is_stated_of_poses_held_out_is_what_other_poses_get(little: Trace) -> None:
    """Poses held out are of a fit to a fifth fewer rows."""
    _, other = six_axes.campaign(300, seed=1, effects=eccentric(LITTLE))
    error = np.linalg.norm(predict(little.arm, other).position - other.position, axis=1)
    rms = np.sqrt((error**2).mean())
    assert 0.90 * rms < little.held_out[1] < 1.15 * rms  # three standard errors of an RMS of 900 numbers, and more


@pytest.mark.slow
def test_noise_is_no_family() -> None:
    assert not measured({}, 200).state.background.names


@pytest.mark.slow
def test_much_at_one_drive_is_no_family() -> None:
    """The effect by itself is worth more than the same at every drive: it is named."""
    found = measured({"shoulder_lift_joint": 4e-3}, 200)
    assert not found.state.background.names
    assert "encoder eccentricity at shoulder_lift_joint (ry)" in [one.effect.title for one in found.found]


def rough() -> list[Effect]:
    """Return gears whose error over position is a band of waves of 20 to 50 a radian, none of which stands out."""
    rng, effects = np.random.default_rng(5), []
    for joint, low, high in zip(six_axes.declared().robot.moving, six_axes.LOWER, six_axes.UPPER, strict=True):
        waves = np.arange(*(int(rate * (high - low) / np.pi) for rate in (20.0, 50.0)))
        location = Location(joint.name, drive_axis(joint), (f"q_{joint.name}",), tuple(waves.tolist()))
        amplitudes = rng.normal(0.0, 3e-4 / np.sqrt(len(waves)), len(waves))
        curve = Candidate(DRIVE_CURVE, location, (float(low), float(high)))
        effects.append(curve.effect(amplitudes))
    return effects


@pytest.mark.slow
def test_a_band_of_waves_is_a_curve_however_few_poses_there_are() -> None:
    found = trace(*six_axes.campaign(150, effects=rough()))
    assert "curve of the drives" in found.state.background.names
    assert not [one.effect.title for one in found.found if one.probability > 0.5]
