"""How far off the points of the rigid arm are, its instrument and target placed, in many conventions at once.

The arm bends as it does in the campaign as written, whose displacements are kept: what one that bends otherwise shows
is judged later, by `misread`, and of the few conventions alone that bring the points nearest to their places.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from armflex.arm import Arm
from armflex.conventions import RESOLUTION, Array
from armflex.errors import FEW
from armflex.estimate.robust import ROWS_AT_ONCE, TAILS
from armflex.mechanics.loop_rows import rigid_tips
from armflex.mechanics.many_rows import rotations
from armflex.readings.end import rigid_motion
from armflex.readings.instrument import Instrument, middle_length, rigid_fit

FINE_SHARE = 3e-5
"""Prior: part of the reach, of a radian and of g that an arm may be off by before conventions are thought of."""


@dataclass(frozen=True, eq=False)
class PlacedPoints:
    """What is left (..., M, 3) [m] of where an arm was seen, its shift (..., k, 3) per column beside the joints, and
    its base's (..., 3, 3) turn.
    """

    left: Array
    beside: Array
    turn: Array


@dataclass(frozen=True, eq=False)
class SeenRows:
    """Rows in which the tip was seen, and the rigid arm that is placed in them.

    Attributes:
        arm: The arm as declared.
        q: (M, nq) positions as read [rad or m].
        at: (M, 3) where the target was seen [m].
        rows: (M,) numbers of the rows in the campaign.
        bent: (M, 3) how far the tip is from that of the rigid arm in the campaign as written, base axes [m].
        tip: (M, 4, 4) its poses as written, so bent [m].
    """

    arm: Arm
    q: Array
    at: Array
    rows: np.ndarray
    bent: Array
    tip: Array

    def some(self, rows: np.ndarray) -> SeenRows:
        """Return (m,) of the rows."""
        arrays = (self.q, self.at, self.rows, self.bent, self.tip)
        return SeenRows(self.arm, *(array[rows] for array in arrays))

    def tips(self, q: Array, arm: Arm | None = None) -> Array:
        """Return the (..., 4, 4) poses of the tip [m], bent as it is, at (..., nq) positions [rad or m]."""
        tips = rigid_tips((arm or self.arm).loaded(None), q.reshape(-1, q.shape[-1])).reshape(*q.shape[:-1], 4, 4)
        tips[..., :3, 3] += self.bent
        return tips

    def placed(self, q: Array, beside: Array | None = None) -> PlacedPoints:
        """Return the arm placed at (..., M, nq) positions, its target found, with columns (M, k) that shift it."""
        stacked = q.reshape(-1, *self.q.shape)
        seen = np.broadcast_to(self.at, (*stacked.shape[:2], 3))
        placed = self.placed_tips(self.tips(stacked), seen, beside)
        return PlacedPoints(*(part.reshape(*q.shape[:-2], *part.shape[1:]) for part in placed))

    def placed_tips(
        self, tips: Array, seen: Array, beside: Array | None = None, unknown: bool | None = None
    ) -> Iterator[Array]:
        """Return what `PlacedPoints` has, of H conventions.

        Args:
            tips: (H, M, 4, 4) poses of the tip in the base [m].
            seen: (H, M, 3) where its target was seen [m].
            beside: (M, k) columns that shift the arm, if any do.
            unknown: Whether the instrument may stand anywhere; where not given as the arm has it.
        """
        unknown = self.arm.measurement.frame != "base" if unknown is None else unknown
        beside = np.zeros((tips.shape[1], 0)) if beside is None else beside
        pieces = np.array_split(np.arange(len(tips)), max(1, tips[..., 0, 0].size // ROWS_AT_ONCE))
        parts = [self._placed(tips[piece], seen[piece], beside, unknown) for piece in pieces]
        return map(np.concatenate, zip(*parts, strict=True))

    def _placed(self, tips: Array, seen: Array, beside: Array, unknown: bool) -> tuple[Array, Array, Array]:
        """Return the same of some: Gauss and Newton's steps from a rigid fit, lost beams weighed down."""
        fixed, (count, size) = self.arm.instrument or Instrument(), seen.shape[:2]
        axes = tips[..., :3, :3]
        here = tips[..., :3, 3] + axes @ fixed.target
        columns = np.column_stack([beside, np.ones(size)]) if unknown else beside
        across, through = columns @ np.linalg.pinv(columns), columns.shape[1]
        turn = np.broadcast_to(fixed.pose.rotation, (count, 3, 3))
        if unknown:
            turn = rigid_fit(here - across @ here, seen - across @ seen)[0]
        else:
            seen = seen - fixed.pose.translation
        shifting = np.einsum("mk,ij->mikj", columns, np.eye(3)).reshape(size, 3, -1)
        weights, target, left = np.ones((count, size)), np.zeros((count, 3)), seen
        shifts = np.zeros((count, through, 3))
        for _ in range(FEW):
            there = (here + (axes @ target[:, None, :, None])[..., 0]) @ turn.swapaxes(1, 2)
            jacobian = [rigid_motion(there.reshape(-1, 3)).reshape(count, size, 3, 6)[..., 3:]] if unknown else []
            jacobian += [np.broadcast_to(shifting, (count, *shifting.shape)), turn[:, None] @ axes]
            flat, left = np.concatenate(jacobian, axis=3).reshape(count, 3 * size, -1), seen - there
            precision, start = np.full((count, flat.shape[2]), RESOLUTION), np.zeros((count, flat.shape[2]))
            noise = np.maximum(middle_length(((left - across @ left) ** 2).sum(axis=2)), RESOLUTION)
            precision[:, -3:] = noise[:, None] / (self.arm.prior.tool or RESOLUTION) ** 2
            start[:, -3:] = target
            weighted = (flat * np.repeat(weights, 3, axis=1)[..., None]).swapaxes(1, 2)
            score = weighted @ left.reshape(count, -1, 1) - (precision * start)[..., None]
            information = weighted @ flat + precision[:, None] * np.eye(flat.shape[2])
            step = (np.linalg.pinv(information, hermitian=True) @ score)[..., 0]
            left = left - (flat @ step[..., None]).reshape(left.shape)
            turn, target = (rotations(step[:, :3]) @ turn if unknown else turn), target + step[:, -3:]
            shifts = step[:, 3 * unknown : 3 * (unknown + through)].reshape(count, through, 3)
            length = np.linalg.norm(left, axis=2)
            weights = np.minimum(1.0, 2.0 * middle_length(length)[:, None] / np.maximum(length, RESOLUTION))
        return left, shifts[:, : through - unknown], turn

    def nearer(self, there: Array, at: Array) -> np.ndarray:
        """Return (M,) which points are nearer to their places in another convention, the instrument placed by the rest.

        Args:
            there: (M, 4, 4) poses of the tip in it [m].
            at: (M, 3) where the target was seen then [m].
        """
        fixed, unknown = self.arm.instrument or Instrument(), self.arm.measurement.frame != "base"
        here, there = (tips[:, :3, 3] + tips[:, :3, :3] @ fixed.target for tips in (self.tip, there))
        so = np.zeros(len(there), dtype=bool)
        turn, shift = fixed.pose.rotation, fixed.pose.translation
        for _ in range(FEW):
            if unknown:
                turn, shift, _ = rigid_fit(np.where(so[:, None], there, here), np.where(so[:, None], at, self.at))
            last, off = so, [((b - a @ turn.T - shift) ** 2).sum(axis=1) for a, b in ((there, at), (here, self.at))]
            so = 4.0 * off[0] < off[1]
            if np.array_equal(so, last):
                break
        return so

    def cost(self, left: Array) -> Array:
        """Return minus the logarithm of the density of (..., M, 3) what is left [m], at its own scatter; see `misread`.

        It is of one reading, the mean over them.
        """
        off = (left**2).sum(axis=-1)
        least = np.maximum(middle_length(off) / 3.0, (FINE_SHARE * self.arm.robot.reach) ** 2)
        return 0.5 * (TAILS + 3.0) * np.log1p(off / least[..., None] / TAILS).mean(axis=-1) + 1.5 * np.log(least)
