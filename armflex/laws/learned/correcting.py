"""What corrections have in common: loads and twists in parts of what is typical of the flexure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.laws.law import Law


@dataclass(frozen=True, eq=False)
class Correcting:
    """Scales of a correction.

    Attributes:
        components: Of the load that count, 0 to 5.
        axes: Of the twist that answer, 0 to 5.
        load_scale: (6,) typical loads [N, Nm].
        twist_scale: (6,) typical twists [m, rad]; values are in parts of them.
    """

    components: tuple[int, ...]
    axes: tuple[int, ...]
    load_scale: Array
    twist_scale: Array

    def law(self, values: Array) -> Law | None:
        """Return None: no solver knows it."""
        return None

    def scaled(self, wrench: Array) -> Array:
        """Return the (..., c) components that count of a (..., 6) wrench, as multiples of typical ones."""
        return wrench[..., self.components] / self.typical

    @cached_property
    def typical(self) -> Array:
        """(c,) typical loads of the components that count."""
        return self.load_scale[list(self.components)]

    @cached_property
    def spread(self) -> Array:
        """(6, a) typical twist at the place of every axis that answers."""
        return np.diag(self.twist_scale)[:, list(self.axes)]
