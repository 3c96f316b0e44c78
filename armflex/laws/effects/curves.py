"""Laws of many curves over one column: sines of a drive's position, terms of a walk in time.

At work they are one table (`Of.TABLE`), and of each curve the same table as of their sum.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Amplitude, Inner, Search, Solved, TwistLaw, Values
from armflex.laws.effects.location import Here, Location
from armflex.laws.effects.shapes import of_column
from armflex.laws.terms import Term, Terms, table, through

FINE = 8
"""Tolerance: knots of a table for each half-wave of the finest curve: it errs by a thousandth of that."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CurvesLaw(TwistLaw):
    """A law of many curves over the column of its location, all along one direction; see `curves`.

    Attributes:
        knots: (terms) -> (k, K) values of the acting curves at knots spread evenly between both inner values.
    """

    knots: Callable[[tuple[int, ...]], Array]

    def shapes(self, location: Location, inner: Values, view: Solved, context: Context) -> Array:
        knots, (low, high) = self.knots(location.terms), inner
        x = (context.row_at(view).column(location.covariates[0]) - low) / ((high - low) / (knots.shape[1] - 1))
        shapes = np.zeros((len(self.amplitudes), len(x)))
        shapes[list(location.terms)] = through(knots, x)
        return shapes


def curves(
    direction: Callable[[Here, Values], Array],
    knots: Callable[[tuple[int, ...]], Array],
    most: int,
    inner: tuple[str, str, str],
    **more: Any,
) -> CurvesLaw:
    """Return a law of so many curves at most.

    Args:
        direction: Of every twist.
        knots: As of `CurvesLaw`.
        most: How many they are.
        inner: Names of the column's values at the first and the last knot, and their unit.
        more: What else an effect's law says.
    """

    def curve(here: Here, inner: Values, values: Array) -> list[Term]:
        low, high = inner
        factor = table(here.location.covariates[0], low, (high - low) / (len(values) - 1), values.tolist())
        return [Term(direction(here, inner), factors=(factor,))]

    def terms(here: Here, inner: Values) -> list[list[Term]]:
        each, acting = [list[Term]() for _ in range(most)], here.location.terms
        for i, values in zip(acting, knots(acting), strict=True):
            each[i] = curve(here, inner, values)
        return each

    def joined(here: Here, amplitudes: Sequence[float], inner: Values) -> Terms:
        acting = here.location.terms
        return curve(here, inner, np.array([amplitudes[i] for i in acting]) @ knots(acting))

    first, last, unit = inner
    return CurvesLaw(
        amplitudes=tuple(Amplitude(f"s{i + 1}", "{m}") for i in range(most)),
        inner=(
            Inner(first, unit, of_column(lambda x: (float(x.min()),)), positive=False, polished=False),
            Inner(last, unit, of_column(lambda x: (float(x.max()),)), positive=False, polished=False),
        ),
        direction=direction,
        knots=knots,
        terms=terms,
        joined=joined,
        search=Search.NOWHERE,
        **more,
    )
