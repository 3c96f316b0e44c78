"""What every kind of reading has to say of itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.conventions import Array
from armflex.declaration import Declaration
from armflex.readings.postures import Postures
from armflex.readings.sensor import Nuisance
from armflex.robot import Robot

Own = TypeVar("Own", bound="Kind")


@dataclass(frozen=True, eq=False)
class Kind(ABC):
    """The readings of one kind by one instrument in N rows, d numbers each.

    Motions of a link are of its origin in base axes, linear [m] before angular [rad].

    Attributes:
        values: (N, d) what was read, in `unit`; zero where nothing was.
        sigma: (N, d) one standard deviation of each number, in `unit`; infinite where a row has no such reading.
        name: Of the sensor that read it; '' is the instrument that looks at the tip.
    """

    values: Array
    sigma: Array
    name: str = ""

    dimension: ClassVar[int]
    """d."""

    unit: ClassVar[str]
    """SI unit of its numbers."""

    quantity: ClassVar[str]
    """Kind of quantity whose units a column's header may give; see `armflex.conventions.UNITS`."""

    channels: ClassVar[tuple[str, ...]]
    """What each number's column is called after the sensor's name; '' where there is only one."""

    framed: ClassVar[bool] = False
    """Whether it is read in the frame of the instrument that looks at the tip."""

    by_motion: ClassVar[bool] = True
    """Whether `jacobian` says all that it answers to; else a view takes difference quotients of `predicted`."""

    beside: ClassVar[tuple[str, ...]] = ()
    """Attributes that rows may give as whole numbers, in columns called after the sensor's name and theirs."""

    apart: ClassVar[int] = 0
    """How many of its numbers may be an outlier without the others; 0 where all are of one moment and one look."""

    positive: ClassVar[bool] = False
    """Whether only numbers above zero can be read."""

    nuisances: ClassVar[tuple[Nuisance, ...]] = ()
    """What of a sensor of this kind may have to be found."""

    @classmethod
    def unread(cls: type[Own], count: int, sigma: ArrayLike = 1.0, name: str = "", about: Any = None) -> Own:
        """Return readings still to be taken in `count` rows; their standard deviation is one or (d,), in its unit.

        `about` is of the sensor, where the kind needs it.
        """
        shape = (count, cls.dimension)
        return cls(np.zeros(shape), np.broadcast_to(np.asarray(sigma, dtype=float), shape), name)

    @classmethod
    def columns(cls, name: str) -> tuple[str, ...]:
        """Return what the columns of a sensor of this kind are called."""
        return tuple(f"{name}_{channel}" if channel else name for channel in cls.channels)

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> tuple[str | None, Any] | None:
        """Return the link that a sensor is on and its `about`, from keys of this kind alone; None where it has none.

        The link is None where the key `link` has it, as of most kinds.
        """
        return None

    @property
    def headers(self) -> tuple[str, ...]:
        """Names of (d,) columns that hold its numbers."""
        return self.columns(self.name)

    @property
    def title(self) -> str:
        """What people are shown: 'wire1 (distance)'."""
        words = "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in type(self).__name__).strip()
        return f"{self.name} ({words})" if self.name else words

    def some(self: Own, rows: np.ndarray) -> Own:
        """Return the readings of (M,) rows."""
        return replace(self, values=self.values[rows], sigma=self.sigma[rows])

    def scaled(self: Own, factor: float) -> Own:
        """Return the readings with their standard deviations times a factor."""
        return replace(self, sigma=factor * self.sigma)

    @property
    def look(self: Own) -> Own:
        """The readings with as many numbers left as a look has degrees of freedom, of kinds that read more."""
        return self

    @abstractmethod
    def predicted(self, at: Postures) -> Array:
        """Return the (N, d) numbers that the instrument would read, in `unit`."""

    def residual(self, at: Postures) -> Array:
        """Return (N, d) what was read minus what would be read, in `unit`; zero where nothing was."""
        return np.where(np.isfinite(self.sigma), self.values - self.predicted(at), 0.0)

    @abstractmethod
    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return by link the (N, d, 6) change of a reading per motion [m, rad] of each it sees; None is the tip."""

    def by_shift(self, at: Postures) -> Array:
        """Return (N, d) how far each number changes, in `unit`, as what it sees is shifted any way [per m]."""
        return np.ones(self.values.shape)

    def by_gravity(self, at: Postures) -> Array:
        """Return (N, d, 3) change per gravity in the base [m/s^2], the arm held where it is."""
        return np.zeros((*self.values.shape, 3))

    def by_frame(self, at: Postures) -> Array:
        """Return (N, d, 6) change per shift [m] and rotation vector [rad] of the instrument's frame."""
        return np.zeros((*self.values.shape, 6))

    def by_scale(self, at: Postures) -> Array:
        """Return (N, d) change, in `unit`, per share by which the instrument's distances are too long."""
        return np.zeros(self.values.shape)

    def by_target(self, at: Postures) -> Array:
        """Return (N, d, 3) change per shift [m] of the instrument's target in the tip frame."""
        return np.zeros((*self.values.shape, 3))

    def by_mounting(self, at: Postures) -> Array:
        """Return (N, d, 3) change per rotation vector [rad] of the instrument's target on the tool, in tip axes."""
        return np.zeros((*self.values.shape, 3))

    def by_own(self, at: Postures) -> Array:
        """Return (N, d, K) change per nuisance of the sensor, all of them in order and their units."""
        return np.zeros((*self.values.shape, 0))

    @property
    def texts(self) -> tuple[str, ...] | None:
        """(N,) the cells of its column where they are texts, () where it has no column, None where they are numbers."""
        return None

    def by_key(self, at: Postures, key: str) -> Array:
        """Return (N, d, K) as `by_own`, of the nuisances of one session, '' all of them; of another key zero."""
        own = np.array([key in ("", one) for one in at.sessions], dtype=bool)
        return self.by_own(at) * own[:, None, None]

    def begun(self, at: Postures, key: str) -> Array | None:
        """Return (K,) as `start`, of one session, '' all of them; None where it says nothing of that."""
        rows = np.flatnonzero([key in ("", one) for one in at.sessions])
        return self.some(rows).start(at.some(rows))

    def readable(self, at: Postures) -> np.ndarray:
        """Return (N,) where the instrument is within its range, or (N, d) of every number."""
        return np.ones(len(self.values), dtype=bool)

    def start(self, at: Postures) -> Array:
        """Return (K,) deviations of the nuisances, in their units, from which a fit may begin."""
        return np.zeros(sum(len(one.axes) for one in self.nuisances))

    def elsewhere(self, at: Postures) -> str | None:
        """Return where the instrument might stand instead, for the same readings; None where that is no question."""
        return None


def point_of(at: Postures, link: str | None, own: Array) -> tuple[Array, Array]:
    """Return the (N, 3) place in the base [m] of (N, 3) points of a link, and its (N, 3, 6) change with its motion."""
    pose = at.pose(link)
    lever = np.einsum("nij,nj->ni", pose[:, :3, :3], own)
    return pose[:, :3, 3] + lever, rigid_motion(lever)


def mounted(at: Postures, link: str | None, vectors: Array) -> tuple[Array, Array]:
    """Return the (N, 3, 3) axes in the base of what is turned by (N, 3) rotation vectors [rad] on a link, and what
    small rotations in those axes come of changes of the vectors, (N, 3, 3).
    """
    unique, back = np.unique(vectors, axis=0, return_inverse=True)
    turns = np.array([pin.exp3(vector) for vector in unique]).reshape(-1, 3, 3)
    changes = np.array([pin.Jexp3(vector) for vector in unique]).reshape(-1, 3, 3)
    return at.pose(link)[:, :3, :3] @ turns[back.ravel()], changes[back.ravel()]


def rigid_motion(points: Array) -> Array:
    """Return the (N, 3, 6) change of (N, 3) points per shift [m] and rotation vector [rad] about the origin."""
    return np.concatenate([np.broadcast_to(np.eye(3), (len(points), 3, 3)), -skew(points)], axis=2)


def skew(vectors: Array) -> Array:
    """Return the (N, 3, 3) matrices whose product with another vector is the cross product with (N, 3) vectors."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
