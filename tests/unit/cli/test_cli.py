"""The command line, as a shell runs it or in this process: exit codes, JSON files, messages, nothing left behind."""

import csv
import io
import logging
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from goldens import compare
from rich.console import Console
from support.command_line import Run, few_rows, fine, run_here, strict_json, wait_for
from support.small_arms import ROBOTS

from armflex import Arm, Trajectory, Wrench, compensate, load_arm, load_law, read_trajectory, trace
from armflex.cli import terminal
from armflex.cli.main import COMMANDS
from armflex.cli.trace_command import as_json
from armflex.errors import Flag
from armflex.progress import Doing
from armflex.trace.findings import Trace
from armflex.trajectory import write_trajectory
from armflex.version import __version__

TARM, HEAVY = ROBOTS / "tarm_like", ROBOTS / "heavy_six"
TABLE = TARM / "a4_table_1.csv"


def test_help_of_the_whole_names_every_command(shell: Run, armflex: Run) -> None:
    text = fine(shell("--help")).stdout
    assert all(f"  {name} " in text for name in COMMANDS)
    assert "deflect" in fine(armflex(), 2).stderr and "deflect" in fine(armflex("-h")).stdout
    assert fine(armflex("--version")).stdout.strip()


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command(armflex: Run, command: str) -> None:
    text = fine(armflex(command, "--help")).stdout
    assert text.startswith("Usage: ") and command in text.splitlines()[0]
    assert "--json" in text


ARM_WITH_BOTH = """[robot]
dh = "standard"
gravity = [0.0, 0.0, -9.81]
[robot.joint]
A1 = { d_mm = 450, a_mm = 150, alpha_deg = -90 }
A2 = { theta_deg = -90, a_mm = 850 }
[payload.p]
mass = 100.0
com = [0.0, 0.0, 0.0]
[flexure.A2]
joint = "A2"
joint_stiffness = 1.0e6
[[effect]]
name = "gear_harmonic"
site = "A2"
axis = "rz"
covariates = ["q_A2"]
parameters = { A = 0.0, B = 1e-3, k = 1.0 }
"""


def test_deflect_prints_a_flexure_and_the_effects_at_its_joint_apart(armflex: Run, tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(ARM_WITH_BOTH)
    printed = fine(armflex("deflect", "arm.toml", "--q", "A2=90deg", "--payload", "p")).stdout
    table = printed.partition("Local deflection")[2].partition("Tip:")[0]
    rows = {line[:15].strip(): [float(cell) for cell in line[15:].split()] for line in table.splitlines()[4:-1]}
    # 100 kg at 0.85 m on 1e6 Nm/rad, and a wave whose cosine is 0 here, or 1 at 0.
    assert rows["A2"][5] == pytest.approx(0.8339, rel=1e-3)
    assert abs(rows["effects at A2"][5]) < 2e-3
    printed = fine(armflex("deflect", "arm.toml", "--q", "A2=0", "--payload", "p")).stdout
    assert [line.split()[8] for line in printed.splitlines() if line.startswith(" effects at A2")] == ["1"]


def test_deflect_json(armflex: Run, tmp_path: Path, tarm: Arm) -> None:
    result = fine(
        armflex(
            "deflect", TARM / "arm.toml", "--q", "M1=1500mm, A1=10deg,A3=0.5", "--payload", "p600", "--json", "d.json"
        )
    )
    found = strict_json(tmp_path / "d.json")
    assert (found["format"], found["base"], found["tip"]) == ("armflex-deflect-1", "crane", "tool")
    q = tarm.position(M1=1.5, A1=np.deg2rad(10.0), A3=0.5)
    expected = tarm.deflection(q, "p600")
    for name in ("q", "wrenches", "twists", "displacement", "covariance", "compliance", "contributions", "joint_loads"):
        np.testing.assert_allclose(found[name], getattr(expected, name), rtol=1e-10, atol=1e-15)
    assert f"{np.linalg.norm(expected.displacement[:3]) * 1e3:.4g} mm" in result.stdout


@pytest.mark.parametrize(("text", "newtons"), [("0,0,-500N", 500.0), ("0,0,-0.5kN", 500.0), ("0,0,-50kgf", 490.3325)])
def test_deflect_under_a_force_with_unit(armflex: Run, tmp_path: Path, heavy: Arm, text: str, newtons: float) -> None:
    fine(armflex("deflect", HEAVY / "arm.toml", "--force", f"tool={text}", "--json", "d.json"))
    load = Wrench("tool", np.array([0.0, 0.0, -newtons]), np.zeros(3))
    expected = heavy.deflection(np.zeros(6), wrenches=[load]).displacement
    np.testing.assert_allclose(strict_json(tmp_path / "d.json")["displacement"], expected, rtol=1e-12)


@pytest.mark.parametrize(("robot", "tolerance", "code"), [(TARM, "0.1m", 1), (HEAVY, "5mm", 1), (HEAVY, "1cm", 0)])
def test_check_json_and_exit_code(armflex: Run, tmp_path: Path, robot: Path, tolerance: str, code: int) -> None:
    result = fine(
        armflex("check", robot / "arm.toml", robot / "trajectory.csv", "--tolerance", tolerance, "--json", "c.json"),
        code,
    )
    found = strict_json(tmp_path / "c.json")
    assert found["format"] == "armflex-check-1" and found["ok"] == (code == 0)
    said = {"ok": "is within", "uncertain": "is NOT certain to be within", "fail": "is NOT within"}
    assert f"The path {said[found['path_worst']['verdict']]} tolerance" in result.stdout
    assert all(point["name"] in result.stdout for point in found["via_points"])
    assert found["tolerance_m"] == {"0.1m": 0.1, "5mm": 0.005, "1cm": 0.01}[tolerance]


@pytest.mark.parametrize(("robot", "match"), [(TARM, "position"), (HEAVY, "pose")])
def test_compensate_writes_what_python_finds(
    armflex: Run, tmp_path: Path, tarm: Arm, heavy: Arm, robot: Path, match: str
) -> None:
    arm = tarm if robot is TARM else heavy
    path = few_rows(robot / "trajectory.csv", tmp_path / "t.csv", 20)
    fine(armflex("compensate", robot / "arm.toml", path, "-o", "o.csv", "--match", match, "--json", "c.json"))
    written: Trajectory = read_trajectory(tmp_path / "o.csv", arm)
    expected = compensate(arm, read_trajectory(path, arm), match)
    np.testing.assert_allclose(written.q, expected.trajectory.q, rtol=0, atol=1e-12)
    found = strict_json(tmp_path / "c.json")
    assert found["sigma_m"] == max(row["sigma_m"] for row in found["rows"])
    assert found["format"] == "armflex-compensate-1" and found["ok"] and len(found["rows"]) == 20


def test_check_against_says_whether_a_compensated_path_is_where_it_was_meant(armflex: Run, tmp_path: Path) -> None:
    arm, path = HEAVY / "arm.toml", few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 10)
    fine(armflex("compensate", arm, path, "-o", "o.csv", "--json", "c.json"))
    command = ["check", arm, "o.csv", "--tolerance", "1mm", "--against", path, "--json", "k.json"]
    said = " ".join(fine(armflex(*command)).stdout.split())  # a long path begins a line of its own
    assert f"against the rigid tip on {path}" in said
    found, row = strict_json(tmp_path / "k.json"), strict_json(tmp_path / "c.json")["rows"][0]
    assert found["ok"] and found["against"] == str(path) and found["path_worst"]["displacement_m"] < 1e-5
    assert found["via_points"][0]["sigma_m"] == pytest.approx(row["sigma_m"], rel=1e-6)
    # As it was, the path is off by what the loaded tip sags; and a path of other rows is not this one's.
    fine(armflex("check", arm, path, "--tolerance", "1mm", "--against", path), 1)
    few_rows(HEAVY / "trajectory.csv", tmp_path / "short.csv", 9)
    result = fine(armflex(*command[:-4], "--against", "short.csv", "--json", "n.json"), 2)
    assert "the desired path has 9 rows, this one has 10" in result.stderr and not (tmp_path / "n.json").exists()


def narrowed(folder: Path) -> Path:
    """Copy heavy_six with a J2 that cannot go back far enough to lift."""
    shutil.copytree(HEAVY, folder / "narrow")
    urdf = folder / "narrow" / "robot.urdf"
    urdf.write_text(urdf.read_text().replace('lower="-1.05" upper="1.3"', 'lower="0.4433" upper="1.3"'))
    return folder / "narrow" / "arm.toml"


@pytest.mark.slow
def test_compensate_out_of_reach_writes_nothing_unless_asked(armflex: Run, tmp_path: Path) -> None:
    arm, path = narrowed(tmp_path), few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 30)
    command = ["compensate", arm, path, "-o", "o.csv", "--match", "pose", "--json", "c.json"]
    result = fine(armflex(*command), 1)
    assert "limit: J2" in result.stdout and not (tmp_path / "o.csv").exists()
    assert not strict_json(tmp_path / "c.json")["ok"]
    fine(armflex(*command, "--best-effort"), 1)
    assert (tmp_path / "o.csv").exists()


def test_compensate_between(armflex: Run, tmp_path: Path) -> None:
    path = few_rows(HEAVY / "trajectory.csv", tmp_path / "t.csv", 10)
    fine(armflex("compensate", HEAVY / "arm.toml", path, "-o", "o.csv", "--between", "0.1um", "--json", "c.json"))
    assert strict_json(tmp_path / "c.json")["between_m"] <= 1e-7
    assert len((tmp_path / "o.csv").read_text().splitlines()) > 11


def test_train_json_and_file(armflex: Run, tmp_path: Path) -> None:
    fine(armflex("train", TABLE, "--model", "linear", "-o", "a.safetensors", "--json", "t.json"))
    found = strict_json(tmp_path / "t.json")
    assert (found["format"], found["model"], found["rows"], found["unit"]) == ("armflex-train-1", "linear", 20, "mm")
    np.testing.assert_array_equal(np.round(found["train_rms"], 3), [0.142, 0.099, 0.341])
    np.testing.assert_array_equal(np.round(found["held_out_rms"], 3), [0.172, 0.121, 0.415])
    assert found["compared"] == [{"model": "linear", "held_out_rms": found["held_out_rms"]}]
    law = load_law(tmp_path / "a.safetensors").law
    np.testing.assert_allclose(law.compliance[:3, :3], found["parameters"]["compliance"])
    fine(armflex("train", TABLE, "--read-as", "mm=um", "--structure", "diagonal", "-o", "b.safetensors"))
    assert load_law(tmp_path / "b.safetensors").metadata["units"] == ["um"] * 3


def campaign(folder: Path) -> Path:
    """Write a campaign as it comes from the field: measured columns, units, covariates, rows without a reading."""
    header = "pose,session,time,payload,q_J1_deg,q_J2,q_J3,q_J4,q_J5,q_J6,approach_J1,x_mm,y_mm,z_mm,sigma_mm,weather"
    rows = ["p1,a,0,p200,10,0.1,0.2,0,0.8,0,1,1500,2,3,0.02,fair", "p2,b,5,,-20,0.3,0,0,0.5,0.1,-1,,,,,foul"]
    (folder / "m.csv").write_text("\n".join((header, *rows)) + "\n")
    return folder / "m.csv"


def test_predict_on_a_campaign(armflex: Run, tmp_path: Path, heavy: Arm) -> None:
    result = fine(armflex("predict", HEAVY / "arm.toml", campaign(tmp_path), "-o", "o.csv", "--json", "p.json"))
    rows = list(csv.DictReader((tmp_path / "o.csv").open()))
    assert [(row["pose"], row["session"], row["payload"]) for row in rows] == [("p1", "a", "p200"), ("p2", "b", "none")]
    for row, q, payload in zip(
        rows,
        ([np.deg2rad(10), 0.1, 0.2, 0, 0.8, 0], [np.deg2rad(-20), 0.3, 0, 0, 0.5, 0.1]),
        ("p200", "none"),
        strict=True,
    ):
        found = heavy.deflection(q, payload)
        np.testing.assert_allclose([float(row[n]) for n in "xyz"], found.pose.translation, rtol=1e-12)
        np.testing.assert_allclose([float(row[n]) for n in ("dx", "dy", "dz", "rx", "ry", "rz")], found.displacement)
        sigma = np.sqrt(np.diag(found.covariance)[:3])
        np.testing.assert_allclose([float(row[f"sigma_{n}"]) for n in "xyz"], sigma, rtol=1e-12)
    summary = strict_json(tmp_path / "p.json")
    assert summary["rows"] == 2
    assert "base_frame" in result.stderr


def test_view_writes_a_page_and_says_so(armflex: Run, tmp_path: Path) -> None:
    fine(armflex("view", HEAVY / "arm.toml", "--q", "J2=0.3", "--payload", "p200", "-o", "v.html", "--json", "v.json"))
    assert strict_json(tmp_path / "v.json") == {
        "armflex": __version__, "format": "armflex-view-1", "page": "v.html", "base": "base", "tip": "tool"
    }  # fmt: skip
    assert (tmp_path / "v.html").stat().st_size > 500_000


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess, Trace]:
    """Run the demonstration; return its folder, what it said, and the trace that it made, which takes longest."""
    folder, made = tmp_path_factory.mktemp("demo"), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "160")
        patch.setattr(
            "armflex.cli.demo_command.trace", lambda *given, **rest: made.append(trace(*given, **rest)) or made[0]
        )
        said = fine(run_here(folder, "demo", "-o", "out", "--json", "demo.json"))
    return folder, said, made[0]


@pytest.mark.slow
def test_demo_runs_through(demo) -> None:
    folder, result, _ = demo
    shifts = strict_json(folder / "demo.json")["tip_moves_m"]
    assert shifts["paper_A4_literal"] > 4 * shifts["paper_A4_um"] > 4 * shifts["paper_A4_composed"]
    assert "no machine" in result.stdout and "a machine" in result.stdout
    names = {path.name for path in (folder / "out").iterdir()}
    assert names == {"tarm_like", "tarm_like.html", "compensated.csv", "traced.toml", "trace.html"}
    assert strict_json(folder / "demo.json")["traced"] == ["backlash at A2 (ry)"]


@pytest.mark.slow
def test_the_demo_traces_what_it_traced(demo) -> None:
    """It is the trace of `armflex trace` on the boom's campaign."""
    assert compare("trace_tarm", as_json(demo[2])) == []


A, T = TARM / "arm.toml", TARM / "trajectory.csv"
BAD = {
    "a command that is gone": (["trust", A], "trust is no more: an arm file runs no code"),
    "an option that is gone": (["map", A, "--store", "d"], "--store is no more: leave it out; a map of the default"),
    "no such command": (["chek"], "no command 'chek', did you mean 'check'"),
    "no such option": (["deflect", A, "--paylod", "p600"], "Did you mean '--payload'"),
    "missing tolerance": (["check", A, T], "has no tolerance: give one for such rows (--tolerance 5mm"),
    "missing argument": (["deflect"], "missing argument 'ARM'"),
    "missing arm": (["deflect", "none.toml"], "none.toml: cannot be read: No such file"),
    "folder as arm": (["deflect", TARM], "tarm_like: cannot be read: Is a directory"),
    "missing URDF": (["deflect", "none.urdf"], "none.urdf: cannot be read"),
    "an arm that is no TOML": (["deflect", T], "trajectory.csv is no arm (ARM)"),
    "missing trajectory": (["check", A, "none.csv", "--tolerance", "5mm"], "none.csv: cannot be read"),
    "another arm's trajectory": (
        ["check", A, HEAVY / "trajectory.csv", "--tolerance", "5mm"],
        "trajectory.csv:1: seems to be of another arm: it has q_J1",
    ),
    "unknown joint": (["deflect", A, "--q", "A9=1"], "no joint named 'A9', did you mean 'A"),
    "joint twice": (["deflect", A, "--q", "A1=1,A1=2"], "joint 'A1' is given twice"),
    "joint in two options": (["deflect", A, "--q", "A1=1", "--q", "A1=2"], "joint 'A1' is given twice"),
    "no position": (["deflect", A, "--q", "A1"], "'A1' is not of the form JOINT=POSITION"),
    "empty position": (["deflect", A, "--q", "A1="], "'rad': expected a"),
    "outside limits": (["deflect", A, "--q", "A2=1"], "joint 'A2' at 1 is outside its limits"),
    "huge position": (["deflect", A, "--q", "A1=1e400"], "is not a finite angle"),
    "degrees for a slide": (["deflect", A, "--q", "M1=1deg"], "'deg' is no unit of length"),
    "unknown payload": (["deflect", A, "--payload", "p60"], "no payload named 'p60', did you mean 'p600'"),
    "unknown preset": (["deflect", A, "--preset", "paper_A4"], "no preset named 'paper_A4', did you mean 'paper_A4_"),
    "preset of a URDF": (["deflect", TARM / "robot.urdf", "--preset", "x"], "no preset named 'x'"),
    "force without unit": (["deflect", A, "--force", "tool=0,0,-500"], "expected a force with its unit"),
    "force in another unit": (["deflect", A, "--force", "tool=0,0,-5mm"], "'mm' is no unit of force"),
    "force of two": (["deflect", A, "--force", "tool=0,-5N"], "is not of the form LINK=FX,FY,FZ"),
    "force at no link": (["deflect", A, "--force", "tol=0,0,-5N"], "no link named 'tol', did you mean 'tool'"),
    "unknown method": (["deflect", A, "--method", "newtn"], "'newtn' is not known, did you mean 'newton'"),
    "tolerance without unit": (["check", A, T, "--tolerance", "5"], "length with its unit, such as 5mm"),
    "tolerance of angle": (["check", A, T, "--tolerance", "5mrad"], "'mrad' is no unit of length"),
    "endless tolerance": (["check", A, T, "--tolerance", "1e400mm"], "'1e400mm' is not a finite length"),
    "no tolerance": (["check", A, T, "--tolerance", "0mm"], "tolerance must be positive"),
    "negative gap": (["compensate", A, T, "-o", "o", "--between", "-1mm"], "between must be positive"),
    "match": (["compensate", A, T, "-o", "o", "--match", "both"], "'both' is not known (known: position, pose)"),
    "no output": (["compensate", A, T], "missing option '-o'"),
    "train without unit": (["train", "nounit.csv", "-o", "o"], "column 'dx' has no unit"),
    "train a trajectory": (["train", T, "-o", "o"], "has no column 'fx'"),
    "train an unknown model": (["train", TABLE, "--model", "liner", "-o", "o"], "'liner' is not"),
    "read-as": (["train", TABLE, "--read-as", "mm", "-o", "o"], "'mm' is not of the form mm=um"),
    "predict without joints": (["predict", A, TABLE, "-o", "o"], "has no column 'q_M1'"),
    "predict with a misspelt payload": (["predict", A, "paylod.csv", "-o", "o"], "'paylod', did you mean 'payload'"),
    "predict degrees": (["predict", A, "outside.csv", "-o", "o"], "outside.csv:3: joint 'A2' at 12 is outside"),
    "magnify nothing": (["view", A, "-o", "o", "--magnify", "0"], "magnification must be positive"),
    "magnify out of sight": (
        ["view", A, "-o", "o", "--magnify", "1e300"],
        "magnification must be positive and at most",
    ),
    "magnify by a word": (["view", A, "-o", "o", "--magnify", "much"], "'much' is not a valid float"),
    "demo into a file": (["demo", "-o", "paylod.csv"], "paylod.csv/tarm_like: cannot be written"),
}


@pytest.mark.parametrize(("arguments", "complaint"), BAD.values(), ids=BAD)
def test_bad_input_exits_with_2_and_says_what(armflex: Run, tmp_path: Path, arguments: list, complaint: str) -> None:
    header = "q_M1,q_A1,q_A2,q_A3,q_A4,q_A5,q_A6"
    (tmp_path / "nounit.csv").write_text("fx,fy,fz,dx,dy,dz\n" + "1,2,3,4,5,6\n" * 9)
    (tmp_path / "paylod.csv").write_text(f"{header},paylod\n0,0,0,0,0,0,0,p600\n")
    (tmp_path / "outside.csv").write_text(f"{header}\n0,0,0,0,0,0,0\n0,0,12,0,0,0,0\n")
    before = sorted(tmp_path.rglob("*"))
    json_file = [] if arguments[0] in ("demo", "chek") else ["--json", "j.json"]
    result = fine(armflex(*arguments, *json_file), 2)
    assert complaint in result.stderr
    said = [line for line in result.stderr.splitlines() if not line.startswith("warning: ")]
    assert len(said) == 1 and said[0].startswith("error: ")
    assert sorted(tmp_path.rglob("*")) == before, "something was left behind"


WRITERS = {
    "compensate": ["compensate", HEAVY / "arm.toml", HEAVY / "trajectory.csv", "-o"],
    "train": ["train", TABLE, "-o"],
    "predict": ["predict", HEAVY / "arm.toml", HEAVY / "trajectory.csv", "-o"],
    "view": ["view", HEAVY / "arm.toml", "-o"],
    "json": ["deflect", HEAVY / "arm.toml", "--json"],
}


@pytest.mark.parametrize("command", WRITERS)
@pytest.mark.parametrize("place", ["folder", "none/o.csv", "/proc/o.csv"])
def test_output_that_cannot_be_written(armflex: Run, tmp_path: Path, command: str, place: str) -> None:
    if place.startswith("/proc") and not Path("/proc").is_dir():
        pytest.skip("no /proc, where even root cannot create a file")
    (tmp_path / "folder").mkdir()
    result = fine(armflex(*WRITERS[command], place), 2)
    assert Path(place).name in result.stderr
    assert [path.name for path in tmp_path.rglob("*")] == ["folder"]


@pytest.mark.parametrize("command", ["compensate", "train", "predict", "view"])
def test_bad_output_is_noticed_before_the_other_file_is_written(armflex: Run, tmp_path: Path, command: str) -> None:
    for output, other in (("none/o", "j.json"), ("o", "none/j.json")):
        fine(armflex(*WRITERS[command], output, "--json", other), 2)
        assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
def test_a_pipe_is_written_to_and_not_replaced(armflex: Run, tmp_path: Path) -> None:
    """As a device such as /dev/null must be, which a test had better leave alone."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        fine(armflex(*WRITERS["json"], pipe))
        assert b'"format": "armflex-deflect-1"' in os.read(reader, 65536)
    finally:
        os.close(reader)
    assert pipe.is_fifo() and list(tmp_path.iterdir()) == [pipe]


def test_an_arm_that_gives_too_far_exits_with_1(armflex: Run, tmp_path: Path) -> None:
    shutil.copytree(HEAVY, tmp_path / "soft")
    arm = tmp_path / "soft" / "arm.toml"
    arm.write_text(arm.read_text().replace("1.2e-7, 4.5e-7, 1.2e-7", "1.2e-7, 4.5e-4, 1.2e-7"))
    assert "turns by" in fine(armflex("deflect", arm), 1).stderr
    assert "large_sag" in fine(armflex("deflect", arm, "--allow-large")).stderr


def test_doubts_go_to_stderr(armflex: Run) -> None:
    result = fine(armflex("deflect", TARM / "robot.urdf"))
    assert "warning: rigid:" in result.stderr and "rigid:" not in result.stdout


@pytest.mark.slow
def test_a_terminal_without_the_plus_minus_sign(shell: Run) -> None:
    command = ["check", HEAVY / "arm.toml", HEAVY / "trajectory.csv", "--tolerance", "1m"]
    assert "± mm" in fine(shell(*command, PYTHONIOENCODING="utf-8")).stdout
    assert "? mm" in fine(shell(*command, PYTHONIOENCODING="ascii")).stdout


def test_a_reader_that_goes_away_gets_no_traceback() -> None:
    code = f"from armflex.cli.main import main; import sys; sys.argv = ['armflex', 'deflect', {str(A)!r}]; main()"
    child = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROBOTS.parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    child.stdout.close()
    assert b"Traceback" not in child.communicate(timeout=600)[1]
    assert child.returncode == 0  # the verdict is that of the work


@pytest.mark.slow
def test_a_demo_leaves_an_edited_arm_alone(demo, armflex: Run, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("armflex.cli.demo_command.trace", lambda *_, **__: demo[2])  # of files that nobody edited
    (tmp_path / "d" / "tarm_like").mkdir(parents=True)
    edited = (TARM / "learned.toml").read_text().replace("payload_rating = 600.0", "payload_rating = 500.0")
    (tmp_path / "d" / "tarm_like" / "learned.toml").write_text(edited)
    result = fine(armflex("demo", "-o", "d"))
    assert (tmp_path / "d" / "tarm_like" / "learned.toml").read_text() == edited
    assert "exceeds the rated 500 kg" in result.stderr


def unnamed_rows(folder: Path, count: int) -> Path:
    """Write a path of many rows that names no via-points."""
    arm = load_arm(HEAVY / "arm.toml")
    q = np.linspace([0.0, 0.2, 0.4, 0.1, 0.5, 0.0], [0.3, 0.3, 0.3, 0.2, 0.6, 0.1], count)
    path = Trajectory(arm.joint_names, np.arange(count) * 1.0, q, ("none",) * count, ("",) * count)
    return write_trajectory(path, folder / "rows.csv")


def test_a_path_without_via_points_is_said_to_have_none(armflex: Run, tmp_path: Path) -> None:
    unnamed_rows(tmp_path, 60)
    shown = fine(armflex("compensate", HEAVY / "arm.toml", "rows.csv", "-o", "o.csv")).stdout
    assert "\\n" not in shown and "names no via-points" in shown and "a column `via`" in " ".join(shown.split())
    assert "60 of 60 rows reached" in shown and "more" not in shown and "not reached;" in " ".join(shown.split())
    assert shown.count("  reached") in (2, 3)  # first, last, and where most remains
    shown = fine(armflex("check", HEAVY / "arm.toml", "rows.csv", "--tolerance", "1m")).stdout
    assert "names no via-points" in shown and "within tolerance" in shown
    assert all(word in shown for word in ("first", "worst row", "last", "Worst of the whole path"))


def test_rows_that_are_left_out_of_a_table_are_counted_as_what_they_are(armflex: Run, tmp_path: Path) -> None:
    narrow = narrowed(tmp_path)
    arm = load_arm(narrow)
    path = read_trajectory(HEAVY / "trajectory.csv", arm)
    rows = path.via.index("lift")
    many = Trajectory(
        arm.joint_names, np.arange(50.0), np.tile(path.q[rows], (50, 1)), (path.payload[rows],) * 50,
        tuple(f"v{i}" for i in range(50)),
    )  # fmt: skip
    write_trajectory(many, tmp_path / "many.csv")
    shown = armflex("compensate", narrow, "many.csv", "-o", "o.csv").stdout
    lost = 50 - int(re.search(r"(\d+) of 50 rows reached", shown)[1])
    hidden = re.search(r"10 further rows are not shown; (\d+) of them were not reached", shown)
    assert int(hidden[1]) == (10 if lost else 0)


def test_a_pipe_gets_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.setattr(terminal, "EVERY", 0.2)
    monkeypatch.setattr(terminal, "REDRAWN", 0.05)
    lines = list[str]()

    def heard(text: str) -> bool:
        lines.extend(line.partition(" s  ")[2] for line in capsys.readouterr().err.splitlines())
        return text in lines

    with terminal.showing_stages("reading"):
        wait_for(lambda: heard("reading"))
        terminal.show_stage("searching")
        for number in range(2000):
            terminal.doing(Doing("searching", "screening candidates", number, 2000))
        wait_for(lambda: heard("searching: screening candidates, 1999 of 2000"))
        with terminal.progress("checking") as tick:
            tick(3, 9)
            wait_for(lambda: heard("checking, 3 of 9"))
    whole = ["reading", "searching", "searching: screening candidates, 1999 of 2000", "checking, 3 of 9"]
    assert [line for line in dict.fromkeys(lines) if "of 2000" not in line or line in whole] == whole
    assert len(lines) < 200


def test_a_terminal_gets_a_live_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    """It stands in the last line alone, is as wide as that at most, and makes way for what is printed."""
    monkeypatch.setattr(terminal, "REDRAWN", 0.02)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "60")
    with terminal.showing_stages():
        terminal.show_stage("searching")
        terminal.doing(Doing("searching", "refining " + 100 * "x", 1, 2))
        written = ""

        def heard(text: str) -> bool:
            nonlocal written
            written += capsys.readouterr().err
            return text in written

        wait_for(lambda: heard("refining") and written.count("\r") > 2)
        logging.getLogger("armflex.mechanics").warning("a word")
        wait_for(lambda: heard("a word\n") and "refining" in written.partition("a word\n")[2])
    written += capsys.readouterr().err
    assert "\r\x1b[Ka word\n" in written and written.endswith("\r\x1b[K")
    assert written.count("\n") == 2
    assert max(len(line) for line in re.split("[\r\n]", written.replace("\x1b[K", ""))) <= 60


def test_a_command_says_from_the_first_that_it_works(armflex: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal, "EVERY", 0.0)
    monkeypatch.setattr(terminal, "REDRAWN", 0.001)
    assert "0 s  reading arm.toml\n" in fine(armflex("deflect", HEAVY / "arm.toml")).stderr


@pytest.mark.parametrize("width", [20, 60, 80, 200])
def test_tables_break_no_word_and_no_number(monkeypatch: pytest.MonkeyPatch, width: int) -> None:
    shown = io.StringIO()
    console = Console(file=shown, width=width, force_terminal=True, color_system=None)
    monkeypatch.setattr("armflex.cli.terminal.stream", lambda: console)
    rows = [["ISO pose P1", "none", "0.00292", "0.0354"], ["a pose PositionTwentyFive", "rated load", "-1.25e-05", "3"]]
    columns = ["pose", "payload", "AP with this model", "repeatability"]
    terminal.print_table("ISO 9283", columns, rows)
    words = [word for word in shown.getvalue().split() if "\u2500" not in word]
    expected = Counter(" ".join(map(" ".join, [columns, *rows])).split())
    assert not expected - Counter(words) and set(words) - set(expected) <= {"ISO", "9283", "9283,", "continued"}


@pytest.mark.parametrize(("count", "printed"), [(4, 4), (5, 4), (72, 4)])
def test_of_many_flags_that_are_alike_the_first_are_printed(count: int, printed: int, capsys, monkeypatch) -> None:
    monkeypatch.setattr(terminal, "_said", set())
    terminal.show_flags([*(Flag("payload_change", f"row {i}") for i in range(count)), Flag("soft", "it bends")])
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == printed + 1 and "row 2" in lines[2] and lines[-1].endswith("soft: it bends")
    assert count == 4 or f"{count - 3} more" in lines[3]
