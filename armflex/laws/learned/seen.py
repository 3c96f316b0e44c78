"""The loads that a law was learned under."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import Array
from armflex.laws.law import Law, Row
from armflex.laws.learned.window import Window, load_scale, window_of


@dataclass(frozen=True, eq=False)
class Seen:
    """The loads that a campaign put on a flexure.

    Attributes:
        mean, precision, loads: See `Window`.
        load_scale: (6,) RMS loads [N, Nm].
        twist_scale: (6,) RMS twists of the declared law under them [m, rad].
    """

    mean: Array
    precision: Array
    loads: Array
    load_scale: Array
    twist_scale: Array

    def window(self, faded: float, energy: Array | None) -> Window:
        """Return where a correction counts that is nothing from a reach on; see `Window`."""
        return Window(self.mean, self.precision, self.loads, faded, energy)


def seen_in(law: Law, wrenches: Array, row: Row) -> Seen:
    """Return what (M, 6) loads are to a law in M rows."""
    twists = np.sqrt((law.twist(wrenches, row) ** 2).mean(axis=0))
    window = window_of(wrenches, tuple(np.flatnonzero(twists > 0.0).tolist()))
    return Seen(window.mean, window.precision, window.loads, load_scale(wrenches), twists)
