"""The one way to the terminal: every text arrives as it is, none as markup, and none moves the cursor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

import click
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from armflex.conventions import number as number
from armflex.conventions import printable
from armflex.errors import Flag

NARROWEST = 130
"""Columns to lay out for where the output is no terminal."""

_said: set[str] = set()


def stream(stderr: bool = False) -> Console:
    """Return stdout or stderr, on which text is no markup; a pipe gets plain text wide enough for every table."""
    plain = partial(Console, stderr=stderr, markup=False, emoji=False, highlight=False)
    out = plain()
    return out if out.is_terminal else plain(width=NARROWEST)


def say(*lines: str) -> None:
    """Print lines on stdout; what would break one of them, or colour it, is shown and not obeyed."""
    out = stream()
    for line in lines:
        out.print(printable(line))


def heading(text: str) -> None:
    """Print a line in bold on stdout, with a rule behind it."""
    stream().rule(Text(printable(text), style="bold"), align="left")


def complain(text: str, end: str = "\n", over: bool = False) -> None:
    """Print a line on stderr; `over` writes it over what stands in the terminal's last line."""
    click.echo(("\r\x1b[K" if over else "") + printable(text) + end, err=True, nl=False)


def warn(text: str) -> None:
    """Print a warning on stderr, once: an arm's flags come with every result."""
    if text not in _said:
        _said.add(text)
        complain(f"warning: {text}")


def show_flags(flags: Sequence[Flag]) -> None:
    """Print flags about a result on stderr."""
    for flag in flags:
        warn(str(flag))


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table: the first column is text, numbers are set to the right, verdicts give a row its colour."""
    table = Table(title=printable(title), title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    rows = [[printable(str(cell)) for cell in row] for row in rows]
    for index, column in enumerate(columns):
        numeric = index > 0 and all(not row[index] or row[index][0] in "+-.×0123456789" for row in rows)
        table.add_column(printable(column), justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        failed = "fail" in row or "not reached" in row
        table.add_row(*row, style="red" if failed else "yellow" if "uncertain" in row else None)
    stream().print(table)


def plus_minus(sigma: float | None) -> str:
    """Return the cell of a standard uncertainty [m or rad], in mm or mrad; None where nobody states one."""
    return "-" if sigma is None else "undetermined" if np.isinf(sigma) else number(sigma * 1e3, 2)


def no_via_points(shown: str) -> str:
    """Return what is said of a trajectory that names no via-points, and what is shown of its rows instead."""
    advice = "to have rows listed, give them names in a column `via`"
    return f"The trajectory names no via-points: every row counts alike, and shown are {shown}; {advice}."


@contextmanager
def progress(title: str) -> Iterator[Callable[[int, int | None], None]]:
    """Yield a function of (done, total) that draws a bar on a terminal's stderr and is silent elsewhere."""
    from rich.progress import Progress

    out = stream(stderr=True)
    with Progress(console=out, transient=True, disable=not out.is_terminal) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
