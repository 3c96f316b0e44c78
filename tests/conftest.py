"""What several files of tests share: the bundled arms with their trajectories, and the command line."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from armflex import Arm, Trajectory, load_arm, read_trajectory

ROBOTS = Path(__file__).parents[1] / "robots"
pytest_plugins = ("support.stage", "support.traced_backlash", "support.tracking")
"""What brings fixtures of its own."""
pytest.register_assert_rewrite("support")


def pytest_configure(config: pytest.Config) -> None:
    """Compile the kernel once, before the workers start: they would each, and code compiled apart rounds otherwise."""
    if not hasattr(config, "workerinput"):
        code = "from armflex.mechanics.rows import kernel; kernel().compile_everything()"
        subprocess.run([sys.executable, "-c", code], cwd=ROBOTS.parent, check=True)


def _quietly(path: Path, preset: str | None = None) -> Arm:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_arm(path, preset=preset)


@pytest.fixture(scope="session")
def tarm() -> Arm:
    """Seven joints, redundant where only the position counts; M1's compliance depends on its position."""
    return _quietly(ROBOTS / "tarm_like" / "arm.toml")


@pytest.fixture(scope="session")
def heavy() -> Arm:
    """Six joints."""
    return _quietly(ROBOTS / "heavy_six" / "arm.toml")


@pytest.fixture(scope="session")
def tarm_path(tarm: Arm) -> Trajectory:
    return read_trajectory(ROBOTS / "tarm_like" / "trajectory.csv", tarm)


@pytest.fixture(scope="session")
def heavy_path(heavy: Arm) -> Trajectory:
    return read_trajectory(ROBOTS / "heavy_six" / "trajectory.csv", heavy)


@pytest.fixture(scope="session")
def tarm_preset() -> Callable[[str], Arm]:
    """Return the function that loads tarm_like with other flexures."""
    return lambda name: _quietly(ROBOTS / "tarm_like" / "arm.toml", name)


@pytest.fixture
def armflex(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Return the function that runs the command line in a process of its own, inside `tmp_path`."""

    def run(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", "from armflex.cli.main import main; main()", *map(str, arguments)]
        env = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "PYTHONPATH": str(ROBOTS.parent), **environment}
        return subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120)

    return run
