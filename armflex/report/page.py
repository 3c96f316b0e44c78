"""The page's text from its template; everything that is not a figure is escaped."""

from __future__ import annotations

from importlib import resources

from jinja2 import Environment, StrictUndefined

from armflex.report.account import account
from armflex.report.svg import drawing
from armflex.trace.result import Trace


def render(trace: Trace) -> str:
    """Return the page of a trace as HTML text."""
    with drawing():
        found = account(trace)
    text = (resources.files(__package__) / "page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(text).render(page=found).lstrip()
