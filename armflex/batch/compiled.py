"""The functions of `bending` compiled by numba, where that is installed (`pip install armflex[fast]`).

The same formulas; a loop over configurations is one pass over memory instead of a dozen.
"""

from __future__ import annotations

import numba
import numpy as np

from armflex.batch.bending import rotation_vectors
from armflex.batch.chain import Chain, Straight
from armflex.conventions import Array

jit = numba.njit(cache=True, nogil=True, error_model="numpy")


def straighten(chain: Chain, q: Array) -> Straight:
    """Return the rigid arm at (nq, N) joint positions."""
    many, n = q.shape[1], chain.flexures
    turn, origin, moment = np.empty((n, 3, 3, many)), np.empty((n, 3, many)), np.zeros((n, 3, many))
    here, at = np.zeros((3, 3, many)), np.zeros((3, many))
    here[0, 0] = here[1, 1] = here[2, 2] = 1.0
    _straighten(*chain.tables, np.sin(q), np.cos(q), q, here, at, turn, origin, moment)
    at += np.tensordot(chain.tip_origin, here, axes=(0, 1))
    return Straight(turn, origin, moment, at, np.matmul(chain.tip_rotation.T, here))


def weigh(chain: Chain, straight: Straight, twists: Array | None = None) -> Array:
    """Return the (n, 6, N) loads on the flexures in their own axes under the weight, bent by (n, 6, N) twists."""
    n, _, many = straight.origin.shape
    moments, pull, loads = np.empty((n, 3, many)), np.empty((3, many)), np.empty((n, 6, many))
    at, bent = (straight.turn, straight.origin, straight.moment), twists is not None
    order = np.array(chain.order, dtype=np.int64)
    given = twists if bent else np.empty((0, 6, many))
    _weigh(*at, given, order, chain.outboard, chain.gravity, bent, moments, pull, loads)
    return loads


def displace(chain: Chain, straight: Straight, twists: Array) -> Array:
    """Return the (6, N) displacement of the tip by (n, 6, N) twists: shift [m], rotation vector [rad], base axes."""
    shift, quaternion = np.empty_like(straight.tip), np.empty((4, straight.tip.shape[1]))
    order = np.array(chain.order, dtype=np.int64)
    _displace(straight.turn, straight.origin, straight.tip, twists, order, shift, quaternion)
    return np.concatenate([shift, rotation_vectors(quaternion[0], quaternion[1:])])


@jit
def _straighten(rotation, origin, axis, kind, place, mass, lever, sine, cosine, q, here, at, turn, where, moment):
    """Fill turn (n, 3, 3, N), where (n, 3, N) and moment (n, 3, N); leave the last frame in `here` and `at`.

    kind: 0 a flexure, 1 a turning joint, 2 a sliding one.
    """
    many, carrier = q.shape[1], -1
    turned = np.eye(3)
    for link in range(len(kind)):
        px, py, pz = origin[link]
        ax, ay, az = axis[link]
        own = place[link]
        for c in range(many):
            for i in range(3):
                at[i, c] += here[i, 0, c] * px + here[i, 1, c] * py + here[i, 2, c] * pz
        turned = rotation[link]
        plain = True
        for i in range(3):
            for j in range(3):
                plain = plain and turned[i, j] == (1.0 if i == j else 0.0)
        if not plain:
            for i in range(3):
                for c in range(many):
                    a, b, d = here[i, 0, c], here[i, 1, c], here[i, 2, c]
                    here[i, 0, c] = a * turned[0, 0] + b * turned[1, 0] + d * turned[2, 0]
                    here[i, 1, c] = a * turned[0, 1] + b * turned[1, 1] + d * turned[2, 1]
                    here[i, 2, c] = a * turned[0, 2] + b * turned[1, 2] + d * turned[2, 2]
        if kind[link] == 0:
            carrier = own
            turn[carrier, :, :, :] = here
            where[carrier, :, :] = at
        elif kind[link] == 2:
            for i in range(3):
                for c in range(many):
                    along = here[i, 0, c] * ax + here[i, 1, c] * ay + here[i, 2, c] * az
                    at[i, c] += along * q[own, c]
        else:
            for i in range(3):
                for c in range(many):
                    s, v = sine[own, c], 1.0 - cosine[own, c]
                    a, b, d = here[i, 0, c], here[i, 1, c], here[i, 2, c]
                    # A row of the frame times exp(axis): rows turn the other way about the axis.
                    k0, k1, k2 = b * az - d * ay, d * ax - a * az, a * ay - b * ax
                    here[i, 0, c] = a + s * k0 + v * (k1 * az - k2 * ay)
                    here[i, 1, c] = b + s * k1 + v * (k2 * ax - k0 * az)
                    here[i, 2, c] = d + s * k2 + v * (k0 * ay - k1 * ax)
        m = mass[link]
        if m > 0.0 and carrier >= 0:
            lx, ly, lz = lever[link]
            for i in range(3):
                for c in range(many):
                    arm = here[i, 0, c] * lx + here[i, 1, c] * ly + here[i, 2, c] * lz
                    moment[carrier, i, c] += m * (at[i, c] + arm)


@jit
def _screw(turn, where, twists, k, c):
    """Return the screw of flexure k in configuration c: linear, angular, and the exponential's coefficients."""
    x, y, z = twists[k, 3, c], twists[k, 4, c], twists[k, 5, c]
    wx = turn[k, 0, 0, c] * x + turn[k, 0, 1, c] * y + turn[k, 0, 2, c] * z
    wy = turn[k, 1, 0, c] * x + turn[k, 1, 1, c] * y + turn[k, 1, 2, c] * z
    wz = turn[k, 2, 0, c] * x + turn[k, 2, 1, c] * y + turn[k, 2, 2, c] * z
    s = x * x + y * y + z * z
    x, y, z = twists[k, 0, c], twists[k, 1, c], twists[k, 2, c]
    vx = turn[k, 0, 0, c] * x + turn[k, 0, 1, c] * y + turn[k, 0, 2, c] * z
    vy = turn[k, 1, 0, c] * x + turn[k, 1, 1, c] * y + turn[k, 1, 2, c] * z
    vz = turn[k, 2, 0, c] * x + turn[k, 2, 1, c] * y + turn[k, 2, 2, c] * z
    px, py, pz = where[k, 0, c], where[k, 1, c], where[k, 2, c]
    vx, vy, vz = vx - (wy * pz - wz * py), vy - (wz * px - wx * pz), vz - (wx * py - wy * px)
    second = 0.5 - s * (1 / 24 - s * (1 / 720 - s / 40320))
    third = 1 / 6 - s * (1 / 120 - s * (1 / 5040 - s / 362880))
    return vx, vy, vz, wx, wy, wz, second, third, s


@jit
def _weigh(turn, where, moment, twists, order, outboard, gravity, bent, moments, pull, loads):
    """Fill the (n, 6, N) loads; `moments` (n, 3, N) and `pull` (3, N) are room to work in."""
    many, n = where.shape[2], len(order)
    gx, gy, gz = gravity
    moments[:] = moment
    for step in range(n - 1, 0, -1):
        k, inner = order[step], order[step - 1]
        m = outboard[k]
        for c in range(many):
            qx, qy, qz = moments[k, 0, c], moments[k, 1, c], moments[k, 2, c]
            if bent:
                vx, vy, vz, wx, wy, wz, b, t, _ = _screw(turn, where, twists, k, c)
                ux, uy, uz = m * vx + wy * qz - wz * qy, m * vy + wz * qx - wx * qz, m * vz + wx * qy - wy * qx
                ox, oy, oz = wy * uz - wz * uy, wz * ux - wx * uz, wx * uy - wy * ux
                qx += ux + b * ox + t * (wy * oz - wz * oy)
                qy += uy + b * oy + t * (wz * ox - wx * oz)
                qz += uz + b * oz + t * (wx * oy - wy * ox)
            moments[inner, 0, c] += qx
            moments[inner, 1, c] += qy
            moments[inner, 2, c] += qz
    for c in range(many):
        pull[0, c], pull[1, c], pull[2, c] = gx, gy, gz
    for step in range(n):
        k = order[step]
        m = outboard[k]
        for c in range(many):
            x, y, z = pull[0, c], pull[1, c], pull[2, c]
            if bent:
                _, _, _, wx, wy, wz, b, t, s = _screw(turn, where, twists, k, c)
                a = 1.0 - t * s
                ox, oy, oz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
                x += b * (wy * oz - wz * oy) - a * ox
                y += b * (wz * ox - wx * oz) - a * oy
                z += b * (wx * oy - wy * ox) - a * oz
                pull[0, c], pull[1, c], pull[2, c] = x, y, z
            rx = moments[k, 0, c] - m * where[k, 0, c]
            ry = moments[k, 1, c] - m * where[k, 1, c]
            rz = moments[k, 2, c] - m * where[k, 2, c]
            mx, my, mz = ry * z - rz * y, rz * x - rx * z, rx * y - ry * x
            x, y, z = m * x, m * y, m * z
            for j in range(3):
                r0, r1, r2 = turn[k, 0, j, c], turn[k, 1, j, c], turn[k, 2, j, c]
                loads[k, j, c] = r0 * x + r1 * y + r2 * z
                loads[k, 3 + j, c] = r0 * mx + r1 * my + r2 * mz


@jit
def _displace(turn, where, tip, twists, order, shift, quaternion):
    """Fill the (3, N) shift of the tip and the (4, N) quaternion of its turn, real part first."""
    many = tip.shape[1]
    for c in range(many):
        shift[0, c] = shift[1, c] = shift[2, c] = 0.0
        quaternion[0, c] = 1.0
        quaternion[1, c] = quaternion[2, c] = quaternion[3, c] = 0.0
    for step in range(len(order) - 1, -1, -1):
        k = order[step]
        for c in range(many):
            vx, vy, vz, wx, wy, wz, b, t, s = _screw(turn, where, twists, k, c)
            x, y, z = tip[0, c] + shift[0, c], tip[1, c] + shift[1, c], tip[2, c] + shift[2, c]
            ux, uy, uz = vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x
            ox, oy, oz = wy * uz - wz * uy, wz * ux - wx * uz, wx * uy - wy * ux
            shift[0, c] += ux + b * ox + t * (wy * oz - wz * oy)
            shift[1, c] += uy + b * oy + t * (wz * ox - wx * oz)
            shift[2, c] += uz + b * oz + t * (wx * oy - wy * ox)
            half = 0.5 - s * (1 / 48 - s * (1 / 3840 - s / 645120))
            a = 1.0 - s * (1 / 8 - s * (1 / 384 - s / 46080))
            wx, wy, wz = half * wx, half * wy, half * wz
            r, i, j, k_ = quaternion[0, c], quaternion[1, c], quaternion[2, c], quaternion[3, c]
            quaternion[0, c] = a * r - (wx * i + wy * j + wz * k_)
            quaternion[1, c] = a * i + r * wx + wy * k_ - wz * j
            quaternion[2, c] = a * j + r * wy + wz * i - wx * k_
            quaternion[3, c] = a * k_ + r * wz + wx * j - wy * i
