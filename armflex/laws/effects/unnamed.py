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
from armflex.laws.effects.guide import GUIDE
from armflex.laws.effects.law import Amplitude, Inner, TwistLaw, Values
from armflex.laws.effects.scene import AXES, Scene, column_of
from armflex.laws.effects.shapes import along, on_axis
from armflex.laws.effects.spot import BASE, TOOL, Here, Spot

KNOTS = 8
"""Hats of a free shape over the recorded range; the mean is left to the constant parameters."""

LEAST_PERIODS, PERIODS = 0.5, 6.0
"""Fewest and most periods of a wave over a column's recorded range; less of one is a trend."""


def suspects(scene: Scene) -> tuple[str, ...]:
    """Return every column that may be a cause: what was recorded, and every joint's position."""
    return (*scene.recorded, *(f"q_{joint}" for joint in scene.joints))


def hats(values: Array, low: float, high: float, count: int) -> Array:
    """Return (count, ...) piecewise straight functions; the last of all is left out, so they sum to no constant."""
    place = (np.clip(values, low, high) - low) * (count / (high - low if high > low else 1.0))
    knots = np.arange(count, dtype=float).reshape(-1, *(1,) * np.ndim(place))
    return np.maximum(1.0 - np.abs(place - knots), 0.0)


def _spline(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    return hats(column_of(row, here.spot.covariates[0]), *inner, KNOTS)


def _spline_compliance(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    load = along(here, wrench)
    values = np.broadcast_to(column_of(row, here.spot.covariates[0]), np.shape(load))
    return hats(values, *inner, KNOTS) * load


def _bump(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    away = (column_of(row, here.spot.covariates[0]) - inner[0]) / inner[1]
    return (np.exp(-0.5 * away**2) * np.ones(wrench.shape[:-1]),)


def _wave(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    angle = inner[0] * column_of(row, here.spot.covariates[0])
    return np.sin(angle), np.cos(angle)


def _level(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    return (column_of(row, here.spot.covariates[0]) * np.ones(wrench.shape[:-1]),)


def _line(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    away = column_of(row, here.spot.covariates[0]) - inner[0]
    return away * np.ones(wrench.shape[:-1]), away**2 * np.ones(wrench.shape[:-1])


def _product(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    first, second = (column_of(row, name) for name in here.spot.covariates)
    tents = hats(first, inner[0], inner[1], KNOTS)
    return (*tents, *(tent * (second - inner[2]) for tent in [*tents, 1.0 - sum(tents)]))


def _wave_product(here: Here, wrench: Array, row: Row, inner: Values) -> Sequence[Array]:
    first, second = (column_of(row, name) for name in here.spot.covariates)
    sine, cosine = np.sin(inner[0] * first), np.cos(inner[0] * first)
    return [wave * factor for factor in (1.0, second - inner[1]) for wave in (sine, cosine)]


def lowest(spot: Spot, scene: Scene, place: int = 0) -> Iterable[float]:
    """Return the lowest recorded value of one of the spot's columns."""
    return (float(scene.column(spot.covariates[place]).min()),)


def highest(spot: Spot, scene: Scene, place: int = 0) -> Iterable[float]:
    """Return the highest recorded value of one of the spot's columns."""
    return (float(scene.column(spot.covariates[place]).max()),)


def _middle(spot: Spot, scene: Scene) -> Iterable[float]:
    return (float(scene.column(spot.covariates[-1]).mean()),)


def _centres(spot: Spot, scene: Scene) -> Iterable[float]:
    values = scene.column(spot.covariates[0])
    return np.linspace(values.min(), values.max(), 25)


def _widths(spot: Spot, scene: Scene) -> Iterable[float]:
    return float(np.ptp(scene.column(spot.covariates[0]))) * np.array([0.02, 0.05, 0.1])


def _waves(spot: Spot, scene: Scene) -> Iterable[float]:
    span = float(np.ptp(scene.column(spot.covariates[0])))
    return 2.0 * np.pi / span * np.arange(LEAST_PERIODS, PERIODS, 1.0 / 3.0)


LOW = Inner("low", "as recorded", lowest, positive=False, polished=False)
HIGH = Inner("high", "as recorded", highest, positive=False, polished=False)
MIDDLE = Inner("middle", "as recorded", _middle, positive=False, polished=False)
TENTS = tuple(f"a{i}" for i in range(KNOTS))


def shaped_places(scene: Scene) -> list[tuple[str, str]]:
    """Return the sites and axes at which free shapes are tried: the base, every joint and the tool."""
    return [(site, axis) for site in (BASE, *scene.joints, TOOL) for axis in AXES]


def everywhere(scene: Scene) -> list[Spot]:
    """Return every joint, the base and the tool with each axis and each suspect column."""
    return [Spot(site, axis, (name,)) for site, axis in shaped_places(scene) for name in suspects(scene)]


def _with_all(make: Callable[[Scene], list[Spot]], count: int, scene: Scene) -> list[Spot]:
    return [Spot(s.site, s.axis, s.covariates, tuple(range(count))) for s in make(scene)]


SPLINE = TwistLaw(
    "unnamed_shape",
    partial(_with_all, everywhere, KNOTS),
    tuple(Amplitude(name, "{m}") for name in TENTS),
    on_axis(_spline),
    (LOW, HIGH),
)
SPLINE_COMPLIANCE = TwistLaw(
    "unnamed_compliance",
    partial(_with_all, everywhere, KNOTS),
    tuple(Amplitude(name, "{m}/{w}") for name in TENTS),
    on_axis(_spline_compliance),
    (LOW, HIGH),
    loaded=True,
)
BUMP = TwistLaw(
    "unnamed_bump",
    everywhere,
    (Amplitude("height", "{m}"),),
    on_axis(_bump),
    (
        Inner("centre", "as recorded", _centres, positive=False),
        Inner("width", "as recorded", _widths),
    ),
)
WAVE = TwistLaw(
    "unnamed_wave",
    partial(_with_all, everywhere, 2),
    (Amplitude("A", "{m}"), Amplitude("B", "{m}")),
    on_axis(_wave),
    (Inner("k", "per recorded", _waves),),
)
LINE = TwistLaw(
    "unnamed_line",
    everywhere,
    (Amplitude("slope", "{m} per recorded"), Amplitude("curvature", "{m} per recorded^2")),
    on_axis(_line),
    (MIDDLE,),
)
PRODUCT = TwistLaw(
    "unnamed_product",
    lambda scene: [],
    tuple(Amplitude(f"a{i}", "{m}") for i in range(2 * KNOTS + 1)),
    on_axis(_product),
    (LOW, HIGH, MIDDLE),
)
WAVE_PRODUCT = TwistLaw(
    "unnamed_wave_product",
    lambda scene: [],
    tuple(Amplitude(name, "{m}" + unit) for name, unit in zip("ABCD", ("", "", *2 * (" per recorded",)), strict=True)),
    on_axis(_wave_product),
    (Inner("k", "per recorded", _waves), MIDDLE),
)

LEVEL = TwistLaw(
    "unnamed_level",
    lambda scene: [Spot(site, axis, (name,)) for site, axis in shaped_places(scene) for name in scene.levels],
    (Amplitude("step", "{m}"),),
    on_axis(_level),
)

SHAPES = {law.name: law for law in (GUIDE, LEVEL, LINE, WAVE, BUMP, SPLINE, SPLINE_COMPLIANCE, WAVE_PRODUCT, PRODUCT)}
"""Name in files -> shape; the plainer first."""
