"""How well the fitted parameters of an arm are known: what a calibration leaves behind for predictions."""

from __future__ import annotations

from dataclasses import dataclass

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
