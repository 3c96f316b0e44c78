"""The compiled engine's linear response against Pinocchio's, on arms of every shape; its derivation shares nothing."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import block_diag
from support.arms import bundled, corrected, crooked, positions
from support.every_law import KNOWN, effects, laws_of
from support.small_arms import random_compliance, standing, three_joints

from armflex import Arm, Payload, Wrench
from armflex.errors import UnstableEquilibriumError
from armflex.laws import LinearLaw
from armflex.mechanics.response import Response, respond

NEAR = 1e-11
"""Of the largest of its kind."""


def assert_close(found: np.ndarray, expected: np.ndarray, near: float = NEAR) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=near * np.abs(expected).max(initial=1e-300))


def pinocchios(twist: np.ndarray) -> np.ndarray:
    return pin.Jexp6(pin.Motion(twist))


def by_series(twist: np.ndarray) -> np.ndarray:
    """Return the (6, 6) body motion per change of a twist."""
    turning, found = np.kron(np.eye(2), pin.skew(twist[3:])), np.eye(6)
    turning[:3, 3:] = pin.skew(twist[:3])
    for k in range(20, 0, -1):
        found = np.eye(6) - turning @ found / (k + 1)
    return found


def assert_like_pinocchio(arm: Arm, q: np.ndarray, payloads: list, found: Response, known=None, near=NEAR) -> None:
    """Compare with the tangent, the Jacobians and the compliance of each row by itself."""
    known = known or {}
    for i, row in enumerate(q):
        given = {name: values if np.ndim(values) == 0 else values[i] for name, values in known.items()}
        one = arm.deflection(row, payloads[i], covariates=given, enforce_limits=False)
        n = len(arm.flexure_names)
        # Pinocchio's own derivative of exp6 is off by up to 7e-9 about a milliradian: the exact one in its place.
        pinocchio, exact = (block_diag(*(of(twist) for twist in one.twists)) for of in (pinocchios, by_series))
        turned = np.linalg.solve(pinocchio, exact)
        tangent = np.eye(6 * n) + (one.tangent - np.eye(6 * n)) @ turned
        by_law = np.linalg.solve(tangent.T, (one.flexure_jacobian @ turned).T).T
        stack, loads = arm.stack, one.wrenches.ravel()
        by_load = by_law @ stack.tangent(loads, one._row)
        tip = one._mechanics.tip_jacobian(one._configuration)[:, one._mechanics.flex.flexure_v]
        stiffness = one._mechanics.stiffness(one._configuration, one.solved.case)
        by_joint = stiffness[np.ix_(one._mechanics.flex.flexure_v, one._mechanics.flex.v_index)]
        np.testing.assert_allclose(found.tip[i], one.pose.homogeneous, rtol=0, atol=1e-12)
        # A stiff arm's twists are right to the rounding of rotations of order 1, some tens of operations of it.
        near_twists = max(NEAR * np.abs(one.twists).max(), 32.0 * np.finfo(float).eps)
        np.testing.assert_allclose(found.flexure_twists[i], one.twists.ravel(), rtol=0, atol=near_twists)
        assert_close(found.flexure_wrenches[i], one.wrenches)
        assert_close(found.laws[i].reshape(6, 6 * n), by_law, near)
        assert_close(found.link_loads[i, found.link_names.index(arm.robot.tip)], by_load @ tip.T, near)
        assert_close(found.joints[i], one.joint_jacobian - by_load @ by_joint, near)


@pytest.mark.parametrize(("name", "payload"), [("tarm_like", "p600"), ("heavy_six", "p200"), ("tarm_like", "none")])
def test_the_bundled_arms(name, payload):
    for arm in (bundled(name), corrected(bundled(name))):
        q = positions(arm, 4)
        assert_like_pinocchio(arm, q, [payload] * 4, respond(arm, q, [payload] * 4))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["effects", "effects on structures", "structural"])
def test_curved_laws_and_pulls(tmp_path, kind):
    """Tangents of effects are differences, whose rounding both engines see otherwise."""
    arm = replace(three_joints(tmp_path, laws_of(kind)), effects=effects())
    q = positions(bundled("heavy_six"), 9)[:, :3]
    found = respond(arm, q, ["none"] * 9, KNOWN)
    assert_like_pinocchio(arm, q, ["none"] * 9, found, KNOWN, 1e-6)


def test_a_row_that_is_soft_but_stays(tmp_path):
    """Where neither steps nor the tangent's size prove anything, Pinocchio's engine solves and judges the row."""
    arm = three_joints(tmp_path, [random_compliance(i, 60.0) for i in range(3)])
    q = positions(arm, 12)
    turns = [arm.deflection(row, allow_large=True).twists[:, 3:] for row in q]
    q = q[[np.linalg.norm(turn, axis=1).max() < 0.1 for turn in turns]]
    assert len(q)
    assert_like_pinocchio(arm, q, ["none"] * len(q), respond(arm, q, ["none"] * len(q)))


def test_no_unit_of_length_makes_a_row_soft(monkeypatch):
    """A turn of it gives many metres at a mount that is soft across the load: in a longer unit the tangent is near."""
    arm, soft = bundled("tarm_like"), LinearLaw(np.diag([1e-4, 1e-4, *[1e-9] * 4]))
    arm = replace(arm, flexures=(replace(arm.flexures[0], law=soft), *arm.flexures[1:]))
    q = positions(arm, 300)
    with monkeypatch.context() as patched:
        patched.setattr("armflex.mechanics.response.find_equilibrium", None)  # no row is left to it
        found = respond(arm, q, ["p600"] * len(q)).some(np.arange(4))
    assert np.linalg.norm(arm.deflection(q[0], "p600").tangent - np.eye(6 * len(arm.flexures))) > 5.0
    assert_like_pinocchio(arm, q[:4], ["p600"] * 4, found)


def test_rows_without_an_answer_are_refused(tmp_path):
    arm = standing(tmp_path, 0.1, 1.0)
    with pytest.raises(UnstableEquilibriumError, match="buckles"):
        respond(arm, np.zeros((2, 1)), ["none"] * 2)


def test_no_rows():
    found = respond(bundled("heavy_six"), np.zeros((0, 6)), [])
    assert found.tip.shape == (0, 4, 4) and found.laws.shape == (0, 6, 6, 6) and found.twists.shape[0] == 0


def test_a_dead_force_is_a_weight(tmp_path):
    """A force at a payload's centre of mass gives what the payload's weight gives."""
    arm = three_joints(tmp_path, [random_compliance(i) for i in range(3)])
    q, body = positions(arm, 4), Payload(30.0, [0.0, 0.0, 0.0])
    force = Wrench("tool", 30.0 * arm.robot.gravity, [0.0, 0.0, 0.0])
    pushed, carried = arm.deflection(q, wrenches=[force]), arm.deflection(q, body)
    np.testing.assert_allclose(pushed.displacement, carried.displacement, rtol=0, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["heavy_six", "crooked"])
def test_any_link_is_asked_as_the_tip_is(tmp_path, name):
    """Of every link: its motion by joints, gravity and a wrench elsewhere against differences of its pose."""
    law = [LinearLaw(random_compliance(i, 2.0)) for i in range(3)]
    where = {"foot": (None, law[0]), "roll": ("roll", law[1]), "end": ("slide", law[2], True)}
    arm = corrected(bundled(name) if name == "heavy_six" else crooked(tmp_path, where))
    q, load, step = positions(arm, 2), [Payload(15.0, [0.2, 0.1, 0.0])] * 2, 1e-5

    def poses(joints: np.ndarray = q, asked: Arm = arm) -> np.ndarray:
        return respond(asked, joints, load).links

    def assert_differs(after: np.ndarray, before: np.ndarray, expected: np.ndarray) -> None:
        moved = (after[:, :3, 3] - before[:, :3, 3]) / (2.0 * step)
        turned = [
            pin.log3(new @ old.T) / (2.0 * step) for new, old in zip(after[:, :3, :3], before[:, :3, :3], strict=True)
        ]
        np.testing.assert_allclose(np.hstack([moved, turned]), expected, atol=2e-6 * max(1.0, np.abs(expected).max()))

    found = respond(arm, q, load)
    assert_close(found.of(arm.robot.tip).laws, found.laws)
    robots = [
        replace(arm.robot, gravity=arm.robot.gravity + sign * step * np.array([0.3, 1.0, 0.2])) for sign in (-1, 1)
    ]
    below, above = (poses(asked=replace(arm, robot=robot)) for robot in robots)
    joints = [(poses(q - step * unit), poses(q + step * unit)) for unit in np.eye(len(arm.joint_names))]
    for place, link in enumerate(found.link_names):
        own = found.of(link)
        np.testing.assert_array_equal(own.tip, found.links[:, place])
        assert_differs(above[:, place], below[:, place], own.gravity @ [0.3, 1.0, 0.2])
        for number, (before, after) in enumerate(joints):
            assert_differs(after[:, place], before[:, place], own.joints[:, :, number])
        for some in ([1, 0], [1]):
            np.testing.assert_array_equal(found.some(np.array(some)).of(link).laws, own.laws[some])
        for number, joint in enumerate(arm.robot.moving):
            first = 0 if joint.kind == "prismatic" else 3
            along = own.site(f"link:{joint.name}")[:, :, first : first + 3] @ joint.axis
            assert_close(along, own.joints[:, :, number], 1e-9)
        # What a wrench at one link does to another is what one there does to the first (Maxwell 1864), where twists
        # are small: a law between a wrench in flexed axes and exponential coordinates has no potential.
        tip = found.link_names.index(arm.robot.tip)
        assert_close(own.link_loads[:, tip], np.swapaxes(found.link_loads[:, place], 1, 2), 0.05)


@pytest.mark.parametrize("name", ["heavy_six", "palletizer"])
def test_what_is_asked_together_is_what_is_asked_alone(name):
    """With rows of two payloads in turn, which do not follow each other."""
    arm = bundled(name)
    q = np.tile(arm.position(), (4, 1)) if arm.loaded(None).tied else positions(arm, 4)
    bodies = [Payload(15.0, [0.2, 0.1, 0.0]), "none"] * 2
    together = respond(arm, q, bodies, ask=("joints", "twists", "link_loads", "wrenches", "links"))
    alone = respond(arm, q, bodies)
    for member in ("links", "wrenches", "laws", "joints", "twists", "link_loads"):
        assert_close(getattr(together, member), getattr(alone, member), 1e-12)
    assert_close(together.per_load[1:2], respond(arm, q[1:2], ["none"], ask=("per_load",)).per_load, 1e-12)
