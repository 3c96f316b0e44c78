"""Many questions to an arm at once: in arrays where the arm's own weight is all that acts, else one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from armflex.arm_doubts import wrench_doubts
from armflex.batch.deflection_batch import Acting, DeflectionBatch
from armflex.batch.laws import BatchLaws
from armflex.batch.solver import MANY, BatchSolver, Found, compiled, room_for
from armflex.conventions import LARGEST_POSITION, Array, real_array
from armflex.errors import ExtrapolationError, ShapeError, naming
from armflex.parallel import in_order
from armflex.statics.deflect import Asked, deflect, deflect_moving
from armflex.statics.deflection import Deflection
from armflex.statics.loads import Payload, Wrench

if TYPE_CHECKING:
    from armflex.arm import Arm

PIECE = 16384
"""Configurations that a process or thread is given at a time."""


def deflect_batch(
    arm: Arm,
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
    moving = tuple(_motion(arm, values, name, q) for values, name in zip(motion, "va", strict=True))
    acting = Acting(arm, names, moving, covariates, wrenches, asked)
    wrench_doubts(arm, wrenches)  # raises where a link is not the arm's
    answers = room_for(len(q), len(arm.modelled))
    pieces = [slice(start, start + PIECE) for start in range(0, len(q), PIECE)]
    rooms = [tuple(part[rows] for part in answers) for rows in pieces]
    alone = jobs in (None, 1)
    here = alone or _in_threads(acting, q)  # where what is written is ours
    tasks = [
        partial(_answer, acting.some(rows), q[rows], rows.start, len(q), room if here else None)
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


def check_positions(arm: Arm, q: Array, enforce_limits: bool) -> Array:
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


def _motion(arm: Arm, values: ArrayLike | None, name: str, q: Array) -> Array | None:
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


def _in_threads(acting: Acting, q: Array) -> bool:
    """Return whether the rows are answered by compiled code, which threads can run side by side."""
    if compiled() is None or len(q) < MANY or not acting.still:
        return False
    row = acting.arm.loaded(acting.payload(0)).row(q[:1], acting.some(slice(0, 1)).covariates)
    return BatchLaws(acting.arm.stack, row).numbers is not None


def _answer(acting: Acting, q: Array, first: int, total: int, room: Found | None) -> Found:
    """Return the answers at some of `total` positions, from row `first` on; in a room for them where there is one."""
    count, n = len(q), len(acting.arm.modelled)
    found, left = room or room_for(count, n), np.ones(count, dtype=bool)
    for loaded, rows in acting.groups(count) if acting.still else ():
        solver = BatchSolver(loaded, acting.asked.method == "exact", total)
        for some in chunks(rows, solver.chunk):
            row, whole = loaded.row(q[some], acting.known(some)), isinstance(some, slice)
            into = tuple(part[some] for part in found) if whole else room_for(len(row.q), n)
            left[some] = ~solver.settle(row, BatchLaws(loaded.arm.stack, row), loaded.softening, into)
            if not whole:
                for part, values in zip(found, into, strict=True):
                    part[some] = values
    for i in np.flatnonzero(left):
        with naming(f"row {first + i}"):
            one = alone(acting, q, int(i))
        for into, part in zip(found, (one.displacement, one.wrenches, one.twists), strict=True):
            into[i] = part
    return found


def chunks(rows: np.ndarray, size: int) -> Iterator[slice | np.ndarray]:
    """Yield rows `size` at a time, as slices where they follow each other: those are not copied."""
    together = len(rows) > 0 and rows[-1] - rows[0] + 1 == len(rows)
    for start in range(0, len(rows), size):
        some = rows[start : start + size]
        yield slice(int(some[0]), int(some[-1]) + 1) if together else some


def alone(acting: Acting, q: Array, i: int) -> Deflection:
    """Return the answer in one row, asked by itself."""
    arm, asked = acting.arm, acting.asked
    checked, flags = arm.check_position(q[i], asked.enforce_limits)
    loaded, known, plain = arm.loaded(acting.payload(i)), acting.known(i), asked._replace(strict=False)
    if acting.wrenches or acting.moves:
        return deflect_moving(loaded, checked, flags, known, plain, acting.motion(i), acting.wrenches)
    return deflect(loaded, checked, flags, known, plain)
