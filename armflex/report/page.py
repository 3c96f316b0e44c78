"""The page's text from its template; everything that is not a figure is escaped."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources
from typing import TypeVar

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from armflex.report.account import Account, EffectAccount, account
from armflex.report.svg import drawing
from armflex.trace.result import Trace

FIGURES = ("workspace", "sessions", "heat", "pulls", "detectable")
EFFECT_FIGURES = ("against", "ranking", "posterior")

Part = TypeVar("Part", Account, EffectAccount)


def render(trace: Trace) -> str:
    """Return the page of a trace as HTML text."""
    with drawing():
        found = account(trace)
    text = (resources.files(__package__) / "page.html").read_text(encoding="utf-8")
    template = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return template.from_string(text).render(page=_drawn(found))


def _drawn(found: Account) -> Account:
    """Return the account with its figures marked as SVG; matplotlib has escaped the names in them."""
    effects = [_marked(effect, EFFECT_FIGURES) for effect in found.effects]
    return replace(_marked(found, FIGURES), effects=effects)


def _marked(part: Part, names: tuple[str, ...]) -> Part:
    return replace(part, **{name: Markup(getattr(part, name)) for name in names})
