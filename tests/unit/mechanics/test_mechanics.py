"""Deflection against closed forms, finite differences, and the symmetries that any elastic arm has."""

import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.small_arms import (
    ROBOTS,
    arm_of,
    central_difference,
    joint,
    link,
    one_joint,
    random_compliance,
    skew_parts,
    three_joints,
)

from armflex import Arm, Flexure, Payload, Wrench, load_arm
from armflex.laws import LinearFit, LinearLaw
from armflex.laws.law import WithoutParameters
from armflex.mechanics.pinocchio_model import LoadCase, build_model, carrying
from armflex.robot import Corrections, load_robot

G = 9.81
WEIGHTLESS = np.zeros(3)
POSE = np.array([0.4, -0.7, 0.5])
SOFT = 6.0  # times `random_compliance`: about 20 mm of sag, so that geometry counts


@dataclass(frozen=True)
class Prescribed(WithoutParameters):
    """A law that gives the same twist whatever the load."""

    value: np.ndarray

    def twist(self, wrench, row):
        return self.value

    def tangent(self, wrench, row):
        return np.zeros((6, 6))


@pytest.fixture(scope="module")
def crooked(tmp_path_factory) -> Arm:
    return three_joints(tmp_path_factory.mktemp("crooked"), [random_compliance(i, SOFT) for i in range(3)])


@cache
def bundled(name: str) -> Arm:
    return load_arm(ROBOTS / name / "arm.toml")


PAYLOAD = Payload(15.0, [0.2, 0.1, -0.05], [0.4, 0.5, 0.6, 0.0, 0.05, 0.0])


# (a) Signs.


def test_a_weight_on_a_horizontal_link_moves_it_down(tmp_path):
    compliance = np.diag([1e-9, 2e-9, 3e-9, 4e-8, 5e-8, 6e-8])
    result = one_joint(tmp_path, compliance, com=(1, 0, 0), mass=2.0).deflection([0.0])
    assert result.wrenches[0] == pytest.approx([0, 0, -2 * G, 0, 2 * G, 0], abs=1e-4)
    assert result.twists[0] == pytest.approx([0, 0, -3e-9 * 2 * G, 0, 5e-8 * 2 * G, 0], abs=1e-11)
    assert result.displacement[2] == pytest.approx(-(3e-9 + 5e-8) * 2 * G, rel=1e-6)
    assert result.displacement[4] == pytest.approx(5e-8 * 2 * G, rel=1e-6)
    assert result.joint_loads[0] == pytest.approx(result.wrenches[0], abs=1e-4)
    assert result.pose.translation[2] < result.rigid_pose.translation[2]


def test_the_flexure_sits_outboard_of_its_joint(tmp_path):
    """At q = 90 degrees the link hangs, so gravity pulls along the flexure's own x."""
    compliance = np.diag([1e-7, 0, 0, 0, 0, 0])
    result = one_joint(tmp_path, compliance, com=(1, 0, 0), mass=2.0).deflection([np.pi / 2])
    assert result.wrenches[0] == pytest.approx([2 * G, 0, 0, 0, 0, 0], abs=1e-12)
    assert result.displacement == pytest.approx([0, 0, -1e-7 * 2 * G, 0, 0, 0], abs=1e-15)


def test_motion_loads_the_structure_against_its_acceleration(tmp_path):
    """A point mass on a turntable: outwards by v^2 / r, and backwards when it speeds up."""
    parts = [
        link("base"),
        joint("j", "base", "body", axis=(0, 0, 1)),
        link("body", 2.0, (1.5, 0, 0), moment=1e-9),
        joint("flange", "body", "tool", (1.5, 0, 0), kind="fixed"),
        link("tool"),
    ]
    arm = arm_of(tmp_path, parts, "tool", {"j": np.diag([1e-9, 1e-9, 1e-9, 0, 0, 1e-9])}, gravity=WEIGHTLESS)
    result = arm.deflection([0.3], v=[4.0], a=[5.0])
    outward, back = 2.0 * 1.5 * 16.0, 2.0 * 1.5 * 5.0
    assert result.wrenches[0] == pytest.approx([outward, -back, 0, 0, 0, -back * 1.5], rel=1e-6, abs=1e-6)


# (b) One joint, a full compliance, a known wrench: linear theory by hand.


@pytest.mark.parametrize("axes", ["base", "frame"])
@pytest.mark.parametrize("component", range(6))
def test_every_row_of_a_full_compliance(tmp_path, component, axes):
    compliance, lever = random_compliance(3), np.array([0.8, -0.3, 0.5])
    arm = one_joint(tmp_path, compliance, (0.4, 0, 0), tool=lever, gravity=WEIGHTLESS)
    load = np.zeros(6)
    load[component] = 1e-2
    result = arm.deflection([0.0], wrenches=[Wrench("tool", load[:3], load[3:], axes)])
    at_joint = np.concatenate([load[:3], load[3:] + skew_parts(lever) @ load[:3]])
    twist = compliance @ at_joint
    tip = np.concatenate([twist[:3] + skew_parts(twist[3:]) @ lever, twist[3:]])
    np.testing.assert_allclose(result.wrenches[0], at_joint, atol=1e-8)
    np.testing.assert_allclose(result.twists[0], twist, atol=1e-14)
    np.testing.assert_allclose(result.displacement, tip, atol=1e-14)


def test_two_joints_in_series_add_up(tmp_path):
    """A horizontal arm with drives only: rotations k F x lever, sag by both; linear theory by hand."""
    first, second, force = 3e-9, 5e-9, 100.0
    parts = [
        link("base"),
        joint("a", "base", "one"),
        link("one", 1.0, (0.5, 0, 0)),
        joint("b", "one", "two", (1.2, 0, 0)),
        link("two", 1.0, (0.5, 0, 0)),
        joint("flange", "two", "tool", (0.7, 0, 0), kind="fixed"),
        link("tool"),
    ]
    drives = {"a": np.diag([0, 0, 0, 0, first, 0]), "b": np.diag([0, 0, 0, 0, second, 0])}
    arm = arm_of(tmp_path, parts, "tool", drives, gravity=WEIGHTLESS)
    result = arm.deflection([0.0, 0.0], wrenches=[Wrench("tool", [0, 0, -force], [0, 0, 0])])
    expected = [0, 0, -force * (first * 1.9**2 + second * 0.7**2), 0, force * (first * 1.9 + second * 0.7), 0]
    assert result.displacement == pytest.approx(expected, rel=1e-9, abs=1e-11)


def test_the_displacement_is_that_of_the_poses(crooked):
    result = crooked.deflection(POSE, payload=PAYLOAD)
    shift = result.pose.translation - result.rigid_pose.translation
    turned = pin.exp3(result.displacement[3:]) @ result.rigid_pose.rotation
    np.testing.assert_allclose(result.displacement[:3], shift, atol=1e-16)
    np.testing.assert_allclose(turned, result.pose.rotation, atol=1e-14)
    assert np.linalg.norm(shift) > 0.01


# (c) Derivatives against central differences.


def tip_change(after: pin.SE3, before: pin.SE3) -> np.ndarray:
    turn = pin.log3(after.rotation @ before.rotation.T)
    return np.concatenate([after.translation - before.translation, turn])


def pose_derivative(pose_at, at: np.ndarray, step: float) -> np.ndarray:
    """Return the (6, n) derivative of a pose: origin and rotation in base axes."""
    columns = []
    for change in np.eye(len(at)) * step:
        columns.append(tip_change(pose_at(at + change), pose_at(at - change)) / (2.0 * step))
    return np.array(columns).T


def with_laws(arm: Arm, laws) -> Arm:
    return replace(arm, flexures=tuple(replace(f, law=law) for f, law in zip(arm.flexures, laws, strict=True)))


def test_flexure_jacobian(crooked):
    """Also far from straight, where the exponential's own derivative counts."""
    twists = np.random.default_rng(1).normal(size=(3, 6)) * 0.05

    def bent(values: np.ndarray):
        return with_laws(crooked, map(Prescribed, values.reshape(3, 6))).deflection(POSE, allow_large=True)

    expected = pose_derivative(lambda values: bent(values).pose, twists.ravel(), 1e-5)
    np.testing.assert_allclose(bent(twists.ravel()).flexure_jacobian, expected, atol=2e-9)


def test_joint_jacobian(crooked):
    twists = np.random.default_rng(1).normal(size=(3, 6)) * 0.05
    arm = with_laws(crooked, map(Prescribed, twists))
    expected = pose_derivative(lambda q: arm.deflection(q, allow_large=True).pose, POSE, 1e-5)
    np.testing.assert_allclose(arm.deflection(POSE, allow_large=True).joint_jacobian, expected, atol=2e-9)


@pytest.mark.parametrize("case", ["crooked", "tarm_like"])
def test_total_jacobian(crooked, case):
    """The tip per joint with the flexures following; the mast's compliance depends on its extension, too."""
    arm, q, payload = (crooked, POSE, PAYLOAD) if case == "crooked" else (bundled(case), tarm_positions(1)[0], "p600")
    result = arm.deflection(q, payload)
    expected = pose_derivative(lambda at: arm.deflection(at, payload).pose, q, 1e-5)
    np.testing.assert_allclose(result.total_jacobian, expected, atol=1e-8)
    assert np.abs(result.joint_jacobian - expected).max() > 1e-3


@pytest.mark.parametrize("method", ["newton", "exact"])
def test_compliance_of_the_tip(crooked, method):
    """With 20 mm of sag: the arm's weight stiffens or softens it by some 1e-3, which must be there."""

    def loaded(load: np.ndarray):
        wrench = Wrench("tool", load[:3], load[3:])
        return crooked.deflection(POSE, payload=PAYLOAD, wrenches=[wrench], method=method)

    result = loaded(np.zeros(6))
    expected = pose_derivative(lambda load: loaded(load).pose, np.zeros(6), 5.0)
    # From 1e-12 of the solver over 10 N, and the third order of the difference.
    np.testing.assert_allclose(result.compliance, expected, atol=5e-12)
    rigid = with_laws(crooked, [Prescribed(np.zeros(6))] * 3).deflection(POSE, payload=PAYLOAD).flexure_jacobian
    blocks = np.zeros((18, 18))
    for i, flexure in enumerate(crooked.flexures):
        blocks[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = flexure.law.compliance
    assert np.abs(rigid @ blocks @ rigid.T - expected).max() > 1e-9  # linear theory does not pass


DEAD = Wrench("tool", [30.0, -50.0, 20.0], [8.0, 5.0, -9.0])
FOLLOWING = Wrench("fore", [-20.0, 40.0, 60.0], [3.0, -7.0, 4.0], axes="frame")
CASES = {
    "static": LoadCase(POSE),
    "dead": LoadCase(POSE, wrenches=(DEAD,)),
    "following": LoadCase(POSE, wrenches=(FOLLOWING,)),
    "moving": LoadCase(POSE, np.array([0.8, -1.1, 0.6]), np.array([2.0, 3.0, -4.0])),
    "speed-only": LoadCase(POSE, v=np.array([0.8, -1.1, 0.6])),
    "all": LoadCase(POSE, np.array([0.8, -1.1, 0.6]), np.array([2.0, 3.0, -4.0]), (DEAD, FOLLOWING)),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_geometric_stiffness(crooked, case):
    mechanics = crooked.loaded(PAYLOAD).mechanics
    twists = np.zeros(mechanics.model.nv)
    twists[mechanics.flex.flexure_v] = np.random.default_rng(2).normal(size=18) * 0.03
    here, load = mechanics.flexed(mechanics.rigid_configuration(POSE), twists), mechanics.load(case)

    def torque(motion: np.ndarray) -> np.ndarray:
        return load(pin.integrate(mechanics.model, here, motion))

    expected = central_difference(torque, np.zeros(mechanics.model.nv), 1e-5)
    np.testing.assert_allclose(mechanics.stiffness(here, case), expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_tangent(crooked, case):
    """The residual's derivative at the solution, from loads asked one twist at a time by prescribing it."""
    options = {"payload": PAYLOAD, "v": case.v, "a": case.a, "wrenches": case.wrenches, "allow_large": True}
    result = crooked.deflection(POSE, **options)

    def residual(twists: np.ndarray) -> np.ndarray:
        blocks = twists.reshape(3, 6)
        wrenches = with_laws(crooked, map(Prescribed, blocks)).deflection(POSE, **options).wrenches
        given = [flexure.law.compliance @ w for flexure, w in zip(crooked.flexures, wrenches, strict=True)]
        return (blocks - given).ravel()

    assert np.abs(residual(result.twists.ravel())).max() < 1e-12
    expected = central_difference(residual, result.twists.ravel(), 1e-5)
    np.testing.assert_allclose(result.tangent, expected, atol=1e-9)
    assert np.abs(result.tangent - np.eye(18)).max() > 1e-3


# (d) Contributions.


def softer(arm: Arm, factor: float) -> Arm:
    return with_laws(arm, [LinearLaw(flexure.law.compliance * factor) for flexure in arm.flexures])


def test_contributions_add_up_and_the_rest_is_quadratic(crooked):
    results = [softer(crooked, factor).deflection(POSE, payload=PAYLOAD) for factor in (0.01, 0.02, 0.04)]
    for result in results:
        np.testing.assert_allclose(result.contributions.sum(axis=0) + result.remainder, result.displacement, atol=1e-17)
    sizes = [np.linalg.norm(result.remainder) for result in results]
    assert sizes[1] / sizes[0] == pytest.approx(4.0, rel=0.05) and sizes[2] / sizes[1] == pytest.approx(4.0, rel=0.05)
    assert sizes[0] < 1e-3 * np.linalg.norm(results[0].displacement)


def test_what_calibration_corrected_is_no_remainder_of_the_flexures(crooked):
    """A joint that stands off moves the tip where nothing gives; first order has no part in it."""
    joint = crooked.joint_names[1]
    corrections = Corrections({joint: 2e-3}, {joint: np.array([1e-3, 0.0, 2e-3, 0.0, 1e-3, 0.0])})
    off = replace(softer(crooked, 1e-6), corrections=corrections).deflection(POSE, payload=PAYLOAD)
    rigid = replace(crooked, flexures=(), corrections=corrections).deflection(POSE, payload=PAYLOAD)
    np.testing.assert_allclose(off.corrected, rigid.displacement, atol=1e-15)
    assert np.linalg.norm(off.corrected[:3]) > 1e-3
    assert np.linalg.norm(off.remainder) < 1e-3 * np.linalg.norm(off.displacement - off.corrected)
    assert not crooked.deflection(POSE, payload=PAYLOAD).corrected.any()


def test_a_contribution_is_what_the_flexure_does_alone(crooked):
    arm = softer(crooked, 1e-4)
    whole = arm.deflection(POSE, payload=PAYLOAD)
    for i, flexure in enumerate(arm.flexures):
        alone = replace(arm, flexures=(flexure,)).deflection(POSE, payload=PAYLOAD)
        np.testing.assert_allclose(whole.contributions[i], alone.displacement, rtol=1e-3, atol=1e-9)


# (e) Symmetries.


def test_betti_without_weight_the_compliance_is_symmetric(tmp_path):
    arm = three_joints(tmp_path, [random_compliance(i) for i in range(3)], gravity=WEIGHTLESS)
    compliance = arm.deflection(POSE).compliance
    np.testing.assert_allclose(compliance, compliance.T, atol=1e-14 * np.abs(compliance).max())
    assert np.linalg.eigvalsh(compliance).min() > 0.0


def test_betti_is_approached_as_the_sag_shrinks(crooked):
    def skew(factor: float) -> float:
        compliance = softer(crooked, factor).deflection(POSE, payload=PAYLOAD).compliance
        return np.abs(compliance - compliance.T).max() / np.abs(compliance).max()

    assert skew(1e-2) < 1e-4
    assert skew(1e-2) / skew(1e-3) == pytest.approx(10.0, rel=0.1)


def test_zero_load_gives_zero(tmp_path):
    arm = three_joints(tmp_path, [random_compliance(i, 100.0) for i in range(3)], gravity=WEIGHTLESS)
    result = arm.deflection(POSE, payload=PAYLOAD)
    assert not result.twists.any() and not result.wrenches.any()
    np.testing.assert_allclose(result.displacement, np.zeros(6), atol=1e-15)


def test_linear_in_a_small_payload(crooked):
    empty = crooked.deflection(POSE)

    def shift(mass: float) -> np.ndarray:
        return tip_change(crooked.deflection(POSE, payload=Payload(mass, PAYLOAD.com)).pose, empty.pose) / mass

    np.testing.assert_allclose(shift(1e-3), shift(2e-3), rtol=1e-5, atol=1e-9)
    lever, force = empty.pose.rotation @ PAYLOAD.com, np.array([0, 0, -G])
    expected = empty.compliance @ np.concatenate([force, skew_parts(lever) @ force])
    np.testing.assert_allclose(shift(1e-3), expected, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("rpy", [(0.3, -0.4, 1.1), (np.pi, 0, 0), (0, np.pi / 2, 0)], ids=["oblique", "hung", "wall"])
def test_turning_base_and_gravity_together_changes_nothing_but_axes(tmp_path, rpy):
    turn = pin.rpy.rpyToMatrix(*rpy)
    compliances = [random_compliance(i, SOFT) for i in range(3)]
    arm = three_joints(tmp_path, compliances)
    text = (tmp_path / "robot.urdf").read_text()
    mount = joint("mount", "floor", "base", (1, 2, 3), rpy, kind="fixed")
    (tmp_path / "turned.urdf").write_text(text.replace("</robot>", f'<link name="floor"/>{mount}</robot>'))
    robot = load_robot(tmp_path / "turned.urdf", "tool", gravity=turn @ arm.robot.gravity)
    turned = Arm(robot, arm.flexures).deflection(POSE, payload=PAYLOAD)
    rigid = arm.deflection(POSE, payload=PAYLOAD)
    np.testing.assert_allclose(turned.wrenches, rigid.wrenches, atol=1e-9)
    np.testing.assert_allclose(turned.displacement, np.kron(np.eye(2), turn) @ rigid.displacement, atol=1e-13)
    floor = pin.SE3(turn, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(turned.pose.homogeneous, (floor * rigid.pose).homogeneous, atol=1e-13)


def test_gravity_is_in_base_axes_also_when_the_base_is_not_the_root(tmp_path, crooked):
    text = crooked.robot.urdf.path.read_text()
    mount = joint("mount", "floor", "base", (1, 2, 3), (0.3, -0.4, 1.1), kind="fixed")
    (tmp_path / "turned.urdf").write_text(text.replace("</robot>", f'<link name="floor"/>{mount}</robot>'))
    arm = Arm(load_robot(tmp_path / "turned.urdf", "tool", "base"), crooked.flexures)
    assert np.array_equal(arm.deflection(POSE).displacement, crooked.deflection(POSE).displacement)


def test_mirrored_positions_give_mirrored_deflections():
    """tarm_like is symmetric about its x-z plane: yaw and roll change sign, and so do dy, rx and rz."""
    arm = bundled("tarm_like")
    q = arm.position(M1=2.0, A1=0.3, A2=-0.1, A3=0.8, A4=-0.5, A5=1.1, A6=0.4)
    mirror = np.array([1, -1, 1, -1, -1, -1, -1])
    sign = np.array([1, -1, 1, -1, 1, -1])
    plain, mirrored = arm.deflection([q, q * mirror], payload="p600").displacement
    np.testing.assert_allclose(mirrored, plain * sign, atol=1e-13)
    assert np.abs(plain).min() > 1e-5


positions = st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).map(np.array)


@settings(max_examples=25)
@given(positions, st.floats(0.0, 40.0), st.floats(1e-3, 6.0), st.integers(0, 1000))
def test_what_holds_at_every_equilibrium(crooked_robot, q, mass, softness, seed):
    """The law holds at the returned load, what hangs outboard is carried, and no energy is gained."""
    compliances = [random_compliance(seed + i, softness) for i in range(3)]
    arm = Arm(crooked_robot, tuple(Flexure(n, n, LinearLaw(c)) for n, c in zip(JOINTS, compliances, strict=True)))
    result = arm.deflection(q, payload=Payload(mass, [0.1, 0.05, 0.0]))
    for twist, wrench, compliance, outboard in zip(
        result.twists, result.wrenches, compliances, (170.0, 90.0, 30.0), strict=True
    ):
        np.testing.assert_allclose(twist, compliance @ wrench, atol=1e-12)
        assert np.linalg.norm(wrench[:3]) == pytest.approx((outboard + mass) * G, rel=1e-12)
        assert wrench @ twist > 0.0
    steps = arm.deflection(q, payload=Payload(mass, [0.1, 0.05, 0.0]), method="newton").residuals
    assert steps[-1] <= 1e-12 and len(steps) <= 6


JOINTS = ("yaw", "pitch", "roll")


@pytest.fixture(scope="module")
def crooked_robot(crooked):
    return crooked.robot


# (f) Uncertainty.


@pytest.mark.slow
def test_covariance_against_monte_carlo(crooked):
    """Every entry of every compliance off by its own 5 %, but that C_ij = C_ji."""
    std, draws, random = 0.05, 1000, np.random.default_rng(8)
    sure = softer(crooked, 0.1)
    arm = with_laws(sure, [LinearLaw(flexure.law.compliance, std) for flexure in sure.flexures])
    seen = []
    for _ in range(draws):
        errors = std * random.normal(size=(3, 6, 6))
        errors = np.triu(errors) + np.triu(errors, 1).transpose(0, 2, 1)
        laws = [LinearLaw(f.law.compliance * (1 + error)) for f, error in zip(sure.flexures, errors, strict=True)]
        seen.append(with_laws(sure, laws).deflection(POSE, payload=PAYLOAD).displacement)
    sampled, stated = np.cov(np.array(seen).T), arm.deflection(POSE, payload=PAYLOAD).covariance
    size = np.sqrt(np.diag(stated))
    # Standard errors of a sampled variance and correlation: sqrt(2 / n), 1 / sqrt(n); four of them.
    np.testing.assert_allclose(np.diag(sampled) / size**2, np.ones(6), atol=4 * np.sqrt(2 / draws))
    np.testing.assert_allclose((sampled - stated) / np.outer(size, size), np.zeros((6, 6)), atol=4 * np.sqrt(2 / draws))


def test_an_entry_and_its_mirror_image_are_one_number():
    """C_15 = C_51 moves both components it couples, so these are correlated."""
    compliance, draws = np.diag([2.0, 1, 1, 1, 3, 1]), 40000
    compliance[0, 4] = compliance[4, 0] = -1.5
    wrench = np.array([1.0, 0.5, 0, 0, 2.0, 0])
    errors = 0.2 * np.random.default_rng(9).normal(size=(draws, 6, 6))
    errors = np.triu(errors) + np.triu(errors, 1).transpose(0, 2, 1)
    sampled = np.cov(((compliance * (1 + errors)) @ wrench).T)
    stated = LinearLaw(compliance, 0.2).covariance(wrench, None)
    assert stated[0, 4] == pytest.approx(0.2**2 * 1.5**2 * 2.0, rel=1e-12)
    np.testing.assert_allclose(stated, sampled, atol=4 * np.sqrt(2 / draws) * stated.max())


def test_no_covariance_where_no_law_has_one(crooked):
    assert crooked.deflection(POSE).covariance is None and crooked.deflection([POSE]).covariance is None


def test_covariance_of_one_uncertain_drive(tmp_path):
    """By hand: sag k F L^2, so its standard deviation is 20 % of that."""
    law = LinearLaw(np.diag([0, 0, 0, 0, 1e-8, 0]), relative_std=0.2)
    result = one_joint(tmp_path, law, (1, 0, 0), 2.0, (1, 0, 0)).deflection([0.0])
    expected = (0.2 * 1e-8 * 2 * G) ** 2
    assert np.diag(result.covariance) == pytest.approx([0, 0, expected, 0, expected, 0], rel=1e-6, abs=1e-24)


def test_loads_beyond_those_trained_on_are_doubted(tmp_path):
    seen = np.array([[-100.0, -200.0, -10.0], [100.0, 200.0, 10.0]])
    fitted = LinearLaw(np.diag([1e-9] * 3 + [0] * 3), fit=LinearFit(np.zeros((3, 3, 3)), np.zeros(3), seen))
    arm = one_joint(tmp_path, fitted, com=(1, 0, 0))
    mild, strong = np.array([100.0, 0, 10, 9e9, 0, 0]), np.array([0, 250.0, -16300, 0, 0, 0])
    assert [flag.code for flag in arm.stack.flags(mild, None)] == ["does_not_turn"]
    assert arm.stack.flags(np.array([100.0, 0, 10, 0, 0, 0]), None) == ()
    flags = arm.stack.flags(strong, None)
    assert [flag.code for flag in flags] == ["extrapolating"] * 2
    assert flags[0].text.endswith("load fy = 250 N is outside the -200 to 200 N it was trained on")
    assert flags[1].text == "flexure 'j': load fz = -16300 N is outside the -10 to 10 N it was trained on"
    certain = with_laws(arm, [LinearLaw(np.eye(6) * 1e-9, 0.1)])
    assert certain.stack.trained == () and certain.stack.flags(strong, None) == ()


# (g) Methods.


@pytest.mark.parametrize(("name", "payload"), [("tarm_like", "p600"), ("heavy_six", "p200"), ("tarm_like", None)])
def test_exact_equals_newton(name, payload):
    arm = bundled(name)
    q = np.random.default_rng(3).uniform(arm.robot.lower, arm.robot.upper, (5, len(arm.joint_names)))
    exact, slow = arm.deflection(q, payload), arm.deflection(q, payload, method="newton")
    np.testing.assert_allclose(slow.twists, exact.twists, atol=1e-11)
    np.testing.assert_allclose(slow.displacement, exact.displacement, atol=1e-11)


# (h) Batches and threads.


def tarm_positions(count: int) -> np.ndarray:
    arm = bundled("tarm_like")
    return np.random.default_rng(4).uniform(0.5 * arm.robot.lower, 0.5 * arm.robot.upper, (count, 7))


def test_a_batch_is_its_rows():
    arm, q = bundled("tarm_like"), tarm_positions(6)
    payloads = ["none", "p300", "p600", "empty", None, Payload(50.0, [0, 0, 0.1])]
    v, a = 0.02 * np.ones((6, 7)), 0.03 * np.ones((6, 7))
    batch = arm.deflection(q, payloads, v=v, a=a)
    for i in range(6):
        single = arm.deflection(q[i], payloads[i], v=v[i], a=a[i])
        for name in ("displacement", "wrenches", "twists", "contributions", "covariance"):
            assert np.array_equal(getattr(batch, name)[i], getattr(single, name)), name
        np.testing.assert_allclose(batch.pose[i], single.pose.homogeneous, rtol=0, atol=1e-12)
        np.testing.assert_allclose(batch.rigid_pose[i], single.rigid_pose.homogeneous, rtol=0, atol=1e-12)
    assert arm.deflection(np.zeros((0, 7))).displacement.shape == (0, 6)


def test_four_threads_give_the_same_answers():
    """All with one payload, hence one model, each at its own positions."""
    shared, q = load_arm(ROBOTS / "tarm_like" / "arm.toml"), tarm_positions(400).reshape(4, 100, 7)

    def work(rows: np.ndarray) -> list[np.ndarray]:
        results = [shared.deflection(row, "p600") for row in rows]
        return [np.concatenate([r.displacement, r.compliance.ravel(), r.joint_loads.ravel()]) for r in results]

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # between almost any two lines
    try:
        with ThreadPoolExecutor(4) as pool:
            together = list(pool.map(work, q))
    finally:
        sys.setswitchinterval(interval)
    assert np.array_equal(together, list(map(work, q)))


# (i) Loads at the joints of a moving arm.


@pytest.mark.parametrize("name", ["tarm_like", "heavy_six"])
def test_joint_loads_of_a_stiff_arm_are_those_of_rigid_dynamics(name):
    arm = bundled(name)
    stiff = with_laws(arm, [LinearLaw(np.eye(6) * 1e-19)] * len(arm.flexures))
    payload = next(p for p in arm.payloads.values() if p.inertia is not None)
    rigid = carrying(build_model(arm.robot), payload.body, arm.robot.gravity).model
    random = np.random.default_rng(6)
    for _ in range(3):
        q = random.uniform(0.3 * arm.robot.lower, 0.3 * arm.robot.upper)
        v, a = random.normal(size=(2, len(q)))
        result = stiff.deflection(q, payload, v=v, a=a)
        axes = [
            np.concatenate([j.axis * (j.kind == "prismatic"), j.axis * (j.kind != "prismatic")])
            for j in arm.robot.moving
        ]
        held = [-load @ axis for load, axis in zip(result.joint_loads, axes, strict=True)]
        expected = pin.rnea(rigid, rigid.createData(), q, v, a)
        np.testing.assert_allclose(held, expected, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_allclose(result.wrenches, result.joint_loads, rtol=1e-9, atol=1e-6)


def test_the_bundled_arms_load_without_a_doubt():
    for folder in sorted(ROBOTS.iterdir()):
        if (folder / "arm.toml").exists():
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                arm = load_arm(folder / "arm.toml")
            assert arm.deflection(np.clip(0.0, arm.robot.lower, arm.robot.upper)).flags == ()


@pytest.mark.slow
def test_the_sag_that_the_bundled_arm_states():
    """The table in robots/tarm_like/README.md: linear, joints only, straight, with 600 kg [mm]."""
    arm = bundled("tarm_like")
    for extension, expected in ((0.0, -187.0), (3.0, -193.7), (6.0, -200.4)):
        q = arm.position(M1=extension)
        rigid = with_laws(arm, [Prescribed(np.zeros(6))] * 7).deflection(q, "p600")
        at = arm.loaded("p600").row(q, {})
        twists = np.array([one.law.twist(load, at) for one, load in zip(arm.flexures, rigid.wrenches, strict=True)])
        assert 1e3 * (rigid.flexure_jacobian @ twists.ravel())[2] == pytest.approx(expected, abs=0.05)
