"""Readings of several kinds side by side: the d numbers of a row are those of every kind in turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import SHOWN, Array, Shown
from armflex.errors import listing
from armflex.readings.kind import Kind
from armflex.readings.postures import Postures

One = TypeVar("One", bound=Kind)


@dataclass(frozen=True, eq=False)
class Readings:
    """What was read in N rows, or is to be.

    Attributes:
        count: N.
        kinds: Its kinds, N rows each: those of the instrument at the tip, position first, then sensors, those that
            read lengths before others.
    """

    count: int
    kinds: tuple[Kind, ...] = ()

    @property
    def size(self) -> int:
        """Numbers of a row, d."""
        return sum(kind.dimension for kind in self.kinds)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the instruments, in order; '' is the one at the tip."""
        return tuple(dict.fromkeys(kind.name for kind in self.kinds))

    @cached_property
    def sigma(self) -> Array:
        """(N, d) one standard deviation of every number [m, rad]; infinite where it was not read."""
        return self.stacked(lambda kind: kind.sigma)

    def stacked(self, answer: Callable[[Kind], Array]) -> Array:
        """Return (N, d, ...) what every kind answers, (N, its own d, ...) each in its own unit, side by side."""
        parts = [answer(kind) for kind in self.kinds]
        return np.concatenate(parts, axis=1) if parts else np.zeros((self.count, 0))

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Where the numbers of every kind stand among the d of a row."""
        ends = np.cumsum([0, *(kind.dimension for kind in self.kinds)]).tolist()
        return tuple(slice(start, end) for start, end in pairwise(ends))

    @property
    def foremost(self) -> slice:
        """Where the numbers stand by which the size of an error is said: positions of the tip, where they were read.

        Without them it is all numbers of one unit: lengths, or else angles.
        """
        if not self.kinds or self.kinds[0].name == "":
            return slice(0, self.kinds[0].dimension if self.kinds else 0)
        return slice(0, sum(kind.dimension for kind in self.kinds if kind.unit == self.kinds[0].unit))

    @property
    def unit(self) -> str:
        """SI unit of the foremost numbers."""
        return self.kinds[0].unit if self.kinds else "m"

    @property
    def shown_in(self) -> Shown:
        """The unit in which people are shown errors of the foremost numbers, and its factor."""
        every = {kind.shown_in for kind, place in self.placed if place.stop <= self.foremost.stop}
        return every.pop() if len(every) == 1 else SHOWN[self.unit]

    @property
    def where_read(self) -> str:
        """What the size of a motion is stated of: of the target, or of what instruments read of it."""
        return "at the target" if not self.kinds or not self.kinds[0].name else "in what is read"

    @property
    def foremost_count(self) -> np.ndarray:
        """(N,) how many instruments read foremost numbers in each row."""
        count = np.zeros(self.count, dtype=int)
        for kind, place in self.placed:
            if place.stop <= self.foremost.stop:
                count += np.isfinite(kind.sigma).any(axis=1)
        return count

    @property
    def error_title(self) -> str:
        """What the size of an error is of, in words: the tip's position, or the instruments that are named."""
        kinds = [kind for kind, place in self.placed if place.stop <= self.foremost.stop]
        if not kinds or not kinds[0].name:
            return "3-D position error"
        several = any(kind.dimension > 1 for kind in kinds)
        return f"{'norm of the ' if several else ''}error of {listing(kind.title for kind in kinds)}"

    def row_squares(self, errors: Array) -> Array:
        """Return the (N,) squared error of each row [unit^2], zero where no foremost number was read.

        It is the mean over what instruments read there, each by its norm: of a position that is the 3-D error. The (N,
        d) errors are of all numbers, or of the foremost ones alone [m, rad].
        """
        read = np.isfinite(self.sigma[:, self.foremost])
        squares = np.where(read, errors[:, self.foremost], 0.0) ** 2
        return squares.sum(axis=1) / np.maximum(self.foremost_count, 1)

    def by_kind(self, errors: Array) -> tuple[tuple[Kind, float], ...]:
        """Return every kind with the RMS of what it read of (N, d) errors [its unit], over all its numbers."""
        sizes = []
        for kind, place in self.placed:
            read = np.isfinite(kind.sigma)
            squares = (np.where(read, errors[:, place], 0.0) ** 2).sum()
            sizes.append((kind, float(np.sqrt(squares / max(read.any(axis=1).sum(), 1)))))
        return tuple(sizes)

    @cached_property
    def groups(self) -> tuple[slice, ...]:
        """Where the numbers stand that were read together: by the instrument at the tip, and by every sensor."""
        ends = {name: [place for kind, place in self.placed if kind.name == name] for name in self.names}
        return tuple(slice(members[0].start, members[-1].stop) for members in ends.values())

    @property
    def placed(self) -> tuple[tuple[Kind, slice], ...]:
        """Every kind, and where its numbers stand among the d of a row."""
        return tuple(zip(self.kinds, self.slices, strict=True))

    def of(self, kind: type[One], name: str = "") -> One | None:
        """Return the readings of a kind by an instrument, that at the tip when not given; None where there are none."""
        return next((reading for reading in self.kinds if isinstance(reading, kind) and reading.name == name), None)

    @property
    def read(self) -> np.ndarray:
        """(N,) where anything was read."""
        return np.any(np.isfinite(self.sigma), axis=1) if self.kinds else np.zeros(self.count, dtype=bool)

    def within_range(self, at: Postures) -> Readings:
        """Return readings still to be taken without those that are beyond the range of their instrument."""
        kinds = [
            replace(reading, sigma=np.where(reading.readable(at).reshape(self.count, -1), reading.sigma, np.inf))
            if reading.name
            else reading
            for reading in self.kinds
        ]
        return replace(self, kinds=tuple(kinds))

    def some(self, rows: np.ndarray) -> Readings:
        """Return the readings of some rows, by their (M,) numbers."""
        return Readings(len(rows), tuple(kind.some(rows) for kind in self.kinds))

    def where(self, kept: np.ndarray) -> Readings:
        """Return the readings without the numbers that a (N, d) mask leaves out, as if they had not been read."""
        kinds = [replace(kind, sigma=np.where(kept[:, place], kind.sigma, np.inf)) for kind, place in self.placed]
        return replace(self, kinds=tuple(kinds))

    @property
    def as_looks(self) -> Readings:
        """The readings with few numbers left of those that share one look; see `Kind.look`."""
        return replace(self, kinds=tuple(kind.look for kind in self.kinds))

    def scaled(self, *factors: float) -> Readings:
        """Return the readings with all standard deviations times a factor, or (G,) times that of their instrument."""
        of = dict(zip(self.names, factors * len(self.names) if len(factors) == 1 else factors, strict=True))
        return replace(self, kinds=tuple(kind.scaled(of[kind.name]) for kind in self.kinds))


def unread(count: int, *kinds: type[Kind], sigma: ArrayLike = 1.0) -> Readings:
    """Return readings of some kinds that are still to be taken in `count` rows; sigma is one of each kind, or (d,)."""
    return Readings(count, tuple(kind.unread(count, sigma) for kind in kinds))
