"""What a learned law is made of: parts with parameters, whose twists add up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from armflex.conventions import Array
from armflex.laws.law import Law, Row


@dataclass(frozen=True)
class Group:
    """Parameters whose values are of one size beforehand.

    Attributes:
        name: What they are.
        labels: One name for each, without blanks.
        std: Prior standard deviation of each, or where the search for it starts.
        found: Whether the data say how large they are: the scale with the largest evidence is taken.
    """

    name: str
    labels: tuple[str, ...]
    std: float
    found: bool


class Part(Protocol):
    """A twist under a load that depends on k values; without dimension and of size 1 or less where it makes sense."""

    @property
    def groups(self) -> tuple[Group, ...]:
        """The parameters, in the order of the values."""
        ...

    @property
    def start(self) -> Array:
        """(k,) values where learning starts: the part as it was declared."""
        ...

    def twist(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the (..., 6) twist under a (..., 6) wrench."""
        ...

    def tangent(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return its (..., 6, 6) derivative by the wrench."""
        ...

    def by_values(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return its (..., 6, k) derivative by the values."""
        ...

    def law(self, values: Array) -> Law | None:
        """Return the part as a law of another kind that solvers know better, None where there is none."""
        ...


class OfPart:
    """What is the same of a part that stands for another."""

    part: Part

    @property
    def groups(self) -> tuple[Group, ...]:
        """The part's."""
        return self.part.groups

    @property
    def start(self) -> Array:
        """The part's."""
        return self.part.start
