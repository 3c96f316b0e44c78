"""All hypotheses of a campaign in the linear problem of a fit: columns are made once, and multiplied when asked."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from itertools import islice
from typing import Self

import numpy as np

from armflex.conventions import RESOLUTION, Array
from armflex.estimate.fit import Fit
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.possible import sensible, size_prior
from armflex.linear_gaussian import LinearGaussian
from armflex.trace.bank import Bank, candidate_regressors, products_of
from armflex.trace.columns import Columns
from armflex.trace.hypotheses import Hypothesis
from armflex.trace.projection import Projection
from armflex.trace.selection import (
    SCALES,
    Batch,
    Beside,
    Block,
    Evidence,
    Group,
    Model,
    batches_of,
    prior_of,
)

UNIT_MOTION = 1e-3
"""Prior: by how much an amplitude of 1 moves the target, RMS [m]; what an instrument reads otherwise, by as much."""

SOUGHT_AT_ONCE = 32
"""Tolerance: hypotheses whose columns are held at a time where the likeliest of many are sought."""

ALMOST = 1e-4
"""Tolerance: share of a column's square below which what is left of it, or how it differs from another, cannot be seen
at any plausible size."""

MOTIONLESS = 1e-100
"""Tolerance: square of a column that moves nothing: of a smaller one the square of the scale would overflow."""

MARKS = 16
"""Tolerance: random vectors by whose products columns that are alike are known."""

IMPOSSIBLE = 8.0
"""Prior: log odds against what no machine has: while one effect is missing, another may look as if it were that."""


def batched(some: Iterable[Hypothesis], count: int) -> Iterator[list[Hypothesis]]:
    """Yield so many at a time."""
    rest = iter(some)
    while piece := list(islice(rest, count)):
        yield piece


def unit_of(fit: Fit) -> float:
    """Return the square of a whitened column that moves the target by `UNIT_MOTION`, RMS over the rows."""
    sigma = fit.view.sigma[:, fit.view.foremost]
    moved = UNIT_MOTION * fit.view.per_metre
    return len(fit.view.rows) * moved**2 / float((sigma[np.isfinite(sigma)] ** 2).mean())


class Screen(Evidence):
    """The evidence of all hypotheses at a fit: those of the catalogue's grid in one block, further ones in another.

    Attributes:
        fit, context: Where columns are made.
        projection: Of what is fitted anyway.
        quiet: Standard deviation of the readings by which they are whitened, over that stated.
        refined: Of every law and place, the sets of others beside which values inside it were refined.
    """

    def __init__(self, known: Sequence[Hypothesis], columns: Bank, projection: Projection, quiet: float = 1.0) -> None:
        self.bank, self.projection, self.quiet = columns, projection, quiet
        self.fit, self.context = columns.fit, columns.context
        self.objective, self.freedom = projection.objective, projection.freedom
        self.constant = -projection.freedom * float(np.log(quiet))
        self._unit = unit_of(columns.fit) / quiet**2
        marks = projection.drawn(MARKS)
        others = np.column_stack([projection.shared, projection.residual, projection.cleared(marks)])
        products, last = columns.products(others / quiet), -1 - MARKS
        self._seen, scores = products[:, :last] @ projection.fitted.root, products[:, last]
        scale, self._squares = np.empty(len(scores)), np.empty(len(scores))
        some, apart = [], None if projection.apart is None else projection.apart.each
        for groups, stated, through in columns.squares(apart):
            whole = stated / quiet**2
            places = columns.starts[groups][:, None] + np.arange(whole.shape[1])
            seen = self._seen[places]
            inside = whole - seen @ seen.transpose(0, 2, 1) - through / quiet**2
            self._squares[places] = np.einsum("gkk->gk", whole)
            scale[places] = self._scaled(self._squares[places])
            some.append((groups, places, inside))
        starts = columns.starts.tolist()
        self.groups = [Group(one, a, scale[a:b]) for one, a, b in zip(known, starts, starts[1:], strict=False)]
        self._single = next(((groups, inside[:, 0, 0]) for groups, _, inside in some if inside.shape[1] == 1), None)
        if self._single is not None:
            single, left = self._single
            alone = columns.starts[single]
            marked = products[alone, -MARKS:] - self._seen[alone] @ (projection.half @ marks)
            visible = left > ALMOST * self._squares[alone]
            marked[visible] /= np.sqrt(left[visible, None])
            self.groups = _named(self.groups, single[visible], marked[visible])
        batches = tuple(Batch.of([self.groups[i] for i in own.tolist()], own, *rest) for own, *rest in some)
        self._held, self._scanned = Columns(columns, projection, quiet), np.zeros(0, dtype=int)
        further = Block((), np.empty(0), np.empty((0, len(SCALES))), self._held.with_further)
        rows = self._held.rows(columns.products, self._seen)
        self._catalogue, self._narrow = Block(batches, scores, prior_of(self.groups), rows), None
        self.blocks = [self._catalogue, further]
        self._charges: dict[tuple, float] = {}
        self._sized: dict[int, Array] = {}
        self._short: dict[tuple, float] = {}
        self.refined: dict[tuple, set[frozenset]] = {}

    def forget(self) -> None:
        """Drop what can be made again: a campaign of many rows has room for the columns of one fit only."""
        self._known.clear()
        self.bank.forget()
        rows = self._held.rows(self.bank.products, self._seen)
        self._catalogue, self._narrow = replace(self._catalogue, gram=rows), None
        self.blocks = [self._catalogue, replace(self.blocks[1])]  # as if never scanned

    def _scaled(self, squares: Array) -> Array:
        moves = np.isfinite(squares) & (squares > MOTIONLESS)
        return np.where(moves, np.sqrt(self._unit / np.where(moves, squares, 1.0)), 0.0)

    def scale_of(self, columns: Array, unit: Array | None) -> Array:
        """Return the (k,) scale of a hypothesis's (n, k) columns; `unit` where members are alike as they are."""
        if unit is None:
            return self._scaled((columns**2).sum(axis=0))
        return unit * np.sqrt(self._unit / max(float(((columns * unit) ** 2).sum(axis=0).mean()), MOTIONLESS))

    def extend(self, more: Iterable[Hypothesis]) -> None:
        """Add hypotheses."""
        made = self._moving(more)
        if not made:
            return
        held, first = self._held, self._held.first + len(self._held.further)
        own = held.add(np.hstack([columns for _, columns in made]))
        groups, block = self._block(made, held.columns[own], held.cleared[own], held.seen[own])
        self.groups += [replace(one, first=first + one.first) for one in groups]
        self.blocks[1] = self.blocks[1].joined(block, held.with_further)

    def likeliest(self, more: Iterable[Hypothesis], models: Sequence[Model], most: int) -> list[Hypothesis]:
        """Return the hypotheses that are most probable beside any of some models, of many that are made in pieces."""
        best: list[tuple[float, Hypothesis]] = []
        besides = [self.beside(model) for model in models]
        for piece in batched(more, SOUGHT_AT_ONCE):
            made = self._moving(piece)
            if not made:
                continue
            columns = np.hstack([own for _, own in made])
            cleared, seen = self.projection.cleared(columns), (self.projection.half @ columns).T
            _, block = self._block(made, columns.T, cleared.T, seen)
            odds = np.max([one.odds_in(block) for one in besides], axis=(0, 2))
            best += zip(odds.tolist(), (one for one, _ in made), strict=True)
            best = sorted(best, key=lambda pair: -pair[0])[:most]
        return [one for _, one in best]

    def _block(
        self, made: Sequence[tuple[Hypothesis, Array]], columns: Array, cleared: Array, seen: Array
    ) -> tuple[list[Group], Block]:
        """Return hypotheses as a block of their own, from (K, n) columns, these cleared, and their (K, r) products."""
        groups, first = list[Group](), 0
        for one, own in made:
            groups.append(Group(one, first, self.scale_of(own, one.unit)))
            first += own.shape[1]

        def inside(at: np.ndarray) -> Array:
            return columns[at] @ cleared[at].transpose(0, 2, 1) - seen[at] @ seen[at].transpose(0, 2, 1)

        def gram(places: np.ndarray) -> Array:
            at = self._held.at(places)
            return columns @ self._held.cleared[at].T - seen @ self._held.seen[at].T

        scores = columns @ self.projection.residual
        return groups, Block(batches_of(groups, inside), scores, prior_of(groups), gram)

    def columns_of(self, beside: Beside) -> tuple[Array, Array]:
        """Return the (n, k) scaled and cleared columns of a model, and their (k, r) products with the `half`."""
        at = self._held.at(beside.places)
        return (self._held.cleared[at] * beside.scale[:, None]).T, self._held.seen[at] * beside.scale[:, None]

    def _moving(self, some: Iterable[Hypothesis]) -> list[tuple[Hypothesis, Array]]:
        made = [(one, self.made(one.members)) for one in some]
        return [(one, columns) for one, columns in made if np.isfinite(columns).all() and columns.any()]

    def made(self, members: Sequence[Candidate]) -> Array:
        """Return the (n, k) columns of some candidates, by the scatter of the readings."""
        return np.hstack([candidate_regressors(one, self.fit, self.context) for one in members]) / self.quiet

    def single(self) -> dict[int, tuple[float, float]]:
        """Return of every hypothesis of the catalogue with one column its square, and what the projection leaves of it.

        Both are zero where a column is only rounding beside that of the place where its law does most: an axis through
        the target moves it by 1e-17, not by nothing.
        """
        if self._single is None:
            return {}
        (first, left), most = self._single, dict[tuple, float]()
        whole = self._squares[self.bank.starts[first]]
        some = [self.groups[i].hypothesis.one for i in first.tolist()]
        kinds = [(one.law.name, one.location.turns, one.location.terms) for one in some]  # of a unit
        for kind, square in zip(kinds, whole.tolist(), strict=True):
            most[kind] = max(square, most.get(kind, 0.0))
        moves = whole > RESOLUTION**2 * np.array([most[kind] for kind in kinds])
        pairs = zip(np.where(moves, whole, 0.0).tolist(), np.where(moves, left, 0.0).tolist(), strict=True)
        return dict(zip(first.tolist(), pairs, strict=True))

    def columns(self, places: np.ndarray) -> Array:
        """Return the (n, k) columns at some places."""
        at = self._held.at(places)
        return self._held.columns[at].T

    def explained(self, beside: Beside) -> Array:
        """Return (n,) what a model explains of the readings."""
        return self.columns(beside.places) @ beside.values

    def among(self, places: np.ndarray) -> tuple[Array, Array]:
        at = self._held.at(places)
        return self._held.products(at)[:, at], self._held.scores[at]

    def narrow(self, some: bool) -> None:
        self.blocks[0] = self._catalogue
        if not some:
            return
        numbers = self.ranked[self.ranked < len(self._catalogue.priors)]
        if self._narrow is None or not np.array_equal(numbers, self._scanned):
            batches, kept = self._catalogue.narrowed(numbers)
            parts = self.bank.some(kept)
            gram = self._held.rows(lambda own: products_of(parts, own, len(kept)), self._seen[kept])
            self._scanned = numbers
            self._narrow = Block(batches, self._catalogue.scores[kept], self._catalogue.priors, gram)
        self.blocks[0] = self._narrow

    def scores_of(self, residuals: Array) -> Array:
        """Return the (K, F) products X'M of all columns with (n, F) residuals."""
        projection, held = self.projection, self._held
        cleared, half = projection.cleared(residuals), projection.half @ residuals
        found = self.bank.products(cleared) / self.quiet - self._seen @ half
        own = held.columns[held.further] @ cleared - held.seen[held.further] @ half
        return np.vstack([found, own])

    def with_readings(self, scores: Array, objective: float) -> Self:
        """Return the same hypotheses with other readings: (K,) scores of all columns, and J0."""
        other = copy(self)
        vars(other).pop("_known", None)
        pairs = zip(self.blocks, self.parted(scores), strict=True)
        other.blocks, other.objective = [replace(block, scores=own) for block, own in pairs], objective
        return other

    def parted(self, scores: Array) -> list[Array]:
        """Return (K, ...) scores of all columns block by block."""
        return np.split(scores, [self._held.first])

    def dense(self, numbers: Sequence[int], priors: Array, mask: np.ndarray | None = None) -> Dense:
        """Return the evidence of some hypotheses alone, with (k, T) log priors, from (n,) some readings or all."""
        projection, held = self.projection, self._held
        kept = np.arange(len(projection.data)) if mask is None else np.flatnonzero(mask)
        known = [self.groups[i] for i in numbers]
        places = np.concatenate([np.zeros(0, dtype=int), *(one.places for one in known)])
        starts = np.cumsum([0, *(len(one.scale) for one in known)]).tolist()
        groups = [Group(one.hypothesis, first, one.scale) for one, first in zip(known, starts, strict=False)]
        own, shared = projection.regressors[kept], projection.shared[kept]
        root = LinearGaussian(own.T @ shared + np.diag(projection.precision)).root
        data, read = projection.data[kept], projection.cleared(projection.data)[kept]
        some = np.ix_(self._held.at(places), kept)
        columns = held.columns[some]
        cleared = columns if projection.apart is None else held.cleared[some]
        seen, taken = columns @ shared @ root, data @ shared @ root
        gram, scores = columns @ cleared.T - seen @ seen.T, columns @ read - seen @ taken
        objective = float(data @ read - taken @ taken)
        count = projection.count if mask is None else round(projection.count * float(np.mean(mask)))
        return Dense(groups, gram, scores, objective, projection.free_of(count, shared @ root, kept), priors)

    def charge(self, number: int, amplitudes: Array) -> float:
        sizes = tuple(np.round(np.sign(amplitudes) * np.log10(np.abs(amplitudes) + 1e-30), 1).tolist())
        key, one = (number, sizes), self.groups[number].hypothesis
        if key not in self._charges:
            possible = one.family or sensible(
                one.one.effect(amplitudes), self.fit.view, self.context, self.fit.declared.arm
            )
            self._charges[key] = 0.0 if possible else IMPOSSIBLE
        return self._charges[key] + self._short.get(one.spot, 0.0)

    def sized(self, number: int) -> Array | float:
        group = self.groups[number]
        if group.hypothesis.family:
            return 0.0
        if number not in self._sized:
            effect = group.hypothesis.one.effect(group.scale)
            likely = size_prior(effect, SCALES, self.fit.view, self.context)
            self._sized[number] = np.log(len(SCALES) * likely)
        return self._sized[number]

    def fall_short(self, spot: tuple, by: float) -> None:
        """Charge a law at a place with what a fit of the arm came out below what this linear problem promised."""
        self._short[spot] = self._short.get(spot, 0.0) + max(by, 0.0)
        self._known.clear()


def _named(groups: list[Group], single: np.ndarray, marked: Array) -> list[Group]:
    """Return the hypotheses where a free shape that has the column of a law of the catalogue is that law.

    No reading could distinguish them, and what a law describes is not unnamed: the law has the prior of both. Those
    with (g,) `single` columns that are seen are compared by (g, m) products with random vectors of what the projection
    leaves of them, of length 1.
    """
    physical = np.array([groups[i].hypothesis.one.law.physical for i in single.tolist()], dtype=bool)
    laws, free = np.flatnonzero(physical), np.flatnonzero(~physical)
    first, squares = np.abs(marked[:, 0]), (marked**2).sum(axis=1)
    laws = laws[np.argsort(first[laws])]
    ends = np.searchsorted(first[laws], first[free, None] + 3.0 * np.sqrt(ALMOST) * np.array([-1.0, 1.0]))
    found = groups.copy()
    for i, (a, b) in zip(free.tolist(), ends.tolist(), strict=True):
        near = laws[a:b]
        apart = squares[near] + squares[i] - 2.0 * np.abs(marked[near] @ marked[i])
        alike = single[near[apart <= ALMOST * marked.shape[1]]].tolist()
        if alike:
            law, shape = max(alike, key=lambda one: found[one].hypothesis.prior), int(single[i])
            both = float(np.logaddexp(found[law].hypothesis.prior, groups[shape].hypothesis.prior))
            for place, prior in ((law, both), (shape, -np.inf)):
                found[place] = replace(found[place], hypothesis=replace(found[place].hypothesis, prior=prior))
    return found


class Dense(Evidence):
    """The evidence of a few hypotheses from some of the rows: all (K, K) products of their columns are known."""

    def __init__(
        self, groups: list[Group], whole: Array, scores: Array, objective: float, freedom: float, priors: Array
    ) -> None:
        self.groups, self._gram, self._scores = groups, whole, scores
        self.objective, self.freedom = objective, freedom
        batches = batches_of(groups, lambda places: whole[places[:, :, None], places[:, None, :]])
        self.blocks = [Block(batches, scores, priors, lambda places: whole[:, places])]

    def among(self, places: np.ndarray) -> tuple[Array, Array]:
        return self._gram[np.ix_(places, places)], self._scores[places]
