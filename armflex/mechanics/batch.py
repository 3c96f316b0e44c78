"""Many questions to an arm at once: in arrays where the arm's own weight is all that acts, else one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from armflex.conventions import LARGEST_POSITION, Array, real_array
from armflex.errors import ExtrapolationError, ShapeError, naming
from armflex.mechanics.deflect import Asked, deflect, deflect_moving
from armflex.mechanics.deflection import Deflection
from armflex.mechanics.deflection_batch import Acting, DeflectionBatch
from armflex.mechanics.doubts import wrench_doubts
from armflex.mechanics.laws import RowLaws
from armflex.mechanics.loads import Payload, Wrench
from armflex.mechanics.rows import CHUNK, RowSolver, Solution
from armflex.mechanics.structure import Structure
from armflex.parallel import in_order

PIECE = 16384
"""Configurations that a process or thread is given at a time."""


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
    moving = tuple(_motion(arm, values, name, q) for values, name in zip(motion, "va", strict=True))
    acting = Acting(arm, names, moving, covariates, wrenches, asked)
    wrench_doubts(arm, wrenches)  # raises where a link is not the arm's
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
        solver = RowSolver(loaded, exact, (*acting.wrenches, *arm.pulls))
        for some in chunks(rows, CHUNK):
            row, whole = loaded.row(q[some], acting.known(some)), isinstance(some, slice)
            laws, into = RowLaws(arm.stack, row), found.some(some) if whole else Solution.empty(len(some), n)
            fine = solver.solve(row, laws, into)
            left[some] = ~(solver.proven(row, laws, into, solver.softening, fine) if exact else fine)
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
