"""What the fuzz tests share: how a valid input is spoilt, and what must come of it.

A reader either refuses a spoilt file with an `ArmflexError` that names it, or what it read gives finite numbers and
covariances that are positive semidefinite. Never another exception, never more than a gigabyte or ten seconds.

`make test` runs some dozens of cases per reader, the same ones every time; `make fuzz` 75 times as many, new ones each
time (the environment's HYPOTHESIS_PROFILE chooses). In a module of its own per reader:

    @cases(200)
    @given(mutated_table(*SEED))
    def test_reader(spoilt: bytes) -> None:
        path = written("rows.csv", spoilt)
        judge(lambda: read_rows(path), path, lambda rows: {"position": rows.position, "covariance": rows.covariance})
"""

import copy
import csv
import io
import json
import os
import re
import resource
import signal
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from armflex.cli.main import main
from armflex.errors import ArmflexError

MOST_BYTES = 1 << 30
MOST_SECONDS, STILL = 10.0, 600.0
ROUNDING = 1e-8
"""Of a covariance in units of its own diagonal: how far below zero an eigenvalue may lie."""

_CHECKS = (HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example)
settings.register_profile("suite", derandomize=True, database=None, suppress_health_check=_CHECKS)
settings.register_profile("fuzz", database=None, print_blob=True, suppress_health_check=_CHECKS)
PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "suite")
TIMES = {"suite": 1 / 3, "fuzz": 25}

NUMBERS = (
    *(float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 1e155, 1e30, 1e15, 1e6, 1e3, 1e-30, 1e-300, 5e-324),
    *(0.0, -0.0, -1.0, 1.0, 2.0, 0.5, -1e-9, 10**18, 2**63, -(2**64), 10**400),
)
OTHERS = (
    True,
    False,
    "",
    " ",
    "nan",
    "inf",
    "0",
    "x" * 300,
    "\x00",
    "é\ud7ff\u202e",
    [],
    {},
    [[]],
    [1.0],
    ["a"],
    {"a": 1.0},
)
CELLS = (
    *("", " ", "nan", "NaN", "inf", "-inf", "1e400", "-1e308", "1e308", "1e300", "1e150", "1e9", "1e-320", "-0", "0"),
    *(
        "1",
        "-1",
        "2",
        "9" * 400,
        "1_000",
        "0x10",
        "1,5",
        "1.5.2",
        "\u0661\u0662",
        "true",
        "None",
        "x",
        "é",
        "=1+1",
        "a b",
    ),
    *("1e3", "-1e3", "1e6", "--1", "+", ".", "e5", "\x00", '"', "\n", "\r", "\u202e", "x" * 10_000, "[1]", "{}"),
)
BYTES = (
    *(b"\x00", b"\xff", b"\xfe\xff", b"\xef\xbb\xbf", b"\xc3", b"\n", b"\r", b'"', b"'", b"[" * 3000, b"{" * 3000),
    *(b"=", b",", b"#", b"9" * 5000, b"1e999", b"nan", b"inf", b"-", b"\x1b[31m", b"\xe2\x80\xae", b"<", b">", b"&x;"),
    *(b"<!DOCTYPE x [<!ENTITY x 'y'>]>", b"[[x]]\n", b"a.b.c = 1\n", b"../" * 50, b"%n%s", b"\x7f" * 100),
)


def cases(count: int) -> Callable:
    """Return the decorator that runs a test on a third of so many cases, and in `make fuzz` on 25 times as many."""
    return settings(settings.get_profile(PROFILE), max_examples=max(1, round(count * TIMES[PROFILE])))


def hostile() -> st.SearchStrategy[Any]:
    """Return a value that nobody should have written: not finite, huge, tiny, or of another type."""
    return st.sampled_from((*NUMBERS, *OTHERS)).map(copy.deepcopy)


@st.composite
def mutated_bytes(draw: st.DrawFn, seed: bytes) -> bytes:
    """Return a file with one to three places cut, doubled, overwritten, swapped or grown, or a number replaced."""
    data = seed
    for _ in range(draw(st.integers(1, 3))):
        data = _DAMAGE[draw(st.sampled_from(sorted(_DAMAGE)))](draw, data)
    return data


def _span(draw: st.DrawFn, data: bytes, most: int = 64) -> tuple[int, int]:
    start = draw(st.integers(0, max(len(data) - 1, 0)))
    return start, min(start + draw(st.integers(1, most)), len(data))


def _truncated(draw: st.DrawFn, data: bytes) -> bytes:
    return data[: draw(st.integers(0, len(data)))]


def _dropped(draw: st.DrawFn, data: bytes) -> bytes:
    start, end = _span(draw, data)
    return data[:start] + data[end:]


def _doubled(draw: st.DrawFn, data: bytes) -> bytes:
    start, end = _span(draw, data)
    return data[:end] + data[start:end] * draw(st.integers(1, 50)) + data[end:]


def _inserted(draw: st.DrawFn, data: bytes) -> bytes:
    start, _ = _span(draw, data)
    return data[:start] + draw(st.sampled_from(BYTES)) + data[start:]


def _overwritten(draw: st.DrawFn, data: bytes) -> bytes:
    start, end = _span(draw, data, 8)
    return data[:start] + draw(st.binary(min_size=end - start, max_size=end - start)) + data[end:]


def _flipped(draw: st.DrawFn, data: bytes) -> bytes:
    start, _ = _span(draw, data)
    return (
        data[:start]
        + bytes(byte ^ 1 << draw(st.integers(0, 7)) for byte in data[start : start + 1])
        + data[start + 1 :]
    )


def _renumbered(draw: st.DrawFn, data: bytes) -> bytes:
    """Replace one number of the text."""
    found = list(re.finditer(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", data))
    if not found:
        return data
    number = found[draw(st.integers(0, len(found) - 1))]
    return data[: number.start()] + draw(st.sampled_from(CELLS)).encode() + data[number.end() :]


def _shuffled_lines(draw: st.DrawFn, data: bytes) -> bytes:
    """Drop, double or swap lines."""
    lines = data.splitlines(keepends=True)
    if len(lines) < 2:
        return data
    one, other = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
    how = draw(st.integers(0, 2))
    if how == 0:
        del lines[one]
    elif how == 1:
        lines.insert(other, lines[one])
    else:
        lines[one], lines[other] = lines[other], lines[one]
    return b"".join(lines)


_DAMAGE: dict[str, Callable[[st.DrawFn, bytes], bytes]] = {
    "truncated": _truncated,
    "dropped": _dropped,
    "doubled": _doubled,
    "inserted": _inserted,
    "overwritten": _overwritten,
    "flipped": _flipped,
    "renumbered": _renumbered,
    "renumbered too": _renumbered,
    "lines": _shuffled_lines,
}


@st.composite
def mutated_tree(draw: st.DrawFn, seed: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested tables and lists, as of TOML or JSON, with one to three values, keys or elements spoilt."""
    tree: dict[str, Any] = copy.deepcopy(dict(seed))
    for _ in range(draw(st.integers(1, 3))):
        holder: Any = tree
        while holder:
            keys = list(holder) if isinstance(holder, dict) else range(len(holder))
            key = draw(st.sampled_from(keys))
            inside = isinstance(holder[key], dict | list) and holder[key]
            if not inside or draw(st.integers(0, 4)) == 0:  # small parts are hit as often as large ones
                _spoil(draw, holder, key)
                break
            holder = inside
    return tree


def as_toml(tree: Mapping[str, Any]) -> str:
    """Return nested tables as TOML, one line per key of the root."""
    return "".join(f"{_toml(key)} = {_toml(value)}\n" for key, value in tree.items())


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_toml(key)} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, str | bool):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)


def _spoil(draw: st.DrawFn, holder: Any, key: Any) -> None:
    """Replace, scale, drop, rename, double, wrap or swap one value in place."""
    value = holder[key]
    how = draw(st.sampled_from(("replace", "replace", "scale", "drop", "rename", "double", "wrap", "swap")))
    if how == "scale" and isinstance(value, float):
        holder[key] = value * draw(st.sampled_from((-1.0, 1e3, 1e-3, 1e9, 1e-9, 1e100, 1e-100, 0.0)))
    elif how == "drop":
        del holder[key]
    elif how == "rename" and isinstance(holder, dict):
        holder[draw(st.sampled_from((f"{key}x", key[:-1], key.upper(), "", "e\u0301 \x07", "x" * 300)))] = holder.pop(
            key
        )
    elif how == "double" and isinstance(holder, list):
        holder.insert(key, copy.deepcopy(value))
    elif how == "double":
        holder[f"{key}2"] = copy.deepcopy(value)
    elif how == "wrap":
        for _ in range(draw(st.sampled_from((1, 2, 40)))):
            value = [value] if isinstance(holder, list) else {"a": value}
        holder[key] = value
    elif how == "swap":
        other = draw(st.sampled_from(list(holder) if isinstance(holder, dict) else range(len(holder))))
        holder[key], holder[other] = holder[other], holder[key]
    else:
        holder[key] = draw(hostile())


def mutated_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> st.SearchStrategy[bytes]:
    """Return a CSV file with cells, columns or rows spoilt, or its bytes."""
    return st.one_of(mutated_cells(header, rows).map(_as_csv), mutated_bytes(_as_csv((header, rows))))


@st.composite
def mutated_cells(
    draw: st.DrawFn, header: Sequence[str], rows: Sequence[Sequence[object]]
) -> tuple[list[str], list[list[str]]]:
    """Return a header and rows of text with one to three cells, columns or rows spoilt."""
    names, body = list(header), [[str(cell) for cell in row] for row in rows]
    for _ in range(draw(st.integers(1, 3))):
        how = draw(
            st.sampled_from(("cell", "cell", "cell", "column", "drop", "double", "rename", "swap", "row", "order"))
        )
        column = draw(st.integers(0, max(len(names) - 1, 0)))
        row = draw(st.integers(0, max(len(body) - 1, 0)))
        if not names or not body:
            break
        if how == "cell":
            body[row][column] = draw(st.sampled_from(CELLS))
        elif how == "column":
            cell = draw(st.sampled_from(CELLS))
            for cells in body:
                cells[column] = cell
        elif how == "drop":
            for cells in (names, *body):
                del cells[column]
        elif how == "double":
            for cells in (names, *body):
                cells.insert(column, cells[column])
            names[column] += draw(st.sampled_from(("", "2", "_mm", "_")))
        elif how == "rename":
            names[column] = draw(st.sampled_from((*_renamed(names[column]), *CELLS)))
        elif how == "swap":
            other = draw(st.integers(0, len(names) - 1))
            for cells in body:
                cells[column], cells[other] = cells[other], cells[column]
        elif how == "row":
            body[row : row + 1] = [list(body[row]) for _ in range(draw(st.sampled_from((0, 2, 3))))]
        else:
            other = draw(st.integers(0, len(body) - 1))
            body[row], body[other] = body[other], body[row]
    return names, body


def _renamed(name: str) -> tuple[str, ...]:
    return (f"{name}_mm", f"{name}_deg", f"{name}_N", f"{name}x", name[:-1], name.upper(), f" {name} ", f"{name}_")


def _as_csv(table: tuple[Sequence[str], Sequence[Sequence[object]]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([table[0], *table[1]])
    return text.getvalue().encode()


FOLDER = Path(tempfile.mkdtemp(prefix="armflex_fuzz_"))
"""Where this process writes its cases; one file per name, overwritten by the next case."""


def written(name: str, data: bytes | str) -> Path:
    """Write a case and return its path."""
    path = FOLDER / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode("utf-8", "surrogatepass"))
    return path


class TooSlowError(BaseException):
    """Ten seconds of CPU time have passed; no `except Exception` on the way holds it up."""


@contextmanager
def limited(seconds: float = MOST_SECONDS, more_bytes: int = MOST_BYTES) -> Iterator[None]:
    """Let what is inside take so much CPU time, and so much address space beyond what the process has already.

    What waits for nothing stands still for `STILL` seconds: a busy machine makes no test fail.
    """

    def stop(*_: object) -> None:
        raise TooSlowError(f"took more than {seconds:g} s")

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    timers = {signal.SIGPROF: (signal.ITIMER_PROF, seconds), signal.SIGALRM: (signal.ITIMER_REAL, STILL)}
    before = {number: signal.signal(number, stop) for number in timers}
    for timer, most in timers.values():
        signal.setitimer(timer, most)
    try:
        if STATM.exists():
            now = int(STATM.read_text().split()[0]) * resource.getpagesize()
            allowed = [bound for bound in (soft, hard, now + more_bytes) if bound != resource.RLIM_INFINITY]
            resource.setrlimit(resource.RLIMIT_AS, (min(allowed), hard))
        yield
    finally:
        for number, (timer, _) in timers.items():
            signal.setitimer(timer, 0.0)
            signal.signal(number, before[number])
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


STATM = Path("/proc/self/statm")


def judge(
    read: Callable[[], Any],
    path: Path,
    use: Callable[[Any], Mapping[str, Any]] | None = None,
    names: Sequence[str] = (),
) -> bool:
    """Return whether a file was accepted; fail where it was neither refused as it should be nor gives right numbers.

    Args:
        read: What reads the file.
        path: The file; a refusal must name it.
        use: What is computed with what was read, by name: None, or arrays that must be finite. A `covariance...` must
            also be symmetric and positive semidefinite; a `sigma...` may be infinite, for what nothing determines.
            It may refuse as well, without naming the file.
        names: Further files of which a refusal may name one instead.
    """
    with warnings.catch_warnings(record=True) as caught, limited():
        warnings.simplefilter("always")
        try:
            found = read()
        except ArmflexError as error:
            message = str(error)
            assert message.strip(), f"{type(error).__name__} without a message"
            assert any(name in message for name in (path.name, *names)), f"does not name {path.name}: {message!r}"
            return False
        try:
            numbers = use(found) if use is not None else {}
        except ArmflexError as error:
            assert str(error).strip(), f"{type(error).__name__} without a message"
            return True
    for name, values in numbers.items():
        check_numbers(name, values)
    told = [str(one.message) for one in caught if issubclass(one.category, RuntimeWarning)]
    assert not told, f"accepted, but numpy warned: {told[0]}"
    return True


def judge_command(*arguments: object) -> int:
    """Run a command line in this process and return its exit code; fail where it is none of 0, 1, 2, or untold."""
    out, told = io.StringIO(), io.StringIO()
    with (
        patch.object(sys, "argv", ["armflex", *map(str, arguments)]),
        patch.object(warnings, "showwarning"),  # `main` sets its own
        warnings.catch_warnings(),
        redirect_stdout(out),
        redirect_stderr(told),
        limited(),
    ):
        try:
            main()
            code: object = 0
        except SystemExit as end:
            code = end.code or 0
    assert code in (0, 1, 2), f"exit code {code}"
    assert code != 2 or told.getvalue().startswith(("error: ", "warning: ", "Usage: ")), told.getvalue()
    assert "Traceback" not in told.getvalue()
    return int(code)


def check_numbers(name: str, values: Any) -> None:
    """Fail where numbers are not what their name says; see `judge`."""
    if values is None:
        return
    array = np.asarray(values, dtype=float)
    assert not np.isnan(array).any(), f"{name} is NaN"
    if not name.startswith("sigma"):
        assert np.isfinite(array).all(), f"{name} is not finite"
    if name.startswith("covariance"):
        size = np.sqrt(np.abs(np.diagonal(array, axis1=-2, axis2=-1)))
        unit = np.where(size > 0.0, size, 1.0)
        scaled = array / unit[..., :, None] / unit[..., None, :]
        assert np.abs(scaled - np.swapaxes(scaled, -1, -2)).max(initial=0.0) <= ROUNDING, f"{name} is not symmetric"
        assert np.linalg.eigvalsh(scaled).min(initial=0.0) >= -ROUNDING, f"{name} is not positive semidefinite"
