"""Many questions to an arm at once: compiled where the arm stands still, else one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import LARGEST_POSITION, Array, real_array
from armflex.errors import ExtrapolationError, Flag, ShapeError, naming
from armflex.mechanics.deflection import Asked, Deflection, deflect
from armflex.mechanics.equilibrium import Equilibrium
from armflex.mechanics.laws import RowLaws
from armflex.mechanics.loaded import SAG_BAND, LoadedArm, rows_by_load
from armflex.mechanics.loads import Payload, Wrench
from armflex.mechanics.many_rows import (
    AT_ONCE,
    Pushes,
    RowSolver,
    Solution,
    chunks,
    flexure_poses,
    frame_loads,
    rigid_tips,
    rotations,
)
from armflex.mechanics.pinocchio_model import LoadCase
from armflex.mechanics.structure import Names, Structure
from armflex.parallel import in_order

PIECE = 16384
"""Configurations that a process or thread is given at a time."""

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

    def flags(self, loaded: LoadedArm) -> tuple[Flag, ...]:
        """Return the doubts about the arm, one of its payloads and the loads from outside."""
        return loaded.flags_under(self.wrenches, self.moving[1] is not None)

    def payload(self, i: int) -> str | Payload | None:
        """Return what is carried in a row."""
        return self.payloads[0 if len(self.payloads) == 1 else i]

    def case(self, q: Array, i: int) -> LoadCase:
        """Return what acts in a row, at checked (nq,) positions."""
        v, a = (None if values is None else values[i] for values in self.moving)
        return LoadCase(q, v, a, self.wrenches, self.known(i))

    def groups(self, count: int) -> Iterator[tuple[LoadedArm, np.ndarray]]:
        """Yield the arm with each payload, and the rows in which it is carried."""
        if len(self.payloads) == 1:
            yield self.arm.loaded(self.payloads[0]), np.arange(count)
            return
        yield from self._groups

    @cached_property
    def _groups(self) -> list[tuple[LoadedArm, np.ndarray]]:
        return rows_by_load(self.arm, self.payloads)


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
        mechanics, places = loaded.mechanics, loaded.flex.flexure_v
        motion, torque = np.zeros((2, mechanics.model.nv))
        motion[places], torque[places] = self.twists[i].ravel(), -self.wrenches[i].ravel()
        rigid, case = mechanics.rigid_configuration(checked), acting.case(checked, i)
        found = Equilibrium(loaded, case, rigid, motion, torque, acting.asked.method, ())
        return Deflection(found, (*acting.flags(loaded), *flags))

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
    def drive_loads(self) -> Array:
        """(N, nq) load on every drive about or along its joint's axis [Nm or N]."""
        moving, found = self.acting.arm.robot.moving, np.empty((len(self.q), len(self.acting.arm.robot.moving)))
        axes = [np.concatenate([j.axis, np.zeros(3)][:: 1 if j.kind == "prismatic" else -1]) for j in moving]
        for loaded, rows in self.acting.groups(len(self.q)) if self.acting.compiled else ():
            pushes = Pushes(loaded, self.acting.wrenches, sited=True)
            q, twists = np.ascontiguousarray(self.q[rows]), np.ascontiguousarray(self.twists[rows])
            at = [loaded.sites.names.index(f"link:{joint.name}") for joint in moving]
            links = frame_loads(loaded.sited_chain, pushes, q, twists, loaded.sites, at)
            found[rows] = np.einsum("nja,ja->nj", links, np.array(axes))
        for i in () if self.acting.compiled else range(len(self.q)):
            found[i] = np.einsum("ja,ja->j", self.row(i).joint_loads, np.array(axes))
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
            solver, laws = RowSolver(loaded, True, self.acting.wrenches), RowLaws(stack, row)
            if laws.curved:
                laws.expand(wrenches)
            at = Solution(self.displacement[rows], wrenches, self.twists[rows])
            gains, distance = solver.linearise(row, laws, at, np.arange(len(rows)))
            for i, part in enumerate(parts):
                if part is not None:
                    found[rows] += gains[:, :, i] @ part @ np.swapaxes(gains[:, :, i], 1, 2)
            left[rows] = ~(distance < 1.0)
        for i in np.flatnonzero(left).tolist():
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
        unseen = [] if self.first_unseen is None else [(self.first_unseen[0], flag) for flag in self.first_unseen[1]]
        found: dict[str, Flag] = {}
        for number, flag in sorted((*self.doubts, *unseen), key=lambda pair: pair[0]):
            found.setdefault(flag.code, Flag(flag.code, f"row {number}: {flag.text}"))
        return tuple(found.values())

    @property
    def doubts(self) -> list[tuple[int, Flag]]:
        """The doubts about arm, loads, limits and sag, with the first row of each kind; `unseen` has those of laws."""
        arm, found = self.acting.arm, []
        for loaded, rows in self.acting.groups(len(self.q)):
            if len(rows):
                found += [(int(rows[0]), flag) for flag in self.acting.flags(loaded)]
        outside = ((self.q < arm.robot.lower) | (self.q > arm.robot.upper)).any(axis=1)
        for i in np.flatnonzero(outside):
            found += [(int(i), flag) for flag in arm.check_position(self.q[i], enforce_limits=False)[1]]
        sagging = np.linalg.norm(self.displacement[:, :3], axis=1) > SAG_BAND * arm.robot.reach
        for i in np.flatnonzero(sagging)[:1]:
            found += [(int(i), flag) for flag in arm.loaded(None).sag_flags(self.displacement[i])]
        return found

    @cached_property
    def first_unseen(self) -> tuple[int, tuple[Flag, ...]] | None:
        """The first row whose loads are beyond those that a trained law has seen, and the doubts about it."""
        return next(self.unseen(), None)

    def unseen(self) -> Iterator[tuple[int, tuple[Flag, ...]]]:
        """Yield the rows whose loads are beyond those that a trained law has seen, and the doubts about them."""
        stack, acting = self.acting.arm.stack, self.acting
        for i, wrenches in enumerate(self.wrenches.reshape(len(self.q), -1)) if stack.trained else ():
            flags = stack.doubts(wrenches, acting.arm.loaded(acting.payload(i)).row(self.q[i], acting.known(i)))
            if flags:
                yield i, flags


def deflect_batch(
    arm: Structure,
    q: Array,
    payload: object,
    motion: Sequence[ArrayLike | None],
    covariates: dict[str, Array],
    wrenches: tuple[Wrench, ...],
    asked: Asked,
    jobs: int | None,
) -> DeflectionBatch:
    """Return what the arm does at (N, nq) positions; see `Arm.deflection`."""
    q = check_positions(arm, q, asked.enforce_limits)
    names = _payloads(payload, len(q))
    moving = (_motion(arm, motion[0], "v", q), _motion(arm, motion[1], "a", q))
    acting = Acting(arm, names, moving, covariates, wrenches, asked)
    arm.loaded(None).flags_under(wrenches, accelerated=False)  # raises where a link is not the arm's
    answers = Solution.empty(len(q), len(arm.sites))
    pieces = [slice(start, start + PIECE) for start in range(0, len(q), PIECE)]
    rooms = [answers.some(rows) for rows in pieces]
    alone, here = jobs in (None, 1), acting.compiled  # compiled code runs side by side in threads, Pinocchio does not
    tasks = [
        partial(_answer, acting.some(rows), q[rows], rows.start, room if alone or here else None)
        for rows, room in zip(pieces, rooms, strict=True)
    ]
    done = (task() for task in tasks) if alone else in_order(tasks, jobs, threads=here)
    for room, part in zip(rooms, done, strict=True):
        for into, values in zip(room, part, strict=True):
            if values is not into:
                into[:] = values
    found = DeflectionBatch(q, *answers, arm.names, acting)
    if asked.strict:
        _check_seen(found)
    return found


def check_positions(arm: Structure, q: Array, enforce_limits: bool) -> Array:
    """Return a copy of (N, nq) positions; raise as `Arm.check_position` does, naming the first row that is wrong."""
    lower, upper = np.maximum(arm.robot.lower, -LARGEST_POSITION), np.minimum(arm.robot.upper, LARGEST_POSITION)
    fits = q.shape[1] == len(lower)
    inside = (q >= lower) & (q <= upper) if fits else np.zeros((len(q), 1), dtype=bool)
    for i in () if inside.all() else np.flatnonzero(~inside.all(axis=1)):
        with naming(f"row {i}"):
            arm.check_position(q[i], enforce_limits)
    if not fits and not len(q):
        raise ShapeError(f"q: expected shape (N, {len(lower)}), got {q.shape}")
    return q.copy()


def _payloads(payload: object, count: int) -> tuple:
    if payload is None or isinstance(payload, str | Payload):
        return (payload,)
    names = tuple(payload)  # type: ignore[arg-type]
    if len(names) != count:
        raise ShapeError(f"payload: expected one name or {count}, got {len(names)}")
    return names


def _motion(arm: Structure, values: ArrayLike | None, name: str, q: Array) -> Array | None:
    if values is None:
        return None
    array = real_array(values, name)
    if array.shape != q.shape:
        raise ShapeError(f"{name}: expected shape {q.shape}, got {array.shape}")
    for i in np.flatnonzero(~(np.abs(array) <= LARGEST_POSITION).all(axis=1)):
        with naming(f"row {i}"):
            arm.checked(array[i], name)
    return array.copy()


def _check_seen(found: DeflectionBatch) -> None:
    unseen = found.first_unseen
    if unseen is not None:
        raise ExtrapolationError(f"row {unseen[0]}: " + "; ".join(flag.text for flag in unseen[1]))


@np.errstate(over="ignore", invalid="ignore")  # a row that runs away is not fine, and is asked alone
def _answer(acting: Acting, q: Array, first: int, room: Solution | None) -> Solution:
    """Return the answers at some positions, from row `first` on; in a room for them where there is one."""
    arm, exact, n = acting.arm, acting.asked.method == "exact", len(acting.arm.sites)
    found, left = room or Solution.empty(len(q), n), np.ones(len(q), dtype=bool)
    for loaded, rows in acting.groups(len(q)) if acting.compiled else ():
        solver = RowSolver(loaded, exact, acting.wrenches)
        for some in chunks(rows, AT_ONCE):
            row, whole = loaded.row(q[some], acting.known(some)), isinstance(some, slice)
            laws, into = RowLaws(arm.stack, row), found.some(some) if whole else Solution.empty(len(row.q), n)
            fine = solver.solve(row, laws, into)
            left[some] = ~(solver.proven(row, laws, into, solver.bound, fine) if exact else fine)
            if not whole:
                for part, values in zip(found, into, strict=True):
                    part[some] = values
    asked = acting.asked
    for i in np.flatnonzero(left).tolist():
        with naming(f"row {first + i}"):
            checked, flags = arm.check_position(q[i], asked.enforce_limits)
            loaded, case = arm.loaded(acting.payload(i)), acting.case(checked, i)
            one = deflect(loaded, case, flags, asked.method, asked.allow_large)
        for into, part in zip(found, (one.displacement, one.wrenches, one.twists), strict=True):
            into[i] = part
    return found
