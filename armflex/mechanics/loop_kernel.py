"""The compiled engine of arms with loops: where they close and rest, row after row, and a proof that they stay.

It is `Mechanism` in numbers. Everything is written in the base's axes about its origin: a joint or a flexure moves all
that it carries by spatial twists, a closure gaps by `W (V2 - V1)` of the twists of its ends, and its forces f put the
wrench W'f on its first end and minus that on the second. With t, p and f as there, C the laws' tangent, A = W J and
loads h on the flexures, every round solves the mechanism without the geometric stiffness of what loads it,

    | -(A_t C A_t' + D)   A_p | | df |     | gap + A_t (law(h) - t) |
    |       A_p'           0  | | dp | = - |    torque about p      |,      t = law(h) - C A_t' df,

a matrix of closures and passive joints alone, and of the place where the loops are closed. From the second round on
what that stiffness makes of the step is added, as it was there. What does not settle is left to `Mechanism`, as is all
that needs to be said.

**It stays** where the Hessian of its energy is positive along the motions that its loops allow. With y the coordinates
of laws R y, R R' = C, the loads add `Z' G Z` to the unit matrix, Z the motions per y, projected by the matrix above.
With F the load on all that element k carries, V its twists, s those of its own freedom,

    Z' G Z = - sum_k (V x s) . F - sum_bodies V . dw + sum_ties (V2 - V1) . dh

w what acts on a body and h the wrench of a tie as they move with them. Its norm below 1 is a proof, and a step y of a
round is (1 + Z' G Z)^-1 y with it. One pass out and one back make that linear in a twist that is inserted anywhere, see
`_spread`: the rest of what there is to know.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from armflex.conventions import Array
from armflex.mechanics.certificate import SHARE
from armflex.mechanics.chain import FLEXURE, RIGID, SLIDES, TURNS
from armflex.mechanics.equilibrium import CONVERGED, SLOWEST, SMALL, STEPS
from armflex.mechanics.kernel import _action, _compose, _exponential, _right_jacobian, _times, bare, called, inner
from armflex.mechanics.laws import LawStack
from armflex.mechanics.mechanism import ALIGNED, ASSEMBLED, CLOSED, LONGEST, MOST, ROUNDED
from armflex.mechanics.spring import SHORTEST
from armflex.storage import kept_code
from armflex.storage.kept_code import kept

AXIS, FIXED, ROD, GEAR, COIL, GAS = range(6)
"""Kinds of ties: pins with an axis, pins that are fixed, cylinders, followers, and springs by their law."""

NEAR_SINGULAR = 1e-8
"""Squared share of the closures' singular values below which `Mechanism` looks at them."""

ROUNDING = 1e-12
"""Share of the largest compliance below which one is symmetric, and nowhere negative."""

ENDS = 1e-28
"""Squared length of a step that is none, and of the one to come, were it to shrink as the last one did."""

SQUARED = 1e-8
"""Step of passive joints [m, rad] after which the next would be rounding, as it is about the square."""


class Tree(NamedTuple):
    """Numbers of a mechanism with its payload: T ties, first m rows of closures and then springs.

    Attributes:
        elements, kinds: As of `Chain`, passive joints numbered after the drives, cylinders among them.
        parents: (k,) the element before each, which has a lower number.
        carried: (T, k) 1 where an element moves the second end alone, -1 the first alone.
        ties: (T, 48) points on both ends (6), axis (3), turns of both ends' axes (18), and at 27: offset of a length;
            factor and offset of a gear; stiffness, length and preload; thrust, length and exponent of gas; and at 30:
            axes of both links (18).
        joins: (T, 6) kind, elements of both ends (of a gear the joints), rows from and to, number of the length in q.
        rows: (m, 6) what each row closes of its closure's slots.
        flexures: (n,) element of each, or minus 1 and minus the number of its closure.
        neutral: (nq_model,) Pinocchio's configuration with everything at zero.
        places: Where Pinocchio has them: of drives and of passive joints in a configuration; of passive joints, of
            flexures, which have six there, and of elements in a velocity, -1 where an element is no joint.
    """

    elements: Array
    kinds: np.ndarray
    parents: np.ndarray
    carried: Array
    ties: Array
    joins: np.ndarray
    rows: Array
    flexures: np.ndarray
    neutral: Array
    places: np.ndarray


class Here(NamedTuple):
    """Where a mechanism is, and what it is worked out with.

    turn, origin, axes: of every element, and the spatial twist per motion of its joint. gaps, ways: (m) and (T, 6, 6)
    of the closures, of springs the first row. by_free: (m, p) change of the gaps. loads: (k, 6) on all that an element
    carries. twists, load: (n, 6). torque: (k,). roots: (n, 6, 6) with R R' = C in the first columns, of which the
    coordinates y of laws from `starts` on are the factors: their spatial twists are `screws`, (6 n, 6), and `by_law`,
    (m, 6 n), is how they change the gaps. spare, turns, parts: to work in, since memory takes longer to get than a
    joint to place.
    """

    turn: Array
    origin: Array
    axes: Array
    gaps: Array
    ways: Array
    by_free: Array
    loads: Array
    twists: Array
    load: Array
    torque: Array
    states: Array
    forces: Array
    matrix: Array
    order: np.ndarray
    right: Array
    roots: Array
    starts: np.ndarray
    screws: Array
    by_law: Array
    y: Array
    step: Array
    spare: Array
    turns: Array
    parts: Array


@called
def _memory(tree, free):
    k, n, m, t = len(tree.parents), len(tree.flexures), len(tree.rows), len(tree.joins)
    return Here(
        np.empty((k, 3, 3)),
        np.empty((k, 3)),
        np.zeros((k, 6)),
        np.empty(m),
        np.zeros((t, 6, 6)),
        np.zeros((m, free)),
        np.empty((k, 6)),
        np.zeros((n, 6)),
        np.zeros((n, 6)),
        np.zeros(k),
        np.zeros((t, 4)),
        np.zeros(m),
        np.empty((m + free, m + free)),
        np.empty(m + free, dtype=np.int64),
        np.empty(m + free),
        np.zeros((n, 6, 6)),
        np.zeros(n + 1, dtype=np.int64),
        np.zeros((6 * n, 6)),
        np.zeros((m, 6 * n)),
        np.zeros(6 * n),
        np.empty(6 * n),
        np.zeros((12, 12)),
        np.empty((6, 3, 3)),
        np.empty((6, 6)),
    )


@bare
def _place(tree, q, free, flexed, here):
    """Fill `turn`, `origin`, `axes` and `screws`; flexures are at rest unless it is `flexed`."""
    elements, kinds, turn, origin, axes = tree.elements, tree.kinds, here.turn, here.origin, here.axes
    frame, driven = here.spare[0], len(q)
    for i in range(3):
        origin[0, i] = 0.0
        for j in range(3):
            turn[0, i, j] = 1.0 if i == j else 0.0
    for k in range(1, len(tree.parents)):
        kind, own, back, local = kinds[0, k] & 3, kinds[1, k], tree.parents[k], elements[k]
        value = sine = less = 0.0
        if kind == FLEXURE and flexed:
            _exponential(here.twists[own], frame)
        elif kind in (TURNS, SLIDES):
            value = q[own] if own < driven else free[own - driven]
            half = math.sin(0.5 * value)
            sine, less = 2.0 * half * math.cos(0.5 * value), 2.0 * half * half
        ax, ay, az = local[12], local[13], local[14]
        for i in range(3):
            x, y, z = turn[back, i, 0], turn[back, i, 1], turn[back, i, 2]
            at = origin[back, i] + x * local[9] + y * local[10] + z * local[11]
            u = x * local[0] + y * local[3] + z * local[6]
            v = x * local[1] + y * local[4] + z * local[7]
            w = x * local[2] + y * local[5] + z * local[8]
            if kind == FLEXURE and flexed:
                at += u * frame[9] + v * frame[10] + w * frame[11]
                x = u * frame[0] + v * frame[3] + w * frame[6]
                y = u * frame[1] + v * frame[4] + w * frame[7]
                u, v, w = x, y, u * frame[2] + v * frame[5] + w * frame[8]
            elif kind == TURNS:  # by Rodrigues, of a row r: r + sine r x axis + less ((r axis) axis - r)
                along = axes[k, 3 + i] = u * ax + v * ay + w * az
                x = u + sine * (v * az - w * ay) + less * (along * ax - u)
                y = v + sine * (w * ax - u * az) + less * (along * ay - v)
                u, v, w = x, y, w + sine * (u * ay - v * ax) + less * (along * az - w)
            elif kind == SLIDES:
                axes[k, i] = u * ax + v * ay + w * az
                at += value * axes[k, i]
            turn[k, i, 0], turn[k, i, 1], turn[k, i, 2], origin[k, i] = u, v, w, at
        if kind == TURNS:
            _cross(origin[k], axes[k, 3:], axes[k])
        elif kind == FLEXURE:
            for c in range(here.starts[own], here.starts[own + 1]):
                _screw(turn[k], origin[k], here.roots[own, :, c - here.starts[own]], here.screws[c])


@bare
def _screw(turn, origin, twist, found):
    """Fill the spatial twist of a twist in the axes of a frame."""
    for i in range(3):
        found[i] = turn[i, 0] * twist[0] + turn[i, 1] * twist[1] + turn[i, 2] * twist[2]
        found[3 + i] = turn[i, 0] * twist[3] + turn[i, 1] * twist[4] + turn[i, 2] * twist[5]
    found[0] += origin[1] * found[5] - origin[2] * found[4]
    found[1] += origin[2] * found[3] - origin[0] * found[5]
    found[2] += origin[0] * found[4] - origin[1] * found[3]


@inner
def _tie(tree, t):
    joins = tree.joins
    return joins[t, 0], joins[t, 1], joins[t, 2], joins[t, 3], joins[t, 4], joins[t, 5]


@bare
def _point(here, k, point, found):
    for i in range(3):
        found[i] = here.origin[k, i]
        for j in range(3):
            found[i] += here.turn[k, i, j] * point[j]


@bare
def _cross(a, b, found):
    found[0] = a[1] * b[2] - a[2] * b[1]
    found[1] = a[2] * b[0] - a[0] * b[2]
    found[2] = a[0] * b[1] - a[1] * b[0]


@bare
def _join(tree, q, free, here):
    """Fill `gaps`, with what pins and cylinders give, `ways`, and lengths and directions of rods.

    Returns whether all rods have one.
    """
    one, two, gap, parts = here.spare[2], here.spare[3], here.spare[4], here.parts
    for t in range(len(tree.joins)):
        kind, e1, e2, start, end, number = _tie(tree, t)
        tie = tree.ties[t]
        if kind == GEAR:
            own, master = _position(tree, q, free, e1), _position(tree, q, free, e2)
            here.gaps[start] = own - tie[27] * master - tie[28]
            continue
        _point(here, e1, tie[:3], one)
        _point(here, e2, tie[3:6], two)
        if kind >= ROD:
            state = here.states[t]
            state[0] = math.sqrt((two[0] - one[0]) ** 2 + (two[1] - one[1]) ** 2 + (two[2] - one[2]) ** 2)
            if not state[0] > SHORTEST:
                return False
            for i in range(3):
                state[1 + i] = here.ways[t, 0, i] = (two[i] - one[i]) / state[0]
            _cross(two, state[1:], here.ways[t, 0, 3:])
            if kind == ROD:
                here.gaps[start] = state[0] - q[number] - tie[27]
            continue
        _pin(tree, here, t, one, two, gap, parts)
        for r in range(start, end):
            x = y = z = u = v = w = value = 0.0
            for a in range(3):
                share, value = tree.rows[r, a], value + tree.rows[r, a] * gap[a]
                x, y, z = x + share * parts[a, 0], y + share * parts[a, 1], z + share * parts[a, 2]
            for a in range(3, 6 if end - start > 3 else 3):
                share, value = tree.rows[r, a], value + tree.rows[r, a] * gap[a]
                u, v, w = u + share * parts[a, 0], v + share * parts[a, 1], w + share * parts[a, 2]
            here.gaps[r], way = value, here.ways[t, r - start]
            way[0], way[1], way[2], way[3] = x, y, z, two[1] * z - two[2] * y + u
            way[4], way[5] = two[2] * x - two[0] * z + v, two[0] * y - two[1] * x + w
    for i in range(len(tree.flexures)):
        if tree.flexures[i] < 0:
            t = -1 - tree.flexures[i]
            for r in range(tree.joins[t, 3], tree.joins[t, 4]):
                for a in range(6):
                    here.gaps[r] -= tree.rows[r, a] * here.twists[i, a]
    return True


@bare
def _position(tree, q, free, k):
    own = tree.kinds[1, k]
    return q[own] if own < len(q) else free[own - len(q)]


@bare
def _pin(tree, here, t, one, two, gap, parts):
    """Fill the six gaps of a pin, see `ties.Pin`, and (6, 6) parts.

    First columns: its axes, and below them the change of its angles by a turn in base axes. Last columns, below: the
    same by a turn in its own axes.
    """
    tie, k1, k2, whole = tree.ties[t], tree.joins[t, 1], tree.joins[t, 2], here.turn
    x, y, z = two[0] - one[0], two[1] - one[1], two[2] - one[2]
    for j in range(3):
        a, b, c = tie[9 + j], tie[12 + j], tie[15 + j]
        for i in range(3):
            parts[j, i] = whole[k1, i, 0] * a + whole[k1, i, 1] * b + whole[k1, i, 2] * c
        gap[j] = parts[j, 0] * x + parts[j, 1] * y + parts[j, 2] * z
    if tree.joins[t, 4] - tree.joins[t, 3] == 3:  # a spherical bearing has no angles
        for i in range(3):
            gap[3 + i] = 0.0
            for j in range(3):
                parts[3 + i, j] = parts[3 + i, 3 + j] = 0.0
        return
    other, turned, change = here.turns[1], here.turns[2], parts[3:, 3:]
    for j in range(3):
        a, b, c = tie[18 + j], tie[21 + j], tie[24 + j]
        for i in range(3):
            other[i, j] = whole[k2, i, 0] * a + whole[k2, i, 1] * b + whole[k2, i, 2] * c
    for i in range(3):
        for j in range(3):
            turned[i, j] = parts[i, 0] * other[0, j] + parts[i, 1] * other[1, j] + parts[i, 2] * other[2, j]
    if tree.joins[t, 0] == FIXED:
        _logarithm(turned, gap[3:])
        x, y, z = gap[3], gap[4], gap[5]
        s = x * x + y * y + z * z
        c = 1 / 12 + s * (1 / 720 + s / 30240)
        if s > 1e-2:
            angle = math.sqrt(s)
            c = (1.0 - 0.5 * angle * math.sin(angle) / (1.0 - math.cos(angle))) / s
        change[0, 0], change[0, 1], change[0, 2] = 1.0 + c * (x * x - s), c * x * y + 0.5 * z, c * x * z - 0.5 * y
        change[1, 0], change[1, 1], change[1, 2] = c * x * y - 0.5 * z, 1.0 + c * (y * y - s), c * y * z + 0.5 * x
        change[2, 0], change[2, 1], change[2, 2] = c * x * z + 0.5 * y, c * y * z - 0.5 * x, 1.0 + c * (z * z - s)
    else:
        axis, there = tie[6:9], here.spare[5]
        for i in range(3):
            there[i] = turned[i, 0] * axis[0] + turned[i, 1] * axis[1] + turned[i, 2] * axis[2]
        _cross(axis, there, gap[3:])
        along = axis[0] * there[0] + axis[1] * there[1] + axis[2] * there[2]
        for i in range(3):
            for j in range(3):
                change[i, j] = (along if i == j else 0.0) - there[i] * axis[j]
    for i in range(3):
        for j in range(3):
            parts[3 + i, j] = change[i, 0] * parts[0, j] + change[i, 1] * parts[1, j] + change[i, 2] * parts[2, j]


@bare
def _logarithm(turn, found):
    """Fill the rotation vector of a rotation by less than a half turn."""
    x, y, z = 0.5 * (turn[2, 1] - turn[1, 2]), 0.5 * (turn[0, 2] - turn[2, 0]), 0.5 * (turn[1, 0] - turn[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 1.0
    if sine > 1e-8:
        factor = math.atan2(sine, 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0)) / sine
    found[0], found[1], found[2] = factor * x, factor * y, factor * z


@bare
def _reach(tree, q, here):
    """Fill `by_free`."""
    kinds, driven = tree.kinds, len(q)
    for t in range(len(tree.joins)):
        kind, e1, e2, start, end, _ = _tie(tree, t)
        if kind == GEAR:
            own, master = kinds[1, e1] - driven, kinds[1, e2] - driven
            here.by_free[start, own] = 1.0
            if master >= 0:
                here.by_free[start, master] = -tree.ties[t, 27]
            continue
        for k in range(1, len(tree.parents)):
            sign, own = tree.carried[t, k], kinds[1, k] - driven
            if sign != 0.0 and own >= 0 and kinds[0, k] & 3 != FLEXURE:
                _open(here, t, start, end, sign, here.axes[k], here.by_free[:, own])


@bare
def _open(here, t, start, end, sign, twist, found):
    """Fill by how much a spatial twist of what an end of a tie is carried by opens its rows."""
    for r in range(start, end):
        value = 0.0
        for b in range(6):
            value += here.ways[t, r - start, b] * twist[b]
        found[r] = sign * value


@bare
def _bend(tree, here, roots, screws):
    """Fill `by_law` for coordinates that are factors of (n, 6, 6) roots and have (W, 6) spatial twists."""
    starts, found = here.starts, here.by_law
    found[:, : starts[-1]] = 0.0
    for i in range(len(tree.flexures)):
        k = tree.flexures[i]
        for c in range(starts[i], starts[i + 1]):
            if k < 0:
                for r in range(tree.joins[-1 - k, 3], tree.joins[-1 - k, 4]):
                    for a in range(6):
                        found[r, c] -= tree.rows[r, a] * roots[i, a, c - starts[i]]
                continue
            for t in range(len(tree.joins)):
                if tree.carried[t, k] != 0.0:
                    _, _, _, start, end, _ = _tie(tree, t)
                    _open(here, t, start, end, tree.carried[t, k], screws[c], found[:, c])


@bare
def _close(tree, q, free, here):
    """Move (p,) passive joints to where the loops close; return whether `Mechanism` would say the same."""
    m, p = here.by_free.shape
    normal, step, before = here.matrix, here.right, 2.0 * LONGEST
    for _ in range(MOST):
        _place(tree, q, free, False, here)
        if not _join(tree, q, free, here):
            return False
        _reach(tree, q, here)
        for a in range(p):
            step[a] = 0.0
            for r in range(m):
                step[a] += here.by_free[r, a] * here.gaps[r]
            for b in range(a + 1):
                normal[a, b] = 0.0
                for r in range(m):
                    normal[a, b] += here.by_free[r, a] * here.by_free[r, b]
        total = 0.0
        for a in range(p):
            total += normal[a, a]
        if not _factored(normal, p):
            return False
        _solved_by(normal, p, step)
        size = 0.0
        for a in range(p):
            size = max(size, abs(step[a]))
        if not size < np.inf:
            return False
        shrinks = size <= 0.5 * before
        ends = size <= CLOSED or (size <= SQUARED and shrinks) or (size <= ROUNDED and not shrinks)
        if not (ends or shrinks):
            return False
        for a in range(p):
            free[a] -= step[a] * (1.0 if ends else min(1.0, LONGEST / size))
        before = size
        if ends:
            largest = 0.0
            for r in range(m):
                largest = max(largest, abs(here.gaps[r]))
            return largest <= ASSEMBLED and _least(normal, p, step) > NEAR_SINGULAR * total
    return False


@bare
def _factored(matrix, n):
    """Put the Cholesky factor of a positive matrix into its lower triangle; return whether it is one."""
    for a in range(n):
        for b in range(a + 1):
            value = matrix[a, b]
            for c in range(b):
                value -= matrix[a, c] * matrix[b, c]
            if a == b:
                if not value > 0.0:
                    return False
                matrix[a, a] = math.sqrt(value)
            else:
                matrix[a, b] = value / matrix[b, b]
    return True


@bare
def _solved_by(factor, n, right):
    for a in range(n):
        value = right[a]
        for b in range(a):
            value -= factor[a, b] * right[b]
        right[a] = value / factor[a, a]
    for a in range(n - 1, -1, -1):
        value = right[a] = right[a] / factor[a, a]
        for b in range(a):
            right[b] -= factor[a, b] * value


@bare
def _least(factor, n, column):
    """Return a bound below the least eigenvalue of a matrix with a Cholesky factor: one over its inverse's trace."""
    trace = 0.0
    for c in range(n):
        for a in range(c, n):
            value = 1.0 if a == c else 0.0
            for b in range(c, a):
                value -= factor[a, b] * column[b]
            column[a] = value / factor[a, a]
            trace += column[a] ** 2
    return 1.0 / max(trace, 1e-300)


@called
def _idle(here, idle):
    """Fill the (m, m) projector on what nothing answers to, unless that of the row before holds; see `Mechanism`.

    Returns whether the gaps are closed there.
    """
    m, p = here.by_free.shape
    reached, column, total, worst, some = np.zeros((m, m)), np.empty(m), 0.0, 0.0, False
    for r in range(m):
        some = some or idle[r, r] != 0.0
    for j in range(p + here.starts[-1]):
        size = 0.0
        for r in range(m):
            column[r] = here.by_free[r, j] if j < p else here.by_law[r, j - p]
        if j >= p:  # by the size of its twist
            i = 0
            while here.starts[i + 1] <= j - p:
                i += 1
            for a in range(6):
                size += here.roots[i, a, j - p - here.starts[i]] ** 2
        scale = 1.0 / math.sqrt(size) if j >= p else 1.0
        for r in range(m):
            column[r] *= scale
        for r in range(m):
            for s in range(r + 1):
                reached[r, s] += column[r] * column[s]
            left = 0.0
            for s in range(m if some else 0):
                left += idle[r, s] * column[s]
            worst = max(worst, abs(left))
    for r in range(m):
        total += reached[r, r]
        for s in range(r):
            reached[s, r] = reached[r, s]
    trial = reached + total * idle
    same = worst <= 1e-13 * math.sqrt(total)
    if not (same and _factored(trial, m) and _least(trial, m, column) > 10.0 * ALIGNED**2 * total):
        sizes, left = np.linalg.eigh(reached)
        idle[:] = 0.0
        for c in range(m):
            if sizes[c] <= ALIGNED**2 * sizes[m - 1]:
                for r in range(m):
                    for s in range(m):
                        idle[r, s] += left[r, c] * left[s, c]
    for r in range(m):
        left = 0.0
        for s in range(m):
            left += idle[r, s] * here.gaps[s]
        if not abs(left) <= ALIGNED:
            return False
    return True


@called
def _root(compliance, roots, others, starts):
    """Fill (n, 6, 6) matrices R and S with R S' = C in their first columns, and where those of each begin in a row.

    Returns the largest number, and whether all R are S: whether all are symmetric, and nowhere negative.
    """
    left, largest, even = np.empty((6, 6)), 0.0, True
    for i in range(len(compliance)):
        for a in range(6):
            for b in range(6):
                largest = max(largest, abs(compliance[i, a, b]))
    for i in range(len(compliance)):
        starts[i + 1], odd, most = starts[i], 0.0, 0.0
        for a in range(6):
            for b in range(6):
                left[a, b] = compliance[i, a, b]
                odd, most = max(odd, abs(compliance[i, a, b] - compliance[i, b, a])), max(most, abs(left[a, b]))
        for c in range(6):
            row = 0
            for a in range(6):
                row = a if left[a, a] > left[row, row] else row
            column = row  # of what is even and nowhere negative the largest is on the diagonal
            if odd > ROUNDING * largest or left[row, row] < (1.0 - ROUNDING) * most:
                for a in range(6):
                    for b in range(6):
                        if abs(left[a, b]) > abs(left[row, column]):
                            row, column = a, b
            size, straight = left[row, column], row == column and left[row, column] > 0.0
            if not abs(size) > (1e-14 if straight else ROUNDING) * largest:
                break
            even, factor, most = even and straight, 1.0 / math.sqrt(abs(size)), 0.0
            for a in range(6):
                roots[i, a, c] = factor * left[a, column]
                others[i, a, c] = math.copysign(factor, size) * left[row, a]
            for a in range(6):
                for b in range(6):
                    left[a, b] -= roots[i, a, c] * others[i, b, c]
                    most = max(most, abs(left[a, b]))
            starts[i + 1] += 1
            if not most > 1e-14 * largest:
                break
    return largest, even


@bare
def _factor(matrix, order):
    """Factor a square matrix in place with row pivots; return whether it is regular."""
    n = len(order)
    for c in range(n):
        best = c
        for a in range(c + 1, n):
            if abs(matrix[a, c]) > abs(matrix[best, c]):
                best = a
        order[c] = best
        if not abs(matrix[best, c]) > 0.0:
            return False
        if best != c:
            for b in range(n):
                matrix[c, b], matrix[best, b] = matrix[best, b], matrix[c, b]
        for a in range(c + 1, n):
            if matrix[a, c] != 0.0:
                factor = matrix[a, c] = matrix[a, c] / matrix[c, c]
                for b in range(c + 1, n):
                    matrix[a, b] -= factor * matrix[c, b]
    return True


@bare
def _solve(matrix, order, right):
    """Put the solution of a factored system into its (n, W) right sides."""
    n, w = right.shape
    for a in range(n):
        best = order[a]
        for c in range(w if best != a else 0):
            right[a, c], right[best, c] = right[best, c], right[a, c]
    for a in range(n):
        for b in range(a):
            factor = matrix[a, b]
            if factor != 0.0:
                for c in range(w):
                    right[a, c] -= factor * right[b, c]
    for a in range(n - 1, -1, -1):
        for b in range(a + 1, n):
            factor = matrix[a, b]
            for c in range(w):
                right[a, c] -= factor * right[b, c]
        for c in range(w):
            right[a, c] /= matrix[a, a]


@bare
def _solve_one(matrix, order, right):
    """Put the solution of a factored system into its (n) right side."""
    n = len(order)
    for a in range(n):
        best = order[a]
        value = right[best]
        right[best] = right[a]
        for b in range(a):
            value -= matrix[a, b] * right[b]
        right[a] = value
    for a in range(n - 1, -1, -1):
        value = right[a]
        for b in range(a + 1, n):
            value -= matrix[a, b] * right[b]
        right[a] = value / matrix[a, a]


@bare
def _assemble(here, idle, scale):
    """Fill and factor `matrix`, rows of torques and forces times `scale`; return whether it is regular."""
    m, p = here.by_free.shape
    matrix, bends, total = here.matrix, here.by_law, here.starts[-1]
    for r in range(m):
        for s in range(r + 1):
            value = idle[r, s]
            for c in range(total):
                value += bends[r, c] * bends[s, c]
            matrix[r, s] = matrix[s, r] = -value / scale
        for a in range(p):
            matrix[r, m + a] = matrix[m + a, r] = here.by_free[r, a]
    for a in range(p):
        for b in range(p):
            matrix[m + a, m + b] = 0.0
    return _factor(matrix, here.order)


@bare
def _weigh(tree, here, links, wrenches):
    """From where it is and `forces`, fill `loads` and `torque`."""
    loads, count, forces = here.loads, len(tree.parents), here.forces
    point, push, wrench = here.spare[2], here.spare[3], here.spare[4]
    loads[:] = 0.0
    here.torque[:] = 0.0
    for j in range(-count, len(links)):
        k = _pushed(tree, here, links, wrenches, j, point, push)
        _cross(point, push[:3], wrench[3:])
        for i in range(3):
            loads[k, i] += push[i]
            loads[k, 3 + i] += push[3 + i] + wrench[3 + i]
    for t in range(len(tree.joins)):
        kind, e1, e2, start, end, _ = _tie(tree, t)
        if kind == GEAR:
            here.torque[e1] += forces[start]
            here.torque[e2] -= tree.ties[t, 27] * forces[start]
            continue
        tension = _tension(tree.ties[t], kind, here.states[t, 0])
        for a in range(6):
            wrench[a] = tension * here.ways[t, 0, a] if kind >= COIL else 0.0
            for r in range(start, end):
                wrench[a] += forces[r] * here.ways[t, r - start, a]
            loads[e1, a] += wrench[a]
            loads[e2, a] -= wrench[a]
    for k in range(count - 1, 0, -1):
        for a in range(6):
            loads[tree.parents[k], a] += loads[k, a]
            here.torque[k] -= here.axes[k, a] * loads[k, a]


@called
def _bear(tree, here):
    """Fill `load`: what flexures bear, in their axes."""
    screw = np.empty((6, 6))
    for i in range(len(tree.flexures)):
        k, load = tree.flexures[i], here.load[i]
        load[:] = 0.0
        if k >= 0:
            _action(here.turn[k], here.origin[k], screw)
            for a in range(6):
                for b in range(6):
                    load[a] += screw[b, a] * here.loads[k, b]
            continue
        for r in range(tree.joins[-1 - k, 3], tree.joins[-1 - k, 4]):
            for a in range(6):
                load[a] += here.forces[r] * tree.rows[r, a]


@bare
def _pushed(tree, here, links, wrenches, j, point, push):
    """Fill where a wrench acts and the (6,) wrench there, base axes; return its element. Those below 0 are weights."""
    if j < 0:
        k = len(tree.parents) + j
        _point(here, k, tree.elements[k, 16:19], point)
        for i in range(3):
            push[i], push[3 + i] = tree.elements[k, 15] * tree.elements[-1, 12 + i], 0.0
        return k
    k, wrench = links[j, 0], wrenches[j]
    _point(here, k, wrench[:3], point)
    for i in range(3):
        push[i], push[3 + i] = wrench[3 + i], wrench[6 + i]
    if links[j, 2]:
        for i in range(3):
            push[i] = push[3 + i] = 0.0
            for a in range(3):
                push[i] += here.turn[k, i, a] * wrench[3 + a]
                push[3 + i] += here.turn[k, i, a] * wrench[6 + a]
    return k


@bare
def _tension(tie, kind, length):
    if kind == COIL:
        return tie[29] + tie[27] * (length - tie[28])
    return -tie[27] * (tie[28] / length) ** tie[29] if kind == GAS else 0.0


@called
def _settle(tree, compliance, offset, scale, links, wrenches, q, free, idle, here):
    """From where the loops are closed and it is placed, move to rest.

    Returns by how much loads change the stiffness, see the head of this module; infinite where `Mechanism` is to say.
    """
    m, p = here.by_free.shape
    twists, right, y, step, by_law, starts = here.twists, here.right, here.y, here.step, here.by_law, here.starts
    total, before, distance, plain, given = starts[-1], np.inf, np.inf, np.empty(starts[-1]), False
    tangent, follows = np.empty((0, 0)), np.empty((0, 0))
    here.forces[:] = 0.0
    y[:] = 0.0
    for i in range(len(offset)):
        for a in range(6):
            given = given or offset[i, a] != 0.0
    for count in range(STEPS):
        if count > 0:
            _place(tree, q, free, True, here)
        if not _join(tree, q, free, here):
            return np.inf
        if count < 2:  # then they are known well enough
            _reach(tree, q, here)
            _bend(tree, here, here.roots, here.screws)
            if count == 0 and not _idle(here, idle):
                return np.inf
            if count == 0 and given:
                twists[:] = offset
                _place(tree, q, free, True, here)
                if not _join(tree, q, free, here):
                    return np.inf
                _reach(tree, q, here)
                _bend(tree, here, here.roots, here.screws)
            if not _assemble(here, idle, scale):
                return np.inf
        _weigh(tree, here, links, wrenches)
        if count == 1:
            tangent, follows = _hessian(tree, here, links, wrenches, scale, len(q))
            distance = 0.0
            for a in range(total):
                for b in range(total):
                    distance += tangent[a, b] ** 2
                tangent[a, a] += 1.0
            distance = math.sqrt(distance)
            if not (distance <= SHARE and _factored(tangent, total)):
                return np.inf
        for i in range(len(twists)):
            k = tree.flexures[i]
            for c in range(starts[i], starts[i + 1]):
                step[c] = -y[c]
                if k >= 0:
                    for a in range(6):
                        step[c] += here.screws[c, a] * here.loads[k, a]
                else:
                    for r in range(m):
                        step[c] -= by_law[r, c] * here.forces[r]
        for r in range(m):
            right[r] = -here.gaps[r]
            for c in range(total):
                right[r] -= by_law[r, c] * step[c]
            for s in range(m):
                right[r] += idle[r, s] * here.forces[s]
        for k in range(1, len(tree.parents)):
            kind, own = tree.kinds[0, k] & 3, tree.kinds[1, k] - len(q)
            if kind in (TURNS, SLIDES) and own >= 0:
                right[m + own] = -scale * here.torque[k]
        _solve_one(here.matrix, here.order, right)
        for r in range(m):
            right[r] /= scale
            here.forces[r] += right[r]
            for c in range(total):
                step[c] -= by_law[r, c] * right[r]
        if count > 0:  # what the change of the loads makes of the step; forces follow with the next one
            plain[:] = step[:total]
            _solved_by(tangent, total, step)
            for b in range(p):
                for a in range(total):
                    right[m + b] += follows[b, a] * (step[a] - plain[a])
        size, square = 0.0, 0.0
        for a in range(p):
            free[a] += right[m + a]
            size += right[m + a] ** 2
        for c in range(total):
            y[c] += step[c]
        for i in range(len(twists)):
            for a in range(6):
                value = offset[i, a]
                for c in range(starts[i], starts[i + 1]):
                    value += here.roots[i, a, c - starts[i]] * y[c]
                if tree.flexures[i] >= 0:
                    size += (value - twists[i, a]) ** 2
                    square += value**2
                twists[i, a] = value
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
                    twists[i, a] = offset[i, a]
                    for b in range(6):
                        twists[i, a] += compliance[i, a, b] * here.load[i, b]
            for r in range(m):
                if not abs(here.gaps[r]) <= ALIGNED:
                    return np.inf
            return distance if square < SMALL else np.inf
        before = size
    return np.inf


@bare
def _freedoms(tree, here, driven, screws, carriers):
    """Fill the (W + p, 6) spatial twists of coordinates of laws and passive joints, and the elements they first move.

    A closure's move none.
    """
    total = here.starts[-1]
    for i in range(len(tree.flexures)):
        for c in range(here.starts[i], here.starts[i + 1]):
            carriers[c] = max(tree.flexures[i], 0)
            for a in range(6):
                screws[c, a] = here.screws[c, a] if tree.flexures[i] >= 0 else 0.0
    for k in range(1, len(tree.parents)):
        kind, own = tree.kinds[0, k] & 3, tree.kinds[1, k] - driven
        if kind in (TURNS, SLIDES) and own >= 0:
            carriers[total + own] = k
            for a in range(6):
                screws[total + own, a] = here.axes[k, a]


@called
def _hessian(tree, here, links, wrenches, scale, driven):
    """Return Z' G Z, see the head of this module, and the (p, W) motions of passive joints per coordinate of laws."""
    (m, p), total, by_law = here.by_free.shape, here.starts[-1], here.by_law
    right, motions = np.zeros((m + p, total)), np.zeros((total + p, total))
    screws, carriers = np.empty((total + p, 6)), np.empty(total + p, dtype=np.int64)
    for r in range(m):
        for c in range(total):
            right[r, c] = -by_law[r, c]
    _solve(here.matrix, here.order, right)
    for a in range(total):
        motions[a, a] = 1.0
        for r in range(m):
            share = by_law[r, a] / scale
            for b in range(total):
                motions[a, b] -= share * right[r, b]
    motions[total:] = right[m:]
    virtual = _virtual(tree, total)
    _freedoms(tree, here, driven, screws, carriers)
    _step(screws, carriers, motions, virtual.step)
    _spread(tree, here, links, wrenches, np.zeros((0, total)), virtual)
    hessian, met = np.zeros((total, total)), np.empty(total)
    for z in range(total + p):
        _meet(screws[z], virtual.field[carriers[z]], met)
        for a in range(total):
            share = motions[z, a]
            for b in range(total):
                hessian[a, b] += share * met[b]
    return hessian, right[m:]


@bare
def _meet(twist, field, found):
    """Fill the (W) answers to a spatial twist."""
    for b in range(len(found)):
        found[b] = 0.0
    for a in range(6):
        value = twist[a]
        for b in range(len(found)):
            found[b] += value * field[a, b]


class Virtual(NamedTuple):
    """W virtual motions: spatial twists of each element's own freedoms and of elements, (k, 6, W), and what they meet.

    field: (k, 6, W) work of the changes of all loads, and of gaps with forces of theirs, per spatial twist that is
    inserted at an element and moves all that it carries. ends: (T, 2, 6, W) of that what each end of a tie adds.
    flat, tied: those three and `ends` as (3, k, 6 W) and (T, 2, 6 W).
    """

    step: Array
    motion: Array
    field: Array
    ends: Array
    flat: Array
    tied: Array


@called
def _virtual(tree, columns):
    k, t = len(tree.parents), len(tree.joins)
    flat, tied = np.zeros((3, k, 6 * columns)), np.empty((t, 2, 6 * columns))
    whole = flat.reshape((3, k, 6, columns))
    return Virtual(whole[0], whole[1], whole[2], tied.reshape((t, 2, 6, columns)), flat, tied)


@bare
def _step(screws, carriers, motions, step):
    """Add to the (k, 6, W) twists of the elements' own freedoms what (Z, W) motions of coordinates are."""
    for z in range(len(screws)):
        own = step[carriers[z]]
        for a in range(6):
            value = screws[z, a]
            for b in range(motions.shape[1]):
                own[a, b] += value * motions[z, b]


@bare
def _spread(tree, here, links, wrenches, forces, virtual):
    """From `step` and (m, W) virtual forces, fill `motion`, `field` and `ends`; forces of no rows are none."""
    count, step, motion, field = len(tree.parents), virtual.step, virtual.motion, virtual.field
    point, push, moment = here.spare[6], here.spare[7], here.spare[8]
    own, whole, met = virtual.flat[0], virtual.flat[1], virtual.flat[2]
    for k in range(1, count):
        back = tree.parents[k]
        for b in range(own.shape[1]):
            whole[k, b] = whole[back, b] + own[k, b]
        if tree.kinds[0, k] & 3 != RIGID:
            _turned(step[k], here.loads[k], -1.0, field[k])
    for j in range(-count, len(links)):
        k = _pushed(tree, here, links, wrenches, j, point, push)
        if j >= 0 and links[j, 2]:
            _cross(point, push[:3], moment)
            for i in range(3):
                push[3 + i] += moment[i]
            _turned(motion[k], push, 1.0, field[k])
        elif push[0] != 0.0 or push[1] != 0.0 or push[2] != 0.0:
            _shifted(motion[k], push, point, field[k])
    for t in range(len(tree.joins)):
        if tree.joins[t, 0] != GEAR:
            _tied(tree, here, t, forces, virtual)
    for k in range(count - 1, 0, -1):
        back = tree.parents[k]
        for b in range(met.shape[1]):
            met[back, b] += met[k, b]


@bare
def _turned(twist, load, sign, field):
    """Add by how much a wrench that moves along with (6, W) twists changes."""
    fx, fy, fz = sign * load[0], sign * load[1], sign * load[2]
    mx, my, mz = sign * load[3], sign * load[4], sign * load[5]
    for b in range(field.shape[1]):
        vx, vy, vz, wx, wy, wz = twist[0, b], twist[1, b], twist[2, b], twist[3, b], twist[4, b], twist[5, b]
        field[0, b] += wy * fz - wz * fy
        field[1, b] += wz * fx - wx * fz
        field[2, b] += wx * fy - wy * fx
        field[3, b] += wy * mz - wz * my + vy * fz - vz * fy
        field[4, b] += wz * mx - wx * mz + vz * fx - vx * fz
        field[5, b] += wx * my - wy * mx + vx * fy - vy * fx


@bare
def _shifted(motion, push, point, field):
    """Add minus what (6, W) motions make of the change of a wrench that keeps its direction, by a motion of its point.

    The moment keeps its direction, too: only the force's moment about the origin changes with its point.
    """
    fx, fy, fz, x, y, z = push[0], push[1], push[2], point[0], point[1], point[2]
    for b in range(field.shape[1]):
        wx, wy, wz = motion[3, b], motion[4, b], motion[5, b]
        gx, gy, gz = wy * fz - wz * fy, wz * fx - wx * fz, wx * fy - wy * fx
        field[0, b] += gx
        field[1, b] += gy
        field[2, b] += gz
        field[3, b] += y * gz - z * gy
        field[4, b] += z * gx - x * gz
        field[5, b] += x * gy - y * gx


@bare
def _tied(tree, here, t, forces, virtual):
    """Add what the change of a tie's wrench gives at its ends, see `shift` of `ties`, and the change of its gaps."""
    kind, e1, e2, start, end, _ = _tie(tree, t)
    tie, ends, one, two = tree.ties[t], virtual.ends[t], here.spare[2], here.spare[3]
    pull, moment, turning = here.spare[9], here.spare[10], here.turns[3]
    _point(here, e1, tie[:3], one)
    _point(here, e2, tie[3:6], two)
    across = rate = 0.0
    if kind >= ROD:
        length = here.states[t, 0]
        tension = here.forces[start] if kind == ROD else _tension(tie, kind, length)
        rate = tie[27] if kind == COIL else -tie[29] * tension / length if kind == GAS else 0.0
        across = tension / length
        for i in range(3):
            pull[i] = tension * here.states[t, 1 + i]
    else:
        _pin_turning(tree, here, t, one, two, pull, moment, turning)
    px, py, pz, mx, my, mz = pull[0], pull[1], pull[2], moment[0], moment[1], moment[2]
    x1, y1, z1, x2, y2, z2 = one[0], one[1], one[2], two[0], two[1], two[2]
    sx, sy, sz = here.states[t, 1], here.states[t, 2], here.states[t, 3]
    there, back, here_end, there_end = virtual.motion[e2], virtual.motion[e1], ends[0], ends[1]
    t00, t10, t20 = turning[0, 0], turning[1, 0], turning[2, 0]
    t01, t11, t21 = turning[0, 1], turning[1, 1], turning[2, 1]
    t02, t12, t22 = turning[0, 2], turning[1, 2], turning[2, 2]
    for b in range(ends.shape[2]):
        wx, wy, wz = there[3, b] - back[3, b], there[4, b] - back[4, b], there[5, b] - back[5, b]
        ex = there[0, b] - back[0, b] + wy * z2 - wz * y2
        ey = there[1, b] - back[1, b] + wz * x2 - wx * z2
        ez = there[2, b] - back[2, b] + wx * y2 - wy * x2
        gx, gy, gz = py * wz - pz * wy, pz * wx - px * wz, px * wy - py * wx
        if kind >= ROD:
            stretch = (rate - across) * (ex * sx + ey * sy + ez * sz)
            nx, ny, nz = across * ex + stretch * sx, across * ey + stretch * sy, across * ez + stretch * sz
            gx, gy, gz = gx + nx, gy + ny, gz + nz
            here_end[0, b], here_end[1, b], here_end[2, b] = -nx, -ny, -nz
            here_end[3, b], here_end[4, b] = z1 * ny - y1 * nz, x1 * nz - z1 * nx
            here_end[5, b] = y1 * nx - x1 * ny
            cx, cy, cz = 0.0, 0.0, 0.0
        else:
            cx = t00 * wx + t10 * wy + t20 * wz
            cy = t01 * wx + t11 * wy + t21 * wz
            cz = t02 * wx + t12 * wy + t22 * wz
            here_end[0, b] = here_end[1, b] = here_end[2, b] = 0.0
            here_end[3, b] = py * ez - pz * ey + my * wz - mz * wy - cx
            here_end[4, b] = pz * ex - px * ez + mz * wx - mx * wz - cy
            here_end[5, b] = px * ey - py * ex + mx * wy - my * wx - cz
        there_end[0, b], there_end[1, b], there_end[2, b] = gx, gy, gz
        there_end[3, b] = y2 * gz - z2 * gy + cx
        there_end[4, b] = z2 * gx - x2 * gz + cy
        there_end[5, b] = x2 * gy - y2 * gx + cz
    for side, k in ((0, e1), (1, e2)):
        for r in range(start, end if len(forces) else start):
            for a in range(6):
                way = here.ways[t, r - start, a] * (1.0 if side else -1.0)
                for b in range(ends.shape[2]):
                    ends[side, a, b] += way * forces[r, b]
        for b in range(virtual.tied.shape[2]):
            virtual.flat[2, k, b] += virtual.tied[t, side, b]


@bare
def _pin_turning(tree, here, t, one, two, pull, moment, turning):
    """Fill force and moment of a pin, base axes, and how the moment changes with a turn of its second end."""
    tie, kind, slots, parts = tree.ties[t], tree.joins[t, 0], here.spare[11], here.parts
    _pin(tree, here, t, one, two, here.spare[4], parts)
    slots[:] = 0.0
    for r in range(tree.joins[t, 3], tree.joins[t, 4]):
        for a in range(6):
            slots[a] += here.forces[r] * tree.rows[r, a]
    for i in range(3):
        pull[i] = moment[i] = 0.0
        for j in range(3):
            pull[i] += parts[j, i] * slots[j]
            moment[i] += parts[3 + j, i] * slots[3 + j]
            turning[i, j] = 0.0
    if tree.joins[t, 4] - tree.joins[t, 3] == 3:  # a spherical bearing has no moment
        return
    change, local, axis, there, turned = parts[3:, 3:], here.turns[4], tie[6:9], here.spare[5], here.turns[5]
    half = 0.5 * (change[0, 0] + change[1, 1] + change[2, 2])
    for j in range(3):
        there[j] = half * axis[j] - change[j, 0] * axis[0] - change[j, 1] * axis[1] - change[j, 2] * axis[2]
    for j in range(3):
        if kind == FIXED:
            _cross(slots[3:], change[:, j], turned[j])
            for i in range(3):
                local[i, j] = -0.5 * turned[j, i]
        else:  # of what is turned the axis moves: along e_j by there x e_j, the other way
            for i in range(3):
                turned[i, j] = slots[3 + i] * axis[j] - axis[i] * slots[3 + j]
    if kind != FIXED:
        for i in range(3):  # minus `turned` times the cross product with `there`
            local[i, 0] = -(turned[i, 1] * there[2] - turned[i, 2] * there[1])
            local[i, 1] = -(turned[i, 2] * there[0] - turned[i, 0] * there[2])
            local[i, 2] = -(turned[i, 0] * there[1] - turned[i, 1] * there[0])
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for n in range(3):
                    turning[i, j] += parts[k, i] * local[k, n] * parts[n, j]


@bare
def _tip(tree, here, turn, origin):
    end = tree.elements[len(tree.parents)]
    _compose(here.turn[int(end[15])], here.origin[int(end[15])], end, turn, origin)


@kept
@called
def rest_rows(
    tree, compliance, offset, links, wrenches, q, settled, first, free, idle,
    closed, tips, flexed, twists, loads, forces, displacement, distance, idles, model,
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
        idles: (N or 0, m, m) `idle` there.
        model: (N or 0, nq_model + 2 size) rigid configuration, motion and torque; see `mechanism.Rest`.
    """
    here, scale, even = _memory(tree, len(free)), 0.0, False
    turn, moved, at, end, turned = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty((3, 3))
    for row in range(first, len(q)):
        here.twists[:] = 0.0
        if not _close(tree, q[row], free, here):
            return row
        closed[row] = free
        own = min(row, len(compliance) - 1)
        if settled and (row == first or own > 0):
            scale, even = _root(compliance[own], here.roots, np.empty_like(here.roots), here.starts)
            scale = max(scale, 1e-9)
        _place(tree, q[row], free, False, here)
        _tip(tree, here, turn, at)
        tips[row] = 0.0
        tips[row, 3, 3] = 1.0
        tips[row, :3, :3], tips[row, :3, 3] = turn, at
        if not settled:
            continue
        if not even:
            return row
        pushed = wrenches[min(row, len(wrenches) - 1)]
        flexed[row] = free
        distance[row] = _settle(
            tree, compliance[own], offset[own], scale, links, pushed, q[row], flexed[row], idle, here
        )
        if not distance[row] <= SHARE:
            return row
        twists[row], loads[row], forces[row] = here.twists, here.load, here.forces
        if len(idles):
            idles[row] = idle
        _tip(tree, here, moved, end)
        for i in range(3):
            displacement[row, i] = end[i] - at[i]
            for j in range(3):
                turned[i, j] = moved[i, 0] * turn[j, 0] + moved[i, 1] * turn[j, 1] + moved[i, 2] * turn[j, 2]
        _logarithm(turned, displacement[row, 3:])
        if len(model):
            _model(tree, here, q[row], free, flexed[row], model[row])
    return len(q)


@bare
def _model(tree, here, q, free, flexed, found):
    """Fill rigid configuration, motion and torque as Pinocchio orders them; see `Tree.places`."""
    nq, p, n, k = len(tree.neutral), len(free), len(tree.flexures), len(tree.parents)
    size, driven = (len(found) - nq) // 2, len(tree.places) - 2 * p - n - k
    motion, torque = found[nq : nq + size], found[nq + size :]
    found[nq:] = 0.0
    for i in range(nq):
        found[i] = tree.neutral[i]
    for i in range(driven):
        found[tree.places[i]] = q[i]
    for i in range(p):
        found[tree.places[driven + i]] = free[i]
        motion[tree.places[driven + p + i]] = flexed[i] - free[i]
    at = driven + 2 * p + n
    for i in range(k):
        if tree.places[at + i] >= 0:
            torque[tree.places[at + i]] = here.torque[i]
    first = size
    for t in range(len(tree.joins)):
        first -= 6 if tree.joins[t, 0] < COIL else 0
    for t in range(len(tree.joins)):
        for r in range(tree.joins[t, 3], tree.joins[t, 4]):
            for a in range(6):
                torque[first + 6 * t + a] -= here.forces[r] * tree.rows[r, a]
    for i in range(n):
        start = tree.places[driven + 2 * p + i]
        for a in range(6):
            motion[start + a], torque[start + a] = here.twists[i, a], -here.load[i, a]


@kept
@called
def respond_rows(
    tree, tangents, links, wrenches, q, flexed, twists, forces, idle, end, places, numbers,
    laws, joints, sites, motions, gravity, poses, loads,
):  # fmt: skip
    """Fill how the origin of a frame moves, base axes, where the mechanism rests in N rows, into arrays that have rows.

    Let z be coordinates y of laws, passive joints and forces in closures; M dz = 0 is how the mechanism stays at rest,
    M with the loads' changes as `_spread` has them. With J the frame's motion per z, the six virtual motions J M^-1
    meet whatever else is changed.

    Args:
        tree, links, wrenches: As of `rest_rows`.
        tangents: (1 or N, n, 6, 6) of the laws.
        q, flexed, twists, forces, idle: (N, ...) as `rest_rows` found them.
        end: (13,) the element that the frame is fixed to, and rotation and origin in its axes.
        places, numbers: See `Frames`; `sites` and `loads` have closures and pins behind them.
        laws, joints, sites: (N, 6, n, 6), (N, 6, nq) and (N, 6, s, 6) per twist of a law, drive, and twist at a site.
        motions, gravity: (N, f, 6, 6) per wrench at a frame, and (N, 6, 3).
        poses, loads: (N, f, 4, 4) of the frames and (N, s, 6) at the sites.
    """
    here, n, count = _memory(tree, flexed.shape[1]), len(tree.flexures), len(tree.parents)
    (m, p), driven, f = here.by_free.shape, q.shape[1], places.shape[1]
    derivative, at, turn, roots = np.empty((6, 6)), np.empty(3), np.empty((3, 3)), np.empty((n, 6, 6))
    own, derived, screw, carried = np.empty((6, 6)), np.empty((n, 6, 6)), np.empty((6, 6)), np.zeros(count)
    k = int(end[0])
    while k > 0:
        carried[k] = 1.0
        k = tree.parents[k]
    carried[0] = 1.0
    answers, scale = len(laws) + len(joints) + len(sites) + len(motions) + len(gravity), 0.0
    met, none, rank, free = _virtual(tree, 6), np.zeros((0, 0)), 0, 0
    virtual, matrix, right, screws, order, carriers = met, none, none, none, here.order, here.order
    for row in range(len(q)):
        if row < len(tangents):
            largest, _ = _root(tangents[row], roots, here.roots, here.starts)
            scale = 1.0 / math.sqrt(max(largest, 1e-9))
        pushed = wrenches[min(row, len(wrenches) - 1)]
        here.twists[:], here.forces[:] = twists[row], forces[row]
        _place(tree, q[row], flexed[row], True, here)
        _join(tree, q[row], flexed[row], here)
        _weigh(tree, here, links, pushed)
        for i in range(f if len(poses) + len(loads) else 0):
            k = places[0, i]
            _compose(here.turn[k], here.origin[k], numbers[i], turn, at)
            if len(poses):
                poses[row, i] = 0.0
                poses[row, i, 3, 3] = 1.0
                poses[row, i, :3, :3], poses[row, i, :3, 3] = turn, at
            if len(loads):
                _action(turn, at, screw)
                loads[row, i] = 0.0
                for a in range(6):
                    for b in range(6):
                        loads[row, i, a] += screw[b, a] * here.loads[places[1, i], b]
        if len(loads):
            loads[row, f:] = 0.0
            for t in range(len(tree.joins)):
                for r in range(tree.joins[t, 3], tree.joins[t, 4]):
                    for a in range(6):
                        loads[row, f + t, a] += here.forces[r] * tree.rows[r, a]
        if answers == 0:
            continue
        if row < len(tangents):
            rank = here.starts[-1]
            free, size = rank + p, rank + p + m
            virtual, matrix, right = _virtual(tree, free), np.empty((size, size)), np.empty((size, 6))
            order, carriers = np.empty(size, dtype=np.int64), np.empty(free, dtype=np.int64)
            screws = np.empty((free, 6))
        virtual.step[:] = virtual.field[:] = right[:] = 0.0
        met.step[:] = met.field[:] = 0.0
        _freedoms(tree, here, driven, screws, carriers)
        for z in range(free):
            for a in range(6):
                virtual.step[carriers[z], a, z] = screws[z, a]
        _spread(tree, here, links, pushed, none, virtual)
        _reach(tree, q[row], here)
        _bend(tree, here, here.roots, here.screws)
        for r in range(m):
            for c in range(rank):
                matrix[free + r, c] = scale * here.by_law[r, c]
        real = screws.copy()
        for i in range(n):
            k = tree.flexures[i]
            if k >= 0:
                _action(here.turn[k], here.origin[k], own)
                _right_jacobian(here.twists[i], derivative)
                _times(own, derivative, derived[i])
                for c in range(here.starts[i], here.starts[i + 1]):
                    for a in range(6):
                        real[c, a] = 0.0
                        for b in range(6):
                            real[c, a] += derived[i, a, b] * roots[i, b, c - here.starts[i]]
        _bend(tree, here, roots, real)
        _compose(here.turn[int(end[0])], here.origin[int(end[0])], end[1:], turn, at)
        for r in range(m):
            for c in range(rank):
                matrix[c, free + r] = scale * here.by_law[r, c]
            for a in range(p):
                matrix[free + r, rank + a] = matrix[rank + a, free + r] = scale * here.by_free[r, a]
            for c in range(m):
                matrix[free + r, free + c] = -scale * scale * idle[row, c, r]
        for b in range(free):  # transposed: b is what moves, a what is met
            _meet(real[b], virtual.field[carriers[b]], matrix[b, :free])
            matrix[b, b] += 1.0 if b < rank else 0.0
            if carried[carriers[b]] > 0.0:
                v, w = real[b, :3], real[b, 3:]
                right[b, 0] = v[0] + w[1] * at[2] - w[2] * at[1]
                right[b, 1] = v[1] + w[2] * at[0] - w[0] * at[2]
                right[b, 2] = v[2] + w[0] * at[1] - w[1] * at[0]
                right[b, 3:] = w
        _factor(matrix, order)
        _solve(matrix, order, right)
        for r in range(m):
            for a in range(6):
                right[free + r, a] *= scale
        force = right[free:]
        _step(screws, carriers, right[:free], met.step)
        _spread(tree, here, links, pushed, force, met)
        _action(np.eye(3), -at, screw)
        for k in range(count):
            for a in range(6):
                for b in range(6):
                    met.field[k, a, b] = carried[k] * screw[b, a] - met.field[k, a, b]
        if len(laws):
            laws[row] = 0.0
            for i in range(n):
                e = tree.flexures[i]
                if e >= 0:
                    _pair(met.field[e], derived[i], laws[row, :, i])
                else:
                    _slots(tree, -1 - e, force, laws[row, :, i])
        if len(joints):
            joints[row] = 0.0
            for k in range(1, count):
                j = tree.kinds[1, k]
                if tree.kinds[0, k] & 3 in (TURNS, SLIDES) and j < driven:
                    for a in range(6):
                        for b in range(6):
                            joints[row, b, j] += met.field[k, a, b] * here.axes[k, a]
            for t in range(len(tree.joins)):
                kind, _, e2, r, _, j = _tie(tree, t)
                if kind == ROD:
                    joints[row, :, j] += force[r]
                elif kind == GEAR and tree.kinds[1, e2] < driven:
                    joints[row, :, tree.kinds[1, e2]] += tree.ties[t, 27] * force[r]
        if len(sites):
            sites[row] = 0.0
            for i in range(f):
                k = places[0, i]
                _compose(here.turn[k], here.origin[k], numbers[i], turn, at)
                _action(turn, at, screw)
                field = met.field[places[1, i]].copy()
                if k == places[1, i] and tree.kinds[0, k] & 3 != FLEXURE:  # outboard of a passive joint its axis stays
                    _turned(met.step[k], here.loads[k], -1.0, field)
                _pair(field, screw, sites[row, :, i])
            closures = 0
            for t in range(len(tree.joins)):
                if tree.joins[t, 0] < COIL:
                    _slots(tree, t, force, sites[row, :, f + t])
                    closures += 1
            for t in range(closures):
                for side in range(2 if tree.joins[t, 0] < GEAR else 0):
                    k = tree.joins[t, 1 + side]
                    _point(here, k, tree.ties[t, 3 * side :], at)
                    for a in range(3):
                        for b in range(3):
                            turn[a, b] = 0.0
                            for c in range(3):
                                turn[a, b] += here.turn[k, a, c] * tree.ties[t, 30 + 9 * side + 3 * c + b]
                    _action(turn, at, screw)
                    _pair(met.ends[t, side], -screw, sites[row, :, f + closures + 2 * t + side])
        for i in range(f if len(motions) else 0):
            k = places[0, i]
            _compose(here.turn[k], here.origin[k], numbers[i], turn, at)
            for b in range(6):
                motions[row, i, b, 3:] = met.motion[k, 3:, b]
                _cross(met.motion[k, 3:, b], at, motions[row, i, b, :3])
                for a in range(3):
                    motions[row, i, b, a] += met.motion[k, a, b]
        if len(gravity):
            gravity[row] = 0.0
            for k in range(1, count):
                _point(here, k, tree.elements[k, 16:19], at)
                for b in range(6):
                    _cross(met.motion[k, 3:, b], at, turn[0])
                    for a in range(3):
                        gravity[row, b, a] += tree.elements[k, 15] * (met.motion[k, a, b] + turn[0, a])


@bare
def _pair(field, motions, found):
    """Fill the (6, 6) answers to (6, 6) spatial motions."""
    for b in range(6):
        for c in range(6):
            found[b, c] = 0.0
            for a in range(6):
                found[b, c] += field[a, b] * motions[a, c]


@bare
def _slots(tree, t, force, found):
    """Fill the (6, 6) answers to a closure's twist."""
    for r in range(tree.joins[t, 3], tree.joins[t, 4]):
        for b in range(6):
            for c in range(6):
                found[b, c] += force[r, b] * tree.rows[r, c]


def compile_everything() -> None:
    """Compile what is not yet kept, by asking about no rows."""
    none = np.zeros((0, 6))
    tree = Tree(
        np.zeros((2, 20)), np.full((4, 1), RIGID), np.zeros(1, dtype=np.int64), np.zeros((0, 1)), np.zeros((0, 48)),
        np.zeros((0, 6), dtype=np.int64), none, np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0, dtype=np.int64),
    )  # fmt: skip
    laws, plain = LawStack((), ()).numbers, np.zeros((0, 0))
    loads, pushed = np.zeros((0, 0, 6)), (np.zeros((0, 3), dtype=np.int64), np.zeros((1, 0, 9)))
    arrays = plain, np.zeros((0, 4, 4)), plain, loads, loads, plain, none, np.zeros(0), loads, plain
    frames = np.zeros(13), np.zeros((2, 0), dtype=np.int64), np.zeros((0, 12))
    answers = np.zeros((0, 6, 0, 6)), np.zeros((0, 6, 0)), np.zeros((0, 6, 0, 6)), np.zeros((0, 0, 6, 6))
    answers += np.zeros((0, 6, 3)), np.zeros((0, 0, 4, 4)), loads
    with kept_code.compiled_once(rest_rows, respond_rows):
        rest_rows(tree, laws.compliance, laws.offset, *pushed, plain, True, 0, np.zeros(0), plain, *arrays)
        respond_rows(tree, laws.compliance, *pushed, plain, plain, loads, plain, loads, *frames, *answers)


def is_kept() -> bool:
    """Return whether nothing has to be compiled."""
    return kept_code.is_kept(rest_rows, respond_rows)
