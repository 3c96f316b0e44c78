"""Tables for people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich import box
from rich.console import Console
from rich.table import Table

from armflex.conventions import number as number

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
