"""The compiled engine of arms that rest: how a tip responds to what may be otherwise, and where loops close and rest.

It is `Mechanism` in numbers; a chain is one without closures, and `kernel` finds where it rests. All is written in the
base's axes about its origin. The coordinates z are positions of passive joints and y of laws R y, R S' = C; each moves
all that its element carries by a spatial twist s. A closure gaps by `W (V2 - V1)` of the twists of its ends, its forces
f put the wrench W'f on its first end and minus that on the second. With A = W s, F the load on all that an element
carries and G the change of -s F with z, every step solves

    | 1_y + G   A' | | dz |   | s F - y |
    |   A      -D  | | df | = |  -gap   |      D: a unit for what nothing answers to

without G in the first step, with it as it was there from the second on. What does not settle is left to `Mechanism`, as
is all that needs to be said.

**It stays** where 1_y + Z' G Z is positive along the motions Z that its loops allow, by coordinate of laws. A norm of
Z' G Z below 1 is a proof, as Cholesky's factor is. With V the twists of elements, G is

    Z' G Z = - sum_k (V x s) . F - sum_bodies V . dw + sum_ties (V2 - V1) . dh

w what acts on a body and h the wrench of a tie as they move with them. One pass out and one back make that linear in a
twist that is inserted anywhere, see `_spread`: the rest of what there is to know.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from armflex.conventions import Array
from armflex.mechanics.certificate import SHARE
from armflex.mechanics.chain import FLEXURE, RIGID, ROTATED, SLIDES, TURNS, Tree
from armflex.mechanics.equilibrium import CONVERGED, SLOWEST, SMALL, STEPS
from armflex.mechanics.laws import LawStack
from armflex.mechanics.mechanism import ALIGNED, ASSEMBLED, CLOSED, LONGEST, MOST, ROUNDED
from armflex.mechanics.spring import SHORTEST
from armflex.mechanics.vectors import (
    WIDE,
    add_columns,
    bare,
    called,
    columns,
    cross,
    dot,
    inner,
    minus,
    pack,
    plus,
    put,
    put_pack,
    three,
    times,
    turned,
    turned_back,
)  # fmt: skip
from armflex.storage import kept_code
from armflex.storage.kept_code import kept

ROD, GEAR, COIL, GAS = range(4, 8)
"""Kinds of ties: cylinders, followers, and springs by their law; pins are 0 to 3, by how many axes they hold."""

NEAR_SINGULAR = 1e-8
"""Squared share of the closures' singular values below which `Mechanism` looks at them."""

ROUNDING = 1e-12
"""Share of the largest compliance below which one is symmetric, and nowhere negative."""

ENDS = 1e-28
"""Squared length of a step that is none, and of the one to come, were it to shrink as the last one did."""

SQUARED = 1e-8
"""Step of passive joints [m, rad] after which the next would be rounding, as it is about the square."""


TIP = 8
"""Columns of a frame's six motions."""


class Here(NamedTuple):
    """Where a mechanism is: d drives, p passive joints, and y coordinates of its laws.

    turn, origin: of every element. screws, carriers: (d + p + y) spatial twists of joints and laws, of which those of a
    closure have none, and their elements. roots, owner: (y, 6) R by rows, and the flexure of each; rank: how many there
    are. loads: (k, 6) on all that an element carries. twists, load: (n, 6) of flexures. gaps, forces: (m). ways: (m, 6)
    W, and then of the springs. by: (m, p + y) A. pairs: (T, 18) axes of pins, lengths: (T) of rods. angles: (k, 3) of
    joints, with sine and versine. frame, square: to work in.
    """

    turn: Array
    origin: Array
    screws: Array
    carriers: np.ndarray
    roots: Array
    owner: np.ndarray
    rank: np.ndarray
    loads: Array
    twists: Array
    load: Array
    gaps: Array
    forces: Array
    ways: Array
    by: Array
    pairs: Array
    lengths: Array
    y: Array
    frame: Array
    square: Array
    angles: Array


@called
def _memory(tree, driven, free):
    k, n, m, t = len(tree.parents), len(tree.flexures), len(tree.rows), len(tree.joins)
    turn, carriers = np.zeros((k, 3, 3)), np.zeros(driven + free + 6 * n, dtype=np.int64)
    turn[0] = np.eye(3)
    for e in range(1, k):
        if tree.kinds[0, e] & 3 in (TURNS, SLIDES):
            carriers[tree.kinds[1, e]] = e
    return Here(
        turn, np.zeros((k, 3)), np.zeros((len(carriers), 6)), carriers, np.zeros((6 * n, 6)),
        np.zeros(6 * n, dtype=np.int64), np.zeros(1, dtype=np.int64), np.empty((k, 6)), np.zeros((n, 6)),
        np.zeros((n, 6)), np.empty(m), np.zeros(m), np.zeros((m + t, 6)), np.zeros((m, free + 6 * n)),
        np.zeros((t, 18)), np.zeros(t), np.zeros(6 * n), np.empty(12), np.empty((6, 6)),
        np.zeros((k, 3)),
    )  # fmt: skip


class Room(NamedTuple):
    """What equations of Z coordinates and m rows are worked with; rows of packs, see `vectors`.

    motion, field: (k, 6 W) see `_spread`. unit: (Z, W). stiff: (Z, W) G. matrix, order: of the equations, with a row to
    work in. right: (Z + m, 8). laws: (Z + m, W) their solution by coordinate of laws.
    """

    motion: Array
    field: Array
    unit: Array
    stiff: Array
    matrix: Array
    order: np.ndarray
    right: Array
    laws: Array
    small: Array
    inverse: Array


@called
def _room(tree, p, rank):
    """Return room for passive joints and coordinates of laws."""
    free, k, m = p + rank, len(tree.parents), len(tree.rows)
    size, wide, most = free + m, _wide(free), max(free, m)
    return Room(
        np.empty((k, 6 * wide)), np.empty((k, 6 * wide)), np.eye(free, wide), np.zeros((free, wide)),
        np.zeros((size + 1, _wide(size))), np.empty(size, dtype=np.int64), np.zeros((size, WIDE)),
        np.zeros((size, _wide(rank))), np.zeros((most + 1, _wide(most))), np.zeros((most, _wide(most))),
    )  # fmt: skip


@inner
def _wide(count):
    return (count + WIDE - 1) // WIDE * WIDE


@bare
def _place(tree, q, free, flexed, here):
    """Fill `turn`, `origin` and `screws`; flexures are at rest unless it is `flexed`."""
    kinds, turn, origin, frame = tree.kinds, here.turn, here.origin, here.frame
    for k in range(1, len(tree.parents)):
        kind, own, back, local = kinds[0, k] & 3, kinds[1, k], tree.parents[k], tree.elements[k]
        value, known, screw, axis = 0.0, here.angles[k], here.screws[max(own, 0)], three(local, 12)
        if kind == FLEXURE and flexed:
            _exponential(here.twists[own], frame)
        elif kind in (TURNS, SLIDES):
            value = _position(tree, q, free, k)
            if value != known[0]:
                half = math.sin(0.5 * value)
                put(known, 0, (value, 2.0 * half * math.cos(0.5 * value), 2.0 * half * half))
        for i in range(3):
            row = three(turn[back, i], 0)
            at = origin[back, i] + dot(row, three(local, 9))
            row = _through(row, local) if kinds[0, k] & ROTATED else row
            if kind == FLEXURE and flexed:
                at += dot(row, three(frame, 9))
                row = _through(row, frame)
            elif kind == TURNS:  # by Rodrigues
                share = screw[3 + i] = dot(row, axis)
                bent = plus(times(known[1], cross(row, axis)), times(known[2], minus(times(share, axis), row)))
                row = plus(row, bent)
            elif kind == SLIDES:
                screw[i] = dot(row, axis)
                at += value * screw[i]
            put(turn[k, i], 0, row)
            origin[k, i] = at
        if kind == TURNS:
            put(screw, 0, cross(three(origin[k], 0), three(screw, 3)))
    for c in range(here.rank[0]):
        z = len(q) + len(free) + c
        k = here.carriers[z]
        if k > 0:
            _screw(here, k, here.roots[c], here.screws[z])


@inner
def _screw(here, k, twist, found):
    """Fill the spatial twist of one in the axes of an element."""
    about = turned(here.turn[k], three(twist, 3))
    put(found, 0, plus(turned(here.turn[k], three(twist, 0)), cross(three(here.origin[k], 0), about)))
    put(found, 3, about)


@inner
def _through(row, frame):
    """Return a row of a rotation times that of a frame."""
    return plus(times(row[0], three(frame, 0)), plus(times(row[1], three(frame, 3)), times(row[2], three(frame, 6))))


@inner
def _tie(tree, t):
    joins = tree.joins
    return joins[t, 0], joins[t, 1], joins[t, 2], joins[t, 3], joins[t, 4], joins[t, 5]


@inner
def _point(here, k, point):
    return plus(three(here.origin[k], 0), turned(here.turn[k], point))


@inner
def _position(tree, q, free, k):
    own = tree.kinds[1, k]
    return q[own] if own < len(q) else free[own - len(q)]


@inner
def _six(a, b):
    """Return the product of six numbers and six."""
    return dot(three(a, 0), three(b, 0)) + dot(three(a, 3), three(b, 3))


@bare
def _join(tree, q, free, here):
    """Fill `gaps`, with what pins and cylinders give, `ways`, `pairs` and `lengths`; return whether all rods have one.

    A pin's gaps are in axes of its first element: of points, and the sum of a x b over its axes a there and b on the
    second, which have the weights that make that a small angle.
    """
    for t in range(len(tree.joins)):
        kind, e1, e2, start, end, number = _tie(tree, t)
        tie, pairs = tree.ties[t], here.pairs[t]
        if kind == GEAR:
            own, master = _position(tree, q, free, e1), _position(tree, q, free, e2)
            here.gaps[start] = own - tie[24] * master - tie[25]
            continue
        one, two = _point(here, e1, three(tie, 0)), _point(here, e2, three(tie, 3))
        apart = minus(two, one)
        if kind >= ROD:
            length = here.lengths[t] = math.sqrt(dot(apart, apart))
            if not length > SHORTEST:
                return False
            put(here.ways[start], 0, times(1.0 / length, apart))
            put(here.ways[start], 3, cross(two, times(1.0 / length, apart)))
            if kind == ROD:
                here.gaps[start] = length - q[number] - tie[24]
            continue
        for j in range(kind):
            put(pairs, 3 * j, turned(here.turn[e1], three(tie, 6 + 3 * j)))
            put(pairs, 9 + 3 * j, turned(here.turn[e2], three(tie, 15 + 3 * j)))
        for r in range(start, end):
            across, about = turned(here.turn[e1], three(tree.ways[r], 0)), turned(here.turn[e1], three(tree.ways[r], 3))
            gap, moment = dot(across, apart), cross(two, across)
            for j in range(kind):
                a, b = three(pairs, 3 * j), three(pairs, 9 + 3 * j)
                gap += dot(about, cross(a, b))
                moment = plus(moment, cross(b, cross(about, a)))
            here.gaps[r] = gap
            put(here.ways[r], 0, across)
            put(here.ways[r], 3, moment)
    for i in range(len(tree.flexures)):
        if tree.flexures[i] < 0:
            _, _, _, start, end, _ = _tie(tree, -1 - tree.flexures[i])
            for r in range(start, end):
                here.gaps[r] -= _six(tree.rows[r], here.twists[i])
    return True


@bare
def _open(tree, here, driven, screws, roots, by):
    """Fill the change of the gaps by (Z, 6) twists of coordinates, of closures by (y, 6) twists."""
    p = by.shape[1] - len(roots)
    for z in range(len(screws)):
        k = here.carriers[driven + z]
        by[:, z] = 0.0
        for t in range(len(tree.joins)):
            sign = tree.carried[t, k]
            for r in range(tree.joins[t, 3], tree.joins[t, 4] if sign != 0.0 else 0):
                by[r, z] = sign * _six(here.ways[r], screws[z])
        if k == 0:
            _, _, _, start, end, _ = _tie(tree, -1 - tree.flexures[here.owner[z - p]])
            for r in range(start, end):
                by[r, z] = -_six(tree.rows[r], roots[z - p])
    for t in range(len(tree.joins)):
        kind, e1, e2, start, _, _ = _tie(tree, t)
        if kind == GEAR:
            own, master = tree.kinds[1, e1] - driven, tree.kinds[1, e2] - driven
            by[start, own] = 1.0
            if master >= 0:
                by[start, master] = -tree.ties[t, 24]


@bare
def _factor(matrix, order):
    """Factor a square matrix in place, with one more row to work in, by row pivots; return whether it is regular."""
    n, pivot = len(order), matrix[len(order)]
    for c in range(n):
        best, first = c, c // WIDE * WIDE
        for a in range(c + 1, n):
            if abs(matrix[a, c]) > abs(matrix[best, c]):
                best = a
        order[c] = best
        if not abs(matrix[best, c]) > 0.0:
            return False
        _swap(matrix, c, best)
        for b in range(first, matrix.shape[1]):
            pivot[b] = matrix[c, b] if b > c else 0.0
        own = 1.0 / matrix[c, c]
        for a in range(c + 1, n):
            if matrix[a, c] != 0.0:
                row, factor = matrix[a], own * matrix[a, c]
                for b in range(first, len(row), WIDE):
                    put_pack(row, b, pack(row, b) - factor * pack(pivot, b))
                row[c] = factor
    return True


@inner
def _swap(matrix, a, b):
    for c in range(0, matrix.shape[1] if a != b else 0, WIDE):
        one, other = pack(matrix[a], c), pack(matrix[b], c)
        put_pack(matrix[a], c, other)
        put_pack(matrix[b], c, one)


@bare
def _solve(matrix, order, right):
    """Put the solution of a factored system into its (n, W) right sides."""
    n = len(order)
    for a in range(n):
        _swap(right, a, order[a])
    for c in range(0, right.shape[1], WIDE):
        for a in range(n):
            put_pack(right[a], c, _left(matrix, right, a, 0, a, c))
        for a in range(n - 1, -1, -1):
            put_pack(right[a], c, (1.0 / matrix[a, a]) * _left(matrix, right, a, a + 1, n, c))


@inner
def _left(matrix, right, a, first, last, c):
    """Return what other rows, from one on, leave of columns of a row."""
    value, other = pack(right[a], c), 0.0 * pack(right[a], c)
    for b in range(first, last - 1, 2):
        value = value - matrix[a, b] * pack(right[b], c)
        other = other - matrix[a, b + 1] * pack(right[b + 1], c)
    if (last - first) % 2:
        value = value - matrix[a, last - 1] * pack(right[last - 1], c)
    return value + other


@bare
def _close(tree, q, free, here, room):
    """Move (p,) passive joints to where the loops close; return whether `Mechanism` would say the same."""
    m, p, driven, by, before = len(here.gaps), len(free), len(q), here.by, 2.0 * LONGEST
    normal, order, step = room.small[: p + 1], room.order[:p], room.right[:p]
    for _ in range(MOST):
        _place(tree, q, free, False, here)
        if not _join(tree, q, free, here):
            return False
        _open(tree, here, driven, here.screws[driven : driven + p], here.roots, by)
        total = size = 0.0
        for a in range(p):
            step[a, 0] = 0.0
            for r in range(m):
                step[a, 0] += by[r, a] * here.gaps[r]
            for b in range(p):
                normal[a, b] = 0.0
                for r in range(m):
                    normal[a, b] += by[r, a] * by[r, b]
            total += normal[a, a]
        held = _positive(normal[:p], -NEAR_SINGULAR * total, room.inverse)
        if not _factor(normal, order):
            return False
        _solve(normal, order, step)
        for a in range(p):
            size = max(size, abs(step[a, 0]))
        if not size < np.inf:
            return False
        shrinks = size <= 0.5 * before
        ends = size <= CLOSED or (size <= SQUARED and shrinks) or (size <= ROUNDED and not shrinks)
        if not (ends or shrinks):
            return False
        for a in range(p):
            free[a] -= step[a, 0] * (1.0 if ends else min(1.0, LONGEST / size))
        before = size
        if ends:
            largest = 0.0
            for r in range(m):
                largest = max(largest, abs(here.gaps[r]))
            return largest <= ASSEMBLED and held
    return False


@called
def _idle(here, room, p, idle):
    """Fill the (m, m) projector on what nothing answers to, unless that of the row before holds; see `Mechanism`.

    Returns whether the gaps are closed there.

    With A the rows of the gaps' changes by unit motions, t the trace of A A' and P the projector, all rows are answered
    to or idle where A A' + t P - 10 ALIGNED^2 t 1 has a Cholesky factor. Rounding moves eigenvalues of that by m eps t,
    1e-15 t beside the 1e-7 t that is asked for: what rounding makes of idle rows decides nothing, nor does their sign.
    An inverse of A A' alone says nothing here, as it is of rounding where rows are idle.
    """
    m, total, by, worst, some = len(here.gaps), 0.0, here.by, 0.0, False
    trial, reached, count = room.small[:m], np.zeros((m, m)), p + here.rank[0]
    shares = np.ones(count)
    for c in range(here.rank[0]):  # a law's by the size of its twist
        shares[p + c] = 1.0 / _six(here.roots[c], here.roots[c])
    for r in range(m):
        for s in range(r + 1):
            for z in range(count):
                reached[r, s] += by[r, z] * by[s, z] * shares[z]
        total, some = total + reached[r, r], some or idle[r, r] != 0.0
    for r in range(m):
        for z in range(count if some else 0):
            left = 0.0
            for s in range(m):
                left += idle[r, s] * by[s, z]
            worst = max(worst, left * left * shares[z])
        for s in range(r + 1):
            reached[s, r] = reached[r, s]
            trial[r, s] = trial[s, r] = reached[r, s] + total * idle[r, s]
    if not (worst <= 1e-26 * total and _positive(trial, -10.0 * ALIGNED**2 * total, room.inverse)):
        sizes, ways = np.linalg.eigh(reached)
        idle[:] = 0.0
        for c in range(m):
            if sizes[c] <= ALIGNED**2 * sizes[m - 1]:
                idle += np.outer(ways[:, c], ways[:, c])
    for r in range(m):
        left = 0.0
        for s in range(m):
            left += idle[r, s] * here.gaps[s]
        if not abs(left) <= ALIGNED:
            return False
    return True


@bare
def _root(tree, compliance, here, roots, first):
    """Fill rows of (y, 6) matrices R, and S in `here`, of laws with R S' = C, and whose they are, from a coordinate on.

    Returns the largest number, and whether all R are S: whether all are symmetric, and nowhere negative.
    """
    largest, even, left, rank = 0.0, True, here.square, 0
    for i in range(len(compliance)):
        for a in range(6):
            for b in range(6):
                largest = max(largest, abs(compliance[i, a, b]))
    for i in range(len(compliance)):
        odd = most = 0.0
        for a in range(6):
            for b in range(6):
                left[a, b] = compliance[i, a, b]
                most, odd = max(most, abs(left[a, b])), max(odd, abs(compliance[i, b, a] - left[a, b]))
        for _ in range(6):
            row = 0
            for a in range(6):
                row = a if left[a, a] > left[row, row] else row
            column = row  # of what is even and nowhere negative the largest is on the diagonal
            if odd > ROUNDING * largest or left[row, row] < (1.0 - ROUNDING) * most:
                for a in range(6):
                    for b in range(6):
                        if abs(left[a, b]) > abs(left[row, column]):
                            row, column = a, b
            size, straight, most = left[row, column], row == column and left[row, column] > 0.0, 0.0
            if not abs(size) > (1e-14 if straight else ROUNDING) * largest:
                break
            even, factor = even and straight, 1.0 / math.sqrt(abs(size))
            for a in range(6):
                roots[rank, a] = factor * left[a, column]
                here.roots[rank, a] = math.copysign(factor, size) * left[row, a]
            for a in range(6):
                for b in range(6):
                    left[a, b] -= roots[rank, a] * here.roots[rank, b]
                    most = max(most, abs(left[a, b]))
            here.owner[rank], here.carriers[first + rank] = i, max(tree.flexures[i], 0)
            here.screws[first + rank] = 0.0
            rank += 1
    here.rank[0] = rank
    return largest, even


@bare
def _weigh(tree, here, links, wrenches):
    """From where it is and `forces`, fill `loads`."""
    loads, count, ways = here.loads, len(tree.parents), here.ways
    loads[:] = 0.0
    for j in range(-count, len(links)):
        k, point, force, moment = _pushed(tree, here, links, wrenches, j)
        put(loads[k], 0, plus(three(loads[k], 0), force))
        put(loads[k], 3, plus(three(loads[k], 3), plus(moment, cross(point, force))))
    for t in range(len(tree.joins)):
        kind, e1, e2, start, end, _ = _tie(tree, t)
        tension = _tension(tree.ties[t], kind, here.lengths[t])
        for r in range(start if kind != GEAR else end, max(end, start + (kind >= COIL))):
            share = tension if kind >= COIL else here.forces[r]
            for a in range(6):
                loads[e1, a] += share * ways[r, a]
                loads[e2, a] -= share * ways[r, a]
    for k in range(count - 1, 0, -1):
        for a in range(6):
            loads[tree.parents[k], a] += loads[k, a]


@bare
def _borne(load, turn, at, found):
    """Fill a load in the axes of a frame."""
    force, moment = three(load, 0), three(load, 3)
    put(found, 0, turned_back(turn, force))
    put(found, 3, turned_back(turn, plus(moment, cross(force, three(at, 0)))))


@bare
def _bear(tree, here):
    """Fill `load`: what flexures bear, in their axes."""
    for i in range(len(tree.flexures)):
        k, load = tree.flexures[i], here.load[i]
        if k >= 0:
            _borne(here.loads[k], here.turn[k], here.origin[k], load)
            continue
        load[:] = 0.0
        _, _, _, start, end, _ = _tie(tree, -1 - k)
        for r in range(start, end):
            for a in range(6):
                load[a] += here.forces[r] * tree.rows[r, a]


@inner
def _pushed(tree, here, links, wrenches, j):
    """Return an element, where a wrench acts on it, and force and moment there. Those below 0 are weights."""
    if j < 0:
        k = len(tree.parents) + j
        force = times(tree.elements[k, 15], three(tree.elements[-1], 12))
        return k, _point(here, k, three(tree.elements[k], 16)), force, (0.0, 0.0, 0.0)
    k, wrench = links[j, 0], wrenches[j]
    force, moment = three(wrench, 3), three(wrench, 6)
    if links[j, 2]:
        force, moment = turned(here.turn[k], force), turned(here.turn[k], moment)
    return k, _point(here, k, three(wrench, 0)), force, moment


@inner
def _tension(tie, kind, length):
    if kind == COIL:
        return tie[26] + tie[24] * (length - tie[25])
    return -tie[24] * (tie[25] / length) ** tie[26] if kind == GAS else 0.0


@bare
def _settle(tree, compliance, offset, scale, links, wrenches, q, free, idle, here, room):
    """From where the loops are closed, with `by` there, move to rest.

    Returns by how much loads change the stiffness, see the head of this module; infinite where `Mechanism` is to say.
    """
    p, m, rank, driven, gears, given = len(free), len(here.gaps), here.rank[0], len(q), len(here.gaps), False
    twists, forces, y, right, by, total = here.twists, here.forces, here.y, room.right, here.by, p + here.rank[0]
    screws, before, distance = here.screws[driven : driven + total], np.inf, np.inf
    forces[:] = 0.0
    y[:] = 0.0
    room.stiff[:] = 0.0
    for t in range(len(tree.joins)):
        gears -= tree.joins[t, 0] == GEAR
    for i in range(len(twists)):
        for a in range(6):
            twists[i, a] = offset[i, a]
            given = given or offset[i, a] != 0.0
    for count in range(STEPS):
        if count > 0 or given:
            _place(tree, q, free, True, here)
            if not _join(tree, q, free, here):
                return np.inf
            if count < 2:
                _open(tree, here, driven, screws, here.roots, by)
        _weigh(tree, here, links, wrenches)
        if count == 1:
            distance = _distance(tree, here, room, links, wrenches, here.turn[:0], screws, driven)
            if not distance <= SHARE:
                return np.inf
        if count < 2 and not _system(here, room, idle, scale, by):
            return np.inf
        for z in range(total):
            k = here.carriers[driven + z]
            right[z, 0] = _six(screws[z], here.loads[k]) - (y[z - p] if z >= p else 0.0)
            for r in range(gears if k > 0 else 0, m):
                right[z, 0] -= by[r, z] * forces[r]
        for r in range(m):
            right[total + r, 0] = -scale * here.gaps[r]
            for s in range(m):
                right[total + r, 0] += scale * idle[r, s] * forces[s]
        _solve(room.matrix, room.order, right)
        size = square = 0.0
        for z in range(p):
            free[z] += right[z, 0]
            size += right[z, 0] ** 2
        for r in range(m):
            forces[r] += scale * right[total + r, 0]
        for c in range(rank):
            step, i, root = right[p + c, 0], here.owner[c], here.roots[c]
            y[c] += step
            size += step**2 * _six(root, root) if tree.flexures[i] >= 0 else 0.0
            for a in range(6):
                twists[i, a] += root[a] * step
        for i in range(len(twists)):
            square += _six(twists[i], twists[i]) if tree.flexures[i] >= 0 else 0.0
        if not size < np.inf or (count > 1 and not size < SLOWEST * before and size > CONVERGED):
            return np.inf
        if count > 1 and size * size <= ENDS * before:
            if size > ENDS:
                _place(tree, q, free, True, here)
                _join(tree, q, free, here)
            _weigh(tree, here, links, wrenches)
            _bear(tree, here)
            for i in range(len(twists)):  # those of the tree have closed the loops; forces are a step behind
                for a in range(6 if tree.flexures[i] < 0 else 0):
                    twists[i, a] = offset[i, a] + _six(compliance[i, a], here.load[i])
            for r in range(m):
                if not abs(here.gaps[r]) <= ALIGNED:
                    return np.inf
            return distance if square < SMALL else np.inf
        before = size
    return np.inf


@bare
def _distance(tree, here, room, links, wrenches, changes, real, driven):
    """Fill `stiff`, and return the bound on Z' G Z that `_proof` has; `matrix` is that without G still."""
    total, laws, stiff, rank, form = len(real), room.laws, room.stiff, here.rank[0], room.inverse
    p = total - rank
    laws[:] = 0.0
    for c in range(rank):
        laws[p + c, c] = 1.0
    _solve(room.matrix, room.order, laws)
    _stiffen(tree, here, room, links, wrenches, changes, real, driven)
    half = room.small
    for b in range(0, laws.shape[1], WIDE):
        for z in range(total):
            put_pack(half[z], b, _sum(stiff[z], laws, b, laws.shape[1], total))
        for c in range(rank):
            value = laws[0, c] * pack(half[0], b)
            for z in range(1, total):
                value = value + laws[z, c] * pack(half[z], b)
            put_pack(form[c], b, value)
    return _proof(form[:rank], half)


@bare
def _proof(stiff, left):
    """Return a bound on how negative G or Z' G Z is, by coordinate of laws: below 1 is a proof that the arm stays.

    That is its norm, or a share of the unit matrix with which it is positive; `left` is to work in.
    """
    norm = 0.0
    for a in range(len(stiff)):
        for b in range(len(stiff)):
            norm += stiff[a, b] ** 2
    norm = math.sqrt(norm)
    for share in (SHARE, 1.0 - 1e-9):
        if norm > share and _positive(stiff, share, left):
            norm = share
    return norm


@bare
def _positive(stiff, share, left):
    """Return whether a square matrix with a share of the unit matrix is positive: Cholesky of its even part."""
    for a in range(len(stiff)):
        for b in range(a + 1):
            value = 0.5 * (stiff[a, b] + stiff[b, a])
            for c in range(b):
                value -= left[a, c] * left[b, c]
            if b < a:
                left[a, b] = value / left[b, b]
            elif value + share > 0.0:
                left[a, a] = math.sqrt(value + share)
            else:
                return False
    return True


@inner
def _sum(shares, rows, start, wide, count):
    """Return a pack of columns of the product of some numbers with rows of a width."""
    value = shares[0] * pack(rows, start)
    for a in range(1, count):
        value = value + shares[a] * pack(rows, start + a * wide)
    return value


@bare
def _stiffen(tree, here, room, links, wrenches, changes, real, driven):
    """Fill `stiff`: what motions of coordinates change of the loads, a row for each of (Z, 6) motions that are met."""
    _spread(tree, here, driven, links, wrenches, changes, room.unit, room.unit[:0], room.motion, room.field)
    wide = room.unit.shape[1]
    for z in range(len(real)):
        field = room.field[here.carriers[driven + z]]
        for b in range(0, wide, WIDE):
            put_pack(room.stiff[z], b, _sum(real[z], field, b, wide, 6))


@bare
def _system(here, room, idle, scale, by):
    """Fill and factor `matrix`, forces by `scale`; `by` is what moves, as rows. Returns whether it is regular."""
    matrix, stiff, free, m = room.matrix, room.stiff, len(room.stiff), len(here.gaps)
    for a in range(free):
        for b in range(free):
            matrix[a, b] = stiff[a, b]
        matrix[a, a] += 1.0 if a >= free - here.rank[0] else 0.0
        for r in range(m):
            matrix[a, free + r], matrix[free + r, a] = scale * by[r, a], scale * here.by[r, a]
    for r in range(m):
        for s in range(m):
            matrix[free + r, free + s] = -scale * scale * idle[s, r]
    return _factor(matrix, room.order)


@bare
def _spread(tree, here, driven, links, wrenches, changes, rows, forces, motion, field):
    """Fill (k, 6 W) motions of elements, and work per twist that is inserted at one and moves all that it carries.

    That is of the changes of all loads with (Z, W) virtual motions of coordinates, and with (m, W) virtual forces of
    gaps; those of no rows are none. A wrench that changes by K with its link's motion d adds K' d as a wrench there.
    """
    count, wide = len(tree.parents), rows.shape[1]
    motion[:] = 0.0
    field[:] = 0.0
    for z in range(len(rows)):
        k, screw = here.carriers[driven + z], here.screws[driven + z]
        if k > 0:
            for b in range(0, wide, WIDE):
                size = 0.0
                for c in range(b, b + WIDE):
                    size += abs(rows[z, c])
                if size > 0.0:
                    rates = pack(rows[z], b)
                    add_columns(motion[k], b, wide, times(rates, three(screw, 0)))
                    add_columns(motion[k], b + 3 * wide, wide, times(rates, three(screw, 3)))
                    _turn_back(here, driven + z, rates, field[k], b, wide)
    for k in range(1, count):
        for b in range(0, 6 * wide, WIDE):
            put_pack(motion[k], b, pack(motion[k], b) + pack(motion[tree.parents[k]], b))
    for j in range(-count, len(links)):
        k, point, force, moment = _pushed(tree, here, links, wrenches, j)
        follows = j >= 0 and links[j, 2] != 0
        moment = plus(moment, cross(point, force))
        for b in range(0, wide if follows or dot(force, force) > 0.0 else 0, WIDE):
            about = columns(motion[k], b + 3 * wide, wide)
            change = cross(about, force)  # of a force that keeps its direction only the point moves
            add_columns(field[k], b, wide, change)
            if follows:
                turning = plus(cross(about, moment), cross(columns(motion[k], b, wide), force))
                add_columns(field[k], b + 3 * wide, wide, turning)
            else:
                add_columns(field[k], b + 3 * wide, wide, cross(point, change))
        for b in range(0, wide if 0 <= j < len(changes) else 0, WIDE):
            about = columns(motion[k], b + 3 * wide, wide)
            way = plus(columns(motion[k], b, wide), cross(about, point))
            push = plus(turned_back(changes[j, :3, :3], way), turned_back(changes[j, 3:, :3], about))
            twist = plus(turned_back(changes[j, :3, 3:], way), turned_back(changes[j, 3:, 3:], about))
            add_columns(field[k], b, wide, times(-1.0, push))
            add_columns(field[k], b + 3 * wide, wide, times(-1.0, plus(twist, cross(point, push))))
    for t in range(len(tree.joins)):
        if tree.joins[t, 0] != GEAR:
            _, e1, e2, _, _, _ = _tie(tree, t)
            _tied(tree, here, t, forces, motion, field[e1], field[e2], wide)
    for k in range(count - 1, 0, -1):
        back = field[tree.parents[k]]
        for b in range(0, 6 * wide, WIDE):
            put_pack(back, b, pack(back, b) + pack(field[k], b))


@inner
def _turn_back(here, z, rates, field, start, wide):
    """Take away by how much the load on what a coordinate carries turns with it, at some rates."""
    load, screw = here.loads[here.carriers[z]], here.screws[z]
    about, force = three(screw, 3), three(load, 0)
    add_columns(field, start, wide, times(rates, cross(force, about)))
    turning = plus(cross(three(load, 3), about), cross(force, three(screw, 0)))
    add_columns(field, start + 3 * wide, wide, times(rates, turning))


@bare
def _tied(tree, here, t, forces, motion, one, two, wide):
    """Add what the change of a tie's wrench gives at its ends, see `shift` of `ties`, and the change of its gaps."""
    kind, e1, e2, start, end, _ = _tie(tree, t)
    tie, pairs = tree.ties[t], here.pairs[t]
    p1, p2 = _point(here, e1, three(tie, 0)), _point(here, e2, three(tie, 3))
    pull = about = moment = (0.0, 0.0, 0.0)
    across = rate = 0.0
    along = three(here.ways[start], 0)
    if kind >= ROD:
        tension = here.forces[start] if kind == ROD else _tension(tie, kind, here.lengths[t])
        across = tension / here.lengths[t]
        rate = tie[24] if kind == COIL else -tie[26] * across if kind == GAS else 0.0
        pull = times(tension, along)
    else:
        for r in range(start, end):
            pull = plus(pull, times(here.forces[r], three(tree.ways[r], 0)))
            about = plus(about, times(here.forces[r], three(tree.ways[r], 3)))
        pull, about = turned(here.turn[e1], pull), turned(here.turn[e1], about)
        for j in range(kind):
            moment = plus(moment, cross(three(pairs, 9 + 3 * j), cross(about, three(pairs, 3 * j))))
    for b in range(0, wide, WIDE):
        turn = minus(columns(motion[e2], b + 3 * wide, wide), columns(motion[e1], b + 3 * wide, wide))
        shift = minus(columns(motion[e2], b, wide), columns(motion[e1], b, wide))
        shift = plus(shift, cross(turn, p2))
        change = cross(pull, turn)
        if kind >= ROD:
            stretch = (rate - across) * dot(along, shift)
            push = plus(times(across, shift), times(stretch, along))
            change = plus(change, push)
            add_columns(one, b, wide, times(-1.0, push))
            add_columns(one, b + 3 * wide, wide, cross(push, p1))
            add_columns(two, b + 3 * wide, wide, cross(p2, change))
        else:
            other = cross(p2, change)
            back = plus(cross(pull, shift), cross(moment, turn))
            for j in range(kind):
                held = cross(three(pairs, 9 + 3 * j), cross(cross(about, three(pairs, 3 * j)), turn))
                other, back = plus(other, held), minus(back, held)
            add_columns(one, b + 3 * wide, wide, back)
            add_columns(two, b + 3 * wide, wide, other)
        add_columns(two, b, wide, change)
    for r in range(start, end if len(forces) else start):
        for a in range(6):
            for b in range(0, wide, WIDE):
                share, at = here.ways[r, a] * pack(forces[r], b), a * wide + b
                put_pack(one, at, pack(one, at) - share)
                put_pack(two, at, pack(two, at) + share)


@called
def _compose(turn, origin, frame, into, at):
    """Fill the product of a pose and a frame's: its rotation row by row, and its origin."""
    for i in range(3):
        at[i] = origin[i] + turn[i, 0] * frame[9] + turn[i, 1] * frame[10] + turn[i, 2] * frame[11]
        for j in range(3):
            into[i, j] = turn[i, 0] * frame[j] + turn[i, 1] * frame[3 + j] + turn[i, 2] * frame[6 + j]


@called
def _exponential(twist, frame):
    """Fill the frame that exp6 of a twist is: its rotation row by row, and its origin."""
    x, y, z = twist[3], twist[4], twist[5]
    s = x * x + y * y + z * z
    if s < 0.02:
        second = 0.5 - s * (1 / 24 - s * (1 / 720 - s / 40320))
        third = 1 / 6 - s * (1 / 120 - s * (1 / 5040 - s / 362880))
    else:
        angle = math.sqrt(s)
        second, third = 2.0 * math.sin(0.5 * angle) ** 2 / s, (angle - math.sin(angle)) / (s * angle)
    first = 1.0 - third * s
    vx, vy, vz = twist[0], twist[1], twist[2]
    ox, oy, oz = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
    frame[9] = vx + second * ox + third * (y * oz - z * oy)
    frame[10] = vy + second * oy + third * (z * ox - x * oz)
    frame[11] = vz + second * oz + third * (x * oy - y * ox)
    u, v, w = second * x, second * y, second * z
    xx, yy, zz, xy, xz, yz = u * x, v * y, w * z, u * y, u * z, v * z
    x, y, z = first * x, first * y, first * z
    frame[0], frame[1], frame[2] = 1.0 - yy - zz, xy - z, xz + y
    frame[3], frame[4], frame[5] = xy + z, 1.0 - xx - zz, yz - x
    frame[6], frame[7], frame[8] = xz - y, yz + x, 1.0 - xx - yy


@bare
def _right_jacobian(twist, found):
    """Fill the (6, 6) body motion per change of a twist (v, w): sum over k of (-ad)^k / (k + 1)!.

    With V and W the cross products with v and w, s = w w and d = v w, it has 1 + a W + b W^2 on its diagonal and
    a V + b (w v' + v w' - 2 d) + 2 d (a' W + b' W^2) above it; a and b are series in s, a' and b' their derivatives.
    """
    x, y, z, u, v, w = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
    s, d = u * u + v * v + w * w, x * u + y * v + z * w
    one = two = three = four = slope = 0.0
    power = term = 1.0
    for j in range(14):
        term /= 2 * j + 2
        one, three = one - term * power, three + term * slope
        term /= 2 * j + 3
        two, four = two + term * power, four - term * slope
        slope, power = (j + 1) * power, -s * power
    across, square = 2.0 * d * three, 2.0 * d * four
    same, far = 1.0 - s * two, -2.0 * d * two - s * square
    for i in range(3):
        for j in range(3):
            a, b = twist[3 + i], twist[3 + j]
            found[3 + i, j], found[i, j] = 0.0, two * a * b
            found[i, 3 + j] = two * (a * twist[j] + twist[i] * b) + square * a * b
        found[i, i] += same
        found[i, 3 + i] += far
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # a cross product takes axis j to minus k's share of i
        turns, moves = one * twist[3 + k], one * twist[k] + across * twist[3 + k]
        found[i, j] -= turns
        found[j, i] += turns
        found[i, 3 + j] -= moves
        found[j, 3 + i] += moves
    for i in range(3):
        for j in range(3):
            found[3 + i, 3 + j] = found[i, j]


@called
def _times(left, right, product):
    """Fill the product of the first six columns of a matrix with a (6, 6) one."""
    for a in range(6):
        for b in range(6):
            value = 0.0
            for c in range(6):
                value += left[a, c] * right[c, b]
            product[a, b] = value


@bare
def _tip(here, end, turn, origin):
    _compose(here.turn[int(end[15])], here.origin[int(end[15])], end, turn, origin)


@bare
def _logarithm(turn, found):
    """Fill the rotation vector of a rotation by less than a half turn."""
    x, y, z = 0.5 * (turn[2, 1] - turn[1, 2]), 0.5 * (turn[0, 2] - turn[2, 0]), 0.5 * (turn[1, 0] - turn[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 1.0
    if sine > 1e-8:
        factor = math.atan2(sine, 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0)) / sine
    found[0], found[1], found[2] = factor * x, factor * y, factor * z


@kept
@called
def rest_rows(
    tree, compliance, offset, links, wrenches, q, settled, first, free, idle,
    closed, tips, flexed, twists, loads, forces, displacement, distance, idles,
):  # fmt: skip
    """Close the loops, and unless they are not to be `settled` come to rest, in (N, nq) rows from `first` on.

    Each starts from the (p,) `free` that the row before left. Returns the number of the row that `Mechanism` must be
    asked about, N where there is none; `closed` is filled there, too, where the loops do close.

    Args:
        tree, links, wrenches: See `Tree` and `Pushes`.
        compliance, offset: (1 or N, n, 6, 6) and (1 or N, n, 6) of the laws.
        q, settled, first, free: See above.
        idle: (m, m) projector on gaps that nothing answers to, of the row before; zero where it is not known.
        closed, tips: (N, p) passive joints and (N, 4, 4) of the tip where nothing gives.
        flexed, twists, loads, forces: (N, p), (N, n, 6), (N, n, 6), (N, m) where it rests.
        displacement: (N, 6) of the tip from there.
        distance: (N,) by which the loads change its stiffness, see the head of this module.
        idles: (N, m, m) `idle` there.
    """
    here, scale, even, p = _memory(tree, q.shape[1], len(free)), 0.0, False, len(free)
    turn, moved, change, at, end = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    roots = here.roots.copy()
    room = closing = _room(tree, p, 0)
    for row in range(first, len(q)):
        here.twists[:] = 0.0
        if not _close(tree, q[row], free, here, closing):
            return row
        closed[row] = free
        own = min(row, len(compliance) - 1)
        if settled and (row == first or own > 0):
            largest, even = _root(tree, compliance[own], here, roots, q.shape[1] + p)
            scale = 1.0 / math.sqrt(max(largest, 1e-9))
            if len(room.unit) != p + here.rank[0]:
                room = _room(tree, p, here.rank[0])
        _place(tree, q[row], free, False, here)
        _tip(here, tree.elements[len(tree.parents)], turn, at)
        tips[row] = np.eye(4)
        tips[row, :3, :3], tips[row, :3, 3] = turn, at
        if not settled:
            continue
        if not even:
            return row
        _join(tree, q[row], free, here)
        _open(tree, here, q.shape[1], here.screws[q.shape[1] : q.shape[1] + len(room.unit)], here.roots, here.by)
        if not _idle(here, closing, p, idle):
            return row
        flexed[row], pushed = free, wrenches[min(row, len(wrenches) - 1)]
        distance[row] = _settle(
            tree, compliance[own], offset[own], scale, links, pushed, q[row], flexed[row], idle, here, room
        )
        if not distance[row] <= SHARE:
            return row
        twists[row], loads[row], forces[row], idles[row] = here.twists, here.load, here.forces, idle
        _tip(here, tree.elements[len(tree.parents)], moved, end)
        displacement[row, :3] = end - at
        for i in range(3):
            put(change[i], 0, turned(turn, three(moved[i], 0)))
        _logarithm(change, displacement[row, 3:])
    return len(q)


@kept
@called
def respond_rows(
    tree, tangents, links, wrenches, changes, q, flexed, twists, forces, idle, by_load, end, places, numbers,
    laws, joints, sites, motions, poses, loads, distance,
):  # fmt: skip
    """Fill how the origin of a frame moves, base axes, where the mechanism rests in N rows, into arrays that have rows.

    With M the matrix of the head of this module and J the frame's motion per coordinate, the six virtual motions J M^-1
    meet whatever else is changed.

    Args:
        tree, links, wrenches: As of `rest_rows`.
        tangents: (1 or N, n, 6, 6) of the laws.
        changes: (1 or N, L, 6, 6) change of each link's wrench with its motion, base axes; of no rows for none.
        q, flexed, twists, forces, idle: (N, ...) as `rest_rows` found them.
        by_load: (N, 6, n, 6) of no passive joints and closures, where it is known: motion of the frame per load.
        end: (16,) the frame, as the last row of `Tree.elements` has the tip.
        places, numbers: See `Frames`; `sites` and `loads` have closures and pins behind them.
        laws, joints, sites: (N, 6, n, 6), (N, 6, nq) and (N, 6, s, 6) per twist of a law, drive, and twist at a site.
        motions: (N, f, 6, 6) per wrench at a frame.
        poses, loads: (N, f, 4, 4) of the frames and (N, s, 6) at the sites.
        distance: (N,) by how much less than 1 a direction's stiffness may be, of no passive joints; see `_proof`.
    """
    driven, p, n, count, f = q.shape[1], flexed.shape[1], len(tree.flexures), len(tree.parents), places.shape[1]
    here = _memory(tree, driven, p)
    room, ties, first = _room(tree, p, here.rank[0]), len(tree.joins), driven + p
    at, turn, own, carried, still = np.empty(3), np.empty((3, 3)), np.empty((6, 6)), np.zeros(count), np.zeros(3)
    roots, derived, by, start = here.roots.copy(), np.empty((n, 6, 6)), here.by.copy(), np.zeros(6 * TIP)
    right, ends = np.zeros((0, TIP)), np.empty((2, 6 * TIP))
    motion, field, wide = np.empty((count, 6 * TIP)), np.empty((count, 6 * TIP)), right.shape[1]
    k, scale, real, none = int(end[15]), 0.0, here.screws, here.turn[:0]
    while k > 0:
        carried[k] = 1.0
        k = tree.parents[k]
    carried[0] = 1.0
    if len(by_load):  # every motion of a flexure is a coordinate
        right, here.rank[0] = np.zeros((6 * n, TIP)), 6 * n
        for z in range(6 * n):
            here.roots[z, z % 6], here.owner[z], here.carriers[first + z] = 1.0, z // 6, tree.flexures[z // 6]
    for row in range(len(q)):
        if row < len(tangents) and not len(by_load):
            largest, _ = _root(tree, tangents[row], here, roots, first)
            scale = 1.0 / math.sqrt(max(largest, 1e-9))
            if row == 0 or len(room.unit) != p + here.rank[0]:
                room, real = _room(tree, p, here.rank[0]), np.empty((p + here.rank[0], 6))
                right = np.zeros((len(room.order), TIP))
        pushed, total = wrenches[min(row, len(wrenches) - 1)], p + here.rank[0]
        changed = changes[min(row, len(changes) - 1)] if len(changes) else none
        here.twists[:], here.forces[:] = twists[row], forces[row]
        _place(tree, q[row], flexed[row], True, here)
        _join(tree, q[row], flexed[row], here)
        _weigh(tree, here, links, pushed)
        for i in range(f if len(poses) + len(loads) else 0):
            _compose(here.turn[places[0, i]], here.origin[places[0, i]], numbers[i], turn, at)
            if len(poses):
                poses[row, i] = np.eye(4)
                poses[row, i, :3, :3], poses[row, i, :3, 3] = turn, at
            if len(loads):
                _borne(here.loads[places[1, i]], turn, at, loads[row, i])
        if len(loads):
            loads[row, f:] = 0.0
            for t in range(ties):
                for r in range(tree.joins[t, 3], tree.joins[t, 4]):
                    for a in range(6):
                        loads[row, f + t, a] += here.forces[r] * tree.rows[r, a]
        if len(laws) + len(joints) + len(sites) + len(motions) == 0:
            continue
        _tip(here, end, turn, at)
        start[:] = 0.0
        for b in range(3):  # the frame's own motion, as a load that asks for it
            start[TIP * b + b] = start[TIP * (3 + b) + 3 + b] = still[b] = 1.0
            start[3 * TIP + b], start[4 * TIP + b], start[5 * TIP + b] = cross(three(at, 0), three(still, 0))
            still[b] = 0.0
        if len(by_load):
            for z in range(total):
                right[z, :6] = by_load[row, :, z // 6, z % 6]
        else:
            screws = here.screws[driven : driven + total]
            real[:] = screws
            for i in range(n):
                _right_jacobian(here.twists[i], derived[i])
            for c in range(here.rank[0]):
                k = here.carriers[first + c]
                if k > 0:
                    for a in range(6):
                        own[0, a] = _six(derived[here.owner[c], a], roots[c])
                    _screw(here, k, own[0], real[p + c])
            _open(tree, here, driven, screws, here.roots, here.by)
            _open(tree, here, driven, real, roots, by)
            _stiffen(tree, here, room, links, pushed, changed, real, driven)
            if len(distance):
                distance[row] = _proof(room.stiff[:total], room.matrix)
            _system(here, room, idle[row], scale, by)
            right[:] = 0.0
            for z in range(total):
                for b in range(0, TIP if carried[here.carriers[driven + z]] > 0.0 else 0, WIDE):
                    put_pack(right[z], b, _sum(real[z], start, b, TIP, 6))
            _solve(room.matrix, room.order, right)
        force = right[total:]
        for r in range(len(force)):
            for b in range(TIP):
                force[r, b] *= scale
        _spread(tree, here, driven, links, pushed, changed, right[:total], force, motion, field)
        for k in range(count):
            for b in range(0, 6 * TIP, WIDE):
                put_pack(field[k], b, carried[k] * pack(start, b) - pack(field[k], b))
        if len(laws):
            laws[row] = 0.0
            for i in range(n):
                e = tree.flexures[i]
                if e >= 0:
                    _answer(field[e], here.turn[e], here.origin[e], 1.0, ends[0], own)
                    _times(own, derived[i], laws[row, :, i])
                else:
                    _slots(tree, -1 - e, force, laws[row, :, i])
        if len(joints):
            joints[row] = 0.0
            for j in range(driven):
                for a in range(6 if here.carriers[j] > 0 else 0):
                    for b in range(6):
                        joints[row, b, j] += here.screws[j, a] * field[here.carriers[j], a * TIP + b]
            for t in range(ties):
                kind, _, e2, r, _, j = _tie(tree, t)
                j, factor = (tree.kinds[1, e2], tree.ties[t, 24]) if kind == GEAR else (j, 1.0)
                for b in range(6 if kind == ROD or (kind == GEAR and j < driven) else 0):
                    joints[row, b, j] += factor * force[r, b]
        if len(sites):
            sites[row] = 0.0
            for i in range(f):
                k = places[0, i]
                _compose(here.turn[k], here.origin[k], numbers[i], turn, at)
                ends[0] = field[places[1, i]]
                for z in range(p if k == places[1, i] else 0):  # outboard of a passive joint its axis stays
                    for b in range(0, TIP if here.carriers[driven + z] == k else 0, WIDE):
                        _turn_back(here, driven + z, pack(right[z], b), ends[0], b, wide)
                _answer(ends[0], turn, at, 1.0, ends[1], own)
                sites[row, :, i] = own
            closures = 0
            for t in range(ties):
                if tree.joins[t, 0] < COIL:
                    _slots(tree, t, force, sites[row, :, f + t])
                    closures += 1
            for t in range(closures):
                if tree.joins[t, 0] == GEAR:
                    break
                ends[:] = 0.0
                _tied(tree, here, t, force, motion, ends[0], ends[1], wide)
                for side in range(2):
                    k = tree.joins[t, 1 + side]
                    put(at, 0, _point(here, k, three(tree.ties[t], 3 * side)))
                    for a in range(3):
                        put(turn[a], 0, _through(three(here.turn[k, a], 0), tree.ties[t, 27 + 9 * side :]))
                    _answer(ends[side], turn, at, -1.0, start, own)
                    sites[row, :, f + closures + 2 * t + side] = own
        for i in range(f if len(motions) else 0):
            _compose(here.turn[places[0, i]], here.origin[places[0, i]], numbers[i], turn, at)
            for b in range(6):
                each = motion[places[0, i], b::TIP]
                way, about = three(each, 0), three(each, 3)
                put(motions[row, i, b], 0, plus(way, cross(about, three(at, 0))))
                put(motions[row, i, b], 3, about)


@bare
def _answer(field, turn, at, sign, work, found):
    """Fill the (6, 6) answers of a field to twists in the axes of a frame."""
    for b in range(0, TIP, WIDE):
        force, moment = columns(field, b, TIP), columns(field, b + 3 * TIP, TIP)
        moment = turned_back(turn, plus(moment, cross(force, three(at, 0))))
        force = turned_back(turn, force)
        for a in range(3):
            put_pack(work, b + a * TIP, sign * force[a])
            put_pack(work, b + (3 + a) * TIP, sign * moment[a])
    for b in range(6):
        for a in range(6):
            found[b, a] = work[a * TIP + b]


@bare
def _slots(tree, t, force, found):
    """Fill the (6, 6) answers to a closure's twist."""
    for r in range(tree.joins[t, 3], tree.joins[t, 4]):
        for b in range(6):
            for c in range(6):
                found[b, c] += force[r, b] * tree.rows[r, c]


@kept
@called
def rigid_tips(tree, q, poses):
    """Fill the (N, 4, 4) poses of a chain's tip where nothing gives, at (N, nq) joint positions."""
    free, turn, at = np.empty(0), np.empty((3, 3)), np.empty(3)
    here = _memory(tree, q.shape[1], len(free))
    for row in range(len(q)):
        _place(tree, q[row], free, True, here)  # by no twist
        _tip(here, tree.elements[len(tree.parents)], turn, at)
        poses[row] = np.eye(4)
        poses[row, :3, :3], poses[row, :3, 3] = turn, at


def _nothing() -> tuple:
    """Return what has no elements: a tree, laws, links and wrenches, and arrays of no rows by their dimensions."""
    one, none = np.zeros(1, dtype=np.int64), np.zeros((0, 6))
    ties = np.zeros((0, 1)), np.zeros((0, 45)), np.zeros((0, 6), dtype=np.int64)
    tree = Tree(np.zeros((2, 20)), np.full((3, 1), RIGID), one, *ties, none, none, one[:0])
    pushed = np.zeros((0, 3), dtype=np.int64), np.zeros((1, 0, 9))
    return tree, LawStack((), ()).numbers, pushed, np.zeros((0, 0)), np.zeros((0, 0, 6)), np.zeros((0, 0, 6, 6))


def compile_responses() -> None:
    """Compile how arms respond, where that is not yet kept, by asking about no rows."""
    tree, laws, pushed, plain, loads, answers = _nothing()
    frames = np.zeros(16), np.zeros((2, 0), dtype=np.int64), np.zeros((0, 12))
    found = answers, loads, answers, answers, answers, loads, np.zeros(0)
    with kept_code.compiled_once(respond_rows, rigid_tips):
        given = laws.compliance, *pushed, answers, plain, plain, loads, plain, loads, answers
        respond_rows(tree, *given, *frames, *found)
        rigid_tips(tree, plain, np.zeros((0, 4, 4)))


def compile_everything() -> None:
    """Compile what is not yet kept."""
    compile_responses()
    compile_mechanisms()


def compile_mechanisms() -> None:
    """Compile where mechanisms close and rest, likewise."""
    tree, laws, pushed, plain, loads, _ = _nothing()
    arrays = plain, np.zeros((0, 4, 4)), plain, loads, loads, plain, np.zeros((0, 6)), np.zeros(0), loads
    with kept_code.compiled_once(rest_rows):
        rest_rows(tree, laws.compliance, laws.offset, *pushed, plain, True, 0, np.zeros(0), plain, *arrays)


def is_kept() -> bool:
    """Return whether nothing has to be compiled."""
    return kept_code.is_kept(rest_rows, respond_rows, rigid_tips)
