"""The columns of a linear problem and their products: of thousands of candidates those are held that models have."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from armflex.conventions import Array
from armflex.trace.bank import Bank
from armflex.trace.projection import Projection


class Columns:
    """Columns of a bank, and further ones behind them, by their numbers.

    Attributes:
        bank: Makes its columns when they are asked for.
        projection: Between columns: products are X'MX.
        quiet: What columns of the bank are divided by.
        further: (F,) places of the further ones among those held.
        columns, cleared: (h, n) columns that are held, and the same cleared of the parameters apart.
        seen: (h, r) their products with the `half` of the projection.
        scores: (h,) X'My.
    """

    def __init__(self, bank: Bank, projection: Projection, quiet: float) -> None:
        self.bank, self.projection, self.quiet = bank, projection, quiet
        self.first, self.further = int(bank.starts[-1]), np.zeros(0, dtype=int)
        self._place, self._products = dict[int, int](), dict[int, Array]()
        self._count, size = 0, len(projection.residual)
        self._columns, self._seen = np.empty((0, size)), np.empty((0, len(projection.half)))
        self._cleared, self._scores = self._columns, np.empty(0)

    columns = property(lambda self: self._columns[: self._count])
    cleared = property(lambda self: self._cleared[: self._count])
    seen = property(lambda self: self._seen[: self._count])
    scores = property(lambda self: self._scores[: self._count])

    def add(self, columns: Array) -> np.ndarray:
        """Add (n, k) further columns, and return the (k,) places where they are held."""
        own, first = self._hold(columns), self.first + len(self.further)
        self._place |= zip(range(first, first + len(own)), own.tolist(), strict=True)
        self.further = np.append(self.further, own)
        return own

    def _hold(self, columns: Array) -> np.ndarray:
        first, last, projection = self._count, self._count + columns.shape[1], self.projection
        if last > len(self._scores):  # room for more than are asked for, so that few are moved

            def grown(held: Array) -> Array:
                more = np.empty((64 + last + last // 2, *held.shape[1:]))
                more[:first] = held[:first]
                return more

            self._columns, self._seen, self._scores = map(grown, (self._columns, self._seen, self._scores))
            self._cleared = self._columns if projection.apart is None else grown(self._cleared)
        self._count = last
        self.columns[first:] = columns.T
        if projection.apart is not None:
            self.cleared[first:] = projection.cleared(columns).T
        self.seen[first:] = columns.T @ projection.half.T
        self.scores[first:] = columns.T @ projection.residual
        return np.arange(first, last)

    def at(self, numbers: np.ndarray) -> np.ndarray:
        """Return where (k,) columns are held, and hold those that are not."""
        missing = [number for number in dict.fromkeys(numbers.tolist()) if number not in self._place]
        if missing:
            starts = self.bank.starts
            groups = np.searchsorted(starts, missing, side="right") - 1
            known = {i: self.bank.group(i) / self.quiet for i in dict.fromkeys(groups.tolist())}
            pairs = zip(missing, groups.tolist(), strict=True)
            some = np.column_stack([known[i][:, number - starts[i]] for number, i in pairs])
            self._place |= zip(missing, self._hold(some).tolist(), strict=True)
        return np.array([self._place[number] for number in numbers.tolist()], dtype=int)

    def products(self, at: np.ndarray) -> Array:
        """Return (k, h) products of columns that are held with all of those; what was known is not made again."""
        known, some = self._products, dict.fromkeys(at.tolist())
        for length in {len(known.get(i, ())) for i in some} - {self._count}:
            own = np.array([i for i in some if len(known.get(i, ())) == length])
            more = self.cleared[own] @ self.columns[length:].T - self.seen[own] @ self.seen[length:].T
            known |= {i: np.append(known.get(i, ()), one) for i, one in zip(own.tolist(), more, strict=True)}
        return np.array([known[i] for i in at.tolist()]).reshape(len(at), self._count)

    def with_further(self, numbers: np.ndarray) -> Array:
        """Return the (F, k) products of the further columns with some."""
        return self.products(self.at(numbers))[:, self.further].T

    def rows(self, products: Callable[[Array], Array], seen: Array) -> Callable[[np.ndarray], Array]:
        """Return what returns the (K, k) products of some columns of the bank with any, and makes none twice.

        Args:
            products: Returns their (K, k) products with (n, k) others, as the bank has them.
            seen: (K, r) their products with the `half`.
        """
        known = dict[int, Array]()

        def found(numbers: np.ndarray) -> Array:
            missing = np.array([number for number in dict.fromkeys(numbers.tolist()) if number not in known], dtype=int)
            if len(missing):
                at = self.at(missing)
                more = products(self.cleared[at].T) / self.quiet - seen @ self.seen[at].T
                known.update(zip(missing.tolist(), np.ascontiguousarray(more.T), strict=True))
            return np.array([known[number] for number in numbers.tolist()]).reshape(-1, len(seen)).T

        return found
