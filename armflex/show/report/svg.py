"""Figures as inline SVG: no ids that clash, no addresses, colours that follow the page's light or dark theme."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from io import StringIO
from itertools import product
from typing import TYPE_CHECKING, Literal

import numpy as np

from armflex.plotting import styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, RULE, PAPER, BEFORE, AFTER, MARK, SOFT = (f"#{i:02x}{i:02x}{i:02x}" for i in range(1, 9))
"""Stand-ins for the page's colours; each becomes a variable of its style sheet."""

VARIABLES = {INK: "ink", MUTED: "muted", RULE: "rule", PAPER: "card", BEFORE: "before", AFTER: "after", MARK: "mark"}
VARIABLES[SOFT] = "soft"

DASHED = (0, (4, 3))
"""How a line of reference is drawn: points of line and of gap."""

CHARACTER = 9.0
"""Size of letters [points]."""

WAYS = ((1.0, 1.0), (1.0, 0.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, 0.0), (-1.0, -1.0), (0.0, 1.5), (0.0, -1.5))
"""Where a name may stand beside its point, in order."""

STYLE = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": CHARACTER,
    "axes.unicode_minus": True,
    "text.color": INK,
    "axes.edgecolor": RULE,
    "axes.labelcolor": MUTED,
    "axes.titlesize": 9.5,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": RULE,
    "grid.linewidth": 0.5,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "path.simplify": False,
}


@contextmanager
def drawing() -> Iterator[None]:
    """Draw in the page's style while the context lasts, whatever the user's own is."""
    import matplotlib as mpl

    with styled({**mpl.rcParamsDefault, **STYLE}):
        yield


def blank(width: float = 1.0, height: float = 1.0) -> Figure:
    """Return a figure [inch] with nothing on it."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def canvas(width: float, height: float, rows: int = 1, columns: int = 1, **more) -> tuple[Figure, list[Axes]]:
    """Return a figure [inch] and its axes row by row."""
    figure = blank(width, height)
    axes = figure.subplots(rows, columns, squeeze=False, **more)
    return figure, list(axes.ravel())


def inline(figure: Figure, name: str) -> str:
    """Return the SVG element of a figure; `name` makes its ids its own and is read aloud."""
    import matplotlib as mpl

    text = StringIO()
    with mpl.rc_context({"svg.hashsalt": name}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # browsers have more letters than matplotlib measures by
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<!--.*?-->\s*|<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(<g) id="[^"]*"', r"\1", svg)  # named by number, alike in every figure, and used by nothing
    svg = re.sub(r"<[^>]*>", _themed, svg)  # no text in between
    box = re.findall(r'viewBox="([^"]*)"', svg)[0]
    safe = re.sub(r"[^\w ,.-]", " ", name)
    width = 1.44 * float(box.split()[2])  # of the page per point of a figure: ten inches fill a wide page
    # Width in pixels below which a figure is scrolled instead of shrunk.
    size = f"min-width:{min(width, 640.0):.0f}px; max-width:{width:.0f}px"
    head = f'<svg class="figure" viewBox="{box}" style="{size}" role="img" aria-label="{safe}">'
    return head + svg[svg.index(">") + 1 :].strip()


def _themed(tag: re.Match) -> str:
    """Return a tag whose style follows the page's theme."""
    plain = tag[0].replace("xlink:href=", "href=")
    colours = partial(re.sub, r"#0[1-8]0[1-8]0[1-8]", lambda match: f"var(--{VARIABLES[match[0]]})")
    return re.sub(r'style="[^"]*"', lambda style: colours(style[0]), plain)


def grid(axes: Axes, which: Literal["both", "x", "y"] = "both") -> None:
    """Draw faint lines behind the data and no tick marks."""
    axes.grid(True, axis=which)
    axes.tick_params(length=0)


def label(axes: Axes, points: Sequence[tuple[str, tuple[float, float]]]) -> None:
    """Write names beside points (x, y) of data so that none is on another or on a point; what is far has a line.

    Places around a point are tried from near to far, the upper right first; the last one stands where none is free.
    """
    axes.figure.draw_without_rendering()  # pyright: ignore[reportAttributeAccessIssue]
    scale = 72.0 / axes.figure.dpi
    box, dots = np.array(axes.bbox.extents) * scale, [axes.transData.transform(point) * scale for _, point in points]
    taken = [(x - 4.0, y - 4.0, x + 4.0, y + 4.0) for x, y in dots]
    for (text, point), (x, y) in zip(points, dots, strict=True):
        wide, size = 0.6 * CHARACTER * len(text), CHARACTER
        for far, way in product((6.0, 16.0, 28.0, 42.0, 58.0), WAYS):
            left, low = x + far * way[0] - (wide if way[0] < 0.0 else 0.0), y + far * way[1] - 0.5 * size
            place = (left, low, left + wide, low + size)
            inside = place[0] > box[0] and place[1] > box[1] and place[2] < box[2] and place[3] < box[3]
            if inside and not any(_overlap(place, other) for other in taken):
                break
        taken.append(place)
        arrow = {"arrowstyle": "-", "color": MUTED, "linewidth": 0.5} if far > 6.0 else None
        behind = {"facecolor": PAPER, "edgecolor": "none", "alpha": 0.7, "pad": 0.5}
        shift = {"textcoords": "offset points", "ha": "left", "va": "center", "arrowprops": arrow, "bbox": behind}
        axes.annotate(text, point, (left - x, low + 0.5 * size - y), color=INK, **shift)


def _overlap(first: tuple[float, ...], second: tuple[float, ...]) -> bool:
    """Return whether two boxes (left, low, right, high) have a part in common."""
    return first[0] < second[2] and second[0] < first[2] and first[1] < second[3] and second[1] < first[3]


def cut(text: str, most: int = 40) -> str:
    """Return a name no longer than a figure has room for."""
    return text if len(text) <= most else text[: most - 1] + "…"
