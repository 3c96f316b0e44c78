"""Laws as sums of terms: the form in which the engine and exported C know every law.

    twist = sum over terms of (matrix @ w + along) * product of features(w) * product of factors(row)

A feature is a number made of the load w, a factor one made of a column of the row: of a joint law only `q_JOINT`, of an
effect any column. Scaling a law, or moving it to another frame, gives a sum of terms again. A small network is one term
of many neurons, `gains.T @ tanh(units @ w + bias)`. A law that says its terms needs nothing else: its twist and its
tangent follow, and the engine knows it. `Curve` and `Of` stand in engine.c as well: change both or none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from armflex.conventions import Array
from armflex.errors import UnsupportedError
from armflex.laws.row import Row

if TYPE_CHECKING:
    from typing import Protocol

    class Window(Protocol):
        """Loads under which a term counts; see `learned.seen.Seen`."""

        mean: Array
        precision: Array
        energy: Array | None
        faded: float


UNITS = np.eye(6)
NOTHING = np.zeros(6)
UNLOADED = np.zeros((6, 6))
UNITS.flags.writeable = NOTHING.flags.writeable = UNLOADED.flags.writeable = False

LEAST = 1e-300
"""What a number that is raised to a power is at least."""

MOST_FACTORS = 2
"""Columns that one term may depend on."""


class Curve(IntEnum):
    """What a feature makes of a load w; engine.c has the same."""

    PART = 0
    """u . w"""
    SIZE = 1
    """|u . w|"""
    CLIPPED = 2
    """u . w, at most 1 in size: play that the load takes up."""
    TANH = 3
    """tanh(u . w + bias)"""
    RAISED = 4
    """(bias + w' form w)^exponent"""
    RAMP = 5
    """u . w + bias, or 0 where that is below: a stop on one side."""


class Of(IntEnum):
    """What a factor makes of a column x; `a` to `d` are its numbers; engine.c has the same."""

    ONE = 0
    POWER = 1
    """((x - a) / b)^c"""
    SINE = 2
    """sin(a x)"""
    COSINE = 3
    STEP = 4
    """1 from a on"""
    BUMP = 5
    """exp(-((x - a) / b)^2 / 2)"""
    TENT = 6
    """1 at knot d, 0 at the knots beside it; knots are c apart from a on, and b is the last."""
    CREEP = 7
    """log(1 + x / a), x at least 0"""
    OVERLAP = 8
    """1 / (a + |x - b|)"""
    CHEBYSHEV = 9
    """Polynomial of degree c in a travel with the middle a and the half b."""
    TABLE = 10
    """A smooth curve through values at knots that are b apart from a on; where c is not 0 the first follows the last.

    The numbers behind c are the values. Between two knots it is the cubic with the slopes (v[k + 1] - v[k - 1]) / 2 b
    (Catmull and Rom 1974), so it and its slope are continuous, and it is a sum of its values times curves that depend
    on x alone. Where it does not close the slopes at the ends are those of the parabola through three knots, and beyond
    them it stays at the last value.
    """


@dataclass(frozen=True)
class Feature:
    """A number made of a (..., 6) load; see `Curve`.

    Attributes:
        kind: Which.
        u: (6,) of a part of the load, as a tuple: features are compared and hashed.
        bias, exponent: Numbers of some kinds.
        form: (36,) of a quadratic form of it, rows behind one another; empty where none counts.
    """

    kind: Curve
    u: tuple[float, ...] = (0.0,) * 6
    bias: float = 0.0
    exponent: float = 1.0
    form: tuple[float, ...] = ()

    @cached_property
    def way(self) -> Array:
        """(6,) u."""
        return np.array(self.u)

    @cached_property
    def matrix(self) -> Array:
        """(6, 6) form."""
        return np.array(self.form).reshape(6, 6)

    @property
    def degree(self) -> float:
        """Power of the load's size with which it grows in the end."""
        if self.kind is Curve.RAISED:
            return 2.0 * self.exponent
        return 1.0 if self.kind in (Curve.PART, Curve.SIZE, Curve.RAMP) else 0.0

    def of(self, load: Array) -> Array:
        """Return the (...,) number."""
        if self.kind is Curve.PART:
            return load @ self.way
        return self.with_slope(load)[0]

    def with_slope(self, load: Array) -> tuple[Array, Array]:
        """Return the (...,) number and its (..., 6) derivative by the load, 0 at a corner."""
        if self.kind is Curve.RAISED:
            moved = load @ (form := self.matrix)
            base = np.maximum(self.bias + (moved * load).sum(axis=-1), LEAST)
            slope = np.where(base > LEAST, self.exponent, 0.0) * base ** (self.exponent - 1.0)
            return base**self.exponent, slope[..., None] * (moved + load @ form.T)
        part = load @ self.way
        if self.kind is Curve.TANH:
            value = np.tanh(part + self.bias)
            slope = 1.0 - value**2
        elif self.kind is Curve.SIZE:
            value, slope = np.abs(part), np.sign(part)
        elif self.kind is Curve.RAMP:
            value, slope = np.maximum(part + self.bias, 0.0), (part + self.bias > 0.0).astype(float)
        elif self.kind is Curve.CLIPPED:
            value, slope = np.clip(part, -1.0, 1.0), (np.abs(part) < 1.0).astype(float)
        else:
            value, slope = part, np.ones_like(part)
        return value, slope[..., None] * self.way

    def carried(self, action: Array) -> Feature:
        """Return the feature of the load `action.T @ w`."""
        form = tuple((action @ self.matrix @ action.T).ravel().tolist()) if self.form else ()
        return replace(self, u=tuple((action @ self.way).tolist()), form=form)


def part(way: Array, kind: Curve = Curve.PART, bias: float = 0.0) -> Feature:
    """Return a feature of the part (6,) u . w of the load."""
    return Feature(kind, tuple(np.asarray(way, dtype=float).tolist()), bias)


def power(form: Array, exponent: float, bias: float = 0.0) -> Feature:
    """Return the feature (bias + w' form w)^exponent of a (6, 6) form."""
    return Feature(
        Curve.RAISED, bias=bias, exponent=exponent, form=tuple(np.asarray(form, dtype=float).ravel().tolist())
    )


@dataclass(frozen=True)
class Factor:
    """A function of a column; see `Of`."""

    kind: Of
    column: str
    numbers: tuple[float, ...]

    def at(self, row: Row) -> Array:
        """Return its (...,) value; raise `MissingCovariateError` where the row lacks the column."""
        return self.of(np.asarray(row.column(self.column), dtype=float))

    def of(self, x: Array) -> Array:
        """Return its (...,) value for (...,) numbers of the column."""
        if self.kind is Of.TABLE:
            low, step, closed, *values = self.numbers
            return through(np.array(values), (x - low) / step, bool(closed))
        return FUNCTIONS[self.kind](x, *(*self.numbers, 0.0, 0.0, 0.0, 0.0)[:4])

    def in_c(self, knots: list[float]) -> tuple[float, float, float, float]:
        """Return `a` to `d` as C has them: a table's values are put behind the knots, c is its first of these.

        Its d is how many there are, below 0 where they close.
        """
        a, b, c, d = (*self.numbers, 0.0, 0.0, 0.0, 0.0)[:4]
        if self.kind is not Of.TABLE:
            return a, b, c, d
        values, first = self.numbers[3:], float(len(knots))
        knots.extend(values)
        return a, b, first, -float(len(values)) if c else float(len(values))

    def later(self, by: float) -> list[tuple[float, Factor]]:
        """Return shares of factors whose sum at x is this factor at x + by."""
        numbers = list(self.numbers)
        match self.kind:
            case Of.SINE | Of.COSINE:
                angle, sign = numbers[0] * by, 1.0 if self.kind is Of.SINE else -1.0
                other = Of.COSINE if self.kind is Of.SINE else Of.SINE
                return [(float(np.cos(angle)), self), (sign * float(np.sin(angle)), replace(self, kind=other))]
            case Of.CREEP:
                raise UnsupportedError("creep depends on how long a load has stood, which no other clock changes")
            case Of.OVERLAP:
                moved = (1,)
            case _:
                moved = (0, 1) if self.kind is Of.TENT else (0,)
        shifted = tuple(x - by if i in moved else x for i, x in enumerate(numbers))
        return [(1.0, replace(self, numbers=shifted))]


def through(values: Array, x: Array, closes: bool = False) -> Array:
    """Return (..., M) curves through (..., K) values at 0, 1, ... at (M,) places; see `Of.TABLE`."""
    n, last = values.shape[-1], values.shape[-1] - (1 if closes else 2)
    x = x % n if closes else np.clip(x, 0.0, n - 1.0)
    k = np.minimum(np.nan_to_num(x).astype(int), last)
    if closes:
        knots = values[..., np.arange(-1, n + 2) % n]
    else:
        # Of two knots the parabola is a line.
        ends = [
            3.0 * (side[..., :1] - side[..., 1:2]) + side[..., 2:3] if n > 2 else 2.0 * side[..., :1] - side[..., 1:2]
            for side in (values, values[..., ::-1])
        ]
        knots = np.concatenate([ends[0], values, ends[1]], axis=-1)
    before, left, right, after = (knots[..., k + i] for i in range(4))
    t = x - k
    square, cube = 2.0 * before - 5.0 * left + 4.0 * right - after, 3.0 * (left - right) + after - before
    return left + 0.5 * t * (right - before + t * (square + t * cube))


FUNCTIONS: Mapping[Of, Callable[[Array, float, float, float, float], Array]] = {
    Of.ONE: lambda x, a, b, c, d: np.ones_like(x),
    Of.POWER: lambda x, a, b, c, d: ((x - a) / b) ** int(c),
    Of.SINE: lambda x, a, b, c, d: np.sin(a * x),
    Of.COSINE: lambda x, a, b, c, d: np.cos(a * x),
    Of.STEP: lambda x, a, b, c, d: np.where(x >= a, 1.0, 0.0),
    Of.BUMP: lambda x, a, b, c, d: np.exp(-0.5 * ((x - a) / b) ** 2),
    Of.TENT: lambda x, a, b, c, d: np.maximum(1.0 - np.abs((np.minimum(np.maximum(x, a), b) - a) / c - d), 0.0),
    Of.CREEP: lambda x, a, b, c, d: np.log1p(np.maximum(x, 0.0) / a),
    Of.OVERLAP: lambda x, a, b, c, d: 1.0 / (a + np.abs(x - b)),
    Of.CHEBYSHEV: lambda x, a, b, c, d: np.polynomial.chebyshev.chebval((x - a) / b, np.eye(int(c) + 1)[-1]),
}
"""Kind of factor -> its value by column and numbers, but that of a table."""


def table(column: str, low: float, apart: float, values: Sequence[float], closes: bool = False) -> Factor:
    """Return the curve through values at knots of a column, in its unit; see `Of.TABLE`.

    Args:
        column: Its name.
        low: The first knot.
        apart: Distance of two knots.
        values: Two at least, three where the curve closes.
        closes: Whether the first knot follows the last, `apart` behind it.
    """
    if len(values) < (3 if closes else 2) or not apart > 0.0:
        raise UnsupportedError("a curve has two knots or more, three where it closes, some way apart")
    return Factor(Of.TABLE, column, (low, apart, float(closes), *map(float, values)))


def powers(column: str, exponent: int, above: float = 0.0) -> tuple[Factor, ...]:
    """Return the factor (column - above)^exponent, none where that is 1."""
    return (Factor(Of.POWER, column, (above, 1.0, float(exponent))),) if exponent else ()


def waves(column: str, number: float) -> tuple[Factor, Factor]:
    """Return the sine and the cosine of a column times a wave number."""
    return Factor(Of.SINE, column, (number,)), Factor(Of.COSINE, column, (number,))


def tents(column: str, low: float, high: float, count: int) -> list[Factor]:
    """Return the `count + 1` hats over knots spread evenly from `low` to `high`; they sum to one."""
    apart = (high - low if high > low else 1.0) / count
    return [Factor(Of.TENT, column, (low, high, apart, float(i))) for i in range(count + 1)]


@dataclass(frozen=True, eq=False)
class Term:
    """A part of a law; see the head of this module.

    Attributes:
        along: (6,) twist [m, rad], the flexure's axes.
        matrix: (6, 6) times the load, None for none.
        features: Of the load, multiplied.
        factors: Of columns, multiplied; `MOST_FACTORS` at most.
        window: Loads under which a learned correction counts, None where all do.
    """

    along: Array
    matrix: Array | None = None
    features: tuple[Feature, ...] = field(default=(), kw_only=True)
    factors: tuple[Factor, ...] = field(default=(), kw_only=True)
    window: Window | None = field(default=None, kw_only=True)

    @property
    def linear(self) -> bool:
        """Whether it is affine in the load: no feature, no window."""
        return not self.features and self.window is None

    @property
    def loaded(self) -> bool:
        """Whether it depends on the load."""
        return self.matrix is not None or not self.linear

    @property
    def degree(self) -> float:
        """Power of the load's size with which it grows in the end."""
        return (self.matrix is not None) + sum(feature.degree for feature in self.features)

    def times(self, number: float | Array, *factors: Factor) -> Term:
        """Return the term with its twist multiplied, by one number or (6,) of them, and further factors."""
        matrix = None if self.matrix is None else np.reshape(number, (-1, 1)) * self.matrix
        return replace(self, along=self.along * number, matrix=matrix, factors=_with(self.factors, factors))

    def carried(self, action: Array) -> Term:
        """Return the term of the law `action @ law(action.T @ w)`."""
        matrix = None if self.matrix is None else action @ self.matrix @ action.T
        features = tuple(feature.carried(action) for feature in self.features)
        window = _carried(self.window, action)
        return Term(action @ self.along, matrix, features=features, factors=self.factors, window=window)

    def single(self) -> Iterator[Term]:
        """Yield it: it has no neurons."""
        yield self

    def twist(self, load: Array) -> Array:
        """Return the (..., 6) twist under (..., 6) loads but for its factors."""
        value = self.along if self.matrix is None else self.along + load @ self.matrix.T
        for feature in self.features:
            value = feature.of(load)[..., None] * value
        return np.broadcast_to(value, load.shape)

    def tangent(self, load: Array) -> Array:
        """Return the (..., 6, 6) derivative by the load but for its factors."""
        value = self.along if self.matrix is None else self.along + load @ self.matrix.T
        slope = np.zeros((*load.shape, 6)) if self.matrix is None else np.broadcast_to(self.matrix, (*load.shape, 6))
        for feature in self.features:
            number, by_load = feature.with_slope(load)
            slope = number[..., None, None] * slope + value[..., :, None] * by_load[..., None, :]
            value = number[..., None] * value
        return slope


@dataclass(frozen=True, eq=False)
class Neurons:
    """A network's hidden layer: `gains.T @ tanh(units @ w + bias)`, loads and twists in SI.

    Attributes:
        units: (H, 6).
        bias: (H,).
        gains: (H, 6).
        factors, window: As of a `Term`.
    """

    units: Array
    bias: Array
    gains: Array
    factors: tuple[Factor, ...] = ()
    window: Window | None = None

    linear, loaded = False, True

    def times(self, number: float | Array, *factors: Factor) -> Neurons:
        """Return the same with its twist multiplied, and further factors."""
        return replace(self, gains=self.gains * number, factors=_with(self.factors, factors))

    def carried(self, action: Array) -> Neurons:
        """Return the neurons of the law `action @ law(action.T @ w)`."""
        units, gains = self.units @ action.T, self.gains @ action.T
        return Neurons(units, self.bias, gains, self.factors, _carried(self.window, action))

    def twist(self, load: Array) -> Array:
        """Return the (..., 6) twist under (..., 6) loads but for its factors."""
        return self._in_parts(lambda curves: curves @ self.gains, load)

    def tangent(self, load: Array) -> Array:
        """Return the (..., 6, 6) derivative by the load but for its factors."""
        each, total = self._slopes
        return self._in_parts(lambda curves: total - np.square(curves) @ each, load).reshape(*load.shape, 6)

    @cached_property
    def _slopes(self) -> tuple[Array, Array]:
        """(H, 36) slope that each neuron gives where it is steepest, and its sum over all [m/N, rad/Nm and mixed]."""
        each = (self.gains[:, :, None] * self.units[:, None, :]).reshape(-1, 36)
        return each, each.sum(axis=0)

    def _in_parts(self, ask: Callable[[Array], Array], load: Array) -> Array:
        """Return what is asked of the (..., H) curves under (..., 6) loads."""
        rows = max(2**17 // len(self.bias), 1)  # whose curves a core's own cache takes
        if load.ndim == 1 or load.size <= 6 * rows:
            return ask(np.tanh(load @ self.units.T + self.bias))
        flat = load.reshape(-1, 6)
        parts = [self._in_parts(ask, flat[start : start + rows]) for start in range(0, len(flat), rows)]
        return np.concatenate(parts).reshape(*load.shape[:-1], -1)

    def single(self) -> Iterator[Term]:
        """Yield every neuron as a term of its own."""
        for unit, bias, gain in zip(self.units, self.bias.tolist(), self.gains, strict=True):
            yield Term(gain, features=(part(unit, Curve.TANH, bias),), factors=self.factors, window=self.window)


Terms = Sequence[Term | Neurons]
OneTerm = TypeVar("OneTerm", Term, Neurons)


def straight(compliance: Array, *factors: Factor) -> Term:
    """Return the term of a (6, 6) compliance."""
    return Term(np.zeros(6), compliance, factors=factors)


def weight_of(factors: Sequence[Factor], row: Row) -> Array | float:
    """Return the (...,) product of factors in a row, 1 of none."""
    value: Array | float = 1.0
    for number, factor in enumerate(factors):
        value = value * factor.at(row) if number else factor.at(row)
    return value


Weight = Callable[[Sequence[Factor], Row], Array | float]


def twist_of(terms: Terms, load: Array, row: Row, weight: Weight = weight_of) -> Array:
    """Return the (..., 6) twist of terms without windows under (..., 6) loads."""
    total = NOTHING
    for term in terms:
        part = term.twist(load)
        part = np.asarray(weight(term.factors, row))[..., None] * part if term.factors else part
        total = part if total is NOTHING else total + part
    return np.broadcast_to(total, load.shape) if total is NOTHING else total


def twists_of(each: Sequence[Terms], load: Array, row: Row, onto: Array = UNITS) -> Array:
    """Return the (k, ..., r) twists of k sums of terms without windows under (..., 6) loads, on (r, 6) ways."""
    terms = [term for group in each for term in group]
    terms_twists = np.empty((len(terms), *load.shape[:-1], len(onto)))
    for part, term in zip(terms_twists, terms, strict=True):
        assert isinstance(term, Term)  # neurons are those of a joint's law alone
        part[...] = onto @ term.along
        if term.matrix is not None:
            part += load @ (onto @ term.matrix).T
        for feature in term.features:
            part *= feature.of(load)[..., None]
        if term.factors:
            part *= np.asarray(weight_of(term.factors, row))[..., None]
    if len(terms) == len(each):
        return terms_twists
    ends = np.cumsum([len(group) for group in each])[:-1]
    return np.array([part.sum(axis=0) for part in np.split(terms_twists, ends)])


def tangent_of(terms: Terms, load: Array, row: Row, weight: Weight = weight_of) -> Array:
    """Return its (..., 6, 6) derivative by the load."""
    total = np.zeros((*load.shape, 6))
    for term in terms:
        total = total + np.asarray(weight(term.factors, row))[..., None, None] * term.tangent(load)
    return total


def affine_of(terms: Terms, row: Row, weight: Weight = weight_of) -> tuple[Array, Array] | None:
    """Return their (..., 6) twist without load and their (..., 6, 6) compliance, None where one is curved."""
    twist, compliance = NOTHING, UNLOADED
    for term in terms:
        if not isinstance(term, Term) or not term.linear:
            return None
        share = np.asarray(weight(term.factors, row))[..., None]
        twist = twist + share * term.along if term.along.any() else twist
        compliance = compliance if term.matrix is None else compliance + share[..., None] * term.matrix
    return twist, compliance


def _with(factors: tuple[Factor, ...], more: tuple[Factor, ...]) -> tuple[Factor, ...]:
    if len(factors) + len(more) > MOST_FACTORS:
        raise UnsupportedError(f"depends on more than {MOST_FACTORS} columns at once")
    return factors + more


def _carried(window: Window | None, action: Array) -> Window | None:
    if window is None:
        return None
    energy = None if window.energy is None else action @ window.energy @ action.T
    mean, precision = np.linalg.solve(action.T, window.mean), action @ window.precision @ action.T
    return replace(window, mean=mean, precision=precision, energy=energy)  # pyright: ignore[reportArgumentType]
