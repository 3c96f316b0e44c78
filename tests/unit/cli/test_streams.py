"""Commands whose streams are closed, are pipes that nobody reads, or get the result; and commands that are ended."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from html import unescape
from pathlib import Path

import pytest
from support.command_line import fine, run_here
from support.small_arms import ROBOTS

HEAVY, LIFTER = ROBOTS / "heavy_six", ROBOTS / "hybrid_lifter"
COMMAND = f"'{sys.executable}' -m armflex"
CHECK = f"{COMMAND} check '{HEAVY / 'arm.toml'}' '{HEAVY / 'trajectory.csv'}' --tolerance"
ROWS = "clear", "lift", "pick"

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the shell closes streams")


def shell(line: str, folder: Path, **more: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", "-c", line], cwd=folder, capture_output=True, text=True, env={**os.environ, **more}, timeout=600
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("closed", "tolerance", "code"), [("2>&-", "500mm", 0), (">&-", "1mm", 1), ("<&- >&- 2>&-", "1mm", 1)]
)
def test_closed_streams_change_no_verdict(closed: str, tolerance: str, code: int, tmp_path: Path) -> None:
    ran = shell(f"{CHECK} {tolerance} --json c.json {closed}", tmp_path)
    assert ran.returncode == code, ran.stderr
    assert json.loads((tmp_path / "c.json").read_text())["ok"] is (code == 0)


@pytest.mark.slow
def test_a_reader_that_goes_away_stops_nothing(tmp_path: Path) -> None:
    ran = shell(f"{{ {CHECK} 500mm --json c.json; echo $? >rc; }} | head -1", tmp_path)
    assert (tmp_path / "rc").read_text() == "0\n" and "Traceback" not in ran.stderr + ran.stdout
    assert json.loads((tmp_path / "c.json").read_text())["ok"]


@pytest.mark.slow
@pytest.mark.parametrize("stdout", ["/dev/stdout", "-"])
def test_a_result_on_stdout_is_alone_there(stdout: str, tmp_path: Path) -> None:
    ran = shell(f"{CHECK} 500mm --json {stdout}", tmp_path)
    assert json.loads(ran.stdout)["ok"] and "Via-points against" in ran.stderr
    assert list(tmp_path.iterdir()) == []


def test_two_results_on_stdout_are_refused(tmp_path: Path) -> None:
    line = f"{COMMAND} predict '{HEAVY / 'arm.toml'}' '{HEAVY / 'trajectory.csv'}' -o - --json /dev/stdout"
    ran = shell(line, tmp_path)
    assert ran.returncode == 2 and "-o and --json both go to stdout" in ran.stderr and not ran.stdout


@pytest.mark.slow
def test_a_pipe_is_as_wide_as_columns_says(tmp_path: Path) -> None:
    ran = shell(f"{CHECK} 500mm", tmp_path, COLUMNS="60")
    assert max(map(len, ran.stdout.splitlines())) <= 60 and "continued" in ran.stdout


@pytest.mark.slow
def test_an_ended_command_says_so_and_leaves_nothing(tmp_path: Path) -> None:
    script = "import sys, time; from armflex.cli import main, options; from armflex.storage.whole_file import writing;"
    script += "sys.argv = ['armflex', 'deflect', sys.argv[1]]\n"
    script += (
        "def wait(*_, **__):\n  with writing(options.Path('o.toml')): print('here', flush=True); time.sleep(600)\n"
    )
    script += "options.load_arm = wait; main.main()"
    command = [sys.executable, "-c", script, str(HEAVY / "arm.toml")]
    ran = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert ran.stdout is not None and ran.stdout.readline() == "here\n"
    time.sleep(0.1)
    ran.send_signal(signal.SIGTERM)
    _, said = ran.communicate(timeout=600)
    assert ran.returncode == 128 + signal.SIGTERM and "error: ended by SIGTERM" in said
    assert list(tmp_path.iterdir()) == []


def test_check_has_a_page(tmp_path: Path) -> None:
    page = tmp_path / "r.html"
    files = HEAVY / "arm.toml", HEAVY / "trajectory.csv"
    fine(run_here(tmp_path, "check", *files, "--tolerance", "500mm", "--report", page))
    text = unescape(page.read_text())
    assert "The path is within 500 mm." in text and "SHA-256" in text and "<svg" in text
    for word in ("first frequency Hz", "settles in s", "margin mm", "as declared, not calibrated", *ROWS):
        assert word in text
    assert "no via-point swings by more than 500 mm" in text and "0 s<" not in text


def test_the_page_of_a_checked_path_draws_cylinders(tmp_path: Path) -> None:
    """Three, rigid and bent, from two sides."""
    files = LIFTER / "arm.toml", LIFTER / "trajectory.csv"
    fine(run_here(tmp_path, "check", *files, "--tolerance", "100mm", "--report", "r.html"))
    assert len(re.findall(r"stroke-width: 4[;\"]", (tmp_path / "r.html").read_text())) == 12


def test_modes_along_a_path_and_names_of_its_via_points(tmp_path: Path) -> None:
    files = HEAVY / "arm.toml", HEAVY / "trajectory.csv"
    fine(
        run_here(
            tmp_path, "modes", HEAVY / "arm.toml", "--traj", files[1], "--count", "2", "--json", tmp_path / "m.json"
        )
    )
    points = json.loads((tmp_path / "m.json").read_text())["via_points"]
    assert {*ROWS} <= {point["name"] for point in points}
    assert all(len(point["frequencies_hz"]) == 2 for point in points)
    fine(run_here(tmp_path, "predict", *files, "-o", tmp_path / "p.csv"))
    head, *rows = (line.split(",") for line in (tmp_path / "p.csv").read_text().splitlines())
    assert {*ROWS} <= {row[head.index("via")] for row in rows}
