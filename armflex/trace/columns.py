"""The columns of a linear problem and their products: of thousands of candidates those are held that models have."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from armflex.conventions import Array
from armflex.trace.bank import Bank
from armflex.trace.projection import Projection


class Columns:
    """Scaled columns of a bank, and further ones behind them, by their numbers.

    Attributes:
        bank: Makes its columns when they are asked for.
        projection: Between columns: products are X'MX.
        scale: (K,) what those of the bank are multiplied by.
        further: (F,) places of the further ones among those held.
        columns, left: (h, n) columns that are held, and what the projection leaves of them, MX.
    """

    def __init__(self, bank: Bank, projection: Projection, scale: Array) -> None:
        self.bank, self.projection, self.scale = bank, projection, scale
        self.first, self.further = len(scale), np.zeros(0, dtype=int)
        self._place, self._count = dict[int, int](), 0
        self._held = np.empty((2, 0, len(projection.residual)))

    columns = property(lambda self: self._held[0, : self._count])
    left = property(lambda self: self._held[1, : self._count])

    def add(self, columns: Array) -> np.ndarray:
        """Add (k, n) further columns, and return the (k,) places where they are held."""
        own, first = self._hold(columns), self.first + len(self.further)
        self._place |= zip(range(first, first + len(own)), own.tolist(), strict=True)
        self.further = np.append(self.further, own)
        return own

    def _hold(self, columns: Array) -> np.ndarray:
        first, last = self._count, self._count + len(columns)
        if last > self._held.shape[1]:  # room for more than are asked for, so that few are moved
            before, self._held = self._held, np.empty((2, 64 + last + last // 2, columns.shape[1]))
            self._held[:, :first] = before[:, :first]
        self._count = last
        self._held[:, first:last] = columns, self.projection.left_of(columns.T).T
        return np.arange(first, last)

    def at(self, numbers: np.ndarray) -> np.ndarray:
        """Return where (k,) columns are held, and hold those that are not."""
        missing = [number for number in dict.fromkeys(numbers.tolist()) if number not in self._place]
        if missing:
            starts = self.bank.starts
            groups = np.searchsorted(starts, missing, side="right") - 1
            known = {i: self.bank.group(i) for i in dict.fromkeys(groups.tolist())}
            pairs = zip(missing, groups.tolist(), strict=True)
            some = np.array([known[i][:, number - starts[i]] * self.scale[number] for number, i in pairs])
            self._place |= zip(missing, self._hold(some).tolist(), strict=True)
        return np.array([self._place[number] for number in numbers.tolist()], dtype=int)

    def with_further(self, numbers: np.ndarray) -> Array:
        """Return the (F, k) products of the further columns with some."""
        return self.columns[self.further] @ self.left[self.at(numbers)].T

    def with_bank(self, products: Callable[[Array], Array], scale: Array) -> Callable[[np.ndarray], Array]:
        """Return what returns the (K, k) products of some columns of the bank with any, and makes none twice.

        Args:
            products: Returns their (K, k) products with (n, k) others, as the bank has them.
            scale: (K,) what they are multiplied by.
        """
        known = dict[int, Array]()

        def found(numbers: np.ndarray) -> Array:
            missing = np.array([number for number in dict.fromkeys(numbers.tolist()) if number not in known], dtype=int)
            if len(missing):
                more = np.multiply(products(self.left[self.at(missing)].T).T, scale, order="C")
                known.update(zip(missing.tolist(), more, strict=True))
            return np.array([known[number] for number in numbers.tolist()]).reshape(-1, len(scale)).T

        return found
