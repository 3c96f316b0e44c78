"""All hypotheses of a campaign in the linear problem of a fit: columns are made once, and multiplied when asked."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from itertools import accumulate, islice
from typing import NamedTuple, Self

import numpy as np

from armflex.conventions import RESOLUTION, Array
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.possible import sensible, size_prior
from armflex.trace.bank import Bank
from armflex.trace.columns import Columns
from armflex.trace.hypotheses import Hypothesis
from armflex.trace.projection import Projection
from armflex.trace.selection import (
    SCALES,
    Batch,
    Beside,
    Evidence,
    Group,
    Model,
    ScanBlock,
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

LINEAR_ERROR = 0.02
"""Tolerance: the `error` of a linear problem about an arm that lacks what is sought."""

IMPOSSIBLE = 8.0
"""Prior: log odds against what no machine has: while one effect is missing, another may look as if it were that."""


class Screen(Evidence):
    """The evidence of all hypotheses at a fit: those of the catalogue's grid in one block, further ones in another.

    Attributes:
        known: The hypotheses of the catalogue's grid, as they were given.
        bank: Makes columns, which are whitened by the scatter of the readings, `quiet` times that stated.
        fit, context: Where they are made.
        projection: Of what is fitted anyway.
        unit: Square of a whitened column that moves the target by `UNIT_MOTION`, RMS over the rows.
        refined: Of every law and place, the sets of others beside which values inside it were refined.
    """

    error = LINEAR_ERROR

    def __init__(self, known: Sequence[Hypothesis], bank: Bank, projection: Projection, charge: float = 0.0) -> None:
        self.known, self.bank, self.projection, self.quiet = known, bank, projection, bank.quiet
        self.fit, self.context = bank.fit, bank.context
        self.objective, self.freedom = projection.objective, projection.freedom
        self.constant = -projection.freedom * float(np.log(bank.quiet)) - 0.5 * projection.volume - charge
        sigma, moved = bank.fit.view.sigma[:, bank.fit.view.foremost], UNIT_MOTION * bank.fit.view.per_metre
        variance = float((sigma[np.isfinite(sigma)] ** 2).mean()) * bank.quiet**2
        self.unit = len(sigma) * moved**2 / variance
        marks = projection.left_of(projection.drawn(MARKS))
        products = bank.products(np.column_stack([projection.half.T, projection.residual, marks]))
        seen, scores, marked = np.split(products, [-1 - MARKS, -MARKS], axis=1)
        scale, some = np.empty(len(products)), list[tuple[np.ndarray, np.ndarray, Array]]()
        for groups, whole, through in bank.squares(projection.each if projection.each.shape[0] else None):
            places = bank.starts[groups][:, None] + np.arange(whole.shape[1])
            own = scale[places] = self._scaled(np.einsum("gkk->gk", whole))
            inside = whole - seen[places] @ seen[places].transpose(0, 2, 1) - through
            some.append((groups, places, inside * own[:, :, None] * own[:, None, :]))
        starts = bank.starts.tolist()
        self.groups = [Group(one, a, scale[a:b]) for one, a, b in zip(known, starts, starts[1:], strict=False)]
        self.groups, acting = _moving(self.groups)
        self._twins: dict[tuple, tuple[Twin, ...]] = {}
        batches = tuple(Batch(*own, np.array([known[i].positive for i in own[0].tolist()])) for own in some)
        if (alone := _alone(batches)) is not None:
            left, at = alone.inside[:, 0, 0], alone.places[:, 0]
            visible = left > ALMOST * self.unit
            marked = marked[at] * scale[at, None] / np.sqrt(np.where(visible, left, 1.0))[:, None]
            order = np.flatnonzero(visible)[np.argsort(np.abs(marked[visible, 0]), kind="stable")]
            single, pairs = alone.numbers[order], _alike(marked[order])
            self.groups, self._twins = _tied(_named(self.groups, single, pairs), single, pairs)
        self._held = Columns(bank, projection, scale)
        rows = self._held.with_bank(bank.products, scale)
        catalogue = ScanBlock(batches, scores[:, 0] * scale, prior_of(self.groups), rows)
        self.blocks = [catalogue, self._block((), self._held.further)]
        self._charges: dict[tuple, float] = {}
        self._sized: dict[int, Array] = {}
        self._short: dict[tuple, float] = {}
        self.refined: dict[tuple, set[frozenset]] = {}
        if acting:
            self.extend(acting)

    def forget(self) -> None:
        """Drop what can be made again: a campaign of many rows has room for the columns of one fit only."""
        self._known.clear()
        self.across.clear()
        self.bank.forget()
        rows = self._held.with_bank(self.bank.products, self._held.scale)
        self.blocks = [replace(self.blocks[0], gram=rows, axes={}), replace(self.blocks[1])]  # as if never scanned

    def _scaled(self, squares: Array) -> Array:
        moves = np.isfinite(squares) & (squares > MOTIONLESS)
        return np.where(moves, np.sqrt(self.unit / np.where(moves, squares, 1.0)), 0.0)

    def scale_of(self, columns: Array) -> Array:
        """Return the (k,) scale of a hypothesis's (n, k) columns."""
        return self._scaled((columns**2).sum(axis=0))

    def extend(self, more: Iterable[Hypothesis]) -> None:
        """Add hypotheses."""
        for piece in self._in_pieces(more):
            self.hold(piece)

    def hold(self, more: Iterable[tuple[Hypothesis, Array]], idle: bool = False) -> range:
        """Add hypotheses with their (n, k) columns, `idle` ones that move nothing, too, and return their numbers."""
        groups, columns = self._moving(more, idle)
        if not groups:
            return range(0)
        first = len(self._held.scale) + len(self.blocks[1].scores)
        block = self._block(groups, self._held.add(columns))
        self.groups += [replace(one, first=first + one.first) for one in groups]
        self.blocks[1] = self.blocks[1].joined(block, self._held.with_further)
        return range(len(self.groups) - len(groups), len(self.groups))

    def likeliest(self, more: Iterable[Hypothesis], models: Sequence[Model], most: int) -> list[Hypothesis]:
        """Return the hypotheses that are most probable beside any of some models, of many that are made in pieces."""
        best, besides = list[tuple[float, Hypothesis]](), [self.beside(model) for model in models]
        for piece in self._in_pieces(more):
            groups, columns = self._moving(piece)
            if not groups:
                continue
            block = self._block(groups, columns)
            odds = np.max([one.odds_in(block) for one in besides], axis=(0, 2))
            best += zip(odds.tolist(), (one.hypothesis for one in groups), strict=True)
            best = sorted(best, key=lambda pair: -pair[0])[:most]
        return [one for _, one in best]

    def _in_pieces(self, more: Iterable[Hypothesis]) -> Iterator[list[tuple[Hypothesis, Array]]]:
        """Yield hypotheses with their (n, k) columns, `SOUGHT_AT_ONCE` at a time."""
        rest = iter(more)
        while piece := list(islice(rest, SOUGHT_AT_ONCE)):
            yield [(one, self.bank.made(one.one)) for one in piece]

    def _moving(self, some: Iterable[tuple[Hypothesis, Array]], idle: bool = False) -> tuple[list[Group], Array]:
        """Return what of some hypotheses moves what is read, or all, and the (K, n) columns of that, scaled."""
        groups, columns, first = list[Group](), list[Array](), 0
        for one, own in some:
            scale = self.scale_of(own)
            acting = np.flatnonzero(scale > 0.0) if not idle else np.arange(len(scale))
            if np.isfinite(own).all() and len(acting):
                groups.append(Group(one.with_terms(acting), first, scale[acting]))
                columns.append((own[:, acting] * scale[acting]).T)
                first += len(acting)
        return groups, np.concatenate([np.empty((0, len(self.projection.residual))), *columns])

    def _block(self, groups: Sequence[Group], columns: Array) -> ScanBlock:
        """Return hypotheses as a block of their own, from (K, n) columns."""
        left, held = self.projection.left_of(columns.T).T, self._held

        def gram(places: np.ndarray) -> Array:  # without the screen, which holds it: that would not be freed at once
            return columns @ held.of(places)[1].T

        batches = batches_of(groups, lambda at: columns[at] @ left[at].transpose(0, 2, 1))
        return ScanBlock(batches, columns @ self.projection.residual, prior_of(groups), gram)

    def columns_of(self, places: np.ndarray) -> tuple[Array, Array]:
        """Return the (n, k) scaled columns at some places, and what the projection leaves of them."""
        columns, left = self._held.of(places)
        return columns.T, left.T

    def single(self) -> dict[int, float | None]:
        """Return which share of its square the projection leaves of every hypothesis of the catalogue with one column.

        None where that moves nothing that is read, nor is more than rounding beside that of the place where its law
        does most: an axis through the target moves it by 1e-17, not by nothing.
        """
        if (alone := _alone(self.blocks[0].batches)) is None:
            return {}
        kinds, most = list[tuple[tuple, float]](), dict[tuple, float]()
        for group in (self.groups[i] for i in alone.numbers.tolist()):
            one, scale = group.hypothesis.one, float(group.scale[0])
            kind, size = (one.law.name, one.location.turns, one.location.terms), 1.0 / scale if scale > 0.0 else 0.0
            kinds.append((kind, size))  # of a unit
            most[kind] = max(size, most.get(kind, 0.0))
        shares = (alone.inside[:, 0, 0] / self.unit).tolist()
        moves = [
            share if size > RESOLUTION * most[kind] else None for share, (kind, size) in zip(shares, kinds, strict=True)
        ]
        return dict(zip(alone.numbers.tolist(), moves, strict=True))

    def columns(self, places: np.ndarray) -> Array:
        """Return the (n, k) scaled columns at some places."""
        return self.columns_of(places)[0]

    def explained(self, beside: Beside) -> Array:
        """Return (n,) what a model explains of the readings."""
        return self.columns(beside.places) @ beside.values

    def among(self, places: np.ndarray) -> tuple[Array, Array]:
        return self._held.among(places)

    def scores_of(self, residuals: Array) -> Array:
        """Return the (K, F) products X'M of all columns with (n, F) residuals."""
        left, held = self.projection.left_of(residuals), self._held
        return np.vstack([self.bank.products(left) * held.scale[:, None], held.further @ left])

    def with_readings(self, scores: Array, objective: float) -> Self:
        """Return the same hypotheses with other readings: (K,) scores of all columns, and J0."""
        other = copy(self)
        for held in ("_known", "across"):
            vars(other).pop(held, None)
        pairs = zip(self.blocks, self.parted(scores), strict=True)
        other.blocks, other.objective = [replace(block, scores=own) for block, own in pairs], objective
        return other

    def parted(self, scores: Array) -> list[Array]:
        """Return (K, ...) scores of all columns block by block."""
        return np.split(scores, [len(self._held.scale)])

    def dense(self, numbers: Sequence[int], priors: Array) -> Dense:
        """Return the evidence of some hypotheses alone, with (k, T) log priors."""
        known = [self.groups[i] for i in numbers]
        starts = accumulate((len(one.scale) for one in known), initial=0)
        groups = [replace(one, first=first) for one, first in zip(known, starts, strict=False)]
        places = np.concatenate([np.zeros(0, dtype=int), *(one.places for one in known)])
        return Dense(groups, self.columns(places), self.projection, priors, tuple(numbers))

    def charge(self, number: int, amplitudes: Array) -> float:
        sizes = tuple(np.round(np.sign(amplitudes) * np.log10(np.abs(amplitudes) + 1e-30), 1).tolist())
        key, one = (number, sizes), self.groups[number].hypothesis
        if key not in self._charges:
            possible = sensible(one.one.effect(amplitudes), self.fit.view, self.context, self.fit.declared.arm)
            self._charges[key] = 0.0 if possible else IMPOSSIBLE
        return self._charges[key] + self._short.get(one.spot, 0.0)

    def charge_beside(self, beside: Beside, number: int, scale: int) -> float:
        return self.charge(number, beside.amplitudes_of(number, scale))

    def sized(self, number: int) -> Array | float:
        group = self.groups[number]
        if number not in self._sized:
            own = group.hypothesis.one.effect(group.scale)
            twins = [
                twin.one.effect(group.scale * twin.per_unit) for twin in self._twins.get(group.hypothesis.spot, ())
            ]
            likely = size_prior((own, *twins), SCALES, self.fit.view, self.context)
            self._sized[number] = np.log(len(SCALES) * likely)
        return self._sized[number]

    def fall_short(self, spot: tuple, by: float) -> None:
        """Charge a law at a place with what a fit of the arm came out below what this linear problem promised."""
        self._short[spot] = self._short.get(spot, 0.0) + max(by, 0.0)
        self._known.clear()


class Twin(NamedTuple):
    """A law of the same column as another, and how much of it does what a unit of the other does."""

    one: Candidate
    per_unit: float


def _moving(groups: list[Group]) -> tuple[list[Group], list[Hypothesis]]:
    """Return hypotheses where those with a term that moves nothing are none, and what of these is none of the others.

    What acts of them is the hypothesis with these terms alone, which has the prior of both: amplitudes that no reading
    shows, and no prior holds, would else be values of the arm.
    """
    places = {group.hypothesis.one: i for i, group in enumerate(groups)}
    kept, acting = groups.copy(), dict[Candidate, Hypothesis]()
    for i, group in enumerate(groups):
        moves = np.flatnonzero(group.scale > 0.0)
        if len(moves) == len(group.scale):
            continue
        kept[i] = replace(group, hypothesis=replace(group.hypothesis, prior=-np.inf))
        if not len(moves):
            continue
        rest = group.hypothesis.with_terms(moves)
        place = places.get(rest.one)
        same = acting.get(rest.one) if place is None else kept[place].hypothesis
        both = rest if same is None else replace(same, prior=float(np.logaddexp(same.prior, rest.prior)))
        if place is None:
            acting[rest.one] = both
        else:
            kept[place] = replace(kept[place], hypothesis=both)
    return kept, list(acting.values())


def _alike(marked: Array) -> np.ndarray:
    """Return the (2, p) pairs of (g, m) columns that no reading could distinguish, the first before the second.

    Columns are known by their products with random vectors, of what the projection leaves of them, of length 1, and are
    in the order of the size of their first product.
    """
    first, squares, pairs = np.abs(marked[:, 0]), (marked**2).sum(axis=1), [np.empty((2, 0), dtype=int)]
    ends = np.searchsorted(first, first + 3.0 * np.sqrt(ALMOST), side="right").tolist()
    for i, end in enumerate(ends):
        apart = squares[i + 1 : end] + squares[i] - 2.0 * np.abs(marked[i + 1 : end] @ marked[i])
        near = i + 1 + np.flatnonzero(apart <= ALMOST * marked.shape[1])
        pairs.append(np.array([np.full(len(near), i), near]))
    return np.hstack(pairs)


def _named(groups: list[Group], single: np.ndarray, pairs: np.ndarray) -> list[Group]:
    """Return the hypotheses where a free shape that has the column of a law of the catalogue is that law.

    What a law describes is not unnamed: the law has the prior of both. Of those with (g,) `single` columns the (2, p)
    `pairs` are alike.
    """
    physical = np.array([groups[i].hypothesis.one.law.physical for i in single.tolist()], dtype=bool)
    alike, found = dict[int, list[int]](), groups.copy()
    for pair in pairs[:, physical[pairs[0]] != physical[pairs[1]]].T.tolist():
        shape, law = sorted(pair, key=lambda i: bool(physical[i]))
        alike.setdefault(int(single[shape]), []).append(int(single[law]))
    for shape, laws in sorted(alike.items()):
        law = max(laws, key=lambda number: found[number].hypothesis.prior)
        both = float(np.logaddexp(found[law].hypothesis.prior, groups[shape].hypothesis.prior))
        for place, prior in ((law, both), (shape, -np.inf)):
            found[place] = replace(found[place], hypothesis=replace(found[place].hypothesis, prior=prior))
    return found


def _tied(
    groups: list[Group], single: np.ndarray, pairs: np.ndarray
) -> tuple[list[Group], dict[tuple, tuple[Twin, ...]]]:
    """Return the hypotheses where laws of one column are as likely as one another, and the others of each.

    At how many places a law may be distinguishes none of them: they would be named by that. An odd place does, and so
    does a size that machines do not have: see `size_prior`. Arguments are as of `_named`; a law at a place, whatever is
    inside it, is one of them.
    """
    from scipy.sparse import coo_array  # not needed to import the package
    from scipy.sparse.csgraph import connected_components

    possible = np.array([groups[i].hypothesis.prior > -np.inf for i in single.tolist()], dtype=bool)
    pairs, found, twins = pairs[:, possible[pairs].all(axis=0)], groups.copy(), dict[tuple, tuple[Twin, ...]]()
    edges = coo_array((np.ones(pairs.shape[1]), pairs), shape=(len(single), len(single)))
    _, tied = connected_components(edges, directed=False)
    for number in np.unique(tied[pairs[0]]).tolist():
        of_spot = dict[tuple, list[int]]()
        for place in single[tied == number].tolist():
            of_spot.setdefault(groups[place].hypothesis.spot, []).append(place)
        # One that must be positive has all of it on that side.
        masses = {
            spot: np.logaddexp.reduce(
                [groups[i].hypothesis.prior + np.log(2.0) * groups[i].hypothesis.positive for i in places]
            )
            for spot, places in of_spot.items()
        }
        odds = {spot: max(groups[i].hypothesis.odd for i in places) for spot, places in of_spot.items()}
        shared = np.logaddexp.reduce(list(masses.values())) - np.logaddexp.reduce(list(odds.values()))
        for spot, places in of_spot.items() if len(of_spot) > 1 else ():
            scale = groups[places[0]].scale[0]
            others = [groups[there[0]] for there in of_spot.values() if there is not places]
            twins[spot] = tuple(Twin(other.hypothesis.one, float(other.scale[0] / scale)) for other in others)
            for i in places:
                hypothesis = groups[i].hypothesis
                prior = hypothesis.prior + float(shared + odds[spot] - masses[spot])
                found[i] = replace(found[i], hypothesis=replace(hypothesis, prior=prior))
    return found, twins


def _alone(batches: Iterable[Batch]) -> Batch | None:
    """Return the hypotheses with one column."""
    return next((one for one in batches if one.places.shape[1] == 1), None)


class Dense(Evidence):
    """The evidence of a few hypotheses alone: all (K, K) products of their columns are known.

    Attributes:
        columns: (n, K) scaled columns.
        projection: Of what is fitted anyway to the same readings.
        numbers: What the hypotheses are numbered in the screen that they are from.
    """

    error = 0.0

    def __init__(
        self, groups: list[Group], columns: Array, projection: Projection, priors: Array, numbers: tuple[int, ...] = ()
    ) -> None:
        self.groups, self.columns, self.projection, self.numbers = groups, columns, projection, numbers
        self.objective, self.freedom = projection.objective, projection.freedom
        whole = self._gram = projection.inside(columns)
        batches = batches_of(groups, lambda places: whole[places[:, :, None], places[:, None, :]])
        scores = self._scores = columns.T @ projection.residual
        self.blocks = [ScanBlock(batches, scores, priors, lambda places: whole[:, places])]

    def among(self, places: np.ndarray) -> tuple[Array, Array]:
        return self._gram[np.ix_(places, places)], self._scores[places]

    def of_rows(self, times: Array) -> Dense:
        """Return the same where each of (n,) readings counts so many times; those of no time are left out."""
        if np.all(times == 1.0):
            return self
        some = times > 0.0
        columns = self.columns[some] * np.sqrt(times[some])[:, None]
        return Dense(self.groups, columns, self.projection.resampled(times), self.priors, self.numbers)

    def resampled(self, times: Array) -> Dense:
        """Return the same in a resample, in which each of (n,) readings counts so many times."""
        part = self.of_rows(times)
        if part is not self:
            part.doubled = float(np.var(times))
        return part

    def extended(self, more: Sequence[Hypothesis], columns: Sequence[Array], projection: Projection) -> Dense:
        """Return these hypotheses and more, with (n, k) scaled columns of each, beside what another projection has."""
        every, first, groups = [self.columns, *columns], self.columns.shape[1], list(self.groups)
        for hypothesis, columns_of in zip(more, columns, strict=True):
            groups.append(Group(hypothesis, first, np.ones(columns_of.shape[1])))
            first += columns_of.shape[1]
        priors = np.concatenate([self.priors, prior_of(groups[len(self.groups) :])])
        return Dense(groups, np.hstack(every), projection, priors, self.numbers)

    def left(self, model: Model) -> Array:
        """Return what a model and all that is fitted anyway leave of the (n,) readings."""
        beside = self.beside(model)
        data = self.projection.data - self.columns[:, beside.places] @ beside.values
        return data - self.projection.regressors @ self.projection.absorbed(data)

    def here(self, model: Model) -> Model:
        """Return a model of the screen as one of these hypotheses."""
        return tuple(replace(one, number=self.numbers.index(one.number)) for one in model)

    def there(self, model: Model) -> Model:
        """Return a model of these hypotheses as one of the screen."""
        return tuple(replace(one, number=self.numbers[one.number]) for one in model)
