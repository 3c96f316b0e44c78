"""Shapes without a name: a twist, or a compliance, as a free function of a column, for what no law describes.

They are no physics: they say where, along which axis and with which column something happens, and its shape inside the
recorded range; outside it they stay at their end values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np

from armflex.conventions import Array
from armflex.laws import Row
from armflex.laws.effects.effect import Amplitude, Effect, Inner, Manipulator, TwistLaw, Values, Words
from armflex.laws.effects.location import BASE, TOOL, Here, Location
from armflex.laws.effects.scene import AXES, Records, Scene, column_of
from armflex.laws.effects.shapes import along, on_axis

KNOTS = 8
"""Hats of a free shape over the recorded range; the mean is left to the constant parameters."""

LEAST_PERIODS, PERIODS = 0.5, 6.0
"""Fewest and most periods of a wave over a column's recorded range; less of one is a trend."""


def suspects(records: Records) -> tuple[str, ...]:
    """Return every column that may be a cause: what was recorded, and every joint's position."""
    return (*records.recorded, *(f"q_{joint}" for joint in records.joints))


def hats(values: Array, low: float, high: float, count: int) -> Array:
    """Return (count, ...) piecewise straight functions; the last of all is left out, so they sum to no constant."""
    place = (np.clip(values, low, high) - low) * (count / (high - low if high > low else 1.0))
    knots = np.arange(count, dtype=float).reshape(-1, *(1,) * np.ndim(place))
    return np.maximum(1.0 - np.abs(place - knots), 0.0)


def _spline(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    low, high = inner
    return list(hats(column_of(row, here.location.covariates[0]), low, high, KNOTS))


def _spline_compliance(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    load = along(here, wrench)
    values = np.broadcast_to(column_of(row, here.location.covariates[0]), np.shape(load))
    low, high = inner
    return list(hats(values, low, high, KNOTS) * load)


def _bump(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    away = (column_of(row, here.location.covariates[0]) - inner[0]) / inner[1]
    return (np.exp(-0.5 * away**2) * np.ones(wrench.shape[:-1]),)


def _wave(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    angle = inner[0] * column_of(row, here.location.covariates[0])
    return np.sin(angle), np.cos(angle)


def _level(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    return (column_of(row, here.location.covariates[0]) * np.ones(wrench.shape[:-1]),)


def _line(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    away = column_of(row, here.location.covariates[0]) - inner[0]
    return away * np.ones(wrench.shape[:-1]), away**2 * np.ones(wrench.shape[:-1])


def _product(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    first, second = (column_of(row, name) for name in here.location.covariates)
    tents = hats(first, inner[0], inner[1], KNOTS)
    return (*tents, *(tent * (second - inner[2]) for tent in [*tents, 1.0 - sum(tents)]))


def _wave_product(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    first, second = (column_of(row, name) for name in here.location.covariates)
    sine, cosine = np.sin(inner[0] * first), np.cos(inner[0] * first)
    return [wave * factor for factor in (1.0, second - inner[1]) for wave in (sine, cosine)]


def lowest(location: Location, scene: Scene, place: int = 0) -> Iterable[float]:
    """Return the lowest recorded value of one of the location's columns."""
    return (float(scene.column(location.covariates[place]).min()),)


def highest(location: Location, scene: Scene, place: int = 0) -> Iterable[float]:
    """Return the highest recorded value of one of the location's columns."""
    return (float(scene.column(location.covariates[place]).max()),)


def _middle(location: Location, scene: Scene) -> Iterable[float]:
    return (float(scene.column(location.covariates[-1]).mean()),)


def _centres(location: Location, scene: Scene) -> Iterable[float]:
    values = scene.column(location.covariates[0])
    return np.linspace(values.min(), values.max(), 25)


def _widths(location: Location, scene: Scene) -> Iterable[float]:
    return float(np.ptp(scene.column(location.covariates[0]))) * np.array([0.02, 0.05, 0.1])


def _waves(location: Location, scene: Scene) -> Iterable[float]:
    span = float(np.ptp(scene.column(location.covariates[0])))
    return 2.0 * np.pi / span * np.arange(LEAST_PERIODS, PERIODS, 1.0 / 3.0)


def _goes_round(effect: Effect, scene: Scene, arm: Manipulator) -> bool:
    """Return whether a wave goes through `LEAST_PERIODS` over what was recorded of its column."""
    return effect.inner[0] * np.ptp(scene.column(effect.location.covariates[0])) >= 2.0 * np.pi * LEAST_PERIODS


LOW = Inner("low", "as recorded", lowest, positive=False, polished=False)
HIGH = Inner("high", "as recorded", highest, positive=False, polished=False)
MIDDLE = Inner("middle", "as recorded", _middle, positive=False, polished=False)
TENTS = tuple(f"a{i}" for i in range(KNOTS))


def shaped_places(records: Records) -> list[tuple[str, str]]:
    """Return the sites and axes at which free shapes are tried: the base, every joint and the tool."""
    return [(site, axis) for site in (BASE, *records.joints, TOOL) for axis in AXES]


def everywhere(records: Records) -> list[Location]:
    """Return every joint, the base and the tool with each axis and each suspect column."""
    return [Location(site, axis, (name,)) for site, axis in shaped_places(records) for name in suspects(records)]


def _with_all(make: Callable[[Records], list[Location]], count: int, records: Records) -> list[Location]:
    return [Location(s.site, s.axis, s.covariates, tuple(range(count))) for s in make(records)]


SPLINE = TwistLaw(
    name="unnamed_shape",
    words=Words("unnamed shape", "it follows a column freely", "f(x), straight between knots"),
    places=partial(_with_all, everywhere, KNOTS),
    amplitudes=tuple(Amplitude(name, "{m}") for name in TENTS),
    basis=on_axis(_spline),
    inner=(LOW, HIGH),
    physical=False,
    shape="spline",
)
SPLINE_COMPLIANCE = TwistLaw(
    name="unnamed_compliance",
    words=Words("unnamed compliance", "it gives with the load, as a column goes", "f(x) · w"),
    places=partial(_with_all, everywhere, KNOTS),
    amplitudes=tuple(Amplitude(name, "{m}/{w}") for name in TENTS),
    basis=on_axis(_spline_compliance),
    inner=(LOW, HIGH),
    loaded=True,
    physical=False,
    shape="spline_compliance",
)
BUMP = TwistLaw(
    name="unnamed_bump",
    words=Words("unnamed bump", "it happens near one value", "height · exp(−(x − centre)² / 2 width²)"),
    places=everywhere,
    amplitudes=(Amplitude("height", "{m}"),),
    basis=on_axis(_bump),
    inner=(
        Inner("centre", "as recorded", _centres, positive=False),
        Inner("width", "as recorded", _widths),
    ),
    physical=False,
    shape="bump",
    sought=True,
)
WAVE = TwistLaw(
    name="unnamed_wave",
    words=Words("unnamed wave", "it goes up and down with a column", "A sin kx + B cos kx"),
    places=partial(_with_all, everywhere, 2),
    amplitudes=(Amplitude("A", "{m}"), Amplitude("B", "{m}")),
    basis=on_axis(_wave),
    inner=(Inner("k", "per recorded", _waves),),
    physical=False,
    shape="wave",
    sought=True,
    possible=_goes_round,
)
LINE = TwistLaw(
    name="unnamed_line",
    words=Words("unnamed trend", "it grows steadily with a column", "slope · x + curvature · x²"),
    places=everywhere,
    amplitudes=(Amplitude("slope", "{m} per recorded"), Amplitude("curvature", "{m} per recorded^2")),
    basis=on_axis(_line),
    inner=(MIDDLE,),
    physical=False,
    shape="line",
)
PRODUCT = TwistLaw(
    name="unnamed_product",
    words=Words("unnamed product", "two columns act together", "f(x) · (1, y)"),
    places=lambda records: [],
    amplitudes=tuple(Amplitude(f"a{i}", "{m}") for i in range(2 * KNOTS + 1)),
    basis=on_axis(_product),
    inner=(LOW, HIGH, MIDDLE),
    physical=False,
    shape="product",
    columns=2,
    sought=True,
)
WAVE_PRODUCT = TwistLaw(
    name="unnamed_wave_product",
    words=Words(
        "unnamed wave product", "a wave in one column grows with another", "(A + C y) sin kx + (B + D y) cos kx"
    ),
    places=lambda records: [],
    amplitudes=tuple(
        Amplitude(name, "{m}" + unit) for name, unit in zip("ABCD", ("", "", *2 * (" per recorded",)), strict=True)
    ),
    basis=on_axis(_wave_product),
    inner=(Inner("k", "per recorded", _waves), MIDDLE),
    physical=False,
    shape="wave_product",
    columns=2,
    sought=True,
    possible=_goes_round,
)

LEVEL = TwistLaw(
    name="unnamed_level",
    words=Words("unnamed level", "it is there while a column has one entry", "a step"),
    places=lambda records: [
        Location(site, axis, (name,)) for site, axis in shaped_places(records) for name in records.levels
    ],
    amplitudes=(Amplitude("step", "{m}"),),
    basis=on_axis(_level),
    physical=False,
    shape="level",
)
