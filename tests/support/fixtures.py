"""What every test may ask for: the bundled arms with their trajectories, and the command line."""

import hashlib
import inspect
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from armflex import Arm, Measurements, Trajectory, load_arm, read_trajectory
from support.command_line import Run, run_apart, run_here
from support.small_arms import ROBOTS


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


@pytest.fixture(scope="session")
def traced_once() -> Callable[..., Any]:
    """Return `trace` of the boom's bundled campaign alone, made once in a process: a page and an example share it."""
    from armflex.trace import trace  # which takes a second

    campaign, made = hashlib.sha256((ROBOTS / "tarm_like" / "campaign.csv").read_bytes()).hexdigest(), []

    def traced(*given: Any, **more: Any) -> Any:
        rows = inspect.signature(trace).bind(*given, **more).arguments["measurements"]
        (rows,) = rows if isinstance(rows, list) else (rows,)
        assert isinstance(rows, Measurements) and rows.sha256 == campaign
        made.extend([] if made else [trace(*given, **more)])
        return made[0]

    return traced


@pytest.fixture
def armflex(tmp_path: Path) -> Run:
    """Return the function that runs the command line in this process, inside `tmp_path`."""
    return partial(run_here, tmp_path)


@pytest.fixture
def shell(tmp_path: Path) -> Run:
    """Return the function that runs the command line in a process of its own, inside `tmp_path`."""
    return partial(run_apart, tmp_path)
