"""Joints off the chain that move from row to row: their weight bends the arm as if it were held there."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.command_line import run_here
from support.two_arms import beside, two_arms

from armflex import (
    Arm,
    Wrench,
    calibrate,
    check,
    compensate,
    load_arm,
    predict,
    read_measurements,
    read_trajectory,
    write_trajectory,
)
from armflex.errors import ShapeError, TableError
from armflex.laws.effects import Effect, Location
from armflex.laws.effects.catalogue import EVERY
from armflex.measured.table import write_table
from armflex.mechanics.history import known_rows
from armflex.mechanics.many_rows import Pushes
from armflex.mechanics.response import respond
from armflex.rows.branch import branches
from armflex.rows.wrench import wrenches_in

COUNT = 6
SOFT = {"1e-9": 2.5e-4, "1e-8": 1e-3}
"""Last shift [m/N] of column and shoulder -> how much each turns in their place [rad/Nm]."""


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Arm:
    return two_arms(tmp_path_factory.mktemp("two"))


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> list[Arm]:
    """The arm as many times, each with the other one held where a row has it."""
    folder, at = tmp_path_factory.mktemp("held"), beside(COUNT)
    return [two_arms(folder, {name: float(values[i]) for name, values in at.items()}) for i in range(COUNT)]


def positions(count: int = COUNT) -> np.ndarray:
    """Return (N, 3) positions of the arm that is asked about [rad]."""
    return np.random.default_rng(0).uniform(-1.5, 1.5, (count, 3))


def columns(q: np.ndarray, at: dict[str, np.ndarray]) -> dict[str, list]:
    """Return a table's columns of joint positions, of both arms."""
    own = {f"q_{name}": q[:, i].tolist() for i, name in enumerate(("to_torso", "to_upper", "to_fore"))}
    return own | {f"q_{name}": values.tolist() for name, values in at.items()}


def table(path: Path, q: np.ndarray, at: dict[str, np.ndarray], **more: list) -> Path:
    """Return the path of a trajectory of both arms, or of a campaign."""
    write_table(path, {"time": list(range(len(q))), "payload": ["part"] * len(q), **columns(q, at), **more})
    return path


@pytest.mark.parametrize("method", ["exact", "newton"])
def test_a_branch_weighs_where_a_row_has_it(arm: Arm, held: list[Arm], method: str) -> None:
    q, at = positions(), beside(COUNT)
    hung = branches(arm.robot, at)
    batch, plain = (arm.deflection(q, "part", method=method, wrenches=some) for some in (hung, ()))
    assert np.abs(batch.displacement - plain.displacement)[:, :3].max() > 1e-4
    for i, other in enumerate(held):
        want = other.deflection(q[i], "part", method=method)
        single = branches(arm.robot, {name: values[i] for name, values in at.items()})
        one = arm.deflection(q[i], "part", method=method, wrenches=single)
        np.testing.assert_allclose(one.displacement, want.displacement, rtol=0, atol=1e-14)
        np.testing.assert_allclose(batch.displacement[i], want.displacement, rtol=0, atol=1e-14)
        for found in (one.wrenches, batch.wrenches[i]):
            np.testing.assert_allclose(found, want.wrenches, rtol=0, atol=1e-10)
        np.testing.assert_allclose(one.joint_loads, want.joint_loads, rtol=0, atol=1e-10)
        poses = want.link_poses()
        assert all(np.allclose(pose, poses[link], rtol=0, atol=1e-12) for link, pose in one.link_poses().items())


def test_responses_are_those_of_the_arm_held_there(arm: Arm, held: list[Arm]) -> None:
    q, at = positions(), beside(COUNT)
    line = respond(arm, q, ["part"] * COUNT, wrenches=branches(arm.robot, at))
    for i, other in enumerate(held):
        want = respond(other, q[i : i + 1], ["part"])
        for name in ("tip", "laws", "joints", "twists", "wrenches", "gravity"):
            size = np.abs(getattr(want, name)).max()
            np.testing.assert_allclose(getattr(line, name)[i], getattr(want, name)[0], rtol=0, atol=1e-13 * size)


@pytest.mark.parametrize("pull", ["base", "frame", "branch"])
def test_rows_that_are_linearised_apart_are_under_their_own_loads(tmp_path: Path, pull: str) -> None:
    """The arm is so soft that some rows need the reference solver: only those are asked, and then the others."""
    soft = {f"compliance = [1e-8, 1e-8, {k}": f"compliance = [1e-8, 1e-8, {k}{3 * f', {c}'}]" for k, c in SOFT.items()}
    arm, count, rng = two_arms(tmp_path, instead=soft), 12, np.random.default_rng(0)
    q = rng.uniform(-1.0, 1.0, (count, 3))
    force = np.where(np.arange(count)[:, None] % 3 == 0, 500.0, 50.0) * rng.normal(size=(count, 3))
    loads = branches(arm.robot, beside(count)) if pull == "branch" else (Wrench("tool", force, np.zeros(3), pull),)
    line = respond(arm, q, ["part"] * count, wrenches=loads, allow_large=True)
    for i in range(count):
        one = respond(arm, q[i : i + 1], ["part"], wrenches=wrenches_in(loads, i), allow_large=True)
        np.testing.assert_allclose(line.laws[i], one.laws[0], rtol=0, atol=1e-9)
    with pytest.raises(ShapeError, match="expected force and moment"):
        Pushes(arm.loaded("part"), loads).at(q[:3], np.zeros((3, 2, 6)))


def test_gravity_that_is_turned_turns_a_branch(arm: Arm, held: list[Arm]) -> None:
    gravity, at = np.array([1.0, 2.0, -9.5]), beside(COUNT)
    askew = replace(arm, robot=replace(arm.robot, gravity=gravity))
    found = askew.deflection(positions(), wrenches=branches(arm.robot, at))
    for i, other in enumerate(held):
        want = replace(other, robot=replace(other.robot, gravity=gravity)).deflection(positions()[i])
        np.testing.assert_allclose(found.displacement[i], want.displacement, rtol=0, atol=1e-14)


def test_every_command_takes_the_columns(arm: Arm, held: list[Arm], tmp_path: Path) -> None:
    q, at = positions(), beside(COUNT)
    path = read_trajectory(table(tmp_path / "t.csv", 0.1 * q, at, via=[f"v{i}" for i in range(COUNT)]), arm)
    verdicts, moved = check(arm, path, 0.01).via_points, compensate(arm, path)
    for i, other in enumerate(held):
        want = np.linalg.norm(other.deflection(0.1 * q[i], "part").displacement[:3])
        assert next(one for one in verdicts if one.name == f"v{i}").displacement_m == pytest.approx(want, abs=1e-12)
        there = other.deflection(moved.trajectory.q[i], "part").pose.translation
        np.testing.assert_allclose(there, other.rigid_pose(0.1 * q[i]).translation, rtol=0, atol=1e-9)
    again = read_trajectory(write_trajectory(moved.trajectory, tmp_path / "moved.csv"), arm)
    one, two = (arm.deflection(some.q, "part", wrenches=some.wrenches) for some in (moved.trajectory, again))
    np.testing.assert_array_equal(one.displacement, two.displacement)

    asked = predict(arm, read_measurements(table(tmp_path / "rows.csv", q, at), arm, inputs_only=True))
    want = [other.deflection(q[i], "part").pose.translation for i, other in enumerate(held)]
    np.testing.assert_allclose(asked.position, want, rtol=0, atol=1e-12)

    two_arms(tmp_path)
    named = [f"{name}={value:.17g}" for name, value in zip(arm.joint_names, q[0].tolist(), strict=True)]
    named += [f"{name}={float(values[0]):.17g}" for name, values in at.items()]
    asking = ("--q", ",".join(named), "--payload", "part", "--json", "d.json")
    assert run_here(tmp_path, "deflect", "arm.toml", *asking).returncode == 0
    found = json.loads((tmp_path / "d.json").read_text())["displacement"]
    np.testing.assert_allclose(found, held[0].deflection(q[0], "part").displacement, rtol=0, atol=1e-14)


def test_halfway_a_branch_is_halfway(arm: Arm, tmp_path: Path) -> None:
    q, at = positions(2), beside(2)
    path = read_trajectory(table(tmp_path / "t.csv", q, at), arm)
    half = path.with_midpoints(np.array([True]))
    want = branches(arm.robot, {name: values.mean() for name, values in at.items()})
    np.testing.assert_allclose(half.wrenches[0].moment[1], want[0].moment, rtol=0, atol=1e-12)


def test_a_campaign_tells_what_bends_under_a_second_arm(tmp_path: Path) -> None:
    arm, count, rng = two_arms(tmp_path), 60, np.random.default_rng(5)
    q, at = rng.uniform(-1.5, 1.5, (count, 3)), beside(count, 8)
    true = arm.deflection(q, "part", wrenches=branches(arm.robot, at)).pose
    assert isinstance(true, np.ndarray)
    read = true[:, :3, 3] + 1e-5 * rng.normal(size=(count, 3))
    path = table(tmp_path / "m.csv", q, at, sigma=[1e-5] * count, **dict(zip("xyz", read.T.tolist(), strict=True)))
    rows = read_measurements(path, arm)
    found, bare = calibrate(arm, rows), calibrate(arm, replace(rows, wrenches=()))
    assert found.rms < 2e-5 and bare.rms > 3.0 * found.rms
    saved = load_arm(found.write(tmp_path / "fitted.toml"))
    np.testing.assert_allclose(predict(saved, rows).position, read, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("instead", "said"),
    [
        ({"q_to_other_fore": [90.0] * COUNT}, "outside its limits [-2, 2]"),
        ({"q_to_other_slide": [0.1] * (COUNT - 1) + [0.7]}, "to_other_slide' at 0.7 is outside its limits [0, 0.4]"),
        ({"q_to_other_fore": ["x"] * COUNT}, "not a finite number"),
        ({"q_to_other_for": [0.1] * COUNT}, "did you mean 'q_to_other_fore'"),
        (
            {"q_to_finger": [*(0.5 * beside(COUNT)["to_other_slide"])[:-1].tolist(), 0.15]},
            f"rows.csv:{COUNT + 1}: joint 'to_finger' is at 0.15, but mimics 'to_other_slide', which puts it at",
        ),
        ({"force_fz": [9.0] * COUNT, "force_frame": ["other_fore"] * COUNT}, "which joint 'to_other_upper' off"),
    ],
)
def test_what_a_table_may_get_wrong(arm: Arm, tmp_path: Path, instead: dict[str, list], said: str) -> None:
    path = tmp_path / "rows.csv"
    write_table(path, columns(positions(), beside(COUNT)) | {"time": list(range(COUNT))} | instead)
    for read in (lambda: read_trajectory(path, arm), lambda: read_measurements(path, arm, inputs_only=True)):
        with pytest.raises(TableError, match=re.escape(said)) as caught:
            read()
        assert str(path) in str(caught.value)


def test_a_campaign_without_columns_of_what_weighs_is_flagged(arm: Arm, tmp_path: Path) -> None:
    at = beside(COUNT)
    both = read_measurements(table(tmp_path / "both.csv", positions(), at), arm, inputs_only=True)
    one = read_measurements(table(tmp_path / "one.csv", positions(), dict([at.popitem()])), arm, inputs_only=True)
    (flag,) = (flag for flag in one.flags if flag.code == "branch_held")
    assert "no column q_to_other_upper, q_to_other_fore: what hangs there" in flag.text
    assert "branch_held" not in {flag.code for flag in both.flags}


def test_a_joint_that_carries_nothing_of_the_chain_is_refused(tmp_path: Path) -> None:
    arm = two_arms(tmp_path, instead={"base": 'base = "torso"', 'joint = "to_torso"': 'joint = "to_fore"'})
    write_table(tmp_path / "rows.csv", columns(positions(), {"to_other_fore": np.zeros(COUNT)}))
    with pytest.raises(TableError, match="'to_torso' does not hang on the chain from 'torso' to 'tool': leave it out"):
        read_measurements(tmp_path / "rows.csv", arm, inputs_only=True)


def test_a_follower_is_where_its_master_puts_it(arm: Arm, tmp_path: Path) -> None:
    two_arms(tmp_path)
    asked = run_here(tmp_path, "deflect", "arm.toml", "--q", "to_other_slide=0.3,to_finger=0.02")
    assert asked.returncode == 2
    assert "--q: joint 'to_finger' is at 0.02, but mimics 'to_other_slide', which puts it at 0.15" in asked.stderr
    assert run_here(tmp_path, "deflect", "arm.toml", "--q", "to_other_slide=0.3,to_finger=0.15").returncode == 0
    q, at = positions(), beside(COUNT)
    follows = {"to_finger": np.round(0.5 * at["to_other_slide"], 5)}  # as a file has it
    found = read_trajectory(table(tmp_path / "t.csv", q, at | follows), arm).wrenches[0]
    alone = read_trajectory(table(tmp_path / "t.csv", q, at), arm).wrenches[0]
    np.testing.assert_allclose(found.moment, alone.moment, rtol=0, atol=1e-5)


def test_a_remembered_load_is_under_the_gravity_of_the_arm_that_is_asked(arm: Arm, tmp_path: Path) -> None:
    """Moving at no speed is standing still, for which loads are found another way."""
    rows = read_trajectory(table(tmp_path / "t.csv", positions(), beside(COUNT)), arm)
    effect = Effect(EVERY["hysteresis"], Location("to_upper", "ry"), (1e-8, 5.0))
    other = replace(arm, robot=replace(arm.robot, gravity=np.array([3.0, 0.0, -9.0])), effects=(effect,))
    still, moving = (known_rows(other, one)[effect.state] for one in (rows, replace(rows, v=np.zeros_like(rows.q))))
    np.testing.assert_allclose(moving, still, rtol=0, atol=1e-6)
    assert np.ptp(still) > 1.0


@pytest.mark.parametrize("moved", [{"v": np.ones(3)}, {"a": np.ones(3)}])
def test_a_branch_is_not_accelerated_and_says_so(arm: Arm, moved: dict[str, np.ndarray]) -> None:
    q, hung = positions(2), branches(arm.robot, {"to_other_fore": 0.5})
    rows = {name: np.array([values, values]) for name, values in moved.items()}
    for found in (
        arm.deflection(q[0], wrenches=hung, **moved),
        arm.deflection(q, wrenches=hung, **rows),
        arm.deflection(q, wrenches=hung, **rows).row(1),
    ):
        assert "branch_at_rest" in {flag.code for flag in found.flags}
    still = arm.deflection(q[0], wrenches=hung)
    assert "branch_at_rest" not in {flag.code for flag in still.flags}
