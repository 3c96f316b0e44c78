"""Conventions with a number in them, such as units and couplings of joint columns, are named with what they leave."""

import re
from dataclasses import replace

import numpy as np
import pytest
from support.misread_campaigns import ur5

from armflex import calibrate
from armflex.arm import Arm
from armflex.errors import ConventionError
from armflex.estimate.misread import check_conventions
from armflex.measured.measurements import Measurements

UNITS = {
    "centidegrees": (18000.0 / np.pi, 0.0),
    "gradians": (200.0 / np.pi, 0.0),
    "turns": (0.5 / np.pi, 0.0),
    "arcminutes": (10800.0 / np.pi, 0.0),
    "ticks, 4096 a turn, with zero at 2048": (2048.0 / np.pi, 2048.0),
}


@pytest.fixture(scope="module")
def campaign() -> tuple[Arm, Measurements]:
    """A UR5 of three joints that matter for the tip's place, and one session of it."""
    arm, rows = ur5(count=60)
    return arm, replace(rows, session=("s",) * len(rows), units={})


def named(arm: Arm, rows: Measurements) -> str:
    with pytest.raises(ConventionError) as caught:
        check_conventions(arm, rows, np.flatnonzero(rows.measured))
    return str(caught.value)


@pytest.mark.parametrize("unit", UNITS)
def test_a_unit_is_estimated_and_named(campaign: tuple[Arm, Measurements], unit: str) -> None:
    arm, rows = campaign
    factor, zero = UNITS[unit]
    assert f"the turning joints are in {unit}" in named(arm, replace(rows, q=factor * rows.q + zero))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_coupling_is_named(campaign: tuple[Arm, Measurements], sign: float) -> None:
    arm, rows = campaign
    one, other = arm.joint_names[1:3]
    q = rows.q - sign * rows.q[:, [1]] * np.eye(6)[2]
    said = named(arm, replace(rows, q=q))
    assert f"q_{other} is counted with q_{one} {'taken off' if sign > 0 else 'added'}" in said


def test_two_couplings_of_a_joint_are_estimated_together(campaign: tuple[Arm, Measurements]) -> None:
    """One coupling alone is estimated at what makes up for the other."""
    arm, rows = campaign
    one, two, three = arm.joint_names[:3]
    said = named(arm, replace(rows, q=rows.q - (0.5 * rows.q[:, [0]] + rows.q[:, [1]]) * np.eye(6)[2]))
    assert f"q_{three} is counted with 0.5 q_{one} taken off" in said
    assert f"q_{three} is counted with q_{two} taken off" in said


@pytest.mark.parametrize("degrees", [30.0, 7.2])
def test_a_home_at_any_angle_is_named(campaign: tuple[Arm, Measurements], degrees: float) -> None:
    arm, rows = campaign
    said = named(arm, replace(rows, q=rows.q - np.radians(degrees) * np.eye(6)[1]))
    found = re.findall(rf"the home position of {arm.joint_names[1]} is ([+-][\d.]+) degrees", said)
    assert float(found[0]) == pytest.approx(degrees, abs=0.15)


def test_a_sign_and_a_home_are_named_together(campaign: tuple[Arm, Measurements]) -> None:
    arm, rows = campaign
    said = named(arm, replace(rows, q=np.pi / 2.0 * np.eye(6)[1] + rows.q * (1.0 - 2.0 * np.eye(6)[1])))
    assert f"the sign of q_{arm.joint_names[1]} is turned and the home position of {arm.joint_names[1]} is +90" in said


def test_what_is_left_has_the_target_placed(campaign: tuple[Arm, Measurements]) -> None:
    """Where the target is on the tool [prior] leaves open: that is no error of the arm."""
    arm, rows = campaign
    said = named(arm, replace(rows, q=rows.q[:, [0, 2, 1, 3, 4, 5]]))
    assert "are exchanged" in said
    assert float(re.findall(r"Then they are ([\d.e-]+) mm off", said)[0]) < 5.0


def test_a_rail_is_named_by_its_column(campaign: tuple[Arm, Measurements]) -> None:
    arm, rows = campaign
    ridden = np.random.default_rng(0).uniform(0.0, 2000.0, len(rows))
    moved = replace(rows, position=rows.position + 1e-3 * np.outer(ridden, [0.6, 0.8, 0.0]), covariates={"E1": ridden})
    assert "column E1 moves the arm by 1 mm per unit" in named(arm, moved)
    noise = replace(rows, covariates={"E1": ridden})
    assert check_conventions(arm, noise, np.flatnonzero(rows.measured)) == ()


def test_what_is_far_beyond_limits_in_no_unit_is_refused_by_its_line(campaign: tuple[Arm, Measurements]) -> None:
    arm, rows = campaign
    q = 1e3 * np.random.default_rng(0).normal(size=rows.q.shape)
    with pytest.raises(ValueError, match=r"q_.* is .* rad \(limits"):
        calibrate(arm, replace(rows, q=q), anyway=True)


def test_what_scatters_a_hundred_times_as_stated_is_refused_in_python_too(campaign: tuple[Arm, Measurements]) -> None:
    """A wrist that is counted from the level moves this tip by little: no convention is named."""
    arm, rows = campaign
    q = rows.q - (rows.q[:, [1]] + rows.q[:, [2]]) * np.eye(6)[3]
    with pytest.raises(ConventionError, match=r"its readings scatter by .* times as much"):
        calibrate(arm, replace(rows, q=q))
    assert calibrate(arm, replace(rows, q=q), anyway=True).scatter > 100.0
