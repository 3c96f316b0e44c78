"""What an update computes beside Pinocchio, compiled by numba where that is installed: `pip install armflex[fast]`.

The formulas are those of `quick` and `estimate`. Compiling takes seconds, once: the code is kept beside this file, or
where numba keeps such things.
"""

from __future__ import annotations

import math

import numba
import numpy as np

jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
inner = numba.njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})


SHIFT, TURN, TARGET, JOINT, COMPLIANCE, LAW, NOTHING = range(7)
"""Kinds of columns: of the instrument, the tool, a joint, a flexure's axis, a learned law, and none."""


@jit
def see(
    jacobian, geometric, carrier, origin, motion, given, torque, position, sigma,
    turn, shift, local, axes, stretch, places, compliance, kinds, which, law_places, law_units, enough, terms,
):  # fmt: skip
    """Return whether the series of `quick._redistributed` ends, and the residual (3,) and columns (3, P) of a reading.

    Args:
        jacobian: (6, nv) of the target, world axes.
        geometric: (nv, nv) change of the torque per motion.
        carrier, origin: (3, 3) axes and (3,) place of the tip's joint.
        motion, given, torque: (nv,) where the arm is, what its laws give there, and under what.
        position, sigma: Three numbers each, of the reading.
        turn, shift, stretch: Of the instrument.
        local, axes: (3,) target and (3, 3) axes of the tip in that joint.
        places, compliance: (n, 6) and (n, 6, 6) of the flexures.
        kinds, which: (P,) kind of each parameter, and which axis, place or row of `law_units` (L, 6, 6).
        law_places: (L, 6) places of a learned law's flexure.
        enough, terms: Where the series ends: its last term's square by the first's, and how many at most.
    """
    answer, loads, ended = _answer(jacobian, geometric, turn, places, compliance, enough, terms)
    residual, columns = np.empty(3), np.zeros((3, len(kinds)))
    if not ended:
        return False, residual, columns
    point, twist = _point(carrier, origin, motion, given, answer, turn, shift, local, stretch), np.empty(6)
    for r in range(3):
        residual[r] = (position[r] - point[r]) / sigma[r]
    _comply(answer, places, compliance, loads)
    for p in range(len(kinds)):
        kind, k = kinds[p], which[p]
        if kind == SHIFT:
            columns[k, p] = 1.0
        elif kind == TURN:
            columns[(k + 1) % 3, p], columns[(k + 2) % 3, p] = -point[(k + 2) % 3], point[(k + 1) % 3]
        elif kind == TARGET:
            _aim(carrier, turn, axes[:, k], columns[:, p])
        elif kind == LAW:
            _give(torque, law_places[k], law_units[k], twist)
        for r in range(3):
            if kind == JOINT:
                columns[r, p] = answer[r, k]
            elif kind == COMPLIANCE:
                columns[r, p] = 0.5 * (answer[r, k] * motion[k] - loads[r, k] * torque[k])
            elif kind == LAW:
                columns[r, p] = _along(answer[r], law_places[k], twist)
            columns[r, p] /= sigma[r]
    return True, residual, columns


@inner
def _point(carrier, origin, motion, given, answer, turn, shift, local, stretch):
    """Return where the instrument sees the target, the tangent going the rest of the way to where the arm rests."""
    point = shift.copy()
    for r in range(3):
        for k in range(len(motion)):
            point[r] += answer[r, k] * (given[k] - motion[k])
        for i in range(3):
            point[r] += turn[r, i] * (origin[i] + _row(carrier, i, local))
        point[r] *= stretch
    return point


@inner
def _aim(carrier, turn, axis, column):
    """Add an axis of the tip as the instrument sees it."""
    for r in range(3):
        for i in range(3):
            column[r] += turn[r, i] * _row(carrier, i, axis)


@inner
def _row(matrix, i, vector):
    return matrix[i, 0] * vector[0] + matrix[i, 1] * vector[1] + matrix[i, 2] * vector[2]


@inner
def _give(torque, places, unit, twist):
    """Fill the (6,) twist that a (6, 6) compliance gives under minus the torque."""
    for a in range(6):
        twist[a] = 0.0
        for b in range(6):
            twist[a] -= unit[a, b] * torque[places[b]]


@inner
def _along(answer, places, twist):
    value = 0.0
    for a in range(6):
        value += answer[places[a]] * twist[a]
    return value


@inner
def _answer(jacobian, geometric, turn, places, compliance, enough, terms):
    """Return the (3, nv) turned answer, room of its size, and whether the series ends."""
    size = jacobian.shape[1]
    total, term, loads = np.empty((3, size)), np.empty((3, size)), np.zeros((3, size))
    for r in range(3):
        for j in range(size):
            value = turn[r, 0] * jacobian[0, j] + turn[r, 1] * jacobian[1, j] + turn[r, 2] * jacobian[2, j]
            total[r, j] = term[r, j] = value
    limit = enough * _square(total)
    for _ in range(terms):
        _comply(term, places, compliance, loads)
        _redistribute(loads, geometric, places, term)
        for r in range(3):
            for j in range(size):
                total[r, j] += term[r, j]
        if _square(term) <= limit:
            return total, loads, True
    return total, loads, False


@inner
def _square(rows):
    value = 0.0
    for r in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            value += rows[r, j] * rows[r, j]
    return value


@inner
def _comply(rows, places, compliance, found):
    """Fill (3, nv) rows times the compliances of all flexures, among zeros."""
    for i in range(len(places)):
        for r in range(3):
            for a in range(6):
                value = 0.0
                for b in range(6):
                    value += rows[r, places[i, b]] * compliance[i, b, a]
                found[r, places[i, a]] = value


@inner
def _redistribute(loads, geometric, places, found):
    """Fill minus (3, nv) loads times the (nv, nv) geometric stiffness."""
    found[:] = 0.0
    for i in range(len(places)):
        for a in range(6):
            k = places[i, a]
            x, y, z = loads[0, k], loads[1, k], loads[2, k]
            if x != 0.0 or y != 0.0 or z != 0.0:
                for j in range(len(geometric)):
                    found[0, j] -= x * geometric[k, j]
                    found[1, j] -= y * geometric[k, j]
                    found[2, j] -= z * geometric[k, j]


@jit
def take(values, root, residual, columns, far):
    """Return distance, values and root of `estimate.take`; beyond `far` these are as they were."""
    heard, whitened = columns @ root, residual.copy()
    for r in range(len(residual)):
        for i in range(len(values)):
            whitened[r] -= columns[r, i] * values[i]
    factor = _factor(heard)
    _forward(factor, whitened)
    square = 0.0
    for r in range(len(residual)):
        square += whitened[r] * whitened[r]
    distance = math.sqrt(square)
    if not distance <= far:
        return distance, values, root
    after, left = _absorb(values, root, heard, factor, whitened)
    return distance, after, left


@inner
def _factor(heard):
    """Return the Cholesky factor of the unit matrix and (d, P) rows times themselves, lower."""
    d = len(heard)
    factor = np.zeros((d, d))
    for r in range(d):
        for c in range(r + 1):
            value = 1.0 if r == c else 0.0
            for j in range(heard.shape[1]):
                value += heard[r, j] * heard[c, j]
            for k in range(c):
                value -= factor[r, k] * factor[c, k]
            factor[r, c] = math.sqrt(value) if r == c else value / factor[c, c]
    return factor


@inner
def _forward(factor, values):
    """Solve with a lower (d, d) factor in place."""
    for r in range(len(values)):
        for k in range(r):
            values[r] -= factor[r, k] * values[k]
        values[r] /= factor[r, r]


@inner
def _absorb(values, root, heard, factor, whitened):
    """Return values and root that know a reading, too; `heard` is used up."""
    d, count = heard.shape
    half = heard.copy()
    for r in range(d):  # F^-1 and (F + I)^-1 of the rows
        for k in range(r):
            for j in range(count):
                heard[r, j] -= factor[r, k] * heard[k, j]
                half[r, j] -= factor[r, k] * half[k, j]
        once, more = 1.0 / factor[r, r], 1.0 / (factor[r, r] + 1.0)
        for j in range(count):
            heard[r, j] *= once
            half[r, j] *= more
    gain = root @ heard.T
    left = _less(root, gain, half, 0)
    for first in range(3, d, 3):
        left = _less(left, gain, half, first)
    return values + gain @ whitened, left


@inner
def _less(root, gain, half, first):
    """Return the root less three columns of the gain times three rows."""
    count = len(root)
    left = np.empty((count, count))
    for i in range(count):
        x, y, z = gain[i, first], gain[i, first + 1], gain[i, first + 2]
        for j in range(count):
            left[i, j] = root[i, j] - (x * half[first, j] + y * half[first + 1, j] + z * half[first + 2, j])
    return left
