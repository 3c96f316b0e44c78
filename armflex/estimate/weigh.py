"""By how much readings count: as they state, or less where they scatter more than chance explains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.estimate.fit import Fit
from armflex.measured.measurements import Measurements

CHANCE = 4.0
"""Standard deviations of its cube root (Wilson and Hilferty 1931) by which a sum of squares is too large for chance."""

EVEN, ROUNDS = 0.05, 5
"""Change of the factor below which readings need not be weighed once more, and how often they are at most."""


@dataclass(frozen=True, eq=False)
class Weighed:
    """Readings with a factor on their stated standard deviations, 1 or more."""

    stated: Measurements
    factor: float = 1.0

    @cached_property
    def measurements(self) -> Measurements:
        """The readings with these standard deviations."""
        if self.factor == 1.0:
            return self.stated
        return replace(self.stated, readings=self.stated.readings.scaled(self.factor))

    def again(self, found: Fit) -> Weighed:
        """Return the readings weighed by how they scatter about a fit to these."""
        scatter, spread = self.factor * found.noise, 2.0 / (9.0 * found.freedom)
        by_chance = scatter ** (2.0 / 3.0) <= 1.0 - spread + CHANCE * np.sqrt(spread)
        return replace(self, factor=1.0 if by_chance else max(scatter, 1.0))

    def close_to(self, other: Weighed) -> bool:
        """Return whether nothing is gained by one after the other."""
        return abs(np.log(self.factor / other.factor)) <= EVEN
