"""Spoilt files through the command line, in process: exit code 0, 1 or 2, one line of what is wrong, no traceback."""

import tomllib
from pathlib import Path
from typing import Any

from harness import FOLDER, as_toml, cases, judge_command, mutated_bytes, mutated_table, mutated_tree, written
from hypothesis import given
from hypothesis import strategies as st
from seeds import ARM, PATH, PATH_HEADER, URDF, arm, campaign, declared
from support.small_arms import ROBOTS

PLAIN = ARM.replace("LEARN", "").partition("[[effect]]")[0]
QUICK = PLAIN.replace("geometry = 1e-4\n", "")
"""Fitted in less time: no parameters of the geometry."""

ARMS = st.one_of(mutated_tree(tomllib.loads(PLAIN)).map(as_toml), mutated_bytes(PLAIN.encode()))
ROWS = st.deferred(lambda: mutated_table(campaign()[0], campaign()[1][:4]))


def run(command: str, spoilt: str | bytes, *arguments: object) -> None:
    """Run a command with a spoilt arm."""
    declared()
    judge_command(command, written("arm.toml", spoilt), *arguments)


def plain() -> Path:
    """Return the path of the arm without effects."""
    arm()
    return FOLDER / "plain.toml"


def seed_of(name: str, header: tuple[str, ...], rows: Any) -> Path:
    return written(name, "".join(",".join(row) + "\n" for row in (header, *rows)))


@cases(30)
@given(ARMS)
def test_deflect(spoilt: str | bytes) -> None:
    run("deflect", spoilt, "--q", "yaw=0.1,lift=0.2", "--payload", "p5", "--json", FOLDER / "out.json")


@cases(30)
@given(mutated_bytes(URDF.encode()))
def test_deflect_of_a_urdf(spoilt: bytes) -> None:
    judge_command("deflect", written("bare.urdf", spoilt), "--q", "yaw=0.1")


@cases(15)
@given(st.text(max_size=20), st.sampled_from(("--q", "--payload", "--force", "--covariates", "--preset", "--tip")))
def test_options(text: str, option: str) -> None:
    judge_command("deflect", plain(), option, text)


@cases(20)
@given(ARMS)
def test_predict_with_a_spoilt_arm(spoilt: str | bytes) -> None:
    header, rows = campaign()
    run("predict", spoilt, seed_of("rows.csv", header, rows[:2]), "-o", FOLDER / "out.csv")


@cases(30)
@given(ROWS)
def test_predict_spoilt_rows(spoilt: bytes) -> None:
    judge_command("predict", plain(), written("rows.csv", spoilt), "-o", FOLDER / "out.csv")


@cases(20)
@given(ARMS)
def test_check_with_a_spoilt_arm(spoilt: str | bytes) -> None:
    run("check", spoilt, seed_of("path.csv", PATH_HEADER, PATH), "--tolerance", "5mm")


@cases(30)
@given(mutated_table(PATH_HEADER, PATH))
def test_compensate_a_spoilt_path(spoilt: bytes) -> None:
    judge_command("compensate", plain(), written("path.csv", spoilt), "-o", FOLDER / "out.csv")


@cases(20)
@given(mutated_table(PATH_HEADER, PATH), st.sampled_from(("krl", "rapid", "jointtrajectory")))
def test_export_a_spoilt_path(spoilt: bytes, language: str) -> None:
    judge_command(
        "export", plain(), "--to", language, "--traj", written("path.csv", spoilt), "-o", FOLDER / "out", "--compensate"
    )


@cases(20)
@given(ARMS, st.sampled_from((("urdf",), ("sheet",), ("yaml", "--flavour", "robot_calibration"))))
def test_export_a_spoilt_arm(spoilt: str | bytes, asked: tuple[str, ...]) -> None:
    run("export", spoilt, "--to", *asked, "-o", FOLDER / "out")


@cases(20)
@given(mutated_bytes(URDF.encode()), st.sampled_from(("urdf", "sheet")))
def test_export_a_spoilt_urdf(spoilt: bytes, form: str) -> None:
    judge_command("export", written("bare.urdf", spoilt), "--to", form, "-o", FOLDER / "out")


@cases(30)
@given(mutated_bytes((ROBOTS / "tarm_like" / "a4_table_1.csv").read_bytes()))
def test_train_on_a_spoilt_table(spoilt: bytes) -> None:
    judge_command("train", written("joint.csv", spoilt), "-o", FOLDER / "law.safetensors")


@cases(10)
@given(mutated_tree(tomllib.loads(QUICK)).map(as_toml))
def test_calibrate_a_spoilt_arm(spoilt: str) -> None:
    header, rows = campaign()
    run("calibrate", spoilt, seed_of("rows.csv", header, rows[:12]), "-o", FOLDER / "out.toml")


@cases(15)
@given(st.deferred(lambda: mutated_table(campaign()[0], campaign()[1][:12])))
def test_calibrate_with_spoilt_rows(spoilt: bytes) -> None:
    declared()
    rows = written("rows.csv", spoilt)
    judge_command("calibrate", written("quick.toml", QUICK), rows, "-o", FOLDER / "out.toml")


@cases(10)
@given(ARMS)
def test_view_a_spoilt_arm(spoilt: str | bytes) -> None:
    run("view", spoilt, "-o", FOLDER / "out.html")


@cases(10)
@given(ARMS)
def test_map_a_spoilt_arm(spoilt: str | bytes) -> None:
    run("map", spoilt, "--rows", "32", "--jobs", "1", "-o", FOLDER / "out.csv")


@cases(10)
@given(ARMS)
def test_plan_for_a_spoilt_arm(spoilt: str | bytes) -> None:
    run("plan", spoilt, "--rows", "3", "-o", FOLDER / "out.csv")


@cases(10)
@given(st.deferred(lambda: mutated_table(campaign()[0], campaign()[1][:8])))
def test_trace_spoilt_rows(spoilt: bytes) -> None:
    """What is read is enough here: a trace takes longer than a case may."""
    rows = written("rows.csv", spoilt + b"\nno row")
    assert judge_command("trace", plain(), rows, "-o", FOLDER / "out.toml") == 2
