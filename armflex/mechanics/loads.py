"""What loads an arm beside its weight: payloads fixed to the tip, and what a load on one of its links is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.conventions import Array, finite_array
from armflex.errors import InputError, PayloadError


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
