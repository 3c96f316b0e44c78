"""An instrument beside the tracker, as [instrument.NAME] declares it: its place, what of it is open, what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import Array

if TYPE_CHECKING:
    from armflex.readings.kind import Kind

LONGEST = {"m": 10.0, "rad": 3.2, "px": 1e4, "m/s^2": 100.0, "N": 1e6, "Nm": 1e6, "Hz": 100.0, "1": 0.5}
"""By unit a standard deviation beyond which a number is in another one; sensors stand in the order of these."""

AXES = ("x", "y", "z")
TURNS = ("rx", "ry", "rz")


@dataclass(frozen=True)
class Nuisance:
    """Numbers of an instrument itself that a campaign may have to find, freed by `NAME_std` in its declaration.

    Attributes:
        name: What they are: 'anchor', 'bias'.
        axes: One word each, '' for the only one.
        unit: SI unit of each.
        of: What they do: they shift [m] or turn [rad] an "end" of it on the arm, or the "eye" that looks at that; the
            "gain" stretches what it reads, and the "zero" is added then; '' of what its kind alone knows.
        anywhere: Whether it is found wherever it is, where neither it nor its `NAME_std` is declared.
        spare: How many of the last of them are often left out.
    """

    name: str
    axes: tuple[str, ...]
    unit: str
    of: str = ""
    anywhere: bool = False
    spare: int = 0


ANCHOR, LOOKS = Nuisance("anchor", AXES, "m", "eye"), Nuisance("mounting", TURNS, "rad", "eye")
POINT, MOUNTING = Nuisance("point", AXES, "m", "end"), Nuisance("mounting", TURNS, "rad", "end")
SCALE = Nuisance("scale", ("",), "1", "gain")


def zero_of(axes: tuple[str, ...], unit: str, name: str = "bias") -> Nuisance:
    """Return what is added to each number of a reading."""
    return Nuisance(name, axes, unit, "zero")


@dataclass(frozen=True, eq=False)
class Sensor:
    """One of them.

    Attributes:
        name: By which columns call it.
        kind: What it reads.
        link: Where on the arm.
        sigma: One standard deviation of a reading, in the kind's unit.
        declared: (K,) value of every nuisance of its kind, in their order and units.
        std: (K,) prior standard deviations about them, in their units; 0 keeps one as declared.
        found: (K,) deviations from what is declared, in their units, by session; '' is every one that has none.
        seen_from: The link that it stands on or looks from; None is the base.
        about: What its kind alone declares, see `Kind.declared`.
    """

    name: str
    kind: type[Kind]
    link: str
    sigma: float
    declared: Array
    std: Array
    found: Mapping[str, Array] = field(default_factory=dict)
    seen_from: str | None = None
    about: Any = None

    def keys(self, sessions: Sequence[str], touched: Sequence[str]) -> tuple[str, ...]:
        """Return what has numbers of its own that are to be found: sessions, '' where there is one."""
        every = tuple(dict.fromkeys(sessions)) if len(set(sessions)) > 1 else ("",)
        return every if len(self.free) else ()

    def std_in(self, key: str) -> Array:
        """Return (K,) as `std`, of one key, in their units."""
        return self.std

    def free_in(self, key: str) -> np.ndarray:
        """Return (k,) as `free`, of one key."""
        return np.flatnonzero(self.std_in(key))

    def unread(self, count: int, sigma: ArrayLike | None = None) -> Kind:
        """Return its readings that are still to be taken in `count` rows; see `Kind.unread`."""
        return self.kind.unread(count, self.sigma if sigma is None else sigma, self.name, self.about)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns that it may have: those of `Kind.columns`, and those that hold its numbers."""
        return tuple(dict.fromkeys((*self.kind.columns(self.name), *self.unread(0).headers)))

    @property
    def foreseen(self) -> bool:
        """Whether there is something to say of what it will read: not of a camera that may be anywhere."""
        unknown = [
            nuisance.anywhere * LONGEST[nuisance.unit] or np.inf
            for nuisance in self.kind.nuisances
            for _ in nuisance.axes
        ]
        return bool(self.found) or bool(np.all(self.std < unknown))

    @property
    def free(self) -> np.ndarray:
        """(k,) places among the K numbers of those that a campaign has to find."""
        return np.flatnonzero(self.std)

    @property
    def movable(self) -> np.ndarray:
        """(k,) places among the K numbers of those that change where a sensor is set up otherwise."""
        fixed = ("point", "scale")
        names = [nuisance.name for nuisance in self.kind.nuisances for _ in nuisance.axes]
        return np.flatnonzero([name not in fixed for name in names])

    @property
    def labels(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of each of the K numbers: 'anchor x'."""
        return tuple(
            (f"{nuisance.name} {axis}".strip(), nuisance.unit)
            for nuisance in self.kind.nuisances
            for axis in nuisance.axes
        )

    def of(self, name: str, sessions: Sequence[str]) -> Array:
        """Return the (N, n) values of a nuisance in rows of N sessions, or other keys, in its unit."""
        which = [nuisance.name == name for nuisance in self.kind.nuisances for _ in nuisance.axes]
        values = {session: self._at(session)[which] for session in dict.fromkeys(sessions)}
        return np.array([values[session] for session in sessions]).reshape(len(sessions), sum(which))

    def _at(self, session: str) -> Array:
        """Return the (K,) values of all nuisances in a session."""
        return self.declared + self.deviations(session)

    def deviations(self, session: str) -> Array:
        """Return the (K,) deviations found in a session, in their units; those of all others where it has none."""
        return self.found.get(session, self.found.get("", np.zeros(len(self.declared))))

    def moved(self, session: str, step: Array) -> Sensor:
        """Return the sensor with (k,) steps of what is free, in its units, added to what was found in a session."""
        deviation = self.deviations(session).copy()
        deviation[self.free_in(session)] += step
        return replace(self, found={**self.found, session: deviation})
