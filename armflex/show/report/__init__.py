"""A trace as one self-contained HTML page: no server, no network, nothing beside it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from armflex.storage.whole_file import write_whole

if TYPE_CHECKING:
    from armflex.trace.result import Trace

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
    """Return the page of a traced arm as HTML text."""
    from armflex.show.report.page import render  # imports jinja2 and matplotlib

    return render(trace)
