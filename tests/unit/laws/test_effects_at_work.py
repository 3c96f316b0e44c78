"""Effects at work: derivatives, paths checked and compensated with them, and the columns that they ask for."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from support.command_line import Run, fine, strict_json
from support.effect_arms import BACKLASH, KNOWN, LAWS, TEXT, Q, arm_with, millimetre, plain
from support.small_arms import central_difference

from armflex import Arm, Trajectory, check, compensate, read_trajectory, view
from armflex.cli.options import parse_covariates
from armflex.errors import InputError, MissingCovariateError, TableError
from armflex.tasks.workspace import map_workspace


@pytest.mark.parametrize("name", LAWS)
def test_the_tips_jacobian_is_that_of_the_arm_with_the_effect(name: str) -> None:
    arm, states = millimetre(name), {"play_J2_dx_100": 500.0, "play_J2_ry_100": 500.0}

    def tip(q: np.ndarray) -> np.ndarray:
        return arm.deflection(q, "p200", covariates=KNOWN | states).pose.translation

    moved = tip(Q) - plain().deflection(Q, "p200").pose.translation
    assert 5e-4 < np.linalg.norm(moved) < 2e-3
    found = arm.deflection(Q, "p200", covariates=KNOWN | states).total_jacobian[:3]
    np.testing.assert_allclose(found, central_difference(tip, Q, 1e-5), atol=2e-6)


GEAR = 'name = "gear_harmonic"\nsite = "J3"\nparameters = { A = 3e-4, B = -2e-4, k = 9.0 }'
DEADBAND = 'name = "deadband"\nsite = "J2"\naxis = "ry"\nparameters = { g = 3e-4, tau0 = 200.0 }'
HYSTERESIS = 'name = "hysteresis"\nsite = "J2"\naxis = "ry"\nparameters = { gain = 2e-7, radius = 300.0 }'
WARM = 'name = "thermal_bending"\nsite = "J3"\naxis = "ry"\nparameters = { beta = 2e-5, lag = 5.0 }'
UMBILICAL = """name = "umbilical"
site = "J4"
parameters = { k = 300.0, anchor_x = 0.0, anchor_y = 1.0, anchor_z = 3.0, rest = 0.5 }"""
WORK = {
    "backlash": BACKLASH,
    "gear": GEAR,
    "deadband": DEADBAND,
    "hysteresis": HYSTERESIS,
    "lagged": WARM,
    "umbilical": UMBILICAL,
}


def part(path: Trajectory, count: int = 25) -> Trajectory:
    """Return every fourth row of a path."""
    rows = np.arange(len(path))[::4][:count]
    names = {"payload": tuple(path.payload[i] for i in rows), "via": tuple(path.via[i] for i in rows)}
    return dataclasses.replace(path, time=path.time[rows], q=path.q[rows], **names)


def warming(path: Trajectory) -> Trajectory:
    return dataclasses.replace(path, covariates={"temperature": 20.0 + 0.3 * path.time})


def own_history(arm: Arm, path: Trajectory) -> list[dict[str, float]]:
    """Work out, apart from the library, what effects remember along a path: direction, warmth behind a lag, play."""
    step = np.sign(np.diff(path.q, axis=0, prepend=path.q[:1]))
    bare = dataclasses.replace(arm, effects=())
    play, warm, known = 0.0, float(path.covariates["temperature"][0]), []
    for i, q in enumerate(path.q):
        if i:
            step[i] = np.where(step[i] == 0.0, step[i - 1], step[i])
            fine_time = np.linspace(path.time[i - 1], path.time[i], 2001)
            air = np.interp(fine_time, path.time, path.covariates["temperature"])
            for middle, dt in zip(0.5 * (air[1:] + air[:-1]), np.diff(fine_time), strict=True):
                warm += (middle - warm) * (1.0 - np.exp(-dt / 5.0))
        load = bare.deflection(q, path.payload[i], enforce_limits=False).wrenches[1, 4]
        play = min(max(play, load - 300.0), load + 300.0)
        row = {f"approach_J{j + 1}": step[i, j] for j in range(6)} | {"play_J2_ry_300": play}
        known.append(row | {"temperature": path.covariates["temperature"][i], "temperature_lagged_5s": warm})
    return known


@pytest.mark.parametrize("name", WORK)
def test_a_compensated_path_is_where_it_should_be_with_effects_in_the_arm(
    tmp_path: Path, heavy_path: Trajectory, name: str
) -> None:
    arm, path = arm_with(tmp_path, WORK[name]), warming(part(heavy_path))
    done = compensate(arm, path)
    known = own_history(arm, done.trajectory)
    for i, row in enumerate(known):
        target = plain().rigid_pose(path.q[i]).translation
        driven = arm.deflection(done.trajectory.q[i], path.payload[i], covariates=row, enforce_limits=False).pose
        assert np.linalg.norm(driven.translation - target) < 2e-8
    without = compensate(plain(), path).trajectory.q
    assert np.abs(done.trajectory.q - without).max() > 1e-5, "the effect is worth something on this path"
    assert set(done.trajectory.covariates) == {"temperature"}


def test_a_side_that_never_settles_is_not_reached(tmp_path: Path) -> None:
    """Play larger than what is to be made up for: whichever way the joint goes, it ought to have gone the other way."""
    arm = arm_with(tmp_path, BACKLASH.replace("3.6e-4", "0.04"))
    q = np.tile([0.1, 0.2, 0.3, 0.0, 0.5, 0.0], (3, 1))
    path = Trajectory(arm.joint_names, np.arange(3.0), q, ("p200", "none", "none"), ("a", "b", "c"))
    done = compensate(arm, path, best_effort=True)
    assert not done.ok and "history" in {row.reason.partition(":")[0] for row in done.rows}
    sides = np.sign(np.diff(done.trajectory.q[:, 1], prepend=done.trajectory.q[0, 1]).round(8))
    for i in (1, 2):
        sides[i] = sides[i] or sides[i - 1]
    for i, row in enumerate(done.rows):
        pose = arm.deflection(done.trajectory.q[i], path.payload[i], covariates={"approach_J2": sides[i]}).pose
        left = np.linalg.norm(pose.translation - arm.rigid_pose(q[i]).translation)
        assert left == pytest.approx(np.linalg.norm(row.after[:3]), abs=1e-9)
        assert row.reached == (left < 1e-9)


def test_play_remembers_inertial_loads_too(tmp_path: Path, heavy_path: Trajectory) -> None:
    arm, path = arm_with(tmp_path, HYSTERESIS), part(heavy_path, 6)
    swift = dataclasses.replace(path, v=np.full((6, 6), 0.3), a=np.full((6, 6), 2.0))
    play, found = 0.0, []
    for i, q in enumerate(path.q):
        load = plain().deflection(q, path.payload[i], **swift.motion(i)).wrenches[1, 4]
        play = min(max(play, load - 300.0), load + 300.0)
        found.append(play)
    np.testing.assert_allclose(swift.prepared(arm).covariates["play_J2_ry_300"], found, rtol=1e-9)
    assert not np.allclose(path.prepared(arm).covariates["play_J2_ry_300"], found, rtol=1e-3)


def test_rounding_turns_no_joint_round(heavy: Arm) -> None:
    q = np.zeros((4, 6))
    q[:, 1] = [0.0, 0.1, 0.1 - 1e-15, 0.1 + 1e-12]
    path = Trajectory(heavy.joint_names, np.arange(4.0), q, ("none",) * 4, ("",) * 4)
    assert path.known["approach_J2"].tolist() == [0.0, 1.0, 1.0, 1.0]


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_check_takes_the_side_from_the_motion_between_rows(tmp_path: Path) -> None:
    """There and back: the same configurations differ by the gap."""
    arm = arm_with(tmp_path, BACKLASH.replace("3.6e-4", "4e-3"))
    q = np.array([[0, -0.2, 0.3, 0, 0, 0], [0, 0.2, 0.3, 0, 0, 0], [0, -0.2, 0.3, 0, 0, 0]], float)
    path = Trajectory(arm.joint_names, np.arange(3.0), q, ("none",) * 3, ("a", "b", "c"))
    report = check(arm, path, 1.0)
    for via, row, side in (("a", 0, 0.0), ("b", 1, 1.0), ("c", 2, -1.0)):
        point = next(point for point in report.via_points if point.name == via)
        expected = arm.deflection(q[row], covariates={"approach_J2": side}).displacement[:3]
        assert point.displacement_m == pytest.approx(float(np.linalg.norm(expected)), rel=1e-9)
    sides = [np.linalg.norm(arm.deflection(q[1], covariates={"approach_J2": s}).displacement[:3]) for s in (1.0, -1.0)]
    assert abs(sides[0] - sides[1]) > 1e-3
    assert report.path_worst.displacement_m >= max(sides) * (1 - 1e-9), "both sides of the turning point count"


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_columns_and_constants(tmp_path: Path, heavy_path: Trajectory) -> None:
    arm, path = arm_with(tmp_path, WARM), part(heavy_path, 4)
    for ask in (lambda **more: check(arm, path, 1.0, **more), lambda **more: compensate(arm, path, **more)):
        with pytest.raises(MissingCovariateError, match=r"effect 'thermal_bending link:J3 ry' .* 'temperature'"):
            ask()
        ask(covariates={"temperature": 25.0})
    with pytest.raises(InputError, match="'temperature' is a column of the trajectory already"):
        check(arm, warming(path), 1.0, covariates={"temperature": 25.0})
    with pytest.raises(InputError, match="no covariate 'approach_J9', did you mean 'approach_J"):
        check(arm, path, 1.0, covariates={"approach_J9": 1.0})
    settled = check(arm, path, 1.0, covariates={"temperature": 30.0})
    given = dataclasses.replace(path, covariates={"temperature": np.full(len(path), 30.0)})
    assert check(arm, given, 1.0).via_points == settled.via_points
    view(arm, trajectory=given, path=tmp_path / "v.html")
    view(arm, Q, covariates={"temperature": 30.0}, path=tmp_path / "w.html")


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_a_covariate_that_nothing_depends_on_is_refused_where_somebody_names_it(
    tmp_path: Path, heavy: Arm, heavy_path: Trajectory
) -> None:
    arm, path = arm_with(tmp_path, WARM), part(heavy_path, 2)
    given = {"temprature": 25.0}
    for ask in (
        lambda one: check(one, path, 1.0, covariates=given),
        lambda one: compensate(one, path, covariates=given),
        lambda one: view(one, trajectory=path, covariates=given, path=tmp_path / "v.html"),
        lambda one: view(one, Q, covariates=given, path=tmp_path / "v.html"),
        lambda one: map_workspace(one, rows=4, covariates=given),
    ):
        with pytest.raises(InputError, match="depends on 'temprature', did you mean 'temperature'"):
            ask(arm)
        with pytest.raises(InputError, match=r"depends on 'temprature' \(they depend on: none\)"):
            ask(heavy)
    assert not (tmp_path / "v.html").exists()


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_a_record_may_hold_more_than_the_effects_depend_on(tmp_path: Path, heavy_path: Trajectory) -> None:
    arm, path = arm_with(tmp_path, WARM), warming(part(heavy_path, 2))
    more = dataclasses.replace(path, covariates={**path.covariates, "humidity": np.full(len(path), 40.0)})
    assert check(arm, more, 1.0) == check(arm, path, 1.0)
    known = {"temperature": 25.0, "temperature_lagged_5s": 25.0}
    plain, whole = (arm.deflection(Q, covariates=known | extra) for extra in ({}, {"humidity": 40.0}))
    np.testing.assert_array_equal(whole.displacement, plain.displacement)
    with pytest.raises(MissingCovariateError, match="did you mean 'temperature_laged_5s'"):
        arm.deflection(Q, covariates={"temperature": 25.0, "temperature_laged_5s": 25.0})


def test_a_trajectorys_columns_are_read(tmp_path: Path, heavy: Arm) -> None:
    header = "time,q_J1,q_J2,q_J3,q_J4,q_J5,q_J6,approach_J2,temperature"
    file = tmp_path / "t.csv"
    file.write_text(f"{header}\n0,0,0,0,0,0,0,1,21\n1,0,0.1,0,0,0,0,-1,22\n")
    path = read_trajectory(file, heavy)
    np.testing.assert_array_equal(path.prepared(heavy).covariates["approach_J2"], [1.0, -1.0])
    found = path.between(np.zeros(3, int), np.array([0.0, 0.5, 1.0]))
    np.testing.assert_array_equal(found.covariates["approach_J2"], [-1.0] * 3)
    np.testing.assert_allclose(path.between(np.zeros(1, int), np.array([0.5])).covariates["temperature"], 21.5)
    assert path.with_midpoints(np.array([True])).covariates["approach_J2"].tolist() == [1.0, -1.0, -1.0]
    for bad, said in (("0.5", "approach_J2 is 0.5, not -1, 0 or 1"), ("J2,", "no covariate 'approach_J22'")):
        text = f"{header}\n0,0,0,0,0,0,0,{bad},21\n"
        file.write_text(text if bad == "0.5" else text.replace("approach_J2", "approach_J22").replace("J2,,21", "1,21"))
        with pytest.raises(TableError, match=said):
            read_trajectory(file, heavy)


def test_commands_take_covariates(armflex: Run, tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(f"{TEXT}\n[[effect]]\n{BACKLASH}\n[[effect]]\n{WARM}\n")
    said = fine(armflex("deflect", "arm.toml", "--covariates", "temperature=25"), 2).stderr
    assert "effect 'backlash J2 ry' needs the covariate 'approach_J2'" in said
    said = fine(armflex("deflect", "arm.toml", "--covariates", "temprature=25,approach_J2=1"), 2).stderr
    assert "no effect of this arm depends on 'temprature', did you mean 'temperature'? (they depend on: " in said
    command = ["deflect", "arm.toml", "--q", "J2=0.3", "--json", "d.json", "--covariates"]
    fine(armflex(*command, "temperature=25,approach_J2=1"))
    arm = arm_with(tmp_path, BACKLASH, WARM)
    asked = {"temperature": 25.0, "temperature_lagged_5s": 25.0, "approach_J2": 1.0}
    expected = arm.deflection(arm.position(J2=0.3), covariates=asked).displacement
    np.testing.assert_allclose(strict_json(tmp_path / "d.json")["displacement"], expected, rtol=1e-10)
    for bad, complaint in (
        ("temperature", "'temperature' is not of the form NAME=NUMBER"),
        ("temperature=warm", "is not of the form NAME=NUMBER"),
        ("operator=bob", "'operator=bob' is not of the form NAME=NUMBER or COLUMN=LEVEL=NUMBER"),
        ("operator=bob=1", "no effect of this arm depends on 'operator=bob'"),
        ("temperature=1,temperature=2", "'temperature' is given twice"),
        ("approach_J2=2", "approach_J2 is 2, not -1, 0 or 1"),
    ):
        assert complaint in fine(armflex(*command, bad), 2).stderr


def test_predict_takes_what_no_column_gives(armflex: Run, tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(f"{TEXT}\n[[effect]]\n{BACKLASH}\n[[effect]]\n{WARM}\n")
    joints = ",".join(f"q_J{i}" for i in range(1, 7))
    (tmp_path / "m.csv").write_text(f"time,{joints}\n0,0,0.3,0,0,0,0\n9,0,0.2,0,0,0,0\n")
    (tmp_path / "all.csv").write_text(
        f"time,{joints},temperature,approach_J2\n0,0,0.3,0,0,0,0,25,1\n9,0,0.2,0,0,0,0,25,1\n"
    )
    assert "needs the covariate" in fine(armflex("predict", "arm.toml", "m.csv", "-o", "o.csv"), 2).stderr
    fine(armflex("predict", "arm.toml", "m.csv", "-o", "o.csv", "--covariates", "temperature=25,approach_J2=1"))
    fine(armflex("predict", "arm.toml", "all.csv", "-o", "p.csv"))
    assert (tmp_path / "o.csv").read_text() == (tmp_path / "p.csv").read_text()
    for given, said in (("temperature=20", "is a column of the rows already"), ("temprature=20", "did you mean")):
        bad = armflex("predict", "arm.toml", "all.csv", "-o", "p.csv", "--covariates", given)
        assert said in fine(bad, 2).stderr


def test_a_covariate_may_be_a_level_of_a_text_column():
    assert parse_covariates("operator=bob=1, shift=a=b=-0.5,t=2e1") == {
        "operator=bob": 1.0,
        "shift=a=b": -0.5,
        "t": 20.0,
    }


@pytest.mark.slow
def test_commands_on_a_path_take_covariates(armflex: Run, tmp_path: Path, heavy_path: Trajectory) -> None:
    (tmp_path / "arm.toml").write_text(f"{TEXT}\n[[effect]]\n{BACKLASH}\n[[effect]]\n{WARM}\n")
    rows = part(heavy_path, 4)
    lines = [f"{t}," + ",".join(map(repr, q.tolist())) for t, q in zip(rows.time, rows.q, strict=True)]
    (tmp_path / "t.csv").write_text("\n".join(["time," + ",".join(f"q_J{i}" for i in range(1, 7)), *lines]) + "\n")
    for command in (
        ["check", "arm.toml", "t.csv", "--tolerance", "1m"],
        ["compensate", "arm.toml", "t.csv", "-o", "o.csv"],
        ["view", "arm.toml", "--traj", "t.csv", "-o", "v.html"],
    ):
        assert "needs the covariate 'temperature'" in fine(armflex(*command), 2).stderr
        fine(armflex(*command, "--covariates", "temperature=31"))
