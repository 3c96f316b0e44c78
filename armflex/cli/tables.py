"""Tables for people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich import box
from rich.console import Console
from rich.table import Table

NARROWEST = 130
"""Columns to lay out for where the output is no terminal."""


def console() -> Console:
    """Return stdout; a pipe gets plain text wide enough for every table."""
    out = Console(highlight=False)
    return out if out.is_terminal else Console(highlight=False, width=NARROWEST)


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table: the first column is text, numbers are set to the right."""
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    rows = [[str(cell) for cell in row] for row in rows]
    for index, column in enumerate(columns):
        numeric = index > 0 and all(_is_number(row[index]) for row in rows)
        table.add_column(column, justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        table.add_row(*row, style=_style(row))
    console().print(table)


def _is_number(text: str) -> bool:
    return not text or text[0] in "+-.0123456789" or text == "-"


def _style(row: Sequence[str]) -> str | None:
    if "fail" in row or "not reached" in row:
        return "red"
    return "yellow" if "uncertain" in row else None


def number(value: float, digits: int = 4) -> str:
    """Return a number to so many significant digits, tiny ones as 0."""
    return "0" if abs(value) < 1e-9 else f"{value:.{digits}g}"
