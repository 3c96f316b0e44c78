"""The laws of all flexures as one map from loads to twists, and as the numbers that the engine works with."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.laws import Law, Row
from armflex.laws.law import NOWHERE
from armflex.laws.terms import MOST_FACTORS, NOTHING, UNLOADED, Factor, Neurons, Term
from armflex.mechanics.engine.tables import Factors, Laws


@dataclass(frozen=True)
class LawStack:
    """The laws of all flexures as one map from (..., 6 n) wrenches to (..., 6 n) twists."""

    names: tuple[str, ...]
    laws: tuple[Law, ...]

    @cached_property
    def places(self) -> tuple[tuple[str, slice, Law], ...]:
        """Names, places among the twists and laws of the flexures."""
        named = enumerate(zip(self.names, self.laws, strict=True))
        return tuple((name, slice(6 * i, 6 * i + 6), law) for i, (name, law) in named)

    @cached_property
    def parts(self) -> tuple[tuple[int, Law], ...]:
        """Every flexure's laws that add up, each with the number of its flexure."""
        return tuple((i, part) for i, law in enumerate(self.laws) for part in law.parts)

    def twists(self, wrenches: Array, row: Row) -> Array:
        """Return the (..., 6 n) twists [m, rad] under (..., 6 n) wrenches [N, Nm]."""
        twists = np.empty_like(wrenches)
        for _, place, law in self.places:
            twists[..., place] = law.twist(wrenches[..., place], row)
        return twists

    def tangent(self, wrenches: Array, row: Row) -> Array:
        """Return the (..., 6 n, 6 n) block-diagonal derivative of the twists [m/N, rad/Nm]."""
        total = np.zeros((*wrenches.shape, wrenches.shape[-1]))
        for _, place, law in self.places:
            total[..., place, place] = law.tangent(wrenches[..., place], row)
        return total

    def change_with_position(self, wrenches: Array, row: Row) -> Array:
        """Return the (..., 6 n, nq) derivative of the twists [m, rad] by the joint positions at given loads."""
        change = np.zeros((*wrenches.shape, row.q.shape[-1]))
        if self.rows_differ:
            for i, step in enumerate(1e-4 * np.eye(row.q.shape[-1])):
                ends = [self.twists(wrenches, replace(row, q=row.q + side * step)) for side in (1.0, -1.0)]
                change[..., i] = (ends[0] - ends[1]) / 2e-4
        return change

    def covariance(self, wrenches: Array, row: Row) -> Array | None:
        """Return the (6 n, 6 n) covariance of the twists [m, rad] at given loads, None when no law carries one."""
        total, known = np.zeros((len(wrenches),) * 2), False
        for _, place, law in self.places:
            part = law.covariance(wrenches[place], row)
            if part is not None:
                total[place, place], known = part, True
        return total if known else None

    @cached_property
    def trained(self) -> tuple[tuple[str, slice, Law], ...]:
        """`places` of the flexures whose law was trained."""
        return tuple(place for place in self.places if place[2].trained)

    def flags(self, wrenches: Array, row: Row) -> tuple[Flag, ...]:
        """Return where (6 n,) wrenches [N, Nm] are beyond what a law was trained on."""
        asked = [(name, law.flags(wrenches[place], row)) for name, place, law in self.trained]
        return tuple(replace(f, text=f"flexure {name!r}: {f.text}", about=name) for name, flags in asked for f in flags)

    @cached_property
    def constant(self) -> bool:
        """Whether the tangents are the same under every load and in every row."""
        return all(law.constant is not None for _, law in self.parts)

    @cached_property
    def asked(self) -> tuple[tuple[int, Law], ...]:
        """The parts that must be asked in every row: neither constant nor known by their terms."""
        return tuple((i, law) for i, law in self.parts if law.constant is None and not _is_known(law))

    @cached_property
    def bent(self) -> tuple[tuple[int, Law, Term], ...]:
        """The terms that are curved in the load, with the numbers of their flexures, in order, and their laws."""
        return tuple((i, law, term) for i, law, one in self._known if not one.linear for term in _singly(one))

    @cached_property
    def by_row(self) -> tuple[tuple[int, Law, Term], ...]:
        """The terms that are affine in the load and depend on a column, likewise."""
        return tuple(
            (i, law, one) for i, law, one in self._known if isinstance(one, Term) and one.linear and one.factors
        )

    @cached_property
    def rows_differ(self) -> bool:
        """Whether anything depends on positions or covariates."""
        return bool(self.asked or self.by_row or any(term.factors for _, _, term in self.bent))

    def factors(self, columns: Mapping[str, int]) -> Factors | None:
        """Return what changes with columns, for the engine to ask; None where a law must be asked itself.

        Args:
            columns: Numbers of the columns that are there for every arm, by name: joints, and then the payload's mass.
        """
        if any(law.known_terms is None for _, law in self.asked):
            return None
        rows, names, number = [(0.0,) * 6], [], {}
        knots: list[float] = []
        weighed = [(i, law, one) for i, law in self.asked for one in law.known_terms or ()] + list(self.by_row)

        def place(factor: Factor) -> int:
            if factor not in number:
                column = columns.get(factor.column)
                if column is None:
                    names.extend(() if factor.column in names else (factor.column,))
                    column = len(columns) + names.index(factor.column)
                number[factor] = len(rows)
                rows.append((float(factor.kind), float(column), *factor.in_c(knots)))
            return number[factor]

        def both(term: Term) -> list[int]:
            return [*map(place, term.factors), 0, 0][:MOST_FACTORS]

        change = np.array(
            [
                (i, *both(one), *one.along, *(UNLOADED if one.matrix is None else one.matrix).ravel())
                for i, _, one in weighed
                if isinstance(one, Term)
            ]
        ).reshape(-1, 45)
        weighing = np.array([both(term) for _, _, term in self.bent], dtype=np.int64).reshape(-1, MOST_FACTORS)
        varies = np.zeros(len(self.laws), dtype=np.int64)
        varies[change[:, 0].astype(int)] = 1
        return Factors(np.array(rows), np.array(knots, dtype=float), change, weighing, varies, tuple(names))

    @cached_property
    def _known(self) -> tuple[tuple[int, Law, Term | Neurons], ...]:
        parts = sorted((i, number) for number, (i, law) in enumerate(self.parts) if law.constant is None)
        known = ((i, self.parts[number][1]) for i, number in parts)
        return tuple((i, law, term) for i, law in known if _is_known(law) for term in law.known_terms or ())

    @cached_property
    def numbers(self) -> Laws:
        """The numbers of what is the same everywhere; see `Laws`."""
        n, neurons, starts = len(self.laws), [np.zeros((0, 13, 4))], np.zeros(len(self.laws) + 1, dtype=np.int64)
        compliance, offset = np.zeros((1, n, 6, 6)), np.zeros((1, n, 6))
        for i, law in self.parts:
            if law.constant is not None:
                compliance[0, i] += law.constant
        for i, _, one in self._known:
            if isinstance(one, Neurons) and not one.factors and one.window is None:
                blocks = np.zeros((-(-len(one.bias) // 4) * 4, 13))
                blocks[: len(one.bias)] = np.column_stack([one.units, one.bias, one.gains])
                neurons.append(blocks.reshape(-1, 4, 13).swapaxes(1, 2))
                starts[i + 1 :] += len(neurons[-1])
            elif isinstance(one, Term) and one.linear and not one.factors:
                offset[0, i] += one.along
                if one.matrix is not None:
                    compliance[0, i] += one.matrix
        terms = [term for _, _, term in self.bent]
        bent, shapes = np.zeros((len(terms), 43)), np.zeros((sum(len(term.features) for term in terms), 45))
        for row, term in zip(bent, terms, strict=True):
            row[36:42] = term.along
            if term.matrix is not None:
                row[:36], row[42] = term.matrix.ravel(), 1.0
        for row, feature in zip(shapes, (feature for term in terms for feature in term.features), strict=True):
            row[:9] = (feature.kind, feature.bias, feature.exponent, *feature.u)
            if feature.form:
                row[9:] = feature.form
        spans = np.searchsorted([i for i, _, _ in self.bent], np.arange(n + 1)).astype(np.int64)
        pieces = np.cumsum([0, *(len(term.features) for term in terms)], dtype=np.int64)
        return Laws(
            compliance, offset, np.concatenate(neurons), starts, bent, shapes, spans, pieces, np.ones((1, len(terms)))
        )


def _is_known(law: Law) -> bool:
    """Return whether a law is one of terms, some of them curved, which count under every load."""
    return any(not one.linear for one in law.known_terms or ())


def _singly(one: Term | Neurons) -> Iterable[Term]:
    """Return a term, and every neuron of those that depend on a column; others are known together."""
    if isinstance(one, Term):
        return (one,)
    return one.single() if one.factors or one.window is not None else ()


class RowLaws:
    """The laws of a stack at N rows, or at one, as numbers.

    What is affine at the rows' positions and covariates is looked up once for all of them, terms stand as they are, and
    every other law as its affine expansion about some loads: see `expand`.

    Attributes:
        compliance, offset: (R, n, 6, 6) and (R, n, 6) of what is affine or expanded, R being 1 or N.
        weights: (R, T) of the terms; see `Laws`.
        curved: Laws that must be expanded, with the numbers of their flexures.
        bent: Whether tangents depend on loads all the same.
    """

    def __init__(self, stack: LawStack, row: Row | None = None) -> None:
        self._stack, self._row = stack, NOWHERE if row is None else row  # laws that are the same everywhere need none
        self._same = stack.numbers
        self.bent = len(self._same.neurons) > 0 or bool(stack.bent)
        self.compliance, self.offset = self._same.compliance.copy(), self._same.offset.copy()
        self.weights = self._same.weights.copy()
        self.curved: list[tuple[int, Law]] = []
        self._known: dict[int, Array] = {}
        self._numbers: Laws | None = None
        if row is not None and stack.rows_differ:
            self.know(row)

    def know(self, row: Row) -> None:
        """Ask the laws in other rows; the arrays are filled anew, and are others only for another number of rows."""
        affine, self.curved, self._known, self._numbers = [], [], {}, None
        for i, law in self._stack.asked:
            found = law.affine(row)
            if found is None:
                self.curved.append((i, law))
            else:
                affine.append((i, *found))
                self._known[id(law)] = found[1]
        for i, law, term in self._stack.by_row:
            weight = np.asarray(law.weight(term.factors, row))[..., None]
            affine.append(
                (i, weight * term.along, UNLOADED if term.matrix is None else weight[..., None] * term.matrix)
            )
        weights = [law.weight(term.factors, row) for _, law, term in self._stack.bent]
        self._row, self._slopes, same = row, [], self._same
        single = row.q.ndim == 1
        many = not single and (self.curved or any(part[1].ndim > 1 or part[2].ndim > 2 for part in affine))
        count = len(row.q) if many else 1
        self.compliance = _renewed(self.compliance, same.compliance, count)
        self.offset = _renewed(self.offset, same.offset, count)
        for i, twist, softer in affine:
            if twist is not NOTHING:
                own = self.offset[:, i]
                own += twist
            if softer is not UNLOADED:
                own = self.compliance[:, i]  # a view, so that nothing is written twice
                own += softer
        if weights:
            self.weights = _renewed(self.weights, same.weights, max(1, *(np.size(one) for one in weights)))
            for t, weight in enumerate(weights):
                self.weights[:, t] = weight
        self._affine = (self.compliance.copy(), self.offset.copy()) if self.curved and not single else None

    @property
    def numbers(self) -> Laws:
        """What the engine takes: the same until the laws are asked in other rows."""
        if self._numbers is None:
            parts = {"compliance": self.compliance, "offset": self.offset, "weights": self.weights}
            self._numbers = self._same._replace(**parts)
        return self._numbers

    def expand(self, loads: Array, slopes: bool = True) -> Array:
        """Expand the curved laws about (N, n, 6) loads; return (N,) by how much their twists there were otherwise.

        Between two expansions the equilibrium is solved exactly, so that this is Newton's method on the laws alone;
        without `slopes` their tangents stay those of the last expansion (the chord method), which are dear to ask for.
        """
        before = np.einsum("nkij,nkj->nki", self.compliance, loads) + self.offset
        assert self._affine is not None  # in many rows; in one nothing is expanded
        np.copyto(self.offset, self._affine[1])
        if slopes:
            np.copyto(self.compliance, self._affine[0])
            self._slopes = [law.tangent(loads[:, i], self._row) for i, law in self.curved]
        for (i, law), tangent in zip(self.curved, self._slopes, strict=True):
            if slopes:
                self.compliance[:, i] += tangent
            self.offset[:, i] += law.twist(loads[:, i], self._row) - (tangent @ loads[:, i, :, None])[..., 0]
        after = np.einsum("nkij,nkj->nki", self.compliance, loads) + self.offset
        return np.sqrt(((after - before) ** 2).sum(axis=(1, 2)))

    def tangent(self, law: Law, loads: Array) -> Array:
        """Return the (N, 6, 6) tangent of one of the laws under (N, 6) loads."""
        known = self._known.get(id(law))
        return law.tangent(loads, self._row) if known is None else known


def _renewed(array: Array, same: Array, count: int) -> Array:
    """Return the array, or one of `count` rows where it has another number, filled with the one row of `same`."""
    if len(array) != count:
        return np.repeat(same, count, axis=0)
    np.copyto(array, same)
    return array
