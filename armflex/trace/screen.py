"""All hypotheses of a campaign in the linear problem of a fit: columns are made once, and multiplied when asked."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from armflex.conventions import RESOLUTION, Array
from armflex.estimate.fit import Fit
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.possible import sensible, size_prior
from armflex.linear_gaussian import LinearGaussian
from armflex.trace.bank import Bank, Part, candidate_regressors, products_of
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
    batch_of,
    batches_of,
    joined,
    prior_of,
    reduced,
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


class Held:
    """Columns that are held: those of models, and those that are of no grid.

    Attributes:
        columns, cleared: (h, n) columns, and the same cleared of the parameters apart.
        seen: (h, r) their products with the `half` of the projection.
        scores: (h,) X'My.
    """

    def __init__(self, projection: Projection) -> None:
        self._projection, self.count, size = projection, 0, len(projection.residual)
        self._columns, self._seen = np.empty((0, size)), np.empty((0, len(projection.half)))
        self._cleared, self._scores = self._columns, np.empty(0)
        self._products = dict[int, Array]()

    columns = property(lambda self: self._columns[: self.count])
    cleared = property(lambda self: self._cleared[: self.count])
    seen = property(lambda self: self._seen[: self.count])
    scores = property(lambda self: self._scores[: self.count])

    def add(self, columns: Array) -> np.ndarray:
        """Hold (n, k) columns more, and return their (k,) places."""
        first, last, projection = self.count, self.count + columns.shape[1], self._projection
        if last > len(self._scores):  # room for more than are asked for, so that few are moved

            def grown(held: Array) -> Array:
                more = np.empty((64 + last + last // 2, *held.shape[1:]))
                more[:first] = held[:first]
                return more

            self._columns, self._seen, self._scores = map(grown, (self._columns, self._seen, self._scores))
            self._cleared = self._columns if projection.apart is None else grown(self._cleared)
        self.count = last
        self.columns[first:] = columns.T
        if projection.apart is not None:
            self.cleared[first:] = projection.cleared(columns).T
        self.seen[first:] = columns.T @ projection.half.T
        self.scores[first:] = columns.T @ projection.residual
        return np.arange(first, last)

    def products(self, at: np.ndarray) -> list[Array]:
        """Return (h,) X'MX of each of (k,) columns with all; what was asked for before is known but for what is new."""
        known, some = self._products, dict.fromkeys(at.tolist())
        for length in {len(known.get(i, ())) for i in some} - {self.count}:
            own = np.array([i for i in some if len(known.get(i, ())) == length])
            more = self.cleared[own] @ self.columns[length:].T - self.seen[own] @ self.seen[length:].T
            known |= {i: np.append(known.get(i, ()), one) for i, one in zip(own.tolist(), more, strict=True)}
        return [known[i] for i in at.tolist()]


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
        self._unit, self._first = unit_of(columns.fit) / quiet**2, int(columns.starts[-1])
        marks = projection.drawn(MARKS)
        others = np.column_stack([projection.shared, projection.residual, projection.cleared(marks)])
        products, last = columns.products(others / quiet), -1 - MARKS
        self._seen, scores = products[:, :last] @ projection.fitted.root, products[:, last]
        through = () if projection.apart is None else columns.squares_through(projection.apart.each)
        scale, self._squares = np.empty(self._first), np.empty(self._first)
        some = []
        for number, (groups, stated) in enumerate(columns.squares):
            whole = stated / quiet**2
            places = columns.starts[groups][:, None] + np.arange(whole.shape[1])
            seen = self._seen[places]
            inside = whole - seen @ seen.transpose(0, 2, 1) - (through[number][1] / quiet**2 if through else 0.0)
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
        batches = tuple(batch_of([self.groups[i] for i in own.tolist()], own, *rest) for own, *rest in some)
        further = Block(len(self.groups), (), np.empty(0), np.empty((0, len(SCALES))))
        self.blocks = [Block(0, batches, scores, prior_of(self.groups)), further]
        self._catalogue, self._narrowed = self.blocks[0], None
        self._narrow_rows, self._narrow = dict[int, Array](), tuple[Part, ...]()
        self._held, self._place, self._rows = Held(projection), dict[int, int](), dict[int, Array]()
        self._further = np.zeros(0, dtype=int)
        self._charges: dict[tuple, float] = {}
        self._sized: dict[int, Array] = {}
        self._short: dict[tuple, float] = {}
        self.refined: dict[tuple, set[frozenset]] = {}

    def forget(self) -> None:
        """Drop what can be made again: a campaign of many rows has room for the columns of one fit only."""
        self.scanned.clear()
        self._known.clear()
        self._rows, self._narrow_rows, self._narrow = {}, {}, ()
        self._narrowed = None
        self.bank.forget()

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
        block, first = self.blocks[-1], self._first + len(self._further)
        own = self._held.add(np.hstack([columns for _, columns in made]))
        self._place |= zip(range(first, first + len(own)), own.tolist(), strict=True)
        self._further = np.append(self._further, own)
        by_size: dict[int, list[Batch]] = {one[1].shape[1]: [one] for one in block.batches}
        groups, end = [], first
        for one, columns in made:
            size, number = columns.shape[1], len(self.groups)
            at, end = np.arange(end, end + size), end + size
            groups.append(Group(one, int(at[0]), self.scale_of(columns, one.unit)))
            self.groups.append(groups[-1])
            inside = _products(own[at - first][None], self._held.columns, self._held.cleared, self._held.seen)
            batch = batch_of(groups[-1:], np.array([number - block.first]), at[None] - self._first, inside)
            by_size.setdefault(size, []).append(batch)
        batches = tuple(joined(some) for some in by_size.values())
        priors = np.concatenate([block.priors, prior_of(groups)])
        self.blocks[-1] = Block(block.first, batches, self._held.scores[self._further], priors)

    def likeliest(self, more: Iterable[Hypothesis], models: Sequence[Model], most: int) -> list[Hypothesis]:
        """Return the hypotheses that are most probable beside any of some models, of many that are made in pieces."""
        best: list[tuple[float, Hypothesis]] = []
        known = [(beside, *self.columns_of(beside)) for beside in map(self.beside, models)]
        for piece in batched(more, SOUGHT_AT_ONCE):
            made = self._moving(piece)
            if not made:
                continue
            columns = np.hstack([own for _, own in made])
            seen, cleared = (self.projection.half @ columns).T, self.projection.cleared(columns)
            ends = np.cumsum([0, *(own.shape[1] for _, own in made)])
            groups = [
                Group(one, first, self._scaled((own**2).sum(axis=0)))
                for (one, own), first in zip(made, ends.tolist(), strict=False)
            ]
            parts = columns.T, cleared.T, seen
            batches = batches_of(groups, lambda places, parts=parts: _products(places, *parts))
            scores, logs = columns.T @ self.projection.residual, []
            for beside, own, own_seen in known:
                across = (columns.T @ own - seen @ own_seen.T) @ beside.inverse.T
                logs.append(beside.odds_of(batches, reduced(batches, across), scores - across @ beside.pull, len(made)))
            odds = np.array([one.prior for one, _ in made]) + np.max(logs, axis=(0, 2))
            best += zip(odds.tolist(), (one for one, _ in made), strict=True)
            best = sorted(best, key=lambda pair: -pair[0])[:most]
        return [one for _, one in best]

    def columns_of(self, beside: Beside) -> tuple[Array, Array]:
        """Return the (n, k) scaled and cleared columns of a model, and their (k, r) products with the `half`."""
        at = self._held_at(beside.places)
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

    def _held_at(self, places: np.ndarray) -> np.ndarray:
        """Return where columns are held, and hold those that are not."""
        missing = [place for place in dict.fromkeys(places.tolist()) if place not in self._place]
        if missing:
            groups = np.searchsorted(self.bank.starts, missing, side="right") - 1
            known = {i: self.bank.group(i) / self.quiet for i in dict.fromkeys(groups.tolist())}
            pairs = zip(missing, groups.tolist(), strict=True)
            some = np.column_stack([known[i][:, place - self.bank.starts[i]] for place, i in pairs])
            self._place |= zip(missing, self._held.add(some).tolist(), strict=True)
        return np.array([self._place[place] for place in places.tolist()], dtype=int)

    def columns(self, places: np.ndarray) -> Array:
        """Return the (n, k) columns at some places."""
        at = self._held_at(places)
        return self._held.columns[at].T

    def explained(self, beside: Beside) -> Array:
        """Return (n,) what a model explains of the readings."""
        return self.columns(beside.places) @ np.concatenate([np.zeros(0), *beside.amplitudes])

    def among(self, places: np.ndarray) -> tuple[Array, Array]:
        at = self._held_at(places)
        products = [one[at] for one in self._held.products(at)]
        return np.array(products).reshape(len(at), len(at)), self._held.scores[at]

    def gram(self, block: int, places: np.ndarray) -> Array:
        at = self._held_at(places)
        if block:
            return np.array([one[self._further] for one in self._held.products(at)]).T
        kept = self.blocks[0].kept
        rows = self._rows if kept is None else self._narrow_rows
        missing = np.array([place for place in dict.fromkeys(places.tolist()) if place not in rows], dtype=int)
        if len(missing):
            some = self._held_at(missing)
            cleared, seen = self._held.cleared[some].T, self._held.seen[some].T
            if kept is None:
                found = self.bank.products(cleared) / self.quiet - self._seen @ seen
            else:
                found = products_of(self._narrow, cleared, len(kept)) / self.quiet - self._seen[kept] @ seen
            rows |= zip(missing.tolist(), np.ascontiguousarray(found.T), strict=True)
        return np.array([rows[place] for place in places.tolist()]).T

    def narrow(self, some: bool) -> None:
        if not some:
            self.blocks[0] = self._catalogue
            return
        numbers = self.ranked[self.ranked < self.blocks[1].first]
        if self._narrowed is None or not np.array_equal(numbers, self._narrowed[0]):
            block = self._catalogue.narrowed(numbers)
            assert block.kept is not None
            self._narrowed, self._narrow_rows = (numbers, block), {}
            self._narrow = self.bank.some(block.kept)
        self.blocks[0] = self._narrowed[1]

    def scores_of(self, residuals: Array) -> Array:
        """Return the (K, F) products X'M of all columns with (n, F) residuals."""
        projection, held = self.projection, self._held
        cleared, half = projection.cleared(residuals), projection.half @ residuals
        found = self.bank.products(cleared) / self.quiet - self._seen @ half
        own = held.columns[self._further] @ cleared - held.seen[self._further] @ half
        return np.vstack([found, own])

    def dense(self, numbers: Sequence[int], priors: Array, mask: np.ndarray | None = None) -> Dense:
        """Return the evidence of some hypotheses alone, from some of the readings.

        Args:
            numbers: Which hypotheses.
            priors: (k, T) log prior probability of each at each of its scales.
            mask: (n,) which readings; all where not given.
        """
        projection, held = self.projection, self._held
        kept = np.arange(len(projection.data)) if mask is None else np.flatnonzero(mask)
        known = [self.groups[i] for i in numbers]
        places = np.concatenate([np.zeros(0, dtype=int), *(one.places for one in known)])
        starts = np.cumsum([0, *(len(one.scale) for one in known)]).tolist()
        groups = [Group(one.hypothesis, first, one.scale) for one, first in zip(known, starts, strict=False)]
        own, shared = projection.regressors[kept], projection.shared[kept]
        root = LinearGaussian(own.T @ shared + np.diag(projection.precision)).root
        data, read = projection.data[kept], projection.cleared(projection.data)[kept]
        some = np.ix_(self._held_at(places), kept)
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

    No reading could distinguish them, and what a law describes is not unnamed: the law has the prior of both.

    Args:
        groups: All of the catalogue's grid.
        single: (g,) those with one column that is seen.
        marked: (g, m) products of what the projection leaves of them, of length 1, with random vectors: alike where
            they are.
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


def _products(places: np.ndarray, columns: Array, cleared: Array, seen: Array) -> Array:
    return columns[places] @ cleared[places].transpose(0, 2, 1) - seen[places] @ seen[places].transpose(0, 2, 1)


class Dense(Evidence):
    """The evidence of a few hypotheses from some of the rows: all (K, K) products of their columns are known."""

    def __init__(
        self, groups: list[Group], whole: Array, scores: Array, objective: float, freedom: float, priors: Array
    ) -> None:
        self.groups, self._gram, self._scores = groups, whole, scores
        self.objective, self.freedom = objective, freedom
        batches = batches_of(groups, lambda places: whole[places[:, :, None], places[:, None, :]])
        self.blocks = [Block(0, batches, scores, priors)]

    def among(self, places: np.ndarray) -> tuple[Array, Array]:
        return self._gram[np.ix_(places, places)], self._scores[places]

    def gram(self, block: int, places: np.ndarray) -> Array:
        return self._gram[:, places]

    def narrow(self, some: bool) -> None:
        """All are scanned: they are few."""
