"""Readings of several kinds side by side: the d numbers of a row are those of every kind in turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import Array
from armflex.readings.kind import Kind

One = TypeVar("One", bound=Kind)


@dataclass(frozen=True, eq=False)
class Readings:
    """What was read in N rows, or is to be.

    Attributes:
        count: N.
        kinds: Its kinds, N rows each.
    """

    count: int
    kinds: tuple[Kind, ...] = ()

    @property
    def size(self) -> int:
        """Numbers of a row, d."""
        return sum(kind.dimension for kind in self.kinds)

    @cached_property
    def sigma(self) -> Array:
        """(N, d) one standard deviation of every number [m, rad]; infinite where it was not read."""
        return self.stacked(lambda kind: kind.sigma)

    def stacked(self, answer: Callable[[Kind], Array]) -> Array:
        """Return (N, d, ...) what every kind answers, (N, its own d, ...) each in its own unit, side by side."""
        parts = [answer(kind) for kind in self.kinds]
        return np.concatenate(parts, axis=1) if parts else np.zeros((self.count, 0))

    @property
    def slices(self) -> tuple[slice, ...]:
        """Where the numbers of every kind stand among the d of a row."""
        ends = np.cumsum([0, *(kind.dimension for kind in self.kinds)]).tolist()
        return tuple(slice(start, end) for start, end in pairwise(ends))

    def place(self, kind: type[Kind]) -> slice:
        """Return where the numbers of a kind stand among the d of a row, an empty slice where there are none."""
        found = (place for one, place in zip(self.kinds, self.slices, strict=True) if isinstance(one, kind))
        return next(found, slice(0, 0))

    def of(self, kind: type[One]) -> One | None:
        """Return the readings of a kind, None where there are none."""
        return next((one for one in self.kinds if isinstance(one, kind)), None)

    def some(self, rows: np.ndarray) -> Readings:
        """Return the readings of some rows, by their (M,) numbers."""
        return Readings(len(rows), tuple(kind.some(rows) for kind in self.kinds))

    def scaled(self, factor: float) -> Readings:
        """Return the readings with all standard deviations times a factor."""
        return replace(self, kinds=tuple(kind.scaled(factor) for kind in self.kinds))


def unread(count: int, *kinds: type[Kind], sigma: ArrayLike = 1.0) -> Readings:
    """Return readings of some kinds that are still to be taken in `count` rows.

    Args:
        count: N.
        kinds: Their kinds, in order.
        sigma: One standard deviation of each of their numbers, one for all of a kind or (d,).
    """
    return Readings(count, tuple(kind.unread(count, sigma) for kind in kinds))
