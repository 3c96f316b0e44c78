"""Configurations spread evenly over all that the joints allow, in chunks that depend on nothing but their number."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import Flag, listing

MOST_ROWS = 1 << 30
"""Length of scipy's Sobol sequence."""


@dataclass(frozen=True, eq=False)
class Configurations:
    """The first `rows` points of a scrambled Sobol sequence between two corners.

    Owen (1998), Scrambling Sobol' and Niederreiter-Xing points, as scipy has it: any power of two of them fills the
    box evenly, and a longer sequence begins with the shorter one.

    Attributes:
        lower, upper: (nq,) corners [rad or m].
        rows: How many.
        seed: Of the scrambling.
        chunk: How many come together, a power of two.
    """

    lower: Array
    upper: Array
    rows: int
    seed: int
    chunk: int

    @property
    def sizes(self) -> list[int]:
        """Number of configurations in each chunk."""
        return [min(self.chunk, self.rows - first) for first in range(0, self.rows, self.chunk)]

    def chunks(self) -> Iterator[Array]:
        """Yield the (n, nq) configurations of every chunk, in order."""
        from scipy.stats import qmc  # takes half a second

        rng = np.random.default_rng(self.seed)
        sequence = qmc.Sobol(len(self.lower), seed=rng)  # pyright: ignore[reportCallIssue] - `rng` since SciPy 1.15
        for size in self.sizes:
            yield self.lower + (self.upper - self.lower) * sequence.random(self.chunk)[:size]


def drawn_range(arm: Arm) -> tuple[Array, Array, tuple[Flag, ...]]:
    """Return the (nq,) lowest and highest positions that are drawn, and flags: a continuous joint makes one turn."""
    lower, upper = arm.robot.lower.copy(), arm.robot.upper.copy()
    turning = np.array([joint.kind == "continuous" for joint in arm.robot.moving])
    lower[turning], upper[turning] = -np.pi, np.pi
    names = [joint.name for joint in arm.robot.moving if joint.kind == "continuous"]
    text = f"{listing(names)}: without limits, so drawn over one turn about zero"
    return lower, upper, (Flag("full_turn", text),) if names else ()


def furthest(arm: Arm, lower: Array, upper: Array) -> float:
    """Return a distance from the base that the tip is never beyond [m]."""
    slides = np.array([joint.kind == "prismatic" for joint in arm.robot.moving])
    travel = np.maximum(np.abs(lower), np.abs(upper))[slides].sum()
    return float(travel + sum(np.linalg.norm(joint.origin) for joint in arm.robot.chain))
