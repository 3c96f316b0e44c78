"""All hypotheses of a campaign in the linear problem of a fit: columns are made once, and multiplied when asked."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, pairwise

import numpy as np

from armflex.conventions import Array
from armflex.estimate.fit import Fit
from armflex.linear_gaussian import LinearGaussian
from armflex.trace.candidates import Bank, Candidate, candidate_regressors
from armflex.trace.hypotheses import Hypothesis
from armflex.trace.projection import Projection
from armflex.trace.selection import Evidence, Group, Model, batch_of
from armflex.trace.sensible import sensible, unusual

MOVED = 1e-3
"""By how much an amplitude of 1 moves the target, RMS [m]; what an instrument reads otherwise, by as much."""

PIECE = 128
"""Tolerance: hypotheses whose columns are held at a time where the likeliest of many are sought."""

STILL = 1e-12
"""Tolerance: share of what an amplitude of 1 does to the readings at the place where it does most that is rounding."""

IMPOSSIBLE = 8.0
"""Prior: log odds against what no machine has: while one effect is missing, another may look as if it were that."""


def batched(some: Iterable[Hypothesis], count: int) -> Iterator[list[Hypothesis]]:
    """Yield so many at a time."""
    rest = iter(some)
    while piece := list(islice(rest, count)):
        yield piece


def unit_of(fit: Fit) -> float:
    """Return the square of a whitened column that moves the target by `MOVED`, RMS over the rows."""
    sigma = fit.view.sigma[:, fit.view.foremost]
    return len(fit.view.rows) * MOVED**2 / float((sigma[np.isfinite(sigma)] ** 2).mean())


class Screen(Evidence):
    """The evidence of all hypotheses at a fit.

    Attributes:
        fit, context: Where columns are made.
        projection: Of what is fitted anyway.
        quiet: Standard deviation of the readings by which they are whitened, over that stated.
    """

    def __init__(self, known: Sequence[Hypothesis], columns: Bank, projection: Projection, quiet: float = 1.0) -> None:
        self.bank, self.projection, self.quiet = columns, projection, quiet
        self.fit, self.context = columns.fit, columns.context
        self.objective, self.count = projection.objective, projection.count
        self.constant = -columns.fit.freedom * float(np.log(quiet))
        self._unit, self._first = unit_of(columns.fit) / quiet**2, int(columns.starts[-1])
        products = columns.products(np.column_stack([projection.shared, projection.residual])) / quiet
        self._seen, self.scores = products[:, :-1] @ projection.fitted.root, products[:, -1]
        taken = () if projection.apart is None else columns.squares_through(projection.apart.each)
        self._insides: dict[int, tuple[list[np.ndarray], list[Array]]] = {}
        scale, self._squares = np.empty(self._first), np.empty(self._first)
        for number, (groups, stated) in enumerate(columns.squares):
            whole = stated / quiet**2
            places = columns.starts[groups][:, None] + np.arange(whole.shape[1])
            seen = self._seen[places]
            inside = whole - seen @ seen.transpose(0, 2, 1) - (taken[number][1] / quiet**2 if taken else 0.0)
            self._squares[places] = np.einsum("gkk->gk", whole)
            scale[places] = self._scaled(self._squares[places])
            self._insides[whole.shape[1]] = ([groups], [inside])
        starts = columns.starts.tolist()
        self.groups = [
            Group(one, np.arange(a, b), scale[a:b]) for one, a, b in zip(known, starts, starts[1:], strict=False)
        ]
        self._further = np.zeros((len(projection.residual), 0))
        self._rows: dict[int, tuple[Array, Array]] = {}
        self._charges: dict[tuple, float] = {}

    def _scaled(self, squares: Array) -> Array:
        moves = np.isfinite(squares) & (squares > 0.0)
        return np.where(moves, np.sqrt(self._unit / np.where(moves, squares, 1.0)), 0.0)

    def extend(self, more: Iterable[Hypothesis]) -> None:
        """Add hypotheses."""
        made = []
        for one in more:
            columns = self.made(one.members)
            if np.isfinite(columns).all() and columns.any():
                made.append((one, columns))
        if not made:
            return
        whole = np.hstack([columns for _, columns in made])
        cleared = self.projection.cleared(whole)
        seen = (self.projection.half @ whole).T
        for place, (own, row) in list(self._rows.items()):
            more_of_row = whole.T @ own - seen @ self._seen[place]
            self._rows[place] = own, np.append(row, more_of_row)
        first = len(self.scores)
        self._seen = np.vstack([self._seen, seen])
        self.scores = np.append(self.scores, whole.T @ self.projection.residual)
        self._further = np.hstack([self._further, whole])
        for one, columns in made:
            size, squares = columns.shape[1], (columns**2).sum(axis=0)
            at = np.arange(first, first + size)
            local = at - (len(self.scores) - whole.shape[1])
            inside = columns.T @ cleared[:, local] - seen[local] @ seen[local].T
            if one.unit is None:
                scale = self._scaled(squares)
            else:  # members are alike as they are, not by what they move
                scale = one.unit * np.sqrt(self._unit / max(float((squares * one.unit**2).mean()), 1e-300))
            numbers, insides = self._insides.setdefault(size, ([], []))
            numbers.append(np.array([len(self.groups)]))
            insides.append(inside[None])
            self.groups.append(Group(one, at, scale))
            first += size
        self.grown()

    def likeliest(self, more: Iterable[Hypothesis], models: Sequence[Model], most: int) -> list[Hypothesis]:
        """Return the hypotheses that are most probable beside any of some models, of many that are made in pieces."""
        best: list[tuple[float, Hypothesis]] = []
        known = [(self.beside(model), *self._beside_columns(model)) for model in models]
        for piece in batched(more, PIECE):
            made = [(one, self.made(one.members)) for one in piece]
            made = [(one, columns) for one, columns in made if np.isfinite(columns).all() and columns.any()]
            if not made:
                continue
            columns = np.hstack([own for _, own in made])
            seen, cleared = (self.projection.half @ columns).T, self.projection.cleared(columns)
            ends = np.cumsum([0, *(own.shape[1] for _, own in made)])
            groups = [
                Group(one, np.arange(a, b), self._scaled((own**2).sum(axis=0)))
                for (one, own), (a, b) in zip(made, pairwise(ends.tolist()), strict=True)
            ]
            batches = []
            for size in np.unique(np.diff(ends)).tolist():
                numbers = np.flatnonzero(np.diff(ends) == size)
                places = np.array([groups[i].places for i in numbers.tolist()])
                stacked, own_seen = columns.T[places] @ cleared.T[places].transpose(0, 2, 1), seen[places]
                batches.append(batch_of(groups, numbers, stacked - own_seen @ own_seen.transpose(0, 2, 1)))
            scores = columns.T @ self.projection.residual
            odds = np.array([one.prior for one, _ in made]) + np.max(
                [
                    beside.odds_of(
                        batches, (columns.T @ own - seen @ own_seen.T) @ np.linalg.inv(beside.root).T, scores
                    )
                    for beside, own, own_seen in known
                ],
                axis=(0, 2),
            )
            best += zip(odds.tolist(), (one for one, _ in made), strict=True)
            best = sorted(best, key=lambda pair: -pair[0])[:most]
        return [one for _, one in best]

    def _beside_columns(self, model: Model) -> tuple[Array, Array]:
        """Return the (n, k) scaled and cleared columns of a model, and their (k, r) products with the `half`."""
        some = [self.groups[one.number] for one in model]
        places = np.concatenate([np.zeros(0, dtype=int), *(one.places for one in some)])
        scale = np.concatenate([np.zeros(0), *(one.scale for one in some)])
        return self.cleared(places) * scale, self.seen(places) * scale[:, None]

    def made(self, members: Sequence[Candidate]) -> Array:
        """Return the (n, k) columns of some candidates, by the scatter of the readings."""
        return np.hstack([candidate_regressors(one, self.fit, self.context) for one in members]) / self.quiet

    def insides(self) -> list[tuple[np.ndarray, Array]]:
        return [(np.concatenate(numbers), np.concatenate(insides)) for numbers, insides in self._insides.values()]

    def single(self) -> dict[int, tuple[float, float]]:
        """Return of every hypothesis of the catalogue with one column its square, and what the projection leaves of it.

        Both are zero where a column is only rounding: an axis through the target moves it by 1e-17, not by nothing.
        """
        numbers, insides = self._insides.get(1, ([], []))
        if not numbers:
            return {}
        first, left, most = numbers[0], insides[0][:, 0, 0], dict[tuple, float]()
        whole = self._squares[self.bank.starts[first]]
        some = [self.groups[i].hypothesis.one for i in first.tolist()]
        kinds = [(one.law.name, one.location.turns, one.location.terms) for one in some]  # of a unit
        for kind, square in zip(kinds, whole.tolist(), strict=True):
            most[kind] = max(square, most.get(kind, 0.0))
        moves = whole > STILL**2 * np.array([most[kind] for kind in kinds])
        pairs = zip(np.where(moves, whole, 0.0).tolist(), np.where(moves, left, 0.0).tolist(), strict=True)
        return dict(zip(first.tolist(), pairs, strict=True))

    def columns(self, places: np.ndarray) -> Array:
        """Return the (n, k) columns at some places."""
        found = np.empty((len(self.projection.residual), len(places)))
        for i, place in enumerate(places.tolist()):
            if place >= self._first:
                found[:, i] = self._further[:, place - self._first]
            else:
                group = int(np.searchsorted(self.bank.starts, place, side="right")) - 1
                found[:, i] = self.bank.group(group)[:, place - self.bank.starts[group]] / self.quiet
        return found

    def cleared(self, places: np.ndarray) -> Array:
        """Return the same, cleared of the parameters apart."""
        self.gram(places)
        return np.array([self._rows[p][0] for p in places.tolist()]).T if len(places) else self._further[:, :0]

    def seen(self, places: np.ndarray) -> Array:
        """Return the (k, r) products of some columns with the `half` of the projection."""
        return self._seen[places]

    def gram(self, places: np.ndarray) -> Array:
        missing = np.array([place for place in places.tolist() if place not in self._rows], dtype=int)
        if len(missing):
            own = self.projection.cleared(self.columns(missing))
            found = (
                np.vstack([self.bank.products(own) / self.quiet, self._further.T @ own])
                - self._seen @ self._seen[missing].T
            )
            for i, place in enumerate(missing.tolist()):
                self._rows[place] = own[:, i].copy(), found[:, i].copy()
        if not len(places):
            return np.zeros((len(self.scores), 0))
        return np.array([self._rows[place][1] for place in places.tolist()]).T  # rows one after another

    def scores_of(self, residuals: Array) -> Array:
        """Return the (K, F) products X'M of all columns with (n, F) residuals."""
        projection = self.projection
        cleared = projection.cleared(residuals)
        found = np.empty((len(self.scores), residuals.shape[1]))
        for part in self.bank.parts:
            found[part.places] = part.products(np.ascontiguousarray(cleared.T)) / self.quiet
        found[self._first :] = self._further.T @ cleared
        return found - self._seen @ (projection.half @ residuals)

    def dense(self, numbers: Sequence[int], charges: Sequence[float], mask: np.ndarray | None = None) -> Dense:
        """Return the evidence of some hypotheses alone, from some of the readings.

        Args:
            numbers: Which hypotheses.
            charges: What the size of each counts against it [nats].
            mask: (n,) which readings; all where not given.
        """
        projection, kept = self.projection, slice(None) if mask is None else mask
        known = [self.groups[i] for i in numbers]
        places = np.concatenate([np.zeros(0, dtype=int), *(one.places for one in known)])
        ends = np.cumsum([0, *(len(one.places) for one in known)]).tolist()
        groups = [
            Group(one.hypothesis, np.arange(*pair), one.scale) for one, pair in zip(known, pairwise(ends), strict=True)
        ]
        every = np.hstack([self.columns(places), projection.data[:, None]])
        columns, cleared = every[kept], projection.cleared(every)[kept]
        own, shared = projection.regressors[kept], projection.shared[kept]
        root = LinearGaussian(own.T @ shared + np.diag(projection.precision)).root
        seen = columns.T @ shared @ root
        whole = columns.T @ cleared - seen @ seen.T
        count = self.count if mask is None else round(self.count * float(np.mean(mask)))
        return Dense(groups, whole[:-1, :-1], whole[:-1, -1], float(whole[-1, -1]), count, np.asarray(charges))

    def charge(self, number: int, amplitudes: Array) -> float:
        sizes = tuple(np.round(np.sign(amplitudes) * np.log10(np.abs(amplitudes) + 1e-30), 1).tolist())
        key = (number, sizes)
        if key not in self._charges:
            one = self.groups[number].hypothesis
            cost = 0.0
            if not one.family:
                cost = 0.5 * unusual(one.one, amplitudes, self.fit.view, self.context)
                cost += IMPOSSIBLE * (not sensible(one.one, amplitudes, self.fit, self.context))
            self._charges[key] = cost
        return self._charges[key]


class Dense(Evidence):
    """The evidence of a few hypotheses from some of the rows: all products of their columns are known.

    Attributes:
        whole: (K, K) G.
    """

    def __init__(
        self, groups: list[Group], whole: Array, scores: Array, objective: float, count: int, charges: Array
    ) -> None:
        self.groups, self.whole, self.scores = groups, whole, scores
        self.objective, self.count, self._charges = objective, count, charges

    def gram(self, places: np.ndarray) -> Array:
        return self.whole[:, places]

    def insides(self) -> list[tuple[np.ndarray, Array]]:
        sizes = np.array([len(one.places) for one in self.groups], dtype=int)
        found = []
        for size in np.unique(sizes).tolist():
            numbers = np.flatnonzero(sizes == size)
            places = np.array([self.groups[i].places for i in numbers.tolist()])
            found.append((numbers, self.whole[places[:, :, None], places[:, None, :]]))
        return found

    def charge(self, number: int, amplitudes: Array) -> float:
        return float(self._charges[number])
