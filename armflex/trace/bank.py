"""The bank of candidates: what the readings would change by with each of them, as whitened columns at one fit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.estimate.fit import Fit
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Values
from armflex.progress import SILENT, Reporter

MADE_AT_ONCE = 2**22
"""Tolerance: numbers of a bank's columns that are made at a time."""

BANK_HELD = 2**26
"""Tolerance: numbers up to which a bank keeps its columns as they are. Of up to twice as many it keeps 24 bits: models
have columns of their own. More are made again whenever they are asked for."""


@dataclass(frozen=True, eq=False)
class ColumnPart:
    """Some columns of a bank: each one number a row, times the same answer of the readings.

    Attributes:
        groups: (g,) which candidates, in this order.
        places: (K,) which columns of the bank.
        shapes: (U, R) numbers, the same array for parts at several sites where no load is in them.
        of: (K,) which of those each column has.
        answer: (R, d) whitened and weighted change of the readings per unit; None where rows are single readings and
            it is 1.
    """

    groups: np.ndarray
    places: np.ndarray
    shapes: Array
    of: np.ndarray
    answer: Array | None

    def products(self, others: Any) -> Array:
        """Return the (K, F) products of the columns with (n, F) others, or with what they are as sparse (F, n) rows."""
        if isinstance(others, np.ndarray):
            if self.answer is not None:
                others = np.einsum("rd,rdf->rf", self.answer, others.reshape(*self.answer.shape, -1))
            return (self.shapes @ others)[self.of]
        if self.answer is not None:
            count, depth = self.answer.shape
            answered = others.data * self.answer.ravel()[others.indices], others.indices // depth, others.indptr
            others = type(others)(answered, shape=(others.shape[0], count))
        return (others @ self.shapes.T).T[self.of]

    def squares(self, some: np.ndarray) -> Array:
        """Return the (g, k, k) products among themselves of (g, k) of the columns."""
        shapes = self.shapes[self.of[some]].astype(float, copy=False)
        weighted = shapes if self.answer is None else shapes * (self.answer**2).sum(axis=1)
        return weighted @ shapes.transpose(0, 2, 1)


@dataclass(frozen=True, eq=False)
class Bank:
    """Candidates with their whitened columns at one fit: n rows, K columns in all.

    Attributes:
        candidates: One per group of columns.
        fit, context: Where the columns are made.
        reporter: Hears how many of them are.
        quiet: Standard deviation of the readings by which columns are whitened, over that stated.
    """

    candidates: tuple[Candidate, ...]
    fit: Fit = field(repr=False)
    context: Context = field(repr=False)
    reporter: Reporter = field(default=SILENT, repr=False)
    quiet: float = 1.0

    @cached_property
    def scale(self) -> Array:
        """(M, d) one over the standard deviation of each reading, weighted."""
        return self.fit.scale / self.quiet

    @cached_property
    def sizes(self) -> np.ndarray:
        """(G,) columns of each group."""
        return np.array([len(candidate.location.terms) for candidate in self.candidates], dtype=int)

    @cached_property
    def starts(self) -> np.ndarray:
        """(G + 1,) first column of every group."""
        return np.concatenate([[0], np.cumsum(self.sizes)]).astype(int)

    def group(self, index: int) -> Array:
        """Return the (n, k) columns of one candidate."""
        return self.made(self.candidates[index])

    def made(self, candidate: Candidate) -> Array:
        """Return the (n, k) columns of any candidate."""
        view, law, location, inner = self.fit.view, candidate.law, candidate.location, candidate.inner
        columns = view.jacobian(law, location, inner, self.context)
        if view.indirect:
            features = law.features(location, inner, view, self.context)
            columns = columns + view.effect_quotient(law, location, inner, features)
        return (columns * self.scale[:, :, None]).reshape(view.residual.size, -1)

    def _answer(self, site: str, direction: Array) -> Array:
        """Return the (M, d) whitened and weighted change of the readings with a twist at a site in a (6,) direction."""
        return self.fit.view.to_twist(site) @ direction * self.scale

    @property
    def parts(self) -> Iterable[ColumnPart]:
        """All columns, part by part."""
        return self._kept if self._count <= 2 * BANK_HELD else self._made()

    @property
    def _count(self) -> int:
        return int(self.starts[-1]) * len(self.fit.view.rows)

    @cached_property
    def _kept(self) -> tuple[ColumnPart, ...]:
        return tuple(self._made())

    def forget(self) -> None:
        """Drop the columns, which are made again when they are asked for."""
        vars(self).pop("_kept", None)

    def squares(self, rows: Any = None) -> Iterator[tuple[np.ndarray, Array, Array]]:
        """Yield for every group size (g,) groups, and (g, k, k) products of their columns among themselves.

        Third come those of the columns' products with (m, n) sparse rows, 0 where not given.
        """
        found: dict[int, list[tuple[np.ndarray, Array, Array]]] = {}
        for part in self.parts:
            sizes, seen = self.sizes[part.groups], np.empty((len(part.of), 0)) if rows is None else part.products(rows)
            starts = np.cumsum(sizes) - sizes
            for size in np.unique(sizes).tolist():
                some = sizes == size
                at = starts[some][:, None] + np.arange(size)
                own = part.groups[some], part.squares(at), seen[at] @ seen[at].transpose(0, 2, 1)
                found.setdefault(size, []).append(own)
        for some in found.values():
            groups, whole, through = map(np.concatenate, zip(*some, strict=True))
            yield groups, whole, through

    def products(self, others: Array) -> Array:
        """Return the (K, F) products of all columns with (n, F) others."""
        others, found = np.ascontiguousarray(others), np.empty((self.starts[-1], others.shape[1]))
        for part in self.parts:
            found[part.places] = part.products(others)
        return found

    def _made(self) -> Iterator[ColumnPart]:
        """Yield the columns, those with the same answer of the readings together.

        An answer is whitened once for all of them, and a twist in one direction takes one number a row, not six.
        """
        view, held = self.fit.view, 0
        shared = dict[tuple, Array]()  # at every site, whichever terms act
        known: dict[tuple[int, ...], Array] = {}
        waiting: dict[tuple, list[tuple[int, Array]]] = {}
        for _, run in groupby(enumerate(self.candidates), lambda pair: pair[1].law_and_place):
            some = list(run)
            self.reporter.step("screening candidates", some[0][0], len(self.candidates))
            law, place, own = some[0][1].law, some[0][1].location, dict[tuple, Array]()
            here, of_load, whole = self.context.here(place, view.arm), law.of_load(place), dict[Values, Array]()
            alike = (law.act.name, law.changes_model, of_load, place.site)
            if law.direction(here, some[0][1].inner) is None:
                inners = list(dict.fromkeys(one.inner for _, one in some))
                whole = dict(zip(inners, law.of_each(place, inners, view, self.context), strict=True))
            for index, one in some:
                direction, terms = law.direction(here, one.inner), list(one.location.terms)
                if direction is not None:
                    store, key = own if of_load else shared, (law.name, place.covariates, one.inner)
                    if key not in store:
                        store[key] = np.ascontiguousarray(law.shapes(one.location, one.inner, view, self.context))
                        held += store[key].size
                    found = store[key]
                else:
                    found = whole[one.inner][:, terms]
                    # Sums round by where a bank is cut: a law that changes the model counts by its columns.
                    held += view.sigma.size * len(terms) if law.changes_model else found.size
                along = b"" if direction is None else direction.tobytes()
                waiting.setdefault((*alike, along), []).append((index, found))
                if held > MADE_AT_ONCE:
                    yield from (self._part(key, each, known) for key, each in waiting.items())
                    waiting, held = {}, 0
        yield from (self._part(key, some, known) for key, some in waiting.items())

    def _part(self, alike: tuple, some: Sequence[tuple[int, Array]], known: dict[tuple[int, ...], Array]) -> ColumnPart:
        """Return the columns of candidates that act alike at a site from what each of them brings, by its number.

        `known` are shapes without loads that were put together before, by the arrays that they are of.
        """
        *_, of_load, _, direction = alike
        groups, brought = np.array([index for index, _ in some]), [found for _, found in some]
        first, view = self.candidates[groups[0]], self.fit.view
        kind = np.float32 if BANK_HELD < self._count <= 2 * BANK_HELD else float
        places = np.concatenate([np.arange(*self.starts[i : i + 2].tolist()) for i in groups.tolist()])
        if direction:
            answer = self._answer(first.location.site, np.frombuffer(direction))
            unique = {id(found): found for found in brought}
            ends = np.cumsum([0, *(len(found) for found in unique.values())]).tolist()
            start = dict(zip(unique, ends, strict=False))
            of = [start[id(found)] + np.array(self.candidates[i].location.terms) for i, found in some]
            key = tuple(unique)
            shapes = None if of_load else known.get(key)
            if shapes is None:
                shapes = np.concatenate(list(unique.values()), dtype=kind)
                known |= {} if of_load else {key: shapes}
            return ColumnPart(groups, places, shapes, np.concatenate(of), answer)
        answer = view.per(first.law, first.location) * self.scale[:, :, None]
        regressors = np.concatenate(brought, axis=1) @ answer.transpose(0, 2, 1)
        if view.indirect:
            pairs = zip(map(self.candidates.__getitem__, groups), brought, strict=True)
            columns = [view.effect_quotient(one.law, one.location, one.inner, features) for one, features in pairs]
            regressors = regressors + (np.concatenate(columns, axis=2) * self.scale[:, :, None]).transpose(0, 2, 1)
        regressors = regressors.transpose(1, 0, 2).reshape(len(places), -1).astype(kind, copy=False)
        return ColumnPart(groups, places, regressors, np.arange(len(places)), None)
