"""How well the fitted parameters of an arm are known: what a calibration leaves behind for predictions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array


@dataclass(frozen=True, eq=False)
class Certainty:
    """Covariance of everything that a fit moved, effects included.

    Attributes:
        labels: Block and parameter of each, as the fit named them, in its order.
        covariance: (P, P) posterior covariance in their units; inner parameters of effects by the logarithm.
        unexplained: Site, axis and standard deviation [m or rad] of a random twist that nobody can predict, None where
            there is none.
    """

    labels: tuple[str, ...]
    covariance: Array
    unexplained: tuple[str, str, float] | None = None

    def part(self, beginning: str) -> Array | None:
        """Return the covariance of the parameters whose labels begin so, None where there are none."""
        own = np.flatnonzero([label.startswith(beginning) for label in self.labels])
        return self.covariance[np.ix_(own, own)] if len(own) else None
