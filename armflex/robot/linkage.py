"""What a tree of links cannot say: links joined once more, joints without a drive, and driven lengths between pins."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.errors import Place
from armflex.robot.urdf import Joint

KINDS = ("revolute", "spherical", "cylindrical", "fixed")


@dataclass(frozen=True, eq=False)
class Loop:
    """Two links joined once more at a point.

    Attributes:
        name: Its name.
        link, to: The links.
        at, at_to: (3,) the point, in the frames of both [m].
        kind: One of `KINDS`: what the joint leaves free.
        axis: (3,) unit axis of a revolute or cylindrical joint, in the frame of `link`.
        turn_to: (3, 3) the axes of `link` in the frame of `to` where the joint closes, free turns apart.
    """

    name: str
    link: str
    at: Array
    to: str
    at_to: Array
    kind: str
    axis: Array
    turn_to: Array


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A driven length between two pins, each of which turns freely.

    Attributes:
        name: Its name, and that of the column of its length.
        link, to: The links.
        at, at_to: (3,) the pins, in the frames of their links [m].
        lower, upper: Least and greatest length [m].
        effort: Greatest force [N], infinite where it is not given.
        place: Where it is declared.
    """

    name: str
    link: str
    at: Array
    to: str
    at_to: Array
    lower: float
    upper: float
    effort: float
    place: Place

    @cached_property
    def joint(self) -> Joint:
        """A sliding joint along x in axes of its own, for everything that asks about drives."""
        ends, x = (self.link, self.to), np.array([1.0, 0.0, 0.0])
        limits = (self.lower, self.upper, self.effort, np.inf)
        return Joint(self.name, "prismatic", *ends, np.zeros(3), np.eye(3), x, *limits, None, self.place)


@dataclass(frozen=True, eq=False)
class Linkage:
    """What makes a mechanism of a tree.

    Attributes:
        passive: Joints without a drive, with where they are near at the first row [rad or m], None where nobody says.
        beside: Joints off the chain that move, with and without a drive.
        loops, cylinders: What joins links once more.
        followers: Joints that a gear or a belt ties to another: its name, the factor and the offset [rad or m].
    """

    passive: Mapping[str, float | None] = field(default_factory=dict)
    beside: tuple[Joint, ...] = ()
    loops: tuple[Loop, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    followers: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        """Whether anything closes or is without a drive."""
        return bool(self.closures or self.passive)

    @cached_property
    def free(self) -> dict[str, float | None]:
        """Joints whose positions follow from the others, with where they are near at the first row [rad or m]."""
        return {**self.passive, **dict.fromkeys(self.followers)}

    @cached_property
    def pins(self) -> tuple[str, ...]:
        """Names of the pins of loops and cylinders: that on `link` has the name, that on `to` the name and `:to`."""
        return tuple(
            name for closure in (*self.loops, *self.cylinders) for name in (closure.name, f"{closure.name}:to")
        )

    @cached_property
    def joined(self) -> tuple[str, ...]:
        """Names of loops and cylinders."""
        return tuple(closure.name for closure in (*self.loops, *self.cylinders))

    @cached_property
    def closures(self) -> tuple[str, ...]:
        """Names of what closes: loops, cylinders, followers."""
        return (*self.joined, *self.followers)
