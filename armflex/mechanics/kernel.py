"""The compiled engine: where a chain comes to rest at many configurations.

Compiling takes seconds, once: the code is kept beside this file, or where numba keeps such things.

**Equilibrium.** Everything is written in the base's axes about the rigid arm: flexing flexure k moves all that is
outboard of it by the screw `s_k = Ad(T_k) t_k`, with T_k the flexure's pose in the rigid arm, because

    J1 exp(t1) J2 exp(t2) ... = exp(s1) exp(s2) ... J1 J2 ...

A screw (v, w) moves a point x by `u + b w x u + c w x (w x u)` with `u = v + w x x`; b and c are the exponential's, as
series: they hold for turns up to 0.1 rad. Some configurations go side by side, in lanes, the last axis of every array.
`lanes` is anything with their number as its length: for one lane a tuple, so that the compiler knows and leaves the
loops over them out; for many an array, whose loops it widens.

How its tip responds to what is changed there is said by `tree_kernel`, of all arms.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from armflex.conventions import Array
from armflex.laws.terms import LEAST, Kind
from armflex.mechanics.chain import FLEXURE, ROTATED, SLIDES, TURNS
from armflex.mechanics.equilibrium import CONVERGED, NEXT, SMALL, STEPS
from armflex.mechanics.laws import Laws, LawStack
from armflex.mechanics.tree_kernel import compile_responses, respond_rows, rigid_tips
from armflex.mechanics.vectors import called, cross, dot, in_order, inner, minus, plus, times
from armflex.storage import kept_code
from armflex.storage.kept_code import kept

ONE, LANES = (0,), 48
"""A lane by itself, and how many a batch has: enough to fill the processor's registers, few enough for its caches."""
LARGE = 1.5 * 2.0**52
HALVINGS, LOG_2_ROUND, LOG_2_REST = 1.0 / math.log(2.0), 0.6931471803691238, 1.9082149292705877e-10
"""The logarithm of two, in two parts: products of the first with small whole numbers are exact."""
TURN, TURN_REST, TURNS_PER_RADIAN = 2.0 * math.pi, 2.4492935982947064e-16, 0.5 / math.pi
"""2 pi as a double, what it lacks, and turns in a radian: to divide takes longer."""

KINDS = (Kind.SIZE, Kind.CLIPPED, Kind.TANH, Kind.RAISED, Kind.RAMP)
SIZED, CLIPPED, BOUNDED, RAISED, RAMP = (float(kind) for kind in KINDS)


class Arm(NamedTuple):
    """Numbers of an arm with a payload, and the wrenches on its links; see `Tree` and `Pushes`."""

    elements: Array
    kinds: Array
    flexures: int
    links: np.ndarray
    wrenches: Array


class Room(NamedTuple):
    """Arrays of some lanes.

    turn, origin: Of every flexure in the rigid arm; three rows of `turn` each. moment: first moment about the base of
    what is between it and the next flexure. tip: where the rigid arm has it. frame: three rows, the frame that is
    walked with. points, pushes: where the rigid arm has the loaded links, and their wrenches. screws: two rows of each
    flexure, what `_screw` returns at the twists that were weighed last. The others are what is worked with.
    """

    turn: Array
    origin: Array
    moment: Array
    tip: Array
    frame: Array
    moments: Array
    loads: Array
    twists: Array
    moved: Array
    screws: Array
    seen: Array
    pull: Array
    wrench: Array
    quaternion: Array
    lane: Array
    points: Array
    pushes: Array
    hidden: Array


def room_for(flexures: int, links: int, lanes: int, rooms: int = 1) -> Array:
    """Return memory for some times a `Room`, in rows of six: to cut it into others takes longer than to fill it."""
    return np.empty((rooms, 12 * flexures + 8 + 2 * links, 6, lanes))


def packed(*arrays: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return arrays of one type behind one another in one, and views of it that are shaped as they are."""
    whole, starts = np.concatenate([one.ravel() for one in arrays]), np.cumsum([0, *(one.size for one in arrays)])
    return whole, [whole[i : i + one.size].reshape(one.shape) for i, one in zip(starts, arrays, strict=False)]


@kept
@called
def solve_one(numbers, counts, exact, q, twists, displacement):
    """Fill the (6,) displacement and the (n, 6) twists at (nq,) positions; return whether it converged.

    An array costs as long to be handed over as a joint to be placed, so those that stay are `packed`: in `numbers`
    elements, wrenches, compliance, offset, weights, neurons, bent, shapes, (2, nq) bounds of q, a room and as much
    memory as there are neurons; in `counts` those of elements, links, neurons, bent and shapes, then kinds, links,
    starts, spans and pieces. See `Arm` and `Laws`.
    """
    n, m, many, neurons, terms, features = len(twists), counts[0], counts[1], counts[2], counts[3], counts[4]
    a, b = 20 * (m + 1), 9 * many
    c, d, e = a + b, a + b + 36 * n, a + b + 42 * n
    f = e + terms
    g = f + 13 * neurons
    h = g + 43 * terms
    bounds = numbers[h + 45 * features :]
    for j in range(len(q)):
        if not bounds[j] <= q[j] <= bounds[len(q) + j]:
            return False
    k, o = 5 + 3 * m, 5 + 3 * m + 3 * many
    p, r = o + n + 1, o + 2 * (n + 1)
    chain, kinds, links = numbers[:a].reshape((m + 1, 20)), counts[5:k].reshape((3, m)), counts[k:o].reshape((many, 3))
    arm = Arm(chain, kinds, n, links, numbers[a:c].reshape((1, many, 9)))
    laws = Laws(
        numbers[c:d].reshape((1, n, 6, 6)),
        numbers[d:e].reshape((1, n, 6)),
        numbers[f:g].reshape((neurons, 13)),
        counts[o:p],
        numbers[g:h].reshape((terms, 43)),
        numbers[h : h + 45 * features].reshape((features, 45)),
        counts[p:r],
        counts[r:],
        numbers[e:f].reshape((1, terms)),
    )
    memory, rows = bounds[2 * len(q) :], 12 * n + 8 + 2 * many
    here = _divided(memory[: 6 * rows].reshape((rows, 6, 1)), memory[6 * rows :], n, many)
    _gather(arm, here, 0, ONE)
    _place(arm, here, q.reshape(1, -1), 0, ONE)
    _weigh(arm, here, False, ONE)
    _solve(arm, laws, here, 0, exact, ONE)
    for i in range(len(twists)):
        for a in range(6):
            twists[i, a] = here.twists[i, a, 0]
    _displace(arm, here, ONE)
    _write_displacement(here, 0, displacement)
    return here.lane[0, 0] > 0.0


@kept
@called
def solve_many(
    elements, kinds, links, wrenches, laws, rooms, ready, q, exact, displacement, loads, twists, converged,
):  # fmt: skip
    """Fill (N, 6) displacements, (N, n, 6) loads and twists, and (N,) whether they are solutions, at (N, nq) q.

    Loads of no rows are not asked for: they are a pass over the arm more, and most of what is written.
    There is one room, or one for as many rows as there are lanes. Those of a call before with the same arm and q are
    `ready`: the rigid arm need not be placed again, and the arm comes to rest from where it rested.
    """
    lanes, hidden, n = np.arange(LANES), np.empty(len(laws.neurons) * LANES), twists.shape[1]
    arm = Arm(elements, kinds, n, links, wrenches)
    for first in range(0, len(q), len(lanes)):
        here = _divided(rooms[min(first // len(lanes), len(rooms) - 1)], hidden, n, len(links))
        _gather(arm, here, first, lanes)
        if not ready:
            _place(arm, here, q, first, lanes)
            _weigh(arm, here, False, lanes)
        _solve(arm, laws, here, first, exact, lanes)
        if exact and len(loads) > 0:
            _weigh(arm, here, True, lanes)
        _displace(arm, here, lanes)
        for c in range(min(len(lanes), len(q) - first)):
            row = first + c
            converged[row] = here.lane[0, c] > 0.0
            _write_displacement(here, c, displacement[row])
            for i in range(n):
                for a in range(6):
                    twists[row, i, a] = here.twists[i, a, c]
                    if len(loads) > 0:
                        loads[row, i, a] = here.loads[i, a, c]


@inner
def _divided(room, hidden, n, links):
    """Return memory divided into the arrays of some lanes."""
    last = room[12 * n :]
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
        screws=room[9 * n : 11 * n],
        seen=room[11 * n : 12 * n],
        pull=last[4],
        wrench=last[5],
        quaternion=last[6],
        lane=last[7],
        points=last[8 : 8 + links],
        pushes=last[8 + links :],
        hidden=hidden,
    )


# Equilibrium.


@inner
def _solve(arm, laws, room, first, exact, lanes):
    """From the loads, leave loads and twists at rest; lanes that converged are 1 in `lane[0]`, others 0."""
    _deform(laws, room, room.twists, first, lanes)
    fine, size, before, drawn = room.lane[0], room.lane[1], room.lane[2], room.lane[3]
    _square(room.twists, size, lanes)
    for c in range(len(lanes)):
        fine[c] = 1.0 if size[c] < SMALL else 0.0
        before[c], drawn[c] = size[c], 0.0
    if exact:
        _iterate(arm, laws, room, first, lanes)
        _square(room.twists, size, lanes)
        for c in range(len(lanes)):
            fine[c] *= drawn[c] if size[c] < SMALL else 0.0


@inner
def _iterate(arm, laws, room, first, lanes):
    """Move the twists to rest; lanes that are drawn there, or never will be, are left where they are."""
    fine, size, before, drawn = room.lane[0], room.lane[1], room.lane[2], room.lane[3]
    twists, moved = room.twists, room.moved
    for c in range(len(lanes)):
        if fine[c] == 0.0:  # it would only make numbers that overflow
            for i in range(len(twists)):
                for a in range(6):
                    twists[i, a, c] = 0.0
    for _ in range(STEPS):
        _weigh(arm, room, True, lanes)
        _deform(laws, room, moved, first, lanes)
        for i in range(len(twists)):
            for a in range(6):
                for c in range(len(lanes)):
                    moved[i, a, c] = (moved[i, a, c] - twists[i, a, c]) * (fine[c] - drawn[c])
                    twists[i, a, c] += moved[i, a, c]
        _square(moved, size, lanes)
        moving = False
        for c in range(len(lanes)):
            if fine[c] > drawn[c]:
                if size[c] <= CONVERGED and size[c] * size[c] <= NEXT * before[c]:
                    drawn[c] = 1.0
                elif not size[c] < SMALL:  # shifts and turns may take turns in shrinking
                    fine[c] = 0.0
                else:
                    moving = True
            before[c] = size[c]
        if not moving:
            break


@inner
def _square(twists, size, lanes):
    """Fill the (W,) sums of the squares of (n, 6, W) twists."""
    for c in range(len(lanes)):
        size[c] = 0.0
    for i in range(len(twists)):
        for a in range(6):
            for c in range(len(lanes)):
                size[c] += twists[i, a, c] * twists[i, a, c]


# Laws.


@inner
def _deform(laws, room, twists, first, lanes):
    """Fill the (n, 6, W) twists that the laws give under the loads."""
    last = len(laws.compliance) - 1
    for i in range(len(twists)):
        if last == 0:
            _comply(laws, room.loads, twists, i, lanes)
        else:
            _comply_by_row(laws, room.loads, twists, i, first, lanes)
        if laws.starts[i] < laws.starts[i + 1]:
            _add_networks(laws, room, twists, i, lanes)
        if laws.spans[i] < laws.spans[i + 1]:
            _add_curves(laws, room.loads, twists, i, first, lanes)


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
def _add_networks(laws, room, twists, i, lanes):
    """Add what the networks of flexure i give under its load."""
    neurons, hidden, loads = laws.neurons, room.hidden, room.loads
    first, count, w = laws.starts[i], laws.starts[i + 1] - laws.starts[i], len(lanes)
    for h in range(count):
        for c in range(w):
            value = neurons[first + h, 6]
            for b in range(6):
                value += neurons[first + h, b] * loads[i, b, c]
            hidden[h * w + c] = value
    _activate(hidden, count * w)
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


@called
def _add_curves(laws, loads, twists, i, first, lanes):
    """Add what the curved terms of flexure i give; see `laws.terms`."""
    bent, shapes = laws.bent, laws.shapes
    for t in range(laws.spans[i], laws.spans[i + 1]):
        for c in range(len(lanes)):
            value = laws.weights[min(first + c, len(laws.weights) - 1), t]
            for s in range(laws.pieces[t], laws.pieces[t + 1]):
                kind, part = shapes[s, 0], shapes[s, 1]
                if kind == RAISED:
                    for a in range(6):
                        for b in range(6):
                            part += loads[i, a, c] * shapes[s, 9 + 6 * a + b] * loads[i, b, c]
                    part, power = max(part, LEAST), shapes[s, 2]
                    if power == -0.5:
                        value /= math.sqrt(part)
                    elif power == 0.5:
                        value *= math.sqrt(part)
                    else:
                        value *= part**power
                else:
                    for a in range(6):
                        part += shapes[s, 3 + a] * loads[i, a, c]
                    if kind == SIZED:
                        part = abs(part)
                    elif kind == CLIPPED:
                        part = min(max(part, -1.0), 1.0)
                    elif kind == BOUNDED:
                        part = _tanh(part)
                    elif kind == RAMP:
                        part = max(part, 0.0)
                    value *= part
            for a in range(6):
                given = bent[t, 36 + a]
                if bent[t, 42] > 0.0:
                    for b in range(6):
                        given += bent[t, 6 * a + b] * loads[i, b, c]
                twists[i, a, c] += value * given


@inner
def _activate(values, count):
    """Put tanh in the place of values: one long loop, which the compiler can widen.

    Written out where it is needed it makes all of `_iterate` a quarter slower, with networks or without.
    """
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


# The rigid arm. Numbers are looked up one by one: views of arrays take longer than what is done with them.


@inner
def _place(arm, room, q, first, lanes):
    """Place the rigid arm at the rows of q from `first` on; past the end the last stands for those that are not."""
    here, tip, moment, elements = room.frame, room.tip, room.moment, arm.elements
    _begin(room, lanes)
    sine, less, carrier, last, m = room.lane[4], room.lane[5], -1, len(q) - 1, arm.kinds.shape[1]
    for k in range(1, m):  # the root stands, and what acts on it loads no flexure
        kind, own = arm.kinds[0, k], arm.kinds[1, k]
        _shift(tip, 0, here, elements[k, 9], elements[k, 10], elements[k, 11], lanes)
        if kind & ROTATED:
            _rotate(here, elements, k, lanes)
            kind -= ROTATED
        if kind == FLEXURE:
            carrier = own
            _keep(room, own, lanes)
        elif kind == TURNS:
            for c in range(len(lanes)):
                sine[c], less[c] = _sine_and_less(q[min(first + c, last), own])
            _swing(here, elements[k, 12], elements[k, 13], elements[k, 14], sine, less, lanes)
        elif kind == SLIDES:
            for i in range(3):
                for c in range(len(lanes)):
                    along = here[i, 0, c] * elements[k, 12] + here[i, 1, c] * elements[k, 13]
                    along += here[i, 2, c] * elements[k, 14]
                    tip[0, i, c] += along * q[min(first + c, last), own]
        mass = elements[k, 15]
        if mass > 0.0 and carrier >= 0:
            for i in range(3):
                for c in range(len(lanes)):
                    moment[carrier, i, c] += mass * tip[0, i, c]
            _shift(moment, carrier, here, mass * elements[k, 16], mass * elements[k, 17], mass * elements[k, 18], lanes)
        for j in range(len(arm.links)):
            if arm.links[j, 0] == k:
                for i in range(3):
                    for c in range(len(lanes)):
                        room.points[j, i, c] = tip[0, i, c]
                _shift(room.points, j, here, arm.wrenches[0, j, 0], arm.wrenches[0, j, 1], arm.wrenches[0, j, 2], lanes)
                for i in range(6 if arm.links[j, 2] else 0):
                    for c in range(len(lanes)):
                        own, b = arm.wrenches[min(first + c, len(arm.wrenches) - 1), j], i % 3
                        along = here[b, 0, c] * own[3 + i - b] + here[b, 1, c] * own[4 + i - b]
                        room.pushes[j, i, c] = along + here[b, 2, c] * own[5 + i - b]
    _shift(tip, 0, here, elements[m, 9], elements[m, 10], elements[m, 11], lanes)


@inner
def _gather(arm, room, first, lanes):
    """Fill the wrenches that do not follow their links."""
    last = len(arm.wrenches) - 1
    for j in range(len(arm.links)):
        for i in range(0 if arm.links[j, 2] else 6):
            for c in range(len(lanes)):
                room.pushes[j, i, c] = arm.wrenches[min(first + c, last), j, 3 + i]


@inner
def _sine_and_less(angle):
    """Return the sine of an angle, and what its cosine is less than 1, to 1e-15: the library's cannot be widened.

    By the series of a quarter of the angle, which is doubled twice.
    """
    x = 0.25 * _within_a_turn(angle)
    y = x * x
    high = 1 / 362880 - y * (1 / 39916800 - y * (1 / 6227020800 - y * (1 / 1307674368000 - y / 355687428096000)))
    sine = x * (1.0 - y * (1 / 6 - y * (1 / 120 - y * (1 / 5040 - y * high))))
    high = 1 / 3628800 - y * (1 / 479001600 - y * (1 / 87178291200 - y / 20922789888000))
    cosine = 1.0 - y * (0.5 - y * (1 / 24 - y * (1 / 720 - y * (1 / 40320 - y * high))))
    cosine, sine = 1.0 - 2.0 * sine * sine, 2.0 * sine * cosine
    return 2.0 * sine * cosine, 2.0 * sine * sine


@in_order
def _within_a_turn(angle):
    """Return the angle but for whole turns: what 2 pi is more than its double is taken off by itself."""
    turns = np.rint(angle * TURNS_PER_RADIAN)
    return (angle - turns * TURN) - turns * TURN_REST


@inner
def _begin(room, lanes):
    for i in range(3):
        for c in range(len(lanes)):
            room.tip[0, i, c] = 0.0
            for j in range(3):
                room.frame[i, j, c] = 1.0 if i == j else 0.0
            for k in range(len(room.moment)):
                room.moment[k, i, c] = 0.0


@inner
def _keep(room, k, lanes):
    """Keep where flexure k is."""
    for i in range(3):
        for c in range(len(lanes)):
            room.origin[k, i, c] = room.tip[0, i, c]
            for j in range(3):
                room.turn[3 * k + i, j, c] = room.frame[i, j, c]


@inner
def _shift(points, k, here, x, y, z, lanes):
    """Add a vector in turned axes to the (3, W) point k."""
    for i in range(3):
        for c in range(len(lanes)):
            points[k, i, c] += here[i, 0, c] * x + here[i, 1, c] * y + here[i, 2, c] * z


@inner
def _rotate(here, elements, k, lanes):
    """Turn frames by the rotation of element k."""
    for i in range(3):
        for c in range(len(lanes)):
            x, y, z = here[i, 0, c], here[i, 1, c], here[i, 2, c]
            here[i, 0, c] = x * elements[k, 0] + y * elements[k, 3] + z * elements[k, 6]
            here[i, 1, c] = x * elements[k, 1] + y * elements[k, 4] + z * elements[k, 7]
            here[i, 2, c] = x * elements[k, 2] + y * elements[k, 5] + z * elements[k, 8]


@inner
def _swing(here, ax, ay, az, sine, less, lanes):
    """Turn frames about one of their axes, by the sines of angles and what their cosines are less than 1."""
    for i in range(3):
        for c in range(len(lanes)):
            row = _at(here, i, 0, c)
            across = cross(row, (ax, ay, az))  # a row of the frame times exp(axis) turns the other way about the axis
            bent = plus(times(sine[c], across), times(less[c], cross(across, (ax, ay, az))))
            here[i, 0, c], here[i, 1, c], here[i, 2, c] = plus(row, bent)


# Loads and the tip of the flexed arm.


@inner
def _screw(room, k, c):
    """Return the screw of flexure k in lane c, linear and angular, with the exponential's coefficients and its turn."""
    turn = _at(room.turn, 3 * k, 0, c), _at(room.turn, 3 * k + 1, 0, c), _at(room.turn, 3 * k + 2, 0, c)
    about, way = _at(room.twists, k, 3, c), _at(room.twists, k, 0, c)
    w, s = (dot(turn[0], about), dot(turn[1], about), dot(turn[2], about)), dot(about, about)
    v = minus((dot(turn[0], way), dot(turn[1], way), dot(turn[2], way)), cross(w, _at(room.origin, k, 0, c)))
    second = 0.5 - s * (1 / 24 - s * (1 / 720 - s / 40320))
    third = 1 / 6 - s * (1 / 120 - s * (1 / 5040 - s / 362880))
    return v, w, (second, third, s)


@inner
def _at(rows, k, first, c):
    """Return three numbers of row k, from one on, in lane c."""
    return rows[k, first, c], rows[k, first + 1, c], rows[k, first + 2, c]


@inner
def _moved(mass, moment, screw):
    """Return how far a screw moves what has a mass and a first moment: a point has a mass of 1."""
    v, w, (b, t, _) = screw
    once = plus(times(mass, v), cross(w, moment))
    twice = cross(w, once)
    return plus(once, plus(times(b, twice), times(t, cross(w, twice))))


@inner
def _weigh(arm, room, flexed, lanes):
    """Fill the loads on the flexures under the weight and the wrenches; without `flexed` those of the rigid arm."""
    moments, n, last = room.moments, arm.flexures, arm.kinds.shape[1]
    for i in range(3):
        for c in range(len(lanes)):
            room.pull[i, c] = arm.elements[last, 12 + i]
            for k in range(n):
                moments[k, i, c] = room.moment[k, i, c]
    for k in range(n if flexed else 0):
        for c in range(len(lanes)):
            screw = _screw(room, k, c)
            for a in range(3):
                room.screws[2 * k, a, c], room.screws[2 * k, 3 + a, c] = screw[0][a], screw[1][a]
                room.screws[2 * k + 1, a, c] = screw[2][a]
    for step in range(n - 1, 0, -1):
        k, before = arm.kinds[2, step], arm.kinds[2, step - 1]
        for i in range(3):
            for c in range(len(lanes)):
                moments[before, i, c] += moments[k, i, c]
        if flexed:
            _carry(arm.elements[k, 19], room, k, before, lanes)
    for step in range(n):
        k = arm.kinds[2, step]
        if flexed:
            _lean(room.pull, 0, room, k, -1.0, lanes)
        _load(arm.elements[k, 19], room, k, lanes)
    for j in range(len(arm.links)):
        _push(arm, room, j, flexed, lanes)


@inner
def _kept(room, k, c):
    """Return what `_screw` did for flexure k in lane c."""
    screws = room.screws
    return _at(screws, 2 * k, 0, c), _at(screws, 2 * k, 3, c), _at(screws, 2 * k + 1, 0, c)


@inner
def _carry(mass, room, k, before, lanes):
    """Add to the moments about the flexure before k how far k moves what is outboard of it."""
    for c in range(len(lanes)):
        moved = _moved(mass, _at(room.moments, k, 0, c), _kept(room, k, c))
        for i in range(3):
            room.moments[before, i, c] += moved[i]


@inner
def _lean(vectors, first, room, k, sense, lanes):
    """Turn three rows by flexure k: back, -1, instead of everything outboard of it forth, or forth, 1."""
    for c in range(len(lanes)):
        vector = vectors[first, c], vectors[first + 1, c], vectors[first + 2, c]
        _, w, (b, t, s) = _kept(room, k, c)
        across = cross(w, vector)
        turn = plus(times(b, cross(w, across)), times(sense * (1.0 - t * s), across))
        vectors[first, c], vectors[first + 1, c], vectors[first + 2, c] = plus(vector, turn)


@inner
def _load(mass, room, k, lanes):
    """Fill the loads on flexure k in its own axes."""
    for c in range(len(lanes)):
        pull = room.pull[0, c], room.pull[1, c], room.pull[2, c]
        lever = minus(_at(room.moments, k, 0, c), times(mass, _at(room.origin, k, 0, c)))
        for a in range(6):
            room.loads[k, a, c] = 0.0
        _add_load(room, k, c, times(mass, pull), cross(lever, pull))


@inner
def _add_load(room, k, c, force, moment):
    """Add a force and a moment, base axes, to the load on flexure k in lane c."""
    for j in range(3):
        axis = room.turn[3 * k, j, c], room.turn[3 * k + 1, j, c], room.turn[3 * k + 2, j, c]
        room.loads[k, j, c] += dot(axis, force)
        room.loads[k, 3 + j, c] += dot(axis, moment)


@called
def _push(arm, room, j, flexed, lanes):
    """Add to the loads those of the wrench on link j.

    Its point is moved by the flexures between it and the one that it loads. As the weight it is turned back by that one
    and those inboard of it; one that follows its link is turned forth as the point is moved.
    """
    wrench, follows, outmost = room.wrench, arm.links[j, 2] != 0, arm.links[j, 1] - 1
    if outmost < 0:
        return
    turned = False
    for i in range(6):
        for c in range(len(lanes)):
            wrench[i, c] = room.pushes[j, i, c]
            turned |= i > 2 and wrench[i, c] != 0.0
    for i in range(3):
        for c in range(len(lanes)):
            room.seen[outmost, i, c] = room.points[j, i, c]
    for step in range(outmost, -1, -1):
        k = arm.kinds[2, step]
        if follows:
            _bear(room, step, k, lanes)
        if step > 0:
            _see(room, step, k, flexed, lanes)
            if flexed and follows:
                _lean(wrench, 0, room, k, 1.0, lanes)
                if turned:
                    _lean(wrench, 3, room, k, 1.0, lanes)
    for step in range(0 if follows else outmost + 1):
        k = arm.kinds[2, step]
        if flexed:
            _lean(wrench, 0, room, k, -1.0, lanes)
            if turned:
                _lean(wrench, 3, room, k, -1.0, lanes)
        _bear(room, step, k, lanes)


@inner
def _see(room, step, k, flexed, lanes):
    """Fill where the flexure before step sees the point of a wrench, which flexure k moves."""
    seen = room.seen
    for c in range(len(lanes)):
        point = _at(seen, step, 0, c)
        if flexed:
            point = plus(point, _moved(1.0, point, _kept(room, k, c)))
        seen[step - 1, 0, c], seen[step - 1, 1, c], seen[step - 1, 2, c] = point


@inner
def _bear(room, step, k, lanes):
    """Add a wrench at the point that is seen to the load on flexure k."""
    wrench = room.wrench
    for c in range(len(lanes)):
        force, moment = (wrench[0, c], wrench[1, c], wrench[2, c]), (wrench[3, c], wrench[4, c], wrench[5, c])
        lever = minus(_at(room.seen, step, 0, c), _at(room.origin, k, 0, c))
        _add_load(room, k, c, force, plus(moment, cross(lever, force)))


@inner
def _displace(arm, room, lanes):
    """Leave in `pull` how far the twists move the tip, and in `quaternion` how they turn it, real part first."""
    tip, shift, quaternion = room.tip, room.pull, room.quaternion
    for c in range(len(lanes)):
        shift[0, c] = shift[1, c] = shift[2, c] = 0.0
        quaternion[0, c], quaternion[1, c], quaternion[2, c], quaternion[3, c] = 1.0, 0.0, 0.0, 0.0
    for step in range(arm.flexures - 1, -1, -1):
        for c in range(len(lanes)):
            screw = _screw(room, arm.kinds[2, step], c)
            (u, v, w), s = screw[1], screw[2][2]
            moved = _moved(1.0, plus(_at(tip, 0, 0, c), (shift[0, c], shift[1, c], shift[2, c])), screw)
            for a in range(3):
                shift[a, c] += moved[a]
            half = 0.5 - s * (1 / 48 - s * (1 / 3840 - s / 645120))
            a = 1.0 - s * (1 / 8 - s * (1 / 384 - s / 46080))
            u, v, w = half * u, half * v, half * w
            r, i, j, k = quaternion[0, c], quaternion[1, c], quaternion[2, c], quaternion[3, c]
            quaternion[0, c] = a * r - (u * i + v * j + w * k)
            quaternion[1, c] = a * i + r * u + v * k - w * j
            quaternion[2, c] = a * j + r * v + w * i - u * k
            quaternion[3, c] = a * k + r * w + u * j - v * i


@inner
def _write_displacement(room, c, displacement):
    """Fill the (6,) shift and rotation vector of a lane."""
    r, i, j, k = room.quaternion[0, c], room.quaternion[1, c], room.quaternion[2, c], room.quaternion[3, c]
    sine = math.sqrt(i * i + j * j + k * k)
    times = 2.0 if sine < 1e-8 else 2.0 * math.atan2(sine, r) / sine
    for a in range(3):
        displacement[a], displacement[3 + a] = room.pull[a, c], times * room.quaternion[1 + a, c]


ENTRIES = solve_many, respond_rows, rigid_tips


def compile_everything() -> None:
    """Compile what is not yet kept: it takes some seconds, and is better done beforehand."""
    compile_responses()
    compile_chains()


def compile_chains() -> None:
    """Compile where chains rest, by asking about no rows."""
    arm = np.zeros((1, 20)), np.zeros((3, 0), dtype=np.int64), np.zeros((0, 3), dtype=np.int64), np.zeros((1, 0, 9))
    q, twists, tip, nobody = np.zeros((0, 0)), np.zeros((0, 0, 6)), np.zeros((0, 6)), np.zeros(0, dtype=bool)
    with kept_code.compiled_once(solve_many):
        numbers = LawStack((), ()).numbers
        solve_many(*arm, numbers, room_for(0, 0, LANES), False, q, True, tip, twists, twists, nobody)


def compile_one() -> None:
    """Compile the answer to one row at a time, which only a control loop asks for: of a joint beyond its bounds."""
    with kept_code.compiled_once(solve_one):
        solve_one(np.zeros(32), np.zeros(5, dtype=np.int64), True, np.ones(1), np.zeros((0, 6)), np.zeros(6))


def is_kept() -> bool:
    """Return whether nothing of what `compile_everything` compiles has to be."""
    return kept_code.is_kept(*ENTRIES)
