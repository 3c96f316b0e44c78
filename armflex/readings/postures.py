"""What instruments look at: an arm as it stands in some rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NoReturn, TypeVar

import numpy as np

from armflex.conventions import SMALLEST_STD, STANDARD_GRAVITY, Array
from armflex.readings.end import FIXED, End
from armflex.readings.instrument import Instrument
from armflex.readings.sensor import Sensor

About = TypeVar("About")


def _unasked(what: object) -> NoReturn:
    raise AssertionError(f"{what}: only the positions of the arm are known here")


@dataclass(frozen=True, eq=False)
class Postures:
    """An arm in N rows, and what looks at it.

    Attributes:
        pose: Gives the (N, 4, 4) pose of a link in the base [m] by its name; None is the tip.
        sessions: Of the rows.
        instrument: What looks at the tip from outside.
        sensors: What else there is, by name.
        gravity: (3,) in the base [m/s^2], or (N, 3) where the base was moved between rows.
        q: (N,) controller's position of every joint [rad or m].
        approach: (N,) direction that every joint last moved in: -1, 0 or 1.
        load: Gives the (N, 6) load on the structure at a site, local axes [N, Nm], by its name; see `Response.sites`.
        swing: Gives of a row the (m,) natural frequencies [Hz], the slowest first, and the (m, 6) motions of the tip in
            base axes, for unit modal mass [m, rad].
        place: Gives what people are shown as the place of a row.
        bend: (N, 2) or (1, 2) by how much the air bends lines of sight: what is read at a distance d is too high by the
            first times d^2 [1/m], and stars at a zenith distance z stand lower by the second times tan z [rad].
    """

    pose: Callable[[str | None], Array]
    sessions: Sequence[str]
    instrument: Instrument
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -STANDARD_GRAVITY]))
    q: Mapping[str, Array] = field(default_factory=dict)
    approach: Mapping[str, Array] = field(default_factory=dict)
    load: Callable[[str], Array] = _unasked
    swing: Callable[[int], tuple[Array, Array]] = _unasked
    place: Callable[[int], object] = lambda row: f"row {row}"
    bend: Array = field(default_factory=lambda: np.zeros((1, 2)))

    @cached_property
    def turns(self) -> Array:
        """(N, 3, 3) rotations from the instrument frame to that of each row's session, dimensionless."""
        return self.instrument.session_turns(self.sessions)

    @property
    def axes(self) -> Array:
        """(N, 3, 3) rotations from the base to the frame in which each row is read, dimensionless."""
        return self.turns @ self.instrument.pose.rotation

    @property
    def gravities(self) -> Array:
        """(N, 3) or (1, 3) gravity in the base [m/s^2]."""
        return np.atleast_2d(self.gravity)

    @property
    def up(self) -> Array:
        """(N, 3) or (1, 3) unit vectors against gravity in the base; zeros where there is none."""
        return -self.gravities / np.maximum(np.linalg.norm(self.gravities, axis=1, keepdims=True), 1e-300)

    def some(self, rows: np.ndarray) -> Postures:
        """Return the arm in (M,) of the rows."""
        q, approach = (
            {joint: values[rows] for joint, values in values_by_joint.items()}
            for values_by_joint in (self.q, self.approach)
        )
        return replace(
            self,
            pose=lambda link: self.pose(link)[rows],
            sessions=[self.sessions[i] for i in rows],
            gravity=self.gravity if self.gravity.ndim == 1 else self.gravity[rows],
            q=q,
            approach=approach,
            load=lambda site: self.load(site)[rows],
            swing=lambda row: self.swing(int(rows[row])),
            place=lambda row: self.place(int(rows[row])),
            bend=self.bend if len(self.bend) == 1 else self.bend[rows],
        )

    def end(self, name: str, of: str = "end") -> End:
        """Return where a sensor takes hold of the arm, or its "eye"; '' is the target that the instrument looks at."""
        if (name, of) not in self._ends:
            self._ends[name, of] = self._end(name, of)
        return self._ends[name, of]

    @cached_property
    def _ends(self) -> dict[tuple[str, str], End]:
        return {}

    def _end(self, name: str, of: str) -> End:
        if not name:
            mounted = self.instrument.target_in(self.sessions), self.instrument.mounting_in(self.sessions)
            return End(None, self.pose(None), *mounted)
        sensor = self.sensors[name]
        link = sensor.link if of == "end" else sensor.seen_from or FIXED
        pose = np.tile(np.eye(4), (len(self.sessions), 1, 1)) if link == FIXED else self.pose(link)
        moved = {nuisance.unit: self.of(name, nuisance.name) for nuisance in sensor.kind.nuisances if nuisance.of == of}
        none = np.zeros((len(pose), 3))
        return End(link, pose, moved.get("m", none), moved.get("rad", none))

    def line(self, name: str) -> tuple[End, End, Array, Array]:
        """Return a sensor's point and its eye, (N,) the length between them [m], and (N, 3) the way to the point."""
        end, eye = self.end(name), self.end(name, "eye")
        length = np.maximum(np.linalg.norm(end.place - eye.place, axis=1), SMALLEST_STD)
        return end, eye, length, (end.place - eye.place) / length[:, None]

    def about(self, name: str, of: type[About]) -> About:
        """Return what of a sensor its kind alone knows."""
        about = self.sensors[name].about
        assert isinstance(about, of)
        return about

    def of(self, name: str, nuisance: str) -> Array:
        """Return the (N, n) values of a sensor's nuisance in the rows, in its unit."""
        return self.sensors[name].of(nuisance, self.sessions)
