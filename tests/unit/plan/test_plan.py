"""What to measure next: the mathematics against brute force, the rows against their limits, the promise kept."""

import json
import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from studies import planned
from studies.planned import SIGMA, Machine, declared, rival_study, written
from support.command_line import Run, few_rows, fine, strict_json
from support.instruments import ACCELERATION, ENCODER, LEVEL, heavy
from support.small_arms import ROBOTS, random_compliance, three_joints

from armflex import Arm, InputError, Measurements, load_arm, plan, predict, read_measurements, write_plan
from armflex.arm import Measurement, Prior
from armflex.errors import UnknownNameError, UnsupportedError
from armflex.estimate import Calibration, calibrate
from armflex.files.effect_file import locations_on
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.context import Records
from armflex.laws.effects.effect import Afterwards, Effect
from armflex.laws.effects.location import Location
from armflex.laws.learned import Learning
from armflex.linear_gaussian import LinearGaussian
from armflex.plan.design import DsOptimal, Goal, IOptimal, TOptimal, Truth, exchanged, greedy, instead, path, shows
from armflex.plan.drive import driving_order, motion
from armflex.plan.effects_in_question import named_effect, spelled
from armflex.plan.instruments import informing_levels, unlike
from armflex.plan.picture import draw_plan
from armflex.plan.planned_rows import Plan
from armflex.readings.instrument import Instrument
from armflex.rows import Rows

BOOM = ROBOTS / "tarm_like" / "measured.toml"
P, OWN = 7, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.0, -1.0])


def problem(seed: int, count: int = 9) -> tuple[LinearGaussian, np.ndarray]:
    """Return what is known of P parameters and rows (N, 3, P) of very different sizes."""
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-3.0, 3.0, P)
    measured = rng.normal(size=(30, P)) * scale
    return LinearGaussian.of(measured, np.ones(P)), rng.normal(size=(count, 3, P)) * scale


def goals() -> list[Goal]:
    weight = np.random.default_rng(5).normal(size=(4, P))
    one, other = Truth(OWN, np.arange(5)), Truth(np.eye(P)[4], np.array([0, 1, 2, 3, 5, 6]))
    return [DsOptimal(np.array([1, 3, 4])), IOptimal(weight.T @ weight), TOptimal((one,)), TOptimal((one, other))]


@pytest.mark.parametrize("number", range(4))
@pytest.mark.parametrize("seed", range(3))
def test_a_gain_is_what_the_goal_rises_by(number: int, seed: int) -> None:
    goal, (known, rows) = goals()[number], problem(seed)
    rises = [goal.value(known.with_rows(row)) - goal.value(known) for row in rows]
    np.testing.assert_allclose(goal.gains(known, rows), rises, rtol=1e-6, atol=1e-9 * abs(goal.value(known)))


@pytest.mark.parametrize("seed", range(3))
def test_the_chi_square_between_effects_is_that_of_a_least_squares_fit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    measured = rng.normal(size=(40, P))
    truth = Truth(OWN, np.arange(5))
    target, others = measured @ OWN, np.vstack([measured[:, :5], np.eye(5)])  # priors as rows of their own
    left = np.linalg.lstsq(others, np.concatenate([target, np.zeros(5)]), rcond=None)[1][0]
    known = LinearGaussian.of(measured, np.array([1.0] * 5 + [0.0] * 2))
    assert truth.apart(known, np.zeros((0, 1, P)))[0] == pytest.approx(left, rel=1e-9)


@pytest.mark.parametrize("degree, places", [(1, (-1.0, 1.0)), (2, (-1.0, 0.0, 1.0)), (3, (-1.0, -0.44, 0.44, 1.0))])
def test_a_polynomial_is_measured_where_theory_says(degree: int, places: Sequence[float]) -> None:
    """D-optimal for a polynomial: the ends and the extremes of a Legendre polynomial, equally often (Guest 1958)."""
    x = np.repeat(np.round(np.linspace(-1.0, 1.0, 51), 2), 4)  # 0.44 for 1/sqrt(5) = 0.447
    rows = (x[:, None] ** np.arange(degree + 1))[:, None, :]
    goal, known = DsOptimal(np.arange(degree + 1)), LinearGaussian(1e-6 * np.eye(degree + 1))
    chosen = exchanged(goal, known, rows, greedy(goal, known, rows, 4 * len(places)), 20)
    assert len(set(chosen)) == 4 * len(places)
    assert sorted(x[chosen].tolist()) == sorted(np.repeat(places, 4).tolist())


def test_exchanges_never_lose_and_end_where_none_helps() -> None:
    known, rows = problem(1, 40)
    for goal in goals():
        first = greedy(goal, known, rows, 6)
        chosen = exchanged(goal, known, rows, first, 50)
        best = goal.value(known.with_rows(rows[chosen]))
        begun = goal.value(known.with_rows(rows[first]))
        assert best >= begun - 1e-9 * abs(begun)
        for place in range(6):
            for other in set(range(40)) - set(chosen):
                swapped = [*chosen[:place], other, *chosen[place + 1 :]]
                assert goal.value(known.with_rows(rows[swapped])) <= best + 1e-5 * abs(best)
        assert path(goal, known, rows[chosen])[-1] == pytest.approx(best)


@pytest.mark.parametrize("seed", range(5))
def test_the_way_is_near_the_shortest_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, start, span = rng.uniform(-1.0, 1.0, (7, 3)), np.zeros(3), np.array([1.0, 2.0, 0.5])
    order = driving_order(q, [0] * 7, start, span)
    assert sorted(order) == list(range(7))
    shortest = min(motion(q[list(way)], start, span) for way in permutations(range(7)))
    assert motion(q[order], start, span) < 1.12 * shortest


def test_rows_of_a_group_stay_together() -> None:
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 2))
    order = driving_order(q, [i % 3 for i in range(12)], np.zeros(2), np.ones(2))
    assert [i % 3 for i in order] == [0] * 4 + [1] * 4 + [2] * 4


@pytest.fixture(scope="module")
def six() -> Arm:
    return declared("six")


@pytest.fixture(scope="module")
def found(six: Arm) -> Plan:
    return plan(six, 12, sigma=SIGMA)


@pytest.fixture(scope="module")
def told(six: Arm) -> Plan:
    return plan(six, 8, between=("backlash:J2", "friction_windup:J2"), sigma=SIGMA, payloads=("empty", "p120"))


@pytest.mark.slow
def test_a_calibration_with_the_rows_is_as_certain_as_was_promised(six: Arm, found: Plan, tmp_path: Path) -> None:
    """On a machine whose joints, tool and instrument are not those that were planned with."""
    machine = Machine.draw("six", 4)
    campaign = machine.measure(tmp_path / "m.csv", written(six, found, tmp_path), 4)
    fitted = calibrate(six, read_measurements(campaign, six))
    promised = dict(zip(found.model.names, found.std_after, strict=True))
    ratios = [p.std / promised[p.name] for p in fitted.parameters if p.block in ("joint_offset", "compliance", "tool")]
    assert len(ratios) == 45 and np.median(ratios) == pytest.approx(1.0, abs=0.05)
    assert min(ratios) > 0.6 and max(ratios) < 1.6
    prior = {p.name: p.prior for p in fitted.parameters}
    before = dict(zip(found.model.names, found.std_before, strict=True))
    assert all(before[name] == pytest.approx(prior[name]) for name in prior if np.isfinite(prior[name]))


@pytest.mark.slow
def test_half_as_many_readings_as_at_random() -> None:
    """The whole study is `python tests/studies/planned.py`."""
    came = planned.certainty_study("boom", 12, 1, (2.0,))
    assert came[0.0].certainty < came[2.0].certainty
    along = planned.certainty_study("boom", 20, 1, (2.0,), along=True)
    assert along[0.0].stated < along[2.0].stated


@pytest.mark.slow
def test_rivals_are_told_apart_with_a_third_of_the_readings() -> None:
    odds, at_chance = rival_study("six", ("encoder_scale:J2", "stiffening:J2:ry"), 12, 2)
    assert (odds > 9.0).all()
    assert odds.mean(axis=0).min() > at_chance.mean(axis=0).min()


@pytest.mark.slow
def test_every_row_can_be_driven(six: Arm, found: Plan, told: Plan, tmp_path: Path) -> None:
    for one in (found, told):
        rows = read_measurements(write_plan(one, tmp_path / "poses.csv"), six, inputs_only=True)
        assert ((rows.q >= six.robot.lower) & (rows.q <= six.robot.upper)).all()
        assert not rows.measured.any() and set(rows.session) == {"planned"} and (rows.covariates == {})
        changes = sum(a != b for a, b in zip(rows.payload, rows.payload[1:], strict=False))
        assert changes == len(set(rows.payload)) - 1
        assert predict(six, rows).position.shape == (len(rows), 3)
        assert one.way[0] < one.way[1]
    assert set(told.rows.payload) <= {"empty", "p120"}


def test_a_joint_comes_from_the_side_that_was_planned(six: Arm, tmp_path: Path) -> None:
    sides = plan(six, 8, between=("backlash:J2", "encoder_offset:J3"))
    rows = read_measurements(write_plan(sides, tmp_path / "poses.csv"), six, inputs_only=True)
    joint = six.joint_names.index("J2")
    read = [i for i, name in enumerate(rows.pose) if not name.startswith("to ")]
    assert len(read) == 8 == sides.rows.measured.sum() and read[0] == 1
    came = np.sign(np.diff(rows.q[:, joint]))[np.array(read) - 1]
    assert (came == rows.approach[read, joint]).all() and set(came) == {-1.0, 1.0}
    for i in set(range(len(rows))) - set(read):  # on the way, only the joint in question is elsewhere
        assert (np.delete(rows.q[i] - rows.q[i + 1], joint) == 0.0).all()
    assert (
        "approach_J2" in (tmp_path / "poses.csv").read_text()
        and "approach_J3" not in (tmp_path / "poses.csv").read_text()
    )


def along_links(arm: Arm, rows: Rows) -> dict[str, np.ndarray]:
    """Return (N, 20, 3) points along the line to every link from the one before, and to the payload [m]."""
    poses = [arm.deflection(q, name).link_poses() for q, name in zip(rows.q, rows.payload, strict=True)]
    places = {name: np.array([one[name][:3, 3] for one in poses]) for name in poses[0]}
    tips = np.array([one[arm.robot.tip] for one in poses])
    com = np.array([arm.payload(name).com for name in rows.payload])
    places["payload"] = tips[:, :3, 3] + np.einsum("nij,nj->ni", tips[:, :3, :3], com)
    ends = [(joint.parent, joint.child) for joint in arm.robot.chain] + [(arm.robot.tip, "payload")]
    share = np.linspace(0.0, 1.0, 20)[:, None]
    return {other: places[one][:, None] + share * (places[other] - places[one])[:, None] for one, other in ends}


def test_the_floor_is_at_the_base_unless_it_is_given_or_the_arm_hangs(six: Arm) -> None:
    standing, hanging, below = plan(six, 3), plan(quietly(BOOM), 3), plan(six, 3, floor=-9.0)
    lowest = [points[..., 2].min() for points in along_links(six, standing.rows).values()]
    assert min(lowest) > -1e-6 and standing.offered.dropped["below_floor"] > 10
    assert not hanging.offered.dropped["below_floor"] and not below.offered.dropped["below_floor"]


def test_no_target_is_below_the_floor_either(six: Arm) -> None:
    target = np.array([0.0, 0.0, 0.4])
    planned = plan(replace(six, instrument=Instrument(target=target)), 4, payloads=("none",), floor=0.2)
    poses = [six.deflection(q).pose for q in planned.rows.q]
    assert min(float((pose.translation + pose.rotation @ target)[2]) for pose in poses) > 0.2 - 1e-3


def test_rows_are_written_in_the_units_of_the_campaign_before(six: Arm, told: Plan, tmp_path: Path) -> None:
    heads = [f"q_{name}_deg" if name != "J2" else "q_J2" for name in six.joint_names]
    path = tmp_path / "m.csv"
    path.write_text(",".join([*heads, "x_mm", "y_mm", "z_mm", "sigma_mm"]) + "\n" + "0," * 9 + "0.1\n")
    units = read_measurements(path, six).units
    assert units["q_J1"] == "deg" and units["x"] == "mm" and "q_J2" not in units
    lines = write_plan(replace(told, units=units), tmp_path / "p.csv").read_text().splitlines()
    assert [name for name in lines[0].split(",") if name.startswith(("q_", "x", "y", "z", "sigma"))] == [
        *heads, "x_mm", "y_mm", "z_mm", "sigma_mm"
    ]  # fmt: skip
    cells = dict(zip(lines[0].split(","), lines[1].split(","), strict=True))
    assert cells["sigma_mm"] == f"{SIGMA * 1e3:.3g}" and len(cells["q_J1_deg"].partition(".")[2]) <= 4
    again = read_measurements(tmp_path / "p.csv", six, inputs_only=True)
    np.testing.assert_allclose(again.q, told.rows.q, rtol=0, atol=2e-6)
    assert ((again.q >= six.robot.lower) & (again.q <= six.robot.upper)).all()


@pytest.mark.slow
def test_points_of_the_campaign_before_may_be_in_a_file_of_their_own(armflex: Run, tmp_path: Path) -> None:
    arm = ROBOTS / "heavy_six" / "arm.toml"
    rows = load_arm(arm).robot
    q = np.random.default_rng(2).uniform(0.4 * rows.lower.clip(-1.5), 0.4 * rows.upper.clip(None, 1.5), (20, 6))
    tips = [load_arm(arm).deflection(one).pose.translation * 1e3 for one in q]
    heads = [f"q_{name}" for name in load_arm(arm).joint_names]
    log = [",".join(["pose", *heads, "sigma"])] + [f"p{i},{','.join(map(str, one))},5e-5" for i, one in enumerate(q)]
    (tmp_path / "log.csv").write_text("\n".join(log) + "\n")
    points = [f"p{i},{x},{y},{z}" for i, (x, y, z) in enumerate(tips)]
    (tmp_path / "points.csv").write_text("\n".join(["// Units: mm", "// Frame: base", *points]) + "\n")
    given = ("--rows", 3, "--points", "points.csv", "-o", "p.csv")
    assert "3 rows to read" in fine(armflex("plan", arm, *given, "--after", "log.csv")).stdout
    assert "--points needs --after" in fine(armflex("plan", arm, *given), 2).stderr


def test_no_link_is_below_the_floor_or_in_the_base(six: Arm) -> None:
    high = plan(six, 6, floor=0.5)
    for name, points in along_links(six, high.rows).items():
        if name not in ("link1", "link2"):  # which no pose moves
            assert points[..., 2].min() >= 0.49, name
        if name not in ("link1", "link2", "link3"):  # whose upper end is the elbow
            radius = np.linalg.norm(points[..., :2], axis=2)[points[..., 2] < 0.7]
            assert radius.min(initial=1.0) > 0.1, name
    assert high.offered.dropped["below_floor"] > 100 and high.offered.dropped["in_base_column"] > 0
    with pytest.raises(InputError, match=r"above the floor at 9 m; the highest is"):
        plan(six, 6, floor=9.0)


def test_joints_that_go_round_more_than_once_are_planned_in_their_middle_turn(tmp_path: Path) -> None:
    text = (tmp_path / "robot.urdf", small(tmp_path))[0].read_text()
    (tmp_path / "robot.urdf").write_text(re.sub('lower="[^"]*" upper="[^"]*"', 'lower="-6.3" upper="6.3"', text))
    arm = replace(three_joints_again(tmp_path), prior=Prior(joint_offset=1e-3))
    wide = plan(arm, 6)
    turning = [joint.kind == "revolute" for joint in arm.robot.moving]
    assert (np.abs(wide.rows.q[:, turning]) <= np.pi).all()
    assert any(flag.code == "one_turn" for flag in wide.flags)


@pytest.mark.slow
def test_what_the_instrument_hides_is_said(six: Arm, found: Plan) -> None:
    """The first joint turns the arm as the instrument's frame does; in the base frame its offset shows."""
    blind = {one.name: one for one in found.blind}
    assert "joint_offset J1" in blind and any("instrument" in name for name in blind["joint_offset J1"].partners)
    level = next(line for line in found.advice if "inclinometer" in line)
    assert "joint_offset J6" in level and "joint_offset J1" not in level  # whose axis is upright: nothing tilts
    assert any("joint_offset J1" in line and "in the base frame" in line for line in found.advice)
    assert blind["compliance J1 rz"].moves < 1e-4 and not blind["compliance J1 rz"].partners
    seen = plan(replace(six, measurement=Measurement("base")), 6)
    assert "joint_offset J1" not in {one.name for one in seen.blind}


def test_a_level_is_advised_where_it_tells_and_none_is_yet(six: Arm, tmp_path: Path) -> None:
    """It sees no turn about an axis that stays upright, and no second one on a link says more than the first."""
    offset = CATALOGUE["encoder_offset"]
    assert informing_levels(six, ()) == {"base", "J2", "J3", "J4", "J5", "J6"}
    hung = replace(six, robot=replace(six.robot, gravity=np.array([9.81, 0.0, 0.0])))
    assert informing_levels(hung, ()) == {"base", *six.joint_names}
    assert "inclinometer" in shows(offset, "J1", informing_levels(hung, ()))
    assert "base frame" in shows(offset, "J1", informing_levels(six, ()))
    sliding = informing_levels(quietly(BOOM), ())
    assert "M1" not in sliding and "A1" not in sliding and "A2" in sliding
    for text in (LEVEL, ACCELERATION.replace("link2", "link3"), LEVEL.replace("link3", "tool")):
        arm = load_arm(heavy(tmp_path, text))
        joint = "J6" if "tool" in text else "J3"
        assert informing_levels(six, ()) - informing_levels(arm, arm.sensors) == {joint}
        missing = {one.link for one in unlike(six, "level", ())} - {
            one.link for one in unlike(arm, "level", arm.sensors)
        }
        assert len(missing) == 1 and len(unlike(arm, "wire", arm.sensors)) == len(unlike(six, "wire", ()))
    arm = load_arm(heavy(tmp_path, ENCODER))
    assert "encoder_J2" not in {one.name for one in unlike(arm, "encoder", arm.sensors)}
    assert {one.name for one in unlike(arm, "encoder", ())} >= {"encoder_J2", "encoder_J3"}


def test_two_causes_of_one_motion_are_told_by_no_reading_of_it(six: Arm) -> None:
    """An encoder beside the joint's, or a level, sees what turns it, not why."""
    levels = informing_levels(six, ())
    scale, cables, other = (
        named_effect(text, six, ()) for text in ("encoder_scale:J2", "dress_pack:J2", "encoder_scale:J3")
    )
    assert instead(scale, cables, levels) == "repeat a few poses with the dress pack untied"
    assert "inclinometer" in instead(other, cables, levels) and "untied" in instead(other, cables, levels)
    softer = named_effect("compliance:J2:ry", six, ())
    assert "other payloads" in instead(scale, softer, levels)


@pytest.mark.slow
def test_backlash_and_friction_are_told_only_where_the_load_differs(six: Arm, told: Plan) -> None:
    """Friction wind-up without its load is backlash: rows can only tell that it is more."""
    assert told.goal.shown(told.reached[-1]) > 3.0
    assert "would do as well" in told.advice[0] and "brake" in told.advice[0]
    assert all("moves readings by 5 standard deviations" in hypothesis.source for hypothesis in told.hypotheses)
    same = plan(six, 4, between=("encoder_offset:J1", "encoder_offset:J2"))
    assert same.advice[0].startswith(
        "No tip reading distinguishes encoder offset at J1 (rz) from encoder offset at J2 (ry)"
    )
    assert "inclinometer" in same.advice[0]


def every_place(arm: Arm) -> list[Effect]:
    locations = [
        (law, location)
        for law in CATALOGUE.values()
        if law.afterwards is not Afterwards.OVER
        for location in locations_on(law, arm)
    ]
    return [Effect(law, location, (0.0,) * (len(law.amplitudes) + len(law.inner))) for law, location in locations]


def test_every_effect_goes_by_the_name_it_is_given(six: Arm) -> None:
    for effect in every_place(six):
        again = named_effect(spelled(effect), six, ())
        assert (again.law, again.location.place, again.location.axis, again.location.partner) == (
            effect.law,
            effect.location.place,
            effect.location.axis,
            effect.location.partner,
        )
    assert named_effect("backlash:J2", six, ()).location.axis == "ry"


def test_a_name_from_the_json_of_trace_is_understood() -> None:
    arm = quietly(BOOM)
    one = {"effect": "backlash", "site": "A2", "axis": "ry", "covariates": ["approach_A2"]}
    effect = named_effect(":".join((one["effect"], one["site"], one["axis"])), arm, ())
    assert spelled(effect) == "backlash:A2:ry" and list(effect.location.covariates) == one["covariates"]


@pytest.mark.parametrize(
    "pair, error, text",
    [
        (("backlsh:J2", "backlash:J3"), UnknownNameError, "did you mean 'backlash'"),
        (("backlash:J9", "backlash:J3"), UnknownNameError, "backlash:J"),
        (("stiffening:J2", "backlash:J3"), InputError, "say which"),
        (("backlash:J2", "backlash:J2:ry"), InputError, "distinguished from itself"),
        (("thermal_growth:J2", "backlash:J3"), InputError, "--covariates temperature=10,35"),
        (("hysteresis:J2:ry", "backlash:J3"), UnsupportedError, "the rows before"),
        (("session_frame:base", "backlash:J3"), UnsupportedError, "session that has been"),
    ],
)
def test_rivals_that_make_no_sense(six: Arm, pair: tuple[str, str], error: type, text: str) -> None:
    with pytest.raises(error, match=text):
        plan(six, 5, between=pair)


@pytest.mark.slow
def test_what_effects_depend_on_is_set_to_given_values(six: Arm, tmp_path: Path) -> None:
    warm = plan(six, 6, between=("thermal_growth:J2", "thermal_growth:J3"), covariates={"temperature": (10, 35)})
    rows = read_measurements(write_plan(warm, tmp_path / "poses.csv"), six, inputs_only=True)
    values = rows.covariates["temperature"]
    assert set(values) == {10.0, 35.0} and (np.diff(values) >= 0.0).all()
    with pytest.raises(InputError, match="no effect depends on 'temp'"):
        plan(six, 6, covariates={"temp": (1.0, 2.0)})


@pytest.mark.parametrize(
    "options, text",
    [
        ({"rows": 0}, "rows is 0"),
        ({"rows": 2.5}, "whole number"),
        ({"sigma": -1.0}, "sigma"),
        ({"payloads": ()}, "payloads"),
        ({"payloads": ("p12",)}, "did you mean 'p120'"),
        ({"payloads": "p12"}, "no payload named 'p12', did you mean 'p120'"),
        ({"floor": np.nan}, "floor"),
    ],
)
def test_numbers_out_of_their_range(six: Arm, options: dict, text: str) -> None:
    with pytest.raises(InputError, match=text):
        plan(six, **options)


def small(folder: Path, softness: float = 1.0) -> Arm:
    return three_joints(folder, [random_compliance(i, softness) for i in range(3)])


def test_nothing_free_is_an_error_and_a_soft_arm_says_what_it_cannot_hold(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing is free"):
        plan(small(tmp_path), 4)
    with pytest.raises(InputError, match="no row can be measured: of 32 offered"):
        plan(replace(small(tmp_path, 1e4), prior=Prior(joint_offset=1e-3)), 4)


def test_a_joint_without_limits_is_planned_over_one_turn(tmp_path: Path) -> None:
    text = (tmp_path / "robot.urdf", small(tmp_path))[0].read_text().replace('type="revolute"', 'type="continuous"', 1)
    (tmp_path / "robot.urdf").write_text(text)
    arm = three_joints_again(tmp_path)
    free = plan(replace(arm, prior=Prior(joint_offset=1e-3)), 4)
    assert any(flag.code == "full_turn" for flag in free.flags) and (np.abs(free.rows.q[:, 0]) <= np.pi).all()


def three_joints_again(folder: Path) -> Arm:
    """Return the small arm of a URDF that is there already."""
    from armflex import Flexure
    from armflex.laws import LinearLaw
    from armflex.robot import load_robot

    robot = load_robot(folder / "robot.urdf", "tool")
    return Arm(robot, (Flexure("pitch", "pitch", LinearLaw(random_compliance(0))),))


def quietly(path: Path) -> Arm:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_arm(path)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> tuple[Arm, Measurements]:
    arm, path = quietly(BOOM), tmp_path_factory.mktemp("campaign") / "m.csv"
    return arm, read_measurements(few_rows(ROBOTS / "tarm_like" / "campaign.csv", path, 150), arm)


@pytest.fixture(scope="module")
def fitted(campaign) -> Calibration:
    return calibrate(*campaign)


@pytest.fixture(scope="module")
def learned(campaign) -> Calibration:
    """With a law of A2 that is learned."""
    arm, measured = campaign
    return calibrate(learning(arm, "A2"), measured)


@pytest.mark.slow
def test_what_was_measured_counts(campaign, fitted) -> None:
    """After a campaign the plan starts from that campaign's certainty, and from the effect that it shows."""
    arm, measured = campaign
    further = plan(arm, 4, after=measured)
    known = {p.name: p.std for p in fitted.parameters}
    before = dict(zip(further.model.names, further.std_before, strict=True))
    pairs = [(before[name], std) for name, std in known.items() if name.startswith(("compliance", "joint_offset"))]
    np.testing.assert_allclose(*np.array(pairs).T, rtol=0.02)
    assert [flag.code for flag in further.flags] == ["unexplained_residual"]
    apart = plan(arm, 4, after=measured, between=("backlash:A2", "backlash:A3"))
    assert apart.hypotheses[0].source == "estimated from what was measured" and not apart.flags
    assert apart.hypotheses[0].size[0] == pytest.approx(0.88e-3, rel=0.05)  # as trace finds it in all rows
    assert apart.goal.shown(apart.reached[0]) > 3.0 and apart.reached[-1] > apart.reached[0]


@pytest.mark.slow
def test_a_calibrated_arm_is_planned_from_its_covariance(fitted) -> None:
    further, certainty = plan(fitted.arm, 4), fitted.arm.certainty
    stored = dict(zip(certainty.labels, np.sqrt(np.diag(certainty.covariance)), strict=True))
    before = dict(zip(further.model.names, further.std_before, strict=True))
    kept = [name for name in before if not name.startswith("instrument")]
    np.testing.assert_allclose([before[name] for name in kept], [stored[name] for name in kept], rtol=1e-6)
    assert not any(name.startswith("session_frame") for name in before)


@pytest.mark.slow
def test_laws_that_are_to_be_learned_are_among_what_is_planned_for(campaign, learned) -> None:
    """Before a campaign as uncertain as they were declared, after one as their covariance has it."""
    arm, measured = campaign
    arm = learning(arm, "A2")
    first = plan(arm, 4)
    before = dict(zip(first.model.names, first.std_before, strict=True))
    after = dict(zip(first.model.names, first.std_after, strict=True))
    assert before["law A2 ry"] == pytest.approx(0.5) and after["law A2 ry"] < 0.25
    assert not any(name.startswith("compliance A2") for name in before)
    assert "law A2 dx" in {one.name for one in first.blind}
    stored = {p.name: p.std for p in learned.parameters if p.block == "law"}
    for further in (plan(learned.arm, 4), plan(arm, 4, after=measured)):
        before = dict(zip(further.model.names, further.std_before, strict=True))
        np.testing.assert_allclose([before[name] for name in stored], list(stored.values()), rtol=0.05)


@pytest.mark.slow
def test_laws_to_be_learned_since_a_calibration_are_planned_for(campaign, fitted) -> None:
    """As uncertain as they were declared without the campaign, as its rows leave them with it."""
    again, certainty = learning(fitted.arm, "A2"), fitted.arm.certainty
    first, further = plan(again, 4), plan(again, 4, after=campaign[1])
    for found in (first, further):
        assert not any(name.startswith("compliance A2") for name in found.model.names)
    before = dict(zip(first.model.names, first.std_before, strict=True))
    after = dict(zip(first.model.names, first.std_after, strict=True))
    known = dict(zip(further.model.names, further.std_before, strict=True))
    stored = dict(zip(certainty.labels, np.sqrt(np.diag(certainty.covariance)), strict=True))
    assert before["law A2 ry"] == pytest.approx(0.5) and after["law A2 ry"] < 0.25
    assert before["compliance A3 ry"] == pytest.approx(stored["compliance A3 ry"])
    assert known["law A2 ry"] < 0.1 and known["law A2 dy"] == pytest.approx(0.5, rel=0.01)


@pytest.mark.slow
def test_a_covariance_of_some_of_the_learned_laws_is_refused(campaign, learned) -> None:
    both = learning(learned.arm, "A3")
    with pytest.raises(InputError, match=r"A3 is to be learned, but .* laws of A2 alone"):
        plan(both, 4)
    names = plan(both, 4, after=campaign[1]).model.names
    assert "law A2 ry" in names and "law A3 ry" in names


def learning(arm: Arm, name: str) -> Arm:
    """Return an arm with a flexure's compliance to be learned."""
    return replace(
        arm, flexures=tuple(replace(f, learn=Learning("linear")) if f.name == name else f for f in arm.flexures)
    )


@pytest.mark.slow
def test_the_command_writes_rows_a_picture_and_json(armflex: Run, tmp_path: Path) -> None:
    out = fine(armflex("plan", BOOM, "--rows", 5, "-o", "p.csv", "--json", "p.json", "--picture", "p.png"))
    assert "5 rows to read" in out.stdout and "No tip reading determines" in out.stdout
    content = strict_json(tmp_path / "p.json")
    assert content["format"] == "armflex-plan-1" and content["rows"] == 5
    assert len(content["stops"]) == 5 and all(stop["read"] and stop["worth"] >= 0.0 for stop in content["stops"])
    known = [p for p in content["parameters"] if not p["name"].startswith("instrument")]
    assert all(0.0 < p["after"] <= p["before"] * (1.0 + 1e-9) for p in known) and len(known) == 52
    assert {p["name"] for p in known if not p["told_by_tip"]} == {one["parameter"] for one in content["not_told"]}
    assert (tmp_path / "p.png").stat().st_size > 20_000
    fine(armflex("predict", BOOM, "p.csv", "-o", "predicted.csv"))


@pytest.mark.slow
def test_predictions_of_an_instrument_without_a_place_have_no_figure(armflex: Run, tmp_path: Path) -> None:
    """One reading does not place it, twelve do."""
    heavy = ROBOTS / "heavy_six" / "arm.toml"
    along = ("--along", ROBOTS / "heavy_six" / "trajectory.csv", "-o", "p.csv")
    few = fine(armflex("plan", heavy, "--rows", 1, *along)).stdout
    assert "now instrument not placed yet, after the rows instrument not placed yet;" in " ".join(few.split())
    more = fine(armflex("plan", heavy, "--rows", 12, *along)).stdout
    assert re.search(r"now instrument not placed yet, after the rows 0\.\d+;", " ".join(more.split()))


@pytest.mark.slow
def test_the_command_says_how_far_apart_rivals_will_be(armflex: Run, tmp_path: Path) -> None:
    given = ["--rows", 6, "--between", "encoder_scale:A4,encoder_eccentricity:A4"]
    fine(armflex("plan", BOOM, *given, "-o", "p.csv", "--json", "p.json"))
    content = json.loads((tmp_path / "p.json").read_text())
    assert content["separation_sigmas"] == pytest.approx(content["expected"]["reached"][-1])
    assert [one["name"] for one in content["between"]] == ["encoder_scale:A4:rz", "encoder_eccentricity:A4:rz"]


@pytest.mark.parametrize(
    "given, text",
    [
        (["--rows", 0], "rows is 0"),
        (["--between", "backlash:A2"], "E1,E2"),
        (["--covariate", "temperature"], "NAME=NUMBER"),
        (["--covariates", "temperature=1,x"], "NAME=NUMBER"),
        (["--sigma", "0.1"], "unit"),
        (["--sigma", "1000m"], "the arm's reach"),
        (["--picture", "p.txt"], ".png"),
        (["--after", ROBOTS / "heavy_six" / "trajectory.csv"], "seems to be of another arm"),
    ],
)
def test_bad_input_is_exit_code_2(armflex: Run, tmp_path: Path, given: list, text: str) -> None:
    assert text in fine(armflex("plan", BOOM, *given, "-o", "p.csv"), 2).stderr
    assert not (tmp_path / "p.csv").exists()


@pytest.mark.slow
def test_a_picture_ends_in_png_pdf_or_svg(found: Plan, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="png"):
        draw_plan(found, tmp_path / "p.bmp")


def test_an_effect_over_a_recorded_column_is_planned_for_where_the_column_is_given(six: Arm) -> None:
    def places(records: Records) -> list[Location]:
        return [Location("J2", "ry", ("speed_J2",))] if "speed_J2" in records.recorded else []

    lag = replace(CATALOGUE["encoder_scale"], name="lag", places=places)
    with CATALOGUE.entered("lag", lag):
        assert named_effect("lag:J2", six, ("speed_J2",)).location.covariates == ("speed_J2",)
        with pytest.raises(InputError, match="lag is at no place: a column that it depends on is not given"):
            named_effect("lag:J2", six, ())
