"""`compensate`: the loaded tip is where the rigid arm's would be, by another solver; what cannot be reached is said."""

import itertools
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import lsq_linear, minimize
from support.small_arms import ROBOTS, arm_of, central_difference, joint, link

from armflex import Arm, InputError, Trajectory, check, compensate, load_arm, read_trajectory, view
from armflex.errors import JointLimitError, PoseError, ShapeError, SmallDisplacementError, UnreachableError
from armflex.tasks.compensate import Compensation
from armflex.tasks.inverse_kinematics import Corrector, Trial
from armflex.trajectory import write_trajectory


def remaining(arm: Arm, commanded: Trajectory, moved: Trajectory) -> np.ndarray:
    """Return (N, 2) distance [m] and angle [rad] from the rigid arm's tip, by fixed point instead of Newton."""
    out = []
    for q, start, payload in zip(moved.q, commanded.q, moved.payload, strict=True):
        pose, target = arm.deflection(q, payload, method="newton").pose, arm.rigid_pose(start)
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


def test_a_tool_that_is_turned_to_hold_its_position_is_flagged_with_the_remedy() -> None:
    """Where the last four joints alone may move, they turn the tool ten times as far as its bending did."""
    arm = load_arm(ROBOTS / "tarm_like" / "arm.toml")
    path, costs = some_rows(read_trajectory(ROBOTS / "tarm_like" / "trajectory.csv", arm), 59), np.full(7, 1e4)
    costs[3:] = 1.0
    moved = compensate(arm, path, weights=costs)
    before, after = moved.turns_rad
    assert after > 5.0 * before
    text = f"by up to {after * 1e3:.3g} mrad from where it is meant, by {before * 1e3:.3g} from bending alone"
    for found in (moved, check(arm, moved.trajectory, 0.01)):
        (flag,) = (flag for flag in found.flags if flag.code == "turned")
        assert text in flag.text and "--match pose" in flag.text
    for found in (
        compensate(arm, path, "pose", weights=costs, best_effort=True),
        compensate(arm, path),
        check(arm, moved.trajectory, 0.01, angle=0.01),
        check(arm, path, 0.01),
    ):
        assert "turned" not in {flag.code for flag in found.flags}


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


def miss(arm: Arm, commanded: Trajectory, change: np.ndarray) -> np.ndarray:
    """Return the (3,) way from the rigid arm's tip to the loaded one's after a change of the only row's joints."""
    found = arm.deflection(commanded.q[0] + change, commanded.payload[0], enforce_limits=False)
    return found.pose.translation - arm.rigid_pose(commanded.q[0]).translation


def slsqp(arm: Arm, commanded: Trajectory, start: np.ndarray, weights: np.ndarray, most: float) -> np.ndarray:
    """Return the smallest change of the only row's joints by another solver, wherever it ends."""

    def jacobian(change: np.ndarray) -> np.ndarray:
        q = commanded.q[0] + change
        return 100.0 * arm.deflection(q, commanded.payload[0], enforce_limits=False).total_jacobian[:3]

    low, high = (np.clip(limit - commanded.q[0], -most, most) for limit in (arm.robot.lower, arm.robot.upper))
    return minimize(
        lambda change: 1e4 * change @ (weights * change),
        start,
        jac=lambda change: 2e4 * weights * change,
        constraints={"type": "eq", "fun": lambda change: 100.0 * miss(arm, commanded, change), "jac": jacobian},
        bounds=list(zip(low, high, strict=True)),
        method="SLSQP",
        options={"ftol": 1e-16, "maxiter": 100},
    ).x


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
def test_a_path_is_compensated_once(
    found: dict, name: str, match: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """The file says where its tip is meant to be, so that neither compensating nor checking it takes it for a path."""
    arm, path, once = request.getfixturevalue(name), request.getfixturevalue(f"{name}_path"), found[name, match]
    np.testing.assert_array_equal(once.trajectory.target, path.q)
    assert not any(flag.code == "compensated" for flag in once.flags)
    again = compensate(arm, write_trajectory(once.trajectory, tmp_path / "once.csv"), match)
    np.testing.assert_allclose(again.trajectory.q, once.trajectory.q, atol=1e-8)
    np.testing.assert_allclose(again.trajectory.target, path.q, atol=1e-12)
    (told,) = (flag for flag in again.flags if flag.code == "compensated")
    assert f"{len(path)} of {len(path)} rows" in told.text
    one, other = check(arm, tmp_path / "once.csv", 1e-3), check(arm, once.trajectory, 1e-3, against=path)
    np.testing.assert_allclose([p.displacement_m for p in one.rows], [p.displacement_m for p in other.rows], atol=1e-9)
    assert max(point.displacement_m for point in one.rows) < 1e-8
    assert [flag.code for flag in one.flags if flag.code == "target"] == ["target"]
    springs = [[f.text for f in found.flags if f.code == "payload_change"] for found in (once, again)]
    assert springs[0] == springs[1]
    (told,) = (flag for flag in check(arm, path, 1e-3, against=once.trajectory).flags if flag.code == "desired_moved")
    assert "exchanged" in told.text


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


@pytest.mark.slow
@pytest.mark.parametrize(("row", "weighted"), [(60, True), (0, False)])
def test_redundant_arm_makes_the_smallest_change(tarm: Arm, tarm_path: Trajectory, row: int, weighted: bool) -> None:
    """Against SLSQP: least weighted change of the joints subject to the loaded tip's place."""
    weights = np.array([50.0, 1.0, 4.0, 1.0, 2.0, 0.5, 1.0]) if weighted else np.ones(7)
    commanded = some_rows(tarm_path, row)
    ours = compensate(tarm, commanded, weights=weights).rows[0].change
    best = np.zeros(7)
    for again in range(50):  # again from where it ended: its line search may give up 1e-8 m early
        best = slsqp(tarm, commanded, best, weights, 0.1)
        if again > 3 and np.abs(miss(tarm, commanded, best)).max() < 1e-9:
            break
    assert np.abs(miss(tarm, commanded, best)).max() < 1e-9
    # SLSQP stops on the cost, which is flat at its least: the change is good to about the root of what it leaves there.
    np.testing.assert_allclose(ours, best, rtol=0, atol=2e-6 * np.abs(best).max())
    assert ours @ (weights * ours) <= (1.0 + 1e-9) * best @ (weights * best)
    assert np.abs(ours).max() > 1e-3


HARD = {50: "singular", 87: "singular", 105: "singular"}
"""Of the 300 random positions below, those that no change reaches."""


@pytest.fixture(scope="module")
def study(tarm: Arm) -> list[Trajectory]:
    random = np.random.default_rng(1)
    spans = {"M1": (0.5, 5.0), "A2": (-0.2, 0.2)} | {name: (-1.0, 1.0) for name in ("A3", "A4", "A5", "A6")}
    draws = [{name: random.uniform(*span) for name, span in spans.items()} for _ in range(300)]
    return [at(tarm, *tarm.position(**draw), payload="p600") for draw in draws]


@pytest.mark.slow
def test_random_positions_are_reached_unless_no_change_reaches_them(tarm: Arm, study: list[Trajectory]) -> None:
    rows = [compensate(tarm, commanded, best_effort=True).rows[0] for commanded in study]
    assert {i: row.reason.split(":")[0] for i, row in enumerate(rows) if not row.reached} == HARD
    assert all(row.smallest for row in rows if row.reached)
    for i, row in enumerate(rows):
        left = np.linalg.norm(miss(tarm, study[i], row.change))
        assert left < 2e-10 if row.reached else row.sigma_min < 0.02 and left < np.linalg.norm(row.before[:3]), i


@pytest.mark.slow
@pytest.mark.parametrize("which", [50, 57, 59, 94])
def test_hard_positions_against_another_solver(tarm: Arm, study: list[Trajectory], which: int) -> None:
    commanded, ones = study[which], np.ones(7)
    starts = [np.random.default_rng(seed).normal(scale=0.02, size=7) for seed in range(2)]
    ends = [slsqp(tarm, commanded, start, ones, 0.5) for start in starts]
    sizes = [end @ end for end in ends if np.abs(miss(tarm, commanded, end)).max() < 1e-9]
    row = compensate(tarm, commanded, best_effort=True).rows[0]
    assert row.reached == bool(sizes) == (which not in HARD)
    assert not sizes or row.change @ row.change <= (1.0 + 1e-6) * min(sizes)


def linear(jacobian: np.ndarray, wanted: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[Trial, bool, int]:
    """Return what the solver makes of an arm whose tip moves in proportion to its joints."""
    corrector = Corrector(low, high, np.ones(len(low)))
    search = corrector.find(np.zeros(len(low)))
    change = next(search)
    while True:
        try:
            error = np.concatenate([jacobian @ change - wanted, np.zeros(3)])
            change = search.send(Trial.of(change[None], error[None], jacobian[None])[0])
        except StopIteration as found:
            return (*found.value, corrector.calls)


def least(jacobian: np.ndarray, wanted: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Return the least squared size that solves exactly inside the box, by trying every set of joints held."""
    best = np.inf
    for held in itertools.product((0, -1, 1), repeat=len(low)):
        x = np.select([np.array(held) < 0, np.array(held) > 0], [low, high], 0.0)
        free = np.array(held) == 0
        if free.any():
            rest = wanted - jacobian[:, ~free] @ x[~free]
            x[free] = np.linalg.lstsq(jacobian[:, free], rest, rcond=None)[0]
        inside = (x >= low - 1e-12).all() and (x <= high + 1e-12).all()
        if inside and np.abs(jacobian @ x - wanted).max() < 1e-9:
            best = min(best, float(x @ x))
    return best


@pytest.mark.parametrize("seed", range(40))
def test_limits_are_met_and_left_again_as_the_smallest_change_needs(seed: int) -> None:
    random = np.random.default_rng(seed)
    jacobian, low, high = random.normal(size=(3, 5)), -random.uniform(0, 0.1, 5), random.uniform(0, 0.1, 5)
    corner = np.where(random.random(5) < 0.5, low, high)
    inside = np.where(random.random(5) < 0.6, corner, random.uniform(low, high))
    point, smallest, calls = linear(jacobian, jacobian @ inside, low, high)
    assert point.left < 1e-10 and smallest and calls < 10
    assert point.change @ point.change <= (1.0 + 1e-9) * least(jacobian, jacobian @ inside, low, high)
    point, _, _ = linear(jacobian, 1.5 * jacobian @ inside, low, high)
    best = np.sqrt(2.0 * lsq_linear(jacobian, 1.5 * jacobian @ inside, (low, high), tol=1e-14).cost)
    assert np.linalg.norm(point.matched) <= best * (1.0 + 1e-9) + 1e-10


def test_a_joint_held_too_early_is_released() -> None:
    """Held one by one, the furthest out first and for good, joints 0 and 2 would leave an error of 0.01."""
    jacobian = np.array([[-2.0, 2.0, -2.0, 1.0], [2.0, 1.0, -2.0, 0.0], [-2.0, 1.0, -2.0, -1.0]])
    low, high = np.array([-0.05, -0.075, -0.05, -0.075]), np.array([0.05, 0.075, 0.025, 0.05])
    inside = np.array([0.05, -0.075, 0.0, 0.05])
    point, smallest, _ = linear(jacobian, jacobian @ inside, low, high)
    assert point.left < 1e-10 and smallest
    assert point.change @ point.change <= (1.0 + 1e-9) * least(jacobian, jacobian @ inside, low, high)


def test_nearly_singular_rows_that_can_be_reached_are(tmp_path: Path) -> None:
    """The nearly stretched arm has some 1e-3 m per rad left to change its length with, and a link stretches."""
    arm = planar(tmp_path, axial=1e-9)
    for bend in (0.02, 0.01, 0.003):
        row = compensate(arm, at(arm, -1.0, bend)).rows[0]
        assert row.reached and row.sigma_min < 0.02, bend


def test_weights_choose_the_joints(tarm: Arm, tarm_path: Trajectory) -> None:
    commanded = some_rows(tarm_path, 98)
    plain = compensate(tarm, commanded).rows[0].change
    stiff = compensate(tarm, commanded, weights=np.array([1, 1, 1e6, 1, 1, 1, 1])).rows[0].change
    assert abs(stiff[2]) < 1e-3 * abs(plain[2]) and abs(stiff[0]) > 5.0 * abs(plain[0])


@pytest.mark.parametrize("weight", [1e-6, 1e4])
def test_the_unit_of_the_weights_does_not_matter(tarm: Arm, tarm_path: Trajectory, weight: float) -> None:
    commanded = some_rows(tarm_path, 0, 98)
    plain, weighted = compensate(tarm, commanded), compensate(tarm, commanded, weights=np.full(7, weight))
    assert [flag.code for flag in plain.flags] == [flag.code for flag in weighted.flags]
    for one, other in zip(plain.rows, weighted.rows, strict=True):
        assert other.sigma_min == pytest.approx(one.sigma_min, rel=1e-6)
        np.testing.assert_allclose(other.change, one.change, atol=1e-8)


def test_columns_go_by_the_joints_names(heavy: Arm, heavy_path: Trajectory) -> None:
    plain, order = some_rows(heavy_path, 10, 40), [3, 0, 5, 1, 2, 4]
    mixed = replace(plain, joint_names=tuple(plain.joint_names[i] for i in order), q=plain.q[:, order])
    expected, result = compensate(heavy, plain).trajectory, compensate(heavy, mixed).trajectory
    assert result.joint_names == heavy.joint_names
    np.testing.assert_array_equal(result.q, expected.q)
    strange = replace(plain, joint_names=("X", *plain.joint_names[1:]))
    with pytest.raises(InputError, match=r"X, J2.*J1, J2"):
        compensate(heavy, strange)


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


def test_a_joint_at_its_limit_is_not_blamed_for_what_it_cannot_help(tmp_path: Path) -> None:
    arm = planar(tmp_path, axial=1e-5)
    joints = tuple(replace(joint, upper=0.0) if joint.name == "b" else joint for joint in arm.robot.chain)
    row = compensate(replace(arm, robot=replace(arm.robot, chain=joints)), at(arm, -1.0, 0.0), best_effort=True).rows[0]
    assert row.reason.startswith("singular")


def test_a_target_too_far_off_is_called_that(heavy: Arm, heavy_path: Trajectory) -> None:
    path = some_rows(heavy_path, 10)
    turned = path.q[0] + np.array([0.9, 0, 0, 0, 0, 0])
    row = compensate(heavy, path, targets=[heavy.rigid_pose(turned)], best_effort=True).rows[0]
    assert not row.reached and row.reason.startswith("too far: J1") and row.reason.endswith("0.5 rad or m")
    assert np.abs(row.change).max() == pytest.approx(0.5) and not row.smallest


def test_a_pose_takes_six_joints(tmp_path: Path) -> None:
    arm = planar(tmp_path, axial=1e-5)
    with pytest.raises(UnreachableError, match="joints: a pose takes six, this arm has 2"):
        compensate(arm, at(arm, -1.0, 0.6), "pose")


def test_a_position_out_of_the_plane_takes_three_joints(tmp_path: Path) -> None:
    arm = planar(tmp_path)
    path = at(arm, -1.0, 0.6)
    aside = arm.rigid_pose(path.q[0])
    aside.translation = aside.translation + np.array([0.0, 0.01, 0.0])
    row = compensate(arm, path, targets=[aside], best_effort=True).rows[0]
    assert row.reason == "joints: a position takes three, this arm has 2"
    assert np.linalg.norm(row.after[:3]) == pytest.approx(0.01, rel=1e-6)


def test_a_lost_equilibrium_is_the_reason(tmp_path: Path) -> None:
    """Raised the soft arm stands; where it is to go it bends beyond small displacements."""
    arm = planar(tmp_path)
    soft = replace(
        arm, flexures=tuple(replace(f, law=replace(f.law, compliance=150.0 * f.law.compliance)) for f in arm.flexures)
    )
    path = at(arm, -1.45, 0.1)
    target = arm.rigid_pose(np.array([-1.0, 0.1]))
    row = compensate(soft, path, targets=[target], best_effort=True).rows[0]
    assert not row.reached and row.reason.startswith("equilibrium: flexure")


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
        reached = heavy.deflection(q, payload, method="newton").pose
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


@pytest.mark.parametrize(
    ("target", "error", "complaint"),
    [
        (np.zeros((2, 5)), ShapeError, r"trajectory target: expected \(2, 6\), got \(2, 5\)"),
        (np.zeros(6), ShapeError, r"trajectory target: expected \(2, 6\), got \(6,\)"),
        (np.array([[0.0] * 6, [0.0, np.nan, 0.0, 0.0, 0.0, 0.0]]), InputError, "row 1 .*target: "),
    ],
)
def test_targets_that_are_none_are_refused(
    heavy: Arm, heavy_path: Trajectory, target: np.ndarray, error: type, complaint: str
) -> None:
    path = some_rows(heavy_path, 0, 1)
    for task in (compensate, partial(check, tolerance=1e-3)):
        with pytest.raises(error, match=complaint):
            task(heavy, replace(path, target=target))


def test_targets_in_degrees_are_asked_about(heavy: Arm, heavy_path: Trajectory, tmp_path: Path) -> None:
    path = some_rows(heavy_path, 0, 1)
    written = write_trajectory(replace(path, target=np.degrees(path.q) + 400.0), tmp_path / "path.csv")
    with pytest.raises(InputError, match=r"target_J1 is .* Then name the column target_J1_deg"):
        check(heavy, written, 1e-3)


def test_errors_name_row_and_time(heavy: Arm, heavy_path: Trajectory, tmp_path: Path) -> None:
    q = heavy_path.q.copy()
    q[7, 1] = 9.0
    with pytest.raises(JointLimitError, match=r"trajectory\.csv:9: row 7 at 1.4 s: joint 'J2'"):
        compensate(heavy, replace(heavy_path, q=q))
    with pytest.raises(JointLimitError, match=r"^row 7 at 1.4 s: joint 'J2'"):
        compensate(heavy, replace(heavy_path, q=q, places=()))
    with pytest.raises(JointLimitError, match=r"trajectory\.csv:9: row 7 at 1.4 s: joint 'J2'"):
        view(heavy, trajectory=replace(heavy_path, q=q), path=tmp_path / "v.html")
    assert not (tmp_path / "v.html").exists()
    arm = planar(tmp_path)
    soft = replace(
        arm, flexures=tuple(replace(f, law=replace(f.law, compliance=1e3 * f.law.compliance)) for f in arm.flexures)
    )
    with pytest.raises(SmallDisplacementError, match=r"^row 0 \(here\) at 0 s: flexure"):
        compensate(soft, at(soft, 0.0, 0.3))


def test_payload_changes_and_haste_are_flagged(found: dict, tarm: Arm, tarm_path: Trajectory) -> None:
    flag = next(flag for flag in found["tarm", "position"].flags if flag.code == "payload_change")
    release = next(i for i in range(1, len(tarm_path)) if tarm_path.payload[i] != tarm_path.payload[i - 1])
    there = found["tarm", "position"].trajectory.q[release]
    spring = [tarm.deflection(there, tarm_path.payload[i]).displacement[:3] for i in (release - 1, release)]
    assert f"{1e3 * np.linalg.norm(spring[1] - spring[0]):.3g} mm; between the rows at" in flag.text
    assert "too_fast" not in {flag.code for flag in found["tarm", "position"].flags}
    stays = Trajectory(tarm.joint_names, np.array([0.0, 0.01]), tarm_path.q[[20, 20]], ("none",) * 2, ("", ""))
    targets = [tarm.rigid_pose(tarm_path.q[20] + turn) for turn in (0.0, 0.02)]
    flag = next(flag for flag in compensate(tarm, stays, targets=targets).flags if flag.code == "too_fast")
    assert re.search(r"^\w+ would move at \S+ times its speed limit at 0 s \(commanded path: 0 times\)$", flag.text)


def test_a_payload_that_cannot_be_held_where_it_is_gone_is_no_error(heavy: Arm) -> None:
    """Rows far apart: what was carried at the first is too heavy at the second, where it was never asked of the arm."""
    loaded = replace(heavy, payloads={**heavy.payloads, "huge": replace(heavy.payloads["p200"], mass=3e4)})
    held, stretched = [0.0, -0.6, 1.5, 0.0, 0.8, 0.0], [0.0, 1.2, 0.2, 0.0, 0.3, 0.0]
    path = Trajectory(heavy.joint_names, np.arange(2.0), np.array([held, stretched]), ("huge", "empty"), ("", ""))
    with pytest.raises(SmallDisplacementError):
        loaded.deflection(stretched, "huge")
    flag = next(one for one in compensate(loaded, path, best_effort=True).flags if one.code == "payload_change")
    assert "from huge to empty at 1 s the tip springs by an unknown amount" in flag.text


def test_a_path_that_is_too_fast_as_commanded_is_not_the_compensation_s_fault(tmp_path: Path) -> None:
    rigid = planar(tmp_path)
    rigid = replace(rigid, flexures=())
    path = Trajectory(
        rigid.joint_names, np.array([0.0, 0.1]), np.array([[0.1, 0.5], [0.6, 0.9]]), ("none",) * 2, ("",) * 2
    )
    assert compensate(rigid, path).flags == ()


@pytest.mark.slow
def test_inertial_loads_count(heavy: Arm, heavy_path: Trajectory) -> None:
    still = some_rows(heavy_path, 40)
    pushed = replace(still, v=np.zeros((1, 6)), a=np.array([[3.0, 2.0, -2.0, 0.0, 0.0, 0.0]]))
    result = compensate(heavy, pushed)
    pose = heavy.deflection(result.trajectory.q[0], "p200", v=pushed.v[0], a=pushed.a[0], method="newton").pose
    assert np.linalg.norm(pose.translation - heavy.rigid_pose(still.q[0]).translation) < 1e-9
    assert np.abs(result.rows[0].change - compensate(heavy, still).rows[0].change).max() > 1e-4
