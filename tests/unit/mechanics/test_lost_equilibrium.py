"""Rows 33 to 35 of the table of bad inputs: equilibria that are not found, do not stand, or are too far away."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from support.small_arms import one_joint, random_compliance, three_joints
from support.two_links import codes

from armflex import Arm, Wrench
from armflex.errors import ConvergenceError, SmallDisplacementError, UnstableEquilibriumError

# Rows 33 and 34: one joint, k theta = +-m g h sin(theta0 + theta); fixed points say nothing about stability.

MASS, GRAVITY, HEIGHT = 2.0, 9.81, 0.4


def pendulum(folder: Path, ratio: float, upright: bool) -> Arm:
    """Return one joint whose compliance is such that m g h / k = ratio."""
    compliance = np.zeros((6, 6))
    compliance[4, 4] = ratio / (MASS * GRAVITY * HEIGHT)
    com = (0, 0, HEIGHT if upright else -HEIGHT)
    return one_joint(folder, compliance, com, MASS, com)


def root(ratio: float, start: float, upright: bool) -> float:
    sign = 1.0 if upright else -1.0
    return brentq(lambda angle: angle - sign * ratio * np.sin(start + angle), -0.3, 0.3, xtol=1e-15)


@pytest.mark.parametrize("ratio", [1.05, 2.0])
def test_row33_hanging_where_a_fixed_point_never_converges_newton_does(tmp_path, ratio):
    arm, start = pendulum(tmp_path, ratio, upright=False), 0.1
    result = arm.deflection([start])
    assert result.method == "newton"
    assert result.twists[0] == pytest.approx([0, 0, 0, 0, root(ratio, start, False), 0], abs=1e-13)
    assert len(result.residuals) <= 5


@pytest.mark.parametrize("start", [0.0, 0.02])
def test_row34_upright_at_half_the_critical_load_stands(tmp_path, start):
    result = pendulum(tmp_path, 0.5, upright=True).deflection([start])
    # The residual is below 1e-12 and the tangent 0.5, so the twist is right to 2e-12.
    assert result.twists[0] == pytest.approx([0, 0, 0, 0, root(0.5, start, True), 0], abs=2e-12)
    assert np.linalg.eigvals(result.tangent).real.min() == pytest.approx(1 - 0.5 * np.cos(start + result.twists[0, 4]))


@pytest.mark.parametrize("method", ["newton", "exact"])
@pytest.mark.parametrize("ratio", [1.05, 2.0])
def test_row34_upright_beyond_the_critical_load_buckles(tmp_path, ratio, method):
    with pytest.raises(UnstableEquilibriumError, match="buckles") as caught:
        pendulum(tmp_path, ratio, upright=True).deflection([0.0], method=method)
    assert caught.value.eigenvalue == pytest.approx(1.0 - ratio, abs=1e-9)


@pytest.mark.parametrize("method", ["exact", "newton"])
@pytest.mark.parametrize("ratio", [0.3, 0.6, 0.9, 0.999])
def test_the_distance_to_buckling_is_stated(tmp_path, ratio, method):
    """One spring under m g h: it buckles under k / (m g h) times the load, and gives 1 / (1 - m g h / k) as much."""
    arm, near = pendulum(tmp_path, ratio, upright=True), ratio > 0.5
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        one, many = (arm.deflection(q, method=method) for q in ([1e-6], [[1e-6], [2e-6]]))
    assert one.load_factor == pytest.approx(1.0 / ratio, rel=2e-6)
    assert many.load_factor == pytest.approx(np.full(2, 1.0 / ratio), rel=1e-5)
    for found in (one, many, many.row(0)):
        assert ("near_buckling" in codes(found)) == near
    assert [str(one.message).split(":")[0] for one in said] == ["near_buckling"] * (2 * near)
    assert one.to_dict()["load_factor"] == one.load_factor
    if near:
        flag = next(flag for flag in one.flags if flag.code == "near_buckling")
        assert f"buckle under {1.0 / ratio:.4g} times its loads" in flag.text
        assert flag.size == pytest.approx(1.0 / (1.0 - ratio), rel=3e-3)
        assert one.twists[0, 4] / (ratio * np.sin(1e-6)) == pytest.approx(flag.size, rel=3e-3)


def test_what_loads_stiffen_never_buckles(tmp_path):
    assert pendulum(tmp_path, 2.0, upright=False).deflection([0.0]).load_factor == np.inf


@pytest.mark.parametrize("start", [0.001, 0.02])
def test_row34_upright_and_leaning_beyond_the_critical_load(tmp_path, start):
    """Newton may find the unstable root or the one that has fallen over: neither is an answer."""
    with pytest.raises((UnstableEquilibriumError, SmallDisplacementError, ConvergenceError)):
        pendulum(tmp_path, 2.0, upright=True).deflection([start])


def test_rows33_and_34_exactly_at_the_critical_load(tmp_path):
    """Numbers that are exact in binary: the tangent is zero, so nothing holds the arm, nor is there a Newton step."""
    compliance = np.zeros((6, 6))
    compliance[4, 4] = 1.0 / 8.0
    arm = one_joint(tmp_path, compliance, (0, 0, 1), 1.0, (0, 0, 1), gravity=np.array([0.0, 0.0, -8.0]))
    with pytest.raises(UnstableEquilibriumError) as caught:
        arm.deflection([0.0])
    assert caught.value.eigenvalue == 0.0
    with pytest.raises(ConvergenceError, match="singular"):
        arm.deflection([0.0], wrenches=[Wrench("tool", [2.0**-30, 0, 0], [0, 0, 0])])


def test_row33_numbers_that_overflow_do_not_converge(tmp_path):
    arm = three_joints(tmp_path, [random_compliance(1) * 1e290] * 3)
    with pytest.raises(ConvergenceError) as caught:
        arm.deflection(np.zeros(3))
    assert caught.value.history  # how far it comes depends on how the processor adds


# Row 35: small displacements.


def test_row35_a_flexure_turning_by_over_a_tenth_radian(tmp_path):
    arm, start = pendulum(tmp_path, 2.0, upright=False), 0.3
    with pytest.raises(SmallDisplacementError, match=r"flexure 'j' turns by 0\.2") as caught:
        arm.deflection([start])
    assert np.shape(caught.value.twists) == (1, 6)
    result = arm.deflection([start], allow_large=True)
    assert result.twists[0, 4] == pytest.approx(root(2.0, start, False), abs=1e-13)


@pytest.mark.parametrize("method", ["exact", "newton"])
def test_row35_for_every_method(tmp_path, method):
    with pytest.raises(SmallDisplacementError):
        pendulum(tmp_path, 0.5, upright=False).deflection([0.5], method=method)


@pytest.mark.slow
def test_row35_sag_beyond_a_tenth_of_the_reach_is_flagged(tmp_path):
    soft, stiff = ([np.diag([c, c, c, 0, 0, 0])] * 3 for c in (1e-4, 1e-6))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert three_joints(tmp_path, stiff).deflection(np.zeros(3)).flags == ()
        result = three_joints(tmp_path, soft).deflection(np.zeros(3))
    assert (
        codes(result) == ["large_sag"] and np.linalg.norm(result.displacement[:3]) > 0.1 * 2.0
    )  # m, about the length of the chain
