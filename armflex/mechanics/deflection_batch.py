"""What a loaded arm does at many configurations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.mechanics.deflect import Asked
from armflex.mechanics.deflection import Deflection, Solved
from armflex.mechanics.doubts import SAG_BAND, payload_doubts, sag_doubts, wrench_doubts
from armflex.mechanics.laws import RowLaws
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.loads import Payload, Wrench
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.mechanics.rows import RowSolver, Solution, flexure_poses, rigid_tips, rotations
from armflex.mechanics.structure import Names, Structure

CHUNK = 512
"""Rows whose covariances are found together."""


@dataclass(frozen=True, eq=False)
class Acting:
    """What acts in N rows.

    Attributes:
        arm: The arm.
        payloads: One for all rows, or one for each.
        moving: (N, nq) velocities and accelerations, None where the arm stands still.
        covariates: Numbers, or (N,) of them, by name.
        wrenches: Loads from outside.
        asked: How the question is to be answered.
    """

    arm: Structure
    payloads: tuple[str | Payload | None, ...]
    moving: tuple[Array | None, Array | None]
    covariates: dict[str, Array]
    wrenches: tuple[Wrench, ...]
    asked: Asked

    @property
    def moves(self) -> bool:
        """Whether there is a velocity or an acceleration."""
        return any(values is not None for values in self.moving)

    @property
    def compiled(self) -> bool:
        """Whether the arm stands still, and the method is one that the kernel has."""
        return not self.moves and self.asked.method in ("exact", "first_order")

    def some(self, rows: slice) -> Acting:
        """Return what acts in some of the rows."""
        payloads = self.payloads if len(self.payloads) == 1 else self.payloads[rows]
        moving = tuple(None if values is None else values[rows] for values in self.moving)
        return replace(self, payloads=payloads, moving=moving, covariates=self.known(rows))

    def known(self, rows: int | slice | np.ndarray) -> dict[str, Array]:
        """Return the covariates of a row, or of some."""
        return {name: values[rows] if values.ndim else values for name, values in self.covariates.items()}

    def payload(self, i: int) -> str | Payload | None:
        """Return what is carried in a row."""
        return self.payloads[0 if len(self.payloads) == 1 else i]

    def motion(self, i: int) -> list[Array | None]:
        """Return a row's velocities and accelerations."""
        return [None if values is None else values[i] for values in self.moving]

    def groups(self, count: int) -> Iterator[tuple[LoadedArm, np.ndarray]]:
        """Yield the arm with each payload, and the rows in which it is carried."""
        if len(self.payloads) == 1:
            yield self.arm.loaded(self.payloads[0]), np.arange(count)
            return
        found: dict[int, tuple[LoadedArm, list[int]]] = {}
        for i, payload in enumerate(self.payloads):
            loaded = self.arm.loaded(payload)
            found.setdefault(id(loaded), (loaded, []))[1].append(i)
        for loaded, rows in found.values():
            yield loaded, np.array(rows)


@dataclass(frozen=True, repr=False, eq=False)
class DeflectionBatch:
    """The arm at N configurations; the arrays of `Deflection` with a leading N.

    Equilibria are found before there is a batch; what follows from them is computed when it is asked for, and kept.

    Attributes:
        q: (N, nq) joint positions.
        displacement: (N, 6) flexed minus rigid, base axes [m, rad].
        wrenches, twists: (N, n_flexures, 6) local loads and deflections.
        names: Joints, flexures, base and tip.
        acting: What acts in the rows.
    """

    q: Array
    displacement: Array
    wrenches: Array
    twists: Array
    names: Names
    acting: Acting

    def __repr__(self) -> str:
        """One line: how many rows and the largest shift."""
        most = float(np.linalg.norm(self.displacement[:, :3], axis=1).max(initial=0.0))
        return f"<DeflectionBatch: {len(self.q)} rows, {self.names.tip} moves up to {most * 1e3:.4g} mm>"

    def row(self, i: int) -> Deflection:
        """Return one of the rows by itself; its equilibrium is not solved again."""
        acting = self.acting
        loaded = acting.arm.loaded(acting.payload(i))
        checked, flags = acting.arm.check_position(self.q[i], enforce_limits=False)
        flex, case = loaded.mechanics.flex, None
        if acting.moves or acting.wrenches:
            case = LoadCase(checked, *acting.motion(i), (*acting.wrenches, *acting.arm.pulls))
        motion, torque = np.zeros((2, flex.model.nv))
        motion[flex.flexure_v], torque[flex.flexure_v] = self.twists[i].ravel(), -self.wrenches[i].ravel()
        straight, known = loaded.solver.straight(checked), acting.known(i)
        doubts = (*self._standing(loaded), *flags)
        return Deflection(
            checked, Solved(loaded, straight, motion, torque, acting.asked.method, (), doubts, known, case)
        )

    def _standing(self, loaded: LoadedArm) -> tuple[Flag, ...]:
        """Return the doubts about the arm, its payload and the loads from outside."""
        acting = self.acting
        carried = payload_doubts(acting.arm, loaded.payload, acting.moving[1] is not None)
        return (*acting.arm.flags, *carried, *wrench_doubts(acting.arm, acting.wrenches))

    @cached_property
    def rigid_pose(self) -> Array:
        """(N, 4, 4) tip poses of the rigid arm in the base frame."""
        loaded = self.acting.arm.loaded(None)
        return rigid_tips(loaded.nominal or loaded.chain, self.q)

    @cached_property
    def pose(self) -> Array:
        """(N, 4, 4) tip poses of the flexed arm in the base frame."""
        found = self.rigid_pose.copy()
        found[:, :3, 3] += self.displacement[:, :3]
        found[:, :3, :3] = rotations(self.displacement[:, 3:]) @ found[:, :3, :3]
        return found

    @cached_property
    def contributions(self) -> Array:
        """(N, n_flexures, 6) first-order share of each flexure in the displacement [m, rad]."""
        found = np.empty_like(self.twists)
        if not self.acting.compiled:
            for i in range(len(self.q)):
                found[i] = self.row(i).contributions
            return found
        for loaded, rows in self.acting.groups(len(self.q)):
            poses = flexure_poses(loaded, self.q[rows], self.twists[rows])
            # To go on along a twist is to move by it: exp6's derivative leaves it as it is.
            turns, origins, tip = poses[:, :-1, :3, :3], poses[:, :-1, :3, 3], poses[:, -1:, :3, 3]
            shift, turn = ((turns @ part[..., None])[..., 0] for part in np.split(self.twists[rows], 2, axis=2))
            found[rows] = np.concatenate([shift + np.cross(turn, tip - origins), turn], axis=2)
        return found

    @cached_property
    def covariance(self) -> Array | None:
        """(N, 6, 6) of the laws alone, None where no law carries an uncertainty; see `armflex.total_covariance`."""
        found, left = np.zeros((len(self.q), 6, 6)), np.ones(len(self.q), dtype=bool)
        known, stack = False, self.acting.arm.stack
        for loaded, rows in self._chunks() if self.acting.compiled else ():
            row, wrenches = loaded.row(self.q[rows], self.acting.known(rows)), self.wrenches[rows]
            parts = [law.covariance(wrenches[:, i], row) for i, law in enumerate(stack.laws)]
            if all(part is None for part in parts):
                left[rows] = False
                continue
            known = True
            solver, laws = RowSolver(loaded, True, (*self.acting.wrenches, *self.acting.arm.pulls)), RowLaws(stack, row)
            if laws.curved:
                laws.expand(wrenches)
            at = Solution(self.displacement[rows], wrenches, self.twists[rows])
            gains, distance = solver.linearise(row, laws, at, np.arange(len(rows)))
            for i, part in enumerate(parts):
                if part is not None:
                    found[rows] += gains[:, :, i] @ part @ np.swapaxes(gains[:, :, i], 1, 2)
            left[rows] = ~(distance < 1.0)
        for i in np.flatnonzero(left):
            one = self.row(i).covariance
            known, found[i] = known or one is not None, 0.0 if one is None else one
        return found if known else None

    def _chunks(self) -> Iterator[tuple[LoadedArm, np.ndarray]]:
        """Yield the arm with each payload, and some rows in which it is carried."""
        for loaded, rows in self.acting.groups(len(self.q)):
            for start in range(0, len(rows), CHUNK):
                yield loaded, rows[start : start + CHUNK]

    @cached_property
    def flags(self) -> tuple[Flag, ...]:
        """Doubts, each with the first row it concerns."""
        met = sorted(self._doubts(), key=lambda pair: pair[0])
        found: dict[str, Flag] = {}
        for number, flag in met:
            found.setdefault(flag.code, Flag(flag.code, f"row {number}: {flag.text}"))
        return tuple(found.values())

    def _doubts(self) -> Iterator[tuple[int, Flag]]:
        """Yield the doubts with the first row of each kind."""
        arm = self.acting.arm
        for loaded, rows in self.acting.groups(len(self.q)):
            if len(rows):
                yield from ((int(rows[0]), flag) for flag in self._standing(loaded))
        outside = ((self.q < arm.robot.lower) | (self.q > arm.robot.upper)).any(axis=1)
        for i in np.flatnonzero(outside):
            yield from ((int(i), flag) for flag in arm.check_position(self.q[i], enforce_limits=False)[1])
        sagging = np.linalg.norm(self.displacement[:, :3], axis=1) > SAG_BAND * arm.robot.reach
        for i in np.flatnonzero(sagging)[:1]:
            yield from ((int(i), flag) for flag in sag_doubts(arm, self.displacement[i]))
        if self.first_unseen is not None:
            number, flags = self.first_unseen
            yield from ((number, flag) for flag in flags)

    @cached_property
    def first_unseen(self) -> tuple[int, tuple[Flag, ...]] | None:
        """The first row whose loads are beyond those that a trained law has seen, and the doubts about it."""
        stack, acting = self.acting.arm.stack, self.acting
        if not stack.trained:
            return None
        for i, wrenches in enumerate(self.wrenches.reshape(len(self.q), -1)):
            flags = stack.doubts(wrenches, acting.arm.loaded(acting.payload(i)).row(self.q[i], acting.known(i)))
            if flags:
                return i, flags
        return None
