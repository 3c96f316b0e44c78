"""How the tip answers to the flexures of many bent arms under their own weight: shares, and the gains of a covariance.

Rows come first here, (N, n, ...), flexures in the order of the chain, and everything is in base axes where it is not
said to be local. A flexure's own motion is a turn w and a shift of its frame; it moves what is outboard of it as one
body. What that does to the loads, in the axes of the flexures that carry them:

    on itself and outboard   the weight's direction turns back by w
    inboard                  the first moment c of what it moves becomes c + m shift + w x (c - m p)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.batch.bending import coefficients, straighten, turned_by
from armflex.batch.chain import Chain
from armflex.conventions import Array
from armflex.laws import Law, LinearLaw, PositionDependentLaw, Row

TERMS = 9
"""Of the exponential's derivative: flexures turn by 0.1 rad at most."""
STEPS, NEAR = 60, 1e-13


@dataclass(frozen=True, eq=False)
class Bent:
    """N bent arms with n flexures.

    Attributes:
        turn: (N, n, 3, 3) frames just outboard of the flexures.
        mass: (n,) outboard of each [kg].
        arm: (N, n, 3) its first moment about the flexure [kg m].
        gravity: (3,) [m/s^2].
        jacobian: (N, n, 6, 6) change of the tip (origin, rotation) per change of the flexures' local twists.
        derivative: (N, n, 6, 6) body motion per change of them: exp6's right Jacobian.
        twists: (N, n, 6) local.
    """

    turn: Array
    mass: Array
    arm: Array
    gravity: Array
    jacobian: Array
    derivative: Array
    twists: Array

    def contributions(self) -> Array:
        """Return the (N, n, 6) displacement of the tip by each flexure, to first order."""
        return np.einsum("nkij,nkj->nki", self.jacobian, self.twists)

    def covariance(self, compliance: Array, uncertain: Array) -> tuple[Array, np.ndarray]:
        """Return the (N, 6, 6) covariance of the displacement, and (N,) whether it was found.

        Args:
            compliance, uncertain: (N, n, 6, 6) tangents and covariances of the laws.
        """
        gains, near = self.gains(compliance)
        return (gains @ uncertain @ np.swapaxes(gains, -1, -2)).sum(axis=1), near

    def gains(self, compliance: Array) -> tuple[Array, np.ndarray]:
        """Return (N, n, 6, 6) of the tip's motion per change of the laws' twists, what follows from it included.

        It is `jacobian (I + C dloads/dtwists)^-1`, by its series; and (N,) where the series came to an end.
        """
        found, largest = self.jacobian, np.abs(self.jacobian).max(axis=(1, 2, 3), initial=0.0)
        for _ in range(STEPS):
            before, found = found, self.jacobian + self._answer(found @ compliance)
            near = np.abs(found - before).max(axis=(1, 2, 3), initial=0.0) <= NEAR * largest
            if near.all():
                break
        return found, near

    def _answer(self, weights: Array) -> Array:
        """Return the change of weighted sums of the loads per change of the twists, both (N, n, 6, 6) and local."""
        mass, arm, gravity = self.mass[:, None, None], self.arm[:, :, None], self.gravity
        back = np.swapaxes(self.turn, -1, -2)
        force, moment = weights[..., :3] @ back, weights[..., 3:] @ back
        turned = np.cumsum((mass * force + np.cross(moment, arm))[:, ::-1], axis=1)[:, ::-1]
        shifted = np.cross(gravity, np.cumsum(moment, axis=1) - moment)
        motion = np.empty_like(weights)
        motion[..., :3] = mass * shifted @ self.turn
        motion[..., 3:] = (np.cross(turned, gravity) + np.cross(arm, shifted)) @ self.turn
        return motion @ self.derivative


def covariances(law: Law, loads: Array, row: Row) -> Array | None:
    """Return the (N, 6, 6) covariances of a law's twists under (N, 6) loads, None where it carries none."""
    if isinstance(law, LinearLaw | PositionDependentLaw) and getattr(law, "fit", None) is None:
        return law.covariance(loads, row)
    found = [law.covariance(load, row.some(i)) for i, load in enumerate(loads)]
    return None if any(part is None for part in found) else np.array(found).reshape(-1, 6, 6)


def bend(chain: Chain, q: Array, twists: Array) -> Bent:
    """Return the arm at (N, nq) positions with its flexures' (N, n, 6) twists, numbered as the chain's flexures are."""
    order, straight = list(chain.order), straighten(chain, np.ascontiguousarray(q.T))
    turn, origin, moment = (
        np.moveaxis(part[order], -1, 0) for part in (straight.turn, straight.origin, straight.moment)
    )
    mass, twists = chain.outboard[order], twists[:, order]
    own = mass - np.append(mass[1:], 0.0)
    # What the flexures so far make of a point x of the rigid arm: whole x + shift.
    whole, shift = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
    frames, origins, moments = np.empty_like(turn), np.empty_like(origin), np.empty_like(moment)
    for k in range(len(order)):
        before = whole @ turn[:, k]
        origins[:, k] = _times(whole, origin[:, k]) + shift + _times(before, _shifts(twists[:, k]))
        frames[:, k] = before @ turned_by(twists[:, k, 3:], np.broadcast_to(np.eye(3), before.shape))
        whole = frames[:, k] @ np.swapaxes(turn[:, k], -1, -2)
        shift = origins[:, k] - _times(whole, origin[:, k])
        moments[:, k] = _times(whole, moment[:, k]) + own[k] * shift
    tip = _times(whole, straight.tip.T) + shift
    arm = np.cumsum(moments[:, ::-1], axis=1)[:, ::-1] - mass[:, None] * origins
    derivative = right_jacobian(twists)
    jacobian = _carried(frames, tip[:, None] - origins) @ derivative
    return Bent(frames, mass, arm, chain.gravity, jacobian, derivative, twists)


def _times(matrices: Array, vectors: Array) -> Array:
    return (matrices @ vectors[..., None])[..., 0]


def _shifts(twists: Array) -> Array:
    """Return the (N, 3) translations of the exponentials of (N, 6) twists."""
    once = np.cross(twists[:, 3:], twists[:, :3])
    square = (twists[:, 3:] ** 2).sum(axis=1, keepdims=True)
    second, third = coefficients(square)
    return twists[:, :3] + second * once + third * np.cross(twists[:, 3:], once)


def _carried(frames: Array, levers: Array) -> Array:
    """Return (..., 6, 6) motion of points at (..., 3) levers from frames, base axes, per body motion of the frames."""
    found = np.zeros((*levers.shape[:-1], 6, 6))
    found[..., :3, :3] = found[..., 3:, 3:] = frames
    found[..., :3, 3:] = np.swapaxes(np.cross(np.swapaxes(frames, -1, -2), levers[..., None, :]), -1, -2)
    return found


def right_jacobian(twists: Array) -> Array:
    """Return the (..., 6, 6) body motion per change of (..., 6) exponential coordinates, by its series."""
    turning = np.zeros((*twists.shape, 6))
    turning[..., :3, :3] = turning[..., 3:, 3:] = _skew(twists[..., 3:])
    turning[..., :3, 3:] = _skew(twists[..., :3])
    found = unit = np.broadcast_to(np.eye(6), turning.shape)
    for k in range(TERMS, 1, -1):
        found = unit - turning @ found / k
    return found


def _skew(vectors: Array) -> Array:
    return np.swapaxes(np.cross(vectors[..., None, :], np.eye(3)), -1, -2)
