"""What concerns every test: where fixtures come from, the compiled kernel, and memory that a worker keeps."""

from __future__ import annotations

import ctypes
import gc
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

from armflex.cli import terminal
from armflex.mechanics.many_rows import kernel

hypothesis.settings.register_profile("armflex", deadline=None)  # a machine that is busy fails no test
hypothesis.settings.load_profile("armflex")
pytest.register_assert_rewrite("support")
pytest_plugins = ("support.fixtures", "support.stage", "support.traced_backlash", "support.tracking")
MUCH = 1 << 30
"""Bytes of a worker."""


def pytest_configure(config: pytest.Config) -> None:
    """Compile the engines once, before the workers start: they would each, and code compiled apart rounds otherwise."""
    if not hasattr(config, "workerinput"):
        command, root = [sys.executable, "-m", "armflex", "compile"], Path(__file__).parents[1]
        subprocess.run(command, cwd=root, stdout=subprocess.DEVNULL, check=True, timeout=3600)


@pytest.fixture(scope="session", autouse=True)
def engine() -> None:
    """Load the kernel, as in a process that has asked about many rows; how few are answered has tests of its own."""
    kernel()


@pytest.fixture(scope="session", autouse=True)
def unhurried() -> Iterator[None]:
    """Have no line say that a command still goes on: on a busy machine one more would be there than on another."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terminal, "EVERY", float("inf"))
        yield


@pytest.hookimpl(trylast=True)  # after fixtures have ended
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Give back what a file's tests have freed: the heap of a worker, in pieces, would grow to gigabytes."""
    if nextitem is None or nextitem.path == item.path or not sys.platform.startswith("linux"):
        return
    resident = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc alone
    if trim and resident > MUCH:
        gc.collect()
        trim(0)
