"""A trace, calibration, history, checked path or pose characteristics as one HTML page: no server, no network."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from armflex.conventions import printable
from armflex.storage.whole_file import write_whole

if TYPE_CHECKING:
    from armflex.estimate import Calibration
    from armflex.estimate.calibrations import History
    from armflex.show.report.checked import CheckedPath
    from armflex.tasks.iso9283 import PosePerformance
    from armflex.trace.findings import Trace

__all__ = ["render_report", "write_report"]

PAGES = {
    "Trace": ("traced", "page.html"),
    "Calibration": ("cover", "calibration.html"),
    "PosePerformance": ("performance", "iso9283.html"),
    "History": ("courses", "history.html"),
    "CheckedPath": ("checked", "checked.html"),
}
"""By what is reported the module whose `account` says what a page shows, and the page's template."""


def write_report(
    result: Trace | Calibration | PosePerformance | History | CheckedPath,
    path: str | os.PathLike[str],
    *labels: Sequence[str],
) -> Path:
    """Write the page of a result and return its path; see `render_report`.

    Args:
        result: What is reported.
        path: The page; it appears whole or not at all.
        labels: Of a history: the names of its dates.

    Raises:
        FileError: The page cannot be written.
    """
    return write_whole(Path(path), render_report(result, *labels).encode())


def render_report(result: Trace | Calibration | PosePerformance | History | CheckedPath, *labels: Sequence[str]) -> str:
    """Return the page of a result as HTML text; everything that is not a figure is escaped.

    The same result gives the same page, byte for byte.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from armflex.show.report.svg import drawing

    def shown(value: object) -> object:
        # A text that a browser can show; what is markup already, a figure, is left alone.
        return printable(value, keep="\t\n\r") if type(value) is str else value

    module, template = PAGES[type(result).__name__]
    with drawing():
        page = import_module(f"{__name__}.{module}").account(result, *labels)
    environment = Environment(
        loader=PackageLoader(__name__, ""),
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=True,
        undefined=StrictUndefined,
        finalize=shown,
    )
    return environment.get_template(template).render(page=page).lstrip()
