"""The columns of a linear problem and their products: of thousands of candidates those are held that models have."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from armflex.conventions import Array
from armflex.trace.bank import Bank
from armflex.trace.projection import Projection


class Columns:
    """Scaled columns of a bank, and further ones behind them, by their numbers; of each what the projection leaves, MX.

    Attributes:
        bank: Makes its columns when they are asked for.
        projection: Between columns: products are X'MX.
        scale: (K,) what those of the bank are multiplied by.
    """

    def __init__(self, bank: Bank, projection: Projection, scale: Array) -> None:
        self.bank, self.projection, self.scale = bank, projection, scale
        self._places, self._products, self._count, self._multiplied = dict[int, int](), dict[int, Array](), 0, 0
        self._further = np.empty((0, len(projection.residual)))
        self._both, self._among = np.empty((2, 0, len(projection.residual))), np.empty((0, 0))
        self._scores = np.empty(0)

    @property
    def further(self) -> Array:
        """(F, n) further columns."""
        return self._further[: self._count]

    def add(self, columns: Array) -> Array:
        """Add (k, n) further columns, and return them as they are held."""
        first, last = self._count, self._count + len(columns)
        self._further = _roomy(self._further, last, 0)
        self._further[first:last], self._count = columns, last
        return self._further[first:last]

    def of(self, numbers: np.ndarray) -> Array:
        """Return (k,) columns, and what is left of them, (2, k, n)."""
        at = self._placed(numbers)  # which may move the columns
        return self._both[:, at]

    def among(self, numbers: np.ndarray) -> tuple[Array, Array]:
        """Return the (k, k) products of some columns with one another, and (k,) X'My; none is made twice."""
        at, first, last = self._placed(numbers), self._multiplied, len(self._places)
        if first < last:
            self._among = _roomy(_roomy(self._among, last, 0), last, 1)
            products = self._both[0, :last] @ self._both[1, first:last].T
            self._among[:last, first:last], self._among[first:last, :last] = products, products.T
            self._scores = np.append(self._scores, self._both[0, first:last] @ self.projection.residual)
            self._multiplied = last
        return self._among[np.ix_(at, at)], self._scores[at]

    def _placed(self, numbers: np.ndarray) -> np.ndarray:
        """Return the (k,) places at which some columns are held; those that are not yet are made."""
        starts, count = self.bank.starts, len(self.scale)
        missing = np.array([i for i in dict.fromkeys(numbers.tolist()) if i not in self._places], dtype=int)
        mine, further = missing[missing < count], missing[missing >= count]
        made = [(further, self.further[further - count])]
        for i in dict.fromkeys((np.searchsorted(starts, mine, side="right") - 1).tolist()):
            own = np.arange(*starts[i : i + 2].tolist())
            made.append((own, (self.bank.group(i) * self.scale[own]).T))
        for own, columns in made:
            first, last = len(self._places), len(self._places) + len(own)
            self._both = _roomy(self._both, last, 1)
            self._both[:, first:last] = columns, self.projection.left_of(columns.T).T
            self._places |= zip(own.tolist(), range(first, last), strict=True)
        return np.array([self._places[i] for i in numbers.tolist()], dtype=int)

    def with_further(self, numbers: np.ndarray) -> Array:
        """Return the (F, k) products of the further columns with some; what was known is not made again."""
        known, some = self._products, dict.fromkeys(numbers.tolist())
        for length in {len(known.get(i, ())) for i in some} - {self._count}:
            own = np.array([i for i in some if len(known.get(i, ())) == length])
            more = self.of(own)[1] @ self.further[length:].T
            known |= {i: np.append(known.get(i, ()), one) for i, one in zip(own.tolist(), more, strict=True)}
        return np.array([known[i] for i in numbers.tolist()]).reshape(len(numbers), self._count).T

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
                more = np.multiply(products(self.of(missing)[1].T).T, scale, order="C")
                known.update(zip(missing.tolist(), more, strict=True))
            return np.array([known[number] for number in numbers.tolist()]).reshape(-1, len(scale)).T

        return found


def _roomy(array: Array, count: int, axis: int) -> Array:
    """Return an array with room for so many along an axis, and for half as many again, so that few are moved."""
    if count <= array.shape[axis]:
        return array
    shape = list(array.shape)
    shape[axis] = 64 + count + count // 2
    found = np.empty(shape)  # room that is not used takes no memory
    found[tuple(map(slice, array.shape))] = array
    return found
