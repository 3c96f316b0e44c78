"""A trace as one self-contained HTML page: no server, no network, nothing beside it."""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from armflex.conventions import printable
from armflex.storage.whole_file import write_whole

if TYPE_CHECKING:
    from armflex.trace.findings import Trace

__all__ = ["render_report", "write_report"]


def write_report(trace: Trace, path: str | os.PathLike[str]) -> Path:
    """Write the page of a traced arm and return its path; the same trace gives the same page, byte for byte.

    Args:
        trace: What tracing found.
        path: The page; it appears whole or not at all.

    Raises:
        FileError: The page cannot be written.
    """
    return write_whole(Path(path), render_report(trace).encode())


def render_report(trace: Trace) -> str:
    """Return the page of a traced arm as HTML text; everything that is not a figure is escaped."""
    from jinja2 import Environment, StrictUndefined

    from armflex.show.report.account import account
    from armflex.show.report.svg import drawing

    def shown(value: object) -> object:
        # A text that a browser can show; what is markup already, a figure, is left alone.
        return printable(value, keep="\t\n\r") if type(value) is str else value

    with drawing():
        found = account(trace)
    text = (resources.files(__name__) / "page.html").read_text(encoding="utf-8")
    environment = Environment(
        trim_blocks=True, lstrip_blocks=True, autoescape=True, undefined=StrictUndefined, finalize=shown
    )
    return environment.from_string(text).render(page=found).lstrip()
