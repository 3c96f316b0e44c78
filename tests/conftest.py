"""What concerns every test: where fixtures come from, and memory that a worker keeps."""

import ctypes
import gc
import os
import resource
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from armflex.cli import options, terminal
from armflex.result import plain
from armflex.schemas import read_schema, schema_names
from armflex.version import __version__

# Where bytecode is not kept, every worker and every command that a test starts compiles the package and the tests anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# A machine that is busy fails no test; `make fuzz` draws more than a suite has time for.
hypothesis.settings.register_profile("armflex", deadline=None, max_examples=40)
hypothesis.settings.load_profile("armflex")
pytest.register_assert_rewrite("support")
pytest_plugins = ("support.fixtures", "support.stage", "support.traced_backlash", "support.tracking")
MUCH = 1 << 30
"""Bytes of a worker."""


@pytest.fixture(scope="session", autouse=True)
def unhurried() -> Iterator[None]:
    """Have no line say that a command still goes on: on a busy machine one more would be there than on another."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terminal, "EVERY", float("inf"))
        yield


@pytest.fixture(scope="session", autouse=True)
def as_schemas_say() -> Iterator[None]:
    """Have whatever a command writes for programs be what its schema says."""
    try:
        from jsonschema import Draft202012Validator
    except ImportError:
        yield
        return
    write, of_format = options.write_json, cache(lambda name: Draft202012Validator(read_schema(name)))

    def checked(content: dict[str, Any], path: Path | None = None) -> None:
        write(content, path)
        if content.get("format") in schema_names():  # a command that is called without the others has no name
            of_format(content["format"]).validate(plain({**content, "armflex": __version__}))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(options, "write_json", checked)
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
