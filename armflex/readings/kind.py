"""What every kind of reading has to say of itself."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import SHOWN, SMALLEST_STD, Array, Shown
from armflex.declaration import Declaration
from armflex.readings.end import FIXED, End
from armflex.readings.postures import Postures
from armflex.readings.sensor import LONGEST, Nuisance, Sensor
from armflex.robot import Robot

Own = TypeVar("Own", bound="Kind")

Ends = Mapping[str, tuple[End, Array]]
"""Where an instrument takes hold of the arm, "end" and "eye", each with the (N, d, 6) change of a number per motion of
its point, base axes [m, rad]."""

FURTHEST = 50.0
"""Distance from the base [m], beyond the arm's reach, that nothing has that is read."""


@dataclass(frozen=True, eq=False)
class Kind(ABC):
    """The readings of one kind by one instrument in N rows, d numbers each.

    Motions of a link are of its origin in base axes, linear [m] before angular [rad].

    Attributes:
        values: (N, d) what was read, in `unit`; zero where nothing was.
        sigma: (N, d) one standard deviation of each number, in `unit`; infinite where a row has no such reading.
        name: Of the sensor that read it; '' is the instrument that looks at the tip.
    """

    values: Array = field(repr=False)
    sigma: Array = field(repr=False)
    name: str = ""

    dimension: ClassVar[int]
    """d."""

    unit: ClassVar[str]
    """SI unit of its numbers."""

    quantity: ClassVar[str]
    """Kind of quantity whose units a column's header may give; see `armflex.conventions.UNITS`."""

    shown: ClassVar[Shown | None] = None
    """The unit in which people are shown its errors, and its factor; None of what `SHOWN` has for its SI unit."""

    channels: ClassVar[tuple[str, ...]]
    """What each number's column is called after the sensor's name; '' where there is only one."""

    framed: ClassVar[bool] = False
    """Whether it is read in the frame of the instrument that looks at the tip."""

    far: ClassVar[bool] = False
    """Whether it reads something far away, the same from wherever the arm is."""

    by_motion: ClassVar[bool] = True
    """Whether `jacobian` says all that it answers to; else a view takes difference quotients of `predicted`."""

    beside: ClassVar[tuple[str, ...]] = ()
    """Attributes that rows may give as whole numbers, in columns called after the sensor's name and theirs."""

    apart: ClassVar[int] = 0
    """How many of its numbers may be an outlier without the others; 0 where all are of one moment and one look."""

    positive: ClassVar[bool] = False
    """Whether only numbers above zero can be read."""

    most: ClassVar[tuple[float, ...]] = ()
    """The largest size of each of its numbers, in `unit`; () where nothing bounds them."""

    sensor: ClassVar[type[Sensor]] = Sensor
    """What reads it."""

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
    def instead(cls, name: str) -> tuple[str, ...]:
        """Return columns that a campaign may have instead of `columns`, numbers without a unit; () for none."""
        return ()

    @classmethod
    def of_instead(cls, values: Array, about: Any) -> tuple[Array, np.ndarray]:
        """Return the (N, d) numbers that columns of `instead` stand for, and (N,) where these are such at all."""
        raise NotImplementedError(f"{cls.__name__} has no other columns")

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return by name what of a `Sensor` the keys of its table say that only its kind knows: its link at least."""
        return {"link": link_in(table, "link", robot)}

    @classmethod
    def stated(cls, nuisance: Nuisance, table: Declaration, robot: Robot) -> tuple[Array, float]:
        """Return (n,) what a table says of a nuisance, and one standard deviation, in its unit; 0 keeps it so."""
        value, key = np.zeros(len(nuisance.axes)), f"{nuisance.name}_std"
        if len(nuisance.axes) == 1:
            value[:] = table.number(nuisance.name, 0.0)
        elif table.has(nuisance.name):
            given = table.numbers(nuisance.name, *((len(nuisance.axes) - less,) for less in range(nuisance.spare + 1)))
            value[: len(given)] = given
        std = table.std(key, LONGEST[nuisance.unit] if nuisance.anywhere and not table.has(nuisance.name) else 0.0)
        if 0.0 < std < SMALLEST_STD or std > LONGEST[nuisance.unit]:
            expected = f"expected a standard deviation [{nuisance.unit}] up to {LONGEST[nuisance.unit]:g}"
            raise table.fail(key, f"{expected}, got {std:g}")
        return value, std

    @property
    def exact(self) -> int:
        """How many of its numbers cannot be wrong, and are no readings."""
        return 0

    @property
    def headers(self) -> tuple[str, ...]:
        """Names of (d,) columns that hold its numbers."""
        return self.columns(self.name)

    @property
    def shown_in(self) -> Shown:
        """The unit in which people are shown its errors, and its factor."""
        return self.shown or SHOWN[self.unit]

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
    def ideal(self, at: Postures) -> Array:
        """Return the (N, d) numbers that the instrument would read with no zero and a gain of one, in `unit`."""

    def ends(self, at: Postures) -> Ends:
        """Return where it takes hold of the arm, and how the `ideal` numbers answer to motions there."""
        return {}

    def others(self, at: Postures) -> Mapping[str, Array]:
        """Return by name the (N, d, n) change of a reading per nuisance that is no end's, no gain and no zero."""
        return {}

    def gain(self, at: Postures) -> Array:
        """Return (N, 1) by how much the instrument stretches what it reads, dimensionless."""
        names = [nuisance.name for nuisance in self.nuisances if nuisance.of == "gain"]
        return 1.0 + at.of(self.name, names[0]) if names else np.ones((len(self.values), 1))

    def predicted(self, at: Postures) -> Array:
        """Return the (N, d) numbers that the instrument would read, in `unit`."""
        zeros = [at.of(self.name, nuisance.name) for nuisance in self.nuisances if nuisance.of == "zero"]
        return sum(zeros, self.gain(at) * self.ideal(at))

    def residual(self, at: Postures) -> Array:
        """Return (N, d) what was read minus what would be read, in `unit`; zero where nothing was."""
        return np.where(np.isfinite(self.sigma), self.values - self.predicted(at), 0.0)

    def jacobian(self, at: Postures) -> Mapping[str | None, Array]:
        """Return by link the (N, d, 6) change of a reading per motion [m, rad] of each it sees; None is the tip."""
        jacobians: dict[str | None, Array] = {}
        for end, change in self.ends(at).values():
            if end.link != FIXED:
                jacobians[end.link] = jacobians.get(end.link, 0.0) + end.by_link(self.gain(at)[..., None] * change)
        return jacobians

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

    def by_bend(self, at: Postures) -> Array:
        """Return (N, d, 2) change per curvature of the line of sight [1/m] and per bending of it by the tangent of the
        zenith distance [rad].
        """
        return np.zeros((*self.values.shape, 2))

    def by_target(self, at: Postures) -> Array:
        """Return (N, d, 3) change per shift [m] of the instrument's target in the tip frame."""
        changes = [end.by_shift(change) for end, change in self.ends(at).values() if end.link is None]
        return sum(changes, np.zeros((*self.values.shape, 3)))

    def by_mounting(self, at: Postures) -> Array:
        """Return (N, d, 3) change per rotation vector [rad] of the instrument's target on the tool, in tip axes."""
        ends = self.ends(at).values()
        changes = [change[:, :, 3:] @ end.pose[:, :3, :3] for end, change in ends if end.link is None]
        return sum(changes, np.zeros((*self.values.shape, 3)))

    def by_own(self, at: Postures) -> Array:
        """Return (N, d, K) change per nuisance of the sensor, all of them in order and their units.

        Raises:
            NotImplementedError: `others` lacks a nuisance that is no end's, no gain and no zero.
        """
        changes, gain, ends, others = [np.zeros((*self.values.shape, 0))], self.gain(at), self.ends(at), self.others(at)
        for nuisance in self.nuisances:
            if nuisance.of in ends:
                end, change = ends[nuisance.of]
                moved = end.by_shift(change) if nuisance.unit == "m" else end.by_turn(change)
                changes.append(gain[..., None] * moved)
            elif nuisance.of == "zero":
                changes.append(np.broadcast_to(np.eye(len(nuisance.axes)), (*self.values.shape, len(nuisance.axes))))
            elif nuisance.of == "gain":
                changes.append(self.ideal(at)[..., None])
            elif nuisance.name in others:
                changes.append(others[nuisance.name])
            else:
                raise NotImplementedError(f"{type(self).__name__}.others does not say how {nuisance.name!r} changes it")
        return np.concatenate(changes, axis=2)

    @property
    def texts(self) -> tuple[str, ...] | None:
        """(N,) the cells of its column where they are texts, () where it has no column, None where they are numbers."""
        return None

    def by_key(self, at: Postures, key: str) -> Array:
        """Return (N, d, K) as `by_own`, of the nuisances of one session, '' all of them; of another key zero."""
        of_key = np.array([key in ("", session) for session in at.sessions], dtype=bool)
        return self.by_own(at) * of_key[:, None, None]

    def begun(self, at: Postures, key: str) -> Array | None:
        """Return (K,) as `start`, of one session, '' all of them; None where it says nothing of that."""
        rows = np.flatnonzero([key in ("", session) for session in at.sessions])
        return self.some(rows).start(at.some(rows))

    def readable(self, at: Postures) -> np.ndarray:
        """Return (N,) where the instrument is within its range, or (N, d) of every number."""
        return np.ones(len(self.values), dtype=bool)

    def start(self, at: Postures) -> Array:
        """Return (K,) deviations of the nuisances, in their units, from which a fit may begin."""
        return np.zeros(sum(len(nuisance.axes) for nuisance in self.nuisances))

    def elsewhere(self, at: Postures) -> str | None:
        """Return where the instrument might stand instead, for the same readings; None where that is no question."""
        return None


def link_in(table: Declaration, key: str, robot: Robot, other: str | None = None) -> str:
    """Return the link that a key of an instrument's table names, which is not the `other` that it already is on."""
    link = table.choice(key, robot.urdf.below(robot.base), problem="the arm has no link {!r}")
    if link == other:
        raise table.fail(key, f"{link!r} is the link itself: nothing moves between the two")
    return link
