"""`compensate`: the loaded tip is where the rigid arm's would be, by another solver; what cannot be reached is said."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize
from small_arms import ROBOTS, arm_of, central_difference, joint, link

from armflex import Arm, Compensation, InputError, Trajectory, compensate, load_arm
from armflex.errors import JointLimitError, PoseError, ShapeError, SmallDisplacementError, UnreachableError


def remaining(arm: Arm, commanded: Trajectory, moved: Trajectory) -> np.ndarray:
    """Return (N, 2) distance [m] and angle [rad] from the rigid arm's tip, by fixed point instead of Newton."""
    out = []
    for q, start, payload in zip(moved.q, commanded.q, moved.payload, strict=True):
        pose, target = arm.deflection(q, payload, method="fixed_point").pose, arm.rigid_pose(start)
        turn = np.linalg.norm(pin.log3(pose.rotation @ target.rotation.T))
        out.append((np.linalg.norm(pose.translation - target.translation), turn))
    return np.array(out)


def some_rows(path: Trajectory, *rows: int) -> Trajectory:
    names = [tuple(getattr(path, name)[i] for i in rows) for name in ("payload", "via")]
    return Trajectory(path.joint_names, path.time[list(rows)], path.q[list(rows)], *names)


def at(arm: Arm, *q: float, payload: str = "none") -> Trajectory:
    return Trajectory(arm.joint_names, np.zeros(1), np.array([q], dtype=float), (payload,), ("here",))


def with_limits(folder: Path, robot: str, **limits: tuple[float, float]) -> Arm:
    """Return a copy of a bundled arm whose URDF has other limits at the named joints."""
    shutil.copytree(ROBOTS / robot, folder / robot)
    path = folder / robot / "robot.urdf"
    text = path.read_text()
    for name, (lower, upper) in limits.items():
        pattern = rf'(<joint name="{name}".*?<limit )lower="[^"]*" upper="[^"]*"'
        text, count = re.subn(
            pattern, rf'\g<1>lower="{float(lower)!r}" upper="{float(upper)!r}"', text, count=1, flags=re.S
        )
        assert count == 1, name
    path.write_text(text)
    return load_arm(folder / robot / "arm.toml")


def planar(folder: Path, axial: float = 0.0) -> Arm:
    """Return two links of 1 m that turn about y, soft about y and, if asked, along their length."""
    parts = [
        link("base"),
        joint("a", "base", "one"),
        link("one", 10.0, (0.5, 0, 0)),
        joint("b", "one", "two", (1, 0, 0)),
        link("two", 10.0, (0.5, 0, 0)),
        joint("f", "two", "tool", (1, 0, 0), kind="fixed"),
        link("tool"),
    ]
    compliance = np.diag([axial, 0, 0, 0, 1e-5, 0])
    return arm_of(folder, parts, "tool", {"a": compliance, "b": compliance})


@pytest.fixture(scope="module")
def found(tarm: Arm, tarm_path: Trajectory, heavy: Arm, heavy_path: Trajectory) -> dict[tuple[str, str], Compensation]:
    return {
        ("tarm", "position"): compensate(tarm, tarm_path),
        ("heavy", "position"): compensate(heavy, heavy_path),
        ("heavy", "pose"): compensate(heavy, heavy_path, "pose"),
    }


CASES = [("tarm", "position"), ("heavy", "position"), ("heavy", "pose")]


@pytest.mark.parametrize(("name", "match"), CASES)
def test_the_tip_is_where_the_rigid_arm_would_be(
    found: dict, name: str, match: str, request: pytest.FixtureRequest
) -> None:
    arm, path = request.getfixturevalue(name), request.getfixturevalue(f"{name}_path")
    result = found[name, match]
    left, before = remaining(arm, path, result.trajectory), remaining(arm, path, path)
    assert left[:, 0].max() < 1e-9 and before[:, 0].min() > 1e-3
    assert (left[:, 1].max() < 1e-9) == (match == "pose")
    assert result.ok and not any(row.reason for row in result.rows) and len(result.rows) == len(path)
    assert (result.trajectory.q >= arm.robot.lower).all() and (result.trajectory.q <= arm.robot.upper).all()


@pytest.mark.parametrize(("name", "match"), CASES)
def test_the_report_tells_what_was_done(found: dict, name: str, match: str, request: pytest.FixtureRequest) -> None:
    arm, path, result = request.getfixturevalue(name), request.getfixturevalue(f"{name}_path"), found[name, match]
    for i, row in enumerate(result.rows):
        np.testing.assert_allclose(row.before, arm.deflection(path.q[i], path.payload[i]).displacement, atol=1e-12)
        np.testing.assert_allclose(path.q[i] + row.change, result.trajectory.q[i], atol=1e-15)
        assert (row.time, row.via) == (path.time[i], path.via[i])


@pytest.mark.parametrize(("name", "match"), CASES)
def test_changes_follow_the_path_smoothly(found: dict, name: str, match: str, request: pytest.FixtureRequest) -> None:
    """Between rows of one payload the change of the joints is small beside the step of the path itself."""
    path, result = request.getfixturevalue(f"{name}_path"), found[name, match]
    changes = np.array([row.change for row in result.rows])
    for i in range(1, len(path)):
        if path.payload[i] == path.payload[i - 1]:
            step = np.linalg.norm(path.q[i] - path.q[i - 1])
            assert np.linalg.norm(changes[i] - changes[i - 1]) <= 0.1 * step + 1e-12, i


@pytest.mark.parametrize(
    "q", [(2.0, 0.3, 0.2, 0.5, -0.4, 0.3, 0.1), (5.0, -1.0, -0.2, 1.2, -0.9, 0.1, 2.0)], ids=["near", "far"]
)
def test_jacobian_in_use_is_that_of_the_loaded_arm(tarm: Arm, q: tuple) -> None:
    here = tarm.deflection(q, "p600")

    def pose(at: np.ndarray) -> np.ndarray:
        moved = tarm.deflection(at, "p600").pose
        return np.concatenate([moved.translation, pin.log3(moved.rotation @ here.pose.rotation.T)])

    expected = central_difference(pose, np.array(q), 1e-5)
    np.testing.assert_allclose(here.total_jacobian, expected, atol=2e-9)
    assert np.abs(here.joint_jacobian - expected).max() > 1e-3  # flexures held: something else


@pytest.mark.parametrize("row", [0, 60, 98])
@pytest.mark.parametrize("weighted", [True, False])
def test_redundant_arm_makes_the_smallest_change(tarm: Arm, tarm_path: Trajectory, row: int, weighted: bool) -> None:
    """Against SLSQP: least weighted change of the joints subject to the loaded tip's place."""
    weights = np.array([50.0, 1.0, 4.0, 1.0, 2.0, 0.5, 1.0]) if weighted else np.ones(7)
    commanded = some_rows(tarm_path, row)
    ours = compensate(tarm, commanded, weights=weights).rows[0].change
    target = tarm.rigid_pose(commanded.q[0]).translation

    def miss(change: np.ndarray) -> np.ndarray:
        found = tarm.deflection(commanded.q[0] + change, commanded.payload[0], enforce_limits=False)
        return 100.0 * (found.pose.translation - target)

    best = minimize(
        lambda change: 1e4 * change @ (weights * change),
        np.zeros(7),
        jac=lambda change: 2e4 * weights * change,
        constraints={"type": "eq", "fun": miss},
        bounds=[(-0.1, 0.1)] * 7,
        method="SLSQP",
        options={"ftol": 1e-16, "maxiter": 60},
    )
    # SLSQP differences the constraint forward, so its own answer is good to about 1e-7 of itself.
    np.testing.assert_allclose(ours, best.x, atol=1e-6 * np.abs(best.x).max())
    assert np.abs(ours).max() > 1e-3


def test_weights_choose_the_joints(tarm: Arm, tarm_path: Trajectory) -> None:
    commanded = some_rows(tarm_path, 98)
    plain = compensate(tarm, commanded).rows[0].change
    stiff = compensate(tarm, commanded, weights=np.array([1, 1, 1e6, 1, 1, 1, 1])).rows[0].change
    assert abs(stiff[2]) < 1e-3 * abs(plain[2]) and abs(stiff[0]) > 5.0 * abs(plain[0])


def test_a_joint_at_its_limit_leaves_it_to_the_others(tarm: Arm, tarm_path: Trajectory, tmp_path: Path) -> None:
    row = 98
    commanded = some_rows(tarm_path, row)
    free = compensate(tarm, commanded).rows[0].change
    q, edge = commanded.q[0, 2], commanded.q[0, 2] + 0.3 * free[2]
    arm = with_limits(tmp_path, "tarm_like", A2=(edge, 0.35) if free[2] < 0 else (-0.35, edge))
    result = compensate(arm, commanded)
    assert result.ok and remaining(arm, commanded, result.trajectory)[0, 0] < 1e-9
    assert result.rows[0].change[2] == pytest.approx(edge - q, abs=1e-12) and abs(free[2]) > 1e-3


def test_a_limit_in_the_way_is_named(heavy: Arm, heavy_path: Trajectory, tmp_path: Path) -> None:
    row = heavy_path.via.index("lift")
    free = compensate(heavy, some_rows(heavy_path, row), "pose").rows[0].change
    edge = heavy_path.q[row, 1] + 0.5 * free[1]
    assert free[1] < -1e-3
    arm = with_limits(tmp_path, "heavy_six", J2=(edge, 1.3))
    path = some_rows(heavy_path, heavy_path.via.index("pick"), row)
    with pytest.raises(UnreachableError, match=r"1 of 2 rows .* worst at 5.4 s lift: .* limit: J2") as caught:
        compensate(arm, path, "pose")
    best = compensate(arm, path, "pose", best_effort=True)
    for report in (caught.value.report, best):
        assert not report.ok and [row.reached for row in report.rows] == [True, False]
        assert [row.reason for row in report.rows] == ["", "limit: J2"]
        assert report.trajectory.q[1, 1] >= edge - 1e-12
        left = remaining(arm, path, report.trajectory)
        np.testing.assert_allclose(np.linalg.norm(report.rows[1].after[:3]), left[1, 0], atol=1e-11)
        assert 1e-5 < left[1, 0] < np.linalg.norm(report.rows[1].before[:3]) and left[0].max() < 1e-9


def test_position_alone_gets_round_the_same_limit(heavy: Arm, heavy_path: Trajectory, tmp_path: Path) -> None:
    row = heavy_path.via.index("lift")
    path = some_rows(heavy_path, row)
    edge = heavy_path.q[row, 1] + 0.5 * compensate(heavy, path).rows[0].change[1]
    result = compensate(with_limits(tmp_path, "heavy_six", J2=(edge, 1.3)), path)
    assert result.ok and result.trajectory.q[0, 1] == pytest.approx(edge, abs=1e-12)


def test_stretched_arm_that_shrinks_is_singular(tmp_path: Path) -> None:
    """Raised and stretched, its links shorten under their weight: no joint makes it longer."""
    arm = planar(tmp_path, axial=1e-5)
    with pytest.raises(UnreachableError, match="singular: smallest singular value") as caught:
        compensate(arm, at(arm, -1.0, 0.0))
    row = caught.value.report.rows[0]
    assert row.reason.startswith("singular") and row.sigma_min < 0.02
    assert 1e-4 < np.linalg.norm(row.after[:3]) <= np.linalg.norm(row.before[:3])
    assert "near_singular" in {flag.code for flag in caught.value.report.flags}


def test_bent_arm_that_shrinks_is_reached(tmp_path: Path) -> None:
    arm = planar(tmp_path, axial=1e-5)
    result = compensate(arm, at(arm, -1.0, 0.6))
    assert result.ok and "near_singular" not in {flag.code for flag in result.flags}


def test_wrist_singularity_is_flagged_with_its_value(heavy: Arm) -> None:
    """With J5 at zero J4 and J6 turn about one axis; where only the position counts that does not matter."""
    row = compensate(heavy, at(heavy, 0, 0.2, 0.3, 0, 0.0, 0, payload="p200"), "pose", best_effort=True)
    flag = next(flag for flag in row.flags if flag.code == "near_singular")
    assert f"{row.rows[0].sigma_min:.2g}" in flag.text and row.rows[0].sigma_min < 0.02
    assert not compensate(heavy, at(heavy, 0, 0.2, 0.3, 0, 0.0, 0, payload="p200")).flags
    assert not compensate(heavy, at(heavy, 0, 0.2, 0.3, 0, 0.8, 0, payload="p200"), "pose").flags


@pytest.mark.parametrize("name", ["tarm", "heavy"])
def test_between_inserts_rows_until_the_gap_is_met(name: str, request: pytest.FixtureRequest) -> None:
    arm, path = request.getfixturevalue(name), request.getfixturevalue(f"{name}_path")
    path = some_rows(path, *range(0, 10, 3))
    plain = compensate(arm, path)
    wanted = plain.between_m / 20.0
    result = compensate(arm, path, between=wanted)
    assert plain.between_m > wanted >= result.between_m and len(result.rows) > len(path)
    assert [name for name in result.trajectory.via if name] == [name for name in path.via if name]
    middle = replace(result.trajectory, via=("",) * len(result.trajectory)).with_midpoints(
        np.ones(len(result.trajectory) - 1, dtype=bool)
    )
    kept = [list(result.trajectory.time).index(time) for time in path.time]
    np.testing.assert_allclose(result.trajectory.q[kept], plain.trajectory.q, atol=1e-8)
    straight = np.array([np.interp(middle.time, path.time, column) for column in path.q.T]).T
    gaps = remaining(arm, replace(middle, q=straight), middle)[:, 0]
    assert gaps.max() == pytest.approx(result.between_m, rel=1e-6) and gaps[::2].max() < 1e-9


def test_a_gap_that_cannot_be_met_is_flagged(heavy: Arm, heavy_path: Trajectory) -> None:
    path = some_rows(heavy_path, 4, 7)
    target = [heavy.rigid_pose(q) for q in path.q]
    assert {flag.code for flag in compensate(heavy, path, targets=target, between=1e-6).flags} == {"between"}
    assert not compensate(heavy, path, between=1e-6).flags


@pytest.mark.parametrize("between", [0.0, -1e-3, np.nan])
def test_between_must_be_positive(heavy: Arm, heavy_path: Trajectory, between: float) -> None:
    with pytest.raises(InputError, match="between must be positive"):
        compensate(heavy, some_rows(heavy_path, 0), between=between)


@pytest.mark.parametrize("form", ["SE3", "matrix", "quaternion"])
def test_targets_in_every_form(heavy: Arm, heavy_path: Trajectory, form: str) -> None:
    path = some_rows(heavy_path, 10, 40)
    shift = pin.SE3(pin.exp3(np.array([0.01, -0.02, 0.005])), np.array([0.004, -0.003, 0.002]))
    poses = [heavy.rigid_pose(q) * shift for q in path.q]
    given = {"SE3": poses, "matrix": [p.homogeneous for p in poses], "quaternion": [pin.SE3ToXYZQUAT(p) for p in poses]}
    result = compensate(heavy, path, "pose", targets=given[form])
    assert result.ok and result.between_m is None
    for q, payload, pose in zip(result.trajectory.q, path.payload, poses, strict=True):
        reached = heavy.deflection(q, payload, method="fixed_point").pose
        assert np.abs(pin.log6(pose.actInv(reached)).vector).max() < 1e-9


@pytest.mark.parametrize(
    ("options", "error", "complaint"),
    [
        ({"targets": [np.eye(4)]}, InputError, "expected 2 poses, one per row, got 1"),
        ({"targets": [np.eye(4), np.eye(3)]}, ShapeError, "target 1"),
        ({"targets": [np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0])]}, PoseError, "target 1.*reflection"),
        ({"targets": [np.eye(4), np.array([0, 0, 0, 0, 0, 0, 2.0])]}, PoseError, "target 1.*norm"),
        ({"weights": np.ones(5)}, InputError, "weights: expected 6 positive"),
        ({"weights": np.array([1, 1, 1, 1, 1, 0.0])}, InputError, "weights: expected 6 positive"),
        ({"weights": np.array([1, 1, 1, 1, 1, np.nan])}, InputError, "weights: expected 6 positive"),
        ({"match": "orientation"}, InputError, "expected 'position' or 'pose'"),
    ],
)
def test_wrong_options(heavy: Arm, heavy_path: Trajectory, options: dict, error: type, complaint: str) -> None:
    with pytest.raises(error, match=complaint):
        compensate(heavy, some_rows(heavy_path, 10, 40), **options)


def test_errors_name_row_and_time(heavy: Arm, heavy_path: Trajectory, tmp_path: Path) -> None:
    q = heavy_path.q.copy()
    q[7, 1] = 9.0
    with pytest.raises(JointLimitError, match=r"^row 7 at 1.4 s: joint 'J2'"):
        compensate(heavy, replace(heavy_path, q=q))
    arm = planar(tmp_path)
    soft = replace(
        arm, flexures=tuple(replace(f, law=replace(f.law, compliance=1e3 * f.law.compliance)) for f in arm.flexures)
    )
    with pytest.raises(SmallDisplacementError, match=r"^row 0 at 0 s: flexure"):
        compensate(soft, at(soft, 0.0, 0.3))


def test_payload_changes_and_haste_are_flagged(found: dict, tarm: Arm, tarm_path: Trajectory) -> None:
    flag = next(flag for flag in found["tarm", "position"].flags if flag.code == "payload_change")
    release = next(i for i in range(1, len(tarm_path)) if tarm_path.payload[i] != tarm_path.payload[i - 1])
    spring = [tarm.deflection(tarm_path.q[i], tarm_path.payload[i]).displacement[:3] for i in (release - 1, release)]
    assert f"{np.linalg.norm(spring[1] - spring[0]):.3g} m" in flag.text
    hasty = compensate(tarm, replace(some_rows(tarm_path, 20, 24), time=np.array([0.0, 0.1])))
    assert "too_fast" in {flag.code for flag in hasty.flags}


def test_inertial_loads_count(heavy: Arm, heavy_path: Trajectory) -> None:
    still = some_rows(heavy_path, 40)
    pushed = replace(still, v=np.zeros((1, 6)), a=np.array([[3.0, 2.0, -2.0, 0.0, 0.0, 0.0]]))
    result = compensate(heavy, pushed)
    pose = heavy.deflection(result.trajectory.q[0], "p200", v=pushed.v[0], a=pushed.a[0], method="fixed_point").pose
    assert np.linalg.norm(pose.translation - heavy.rigid_pose(still.q[0]).translation) < 1e-9
    assert np.abs(result.rows[0].change - compensate(heavy, still).rows[0].change).max() > 1e-4
