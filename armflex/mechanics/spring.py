"""Springs between points of two links: a balancer beside a lower arm, a gas strut.

A spring pulls its two points together with a tension that depends on their distance alone, so it has an energy.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from armflex.conventions import Array
from armflex.errors import InputError

SHORTEST = 1e-9
"""Length [m] below which a spring has no direction."""


@dataclass(frozen=True, kw_only=True)
class TensionLaw(ABC):
    """A tension by length.

    Attributes:
        found: What calibration found of `parameters`, in this order; zero as declared.
        strength: What is left of every tension, as a share: 0 of a spring that is broken.
        parameters: Names and units of what calibration may find of it.
    """

    found: tuple[float, ...] = (0.0,)
    strength: float = 1.0
    parameters: ClassVar[tuple[tuple[str, str], ...]]

    @property
    @abstractmethod
    def numbers(self) -> tuple[float, float, float]:
        """What the tension is made of, as it is."""

    @abstractmethod
    def tension(self, length: float) -> float:
        """Return what pulls the ends together [N]; below zero it pushes them apart."""

    @abstractmethod
    def rate(self, length: float) -> float:
        """Return the change of the tension with the length [N/m]."""

    @abstractmethod
    def by_found(self, length: Array) -> Array:
        """Return the (k, N) change of (N,) tensions per unit of what may be found."""


@dataclass(frozen=True)
class CoilSpring(TensionLaw):
    """A linear spring.

    Attributes:
        stiffness: [N/m].
        length: [m]; without a preload it is the free length.
        preload: Tension at `length` [N].
        found: By which share the rate is higher, and how much longer the spring is without load [m].
    """

    stiffness: float
    length: float
    preload: float = 0.0
    found: tuple[float, ...] = field(default=(0.0, 0.0), kw_only=True)
    parameters = (("rate", "1"), ("length", "m"))

    @property
    def numbers(self) -> tuple[float, float, float]:
        """Stiffness [N/m], length [m] and preload [N] as they are: the tension is preload + stiffness (L - length)."""
        return self.rate(0.0), self.length + self.found[1], self.strength * self.preload

    def tension(self, length: float) -> float:
        stiffness, at, preload = self.numbers
        return preload + stiffness * (length - at)

    def rate(self, length: float) -> float:
        return self.strength * self.stiffness * (1.0 + self.found[0])

    def by_found(self, length: Array) -> Array:
        rate = self.strength * self.stiffness
        return np.stack([rate * (length - self.length - self.found[1]), np.full_like(length, -self.rate(0.0))])


@dataclass(frozen=True)
class GasSpring(TensionLaw):
    """A column of gas between the ends, which it pushes apart: pressure x length^exponent stays what it is.

    Attributes:
        pressure: Over that of the surroundings, at `length` [Pa]; `found` is by which share it is higher.
        area: [m^2].
        length: Of the column, taken as the distance of the ends [m].
        exponent: 1 where the gas keeps its temperature, 1.4 where it keeps its heat.
    """

    pressure: float
    area: float
    length: float
    exponent: float = 1.0
    parameters = (("pressure", "1"),)

    @property
    def numbers(self) -> tuple[float, float, float]:
        """Thrust at the length [N], that [m] and the exponent, as they are."""
        return self.strength * self.pressure * (1.0 + self.found[0]) * self.area, self.length, self.exponent

    def tension(self, length: float) -> float:
        thrust, at, exponent = self.numbers
        return -thrust * (at / length) ** exponent

    def rate(self, length: float) -> float:
        return -self.exponent * self.tension(length) / length

    def by_found(self, length: Array) -> Array:
        return (-self.strength * self.pressure * self.area * (self.length / length) ** self.exponent)[None]


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

    def moved(self, step: Array) -> Spring:
        """Return the spring with what was found of it a step further; see `TensionLaw.found`."""
        return replace(self, law=replace(self.law, found=tuple((np.array(self.law.found) + step).tolist())))
