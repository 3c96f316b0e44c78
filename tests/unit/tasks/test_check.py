"""`check`: verdicts against numbers worked out from `arm.deflection`, and nothing missed between the rows."""

import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from support.small_arms import ROBOTS, one_joint

from armflex import Arm, InputError, Measurements, Payload, Trajectory, check, compensate, load_arm, predict
from armflex.errors import ExtrapolationError, JointLimitError, NotFiniteError, Place, TableError
from armflex.estimate.posterior import without_declared_uncertainty
from armflex.estimate.tip_uncertainty import tip_covariance
from armflex.laws import AtNode, LinearLaw
from armflex.laws.joint.linear import LinearFit
from armflex.mechanics.deflection import length_sigma
from armflex.parameters import Certainty
from armflex.robot import Corrections
from armflex.tasks.check import Point
from armflex.trajectory import read_trajectory, write_trajectory

RANK = {"ok": 0, "uncertain": 1, "fail": 2}


def sizes(arm: Arm, q: np.ndarray, payload: str) -> tuple[float, float, float, float]:
    """Return the tip's shift and turn, and the standard uncertainty of each length by differencing the length."""
    found = arm.deflection(q, payload)
    out = []
    for part in (slice(0, 3), slice(3, 6)):
        vector, covariance = found.displacement[part], found.covariance[part, part]
        step = 1e-6 * np.linalg.norm(vector)
        slope = [
            (np.linalg.norm(vector + step * e) - np.linalg.norm(vector - step * e)) / (2 * step) for e in np.eye(3)
        ]
        out += [float(np.linalg.norm(vector)), float(np.sqrt(slope @ covariance @ slope))]
    return out[0], out[2], out[1], out[3]


def expected_verdict(limits: list[tuple[float, float, float]]) -> str:
    words = []
    for size, sigma, limit in limits:
        flagged = abs(limit - size) < 2.0 * sigma
        words.append("uncertain" if flagged else "fail" if size > limit else "ok")
    return max(words, key=RANK.get)


def two_rows(arm: Arm, start: list[float], end: list[float], payload: str = "none") -> Trajectory:
    return Trajectory(arm.joint_names, np.array([0.0, 1.0]), np.array([start, end]), (payload,) * 2, ("a", "b"))


@pytest.mark.parametrize("tolerance", [0.02, 0.035, 0.08, 0.1, 0.2])
@pytest.mark.parametrize("angle", [None, 0.003, 0.015, 0.05])
def test_via_points_against_the_deflection(
    tarm: Arm, tarm_path: Trajectory, tolerance: float, angle: float | None
) -> None:
    rows = [i for i, name in enumerate(tarm_path.via) if name]
    short = some_rows(tarm_path, rows)
    points = {point.name: point for point in check(tarm, short, tolerance, angle).via_points}
    assert len(points) == len(rows) == 8
    for i in rows:
        point = points[tarm_path.via[i]]
        shift, turn, sigma, sigma_turn = sizes(tarm, tarm_path.q[i], tarm_path.payload[i])
        np.testing.assert_allclose([point.displacement_m, point.rotation_rad], [shift, turn], rtol=1e-12)
        np.testing.assert_allclose(point.sigma_m, sigma, rtol=1e-6)
        np.testing.assert_allclose(point.margin_m, tolerance - shift, atol=1e-15)
        assert point.margin_rad == (None if angle is None else pytest.approx(angle - turn, abs=1e-15))
        asked = [(shift, sigma, tolerance)] + ([] if angle is None else [(turn, sigma_turn, angle)])
        assert point.verdict == expected_verdict(asked)
        assert (point.time, point.payload) == (tarm_path.time[i], tarm_path.payload[i])


def test_cause_is_the_largest_share(tarm: Arm, tarm_path: Trajectory, heavy: Arm, heavy_path: Trajectory) -> None:
    causes = set()
    for arm, path in ((tarm, tarm_path), (heavy, heavy_path)):
        for point in check(arm, path, 0.1).via_points:
            found = arm.deflection(path.q[list(path.time).index(point.time)], point.payload)
            along = found.displacement[:3] / np.linalg.norm(found.displacement[:3])
            shares = dict(zip(arm.flexure_names, found.contributions[:, :3] @ along, strict=True))
            assert point.cause == max(shares, key=shares.get)
            causes.add(point.cause)
    assert len(causes) > 1


@pytest.mark.slow
def test_worst_comes_first_and_the_whole_path_decides(tarm: Arm, tarm_path: Trajectory) -> None:
    report = check(tarm, tarm_path, 0.1)
    order = [(-RANK[point.verdict], point.margin_m) for point in report.via_points]
    assert order == sorted(order) and len({point.verdict for point in report.via_points}) == 3
    assert not report.ok and report.path_worst.displacement_m >= report.via_points[0].displacement_m
    assert report.path_worst.verdict == "fail" and len(report.segments) == len(tarm_path) - 1
    assert check(tarm, tarm_path, 1.0).ok
    flagged = check(tarm, tarm_path, 0.17)
    assert flagged.path_worst.verdict == "uncertain" and not flagged.ok


def quick(arm: Arm, q: np.ndarray, payload: str) -> tuple[float, float, float, float]:
    """Return shift, its uncertainty, turn, its uncertainty."""
    found = arm.deflection(q, payload)
    out: list[float] = []
    for part in (slice(0, 3), slice(3, 6)):
        vector = found.displacement[part]
        length = float(np.linalg.norm(vector))
        out += [length, float(np.sqrt(vector @ found.covariance[part, part] @ vector)) / length]
    return tuple(out)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tarm", "heavy"])
def test_finer_sampling_changes_no_verdict(name: str, request: pytest.FixtureRequest) -> None:
    """Against 48 samples of every stretch, at tolerances near and far from where verdicts change."""
    arm, path = request.getfixturevalue(name), request.getfixturevalue(f"{name}_path")
    path = some_rows(path, range(0, len(path), 8 if name == "tarm" else 4))
    fine = np.array(
        [
            [quick(arm, q, path.payload[i]) for q in path.between(np.full(49, i), np.linspace(0.0, 1.0, 49)).q]
            for i in range(len(path) - 1)
        ]
    )
    shift, most, least = fine[..., 0], fine[..., 0] + 2 * fine[..., 1], fine[..., 0] - 2 * fine[..., 1]
    near = [found.max() * factor for found in (shift, most, least) for factor in (1.0 - 1e-4, 1.0 + 1e-4)]
    seen = set()
    for tolerance in (0.3 * shift.max(), 0.8 * shift.max(), *near):
        for angle in (None, tolerance / 7.0):
            report = check(arm, path, tolerance, angle)
            for point, rows in zip(report.segments, fine, strict=True):
                words = [
                    expected_verdict([(*row[:2], tolerance)] + ([] if angle is None else [(*row[2:], angle)]))
                    for row in rows
                ]
                assert point.verdict == max(words, key=RANK.get), (point, tolerance, angle)
                seen.add(point.verdict)
            highest = max(point.displacement_m for point in report.segments)
            assert highest == pytest.approx(shift.max(), abs=0.01 * max(tolerance, shift.max()))
    assert seen == set(RANK)


def some_rows(path: Trajectory, rows: Sequence[int]) -> Trajectory:
    rows = list(rows)
    names = [tuple(getattr(path, name)[i] for i in rows) for name in ("payload", "via")]
    return Trajectory(path.joint_names, path.time[rows], path.q[rows], *names)


def largest_sag(arm: Arm) -> float:
    """Return the most that a one-joint arm's tip moves near the horizontal."""
    found = minimize_scalar(
        lambda q: -np.linalg.norm(arm.deflection([q]).displacement[:3]), bounds=(-0.1, 0.1), options={"xatol": 1e-8}
    )
    return float(-found.fun)


@pytest.mark.parametrize("above", [3e-4, 3e-5, 3e-6])
@pytest.mark.parametrize("peak", [0.5, 0.37, 0.61803, 0.9])
def test_tolerance_just_below_and_above_the_peak(tmp_path: Path, above: float, peak: float) -> None:
    """One joint about y swings through the horizontal, where it sags most, at a fraction that no sample need hit."""
    arm = one_joint(tmp_path, np.diag([0, 0, 0, 0, 1e-4, 0]), (0.8, 0.0, 0.0), 10.0)
    path = two_rows(arm, [-0.9 * peak], [0.9 * (1.0 - peak)])
    most = largest_sag(arm)
    assert check(arm, path, most * (1.0 + above)).ok
    report = check(arm, path, most * (1.0 - above))
    assert not report.ok and report.segments[0].verdict == "fail" and report.samples < 5000


def test_uncertain_just_inside_two_sigma(tmp_path: Path) -> None:
    arm = one_joint(tmp_path, LinearLaw(np.diag([0, 0, 0, 0, 1e-4, 0]), 0.1), (0.8, 0.0, 0.0), 10.0)
    shift, _, sigma, _ = sizes(arm, np.zeros(1), "none")
    path = two_rows(arm, [-0.3], [0.7])
    for factor, verdict in ((2.001, "ok"), (1.999, "uncertain"), (-1.999, "uncertain"), (-2.001, "fail")):
        assert check(arm, path, shift + factor * sigma).segments[0].verdict == verdict, factor


def test_via_points_pass_where_the_path_between_fails(tmp_path: Path) -> None:
    arm = one_joint(tmp_path, np.diag([0, 0, 0, 0, 1e-4, 0]), (0.8, 0.0, 0.0), 10.0)
    report = check(arm, two_rows(arm, [-1.2], [1.3]), 0.004)
    assert [point.verdict for point in report.via_points] == ["ok", "ok"] and not report.ok
    worst = report.path_worst
    assert (worst.name, worst.verdict) == ("", "fail") and worst == report.segments[0]
    assert worst.displacement_m == pytest.approx(largest_sag(arm), rel=0.01) and abs(worst.time - 1.2 / 2.5) < 0.05


@pytest.mark.parametrize("turns", [1, 2, 4, 8])
def test_whole_turns_between_rows_hide_nothing(tmp_path: Path, turns: int) -> None:
    """At every row, and at many even fractions between, the link hangs or stands and hardly sags."""
    arm = one_joint(tmp_path, np.diag([0, 0, 0, 0, 1e-4, 0]), (0.8, 0.0, 0.0), 10.0)
    joint = replace(arm.robot.moving[0], lower=-30.0, upper=30.0)
    chain = tuple(joint if one.name == "j" else one for one in arm.robot.chain)
    arm = replace(arm, robot=replace(arm.robot, chain=chain))
    report = check(arm, two_rows(arm, [-np.pi / 2.0], [(turns - 0.5) * np.pi]), 0.004)
    assert {point.verdict for point in report.via_points} == {"ok"}
    assert not report.ok and report.path_worst.displacement_m == pytest.approx(largest_sag(arm), rel=0.01)


def test_payload_holds_until_the_row_that_drops_it(tarm: Arm, tarm_path: Trajectory) -> None:
    release = next(i for i in range(1, len(tarm_path)) if tarm_path.payload[i] != tarm_path.payload[i - 1])
    path = some_rows(tarm_path, range(release - 1, release + 1))
    segment = check(tarm, path, 0.1).segments[0]
    carried = [np.linalg.norm(tarm.deflection(q, path.payload[0]).displacement[:3]) for q in path.q]
    assert segment.payload == path.payload[0] and segment.displacement_m >= max(carried) * (1 - 1e-12)


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_angle_alone_can_fail(heavy: Arm, heavy_path: Trajectory) -> None:
    wide = check(heavy, heavy_path, 1.0)
    assert wide.ok and wide.angle_rad is None and all(point.margin_rad is None for point in wide.via_points)
    narrow = check(heavy, heavy_path, 1.0, 1e-3)
    assert not narrow.ok and {point.verdict for point in narrow.via_points} == {"fail"}
    assert all(point.margin_m > 0.9 and point.margin_rad < 0.0 for point in narrow.via_points)


def test_rigid_arm_keeps_every_tolerance(tarm: Arm, tarm_path: Trajectory) -> None:
    report = check(replace(tarm, flexures=()), some_rows(tarm_path, range(0, 5)), 1e-9)
    assert report.ok and {point.displacement_m for point in report.segments} == {0.0}
    assert {(point.cause, point.sigma_m) for point in report.segments} == {(None, None)}


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan])
def test_tolerance_must_be_positive(tarm: Arm, tarm_path: Trajectory, bad: float) -> None:
    for limits in ((bad, None), (0.1, bad)):
        with pytest.raises(InputError, match="tolerance must be positive"):
            check(tarm, tarm_path, *limits)


def test_errors_name_row_and_time(tarm: Arm, tarm_path: Trajectory) -> None:
    q = tarm_path.q.copy()
    q[59, 3] = np.nan
    with pytest.raises(NotFiniteError, match=r"trajectory\.csv:61: row 59 \(port_exit\) at 59 s: q of joint 'A3'"):
        check(tarm, replace(tarm_path, q=q), 0.1)


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_what_no_tolerance_allows_fails_with_its_reason(tarm: Arm, tarm_path: Trajectory, tmp_path: Path) -> None:
    q = tarm_path.q.copy()
    q[59, 3] = 9.0
    point = next(p for p in check(tarm, replace(tarm_path, q=q), 10.0).via_points if p.name == "port_exit")
    assert point.verdict == "fail" and point.reason.startswith("joint 'A3' at 9 is outside")
    soft = one_joint(tmp_path, np.diag([0, 0, 0, 0, 5e-3, 0]), (0.8, 0.0, 0.0), 10.0)
    worst = check(soft, two_rows(soft, [1.57], [0.0]), 10.0).path_worst
    assert worst.verdict == "fail" and worst.reason.startswith("flexure 'j' turns")


@pytest.mark.filterwarnings("ignore:near_buckling:armflex.ArmflexWarning")
@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_a_path_near_buckling_is_flagged_with_the_least_load_factor(tmp_path: Path) -> None:
    """Upright at 0.8 of the critical load: k / (m g l) is 1.25, leaning it is more."""
    soft = one_joint(tmp_path, np.diag([0, 0, 0, 0, 0.8 / (10.0 * 9.81 * 0.8), 0]), (0.0, 0.0, 0.8), 10.0)
    report = check(soft, two_rows(soft, [0.0], [0.01]), 0.1)
    assert report.load_factor == pytest.approx(1.25, rel=1e-6)
    flag = next(flag for flag in report.flags if flag.code == "near_buckling")
    assert "buckle under 1.25 times its loads" in flag.text
    assert check(soft, two_rows(soft, [1.5], [1.52]), 0.1).load_factor == np.inf


def test_flags_carry_their_time(tarm: Arm, tarm_path: Trajectory) -> None:
    heavy_loaded = replace(tarm, payload_rating=500.0)
    flag = next(flag for flag in check(heavy_loaded, tarm_path, 0.1).flags if flag.code == "beyond_rating")
    assert flag.text.startswith("at 0 s: payload of 600 kg")


def test_progress_counts_the_stretches(heavy: Arm, heavy_path: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["armflex.tasks.check"], "TOGETHER", 2)
    seen: list[tuple[int, int]] = []
    check(heavy, some_rows(heavy_path, range(0, 4)), 0.1, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(2, 3), (3, 3)]
    assert isinstance(check(heavy, some_rows(heavy_path, range(0, 1)), 0.1).path_worst, Point)


FORCES_ALONE = LinearLaw(
    np.diag([1e-7, 1e-7, 1e-7, 0.0, 0.0, 0.0]),
    fit=LinearFit(np.zeros((3, 3, 3)), np.zeros(3), np.array([[-1e4] * 3, [1e4] * 3])),
)


@pytest.mark.parametrize("law", [FORCES_ALONE, AtNode(FORCES_ALONE, np.array([0.2, 0.0, 0.0]))])
@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_a_law_of_forces_alone_says_that_it_does_not_turn(tmp_path: Path, law: LinearLaw | AtNode) -> None:
    """Upright, the weight goes straight through the joint and there is no moment to be silent about."""
    soft = one_joint(tmp_path, np.zeros((6, 6)), (0.8, 0.0, 0.0), 10.0)
    arm = replace(soft, flexures=(replace(soft.flexures[0], law=law),))
    flags = [arm.deflection(q).flags for q in ([0.0], [0.4])]
    assert [flag.code for flag in flags[0]] == ["does_not_turn"] and flags[0] == flags[1]  # said once of all rows
    assert "does_not_turn" in {flag.code for flag in check(arm, two_rows(arm, [0.0], [0.1]), 0.1).flags}
    assert not arm.deflection([np.pi / 2]).flags
    for q in ([0.0], [[0.0], [0.1]]):
        with pytest.raises(ExtrapolationError, match="does not turn"):
            arm.deflection(q, strict=True)


def test_stretches_are_judged_alike_together_and_one_by_one(
    heavy: Arm, heavy_path: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = some_rows(heavy_path, range(0, 12))
    together = check(heavy, path, 0.005)
    monkeypatch.setattr(sys.modules["armflex.tasks.check"], "TOGETHER", 1)
    assert check(heavy, path, 0.005) == together


@pytest.mark.filterwarnings("ignore:tolerance_angle:armflex.ArmflexWarning")
def test_what_a_fit_does_not_know_is_part_of_the_verdict(heavy: Arm, heavy_path: Trajectory) -> None:
    """Joint offsets alone, of which differences of the arm's own displacement tell the uncertainty."""
    names, std, path = heavy.joint_names, 2e-4, some_rows(heavy_path, range(0, 3))
    labels = tuple(f"joint_offset {name}" for name in names)
    exact = replace(heavy, flexures=tuple(replace(f, law=replace(f.law, relative_std=0.0)) for f in heavy.flexures))
    fitted = replace(exact, certainty=Certainty(exact.named(labels), np.diag(np.full(6, std**2))))
    assert all(point.sigma_m is None for point in check(exact, path, 0.1).via_points)
    report = check(fitted, path, 0.1, 0.1)
    point, step = next(one for one in report.via_points if one.time == path.time[0]), 1e-5

    def length(name: str, by: float) -> float:
        moved = replace(exact, corrections=Corrections(joint_offset={name: by}))
        return float(np.linalg.norm(moved.deflection(path.q[0], path.payload[0]).displacement[:3]))

    slopes = [(length(name, step) - length(name, -step)) / (2.0 * step) for name in names]
    assert point.sigma_m == pytest.approx(std * np.linalg.norm(slopes), rel=1e-4)
    tight = check(fitted, path, point.displacement_m + 1.9 * point.sigma_m)
    wide = check(fitted, path, point.displacement_m + 2.1 * point.sigma_m)
    verdicts = [next(one for one in r.via_points if one.time == path.time[0]).verdict for r in (tight, wide)]
    assert verdicts == ["uncertain", "ok"] and not tight.ok


def test_a_fit_s_and_the_laws_uncertainty_are_those_of_predict(heavy: Arm, heavy_path: Trajectory) -> None:
    """In the base's frame and of the tip itself the instrument has no part."""
    labels = ("joint_offset", "compliance")
    names = [[*heavy.joint_names], [f"{heavy.flexures[1].name} {axis}" for axis in ("rx", "ry")]]
    labels = tuple(f"{block} {name}" for block, some in zip(labels, names, strict=True) for name in some)
    root = np.random.default_rng(1).normal(size=(8, 8)) * np.array([[1e-4]] * 6 + [[0.1]] * 2)
    arm = replace(heavy, certainty=Certainty(heavy.named(labels), root @ root.T))
    rows = some_rows(heavy_path, range(0, 5))
    found, _ = tip_covariance(
        without_declared_uncertainty(arm),
        rows.q,
        rows.payload,
        {},
        without_declared_uncertainty(arm).deflection(rows.q, list(rows.payload)).covariance,
    )
    count = len(rows)
    asked = Measurements(
        joint_names=arm.joint_names, pose=tuple("abcde"), session=("s",) * count, payload=rows.payload,
        time=rows.time, q=rows.q, approach=np.zeros(rows.q.shape), measured=np.zeros(count, dtype=bool),
        position=np.zeros((count, 3)), rotation=None, sigma=np.ones((count, 3)), sigma_r=None, hold=None,
        covariates={}, places=tuple(Place(Path("rows.csv"), i + 2) for i in range(count)),
    )  # fmt: skip
    expected = predict(arm, asked).sigma
    np.testing.assert_allclose(np.sqrt(np.diagonal(found, axis1=1, axis2=2)[:, :3]), expected, rtol=1e-9)
    points = {point.time: point for point in check(arm, replace(rows, via=tuple("abcde")), 0.1).via_points}
    for i, time in enumerate(rows.time):
        shift = heavy.deflection(rows.q[i], rows.payload[i]).displacement[:3]
        along = shift / np.linalg.norm(shift)
        assert points[time].sigma_m == pytest.approx(np.sqrt(along @ found[i, :3, :3] @ along), rel=1e-9)


def test_columns_in_another_order_mean_the_same(tarm, tarm_path):
    order = [6, 2, 0, 5, 1, 3, 4]
    names = tuple(tarm_path.joint_names[i] for i in order)
    shuffled = replace(tarm_path, joint_names=names, q=tarm_path.q[:, order])
    assert check(tarm, shuffled, 0.1) == check(tarm, tarm_path, 0.1)
    strange = replace(tarm_path, joint_names=("B1", *tarm_path.joint_names[1:]))
    with pytest.raises(InputError, match="B1"):
        check(tarm, strange, 0.1)


def test_one_bad_row_does_not_hide_the_others(tarm, tarm_path):
    q = tarm_path.q.copy()
    q[5, 2], q[70, 3] = 0.4, 1.8
    report = check(tarm, replace(tarm_path, q=q), 1.0)
    reasons = {point.reason for point in report.segments if point.reason}
    assert not report.ok and report.path_worst.verdict == "fail"
    assert any("'A2'" in reason for reason in reasons) and any("'A3'" in reason for reason in reasons)


@pytest.mark.slow
def test_a_drive_beyond_its_limit_is_flagged(tarm, tarm_path):
    heavier = replace(tarm, payloads=dict(tarm.payloads, p600=Payload(2500.0, np.zeros(3))))
    flags = {flag.code: flag.text for flag in check(heavier, tarm_path, 1.0).flags}
    assert "'A2' carries" in flags["beyond_effort"]
    assert "beyond_effort" not in {flag.code for flag in check(tarm, tarm_path, 1.0).flags}


def test_flags_are_about_the_worst_row_and_say_where(tarm: Arm, tarm_path: Trajectory) -> None:
    """Of drives, of joints beyond a limit and of a tip that sags, whatever comes first."""
    masses = {f"p{mass}": Payload(float(mass), np.zeros(3)) for mass in (6000, 9000, 7000)}
    rows = Trajectory(tarm.joint_names, np.arange(3.0), tarm_path.q[[70] * 3], tuple(masses), ("",) * 3)
    rows.q[:, tarm.joint_names.index("A6")] = tarm.robot.moving[-1].upper + np.array([0.1, 0.3, 0.2])
    report = check(replace(tarm, payloads=masses, payload_rating=1.0), rows, 1.0)
    flags = {flag.code: flag for flag in report.flags}
    for code in ("beyond_effort", "outside_limits", "beyond_rating"):
        assert flags[code].text.startswith("at 1 s: "), flags[code]
    worst = tarm.deflection(rows.q[1], masses["p9000"], enforce_limits=False, allow_large=True)
    assert flags["beyond_effort"].text == f"at 1 s: {worst.overload[0].text}"


def test_joints_faster_than_their_limits_are_flagged_by_the_times_or_speeds_of_rows(tmp_path: Path) -> None:
    """One stretch of 0.1 s at twice the limit; then one at half of it whose rows state a speed beyond it."""
    arm = one_joint(tmp_path, np.zeros((6, 6)), (0.5, 0, 0))
    limit = arm.robot.moving[0].velocity
    q = limit * np.array([[0.0], [0.2], [0.25]])
    path = Trajectory(arm.joint_names, np.array([0.0, 0.1, 0.2]), q, ("none",) * 3, ("a", "", "b"))
    (flag,) = [flag for flag in check(arm, path, 1e-3).flags if flag.code == "speed_limit"]
    assert flag.text.startswith(f"from 0 to 0.1 s {arm.joint_names[0]} moves at 2 times its speed limit of {limit:g} ")
    stated = replace(path, q=q / 4.0, v=np.full((3, 1), 1.5 * limit), a=np.zeros((3, 1)))
    assert "at 1.5 times" in next(flag.text for flag in check(arm, stated, 1e-3).flags if flag.code == "speed_limit")
    slow = replace(path, time=10.0 * path.time)
    assert "speed_limit" not in {flag.code for flag in check(arm, slow, 1e-3).flags}


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_rotation_is_ranked_and_blamed_where_it_is_worse(tarm, tarm_path):
    report = check(tarm, tarm_path, 10.0, angle=0.01)
    margins = [point.margin_rad for point in report.via_points]
    assert margins == sorted(margins)
    worst = report.path_worst
    found = tarm.deflection(tarm_path.q[list(tarm_path.time).index(worst.time)], worst.payload)
    along = found.contributions[:, 3:] @ found.displacement[3:]
    assert worst.cause == tarm.flexure_names[int(np.argmax(along))]


def test_a_step_that_no_path_takes_is_refused_at_once(tarm: Arm, tmp_path: Path) -> None:
    """A thousand metres took ten thousand configurations, each halved ten times."""
    rest = ",0" * (len(tarm.joint_names) - 1)
    header = "time," + ",".join(f"q_{name}" for name in tarm.joint_names)
    file = tmp_path / "t.csv"
    file.write_text(f"{header}\n0,1{rest}\n1,2{rest}\n2,3{rest}\n3,2{rest}\n")
    path, began = read_trajectory(file, tarm), process_time()
    path.q[2, 0] = 1e3  # which a file's reader would take for millimetres
    words = r"joint 'M1' goes from 2 to 1000 m in one step, more than 102\.4 m; limits \[0, 6\] m"
    with pytest.raises(InputError, match=rf"^{re.escape(str(file))}:4: row 2 at 2 s: {words}"):
        check(tarm, path, 0.1)
    with pytest.raises(InputError, match=rf"^row 2 at 2 s: {words}"):
        check(tarm, replace(path, places=()), 0.1)
    assert process_time() - began < 1.0


def test_a_path_far_outside_its_limits_still_ends(tarm: Arm) -> None:
    rows = np.zeros((2, len(tarm.joint_names)))
    rows[:, 0] = (2.0, 12.0)
    report = check(tarm, two_rows(tarm, *rows.tolist()), 0.2)
    assert report.samples < 5000 and not report.ok and "'M1'" in report.path_worst.reason


def test_a_path_against_itself_is_the_plain_check(heavy: Arm, heavy_path: Trajectory) -> None:
    path = some_rows(heavy_path, range(0, 14))
    plain, against = (check(heavy, path, 0.005, 0.005, against=one) for one in (None, path))
    assert [point.name for point in plain.via_points] == [point.name for point in against.via_points]
    for one, other in zip((*plain.rows, plain.path_worst), (*against.rows, against.path_worst), strict=True):
        assert (one.verdict, one.cause, one.time) == (other.verdict, other.cause, other.time)
        assert other.displacement_m == pytest.approx(one.displacement_m, rel=1e-12)
        assert other.rotation_rad == pytest.approx(one.rotation_rad, rel=1e-9)
        assert other.sigma_m == pytest.approx(one.sigma_m, rel=0.05)  # more than first order


def test_a_compensated_path_is_where_it_was_meant(heavy: Arm, heavy_path: Trajectory) -> None:
    path = some_rows(heavy_path, range(0, 10))
    found = compensate(heavy, path)
    report = check(heavy, found.trajectory, 1e-3, against=path)
    assert max(point.displacement_m for point in report.rows) < 1e-9
    assert max(point.displacement_m for point in report.segments) == pytest.approx(found.between_m, rel=0.2)
    for point, row in zip(report.rows, found.rows, strict=True):
        covariance = heavy.deflection(path.q[0] + row.change, path.payload[0]).covariance  # near by, for the size
        assert point.sigma_m == pytest.approx(row.sigma_m, rel=1e-6)
        assert point.sigma_m == pytest.approx(np.sqrt(np.trace(covariance[:3, :3])), rel=0.3)
    sigma = max(point.sigma_m for point in report.rows)
    assert check(heavy, found.trajectory, 2.2 * sigma, against=path).ok
    doubtful = check(heavy, found.trajectory, 1.8 * sigma, against=path)
    assert not doubtful.ok and doubtful.path_worst.verdict == "uncertain"


def test_against_is_the_way_between_two_tips(tarm: Arm, tarm_path: Trajectory) -> None:
    """Columns in another order, and a rigid arm that is told to be elsewhere: at the rows and halfway between them."""
    rigid, path = replace(tarm, flexures=()), some_rows(tarm_path, range(0, 5))
    order = [3, 0, 6, 1, 2, 4, 5]
    moved = path.q + 0.01 * np.arange(5)[:, None]
    desired = replace(path, q=moved[:, order], joint_names=tuple(path.joint_names[i] for i in order))
    report = check(rigid, path, 0.1, against=desired)
    tips = [[rigid.rigid_pose(q).translation for q in one] for one in (path.q, moved)]
    expected = np.linalg.norm(np.array(tips[0]) - tips[1], axis=1)
    np.testing.assert_allclose([point.displacement_m for point in report.rows], expected, rtol=1e-9)
    assert report.rows[0].displacement_m < 1e-12 and all(point.sigma_m is None for point in report.rows)
    assert [point.displacement_m for point in report.segments] == pytest.approx(expected[1:], rel=0.01)


def test_a_desired_path_of_other_rows_is_refused(heavy: Arm, heavy_path: Trajectory) -> None:
    path = some_rows(heavy_path, range(0, 12))
    at = next(i for i, name in enumerate(path.via) if name and i)
    wrong = {
        r"desired path has 11 rows, this one has 12 \(`compensate --between` inserts": some_rows(path, range(11)),
        r"desired path has 12 rows, this one has 11$": None,
        r"row 3 of the desired path is at 0\.7 s, this one's at 0\.6 s": replace(
            path, time=np.where(np.arange(12) == 3, 0.7, path.time)
        ),
        rf"row {at} of the desired path is via-point '', this one's is '{path.via[at]}'": replace(
            path, via=tuple("" if i == at else name for i, name in enumerate(path.via))
        ),
        "the desired path is of joints a, J2": replace(path, joint_names=("a", *path.joint_names[1:])),
    }
    for complaint, desired in wrong.items():
        given, meant = (path, desired) if desired is not None else (some_rows(path, range(11)), path)
        with pytest.raises(InputError, match=complaint):
            check(heavy, given, 0.1, against=meant)
    far = replace(path, q=np.where(np.arange(12)[:, None] == 4, path.q + 9.0, path.q))
    with pytest.raises(JointLimitError, match="row 4 of the desired path: joint 'J2'"):
        check(heavy, path, 0.1, against=far)


def test_a_short_vector_s_length_is_as_uncertain_as_normal_deviations_make_it() -> None:
    """The root mean square of |x + d| - |x|, by drawing d, whether x is short or long."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(3, 3)) * [[1.0], [0.4], [0.1]]
    deviations = rng.normal(size=(200_000, 3)) @ root.T
    for length in (0.0, 0.3, 1.0, 2.0, 20.0):
        vector = length * np.array([0.36, 0.48, 0.8])
        drawn = np.linalg.norm(vector + deviations, axis=1) - length
        sigma = length_sigma(vector[None], (root @ root.T)[None], short=True)[0]
        assert sigma == pytest.approx(np.sqrt(np.mean(drawn**2)), rel=0.1 if length else 0.01)
    long = 300.0 * vector[None], (root @ root.T)[None]
    assert length_sigma(*long, short=True) == pytest.approx(length_sigma(*long), rel=1e-4)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_what_nothing_determines_makes_every_verdict_uncertain(heavy: Arm, heavy_path: Trajectory) -> None:
    path, labels = some_rows(heavy_path, range(0, 4)), tuple(f"joint_offset {name}" for name in heavy.joint_names)
    known = Certainty(heavy.named(labels), np.diag(np.full(6, 1e-8)), directions=np.eye(6)[:1])
    blind = replace(heavy, certainty=known)
    report = check(blind, path, 10.0)
    assert all(np.isinf(point.sigma_m) and point.verdict == "uncertain" for point in report.rows) and not report.ok
    assert "undetermined" in [flag.code for flag in report.flags]
    found = compensate(blind, path)
    assert np.isinf(found.remains_m[1]) and "undetermined" in [flag.code for flag in found.flags]
    exact = tuple(replace(one, law=replace(one.law, relative_std=0.0)) for one in heavy.flexures)
    nobody = compensate(replace(heavy, flexures=exact), path)
    assert nobody.remains_m[1] is None and "no_uncertainty" in [flag.code for flag in nobody.flags]


@pytest.mark.slow
def test_the_worst_of_the_path_has_the_name_of_its_row() -> None:
    """Also where a stretch that ends there is worse in the last digit."""
    arm = load_arm(ROBOTS / "palletizer" / "arm.toml")
    report = check(arm, read_trajectory(ROBOTS / "palletizer" / "trajectory.csv", arm), tolerance=5e-3)
    assert (report.path_worst.name, report.path_worst.time) == ("place", 4.0)
    assert min(point.badness for point in report.segments) == pytest.approx(report.path_worst.badness, abs=1e-9)


def test_every_row_has_the_tolerance_of_its_own_cell(tarm: Arm, tarm_path: Trajectory, tmp_path: Path) -> None:
    rows = [i for i, name in enumerate(tarm_path.via) if name][:3]
    short = some_rows(tarm_path, rows)
    file = write_trajectory(replace(short, tolerance=np.array([0.02, np.nan, 0.3])), tmp_path / "path.csv")
    file.write_text(
        file.read_text().replace("tolerance", "tolerance_mm").replace(",0.02", ",20").replace(",0.3", ",300")
    )
    path = read_trajectory(file, tarm)
    assert "tolerance" not in path.covariates
    report = check(tarm, path, tolerance=0.08)
    assert [row.tolerance_m for row in report.rows] == pytest.approx([0.02, 0.08, 0.3])
    assert report.tolerance_m == 0.08
    assert report.asked == "20 to 300 mm, by row"
    for row in report.rows:
        assert row.margin_m == pytest.approx(row.tolerance_m - row.displacement_m, abs=1e-15)
    later = replace(short, q=short.q[[0, 0]], tolerance=np.array([0.02, 0.06]), **first_two(short))
    (between,) = check(tarm, later).segments
    fraction = (between.time - later.time[0]) / (later.time[1] - later.time[0])
    assert between.tolerance_m == pytest.approx(0.02 + 0.04 * fraction)  # linear between rows
    assert check(tarm, later).tolerance_m == 0.02
    with pytest.raises(InputError, match=r"path.csv:3: row 1 .* has no tolerance: give one for such rows"):
        check(tarm, path)
    file.write_text(file.read_text().replace(",300", ",-300"))
    with pytest.raises(TableError, match=r"path.csv:4: tolerance is -0.3 m, expected more than 0"):
        read_trajectory(file, tarm)


def first_two(path: Trajectory) -> dict:
    return {"time": path.time[:2], "payload": path.payload[:2], "via": path.via[:2], "places": ()}


def test_a_stretch_that_fails_at_its_end_alone_says_that_the_payload_changes_there(tmp_path: Path) -> None:
    arm = one_joint(tmp_path, np.diag([0, 0, 0, 0, 1e-4, 0]), (0.8, 0.0, 0.0), 10.0)
    arm, q = replace(arm, payloads={"p300": Payload(30.0, np.zeros(3))}), arm.position()
    path = Trajectory(arm.joint_names, np.array([0.0, 5.0]), np.array([q, q]), ("p300", "none"), ("a", "b"))
    loaded, free = (float(np.linalg.norm(arm.deflection(q, name).displacement[:3])) for name in ("p300", "none"))
    report = check(arm, replace(path, tolerance=np.array([9.0 * loaded, 0.5 * (loaded + free)])))
    assert [row.verdict for row in report.via_points] == ["ok", "ok"]
    assert (report.path_worst.verdict, report.path_worst.time, report.path_worst.payload) == ("fail", 5.0, "p300")
    (text,) = [flag.text for flag in report.flags if flag.code == "payload_change"]
    assert text == (
        "at 5 s the payload changes from p300 to none; until there the path has p300, with which it is "
        f"{loaded * 1e3:.4g} mm off there"
    )
