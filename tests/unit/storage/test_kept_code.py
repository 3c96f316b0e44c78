"""Compiled code that is kept: damaged, on a full disk, without a place, for another processor, by several at once."""

from __future__ import annotations

import logging
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
import pytest
from click.testing import CliRunner
from filelock import FileLock
from numba.core import caching
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

from armflex.cli import compile_command
from armflex.mechanics import kernel, tree_kernel, vectors
from armflex.storage.kept_code import compiled_once, kept, sources

ASK = """
import time
import numba
from armflex.storage import kept_code
from armflex.storage.kept_code import compiled_once, is_kept, kept
kept_code.WAITED = 600.0  # on a busy machine, too
def twice(x):
    return 2 * x
function = kept(numba.njit(twice))
with compiled_once(function):
    alone = is_kept(function) or time.sleep(3)  # the others come while it compiles
    function(21)
print(sum(function.stats.cache_misses.values()))
"""


def twice(x):
    return 2 * x


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "kept"))
    return tmp_path / "kept"


@pytest.fixture
def ask(place: Path, caplog: pytest.LogCaptureFixture) -> Callable[[], tuple[int, str]]:
    """Return a function that asks as a new process would: whether kept code was used, and what was said."""

    def asked() -> tuple[int, str]:
        caplog.clear()
        function = kept(numba.njit(twice))
        with caplog.at_level(logging.WARNING):
            assert function(21) == 42
        return sum(function.stats.cache_hits.values()), caplog.text

    return asked


def _wrong_byte(old: bytes) -> bytes:
    return old[:-60] + bytes([old[-60] ^ 1]) + old[-59:]


@pytest.mark.parametrize(
    ("kind", "damage"),
    [(kind, damage) for kind in ("nbi", "nbc") for damage in (lambda old: b"", lambda old: old[:-9])]
    + [("nbc", _wrong_byte)],
)
def test_what_is_damaged_is_compiled_again(place: Path, ask, kind, damage) -> None:
    """Numba ends with UnpicklingError, in every process from then on; and where a byte is wrong it may run that."""
    assert ask() == (0, "") and ask() == (1, "")
    (file,) = place.rglob(f"*.{kind}")
    file.write_bytes(damage(file.read_bytes()))
    hits, said = ask()
    assert hits == 0 and f"compiled code in {file.parent} is damaged, and is compiled again" in said
    assert ask() == (1, "")


def test_code_for_other_arguments_is_compiled_again(place: Path, ask) -> None:
    """Two processes that write at once may leave the index of one with the code of the other."""
    function = kept(numba.njit(twice))
    assert function(21) == 42 and function(0.75) == 1.5
    one, two = sorted(place.rglob("*.nbc"))
    old = one.read_bytes()
    one.write_bytes(two.read_bytes())
    two.write_bytes(old)
    hits, said = ask()
    assert hits == 0 and "is damaged, and is compiled again (code for other arguments" in said
    assert ask() == (1, "")


def test_functions_of_one_name_share_no_code(place: Path) -> None:
    for _ in range(2):
        for share in (3, 5):
            scope: dict = {"__name__": __name__}
            exec(compile(f"def twice(x):\n    return {share} * x", __file__, "exec"), scope)
            assert kept(numba.njit(scope["twice"]))(7) == share * 7


def test_a_frozen_program_keeps_code_without_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    monkeypatch.setattr("numba.misc.appdirs.user_cache_dir", lambda *_, **__: str(tmp_path))
    scope: dict = {"__name__": __name__}
    exec(compile("def thrice(x):\n    return 3 * x", str(tmp_path / "gone" / "gone.py"), "exec"), scope)
    for hits in (0, 1):
        function = kept(numba.njit(scope["thrice"]))
        assert function(7) == 21 and sum(function.stats.cache_hits.values()) == hits
    assert not caplog.text and list(tmp_path.rglob("*.nbc"))


def test_a_full_disk_is_said_and_fails_nothing(ask, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as full:
        full.setattr(caching.IndexDataCacheFile, "_open_for_write", _no_space)
        hits, said = ask()
    assert hits == 0 and "compiled code cannot be kept there: No space left on device" in said
    assert ask() == (0, "") and ask() == (1, "")


def _no_space(*_: object) -> None:
    raise OSError(28, "No space left on device")


def test_no_place_is_said_and_fails_nothing(ask, monkeypatch: pytest.MonkeyPatch, caplog) -> None:
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    function = kept(numba.njit(twice))
    assert function(21) == 42 and "compiled code cannot be kept: cannot cache function" in caplog.text


def test_another_processor_has_code_of_its_own(ask, monkeypatch: pytest.MonkeyPatch) -> None:
    assert ask() == (0, "")
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr("numba.core.codegen.JITCPUCodegen.magic_tuple", lambda _: ("another", "processor", ""))
        assert ask() == (0, "") and ask() == (1, "")
    assert ask() == (1, "")


@pytest.mark.slow
def test_of_several_that_come_at_once_one_compiles(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(ASK)
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONPATH": str(Path(__file__).parents[3])}
    for compiled in ("1", "0"):
        several = [
            subprocess.Popen(
                [sys.executable, "program.py"], cwd=tmp_path, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE
            )
            for _ in range(3)
        ]
        said = [one.communicate(timeout=600) for one in several]
        assert [one.returncode for one in several] == [0] * 3
        assert sorted(out.decode().strip() for out, _ in said) == ["0", "0", compiled]
        waits = "another process compiles: waiting for it, 600 s at most"
        assert {error.decode().strip() for _, error in said} <= {"", waits}
    assert len(list((tmp_path / "kept").rglob("*.nbc"))) == 1


def test_nobody_waits_where_nothing_can_be_locked(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read_only(*_: object, **__: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("filelock.FileLock.acquire", read_only)
    function = kept(numba.njit(twice))
    with compiled_once(function):
        assert function(21) == 42


def test_a_process_that_compiles_for_ever_is_not_waited_for(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("armflex.storage.kept_code.WAITED", 0.2)
    function = kept(numba.njit(twice))
    Path(function._cache.cache_path).mkdir(parents=True, exist_ok=True)
    with FileLock(Path(function._cache.cache_path) / f"{function.__name__}.lock"), compiled_once(function):
        assert function(21) == 42


@pytest.mark.slow
def test_code_is_compiled_again_where_anything_that_it_is_compiled_from_has_changed(tmp_path: Path) -> None:
    """Of a function only its own file is looked at by numba: one of another module that it calls may be the old one."""
    parts = {
        "inner.py": "import numba\nfrom other import SHARE\n@numba.njit\ndef inner(x):\n    return SHARE * x\n",
        "outer.py": "import numba\nfrom armflex.storage.kept_code import kept\nfrom shape import Shape\n"
        "from inner import inner\n@kept\n@numba.njit\ndef outer(x):\n    return inner(Shape(x, 2 * x).one)\n",
        "other.py": "SHARE = 3\ndef python(x):\n    return x\n",
        "shape.py": "from typing import NamedTuple\nclass Shape(NamedTuple):\n    one: int\n    two: int\n",
    }
    changes = {
        "": ("", "", "3 1"),
        "other.py": ("SHARE = 3", "SHARE = 5", "5 1"),
        "inner.py": ("SHARE * x", "SHARE * x + 1", "6 1"),
        "shape.py": ("    one: int\n    two: int\n", "    two: int\n    one: int\n", "11 1"),
        "outer.py": ("(x, 2 * x)", "(x, 3 * x)", "16 1"),
        " outer.py": ("\n@kept", "\n\n@kept", "16 0"),  # the code is the same
        " other.py": ("return x", "return -x", "16 0"),  # is not compiled
    }
    ask = "from outer import outer\nprint(outer(1), sum(outer.stats.cache_misses.values()))"
    path = os.pathsep.join((str(Path(__file__).parents[3]), str(tmp_path)))
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    for name, text in parts.items():
        (tmp_path / name).write_text(text)
    for name, (before, after, expected) in changes.items():
        if name:
            parts[name.strip()] = parts[name.strip()].replace(before, after)
            (tmp_path / name.strip()).write_text(parts[name.strip()])
        for answer in (expected, expected[:-1] + "0"):
            asked = subprocess.run(
                [sys.executable, "-c", ask], env=env, capture_output=True, text=True, check=True, timeout=600
            )
            assert asked.stdout.strip() == answer, name
    assert len(list((tmp_path / "kept").rglob("outer.*"))) == 2  # nothing is left of what was


@pytest.mark.slow
def test_what_was_imported_counts_and_not_its_file_since(tmp_path: Path) -> None:
    """A file may be edited, or be gone, between its import and the first call."""
    before = (
        "import numba\nfrom armflex.storage.kept_code import kept\n@kept\n@numba.njit\ndef one(x):\n    return 3 * x\n"
    )
    after = before.replace("3 * x", "5 * x")
    ask = "import sys\nfrom pathlib import Path\nfrom edited import one\nfile = Path(sys.argv[1])\n"
    ask += "file.write_text(sys.argv[2]) if sys.argv[2] else file.unlink()\n"
    ask += "print(one(1), sum(one.stats.cache_misses.values()))"
    path = os.pathsep.join((str(Path(__file__).parents[3]), str(tmp_path)))
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    for text, later, answer in (
        (before, after, "3 1"),
        (after, "", "5 1"),
        (after, before, "5 0"),
        (before, "", "3 1"),
    ):
        (tmp_path / "edited.py").write_text(text)
        program = [sys.executable, "-c", ask, str(tmp_path / "edited.py"), later]
        asked = subprocess.run(program, env=env, capture_output=True, text=True, check=True, timeout=600)
        assert (asked.stdout.strip(), asked.stderr) == (answer, "")


ENGINE = *kernel.ENTRIES, kernel.solve_one, tree_kernel.rest_rows


@pytest.mark.parametrize("entry", ENGINE, ids=lambda entry: entry.__name__)
def test_whatever_the_engine_names_counts(entry: Dispatcher, monkeypatch: pytest.MonkeyPatch) -> None:
    reached, same = [entry], sources(entry)
    for one in reached:
        space, codes = one.py_func.__globals__, [one.py_func.__code__]
        assert not one.py_func.__closure__
        for code in codes:
            codes += [part for part in code.co_consts if hasattr(part, "co_names")]
        for name in {name for code in codes for name in code.co_names if name in space}:
            value = space[name]
            if isinstance(value, Dispatcher):
                reached += [value] if value not in reached else []
                changed = numba.njit(twice)
            elif isinstance(value, type) and hasattr(value, "_fields"):
                changed = type(name, (value,), {"__module__": value.__module__, "_fields": value._fields[::-1]})
            elif isinstance(value, int | float):
                changed = value + 1
            elif isinstance(value, tuple):
                assert all(isinstance(part, int | float) for part in value)
                changed = (*value, 1)
            else:
                assert value in (np, math) or isinstance(value, _Intrinsic), f"{one}: {name}"
                changed = vectors.pack if value is not vectors.pack else vectors.put_pack
            with monkeypatch.context() as another:
                another.setitem(space, name, changed)
                assert sources(entry) != same, f"{one}: {name}"
    assert sources(entry) == same


def test_what_intrinsics_and_operators_are_made_of_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    same = sources(tree_kernel.rest_rows)
    for name in ("VECTOR", "NUMBER", "LOOSE"):
        with monkeypatch.context() as another:
            another.setattr(vectors, name, "another")
            assert sources(tree_kernel.rest_rows) != same, name


@pytest.mark.slow
def test_every_process_finds_the_same_sources() -> None:
    ask = "from armflex.mechanics import kernel, tree_kernel\nfrom armflex.storage.kept_code import sources\n"
    ask += "for one in (*kernel.ENTRIES, kernel.solve_one, tree_kernel.rest_rows): print(sources(one).hex())"
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])}
    for seed in ("1", "2"):
        program = [sys.executable, "-c", ask]
        found = subprocess.check_output(program, env=env | {"PYTHONHASHSEED": seed}, text=True)
        assert found.split() == [sources(one).hex() for one in ENGINE]


@pytest.mark.parametrize("there", [True, False])
def test_the_command_says_whether_code_is_kept(there: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compile_command, "compilations", tuple)
    monkeypatch.setattr(compile_command, "is_kept", lambda: there)
    result = CliRunner().invoke(compile_command.command, [])
    assert result.exit_code == 0 and ("its code is kept" in result.stdout) == there
    assert ("its code is not kept" in result.stderr) != there
