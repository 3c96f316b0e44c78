"""How well the fitted parameters of an arm are known: what a calibration leaves behind for predictions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armflex.conventions import Array

CANCELLED = 1e-5
"""Share of what parameters do one by one that is left of it where they cancel each other."""


@dataclass(frozen=True, eq=False)
class Certainty:
    """Covariance of everything that a fit moved, effects included.

    Attributes:
        labels: Block and parameter of each, as the fit named them, in its order.
        covariance: (P, P) posterior covariance in their units, of what is determined; inner parameters of effects by
            the logarithm.
        unexplained: Site, axis and standard deviation [m or rad] of a random twist that nobody can predict, None where
            there is none.
        directions: (k, P) directions that neither the campaign nor a prior determined, None where there are none.
    """

    labels: tuple[str, ...]
    covariance: Array
    unexplained: tuple[str, str, float] | None = None
    directions: Array | None = None

    @cached_property
    def undetermined(self) -> tuple[str, ...]:
        """Labels of the parameters that have a part in an undetermined direction: their variance is infinite."""
        if self.directions is None:
            return ()
        return tuple(self.labels[i] for i in np.flatnonzero(self.directions.any(axis=0)))

    def leaves_open(self, columns: Array) -> Array:
        """Return (N, d) which of (N, d, P) changes of d numbers per parameter go with an undetermined direction."""
        if self.directions is None:
            return np.zeros(columns.shape[:-1], dtype=bool)
        # What parameters do against each other cancels but for rounding, which is by the largest of the d numbers.
        size = (np.abs(columns) @ np.abs(self.directions.T)).max(axis=1, keepdims=True)
        return (np.abs(columns @ self.directions.T) > CANCELLED * size).any(axis=-1)

    def part(self, beginning: str) -> Array | None:
        """Return the covariance of the parameters whose labels begin so, None where there are none."""
        own = np.flatnonzero([label.startswith(beginning) for label in self.labels])
        return self.covariance[np.ix_(own, own)] if len(own) else None
