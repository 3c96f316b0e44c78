"""The command line as tests ask it: how it is run, what must come of it, and JSON as strict readers read it."""

import contextlib
import io
import json
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

from support.small_arms import ROBOTS

Run = Callable[..., subprocess.CompletedProcess[str]]
UNSEEN = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)
"""What a Python of its own does not show."""


def run_here(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command line in this process, inside a folder; an error that it does not word is raised."""
    from armflex.cli.main import main

    command = ["armflex", *map(str, arguments)]
    code: Any = 0
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        patch.object(sys, "argv", command),
        patch("armflex.cli.terminal._said", set()),  # a process begins with nothing said
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("default")
        for category in UNSEEN:
            warnings.simplefilter("ignore", category)
        try:
            main()
        except SystemExit as end:
            code = end.code
    return subprocess.CompletedProcess(command, code, *(one.buffer.getvalue().decode() for one in (out, err)))


def run_apart(folder: Path, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own, inside a folder, as a shell does."""
    quiet = "from armflex.cli import terminal; terminal.EVERY = float('inf')"  # however slow the machine is
    command = [sys.executable, "-c", f"{quiet}; from armflex.cli.main import main; main()", *map(str, arguments)]
    env = {"PATH": "/usr/bin:/bin", "HOME": str(folder), "PYTHONPATH": str(ROBOTS.parent), **environment}
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=600)


def wait_for(happened: Callable[[], object], seconds: float = 600.0) -> None:
    """Wait until something has happened, on however busy a machine."""
    end = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.01)


def strict_json(path: Path) -> dict:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def fine(result: subprocess.CompletedProcess, code: int = 0) -> subprocess.CompletedProcess:
    assert result.returncode == code, result.stderr
    assert "Traceback" not in result.stderr + result.stdout
    return result


def few_rows(source: Path, target: Path, count: int) -> Path:
    target.write_text("".join(source.read_text().splitlines(keepends=True)[: count + 1]))
    return target
