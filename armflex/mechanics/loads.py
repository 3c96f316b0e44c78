"""What the arm carries: payloads fixed to the tip, and external wrenches at named frames."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.conventions import Array, finite_array
from armflex.errors import InputError, PayloadError

if TYPE_CHECKING:
    cached_property = property  # as in `armflex.arm`
else:
    from functools import cached_property


@dataclass(frozen=True)
class Payload:
    """A body fixed to the tip.

    Attributes:
        mass: [kg], 0 or more.
        com: (3,) centre of mass in the tip frame [m].
        inertia: (6,) ixx iyy izz ixy ixz iyz about the centre of mass [kg m^2]; only motion needs it.

    Raises:
        PayloadError: Negative, not finite, or an inertia that no body has.
    """

    mass: float
    com: Array
    inertia: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", float(_vector(self.mass, "payload mass")))
        if self.mass < 0.0:
            raise PayloadError(f"payload mass is {self.mass}, expected 0 kg or more")
        object.__setattr__(self, "com", _vector(self.com, "payload com", 3))
        if self.inertia is not None:
            object.__setattr__(self, "inertia", _vector(self.inertia, "payload inertia", 6))
            _check_moments(self.inertia_matrix)

    @property
    def inertia_matrix(self) -> Array:
        """(3, 3) inertia about the centre of mass [kg m^2], zero when none is given."""
        if self.inertia is None:
            return np.zeros((3, 3))
        xx, yy, zz, xy, xz, yz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    @property
    def body(self) -> pin.Inertia:
        """The same as Pinocchio holds it."""
        inertia = self.inertia_matrix  # what rounding left of a moment of zero may be below it
        np.fill_diagonal(inertia, np.diag(inertia).clip(0.0))
        return pin.Inertia(self.mass, self.com, inertia)


class Load(Protocol):
    """A load from outside on one link, which may depend on where the link is."""

    @property
    def frame(self) -> str:
        """The link."""
        ...

    @property
    def dead(self) -> bool:
        """Whether the wrench is the same wherever the link is."""
        ...

    @property
    def sizes(self) -> tuple[float, float]:
        """Of force [N] and moment [N m], of a dead load."""
        ...

    def at(self, pose: Array) -> Array:
        """Return the (..., 6) wrench on the structure at the link's origin, base axes, for (..., 4, 4) poses of it."""
        ...

    def change(self, pose: Array) -> Array:
        """Return the (..., 6, 6) change of that wrench per shift and small rotation of the link, base axes."""
        ...


@dataclass(frozen=True)
class Wrench:
    """A constant load from outside, on the structure.

    Attributes:
        frame: Link at whose origin it acts.
        force: (3,) [N].
        moment: (3,) [N m].
        axes: "base" for fixed axes of the base (a dead load), "frame" for axes that turn with the link.
    """

    frame: str
    force: Array
    moment: Array
    axes: str = "base"

    def __post_init__(self) -> None:
        object.__setattr__(self, "force", finite_array(self.force, "force", (3,)))
        object.__setattr__(self, "moment", finite_array(self.moment, "moment", (3,)))
        if self.axes not in ("base", "frame"):
            raise InputError(f"wrench at {self.frame!r}: axes is {self.axes!r}, expected 'base' or 'frame'")

    @property
    def dead(self) -> bool:
        """Whether it does not turn with its link."""
        return self.axes == "base"

    @cached_property
    def sizes(self) -> tuple[float, float]:
        """Of force [N] and moment [N m]."""
        return math.hypot(*self.force.tolist()), math.hypot(*self.moment.tolist())

    @cached_property
    def _whole(self) -> Array:
        return np.concatenate([self.force, self.moment])

    def at(self, pose: Array) -> Array:
        """Return the (..., 6) wrench [N, Nm] at the link's origin in base axes."""
        if self.dead:
            return self._whole if pose.ndim == 2 else np.broadcast_to(self._whole, (*pose.shape[:-2], 6))
        return np.concatenate([pose[..., :3, :3] @ part for part in (self.force, self.moment)], axis=-1)

    def change(self, pose: Array) -> Array:
        """Return the (..., 6, 6) change per motion of the link [m, rad]: only a load that turns with it has one."""
        change = np.zeros((*pose.shape[:-2], 6, 6))
        if not self.dead:
            load = self.at(pose)[..., None, :]
            change[..., :3, 3:] = np.cross(load[..., :3], np.eye(3))
            change[..., 3:, 3:] = np.cross(load[..., 3:], np.eye(3))
        return change


def _vector(values: ArrayLike, name: str, *shape: int) -> Array:
    try:
        return finite_array(values, name, shape)
    except InputError as error:
        raise PayloadError(str(error)) from None


def _check_moments(matrix: Array) -> None:
    moments = np.linalg.eigvalsh(matrix)
    if moments[0] < -1e-9 * moments[2] or moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-6) + 1e-12:
        raise PayloadError(f"payload inertia has principal moments {moments.tolist()}, which no body has")


NO_PAYLOAD = Payload(0.0, np.zeros(3))
