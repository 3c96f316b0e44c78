"""A point of the arm put into sockets, onto planes or onto spheres: it reads that there is no gap.

What the point is put into is called a socket here, whatever its shape. Sockets hold for a whole campaign, not for a
session: each has a place of its own to be found, named by the text in the instrument's column.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from armflex.conventions import SMALLEST_STD, Array
from armflex.declaration import Declaration
from armflex.errors import shown
from armflex.readings.end import End, shifted
from armflex.readings.kind import FURTHEST, Ends, Kind, link_in
from armflex.readings.plane import Plane
from armflex.readings.postures import Postures
from armflex.readings.sensor import AXES, LONGEST, POINT, Nuisance, Sensor
from armflex.robot import Robot

CARRIED, FEWEST = 20, 3
"""Rows that a known distance is spread over, one of so many and so many at least, so that no part of a campaign is
without it."""

SHAPES = ("point", "plane", "sphere")
"""Of what a point is put into, or onto."""


@dataclass(frozen=True, eq=False)
class Sockets:
    """What is known of the sockets before they are touched; one that is not named is a point whose place is unknown.

    Attributes:
        place: (3,) in the base [m]: of the point, of a point of the plane, of the sphere's centre.
        place_std: One standard deviation of those, each axis [m]; of a plane along its normal, and of its tilt [rad].
        shape: "point", "plane" or "sphere", by name.
        radius: Of spheres, the touching ball's in it [m].
        normal: (3,) of planes in the base, dimensionless; z where not given.
        distances: Pairs of points and the known distance between them [m].
        distance_sigma: One standard deviation of those [m].
        own_point: Whether the touching point is the instrument's own, rather than the target in the tip frame.
    """

    place: Mapping[str, Array] = field(default_factory=dict)
    place_std: float = 0.0
    shape: Mapping[str, str] = field(default_factory=dict)
    radius: Mapping[str, float] = field(default_factory=dict)
    normal: Mapping[str, Array] = field(default_factory=dict)
    distances: tuple[tuple[str, str, float], ...] = ()
    distance_sigma: float = 1e-4
    own_point: bool = False

    def declared(self, socket: str) -> Array:
        """Return (3,) numbers of a socket before anything is found: its place [m]; of a plane height and two tilts."""
        place = np.asarray(self.place.get(socket, np.zeros(3)), dtype=float)
        if self.of_shape(socket) != "plane":
            return place
        return np.array([place @ self.plane(socket).axes[:, 2], 0.0, 0.0])

    def std(self, socket: str) -> Array:
        """Return (3,) prior standard deviations about them; infinite where nobody measured the place."""
        return np.full(3, self.place_std if socket in self.place else np.inf)

    def of_shape(self, socket: str) -> str:
        """Return "point", "plane" or "sphere"."""
        return self.shape.get(socket, "point")

    def plane(self, socket: str) -> Plane:
        """Return where a plane is declared to face."""
        return Plane(self.normal.get(socket, np.array([0.0, 0.0, 1.0])))


@dataclass(frozen=True, eq=False)
class TouchingSensor(Sensor):
    """An instrument that touches sockets: its numbers are by socket, and '' is the touching point."""

    sockets: Sockets = field(default_factory=Sockets)

    def keys(self, sessions: Sequence[str], touched: Sequence[str]) -> tuple[str, ...]:
        """Return the sockets that were touched, and '' where the touching point is to be found."""
        every = ("", *dict.fromkeys(socket for socket in touched if socket))
        return tuple(key for key in every if len(self.free_in(key)))

    def std_in(self, key: str) -> Array:
        return np.append(self.sockets.std(key), np.zeros(3)) if key else np.append(np.zeros(3), self.std[3:])

    @property
    def foreseen(self) -> bool:
        """There is nothing to say of gaps: they are read as zero."""
        return False

    def deviations(self, session: str) -> Array:
        """Return the (6,) deviations of a socket, or of the point that all share."""
        return self.found.get(session, np.zeros(6))

    def _at(self, session: str) -> Array:
        """Return (6,) the place of a socket, and the touching point."""
        place = self.sockets.declared(session) + self.deviations(session)[:3]
        return np.append(place, self.declared[3:] + self.deviations("")[3:])


def sockets_of(sensor: Sensor) -> Sockets:
    """Return what is known of the sockets that an instrument touches, nothing of one that touches none."""
    return sensor.sockets if isinstance(sensor, TouchingSensor) else Sockets()


def read_sockets(table: Declaration) -> Sockets:
    """Return what an instrument that touches knows of what it is put into."""
    shapes, normal = table.part("shape"), table.part("normal").by_name(3)
    of_shape = {name: shapes.choice(name, SHAPES) for name in shapes.table}
    radius = {name: float(value) for name, value in table.part("radius").by_name().items()}
    spheres = [name for name, shape in of_shape.items() if shape == "sphere"]
    for name in [name for name in spheres if not radius.get(name, 0.0) > 0.0]:
        raise table.fail("shape", f"{name!r} is a sphere: give radius = {{ {name} = .. }} [m], above 0")
    for name in [name for name, value in normal.items() if np.linalg.norm(value) < SMALLEST_STD]:
        raise table.fail("normal", f"that of {name!r} has no direction")
    pairs: list[tuple[str, str, float]] = []
    for pair in table.raw("distances") if table.has("distances") else ():
        match pair:
            case [str(first), str(second), int() | float() as length] if first != second and 0.0 < length < FURTHEST:
                pairs.append((first, second, float(length)))
            case _:
                raise table.fail("distances", f'expected [["one", "other", length in m], ..], got {shown(pair)}')
    surfaces = [end for first, other, _ in pairs for end in (first, other) if of_shape.get(end, "point") == "plane"]
    if surfaces:
        raise table.fail("distances", f"{surfaces[0]!r} is a plane: a distance is between points")
    sizes = [table.std(key, default) for key, default in (("place_std", 1e-3), ("distance_sigma", 1e-4))]
    for key, size in zip(("place_std", "distance_sigma"), sizes, strict=True):
        if not SMALLEST_STD <= size <= LONGEST["m"]:
            raise table.fail(key, f"expected one standard deviation [m], got {size:g}")
    own_point = table.has("link")
    if not own_point and (table.has("point") or table.has("point_std")):
        raise table.fail("point", "needs `link`; without a link the target of [prior] tool touches")
    places = table.part("place").by_name(3)
    return Sockets(places, sizes[0], of_shape, radius, normal, tuple(pairs), sizes[1], own_point=own_point)


@dataclass(frozen=True, eq=False)
class Touch(Kind):
    """(N, 3) gaps [m] between point and socket, all read as zero: by axes of the base, or along a surface's normal
    alone.

    Attributes:
        sockets: (N,) name of the socket in each row, '' where none was touched.
    """

    sockets: tuple[str, ...] = ()

    dimension = 3
    unit, quantity = "m", "length"
    channels = AXES
    sensor = TouchingSensor
    nuisances = (Nuisance("place", AXES, "m"), POINT)

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return the link, that of the tip where the target touches, and what is known of the sockets."""
        sockets = read_sockets(table)
        return {"link": link_in(table, "link", robot) if sockets.own_point else robot.tip, "sockets": sockets}

    @classmethod
    def stated(cls, nuisance: Nuisance, table: Declaration, robot: Robot) -> tuple[Array, float]:
        """Return what is declared of a point of its own; places are those of sockets."""
        declared = nuisance is POINT and table.has("link")
        return super().stated(nuisance, table, robot) if declared else (np.zeros(len(nuisance.axes)), 0.0)

    @classmethod
    def columns(cls, name: str) -> tuple[str, ...]:
        """Return its one column, a text."""
        return (name,)

    @property
    def texts(self) -> tuple[str, ...]:
        """(N,) the cells of its column."""
        return self.sockets

    def some(self, rows: np.ndarray) -> Touch:
        return replace(super().some(rows), sockets=tuple(self.sockets[row] for row in rows))

    def touching(self, at: Postures) -> End:
        """Return the touching point: the instrument's own, or the target of the tip."""
        return at.end(self.name if sockets_of(at.sensors[self.name]).own_point else "")

    def _gap(self, at: Postures) -> tuple[Array, Array, Array]:
        """Return (N, 3) gaps [m], and (N, 3, 3) how they change with the point and with the socket's numbers."""
        sensor = at.sensors[self.name]
        sockets, count = sockets_of(sensor), len(self.sockets)
        place = sensor.of("place", self.sockets)
        points = self.touching(at).place
        gap = points - place
        by_point, by_place = np.tile(np.eye(3), (count, 1, 1)), np.tile(-np.eye(3), (count, 1, 1))
        for socket in {name for name in self.sockets if sockets.of_shape(name) != "point"}:
            rows = np.array([touched == socket for touched in self.sockets])
            by_point[rows], by_place[rows] = 0.0, 0.0
            if sockets.of_shape(socket) == "sphere":
                away = points[rows] - place[rows]
                length = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
                gap[rows] = np.outer(length - sockets.radius[socket], [1.0, 0.0, 0.0])
                by_point[rows, 0] = away / length[:, None]
                by_place[rows, 0] = -by_point[rows, 0]
                continue
            height, *tilts = place[rows][0]
            normal, turned = sockets.plane(socket).tilted(np.array(tilts))
            gap[rows] = np.outer(points[rows] @ normal - height, [1.0, 0.0, 0.0])
            by_point[rows, 0] = normal
            by_place[rows, 0] = np.column_stack([np.full(rows.sum(), -1.0), points[rows] @ turned])
        return gap, by_point, by_place

    def ideal(self, at: Postures) -> Array:
        """Return the (N, 3) gaps as the arm has them [m]."""
        return self._gap(at)[0]

    def ends(self, at: Postures) -> Ends:
        """Return the touching point: a gap opens as it moves."""
        return {"end": (self.touching(at), shifted(self._gap(at)[1]))}

    def by_key(self, at: Postures, key: str) -> Array:
        """Return (N, 3, 6): a socket's own rows follow its numbers, '' the point that all share."""
        change, (_, by_point, by_place), end = np.zeros((len(self.values), 3, 6)), self._gap(at), self.touching(at)
        if key:
            rows = np.array([socket == key for socket in self.sockets], dtype=bool)
            change[rows, :, :3] = by_place[rows]
        elif end.link is not None:
            change[:, :, 3:] = end.by_shift(by_point)
        return change

    def by_own(self, at: Postures) -> Array:
        """Return zero (N, 3, 6): sockets are apart from each other; see `by_key`."""
        return np.zeros((len(self.values), 3, 6))

    def begun(self, at: Postures, key: str) -> Array | None:
        """Return (6,) where a fit of a socket may begin: the middle of its points, or the plane through them."""
        sensor, guess = at.sensors[self.name], np.zeros(6)
        sockets = sockets_of(sensor)
        rows = np.array([socket == key for socket in self.sockets], dtype=bool) & np.isfinite(self.sigma[:, 0])
        if not key or key in sockets.place or not rows.any():
            return guess
        points = self.touching(at).place[rows]
        guess[:3] = points.mean(axis=0)
        if sockets.of_shape(key) == "plane":
            plane, tilts = sockets.plane(key), np.zeros(2)
            axes = plane.axes
            normal = np.linalg.svd(points - points.mean(axis=0))[2][-1]
            if len(points) >= FEWEST and abs(normal @ axes[:, 2]) > 0.5:
                tilts = (normal @ axes[:, :2]) / (normal @ axes[:, 2])
            guess[:3] = [guess[:3] @ plane.tilted(tilts)[0], *tilts]
        return guess


@dataclass(frozen=True, eq=False)
class SocketDistance(Kind):
    """(N, 1) a known distance `between` two sockets [m], read in some rows: it is of no pose."""

    between: tuple[str, str] = ("", "")

    dimension = 1
    unit, quantity = "m", "length"
    channels = ("",)
    nuisances = Touch.nuisances

    @property
    def texts(self) -> tuple[str, ...]:
        """Nothing: it has no column."""
        return ()

    def _away(self, at: Postures) -> Array:
        """Return (3,) from the first socket to the second [m]."""
        places: Array = at.sensors[self.name].of("place", self.between)
        return places[1] - places[0]

    def ideal(self, at: Postures) -> Array:
        return np.full((len(self.values), 1), float(np.linalg.norm(self._away(at))))

    def by_key(self, at: Postures, key: str) -> Array:
        """Return (N, 1, 6): the way between them follows its two ends."""
        away, change = self._away(at), np.zeros((len(self.values), 1, 6))
        if key in self.between:
            sign = 1.0 if key == self.between[1] else -1.0
            change[:, 0, :3] = sign * away / max(float(np.linalg.norm(away)), 1e-12)
        return change

    def by_own(self, at: Postures) -> Array:
        """Return zero (N, 1, 6), as `Touch.by_own`."""
        return np.zeros((len(self.values), 1, 6))

    def begun(self, at: Postures, key: str) -> Array | None:
        return None


def touched(name: str, sockets: Sequence[str], sigma: Array, stated: Sockets) -> tuple[Kind, ...]:
    """Return the readings of a touching instrument: its touches, and each distance that is known of its sockets.

    A distance stands in several rows with a standard deviation that makes them together worth one reading.

    Args:
        name: Of the instrument.
        sockets: (N,) what was touched, '' where nothing was.
        sigma: (N, 1) one standard deviation of how well the point sat [m].
        stated: Of the sockets.
    """
    read = np.array([bool(socket) for socket in sockets], dtype=bool)
    each = np.where(read[:, None], np.broadcast_to(sigma, (len(sockets), 3)), np.inf)
    for row, socket in enumerate(sockets):
        if socket and stated.of_shape(socket) != "point":
            each[row, 1:] = np.inf
    kinds: list[Kind] = [Touch(np.zeros((len(sockets), 3)), each, name, tuple(sockets))]
    for first, other, length in stated.distances:
        ends = np.flatnonzero([socket in (first, other) for socket in sockets])
        if {first, other} <= set(sockets):
            count = min(max(len(ends) // CARRIED, FEWEST), len(ends))
            rows = ends[np.linspace(0, len(ends) - 1, count).astype(int)]
            stds = np.full((len(sockets), 1), np.inf)
            stds[rows] = stated.distance_sigma * np.sqrt(count)
            values = np.where(np.isfinite(stds), length, 0.0)
            kinds.append(SocketDistance(values, stds, name, (first, other)))
    return tuple(kinds)
