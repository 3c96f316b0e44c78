"""The one way to the terminal: every text arrives as it is, none as markup, and none moves the cursor."""

import logging
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from armflex.conventions import number as number
from armflex.conventions import printable
from armflex.errors import Flag

EVERY, REDRAWN = 2.0, 0.5
"""Seconds of silence after which a line goes into a pipe (later a tenth of the time that passed), and between two looks
of the live line in a terminal."""

MOST_ALIKE = 3
"""Flags of one code that are printed, where there are more."""

_said: set[str] = set()

_writing = threading.RLock()

_now: dict[str, Any] = {"doing": "", "begun": 0.0, "said": 0.0, "drawn": False, "result": False}
"""What is being done, when that began and when stderr heard of it last [s], whether the live line stands there, and
whether stdout has a result for programs alone."""


class _Stream(Console):
    """A console whose reader may go away, as `head` does: the work goes on."""

    def on_broken_pipe(self) -> None:
        """Write what is left nowhere."""
        nobody_reads(2 if self.stderr else 1)


def nobody_reads(number: int) -> None:
    """Send what this process still writes to its stream of a number, 1 or 2, nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, number)
    os.close(nowhere)


def stream(stderr: bool = False) -> Console:
    """Return stdout or stderr, on which text is no markup; a pipe gets plain text as wide as COLUMNS, or enough.

    It is stderr alone while stdout has a result for programs, see `result_on_stdout`.
    """
    plain = partial(_Stream, stderr=stderr or _now["result"], markup=False, emoji=False, highlight=False)
    out = plain()
    # Columns to lay out for where the output is no terminal.
    return out if out.is_terminal or os.environ.get("COLUMNS", "").isdecimal() else plain(width=130)


def result_on_stdout() -> None:
    """Have everything else on stderr from now on."""
    _now["result"] = True


def say(*lines: str) -> None:
    """Print lines on stdout; what would break one of them, or colour it, is shown and not obeyed."""
    out = stream()
    with _alone():
        for line in lines:
            out.print(printable(line))


def say_file(text: str) -> None:
    """Print the text of a file where `say` prints, lines of any length as they are."""
    with _alone():
        click.echo(text, err=_now["result"])


def say_written(*paths: Path | None) -> None:
    """Print where the result is, in those files that were asked for."""
    if there := [str(path) for path in paths if path is not None]:
        say(f"Written to {' and '.join(there)}.")


def heading(text: str) -> None:
    """Print a line in bold on stdout, with a rule behind it."""
    with _alone():
        stream().rule(Text(printable(text), style="bold"), align="left")


def complain(text: str) -> None:
    """Print a line on stderr."""
    with _alone(), suppress(OSError):  # nobody reads it: the work goes on
        click.echo(printable(text), err=True)
        _now["said"] = time.monotonic()


def warn(text: str) -> None:
    """Print a warning on stderr, once: an arm's flags come with every result."""
    if text not in _said:
        _said.add(text)
        complain(f"warning: {text}")


def show_flags(flags: Sequence[Flag]) -> None:
    """Print flags about a result on stderr, the first of those that are alike."""
    counts = Counter(flag.code for flag in flags)
    shown = Counter[str]()
    for flag in flags:
        shown[flag.code] += 1
        if counts[flag.code] <= MOST_ALIKE + 1 or shown[flag.code] <= MOST_ALIKE:
            warn(str(flag))
        elif shown[flag.code] == counts[flag.code]:
            warn(f"{flag.code}: {counts[flag.code] - MOST_ALIKE} more (--json FILE has all)")


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table: the first column is text, numbers are set to the right, verdicts give a row its colour.

    No word or number is broken. What is wider than the window is continued below, each part with the first column.
    """
    out, texts = stream(), [[printable(str(cell)) for cell in row] for row in rows]
    cells = [[printable(column), *(row[i] for row in texts)] for i, column in enumerate(columns)]
    least = [max(map(cell_len, " ".join(column).split()), default=0) for column in cells]
    parts: list[list[int]] = [[0]]
    for i in range(1, len(columns)):
        # Columns between those of a table; its edges take one each, too.
        width = sum(least[j] + 3 for j in (*parts[-1], i)) - 1
        if width > out.width and len(parts[-1]) > 1:
            parts.append([0])
        parts[-1].append(i)
    for i, part in enumerate(parts):
        _print_part(out, title if not i else f"{title}, continued", [cells[i] for i in part], texts)


def _print_part(out: Console, title: str, cells: Sequence[Sequence[str]], rows: Sequence[Sequence[str]]) -> None:
    """Print some columns of a table, each with its header first."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for index, (header, *column) in enumerate(cells):
        numeric = index > 0 and all(not cell or cell[0] in "+-.×0123456789" for cell in column)
        table.add_column(header, justify="right" if numeric else "left", overflow="fold")
    for row, texts in zip(rows, zip(*(column[1:] for column in cells), strict=True), strict=True):
        failed = "fail" in row or "not reached" in row
        table.add_row(*texts, style="red" if failed else "yellow" if "uncertain" in row else None)
    # rich would rather break a word than be wider.
    whole = [max(map(cell_len, column)) for column in cells]
    least = [max(map(cell_len, " ".join(column).split()), default=0) for column in cells]
    # Columns that no table has.
    rules = out.measure(table, options=out.options.update(max_width=100_000)).maximum - sum(whole)
    free = max(out.width - rules - sum(least), 0)
    for column, narrow, wide in zip(table.columns, least, whole, strict=True):
        column.width = min(wide, narrow + free)
        free -= column.width - narrow
    width, out.width = out.width, max(out.width, rules + sum(least))
    with _alone():
        out.print(Text(printable(title), style="bold"))
        out.print(table)
    out.width = width


def plus_minus(sigma: float | None) -> str:
    """Return the cell of a standard uncertainty [m or rad], in mm or mrad; None where nobody states one."""
    return "-" if sigma is None else "undetermined" if np.isinf(sigma) else number(sigma * 1e3, 2)


def no_via_points(shown: str) -> str:
    """Return what is said of a trajectory that names no via-points, and what is shown of its rows instead."""
    advice = "to have rows listed, give them names in a column `via`"
    return f"The trajectory names no via-points: every row counts alike, and shown are {shown}; {advice}."


@contextmanager
def showing_stages(title: str = "") -> Iterator[None]:
    """Say on stderr what is being done, with the seconds passed: a live line in a terminal, in a pipe one now and then.

    What is done is `title` until `show_stage`, `doing` or `progress` say another. A thread writes: what computes
    need not look at the clock. What the package logs meanwhile is a line of its own.
    """
    over, live = threading.Event(), sys.stderr.isatty()
    begun = time.monotonic()
    _now.update(doing=title, begun=begun, said=begun)

    def keep_saying() -> None:
        while not over.wait(REDRAWN):
            text = str(_now["doing"])
            if text and live:
                with _alone():
                    click.echo(printable(_timed(text))[: stream(stderr=True).width - 1], err=True, nl=False)
                    _now["drawn"] = True
            now = time.monotonic()
            if text and not live and now - _now["said"] >= max(EVERY, 0.1 * (now - begun)) - REDRAWN / 2:
                complain(_timed(text))

    thread = threading.Thread(target=keep_saying, daemon=True)
    thread.start()
    log, lines = logging.getLogger("armflex"), _Complaints()
    log.addHandler(lines)
    try:
        yield
    finally:
        log.removeHandler(lines)
        over.set()
        thread.join()
        with _alone():
            _now["doing"] = ""


class _Complaints(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        complain(record.getMessage())


def show_stage(text: str) -> None:
    """Print what is done from now on on stderr, with the seconds passed."""
    doing(text)
    complain(_timed(text))


def doing(what: object) -> None:
    """Take note of what is done from now on; its text is asked for when it is said, which is seldom."""
    _now["doing"] = what


@contextmanager
def progress(title: str) -> Iterator[Callable[[int, int | None], None]]:
    """Yield a function of (done, total) that takes note of how far something is; afterwards it is written."""
    doing(title)
    yield lambda done, total: doing(f"{title}, {done}" + (f" of {total}" if total else ""))
    doing("writing")


@contextmanager
def _alone() -> Iterator[None]:
    """Write undisturbed, where the live line stood."""
    with _writing:
        if _now["drawn"]:
            click.echo("\r\x1b[K", err=True, nl=False)
            _now["drawn"] = False
        yield


def _timed(text: str) -> str:
    return f"{time.monotonic() - _now['begun']:4.0f} s  {text}"
