"""`export --to` a program or a message: the path that is read back is the one that was given."""

import json
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.arms import bundled
from support.campaign_files import write_columns
from support.command_line import fine, run_here
from support.exported import krl_moves, ls_moves, rapid_moves, urscript_moves, val3_moves
from support.small_arms import ROBOTS, arm_of, joint, link

from armflex import Arm, Trajectory, Wrench, compensate, read_trajectory, write_trajectory
from armflex.errors import InputError, JointLimitError, TableError, UnreachableError, UnsupportedError
from armflex.export import programs
from armflex.laws.effects.catalogue import CATALOGUE
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.location import Location
from armflex.version import __version__

LANGUAGES = ("urscript", "krl", "rapid", "ls", "val3", "jointtrajectory")
NAMES = tuple(f"J{i}" for i in range(1, 7))


def path_file(folder: Path, names: tuple[str, ...], q: np.ndarray, **more: list) -> Path:
    file = folder / "path.csv"
    time = np.cumsum(np.arange(1, len(q) + 1) * 0.25).tolist()
    write_columns(file, {"time": time} | {f"q_{n}": q[:, i].tolist() for i, n in enumerate(names)} | more)
    return file


def message(text: str) -> dict:
    """Return a JointTrajectory as ROS reads it from YAML."""
    return pytest.importorskip("yaml").safe_load(text)


def positions_of(language: str, text: str, arm: Arm) -> np.ndarray:
    """Return (N, nq) positions [rad, m] of what a language's controller would drive."""
    slides = np.array([one.kind == "prismatic" for one in arm.robot.moving])
    out = []
    if language == "urscript":
        return np.array([q for q, _, _ in urscript_moves(text)])
    if language == "jointtrajectory":
        assert message(text)["joint_names"] == list(arm.joint_names)
        return np.array([point["positions"] for point in message(text)["points"]])
    if language == "val3":
        return np.radians([axes for axes, _ in val3_moves(text)])
    if language in ("krl", "ls"):
        for axes in krl_moves(text) if language == "krl" else [axes for axes, _ in ls_moves(text)]:
            own, count = ("A", 6) if language == "krl" else ("J", int((~slides).sum()))
            turning, sliding = (
                [axes[f"{letter}{i}"] for i in range(1, most + 1) if f"{letter}{i}" in axes]
                for letter, most in ((own, count), ("E", 6))
            )
            out.append((turning, sliding))
    else:
        for turning, sliding, _, _ in rapid_moves(text):
            out.append((turning[: int((~slides).sum())], [x for x in sliding if x != 9e9]))
    q = np.zeros((len(out), len(slides)))
    q[:, ~slides] = np.radians([turning for turning, _ in out])
    q[:, slides] = 1e-3 * np.array([sliding for _, sliding in out])
    return q


@given(st.lists(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6), min_size=1, max_size=5))
@settings(max_examples=30)
def test_any_path_comes_back(tmp_path_factory: pytest.TempPathFactory, rows: list[list[float]]) -> None:
    arm, q = bundled("heavy_six"), np.array(rows)
    file = path_file(tmp_path_factory.mktemp("path"), NAMES, q)
    for language in LANGUAGES:
        text = getattr(programs, language)(arm, file).text
        np.testing.assert_allclose(positions_of(language, text, arm), q, rtol=0.0, atol=2e-11)


@pytest.mark.parametrize("language", ["krl", "rapid", "ls", "jointtrajectory"])
def test_sliding_axes_are_external_ones_in_millimetres(language: str, tmp_path: Path) -> None:
    arm = bundled("tarm_like")
    file = ROBOTS / "tarm_like" / "trajectory.csv"
    path = read_trajectory(file, arm)
    text = getattr(programs, language)(arm, file).text
    np.testing.assert_allclose(positions_of(language, text, arm), path.q, rtol=0.0, atol=2e-11)
    if language == "krl":
        assert "; E1 [mm]: M1" in text and "; A1 [deg]: A1" in text and krl_moves(text)[0]["E1"] == 2800.0
    if language == "rapid":
        assert "! eax_a [mm]: M1" in text and rapid_moves(text)[0][1] == [2800.0, *[9e9] * 5]


def test_times_and_blends_are_those_of_the_path(tmp_path: Path) -> None:
    arm, q = bundled("heavy_six"), np.linspace(0.0, 0.5, 18).reshape(3, 6)
    file = path_file(tmp_path, NAMES, q, blend_mm=[10.0, 0.0, 5.0])
    assert [move[1:] for move in urscript_moves(programs.urscript(arm, file).text)] == [
        (None, 0.01),
        (0.5, None),
        (0.75, None),
    ]
    moves = rapid_moves(programs.rapid(arm, file).text)
    assert [(time, zone) for *_, time, zone in moves] == [
        (None, [10.0, 15.0, 15.0, 1.5, 15.0, 1.5]),
        (0.5, None),
        (0.75, None),
    ]
    taught = programs.ls(arm, file)
    assert [time for _, time in ls_moves(taught.text)] == [None, 0.5, 0.75] and "1 blends" in taught.notes[-1]
    staubli = programs.val3(arm, file)
    assert [blend for _, blend in val3_moves(staubli.text)] == [10.0, None, None] and "2 times" in staubli.notes[-1]
    points = message(programs.jointtrajectory(arm, file).text)["points"]
    assert [point["time_from_start"] for point in points] == [
        {"sec": 0, "nanosec": 0},
        {"sec": 0, "nanosec": 500_000_000},
        {"sec": 1, "nanosec": 250_000_000},
    ]
    assert all(point["velocities"] == [] and point["accelerations"] == [] for point in points)
    said = programs.krl(arm, file).notes[-1]
    assert "2 times between rows and 1 blends" in said
    assert "blends" in programs.jointtrajectory(arm, file).notes[-1]
    plain = path_file(tmp_path, NAMES, q)
    assert "r=" not in programs.urscript(arm, plain).text and "fine" in programs.rapid(arm, plain).text


def test_speeds_are_in_the_message_where_the_path_has_them(tmp_path: Path) -> None:
    q = np.zeros((2, 6))
    speeds = {f"v_{name}": [0.1 * i, 0.2] for i, name in enumerate(NAMES)}
    file = path_file(tmp_path, NAMES, q, **speeds)
    first, last = message(programs.jointtrajectory(bundled("heavy_six"), file).text)["points"]
    np.testing.assert_allclose(first["velocities"], [0.1 * i for i in range(6)], atol=1e-12)
    assert last["velocities"] == [0.2] * 6 and last["accelerations"] == []


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_compensated_path_is_that_of_compensate(language: str, tmp_path: Path) -> None:
    arm, file = bundled("heavy_six"), ROBOTS / "heavy_six" / "trajectory.csv"
    wanted: Trajectory = compensate(arm, read_trajectory(file, arm)).trajectory
    found = getattr(programs, language)(arm, file, compensate=True)
    read = positions_of(language, found.text, arm)
    np.testing.assert_allclose(read, wanted.q, rtol=0.0, atol=2e-11)
    assert np.abs(read - read_trajectory(file, arm).q).max() > 1e-3 and "8 mm" in found.notes[0]


def test_a_path_that_cannot_be_compensated_within_the_limits_leaves_no_file(tmp_path: Path) -> None:
    robot = bundled("heavy_six").robot
    q = np.tile(robot.lower, (2, 1))
    q[:, 1], q[:, 2] = robot.upper[1], robot.upper[2]  # where the sag would have to be undone by J2 and J3 alone
    q[0] = 0.0
    file = path_file(tmp_path, NAMES, q, payload=["p200"] * 2)
    with pytest.raises(UnreachableError, match="limit: J1, J2, J3"):
        programs.rapid(bundled("heavy_six"), file, compensate=True)
    given = [ROBOTS / "heavy_six" / "arm.toml", "--to", "rapid", "--traj", file, "--compensate", "-o", "p.mod"]
    done = run_here(tmp_path, "export", *given)
    assert done.returncode == 1 and "cannot be reached" in done.stderr and not (tmp_path / "p.mod").exists()


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_row_beyond_a_limit_is_refused_with_its_line(language: str, tmp_path: Path) -> None:
    q = np.zeros((2, 6))
    q[1, 2] = 2.5
    with pytest.raises(JointLimitError, match=r"path\.csv:3: joint 'J3' at 2\.5 is outside"):
        getattr(programs, language)(bundled("heavy_six"), path_file(tmp_path, NAMES, q))


def many(folder: Path, count: int, kind: str = "revolute", names: tuple[str, ...] = ()) -> Arm:
    parts = [link("l0", 1.0)]
    for i in range(count):
        name = quoteattr(names[i] if names else f"j{i}")[1:-1].replace('"', "&quot;")
        parts += [joint(name, f"l{i}", f"l{i + 1}", (0.1, 0, 0.3), kind=kind), link(f"l{i + 1}", 1.0)]
    return arm_of(folder, parts, f"l{count}", {})


def test_more_joints_than_a_controller_has_are_refused_by_name(tmp_path: Path) -> None:
    arm = many(tmp_path, 8)
    file = path_file(tmp_path, arm.joint_names, np.zeros((1, 8)))
    with pytest.raises(
        UnsupportedError, match=r"KRL has 6 axes A1 to A6 for turning joints, .* 8: no place for j6, j7"
    ):
        programs.krl(arm, file)
    with pytest.raises(UnsupportedError, match=r"RAPID has 6 axes rax_1 to rax_6 .* has 8: no place for j6, j7"):
        programs.rapid(arm, file)
    with pytest.raises(UnsupportedError, match=r"movej takes six turning joints; this arm has 8: j0, j1"):
        programs.urscript(arm, file)
    sliding = many(tmp_path, 7, "prismatic")
    file = path_file(tmp_path, sliding.joint_names, np.zeros((1, 7)))
    with pytest.raises(UnsupportedError, match=r"E1 to E6 for sliding joints, this arm has 7: no place for j6"):
        programs.krl(sliding, file)
    with pytest.raises(UnsupportedError, match=r"has 7, j0, j1, .* sliding"):
        programs.urscript(sliding, file)


ODD = ("a\nEND", '"; PTP', "'); halt()", "]x[: {", "<&>!", "é \u4e2d\U0001f600")
"""Ends of comments, strings and lists in one language or another, and letters that few controllers have."""


@pytest.mark.parametrize("language", LANGUAGES)
def test_names_are_text(language: str, tmp_path: Path) -> None:
    parts = [link("l0", 1.0)]
    for i, name in enumerate(ODD):
        escaped = quoteattr(name, {'"': "&quot;"})[1:-1]
        parts += [joint(escaped, f"l{i}", f"l{i + 1}", (0.1, 0, 0.3)), link(f"l{i + 1}", 1.0)]
    arm = arm_of(tmp_path, parts, "l6", {})
    assert arm.joint_names == ODD
    q = np.linspace(0.0, 0.5, 12).reshape(2, 6)
    file = path_file(tmp_path, ODD, q, via=["# here", "a; b ! c\u4e2d"])
    text = getattr(programs, language)(arm, file).text
    np.testing.assert_allclose(positions_of(language, text, arm), q, rtol=0.0, atol=2e-11)
    if language != "jointtrajectory":
        assert text.isascii() and r"a\nEND" in text


def test_long_times_are_in_seconds_in_tp(tmp_path: Path) -> None:
    file = tmp_path / "path.csv"
    times = {"time": [0.0, 40.04, 40.0401]} | {f"q_{name}": [0.0, 0.1, 0.2] for name in NAMES}
    write_columns(file, times)
    assert [time for _, time in ls_moves(programs.ls(bundled("heavy_six"), file).text)] == [None, 40.0, 0.001]


@pytest.mark.parametrize("name", ["", "1a", "a b", "end", "PROC", "x" * 25, "a-b", "é", "a\n"])
def test_names_of_programs_that_are_none(name: str, tmp_path: Path) -> None:
    file = path_file(tmp_path, NAMES, np.zeros((1, 6)))
    for language in LANGUAGES[:-1]:
        with pytest.raises(InputError, match="--name"):
            getattr(programs, language)(bundled("heavy_six"), file, name=name)


def test_blends_that_make_no_sense(tmp_path: Path) -> None:
    arm, q = bundled("heavy_six"), np.zeros((2, 6))
    with pytest.raises(InputError, match="negative"):
        programs.urscript(arm, path_file(tmp_path, NAMES, q, blend=[-0.01, 0.0]))
    with pytest.raises(InputError, match="several units"):
        programs.urscript(arm, path_file(tmp_path, NAMES, q, blend=[0.01, 0.0], blend_mm=[10.0, 0.0]))
    with pytest.raises(TableError, match="unknown column 'q_J7'"):
        programs.urscript(arm, path_file(tmp_path, (*NAMES, "J7"), np.zeros((2, 7))))


@pytest.mark.parametrize("language", LANGUAGES)
def test_commands(language: str, tmp_path: Path) -> None:
    arm, file = ROBOTS / "heavy_six" / "arm.toml", ROBOTS / "heavy_six" / "trajectory.csv"
    done = run_here(tmp_path, "export", arm, "--to", language, "-o", "p.txt")
    assert done.returncode == 2 and f"--to {language} needs --traj" in done.stderr
    done = run_here(tmp_path, "export", arm, "--to", language, "--traj", file)
    assert done.returncode == 2 and f"--to {language} needs -o" in done.stderr
    done = run_here(tmp_path, "export", arm, "--to", language, "--traj", file, "-o", "p.txt", "--over", file)
    assert done.returncode == 2 and "--over has no meaning" in done.stderr
    done = run_here(tmp_path, "export", arm, "--to", language, "--traj", file, "-o", "p.txt", "--covariates", "t=1")
    assert done.returncode == 2 and not list(tmp_path.iterdir())
    done = fine(run_here(tmp_path, "export", arm, "--to", language, "--traj", file, "-o", "p.txt", "--json", "p.json"))
    assert "written as it is" in re.sub(r"\s+", " ", done.stdout)
    assert json.loads((tmp_path / "p.json").read_text())["to"] == language
    assert len(positions_of(language, (tmp_path / "p.txt").read_text(), bundled("heavy_six"))) == 66


@pytest.mark.parametrize(("language", "mark"), [("urscript", "#"), ("krl", ";"), ("rapid", "!")])
def test_the_head_says_what_was_written_from_what(language: str, mark: str, tmp_path: Path) -> None:
    file = path_file(tmp_path, NAMES, np.zeros((3, 6)), payload=["p100"] * 3)
    write = partial(getattr(programs, language), bundled("heavy_six"), file, arm_file="my/arm.toml")
    ready = read_trajectory(file, bundled("heavy_six"))
    write_trajectory(compensate(bundled("heavy_six"), ready).trajectory, tmp_path / "ready.csv")
    before = getattr(programs, language)(bundled("heavy_six"), tmp_path / "ready.csv", arm_file="my/arm.toml")
    assert "Its joints differ from its target_ columns: it is compensated already" in before.notes[0]
    said = (
        (write(), "Not compensated"),
        (write(compensate=True), "Compensated"),
        (before, "Compensated before: the joints differ from the target_ columns"),
    )
    for found, what in said:
        head = [line.strip() for line in found.text.splitlines()[:4] if line.strip().startswith(mark)]
        assert head[0] == f"{mark} Written by armflex {__version__} from my/arm.toml"
        assert head[1] == f"{mark} {what}; payload p100, no load from outside"


def test_the_head_says_which_temperature_it_was_compensated_for(tmp_path: Path) -> None:
    warm = Effect(CATALOGUE["thermal_growth"], Location("link:J3", None, ("temperature",)), (1e-5, 20.0, 0.0))
    arm = replace(bundled("heavy_six"), effects=(warm,))
    file = path_file(tmp_path, NAMES, np.zeros((3, 6)), payload=["p100"] * 3)
    found = programs.krl(arm, file, compensate=True, covariates={"temperature": 35.0})
    assert "; Compensated for temperature 35; payload p100" in found.text
    hot = path_file(tmp_path, NAMES, np.zeros((3, 6)), payload=["p100"] * 3, temperature=[20.0, 25.0, 30.0])
    assert "; Compensated for temperature 20 to 30; payload" in programs.krl(arm, hot, compensate=True).text


@pytest.mark.parametrize("language", ["urscript", "rapid"])
def test_stops_at_rows_are_told(language: str, tmp_path: Path) -> None:
    arm, write, q = bundled("heavy_six"), getattr(programs, language), np.zeros((4, 6))
    (told,) = [line for line in write(arm, path_file(tmp_path, NAMES, q)).notes if "stops" in line]
    assert "stops at 4 of 4 rows" in told and "`blend`" in told
    some = write(arm, path_file(tmp_path, NAMES, q, blend_mm=[5.0, 0.0, 5.0, 0.0])).notes
    assert any("stops at 2 of 4 rows" in line for line in some)
    assert not any("stops" in line for line in write(arm, path_file(tmp_path, NAMES, q, blend_mm=[5.0] * 4)).notes)


def test_warnings_about_the_path_are_called_so(tmp_path: Path) -> None:
    arm, file = ROBOTS / "heavy_six" / "arm.toml", path_file(tmp_path, NAMES, np.zeros((2, 6)), payload=["", "p100"])
    command = ("export", arm, "--to", "urscript", "--traj", file, "-o", "p.script", "--compensate")
    done = fine(run_here(tmp_path, *command))
    said = [line for line in done.stderr.splitlines() if "p100" in line]
    assert said and all(line.startswith("warning: ") for line in said) and "p100" not in done.stdout


def test_joints_go_on_the_axes_that_are_named(tmp_path: Path) -> None:
    """A turning joint on an external axis, and two that change places: in its own unit each."""
    arm = bundled("tarm_like")
    path = read_trajectory(ROBOTS / "tarm_like" / "trajectory.csv", arm)
    axes = "E1=A3, E2=M1, A1=A2, A2=A1, A3=A4, A4=A5, A5=A6"
    out = [f"E{i}" for i in (1, 2)] + [f"A{i}" for i in range(1, 6)]
    order = [arm.joint_names.index(name) for name in ("A3", "M1", "A2", "A1", "A4", "A5", "A6")]
    factor = np.array([1e3 if arm.robot.moving[i].kind == "prismatic" else 180.0 / np.pi for i in order])
    moves = krl_moves(programs.krl(arm, ROBOTS / "tarm_like" / "trajectory.csv", axes=axes).text)
    found = np.array([[move[axis] for axis in out] for move in moves])
    np.testing.assert_allclose(found, path.q[:, order] * factor, atol=2e-9)
    rapid = programs.rapid(arm, ROBOTS / "tarm_like" / "trajectory.csv", axes=axes.replace("E1", "eax_b")
                           .replace("E2", "eax_a").replace(" A", " rax_"))  # fmt: skip
    turning, sliding, _, _ = rapid_moves(rapid.text)[3]
    np.testing.assert_allclose(turning[:5], np.degrees(path.q[3, order[2:]]), atol=2e-9)
    np.testing.assert_allclose(sliding[:2], [1e3 * path.q[3, order[1]], np.degrees(path.q[3, order[0]])], atol=2e-9)
    swapped = "0=J2,1=J1,2=J3,3=J4,4=J5,5=J6"
    heavy = ROBOTS / "heavy_six" / "trajectory.csv"
    plain, other = (urscript_moves(programs.urscript(bundled("heavy_six"), heavy, axes=a).text) for a in ("", swapped))
    assert [q[:2] for q, _, _ in plain] == [q[1::-1] for q, _, _ in other]


@pytest.mark.parametrize(
    ("axes", "complaint"),
    [
        ("A1=J1", "--axes: no axis for J2, J3, J4, J5, J6; every joint needs one"),
        ("A1=J1,A1=J2", "--axes: 'A1' is given twice"),
        ("A1=J1,A2=J1", "--axes: 'J1' is given twice"),
        ("A7=J1", "no axis of KRL named 'A7', did you mean"),
        ("A1=K1", "no joint named 'K1', did you mean 'J1'?"),
        ("A1", "--axes: 'A1' is not of the form AXIS=JOINT"),
    ],
)
def test_axes_that_cannot_be(axes: str, complaint: str, tmp_path: Path) -> None:
    heavy = ROBOTS / "heavy_six"
    command = ("export", heavy / "arm.toml", "--to", "krl", "--traj", heavy / "trajectory.csv", "-o", "p.src")
    result = fine(run_here(tmp_path, *command, "--axes", axes), 2)
    assert complaint in result.stderr and not list(tmp_path.iterdir())


def test_a_sliding_joint_on_a_turning_axis_is_refused() -> None:
    axes = "A1=M1,A2=A1,A3=A2,A4=A3,A5=A4,A6=A5,E1=A6"
    with pytest.raises(InputError, match="'M1' slides, axes A1 to A6 turn"):
        programs.krl(bundled("tarm_like"), ROBOTS / "tarm_like" / "trajectory.csv", axes=axes)


def test_loads_of_the_path_are_compensated(tmp_path: Path) -> None:
    """Those of the columns, and those of the command for rows that name none; else they mean nothing."""
    arm, q = bundled("heavy_six"), np.array([[0.1, 0.3, -0.2, 0.1, 0.5, 0.0]] * 2)
    plain, pushed = path_file(tmp_path, NAMES, q), tmp_path / "pushed.csv"
    pushed.write_text(plain.read_text())
    text = plain.read_text().splitlines()
    loads = ("payload,force_fz_kN", "p100,-0.8", "p100,-0.8")
    pushed.write_text("\n".join(",".join(pair) for pair in zip(text, loads, strict=True)) + "\n")
    command = ["export", ROBOTS / "heavy_six" / "arm.toml", "--to", "urscript", "-o", "p.script"]
    written = []
    for file, options in ((pushed, []), (plain, ["--payload", "p100", "--force", "fz=-800N"])):
        fine(run_here(tmp_path, *command, "--traj", file, "--compensate", *options))
        written.append((tmp_path / "p.script").read_text())
    assert written[0] == written[1]
    driven, _, _ = urscript_moves(written[0])[0]
    load = Wrench(arm.robot.tip, [0.0, 0.0, -800.0], [0.0, 0.0, 0.0])
    tip = arm.deflection(np.array(driven), "p100", wrenches=[load]).pose.translation
    np.testing.assert_allclose(tip, arm.rigid_pose(q[0]).translation, atol=1e-9)
    for more, complaint in (([], "need --compensate"), (["--compensate", "--to", "c"], "--to c")):
        options = [*command[:-1], "n.script", "--traj", plain, "--payload", "p100", *more]
        assert complaint in fine(run_here(tmp_path, *options), 2).stderr and not (tmp_path / "n.script").exists()


FORMATS = {
    "urdf": [], "sheet": [], "yaml": ["--flavour", "ur_calibration"], "c": [],
    **{one: ["--traj", ROBOTS / "heavy_six" / "trajectory.csv", "--compensate"] for one in LANGUAGES},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_nothing_is_written_but_what_is_asked_for(name: str, tmp_path: Path) -> None:
    """The file, and the JSON; where the arm or a payload is not there, nothing, and what stood there stays."""
    source = tmp_path / "in"
    shutil.copytree(ROBOTS / "heavy_six", source)
    out = tmp_path / "out"
    out.mkdir()
    before = {file: file.read_bytes() for file in source.rglob("*") if file.is_file()}
    command = ["export", source / "arm.toml", "--to", name, *FORMATS[name], "-o", "made", "--json", "told.json"]
    fine(run_here(out, *command))
    assert {file.name for file in out.iterdir()} == {"made", "told.json"}
    (out / "made").write_text("mine")
    wrong = source / "wrong.toml"
    wrong.write_text((source / "arm.toml").read_text().replace('joint = "J3"', 'joint = "J33"'))
    assert "J33" in fine(run_here(out, *["export", wrong, *command[2:]]), 2).stderr
    assert (out / "made").read_text() == "mine" and {file.name for file in out.iterdir()} == {"made", "told.json"}
    wrong.unlink()
    assert before == {file: file.read_bytes() for file in source.rglob("*") if file.is_file()}
