"""Springs between points of two links: a balancer beside a lower arm, a gas strut.

A spring pulls its two points together with a tension that depends on their distance alone, so it has an energy:
with d the way from one point to the other, L its length, T the tension and k = dT/dL,

    force on the first point   T d / L,   on the second its opposite
    change of it               K (moved_2 - moved_1),   K = k u u' + T/L (1 - u u'),   u = d / L
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import ConvergenceError, InputError


class End(NamedTuple):
    """One end of a spring in one thread's Pinocchio.

    Attributes:
        frame, joint: Its link's frame, and the Pinocchio joint that carries it.
        point: (3,) in the axes of that joint [m].
        lever: (6, 3) wrench on the joint per force at the point, axes of the joint.
        turn, place: (3, 3) and (3,) where the joint is [m]: views into Pinocchio's own memory.
        of_joint: (6, 6) body motion of the joint per one of the link.
    """

    frame: int
    joint: int
    point: Array
    lever: Array
    turn: Array
    place: Array
    of_joint: Array


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


class PlacedSprings:
    """The springs of an arm in one thread's Pinocchio of it."""

    def __init__(self, springs: Sequence[Spring], model: pin.Model, data: pin.Data) -> None:
        self.springs, self.model, self.data = tuple(springs), model, data
        self._ends: list[list[End]] = []
        for spring in self.springs:
            ends: list[End] = []
            for link, point in spring.ends:
                frame = model.getFrameId(link, pin.FrameType.BODY)
                joint, placement = model.frames[frame].parentJoint, model.frames[frame].placement
                placed, pose = placement.act(np.asarray(point, dtype=float)), data.oMi[joint]
                lever = np.vstack([np.eye(3), pin.skew(placed)])
                here = pose.rotation, pose.translation
                ends.append(End(frame, joint, placed, lever, *here, placement.action))
            self._ends.append(ends)

    def states(self) -> Array:
        """Return (n_springs, 2) of lengths [m] and tensions [N] where the joints are placed."""
        found = [(length, spring.law.tension(length)) for spring, (_, length, _) in self._drawn()]
        return np.array(found).reshape(-1, 2)

    def push(self, forces: pin.StdVec_Force) -> None:
        """Add what springs do to forces on Pinocchio's joints, in their axes, where the joints are placed."""
        for spring, (way, length, ends) in self._drawn():
            pull = spring.law.tension(length) / length * way
            for end, force in zip(ends, (pull, -pull), strict=True):
                forces[end.joint].vector[:] += end.lever.dot(force.dot(end.turn))

    def stiffness(self, configuration: Array) -> Array:
        """Return the (nv, nv) change of the torque per body motion, beyond that of forces in the joints' axes."""
        model, data, total = self.model, self.data, np.zeros((self.model.nv, self.model.nv))
        for spring, (way, length, ends) in self._drawn():
            tension, along = spring.law.tension(length), np.outer(way, way) / length**2
            moved, pull = [], tension / length * way
            for end, force in zip(ends, (pull, -pull), strict=True):
                # Of the world itself there is no motion.
                body = end.of_joint @ pin.computeFrameJacobian(model, data, configuration, end.frame, pin.LOCAL)
                shifted = end.lever.T @ body
                total -= shifted.T @ pin.skew(force.dot(end.turn)) @ body[3:]
                moved.append(end.turn @ shifted)
            apart = moved[1] - moved[0]
            total += apart.T @ (spring.law.rate(length) * along + tension / length * (np.eye(3) - along)) @ apart
        return total

    def _drawn(self) -> Iterator[tuple[Spring, tuple[Array, float, list[End]]]]:
        """Yield every spring with the way between its ends (3,) [m], its length [m] and the ends."""
        for spring, ends in zip(self.springs, self._ends, strict=True):
            first, second = ends
            way = second.turn.dot(second.point) + second.place - first.turn.dot(first.point) - first.place
            length = math.sqrt(way.dot(way))
            if not length > SHORTEST:
                raise ConvergenceError(f"spring {spring.name!r}: its ends meet, where it has no direction", ())
            yield spring, (way, length, ends)
