"""Unnamed shapes: a twist, or a compliance, as a free function of a column, for what no law describes.

They are no physics: they say where, along which axis and with which column something happens, and its shape inside the
recorded range; outside it they stay at their end values.
"""

from collections.abc import Callable, Iterable
from functools import lru_cache, partial
from itertools import permutations

import numpy as np

from armflex.laws.effects.context import Context, Records
from armflex.laws.effects.effect import (
    Amplitude,
    DependsOn,
    Effect,
    Inner,
    Manipulator,
    Plausible,
    Search,
    TwistLaw,
    Values,
    Words,
)
from armflex.laws.effects.location import BASE, TOOL, Here, Location, with_terms
from armflex.laws.effects.shapes import compliances, free_of_aliases, of_column, on_axis, shares_of_load, twists
from armflex.laws.terms import Curve, Factor, Of, Term, part, powers, tents, waves

KNOTS = 8
"""Hats of a free shape over the recorded range; the mean is left to the constant parameters."""

LEAST_PERIODS, PERIODS = 0.5, 6.0
"""Fewest and most periods of a wave over a column's recorded range; less of one is a trend."""


def _column(here: Here) -> str:
    return here.location.covariates[0]


def _tents(here: Here, inner: Values) -> list[Factor]:
    return tents(_column(here), inner[0], inner[1], KNOTS)[:-1]


def _product_terms(here: Here, inner: Values) -> list[list[Term]]:
    first, second = here.location.covariates
    other, hats = powers(second, 1, inner[2]), tents(first, inner[0], inner[1], KNOTS)
    return twists(here.direction, *((hat,) for hat in hats[:-1]), *((hat, *other) for hat in hats))


def _wave_product_terms(here: Here, inner: Values) -> list[list[Term]]:
    first, second = here.location.covariates
    both, other = waves(first, inner[0]), powers(second, 1, inner[1])
    return twists(here.direction, *((wave,) for wave in both), *((wave, *other) for wave in both))


def _goes_round(effect: Effect, context: Context, arm: Manipulator) -> bool:
    """Return whether a wave goes through `LEAST_PERIODS` over what was recorded of its column, and is seen to."""
    number, values = effect.inner[0], context.column(effect.location.covariates[0])
    return number * np.ptp(values) >= 2.0 * np.pi * LEAST_PERIODS and free_of_aliases(values, number)


FREE = Plausible(5e-3, 5e-3, "what is larger has a cause that is seen")
Shape = partial(TwistLaw, direction=on_axis, plausible=FREE, physical=False)

LOW = Inner("low", "as recorded", of_column(lambda x: (float(x.min()),)), positive=False, polished=False)
HIGH = Inner("high", "as recorded", of_column(lambda x: (float(x.max()),)), positive=False, polished=False)
MIDDLE = Inner(
    "middle", "as recorded", of_column(lambda x: (float(x.mean()),), -1), positive=False, polished=False, usual=0.0
)
CENTRE = Inner("centre", "as recorded", of_column(lambda x: np.linspace(x.min(), x.max(), 25)), positive=False)
WIDTH = Inner("width", "as recorded", of_column(lambda x: float(np.ptp(x)) * np.array([0.02, 0.05, 0.1])))
WAVES = np.arange(LEAST_PERIODS, PERIODS, 1.0 / 3.0)


@lru_cache(64)
def _numbers(column: bytes) -> list[float]:
    """Return wave numbers that the (N,) values of a column distinguish from others; it is asked for at every place."""
    values = np.frombuffer(column)
    numbers = 2.0 * np.pi / float(np.ptp(values)) * WAVES
    return [number for number in numbers.tolist() if free_of_aliases(values, number)]


NUMBER = Inner("k", "per recorded", of_column(lambda x: _numbers(np.asarray(x, dtype=float).tobytes())))
TENTS = tuple(f"a{i}" for i in range(KNOTS))


def _at_all(records: Records, columns: Iterable[tuple[str, ...]]) -> list[Location]:
    """Return the base, every joint and the tool with each axis and each of some columns."""
    sites, groups = (BASE, *records.joints, TOOL), list(columns)
    return [Location(site, axis, names) for site in sites for axis in records.axes(site) for names in groups]


def everywhere(records: Records, columns: int = 1) -> list[Location]:
    """Return every place with each candidate column, or as many different ones in order."""
    return _at_all(records, permutations((*records.recorded, *records.positions), columns))


def _with_all(count: int, columns: int = 1) -> Callable[[Records], list[Location]]:
    """Return the same places, at which that many amplitudes act together."""
    return lambda records: with_terms(everywhere(records, columns), tuple(range(count)))


SPLINE = Shape(
    name="unnamed_shape",
    words=Words("unnamed shape", "it follows a column freely", "f(x), straight between knots"),
    places=_with_all(KNOTS),
    amplitudes=tuple(Amplitude(name, "{m}") for name in TENTS),
    terms=lambda here, inner: twists(here.direction, *([tent] for tent in _tents(here, inner))),
    inner=(LOW, HIGH),
    shape="spline",
)
SPLINE_COMPLIANCE = Shape(
    name="unnamed_compliance",
    words=Words("unnamed compliance", "a compliance that depends on a column", "f(x) · w"),
    places=_with_all(KNOTS),
    amplitudes=tuple(Amplitude(name, "{m}/{w}") for name in TENTS),
    terms=lambda here, inner: compliances(here.direction, *([tent] for tent in _tents(here, inner))),
    inner=(LOW, HIGH),
    depends_on=DependsOn.COMPLIANCE,
    shape="spline_compliance",
)
BUMP = Shape(
    name="unnamed_bump",
    words=Words("unnamed bump", "it happens near one value", "height · exp(−(x − centre)² / 2 width²)"),
    places=everywhere,
    amplitudes=(Amplitude("height", "{m}"),),
    terms=lambda here, inner: twists(here.direction, (Factor(Of.BUMP, _column(here), tuple(inner)),)),
    inner=(CENTRE, WIDTH),
    shape="bump",
    search=Search.RESIDUAL,
)
WAVE = Shape(
    name="unnamed_wave",
    words=Words("unnamed wave", "it goes up and down with a column", "A sin kx + B cos kx"),
    places=_with_all(2),
    amplitudes=(Amplitude("A", "{m}"), Amplitude("B", "{m}")),
    terms=lambda here, inner: twists(here.direction, *([wave] for wave in waves(_column(here), inner[0]))),
    inner=(NUMBER,),
    shape="wave",
    search=Search.RESIDUAL,
    possible=_goes_round,
)
LINE = Shape(
    name="unnamed_line",
    words=Words("unnamed trend", "it grows steadily with a column", "slope · x + curvature · x²"),
    places=everywhere,
    amplitudes=(Amplitude("slope", "{m} per recorded"), Amplitude("curvature", "{m} per recorded^2")),
    terms=lambda here, inner: twists(
        here.direction, *(powers(_column(here), exponent, inner[0]) for exponent in (1, 2))
    ),
    inner=(MIDDLE,),
    shape="line",
)
LINE_COMPLIANCE = Shape(
    name="unnamed_line_compliance",
    words=Words(
        "unnamed trend of a compliance", "a compliance grows steadily with a column", "(slope · x + curvature · x²) · w"
    ),
    places=_with_all(2),
    amplitudes=(Amplitude("slope", "{m}/{w} per recorded"), Amplitude("curvature", "{m}/{w} per recorded^2")),
    terms=lambda here, inner: compliances(
        here.direction, *(powers(_column(here), exponent, inner[0]) for exponent in (1, 2))
    ),
    inner=(MIDDLE,),
    depends_on=DependsOn.COMPLIANCE,
    shape="line_compliance",
    search=Search.NOWHERE,
)
LINE_PLAY = Shape(
    name="unnamed_line_play",
    words=Words(
        "unnamed trend of a play", "the load takes up play that grows with a column", "(g + slope · x) · tanh(τ / τ₀)"
    ),
    places=_with_all(2),
    amplitudes=(Amplitude("g", "{m}"), Amplitude("slope", "{m} per recorded")),
    terms=lambda here, inner: [
        [Term(here.direction, features=(part(here.direction / inner[1], Curve.TANH),), factors=factors)]
        for factors in (powers(_column(here), exponent, inner[0]) for exponent in (0, 1))
    ],
    inner=(MIDDLE, Inner("tau0", "{w}", partial(shares_of_load, shares=(0.1,)))),
    depends_on=DependsOn.COMPLIANCE,
    shape="line_play",
    search=Search.NOWHERE,
)
PRODUCT = Shape(
    name="unnamed_product",
    words=Words("unnamed product", "two columns act together", "f(x) · (1, y)"),
    places=_with_all(2 * KNOTS + 1, columns=2),
    amplitudes=tuple(Amplitude(f"a{i}", "{m}") for i in range(2 * KNOTS + 1)),
    terms=_product_terms,
    inner=(LOW, HIGH, MIDDLE),
    shape="product",
    columns=2,
    search=Search.RESIDUAL,
)
WAVE_PRODUCT = Shape(
    name="unnamed_wave_product",
    words=Words(
        "unnamed wave product", "a wave in one column grows with another", "(A + C y) sin kx + (B + D y) cos kx"
    ),
    places=_with_all(4, columns=2),
    amplitudes=tuple(
        Amplitude(name, "{m}" + unit) for name, unit in zip("ABCD", ("", "", *2 * (" per recorded",)), strict=True)
    ),
    terms=_wave_product_terms,
    inner=(NUMBER, MIDDLE),
    shape="wave_product",
    columns=2,
    search=Search.RESIDUAL,
    possible=_goes_round,
)

LEVEL = Shape(
    name="unnamed_level",
    words=Words("unnamed level", "it is there while a column has one entry", "a step"),
    places=lambda records: _at_all(records, ((name,) for name in records.levels)),
    amplitudes=(Amplitude("step", "{m}"),),
    terms=lambda here, inner: twists(here.direction, powers(_column(here), 1)),
    shape="level",
)
