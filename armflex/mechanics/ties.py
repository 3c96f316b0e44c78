"""What joins two links beside the tree: the pins of loops, the lengths of cylinders and springs, gears and belts.

In one placed configuration of a Pinocchio model a tie says by how much it gaps, how that changes per body motion of
everything, and how the torques that it needs change. All of it follows from the joints' Jacobian J in world axes: with
s = -1 for what carries the first link alone and 1 for the second, D = s J the motion of the second against the first,

    gap' = W D,   torque = (W D)' force = s J' h,   h = W' force the wrench on the second at the world's origin
    torque' = s J' (h' + h x J)                     a column of J is carried by those before it
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import ConvergenceError
from armflex.mechanics.spring import SHORTEST, Spring
from armflex.robot.linkage import Cylinder, Linkage, Loop

skew = pin.skew
UNITS = np.eye(3)


class Carried:
    """A point of a link, in the axes of the joint that carries it; `turn` and `place` are views of where that is."""

    def __init__(self, model: pin.Model, data: pin.Data, link: str, at: Array, moved: Array | None = None) -> None:
        frame, error = model.frames[model.getFrameId(link, pin.FrameType.BODY)], np.zeros(6) if moved is None else moved
        self.joint, self.axes = frame.parentJoint, frame.placement.rotation @ pin.exp3(error[3:])
        self.point = frame.placement.act(np.asarray(at, dtype=float) + error[:3])
        self.turn, self.place = data.oMi[self.joint].rotation, data.oMi[self.joint].translation
        self.moved = np.zeros(model.nv)  # 1 for the velocities that carry it
        for joint in list(model.supports[self.joint])[1:]:
            start = model.joints[joint].idx_v
            self.moved[start : start + model.joints[joint].nv] = 1.0

    @property
    def here(self) -> Array:
        """(3,) where it is [m]."""
        return self.turn.dot(self.point) + self.place


@dataclass(frozen=True)
class Shift:
    """How the wrench of a tie changes: by (6, 6) of the motions of both ends, world axes, and with itself."""

    wrench: Array
    by_first: Array
    by_second: Array


class Pin:
    """A loop's joint: six gaps, in axes of the first link, of which those of its kind are closed.

    Gaps of points come first, and then the sum of a x b over axes a of the first link and b of the second that it holds
    together: of three of them half of that, which for a small turn is its vector.
    """

    def __init__(self, loop: Loop, ends: tuple[Carried, Carried]) -> None:
        self.name, self.ends = loop.name, ends
        held = {"spherical": np.zeros((3, 0)), "fixed": UNITS}.get(loop.kind, loop.axis[:, None])
        self.held = ends[0].axes @ held, (0.5 if loop.kind == "fixed" else 1.0) * ends[1].axes @ loop.turn_to @ held
        across = np.linalg.svd(loop.axis[None])[2][1:]
        along = across if loop.kind == "cylindrical" else UNITS
        about = {"spherical": np.zeros((0, 3)), "fixed": UNITS}.get(loop.kind, across)
        self.rows = np.zeros((len(along) + len(about), 6))
        self.rows[: len(along), :3], self.rows[len(along) :, 3:] = along, about

    def place(self) -> tuple[Array, Array]:
        """Return (r,) gaps [m, rad] and (r, 6) how they change with the motion of the second end against the first."""
        (first, second), gap, way = self.ends, np.empty(6), np.zeros((6, 6))
        self._here, self._axes = second.here, first.turn @ first.axes
        self._held = a, b = first.turn @ self.held[0], second.turn @ self.held[1]
        back, both = self._axes.T, b.dot(a.T)
        self._turning = np.trace(both) * UNITS - both
        across = [both[2, 1] - both[1, 2], both[0, 2] - both[2, 0], both[1, 0] - both[0, 1]]
        gap[:3], gap[3:] = back.dot(self._here - first.here), back.dot(across)
        way[:3, :3], way[:3, 3:], way[3:, 3:] = back, -back.dot(skew(self._here)), back.dot(self._turning)
        return self.rows @ gap, self.rows @ way

    def shift(self, force: Array) -> Shift:
        """Return how the wrench of (6,) forces in its axes changes, where it was placed last."""
        pull, about, (a, b) = self._axes @ force[:3], self._axes @ force[3:], self._held
        moment, other = self._turning.T @ about, skew(about) @ a
        turning = b @ other.T - (b * other).sum() * UNITS
        across, here = skew(pull), skew(self._here)
        first, second = np.zeros((6, 6)), np.zeros((6, 6))
        first[:3, 3:], first[3:, 3:] = -across, -here @ across - skew(moment) - turning
        second[3:, :3], second[3:, 3:] = -across, across @ here + turning
        return Shift(np.concatenate([pull, here.dot(pull) + moment]), first, second)


class Rod:
    """The way between two points, of a cylinder or a spring."""

    rows = np.eye(6)[:1]

    def __init__(self, name: str, ends: tuple[Carried, Carried]) -> None:
        self.name, self.ends = name, ends

    def place(self) -> tuple[float, Array]:
        """Return its length [m] and (1, 6) how that changes with the motion of the second end against the first."""
        self._here = self.ends[0].here, self.ends[1].here
        way = self._here[1] - self._here[0]
        self.length = math.sqrt(way.dot(way))
        if not self.length > SHORTEST:
            raise ConvergenceError(f"{self.name}: its ends meet, where it has no direction", ())
        self._along = way / self.length
        return self.length, np.concatenate([self._along, skew(self._here[1]).dot(self._along)])[None]

    def shift(self, force: Sequence[float] | Array, rate: float = 0.0) -> Shift:
        """Return how the wrench of a tension, `force[0]` [N], changes at a rate [N/m], where it was placed last."""
        tension, along, (p1, p2) = force[0], self._along[:, None] * self._along, map(skew, self._here)
        turns = tension / self.length * (UNITS - along) + rate * along
        across = tension * skew(self._along)
        first, second = np.empty((6, 6)), np.empty((6, 6))
        first[:3, :3], first[:3, 3:] = -turns, turns @ p1
        second[:3, :3], second[:3, 3:] = turns, -turns @ p2
        first[3:], second[3:] = p2 @ first[:3], p2 @ second[:3]
        second[3:, :3] -= across
        second[3:, 3:] += across @ p2
        pull = tension * self._along
        return Shift(np.concatenate([pull, p2.dot(pull)]), first, second)


class Ties:
    """All ties of a Pinocchio model. Closures have six slots each, of which `rows` are closed; springs have a law.

    Attributes:
        names: Of the closures: loops, cylinders, followers.
        rows: (m, 6 K) what is closed of the closures' slots, orthonormal.
        springs: The springs, in order.
        loops, cylinders, sprung_rods: Where they are; `joined` are loops and cylinders.
        gears: Places of a follower and its master in a configuration, factor, offset.
    """

    def __init__(
        self,
        model: pin.Model,
        data: pin.Data,
        linkage: Linkage,
        springs: Sequence[Spring] = (),
        moved: Mapping[str, Array] | None = None,
    ) -> None:
        self.model, self.data, self.springs, self.names = model, data, tuple(springs), linkage.closures

        def ends(one: Loop | Cylinder | Spring) -> tuple[Carried, Carried]:
            errors = (None, None)
            if moved and not isinstance(one, Spring):
                errors = moved.get(one.name), moved.get(f"{one.name}:to")
            return Carried(model, data, one.link, one.at, errors[0]), Carried(model, data, one.to, one.at_to, errors[1])

        self.loops = [Pin(loop, ends(loop)) for loop in linkage.loops]
        self.cylinders = [Rod(f"cylinder {one.name!r}", ends(one)) for one in linkage.cylinders]
        self.sprung_rods = [Rod(f"spring {one.name!r}", ends(one)) for one in self.springs]
        self._geared = np.zeros((len(linkage.followers), model.nv))
        self.gears: list[tuple[int, int, float, float]] = []
        for row, (name, (master, factor, offset)) in zip(self._geared, linkage.followers.items(), strict=True):
            own, other = (model.joints[model.getJointId(one)] for one in (name, master))
            row[own.idx_v], row[other.idx_v] = 1.0, -factor
            self.gears.append((own.idx_q, other.idx_q, factor, offset))
        self.joined = (*self.loops, *self.cylinders)
        parts = [one.rows for one in self.joined] + [Rod.rows] * len(self.gears)
        self.rows, at = np.zeros((sum(map(len, parts)), 6 * len(parts))), 0
        for k, part in enumerate(parts):
            self.rows[at : at + len(part), 6 * k : 6 * k + 6] = part
            at += len(part)
        self._signs = [one.ends[1].moved - one.ends[0].moved for one in (*self.joined, *self.sprung_rods)]

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self.names or self.springs)

    @cached_property
    def _before(self) -> Array:
        """(nv, nv) 1 where a velocity carries the column of another: those of a joint carry each other."""
        carriers = [set(self.model.supports[joint]) for joint in range(self.model.njoints)]
        owner = [joint.id for joint in list(self.model.joints)[1:] for _ in range(joint.nv)]
        return np.array([[b in carriers[a] for b in owner] for a in owner], dtype=float)

    def place(self, configuration: Array) -> tuple[Array, Array]:
        """Return (m,) gaps of what is closed, cylinders' being their lengths, and (m, nv) their change per body motion.

        It places the joints and their Jacobian of `data` as well.
        """
        pin.computeJointJacobians(self.model, self.data, configuration)
        jacobian = self._jacobian
        gaps, ways, count = np.empty(len(self.rows)), np.empty((len(self.rows), self.model.nv)), 0
        for one, sign in zip(self.joined, self._signs, strict=False):
            some = slice(count, count := count + len(one.rows))
            gaps[some], way = one.place()
            ways[some] = way @ (jacobian * sign)
        for (own, master, factor, offset), row in zip(self.gears, self._geared, strict=True):
            gaps[count] = configuration[own] - factor * configuration[master] - offset
            ways[count] = row
            count += 1
        return gaps, ways

    @property
    def _jacobian(self) -> Array:
        """(6, nv) of the joints as they were placed; where nv is 1 Pinocchio has (6,)."""
        return self.data.J.reshape(6, self.model.nv)

    def sprung(self) -> tuple[Array, Array]:
        """Return (n_springs, 2) lengths [m] and tensions [N] and (nv,) the torque that holds the arm against them.

        The joints' Jacobian must have been placed.
        """
        states, torque, jacobian = np.empty((len(self.springs), 2)), np.zeros(self.model.nv), self._jacobian
        signs = self._signs[len(self.joined) :]
        for state, spring, rod, sign in zip(states, self.springs, self.sprung_rods, signs, strict=True):
            length, way = rod.place()
            state[:] = length, spring.law.tension(length)
            torque += sign * (state[1] * (way[0] @ jacobian))
        return states, torque

    def stiffness(self, forces: Array) -> Array:
        """Return the (nv, nv) change of torques per body motion for (6 K,) forces in closures, and of springs.

        All must have been placed by `place` and `sprung`.
        """
        jacobian, total = self._jacobian, np.zeros((self.model.nv, self.model.nv))
        for (one, shift), sign in zip(self._shifts(forces), self._signs, strict=True):
            force, moment = skew(shift.wrench[:3]), skew(shift.wrench[3:])
            crossed = np.zeros((6, 6))
            crossed[:3, 3:], crossed[3:, :3], crossed[3:, 3:] = force, force, moment
            moved = shift.by_first @ (jacobian * one.ends[0].moved) + shift.by_second @ (jacobian * one.ends[1].moved)
            total += sign[:, None] * ((jacobian.T @ (crossed @ jacobian)) * self._before + jacobian.T @ moved)
        return total

    def _shifts(self, forces: Array) -> list[tuple[Pin | Rod, Shift]]:
        """Return all of these but gears, each with how its wrench changes."""
        laws = [(rod, spring.law, rod.length) for spring, rod in zip(self.springs, self.sprung_rods, strict=True)]
        closed = [(one, one.shift(forces[6 * k : 6 * k + 6])) for k, one in enumerate(self.joined)]
        return closed + [(rod, rod.shift([law.tension(at)], law.rate(at))) for rod, law, at in laws]

    def push(self, forces: Array, into: pin.StdVec_Force) -> None:
        """Add what (6 K,) forces in closures, and springs, do to forces on Pinocchio's joints, in their axes."""
        for one, shift in self._shifts(forces):
            for end, side in zip(one.ends, (1.0, -1.0), strict=True):
                into[end.joint] += self.data.oMi[end.joint].actInv(pin.Force(side * shift.wrench))

    def apart(self, row: int) -> tuple[str, bool]:
        """Return the name of the closure that a row closes, and whether the row is an angle."""
        slot = int(np.abs(self.rows[row]).argmax())
        return self.names[slot // 6], slot % 6 >= 3
