"""The one way to the terminal: every text arrives as it is, none as markup, and none moves the cursor."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import click
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from armflex.conventions import number as number
from armflex.printable import printable

NARROWEST = 130
"""Columns to lay out for where the output is no terminal."""


def stream(stderr: bool = False) -> Console:
    """Return stdout or stderr, on which text is no markup; a pipe gets plain text wide enough for every table."""
    plain = {"stderr": stderr, "markup": False, "emoji": False, "highlight": False}
    out = Console(**plain)
    return out if out.is_terminal else Console(width=NARROWEST, **plain)


class Printer:
    """Prints lines; what would break one of them, or colour it, is shown and not obeyed."""

    def __init__(self) -> None:
        self._out = stream()

    def print(self, *lines: str) -> None:
        """Print lines."""
        for line in lines:
            self._out.print(printable(line))


def console() -> Printer:
    """Return what prints on stdout."""
    return Printer()


def heading(text: str) -> None:
    """Print a line in bold on stdout, with a rule behind it."""
    stream().rule(Text(printable(text), style="bold"), align="left")


def complain(text: str, end: str = "\n", over: bool = False) -> None:
    """Print a line on stderr; `over` writes it over what stands in the terminal's last line."""
    click.echo(("\r\x1b[K" if over else "") + printable(text) + end, err=True, nl=False)


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table: the first column is text, numbers are set to the right."""
    table = Table(title=printable(title), title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    rows = [[printable(str(cell)) for cell in row] for row in rows]
    for index, column in enumerate(columns):
        numeric = index > 0 and all(_is_number(row[index]) for row in rows)
        table.add_column(printable(column), justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        table.add_row(*row, style=_style(row))
    stream().print(table)


def no_via_points(shown: str) -> str:
    """Return what is said of a trajectory that names no via-points, and what is shown of its rows instead."""
    advice = "to have rows listed, give them names in a column `via`"
    return f"The trajectory names no via-points: every row counts alike, and shown are {shown}; {advice}.\n"


def _is_number(text: str) -> bool:
    return not text or text[0] in "+-.0123456789" or text == "-"


def _style(row: Sequence[str]) -> str | None:
    if "fail" in row or "not reached" in row:
        return "red"
    return "yellow" if "uncertain" in row else None
