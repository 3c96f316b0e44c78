"""What every kind of reading has to say of itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import Array
from armflex.readings.instrument import Instrument

Own = TypeVar("Own", bound="Kind")


@dataclass(frozen=True, eq=False)
class Kind(ABC):
    """The readings of one kind in N rows, d numbers each.

    Poses of the tip are (N, 4, 4) in the base, motions of the tip are of its origin in base axes, linear [m] before
    angular [rad]; what is read is in the frame of the instrument.

    Attributes:
        values: (N, d) what was read, in `unit`; zero where nothing was.
        sigma: (N, d) one standard deviation of each number; infinite where a row has no reading of this kind.
    """

    values: Array
    sigma: Array

    dimension: ClassVar[int]
    """d."""

    unit: ClassVar[str]
    """SI unit of its numbers."""

    @classmethod
    def unread(cls: type[Own], count: int, sigma: ArrayLike = 1.0) -> Own:
        """Return readings that are still to be taken in `count` rows, with their standard deviation, one or (d,)."""
        shape = (count, cls.dimension)
        return cls(np.zeros(shape), np.broadcast_to(np.asarray(sigma, dtype=float), shape))

    def some(self: Own, rows: np.ndarray) -> Own:
        """Return the readings of some rows."""
        return replace(self, values=self.values[rows], sigma=self.sigma[rows])

    def scaled(self: Own, factor: float) -> Own:
        """Return the readings with their standard deviations times a factor."""
        return replace(self, sigma=factor * self.sigma)

    @abstractmethod
    def residual(self, instrument: Instrument, tip: Array, sessions: Sequence[str]) -> Array:
        """Return (N, d) what was read minus what the instrument would read of the tip, zero where nothing was."""

    @abstractmethod
    def jacobian(self, instrument: Instrument, tip: Array) -> Array:
        """Return (N, d, 6) change of a reading per motion of the tip."""

    @abstractmethod
    def by_frame(self, points: Array) -> Array:
        """Return (N, d, 6) change per shift [m] and rotation vector [rad] of the instrument's frame about its origin.

        Args:
            points: (N, 3) target in the instrument frame [m].
        """

    @abstractmethod
    def by_scale(self, instrument: Instrument, points: Array) -> Array:
        """Return (N, d) change per share by which the instrument's distances are too long; `points` as above."""

    @abstractmethod
    def by_target(self, instrument: Instrument, tip: Array) -> Array:
        """Return (N, d, 3) change per shift [m] of the target in the tip frame."""

    @abstractmethod
    def by_mounting(self, instrument: Instrument, tip: Array) -> Array:
        """Return (N, d, 3) change per rotation vector [rad] of the target on the tool, in tip axes."""
