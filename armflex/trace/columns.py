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
        self._known, self._products, self._count = dict[int, Array](), dict[int, Array](), 0
        self._further = np.empty((0, len(projection.residual)))

    @property
    def further(self) -> Array:
        """(F, n) further columns."""
        return self._further[: self._count]

    def add(self, columns: Array) -> Array:
        """Add (k, n) further columns, and return them as they are held."""
        first, last = self._count, self._count + len(columns)
        if last > len(self._further):  # room for more than are asked for, so that few are moved
            before, self._further = self.further, np.empty((64 + last + last // 2, columns.shape[1]))
            self._further[:first] = before
        self._further[first:last], self._count = columns, last
        return self._further[first:last]

    def of(self, numbers: np.ndarray) -> Array:
        """Return (k,) columns, and what is left of them, (2, k, n)."""
        starts, count = self.bank.starts, len(self.scale)
        missing = np.array([i for i in dict.fromkeys(numbers.tolist()) if i not in self._known], dtype=int)
        mine, further = missing[missing < count], missing[missing >= count]
        made = [(further, self.further[further - count])]
        for i in dict.fromkeys((np.searchsorted(starts, mine, side="right") - 1).tolist()):
            own = np.arange(*starts[i : i + 2].tolist())
            made.append((own, (self.bank.group(i) * self.scale[own]).T))
        for own, columns in made:
            both = np.stack([columns, self.projection.left_of(columns.T).T], axis=1)
            self._known |= zip(own.tolist(), both, strict=True)
        found = [self._known[i] for i in numbers.tolist()]
        return np.stack(found, axis=1) if found else np.empty((2, *self._further[:0].shape))

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
