"""The direction of something far away that an axis of the arm points at, or of a point of the arm from a place: two
angles and no third number.

Azimuth and elevation are about the base's z, from its x, or about the axes of a theodolite that stands somewhere in the
base. They are read, and err, on the sky: an azimuth counts by the cosine of the elevation, and is none at the zenith.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from armflex.conventions import RESOLUTION, SMALLEST_STD, Array
from armflex.declaration import Declaration
from armflex.readings.air import Air, bending, read_air
from armflex.readings.end import End, shifted, turned
from armflex.readings.kind import FURTHEST, Ends, Kind, link_in
from armflex.readings.plane import Plane
from armflex.readings.postures import Postures
from armflex.readings.sensor import AXES, LOOKS, POINT, Nuisance
from armflex.robot import Robot

SENSES = {"counterclockwise": 1.0, "north_to_east": -1.0}
"""Which way azimuths grow, seen from where the base's z points."""

NEAR = 0.1
"""Error [rad] up to which angles are compared where they were read, and a fit finds a frame from where it is."""

ALIGNED = 0.01
"""Prior: standard deviation [rad] of where an axis points in its link, where none is stated: it is not known to an
arcsecond before the first star."""


UNIT = 1e-3
"""How far the length of a unit vector may be from 1."""

STEP = 1e-4
"""Of a difference quotient by gravity [m/s^2]."""

COLLIMATION = Nuisance("collimation", ("x", "y"), "rad")
PLACE = Nuisance("place", AXES, "m", "eye")


@dataclass(frozen=True, eq=False)
class Sight:
    """What is looked at, and through what.

    Attributes:
        sense: 1 where azimuths grow counterclockwise about z, -1 where clockwise.
        axis: The axis that points, across which its collimation tilts it; None of a theodolite.
        air: What bends the line of sight, so that columns are of the direction in vacuum; None where they are as seen.
    """

    sense: float
    axis: Plane | None = None
    air: Air | None = None

    def angles(self, way: Array) -> Array:
        """Return (N, 2) azimuth and elevation [rad] of (N, 3) directions of any length."""
        x, y, z = way.T
        return np.column_stack([np.arctan2(self.sense * y, x), np.arctan2(z, np.hypot(x, y))])

    def ways(self, angles: Array) -> Array:
        """Return (N, 3) unit vectors of (N, 2) azimuth and elevation [rad]."""
        (azimuth, elevation), sense = angles.T, self.sense
        flat = np.cos(elevation)
        return np.column_stack([flat * np.cos(azimuth), sense * flat * np.sin(azimuth), np.sin(elevation)])

    def across(self, angles: Array) -> Array:
        """Return (N, 2, 3) unit vectors along which azimuth and elevation grow there."""
        (azimuth, elevation), sense = angles.T, self.sense
        level = np.column_stack([-np.sin(azimuth), sense * np.cos(azimuth), np.zeros(len(angles))])
        rise = np.column_stack([np.cos(azimuth), sense * np.sin(azimuth), np.zeros(len(angles))])
        up = np.cos(elevation)[:, None] * [0.0, 0.0, 1.0] - np.sin(elevation)[:, None] * rise
        return np.stack([level, up], axis=1)


@dataclass(frozen=True, eq=False)
class Direction(Kind):
    """(N, 2) azimuth and elevation [rad] of what is far away and an axis of the arm points at.

    Standard deviations and errors are of angles on the sky.
    """

    dimension = 2
    unit, quantity = "rad", "direction"
    shown = ("arcsec", 648000.0 / np.pi)
    far = True
    channels = ("azimuth", "elevation")
    most = (4.0 * np.pi, 0.5 * np.pi + UNIT)
    nuisances = (COLLIMATION, LOOKS)

    @classmethod
    def declared(cls, table: Declaration, robot: Robot) -> dict[str, Any]:
        """Return the link, the axis on it or the point that is looked at, the sense of azimuths, and the air."""
        sense = SENSES[table.choice("azimuth", tuple(SENSES), "counterclockwise")]
        said: dict[str, Any] = {"link": link_in(table, "link", robot)}
        if table.has("place") or not table.has("axis"):
            if table.has("axis") or not table.has("place"):
                text = "give `axis`, the direction in the link that points, or `place`, where a theodolite stands"
                problem = "stands beside `place`" if table.has("axis") else "is missing"
                raise table.fail("axis", f"{problem}: {text}")
            if table.has("refraction"):
                text = "is of what is beyond the air: over a few metres it bends by less than a tenth of an arcsec"
                raise table.fail("refraction", f"{text}; the effect `refraction` is for more")
            return said | {"kind": PointDirection, "about": Sight(sense)}
        axis = table.numbers("axis", (3,))
        if np.linalg.norm(axis) < SMALLEST_STD:
            raise table.fail("axis", "expected a direction in the link's frame, got zeros")
        air = read_air(table.sub("refraction")) if table.has("refraction") else None
        if air is not None and not np.linalg.norm(robot.gravity) > 0.0:
            raise table.fail("refraction", "needs gravity: it bends against that")
        return said | {"about": Sight(sense, Plane(axis), air)}

    @classmethod
    def stated(cls, nuisance: Nuisance, table: Declaration, robot: Robot) -> tuple[Array, float]:
        value, std = super().stated(nuisance, table, robot)
        if nuisance is COLLIMATION and not table.has("collimation_std"):
            std = 0.0 if table.has("collimation") else ALIGNED
        if nuisance is PLACE and (away := float(np.linalg.norm(value))) > robot.reach + FURTHEST:
            text = f"is {away:.3g} m from the base, and the arm reaches {robot.reach:.3g} m"
            raise table.fail("place", f"{text}: millimetres?")
        return value, std

    @classmethod
    def instead(cls, name: str) -> tuple[str, ...]:
        return tuple(f"{name}_{axis}" for axis in AXES)

    @classmethod
    def of_instead(cls, values: Array, about: Any) -> tuple[Array, np.ndarray]:
        size = np.linalg.norm(values, axis=1)
        return about.angles(values), np.abs(size - 1.0) < UNIT

    def _pointing(self, at: Postures) -> tuple[End, Array, Array]:
        """Return the link, (N, 3) where its axis points in the base, and (N, 3, 2) the change with its collimation."""
        end, axis = at.end(self.name), at.about(self.name, Sight).axis
        assert axis is not None
        way, changes = axis.tilted(at.of(self.name, "collimation"))
        turn = end.pose[:, :3, :3]
        return end, np.einsum("nij,nj->ni", turn, way), turn @ changes

    def _in_vacuum(self, way: Array, at: Postures) -> tuple[Array, Array, Array]:
        """Return (N, 3) where the light comes from that is seen along unit vectors, base axes; (N, 3, 3) its change
        with these, and (N, 3) with how much more the air bends it per tangent of the zenith distance.
        """
        air, more = at.about(self.name, Sight).air, at.bend[:, 1]
        if air is None and not more.any() and not at.gravities.any():
            return way, np.broadcast_to(np.eye(3), (len(way), 3, 3)), np.zeros_like(way)
        rise, cosine, sine = _vertical(way, at)
        a, b = (0.0, 0.0) if air is None else air.constants
        down, slope = bending(a + more, b, cosine)
        turn_cos, turn_sin = np.cos(down)[:, None], np.sin(down)[:, None]
        there, rise_there = turn_cos * way - turn_sin * rise, turn_sin * way + turn_cos * rise
        # About the vertical the same turn goes farther from the zenith.
        side, wider = np.cross(way, rise), turn_cos[:, 0] + turn_sin[:, 0] * cosine / sine
        change = (1.0 + slope)[:, None, None] * rise_there[:, :, None] * rise[:, None]
        change += wider[:, None, None] * side[:, :, None] * side[:, None] + there[:, :, None] * way[:, None]
        return there, change, -bending(1.0, 0.0, cosine)[0][:, None] * rise_there

    def _grows(self, there: Array, eye: End, at: Postures) -> Array:
        """Return (N, 2, 3) where the two numbers grow, base axes: at what was read, or where it would be far off."""
        sight, read = at.about(self.name, Sight), np.einsum("nij,ni->nj", eye.axes, there)
        near = np.einsum("ni,ni->n", sight.ways(self.values), read) > np.cos(NEAR)
        angles = np.where(near[:, None], self.values, sight.angles(read))
        return sight.across(angles) @ eye.axes.swapaxes(1, 2)

    def _there(self, at: Postures) -> Array:
        """Return (N, 3) unit vectors in which the object is seen, base axes."""
        return self._in_vacuum(self._pointing(at)[1], at)[0]

    def _read(self, at: Postures) -> Array:
        """Return the same in the axes that the angles are about."""
        return np.einsum("nij,ni->nj", at.end(self.name, "eye").axes, self._there(at))

    def ideal(self, at: Postures) -> Array:
        return at.about(self.name, Sight).angles(self._read(at))

    def residual(self, at: Postures) -> Array:
        """Return (N, 2) the way on the sky [rad] from where the object should be seen to where it was."""
        sight, read = at.about(self.name, Sight), self._read(at)
        off = -(sight.across(self.values) @ read[:, :, None])[:, :, 0]
        sine, cosine = np.linalg.norm(off, axis=1), np.einsum("ni,ni->n", sight.ways(self.values), read)
        opposite = (sine < SMALLEST_STD) & (cosine < 0.0)
        off = np.where(opposite[:, None], (1.0, 0.0), off)
        sine = np.where(opposite, 1.0, np.maximum(sine, SMALLEST_STD))
        angle = np.arctan2(np.where(opposite, 0.0, sine), cosine)
        return np.where(np.isfinite(self.sigma), off * (angle / sine)[:, None], 0.0)

    def ends(self, at: Postures) -> Ends:
        """Return the link that points, and what stands still: the axes that the angles are about."""
        (end, way, _), eye = self._pointing(at), at.end(self.name, "eye")
        there, change, _ = self._in_vacuum(way, at)
        grows = self._grows(there, eye, at)
        return {"end": (end, turned(np.cross(way[:, None], grows @ change))),
                "eye": (eye, turned(-np.cross(there[:, None], grows)))}  # fmt: skip

    def others(self, at: Postures) -> Mapping[str, Array]:
        _, way, tilted = self._pointing(at)
        there, change, _ = self._in_vacuum(way, at)
        return {"collimation": self._grows(there, at.end(self.name, "eye"), at) @ change @ tilted}

    def by_gravity(self, at: Postures) -> Array:
        change, grows = np.zeros((*self.values.shape, 3)), self._grows(self._there(at), at.end(self.name, "eye"), at)
        for i, step in enumerate(STEP * np.eye(3)):
            ends = [self._there(replace(at, gravity=at.gravity + side * step)) for side in (1.0, -1.0)]
            change[:, :, i] = (grows @ (ends[0] - ends[1])[:, :, None])[:, :, 0] / (2.0 * STEP)
        return change

    def by_bend(self, at: Postures) -> Array:
        there, _, more = self._in_vacuum(self._pointing(at)[1], at)
        change = np.zeros((*self.values.shape, 2))
        change[:, :, 1] = (self._grows(there, at.end(self.name, "eye"), at) @ more[:, :, None])[:, :, 0]
        return change

    def start(self, at: Postures) -> Array:
        """Return the frame of the angles as the directions have it, where it is not known nearly; see `Kind.start`."""
        sensor = at.sensors[self.name]
        deviation, turn = np.zeros(len(sensor.std)), [name.startswith(LOOKS.name) for name, _ in sensor.labels]
        read = np.isfinite(self.sigma).all(axis=1)
        # Directions without which there is no frame of them
        if read.sum() < 3 or not sensor.std[turn].max(initial=0.0) > NEAR:
            return deviation
        wanted = at.about(self.name, Sight).ways(self.values[read])
        left, _, right = np.linalg.svd(self._there(at)[read].T @ wanted)
        axes = left * (1.0, 1.0, np.linalg.det(left @ right)) @ right
        deviation[turn] = pin.log3(axes) - sensor.declared[turn]
        return deviation


def _vertical(way: Array, at: Postures) -> tuple[Array, Array, Array]:
    """Return (N, 3) unit vectors across others on which these rise against gravity, and cosine and sine of the angles
    between these and the vertical.
    """
    up = at.up
    cosine = np.clip(np.einsum("ni,ni->n", way, np.broadcast_to(up, way.shape)), -1.0, 1.0)
    rise = up - cosine[:, None] * way
    sine = np.linalg.norm(rise, axis=1)
    at_zenith = (sine < RESOLUTION)[:, None]
    rise = np.where(at_zenith, np.cross(way, np.roll(way, 1, axis=1)), rise)
    wide = np.maximum(np.linalg.norm(rise, axis=1, keepdims=True), SMALLEST_STD)
    return rise / wide, cosine, np.maximum(sine, RESOLUTION)


@dataclass(frozen=True, eq=False)
class PointDirection(Direction):
    """The same [rad] of a point of the arm, from the place of a theodolite."""

    nuisances = (PLACE, LOOKS, POINT)
    far = False

    def _there(self, at: Postures) -> Array:
        """Return where the point is seen: the air lifts it by what it bends the line of sight, times its length."""
        _, _, length, way = at.line(self.name)
        if not at.bend[:, 0].any():
            return way
        seen = way + (at.bend[:, 0] * length)[:, None] * _vertical(way, at)[0]
        return seen / np.linalg.norm(seen, axis=1, keepdims=True)

    def ends(self, at: Postures) -> Ends:
        """Return the point, and the theodolite."""
        end, eye, length, way = at.line(self.name)
        grows = self._grows(way, eye, at)
        per = (grows - (grows @ way[:, :, None]) * way[:, None]) / length[:, None, None]
        about = -np.concatenate([per, np.cross(way[:, None], grows)], axis=2)
        return {"end": (end, shifted(per)), "eye": (eye, about)}

    def others(self, at: Postures) -> Mapping[str, Array]:
        return {}

    def by_shift(self, at: Postures) -> Array:
        return np.broadcast_to(1.0 / at.line(self.name)[2][:, None], self.values.shape)

    def by_gravity(self, at: Postures) -> Array:
        return np.zeros((*self.values.shape, 3))

    def by_bend(self, at: Postures) -> Array:
        _, eye, length, way = at.line(self.name)
        change = np.zeros((*self.values.shape, 2))
        lifted = length[:, None] * _vertical(way, at)[0]
        change[:, :, 0] = (self._grows(way, eye, at) @ lifted[:, :, None])[:, :, 0]
        return change
