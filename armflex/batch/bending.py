"""Where the flexures of a chain are, what they carry, where its tip goes: numpy, the configurations last.

Pinocchio answers one configuration at a time. Here the last axis of every array is the configuration, so that numpy
works on many. Everything is written in the base's axes about the rigid arm: bending flexure k moves all that is
outboard of it by the screw `s_k = Ad(T_k) t_k`, with T_k the flexure's pose in the rigid arm, because

    J1 exp(t1) J2 exp(t2) ... = exp(s1) exp(s2) ... J1 J2 ...

A screw (v, w) moves a point x by `u + b w x u + c w x (w x u)` with `u = v + w x x`; b and c are the exponential's, as
series: they hold for turns up to 0.1 rad. `compiled` has the same functions in machine code.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from armflex.batch.chain import Chain, Straight
from armflex.conventions import Array

POSES = 2048
"""Configurations whose tip is placed at once."""


def straighten(chain: Chain, q: Array) -> Straight:
    """Return the rigid arm at (nq, N) joint positions."""
    many, n = q.shape[1], chain.flexures
    turn, origin, moment = np.empty((n, 3, 3, many)), np.empty((n, 3, many)), np.zeros((n, 3, many))
    here, at = np.zeros((3, 3, many)), np.zeros((3, many))
    here[0, 0] = here[1, 1] = here[2, 2] = 1.0
    sine, cosine = np.sin(q), np.cos(q)
    carrier = -1
    for one in chain.links:
        _shift(at, here, one.origin)
        here = here if one.rotation is None else np.matmul(one.rotation.T, here)
        if one.axis is None:
            carrier = one.place
            turn[carrier], origin[carrier] = here, at
        elif one.turns:
            here = _turned(here, one.axis, sine[one.place], cosine[one.place])
        else:
            at += np.einsum("j,ijn->in", one.axis, here) * q[one.place]
        if one.mass and carrier >= 0:
            moment[carrier] += one.mass * at
            _shift(moment[carrier], here, one.mass * one.lever)
    _shift(at, here, chain.tip_origin)
    return Straight(turn, origin, moment, at, np.matmul(chain.tip_rotation.T, here))


def _shift(at: Array, turn: Array, vector: Array) -> None:
    """Add a (3,) vector in turned axes to (3, N) points."""
    for j, part in enumerate(vector):
        if part:
            at += part * turn[:, j]


def _turned(turn: Array, axis: Array, sine: Array, cosine: Array) -> Array:
    """Return (3, 3, N) axes turned about one of theirs by the angles of (N,) sines and cosines."""
    main = int(np.abs(axis).argmax())
    if abs(axis[main]) != 1.0:
        return _turned_about(turn, axis, sine, cosine)
    second, third = (main + 1) % 3, (main + 2) % 3
    sine = axis[main] * sine
    found = np.empty_like(turn)
    found[:, main] = turn[:, main]
    found[:, second] = cosine * turn[:, second] + sine * turn[:, third]
    found[:, third] = cosine * turn[:, third] - sine * turn[:, second]
    return found


def _turned_about(turn: Array, axis: Array, sine: Array, cosine: Array) -> Array:
    skew = pin.skew(axis)
    once, twice = np.matmul(skew.T, turn), np.matmul((skew @ skew).T, turn)
    return turn + sine * once + (1.0 - cosine) * twice


def rotated(turn: Array, vectors: Array) -> Array:
    """Return (n, 3, N) vectors given in the axes of (n, 3, 3, N) frames, in base axes."""
    x, y, z = vectors[:, None, 0], vectors[:, None, 1], vectors[:, None, 2]
    return turn[:, :, 0] * x + turn[:, :, 1] * y + turn[:, :, 2] * z


def rotated_back(turn: Array, vectors: Array) -> Array:
    """Return (n, 3, N) vectors given in base axes, in the axes of (n, 3, 3, N) frames."""
    return turn[:, 0] * vectors[:, 0, None] + turn[:, 1] * vectors[:, 1, None] + turn[:, 2] * vectors[:, 2, None]


def cross(a: Array, b: Array) -> Array:
    """Return the (..., 3, N) product of vectors, one of which may be (3, 1)."""
    found = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[..., j, :], b[..., k, :], out=found[..., i, :])
        found[..., i, :] -= a[..., k, :] * b[..., j, :]
    return found


@dataclass(frozen=True, eq=False)
class Screws:
    """The flexures' twists as screws of the base, with the exponential's coefficients.

    Attributes:
        linear: (n, 3, N) velocity of the point that is at the base's origin.
        angular: (n, 3, N) turn [rad].
        second, third: (n, N) coefficients b and c.
        square: (n, N) squared turn [rad^2].
    """

    linear: Array
    angular: Array
    second: Array
    third: Array
    square: Array

    def motion(self, i: int, drift: Array) -> Array:
        """Return how far screw i takes (3, N) points whose velocities are `drift`."""
        once = cross(self.angular[i], drift)
        return drift + self.second[i] * once + self.third[i] * cross(self.angular[i], once)


def screws_of(straight: Straight, twists: Array) -> Screws:
    """Return the screws of (n, 6, N) local twists."""
    angular = rotated(straight.turn, twists[:, 3:])
    linear = rotated(straight.turn, twists[:, :3]) - cross(angular, straight.origin)
    square = twists[:, 3] ** 2 + twists[:, 4] ** 2 + twists[:, 5] ** 2
    return Screws(linear, angular, *coefficients(square), square)


def coefficients(square: Array) -> tuple[Array, Array]:
    """Return the exponential's b and c for squared turns [rad^2]: (1 - cos x) / x^2 and (x - sin x) / x^3."""
    second = 0.5 - square * (1 / 24 - square * (1 / 720 - square / 40320))
    return second, 1 / 6 - square * (1 / 120 - square * (1 / 5040 - square / 362880))


def weigh(chain: Chain, straight: Straight, twists: Array | None = None) -> Array:
    """Return the (n, 6, N) loads on the flexures in their own axes under the weight, bent by (n, 6, N) twists."""
    screws = None if twists is None else screws_of(straight, twists)
    n, _, many = straight.origin.shape
    down, moments = np.empty((n, 3, many)), straight.moment.copy()
    order, mass = chain.order, chain.outboard
    for inner, outer in zip(order[-2::-1], order[:0:-1], strict=True):
        moments[inner] += moments[outer]
        if screws is not None:
            drift = mass[outer] * screws.linear[outer] + cross(screws.angular[outer], moments[outer])
            moments[inner] += screws.motion(outer, drift)
    pull = np.broadcast_to(chain.gravity[:, None], (3, many))
    for i in order:
        if screws is not None:
            once = cross(screws.angular[i], pull)
            sine = 1.0 - screws.third[i] * screws.square[i]
            pull = pull - sine * once + screws.second[i] * cross(screws.angular[i], once)
        down[i] = pull
    loads = np.empty((n, 6, many))
    loads[:, :3] = rotated_back(straight.turn, mass[:, None, None] * down)
    loads[:, 3:] = rotated_back(straight.turn, cross(moments - mass[:, None, None] * straight.origin, down))
    return loads


def displace(chain: Chain, straight: Straight, twists: Array) -> Array:
    """Return the (6, N) displacement of the tip by (n, 6, N) twists: shift [m], rotation vector [rad], base axes."""
    screws = screws_of(straight, twists)
    shift, turn = np.zeros_like(straight.tip), None
    half = 0.5 - screws.square * (1 / 48 - screws.square * (1 / 3840 - screws.square / 645120))
    whole = 1.0 - screws.square * (1 / 8 - screws.square * (1 / 384 - screws.square / 46080))
    for i in reversed(chain.order):
        drift = screws.linear[i] + cross(screws.angular[i], straight.tip + shift)
        shift = shift + screws.motion(i, drift)
        here = (whole[i], half[i] * screws.angular[i])
        turn = here if turn is None else _joined(here, turn)
    rotation = np.zeros_like(shift) if turn is None else rotation_vectors(*turn)
    return np.concatenate([shift, rotation])


def _joined(first: tuple[Array, Array], second: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the product of two quaternions, (N,) real and (3, N) imaginary parts."""
    (a, v), (b, w) = first, second
    return a * b - (v[0] * w[0] + v[1] * w[1] + v[2] * w[2]), a * w + b * v + cross(v, w)


def rotation_vectors(real: Array, imaginary: Array) -> Array:
    """Return the (3, N) rotation vectors of quaternions."""
    sine = np.sqrt(imaginary[0] ** 2 + imaginary[1] ** 2 + imaginary[2] ** 2)
    small = sine < 1e-8
    return imaginary * np.where(small, 2.0, 2.0 * np.arctan2(sine, real) / np.where(small, 1.0, sine))


def tip_poses(chain: Chain, q: Array) -> Array:
    """Return the (N, 4, 4) poses of the rigid arm's tip at (N, nq) joint positions."""
    found = np.zeros((len(q), 4, 4))
    found[:, 3, 3] = 1.0
    for start in range(0, len(q), POSES):
        some = slice(start, start + POSES)
        straight = straighten(chain, np.ascontiguousarray(q[some].T))
        found[some, :3, :3] = np.moveaxis(straight.tip_turn, -1, 0)
        found[some, :3, 3] = straight.tip.T
    return found


def from_elsewhere(displacements: Array, before: Array, after: Array) -> Array:
    """Return the (N, 6) displacements from (N, 4, 4) poses `after` of what was displaced from poses `before`."""
    found = np.empty_like(displacements)
    found[:, :3] = displacements[:, :3] + before[:, :3, 3] - after[:, :3, 3]
    turned = turned_by(displacements[:, 3:], before[:, :3, :3]) @ np.swapaxes(after[:, :3, :3], 1, 2)
    found[:, 3:] = turns_of(turned)
    return found


def turns_of(matrices: Array) -> Array:
    """Return the (N, 3) rotation vectors of (N, 3, 3) rotations by less than half a turn."""
    skew = matrices - np.swapaxes(matrices, 1, 2)
    axes = 0.5 * np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    sine = np.linalg.norm(axes, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(matrices, axis1=1, axis2=2) - 1.0))
    return axes * np.where(sine < 1e-8, 1.0, angle / np.where(sine < 1e-8, 1.0, sine))[:, None]


def turned_by(vectors: Array, matrices: Array) -> Array:
    """Return (N, 3, 3) orientations turned by (N, 3) rotation vectors in base axes."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = vectors.T
    skew = np.moveaxis(np.array([[0.0 * x, -z, y], [z, 0.0 * x, -x], [-y, x, 0.0 * x]]), -1, 0)
    once = skew @ matrices
    half = np.sinc(0.5 * angle / np.pi)
    return matrices + np.sinc(angle / np.pi) * once + 0.5 * half * half * (skew @ once)
