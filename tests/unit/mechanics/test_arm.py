"""Arms and results as things to hold: copied, sent to other processes, printed, shared."""

import copy
import pickle
import threading
from pathlib import Path

import numpy as np
import pytest
from support.small_arms import joint, link, robot, write

from armflex import Arm, Payload, Wrench, check, load_arm
from armflex.errors import (
    ConvergenceError,
    FileError,
    Place,
    SmallDisplacementError,
    UnknownNameError,
    UnreachableError,
    UnstableEquilibriumError,
)
from armflex.mechanics.response import respond

SPRUNG = 'link = "base"\nat = [0.0, 0.0, -0.3]\nto = "boom"\nat_to = [0.6, 0.0, 0.0]\n'
Q = np.array([2.0, 0.3, 0.1, 0.5, -0.4, 0.2, 0.6])


ONE = {
    "turning": ("revolute", ""),
    "sliding": ("prismatic", ""),
    "compliant": ("revolute", '[flexure.j]\njoint = "j"\njoint_stiffness = 1e5\nrelative_std = 0.1\n'),
    "sprung": ("revolute", f"[spring.s]\n{SPRUNG}rate = 100.0\nfree_length = 0.5\n"),
    "on a cylinder": ("revolute", f"[joint.j]\npassive = true\n[cylinder.c]\n{SPRUNG}lower = 0.5\nupper = 1.1\n"),
}
"""Arms of one joint, of whose one velocity Pinocchio's Jacobians have one dimension."""


@pytest.mark.parametrize("name", ONE)
def test_an_arm_may_have_one_joint(name: str, tmp_path: Path) -> None:
    kind, more = ONE[name]
    moved = joint("j", "base", "boom", (0.0, 0.0, 0.3), axis=(0.0, 1.0, 0.0), kind=kind)
    end = joint("end", "boom", "tool", (1.0, 0.2, 0.1), kind="fixed")
    write(tmp_path, robot(link("base"), link("boom", 4.0, (0.5, 0.0, 0.0), 0.2), link("tool"), moved, end))
    head = '[robot]\nurdf = "robot.urdf"\ntip = "tool"\ngravity = [0.0, 0.0, -9.81]\n'
    arm = load_arm(write(tmp_path, head + more, "arm.toml"))
    q, step = np.array([0.85 if name == "on a cylinder" else 0.1]), 1e-5
    found, batch = arm.deflection(q), arm.deflection(q[None])
    moves = [arm.deflection(q + sign * step).pose.translation for sign in (1.0, -1.0)]
    for jacobian in (found.total_jacobian, batch.total_jacobian[0]):
        assert jacobian.shape == (6, 1)
        np.testing.assert_allclose(jacobian[:3, 0], (moves[0] - moves[1]) / (2.0 * step), rtol=0, atol=1e-8)
    assert found.joint_jacobian.shape == (6, 1) and found.flexure_jacobian.shape == (6, 6 * len(arm.flexures))
    assert found.contributions.shape == (len(arm.flexures), 6) and found.compliance.shape == (6, 6)
    line = respond(arm, q[None], ["none"])
    np.testing.assert_allclose(line.joints[0], found.total_jacobian, rtol=0, atol=1e-9)
    assert line.gravity.shape == (1, 6, 3)


@pytest.mark.parametrize("name", ["q", "v", "a"])
def test_a_buffer_used_again_changes_no_result(tarm, name):
    given = {"q": Q.copy(), "v": 0.1 * Q, "a": 0.2 * Q}
    expected = tarm.deflection(Q, "p600", v=0.1 * Q, a=0.2 * Q)
    found = tarm.deflection(given["q"], "p600", v=given["v"], a=given["a"])
    given[name][:] = 0.0
    for what in ("q", "covariance", "compliance", "tangent", "total_jacobian", "joint_loads"):
        np.testing.assert_array_equal(getattr(found, what), getattr(expected, what), err_msg=what)


def test_a_batch_keeps_its_own_positions(tarm):
    rows = np.tile(Q, (2, 1))
    found = tarm.deflection(rows, "p600")
    rows[:] = 0.0
    np.testing.assert_array_equal(found.q, np.tile(Q, (2, 1)))


def test_a_displacement_cannot_be_overwritten(tarm):
    with pytest.raises(ValueError, match="read-only"):
        tarm.deflection(Q).displacement[0] = 9.0


@pytest.mark.parametrize("again", [copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing))])
def test_a_used_arm_and_its_results_can_be_sent_away(tarm, again):
    found = tarm.deflection(Q, "p600")
    other, result = again(tarm), again(found)
    np.testing.assert_array_equal(other.deflection(Q, "p600").displacement, found.displacement)
    np.testing.assert_array_equal(result.covariance, found.covariance)


@pytest.mark.parametrize(
    "error",
    [
        FileError(Place("arm.toml", 3), "bad"),
        UnknownNameError("joint", "A9", ["A1"]),
        ConvergenceError("no", [1.0, 2.0]),
        UnstableEquilibriumError("buckles", -1.0),
        SmallDisplacementError("turns", [1.0]),
        UnreachableError("far", "report"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_survive_the_way_between_processes(error):
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error) and str(again) == str(error) and again.__dict__ == error.__dict__


def test_printing_is_short(tarm):
    texts = [repr(tarm), repr(tarm.deflection(Q, "p600")), repr(tarm.deflection(Q[None], "p600"))]
    assert all(len(text) < 160 and "\n" not in text for text in texts)
    assert "600 kg" in texts[1] and "1 rows" in texts[2]


def test_an_arms_doubts_come_with_every_result(tarm, tarm_path):
    import dataclasses

    from armflex.errors import Flag

    flagged = dataclasses.replace(tarm, flags=(Flag("gravity", "upside down"),))
    assert "gravity" in [flag.code for flag in flagged.deflection(Q).flags]
    assert "gravity" in [flag.code for flag in flagged.deflection(Q[None]).flags]
    assert [flag.text for flag in check(flagged, tarm_path, 1.0).flags if flag.code == "gravity"] == ["upside down"]


def test_a_load_that_follows_its_link_is_flagged(tarm):
    load = np.array([0.0, 0.0, -100.0])
    dead, following = (Wrench("tool", load, np.zeros(3), axes) for axes in ("base", "frame"))
    assert not tarm.deflection(Q, wrenches=[dead]).flags
    assert [flag.code for flag in tarm.deflection(Q, wrenches=[following]).flags] == ["follower_load"]


def test_drive_shares_by_hand(tarm):
    found = tarm.deflection(np.zeros(7), "p600")
    assert found.drive_shares[2] == pytest.approx(abs(found.joint_loads[2, 4]) / 250e3)
    assert found.drive_shares[0] == pytest.approx(abs(found.joint_loads[0, 2]) / 150e3)


@pytest.mark.slow
def test_many_payloads_from_many_threads(tarm):
    masses = np.linspace(1.0, 600.0, 150)
    expected = [tarm.deflection(Q, Payload(mass, np.zeros(3))).displacement for mass in masses]
    fresh, wrong = load_arm(tarm.robot.urdf.path.parent / "arm.toml"), []

    def ask(arm: Arm) -> None:
        for mass, displacement in zip(masses, expected, strict=True):
            if not np.array_equal(arm.deflection(Q, Payload(mass, np.zeros(3))).displacement, displacement):
                wrong.append(mass)

    threads = [threading.Thread(target=ask, args=(fresh,)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong and len(fresh._carried) <= 64
