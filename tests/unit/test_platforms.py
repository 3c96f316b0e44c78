"""Other systems: consoles and locales without UTF-8, lines that end in CR LF, modules that only POSIX has."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.small_arms import ROBOTS

import armflex

PACKAGE = Path(armflex.__file__).parent
POSIX = {"fcntl", "grp", "pwd", "resource", "termios", "tty"}


def calls_without_encoding(code: str) -> list[int]:
    """Return the lines in which text is read or written in whatever encoding the machine has."""
    found = []
    for node in ast.walk(ast.parse(code)):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        given = [ast.unparse(one) for one in node.args]
        keys = {one.arg: ast.unparse(one.value) for one in node.keywords}
        last = name.rpartition(".")[2]
        binary = any(one.startswith(("'", '"')) and "b" in one and len(one) <= 5 for one in (*given, *keys.values()))
        positional = {"read_text": 0, "write_text": 1}.get(last)
        if positional is not None:
            found += [] if "encoding" in keys or len(given) > positional else [node.lineno]
        elif last == "open" and name not in ("os.open", "webbrowser.open") and not binary and "encoding" not in keys:
            found.append(node.lineno)
    return found


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        *(("open(path)", 1), ("path.open('w')", 1), ("path.read_text()", 1), ("path.write_text(text)", 1)),
        *(("open(path, 'rb')", 0), ("path.read_text('utf-8')", 0), ("open(path, encoding='utf-8-sig')", 0)),
    ],
)
def test_what_counts_as_without_encoding(code: str, expected: int) -> None:
    assert len(calls_without_encoding(code)) == expected


def test_text_is_read_and_written_in_an_encoding_that_is_named() -> None:
    found = [
        f"{path}:{line}" for path in PACKAGE.rglob("*.py") for line in calls_without_encoding(path.read_text("utf-8"))
    ]
    assert not found


def test_modules_of_posix_alone_are_tried() -> None:
    """An import of one at the head of a module would end every command on Windows."""
    found = []
    for path in PACKAGE.rglob("*.py"):
        tree = ast.parse(path.read_text("utf-8"))
        tried = {id(inner) for node in ast.walk(tree) if isinstance(node, ast.Try) for inner in ast.walk(node)}
        for node in ast.walk(tree):
            names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            found += [f"{path}:{name}" for name in names if name in POSIX and id(node) not in tried]
    assert not found


@pytest.mark.slow
@pytest.mark.parametrize("console", ["cp1252", "ascii"])
def test_a_console_and_a_locale_without_utf_8_read_the_same_files(console: str, tmp_path: Path) -> None:
    folder = tmp_path / "Prüfstand 1 ü"
    folder.mkdir()
    for name in ("arm.toml", "robot.urdf", "trajectory.csv"):
        text = (ROBOTS / "tarm_like" / name).read_text("utf-8").replace("above_port", "über der Öffnung")
        (folder / name).write_bytes(text.replace("\n", "\r\n").encode())
    env = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": console}
    command = [sys.executable, "-m", "armflex", "check", "arm.toml", "trajectory.csv", "--tolerance", "1m"]
    ended = subprocess.run(command, cwd=folder, env=env, capture_output=True, timeout=600)
    said = ended.stdout.decode(console)
    assert ended.returncode == 0, ended.stderr
    assert "within tolerance" in said and "ber der" in said
