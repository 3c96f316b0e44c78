"""The page's text from its template; everything that is not a figure is escaped."""

from __future__ import annotations

from importlib import resources

from jinja2 import Environment, StrictUndefined

from armflex.printable import printable
from armflex.show.report.account import account
from armflex.show.report.svg import drawing
from armflex.trace.result import Trace


def render(trace: Trace) -> str:
    """Return the page of a trace as HTML text."""
    with drawing():
        found = account(trace)
    text = (resources.files(__package__) / "page.html").read_text(encoding="utf-8")
    blocks = {"trim_blocks": True, "lstrip_blocks": True}
    environment = Environment(autoescape=True, undefined=StrictUndefined, finalize=_shown, **blocks)
    return environment.from_string(text).render(page=found).lstrip()


def _shown(value: object) -> object:
    """Return a text that a browser can show; what is markup already, a figure, is left alone."""
    return printable(value, keep="\t\n\r") if type(value) is str else value
