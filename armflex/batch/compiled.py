"""Where an arm under its own weight comes to rest, compiled by numba where that is installed: `pip install
armflex[fast]`. One configuration at a time for control loops, many for batches.

The formulas are those of `bending`, the steps those of `statics.solver.Solver.settle`. Some configurations go side by
side, in lanes, the last axis of every array. `lanes` is anything with their number as its length: for one lane a tuple,
so that the compiler knows and leaves the loops over them out; for many an array, whose loops it widens.

Compiling takes seconds, once: the code is kept beside this file, or where numba keeps such things. It is made anew
where this file is newer, not for changes of `compiled_chain` alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from armflex.batch.compiled_chain import displace, in_order, inner, straighten, tell, weigh
from armflex.conventions import Array
from armflex.statics.solver import ENOUGH, NEXT, SLOWEST, SMALL, STEPS

ONE, LANES = (0,), 48
"""A lane by itself, and how many a batch has: enough to fill the processor's registers, few enough for its caches."""
MOST_STEPS = len(STEPS)

LARGE = 1.5 * 2.0**52
HALVINGS, LOG_2_ROUND, LOG_2_REST = 1.0 / math.log(2.0), 0.6931471803691238, 1.9082149292705877e-10
"""The logarithm of two, in two parts: products of the first with small whole numbers are exact."""

jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})


class Arm(NamedTuple):
    """Numbers of an arm with a payload; see `Chain.numbers`."""

    links: Array
    kinds: Array
    order: Array
    outboard: Array
    ends: Array


class Laws(NamedTuple):
    """Numbers of its laws, for all rows or for each; see `BatchLaws.numbers`."""

    compliance: Array
    offset: Array
    neurons: Array
    starts: Array


class Room(NamedTuple):
    """Arrays of some lanes: those of `Straight`, but that a frame has three rows of `turn`, and what is worked with."""

    turn: Array
    origin: Array
    moment: Array
    tip: Array
    frame: Array
    moments: Array
    loads: Array
    twists: Array
    moved: Array
    pull: Array
    quaternion: Array
    lane: Array
    hidden: Array


def room_for(flexures: int, lanes: int, rooms: int = 1) -> Array:
    """Return memory for some times a `Room`, in rows of six: to cut it into others takes longer than to fill it."""
    return np.empty((rooms, 9 * flexures + 7, 6, lanes))


@jit
def answer_one(
    links,
    kinds,
    order,
    outboard,
    ends,
    compliance,
    offset,
    neurons,
    starts,
    bounds,
    room,
    hidden,
    exact,
    q,
    twists,
    displacement,
):
    """Fill the (6,) displacement and the (n, 6) twists at (nq,) positions; return whether they are an answer."""
    for j in range(len(q)):
        if not bounds[0, j] <= q[j] <= bounds[1, j]:
            return False
    arm, laws = Arm(links, kinds, order, outboard, ends), Laws(compliance, offset, neurons, starts)
    here = _divided(room, hidden, len(order))
    straighten(arm, here, q.reshape(1, -1), 0, ONE)
    weigh(arm, here, False, ONE)
    _rest(arm, laws, here, 0, exact, ONE)
    for i in range(len(order)):
        for a in range(6):
            twists[i, a] = here.twists[i, a, 0]
    displace(arm, here, ONE)
    tell(here, 0, displacement)
    return here.lane[0, 0] > 0.0


@jit
def answer_many(
    links, kinds, order, outboard, ends, compliance, offset, neurons, starts, rooms, ready, q, exact, displacement,
    wrenches, twists, fine,
):  # fmt: skip
    """Fill (N, 6) displacements, (N, n, 6) wrenches and twists, and (N,) whether they are answers, at (N, nq) q.

    There is one room, or one for as many rows as there are lanes. Those of a call before with the same arm and q are
    `ready`: the rigid arm need not be placed again, and the arm comes to rest from where it rested.
    """
    lanes, hidden = np.arange(LANES), np.empty(len(neurons) * LANES)
    arm, laws = Arm(links, kinds, order, outboard, ends), Laws(compliance, offset, neurons, starts)
    for first in range(0, len(q), len(lanes)):
        here = _divided(rooms[min(first // len(lanes), len(rooms) - 1)], hidden, len(order))
        if not ready:
            straighten(arm, here, q, first, lanes)
            weigh(arm, here, False, lanes)
        _rest(arm, laws, here, first, exact, lanes)
        if exact:
            weigh(arm, here, True, lanes)
        displace(arm, here, lanes)
        for c in range(min(len(lanes), len(q) - first)):
            row = first + c
            fine[row] = here.lane[0, c] > 0.0
            tell(here, c, displacement[row])
            for i in range(len(order)):
                for a in range(6):
                    wrenches[row, i, a], twists[row, i, a] = here.loads[i, a, c], here.twists[i, a, c]


@inner
def _divided(room, hidden, n):
    """Return memory divided into the arrays of some lanes."""
    last = room[9 * n :]
    return Room(
        turn=room[: 3 * n],
        origin=room[3 * n : 4 * n],
        moment=room[4 * n : 5 * n],
        tip=last[:1],
        frame=last[1:4],
        moments=room[5 * n : 6 * n],
        loads=room[6 * n : 7 * n],
        twists=room[7 * n : 8 * n],
        moved=room[8 * n : 9 * n],
        pull=last[4:5],
        quaternion=last[5],
        lane=last[6],
        hidden=hidden,
    )


@inner
def _rest(arm, laws, room, first, exact, lanes):
    """From the loads, leave loads and twists at rest; `fine` lanes are answers, as `Solver.settle` says."""
    _give(laws, room, room.twists, first, lanes)
    fine, size, before, drawn = room.lane[0], room.lane[1], room.lane[2], room.lane[3]
    _square(room.twists, size, lanes)
    for c in range(len(lanes)):
        fine[c] = 1.0 if size[c] < SMALL else 0.0
        before[c], drawn[c] = size[c], 0.0
    if exact:
        _settle(arm, laws, room, first, lanes)
        _square(room.twists, size, lanes)
        for c in range(len(lanes)):
            fine[c] *= drawn[c] if size[c] < SMALL else 0.0


@inner
def _settle(arm, laws, room, first, lanes):
    """Move the twists to rest; lanes that are drawn there, or never will be, are left where they are."""
    fine, size, before, drawn = room.lane[0], room.lane[1], room.lane[2], room.lane[3]
    twists, moved = room.twists, room.moved
    for c in range(len(lanes)):
        if fine[c] == 0.0:  # it would only make numbers that overflow
            for i in range(len(twists)):
                for a in range(6):
                    twists[i, a, c] = 0.0
    for _ in range(MOST_STEPS):
        weigh(arm, room, True, lanes)
        _give(laws, room, moved, first, lanes)
        for i in range(len(twists)):
            for a in range(6):
                for c in range(len(lanes)):
                    moved[i, a, c] = (moved[i, a, c] - twists[i, a, c]) * (fine[c] - drawn[c])
                    twists[i, a, c] += moved[i, a, c]
        _square(moved, size, lanes)
        moving = False
        for c in range(len(lanes)):
            if fine[c] > drawn[c]:
                if size[c] <= ENOUGH and size[c] * size[c] <= NEXT * before[c]:
                    drawn[c] = 1.0
                elif not size[c] < SLOWEST * before[c]:
                    fine[c] = 0.0
                else:
                    moving = True
            before[c] = size[c]
        if not moving:
            break


@inner
def _give(laws, room, twists, first, lanes):
    """Fill the (n, 6, W) twists that the laws give under the loads."""
    last = len(laws.compliance) - 1
    for i in range(len(twists)):
        if last == 0:
            _comply(laws, room.loads, twists, i, lanes)
        else:
            _comply_by_row(laws, room.loads, twists, i, first, lanes)
        if laws.starts[i] < laws.starts[i + 1]:
            _ask(laws, room, twists, i, lanes)


@inner
def _comply(laws, loads, twists, i, lanes):
    """Fill in what the compliance of flexure i gives, the same in all rows."""
    given = laws.compliance
    for a in range(6):
        # Looked up beforehand: to the compiler it might be the twists that these are stored in.
        offset, x, y, z = laws.offset[0, i, a], given[0, i, a, 0], given[0, i, a, 1], given[0, i, a, 2]
        u, v, t = given[0, i, a, 3], given[0, i, a, 4], given[0, i, a, 5]
        for c in range(len(lanes)):
            force = x * loads[i, 0, c] + y * loads[i, 1, c] + z * loads[i, 2, c]
            twists[i, a, c] = offset + force + u * loads[i, 3, c] + v * loads[i, 4, c] + t * loads[i, 5, c]


@inner
def _comply_by_row(laws, loads, twists, i, first, lanes):
    """Fill in what the compliance of flexure i gives, another in every row."""
    for c in range(len(lanes)):
        row = min(first + c, len(laws.compliance) - 1)
        for a in range(6):
            value = laws.offset[row, i, a]
            for b in range(6):
                value += laws.compliance[row, i, a, b] * loads[i, b, c]
            twists[i, a, c] = value


@inner
def _ask(laws, room, twists, i, lanes):
    """Add what the networks of flexure i give under its load."""
    neurons, hidden, loads = laws.neurons, room.hidden, room.loads
    first, count, w = laws.starts[i], laws.starts[i + 1] - laws.starts[i], len(lanes)
    for h in range(count):
        for c in range(w):
            value = neurons[first + h, 6]
            for b in range(6):
                value += neurons[first + h, b] * loads[i, b, c]
            hidden[h * w + c] = value
    _curve(hidden, count * w)
    for h in range(count):
        k = first + h
        # Looked up beforehand: to the compiler it might be the twists that these are stored in.
        x, y, z, u, v, t = neurons[k, 7], neurons[k, 8], neurons[k, 9], neurons[k, 10], neurons[k, 11], neurons[k, 12]
        for c in range(w):
            value = hidden[h * w + c]
            twists[i, 0, c] += x * value
            twists[i, 1, c] += y * value
            twists[i, 2, c] += z * value
            twists[i, 3, c] += u * value
            twists[i, 4, c] += v * value
            twists[i, 5, c] += t * value


@inner
def _curve(values, count):
    """Put tanh in the place of values: one long loop, which the compiler can widen."""
    for k in range(count):
        values[k] = _tanh(values[k])


@inner
def _tanh(x):
    """Return tanh to 4e-16, in a form that the compiler can do for many at once, which it cannot with the library's.

    `less` is exp(-2 |x|) - 1, whose series is taken between half powers of two.
    """
    r, power = _halved(-2.0 * min(abs(x), 20.0))
    high = 1 / 40320 + r * (1 / 362880 + r * (1 / 3628800 + r * (1 / 39916800 + r * (1 / 479001600 + r / 6227020800))))
    less = r * (
        1.0 + r * (1 / 2 + r * (1 / 6 + r * (1 / 24 + r * (1 / 120 + r * (1 / 720 + r * (1 / 5040 + r * high))))))
    )
    less = power * less + (power - 1.0)
    return math.copysign(less / (2.0 + less), x)


@in_order
def _halved(x):
    """Return the r and the power of two in exp(x) = power exp(r), |r| at most log(2) / 2.

    Added to a number so large, all that is left of the rest is whole halvings, in the last bits: the power's exponent.
    """
    large = x * HALVINGS + LARGE
    halvings = large - LARGE
    power = (np.float64(large).view(np.int64) + 1023) << 52
    return (x - halvings * LOG_2_ROUND) - halvings * LOG_2_REST, np.int64(power).view(np.float64)


@inner
def _square(twists, size, lanes):
    """Fill the (W,) sums of the squares of (n, 6, W) twists."""
    for c in range(len(lanes)):
        size[c] = 0.0
    for i in range(len(twists)):
        for a in range(6):
            for c in range(len(lanes)):
                size[c] += twists[i, a, c] * twists[i, a, c]
