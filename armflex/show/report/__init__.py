"""A trace, or a campaign's pose characteristics, as one self-contained HTML page: no server, no network."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from armflex.conventions import printable
from armflex.storage.whole_file import write_whole

if TYPE_CHECKING:
    from armflex.estimate import Calibration
    from armflex.estimate.history import History
    from armflex.tasks.iso9283 import PosePerformance
    from armflex.trace.findings import Trace

__all__ = ["render_calibration", "render_iso9283", "render_report", "write_history", "write_report"]


def write_report(result: Trace | Calibration | PosePerformance, path: str | os.PathLike[str]) -> Path:
    """Write the page of a traced or calibrated arm, or of what `iso9283` returned, and return its path.

    The same result gives the same page, byte for byte.

    Args:
        result: What is reported.
        path: The page; it appears whole or not at all.

    Raises:
        FileError: The page cannot be written.
    """
    from armflex.estimate import Calibration
    from armflex.tasks.iso9283 import PosePerformance

    if isinstance(result, PosePerformance):
        text = render_iso9283(result)
    else:
        text = render_calibration(result) if isinstance(result, Calibration) else render_report(result)
    return write_whole(Path(path), text.encode())


def write_history(found: History, labels: Sequence[str], path: str | os.PathLike[str]) -> Path:
    """Write the page of a machine's history, its dates named by `labels`, whole or not at all; return its path."""
    from armflex.show.report.courses import account

    return write_whole(Path(path), _rendered("history.html", lambda: account(found, labels)).encode())


def render_report(trace: Trace) -> str:
    """Return the page of a traced arm as HTML text; everything that is not a figure is escaped."""
    from armflex.show.report.account import account

    return _rendered("page.html", lambda: account(trace))


def render_calibration(found: Calibration) -> str:
    """Return the page of a calibrated arm as HTML text; everything is escaped."""
    from armflex.show.report.cover import calibration_account

    return _rendered("calibration.html", lambda: calibration_account(found))


def render_iso9283(found: PosePerformance) -> str:
    """Return the page of a campaign's pose characteristics as HTML text; everything that is not a figure is escaped."""
    from armflex.show.report.performance import account

    return _rendered("iso9283.html", lambda: account(found))


def _rendered(template: str, account: Callable[[], object]) -> str:
    """Return a page of what `account` says, its figures drawn in the page's style."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from armflex.show.report.svg import drawing

    def shown(value: object) -> object:
        # A text that a browser can show; what is markup already, a figure, is left alone.
        return printable(value, keep="\t\n\r") if type(value) is str else value

    with drawing():
        page = account()
    environment = Environment(
        loader=PackageLoader(__name__, ""),
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=True,
        undefined=StrictUndefined,
        finalize=shown,
    )
    return environment.get_template(template).render(page=page).lstrip()
