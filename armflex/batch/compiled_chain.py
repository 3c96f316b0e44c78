"""Where a chain's flexures are, what they carry and where its tip goes, compiled by numba: see `compiled`, `bending`.

`room` is a `compiled.Room`, `arm` a `compiled.Arm`. Scalars are written out: views of arrays take longer than what is
done with them.
"""

from __future__ import annotations

import math

import numba
import numpy as np

inner = numba.njit(nogil=True, forceinline=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
in_order = numba.njit(nogil=True, error_model="numpy", fastmath={"contract"})
"""For sums whose order matters."""

TURN, TURN_REST, TURNS = 2.0 * math.pi, 2.4492935982947064e-16, 0.5 / math.pi
"""2 pi as a double, what it lacks, and turns in a radian: to divide takes longer."""


@inner
def straighten(arm, room, q, first, lanes):
    """Place the rigid arm at the rows of q from `first` on; past the end the last stands for those that are not."""
    here, tip, moment, links = room.frame, room.tip, room.moment, arm.links
    _begin(room, lanes)
    sine, less, carrier, last = room.lane[4], room.lane[5], -1, len(q) - 1
    for k in range(len(links)):
        kind, own = arm.kinds[k, 0], arm.kinds[k, 1]
        _shift(tip, 0, here, links[k, 9], links[k, 10], links[k, 11], lanes)
        if kind & 4:
            _turn(here, links, k, lanes)
        if kind & 3 == 0:
            carrier = own
            _keep(room, own, lanes)
        elif kind & 3 == 1:
            for c in range(len(lanes)):
                sine[c], less[c] = _sine_and_less(q[min(first + c, last), own])
            _swing(here, links[k, 12], links[k, 13], links[k, 14], sine, less, lanes)
        else:
            for i in range(3):
                for c in range(len(lanes)):
                    along = here[i, 0, c] * links[k, 12] + here[i, 1, c] * links[k, 13] + here[i, 2, c] * links[k, 14]
                    tip[0, i, c] += along * q[min(first + c, last), own]
        mass = links[k, 15]
        if mass > 0.0 and carrier >= 0:
            for i in range(3):
                for c in range(len(lanes)):
                    moment[carrier, i, c] += mass * tip[0, i, c]
            _shift(moment, carrier, here, mass * links[k, 16], mass * links[k, 17], mass * links[k, 18], lanes)
    _shift(tip, 0, here, arm.ends[1, 0], arm.ends[1, 1], arm.ends[1, 2], lanes)


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
    turns = np.rint(angle * TURNS)
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
def _turn(here, links, k, lanes):
    """Turn frames by the rotation of link k."""
    for i in range(3):
        for c in range(len(lanes)):
            x, y, z = here[i, 0, c], here[i, 1, c], here[i, 2, c]
            here[i, 0, c] = x * links[k, 0] + y * links[k, 3] + z * links[k, 6]
            here[i, 1, c] = x * links[k, 1] + y * links[k, 4] + z * links[k, 7]
            here[i, 2, c] = x * links[k, 2] + y * links[k, 5] + z * links[k, 8]


@inner
def _swing(here, ax, ay, az, sine, less, lanes):
    """Turn frames about one of their axes, by the sines of angles and what their cosines are less than 1."""
    for i in range(3):
        for c in range(len(lanes)):
            x, y, z = here[i, 0, c], here[i, 1, c], here[i, 2, c]
            # A row of the frame times exp(axis): rows turn the other way about the axis.
            u, v, w = y * az - z * ay, z * ax - x * az, x * ay - y * ax
            here[i, 0, c] = x + sine[c] * u + less[c] * (v * az - w * ay)
            here[i, 1, c] = y + sine[c] * v + less[c] * (w * ax - u * az)
            here[i, 2, c] = z + sine[c] * w + less[c] * (u * ay - v * ax)


@inner
def _screw(room, k, c):
    """Return the screw of flexure k in lane c, linear and angular, with the exponential's coefficients and its turn."""
    turn, twists, i = room.turn, room.twists, 3 * k
    x, y, z = twists[k, 3, c], twists[k, 4, c], twists[k, 5, c]
    wx = turn[i, 0, c] * x + turn[i, 1, c] * y + turn[i, 2, c] * z
    wy = turn[i + 1, 0, c] * x + turn[i + 1, 1, c] * y + turn[i + 1, 2, c] * z
    wz = turn[i + 2, 0, c] * x + turn[i + 2, 1, c] * y + turn[i + 2, 2, c] * z
    s = x * x + y * y + z * z
    x, y, z = twists[k, 0, c], twists[k, 1, c], twists[k, 2, c]
    vx = turn[i, 0, c] * x + turn[i, 1, c] * y + turn[i, 2, c] * z
    vy = turn[i + 1, 0, c] * x + turn[i + 1, 1, c] * y + turn[i + 1, 2, c] * z
    vz = turn[i + 2, 0, c] * x + turn[i + 2, 1, c] * y + turn[i + 2, 2, c] * z
    px, py, pz = room.origin[k, 0, c], room.origin[k, 1, c], room.origin[k, 2, c]
    vx, vy, vz = vx - (wy * pz - wz * py), vy - (wz * px - wx * pz), vz - (wx * py - wy * px)
    second = 0.5 - s * (1 / 24 - s * (1 / 720 - s / 40320))
    third = 1 / 6 - s * (1 / 120 - s * (1 / 5040 - s / 362880))
    return vx, vy, vz, wx, wy, wz, second, third, s


@inner
def weigh(arm, room, bent, lanes):
    """Fill the loads on the flexures under the weight, where the twists bend them or nothing does."""
    moments, n = room.moments, len(arm.order)
    for i in range(3):
        for c in range(len(lanes)):
            room.pull[0, i, c] = arm.ends[0, i]
            for k in range(n):
                moments[k, i, c] = room.moment[k, i, c]
    for step in range(n - 1, 0, -1):
        k, before = arm.order[step], arm.order[step - 1]
        for i in range(3):
            for c in range(len(lanes)):
                moments[before, i, c] += moments[k, i, c]
        if bent:
            _carry(arm.outboard[k], room, k, before, lanes)
    for step in range(n):
        if bent:
            _lean(room, arm.order[step], lanes)
        _load(arm.outboard[arm.order[step]], room, arm.order[step], lanes)


@inner
def _carry(mass, room, k, before, lanes):
    """Add to the moments about the flexure before k how far k moves what is outboard of it."""
    for c in range(len(lanes)):
        x, y, z = room.moments[k, 0, c], room.moments[k, 1, c], room.moments[k, 2, c]
        vx, vy, vz, wx, wy, wz, b, t, _ = _screw(room, k, c)
        ux, uy, uz = mass * vx + wy * z - wz * y, mass * vy + wz * x - wx * z, mass * vz + wx * y - wy * x
        ox, oy, oz = wy * uz - wz * uy, wz * ux - wx * uz, wx * uy - wy * ux
        room.moments[before, 0, c] += ux + b * ox + t * (wy * oz - wz * oy)
        room.moments[before, 1, c] += uy + b * oy + t * (wz * ox - wx * oz)
        room.moments[before, 2, c] += uz + b * oz + t * (wx * oy - wy * ox)


@inner
def _lean(room, k, lanes):
    """Turn the weight's direction back by flexure k, instead of everything outboard of it forth."""
    for c in range(len(lanes)):
        x, y, z = room.pull[0, 0, c], room.pull[0, 1, c], room.pull[0, 2, c]
        _, _, _, wx, wy, wz, b, t, s = _screw(room, k, c)
        a = 1.0 - t * s
        ox, oy, oz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        room.pull[0, 0, c] = x + b * (wy * oz - wz * oy) - a * ox
        room.pull[0, 1, c] = y + b * (wz * ox - wx * oz) - a * oy
        room.pull[0, 2, c] = z + b * (wx * oy - wy * ox) - a * oz


@inner
def _load(mass, room, k, lanes):
    """Fill the loads on flexure k in its own axes."""
    for c in range(len(lanes)):
        x, y, z = room.pull[0, 0, c], room.pull[0, 1, c], room.pull[0, 2, c]
        rx = room.moments[k, 0, c] - mass * room.origin[k, 0, c]
        ry = room.moments[k, 1, c] - mass * room.origin[k, 1, c]
        rz = room.moments[k, 2, c] - mass * room.origin[k, 2, c]
        mx, my, mz = ry * z - rz * y, rz * x - rx * z, rx * y - ry * x
        x, y, z = mass * x, mass * y, mass * z
        for j in range(3):
            r0, r1, r2 = room.turn[3 * k, j, c], room.turn[3 * k + 1, j, c], room.turn[3 * k + 2, j, c]
            room.loads[k, j, c] = r0 * x + r1 * y + r2 * z
            room.loads[k, 3 + j, c] = r0 * mx + r1 * my + r2 * mz


@inner
def displace(arm, room, lanes):
    """Leave in `pull` how far the twists move the tip, and in `quaternion` how they turn it, real part first."""
    tip, shift, quaternion = room.tip, room.pull, room.quaternion
    for c in range(len(lanes)):
        shift[0, 0, c] = shift[0, 1, c] = shift[0, 2, c] = 0.0
        quaternion[0, c], quaternion[1, c], quaternion[2, c], quaternion[3, c] = 1.0, 0.0, 0.0, 0.0
    for step in range(len(arm.order) - 1, -1, -1):
        for c in range(len(lanes)):
            vx, vy, vz, wx, wy, wz, b, t, s = _screw(room, arm.order[step], c)
            x, y, z = tip[0, 0, c] + shift[0, 0, c], tip[0, 1, c] + shift[0, 1, c], tip[0, 2, c] + shift[0, 2, c]
            ux, uy, uz = vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x
            ox, oy, oz = wy * uz - wz * uy, wz * ux - wx * uz, wx * uy - wy * ux
            shift[0, 0, c] += ux + b * ox + t * (wy * oz - wz * oy)
            shift[0, 1, c] += uy + b * oy + t * (wz * ox - wx * oz)
            shift[0, 2, c] += uz + b * oz + t * (wx * oy - wy * ox)
            half = 0.5 - s * (1 / 48 - s * (1 / 3840 - s / 645120))
            a = 1.0 - s * (1 / 8 - s * (1 / 384 - s / 46080))
            wx, wy, wz = half * wx, half * wy, half * wz
            r, i, j, k = quaternion[0, c], quaternion[1, c], quaternion[2, c], quaternion[3, c]
            quaternion[0, c] = a * r - (wx * i + wy * j + wz * k)
            quaternion[1, c] = a * i + r * wx + wy * k - wz * j
            quaternion[2, c] = a * j + r * wy + wz * i - wx * k
            quaternion[3, c] = a * k + r * wz + wx * j - wy * i


@inner
def tell(room, c, displacement):
    """Fill the (6,) shift and rotation vector of a lane."""
    r, i, j, k = room.quaternion[0, c], room.quaternion[1, c], room.quaternion[2, c], room.quaternion[3, c]
    sine = math.sqrt(i * i + j * j + k * k)
    times = 2.0 if sine < 1e-8 else 2.0 * math.atan2(sine, r) / sine
    for a in range(3):
        displacement[a], displacement[3 + a] = room.pull[0, a, c], times * room.quaternion[1 + a, c]
