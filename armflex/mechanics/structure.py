"""What mechanics needs to know of an arm; `armflex.Arm` is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from numpy.typing import ArrayLike

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.mechanics.laws import LawStack
from armflex.mechanics.loads import Load, Payload
from armflex.robot import Corrections, Robot, Site

if TYPE_CHECKING:
    from armflex.mechanics.loaded import LoadedArm


@dataclass(frozen=True)
class Names:
    """What the rows and columns of a result stand for, and the frames it is meant in."""

    joints: tuple[str, ...]
    flexures: tuple[str, ...]
    base: str
    tip: str


class Structure(Protocol):
    """A manipulator with flexures, immutable.

    Attributes:
        robot: The validated robot.
        corrections: Constant errors of its kinematics, bodies included.
        payload_rating: Heaviest rated payload [kg], None when not stated.
        flags: Doubts about it as declared.
        sites: Of its flexures, in order; `stack` has their laws.
        pulls: Loads on its links.
        names: Of joints and flexures, base and tip.
        joint_index: Place of every joint in q.
        bounds: Least and largest positions of all joints that are within their limits and of sensible size.
        link_names: Links at and beyond the base.
        weight: Of everything that moves [N].
    """

    @property
    def robot(self) -> Robot: ...
    @property
    def corrections(self) -> Corrections: ...
    @property
    def payload_rating(self) -> float | None: ...
    @property
    def flags(self) -> tuple[Flag, ...]: ...
    @property
    def sites(self) -> tuple[Site, ...]: ...
    @property
    def stack(self) -> LawStack: ...
    @property
    def pulls(self) -> Sequence[Load]: ...
    @property
    def names(self) -> Names: ...
    @property
    def joint_names(self) -> tuple[str, ...]: ...
    @property
    def joint_index(self) -> dict[str, int]: ...
    @property
    def bounds(self) -> tuple[list[float], list[float]]: ...
    @property
    def link_names(self) -> tuple[str, ...]: ...
    @property
    def weight(self) -> float: ...

    def payload(self, payload: str | Payload | None) -> Payload:
        """Return a payload by name."""
        ...

    def loaded(self, payload: str | Payload | None) -> LoadedArm:
        """Return the arm with a payload, whose models are kept."""
        ...

    def check_position(self, q: ArrayLike, enforce_limits: bool = True) -> tuple[Array, tuple[Flag, ...]]:
        """Return q as (nq,) floats with the doubts about it."""
        ...

    def checked(self, values: ArrayLike, name: str) -> Array:
        """Return a copy of a number for each joint."""
        ...
