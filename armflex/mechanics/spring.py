"""Springs between points of two links: a balancer beside a lower arm, a gas strut.

A spring pulls its two points together with a tension that depends on their distance alone, so it has an energy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from armflex.conventions import Array
from armflex.errors import InputError

SHORTEST = 1e-9
"""Length [m] below which a spring has no direction."""


class TensionLaw(Protocol):
    """A tension by length."""

    def tension(self, length: float) -> float:
        """Return what pulls the ends together [N]; below zero it pushes them apart."""
        ...

    def rate(self, length: float) -> float:
        """Return the change of the tension with the length [N/m]."""
        ...


@dataclass(frozen=True)
class CoilSpring:
    """A linear spring.

    Attributes:
        stiffness: [N/m].
        preload: Tension at `length` [N].
        length: [m]; without a preload it is the free length.
    """

    stiffness: float
    length: float
    preload: float = 0.0

    def tension(self, length: float) -> float:
        """See `TensionLaw`."""
        return self.preload + self.stiffness * (length - self.length)

    def rate(self, length: float) -> float:
        """See `TensionLaw`."""
        return self.stiffness


@dataclass(frozen=True)
class GasSpring:
    """A column of gas between the ends, which it pushes apart: pressure x length^exponent stays what it is.

    Attributes:
        pressure: Over that of the surroundings, at `length` [Pa].
        area: [m^2].
        length: Of the column, taken as the distance of the ends [m].
        exponent: 1 where the gas keeps its temperature, 1.4 where it keeps its heat.
    """

    pressure: float
    area: float
    length: float
    exponent: float = 1.0

    def tension(self, length: float) -> float:
        """See `TensionLaw`."""
        return -self.pressure * self.area * (self.length / length) ** self.exponent

    def rate(self, length: float) -> float:
        """See `TensionLaw`."""
        return -self.exponent * self.tension(length) / length


@dataclass(frozen=True, eq=False)
class Spring:
    """A spring between a point of one link and a point of another.

    Attributes:
        name: Its name.
        link, to: The links.
        at, at_to: (3,) the points, in the frames of their links [m].
        law: Its tension by length.
    """

    name: str
    link: str
    at: Array
    to: str
    at_to: Array
    law: TensionLaw

    def __post_init__(self) -> None:
        if self.link == self.to:
            raise InputError(f"spring {self.name!r} has both ends on link {self.link!r}: it moves nothing")

    @property
    def ends(self) -> tuple[tuple[str, Array], tuple[str, Array]]:
        """Links and the points of them."""
        return (self.link, self.at), (self.to, self.at_to)
