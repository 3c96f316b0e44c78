"""A simulated arm with three parallel axes, calibrated and traced: what is told apart, and what is not."""

from dataclasses import replace

import numpy as np
import pytest
from support import six_axes

from armflex import calibrate, trace
from armflex.cli.trace_command import print_trace
from armflex.errors import ConvergenceError
from armflex.estimate.calibrate import Calibration
from armflex.estimate.fit import Effort, fit

NOISE = np.sqrt(3.0) * six_axes.SIGMA


@pytest.fixture(scope="module")
def calibrated() -> Calibration:
    return calibrate(*six_axes.campaign(200))


def test_poses_held_out_are_predicted_to_the_noise(calibrated: Calibration) -> None:
    assert calibrated.held_out is not None
    assert calibrated.held_out[0] > 3.0 * NOISE and calibrated.held_out[1] < 1.1 * NOISE


def test_what_only_a_combination_tells_is_marked(calibrated: Calibration) -> None:
    """Axes 2, 3 and 4 are parallel: shifts along them add up, and each by itself is told by its prior alone."""
    found, axes = {one.name: one for one in calibrated.parameters}, ("shoulder_lift", "elbow", "wrist_1")
    along = [found[f"geometry {joint}_joint dy"] for joint in axes]
    assert all(one.determined and one.combined for one in along)
    assert all({other.name for other in along} - {one.name} <= set(one.trades_against) for one in along)
    assert found["geometry elbow_joint dz"].determined and not found["geometry elbow_joint dz"].combined
    names = {one["name"] for one in calibrated.content()["parameters"] if one["only_combined_with"]}
    assert names >= {one.name for one in along}


def test_a_fit_that_does_not_settle_names_what_resists(calibrated: Calibration) -> None:
    short = Effort(2, 0.0, content=False)
    with pytest.raises(ConvergenceError, match=r"still moving: geometry .* left is at .*campaign.csv:\d+"):
        fit(calibrated.fit.declared, calibrated.fit.blocks, calibrated.measurements, effort=short)


@pytest.mark.slow
def test_poses_too_few_to_name_an_effect_are_said_to_be(capsys: pytest.CaptureFixture) -> None:
    arm, measurements = six_axes.campaign(6)
    stiff = replace(arm, prior=replace(arm.prior, joint_offset=1e-5, geometry=0.0))
    found = trace(stiff, replace(measurements, q=measurements.q + 5e-3 * np.sin(3.0 * measurements.q)))
    assert not found.found and found.undecided is not None
    assert found.undecided.poses == 6 and found.undecided.rms > 3.0 * found.undecided.stated
    print_trace(found)
    said = capsys.readouterr().out
    assert f"cannot decide what is missing: {1e3 * found.undecided.rms:.3g} mm RMS" in said
    assert "No further effect" not in said
