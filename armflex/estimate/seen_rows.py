"""How far off the points of the rigid arm are, its instrument and target placed, in many conventions at once.

The arm bends as it does in the campaign as written, whose displacements are kept: what one that bends otherwise shows
is judged later, by `misread`, and of the few conventions alone that bring the points nearest to their places.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from armflex.arm import Arm
from armflex.conventions import RESOLUTION, Array
from armflex.errors import FEW
from armflex.estimate.robust import ROWS_AT_ONCE, TAILS, outlier_limit
from armflex.mechanics.loop_rows import rigid_tips
from armflex.mechanics.many_rows import rotations
from armflex.readings.end import rigid_motion
from armflex.readings.instrument import SAME, Instrument, middle_length, rigid_fit

FINE_SHARE = 3e-5
"""Prior: part of the reach, of a radian and of g that an arm may be off by before conventions are thought of."""


@dataclass(frozen=True, eq=False)
class PlacedTarget:
    """A target and the frames in which it was seen, H times placed in G sessions of M points.

    Attributes:
        left: (H, G, M, 3) what is left of where it was seen [m].
        shifts: (H, G, k, 3) shift per column beside the frames.
        turn: (H, G, 3, 3) of the base in the instrument.
        target: (H, 3) how far it is from where it is declared, tip axes [m].
        moved: (H,) whether that is most of what frames leave, beyond chance: little of it does not mislead them.
    """

    left: Array
    shifts: Array
    turn: Array
    target: Array
    moved: np.ndarray


def place_target(
    points: Array,
    axes: Array,
    seen: Array,
    std: float,
    counted: np.ndarray | None = None,
    columns: Array | None = None,
    turn: Array | None = None,
    rounds: int = FEW,
) -> PlacedTarget:
    """Return a target with its frames placed where they leave least of where it was seen, lost beams weighed down.

    Gauss and Newton's steps, the frames projected out of them (Golub and Pereyra 1973), from a rigid fit.

    Args:
        points, axes: (H, G, M, 3) the target [m] and (H, G, M, 3, 3) the tip's axes, in the base.
        seen: (H, G, M, 3) where it was seen [m].
        std: One standard deviation of the target, each tip axis [m].
        counted: (G, M) whether a point is there, all where not given.
        columns: (M, k) columns that shift the arm, their mean zero.
        turn: (3, 3) of the base in an instrument that stands at the origin; it stands anywhere where not given.
        rounds: Steps at most.
    """
    shape, unknown = seen.shape[:3], turn is None
    counted = np.broadcast_to(True if counted is None else counted, shape)
    columns = np.zeros((shape[2], 0)) if columns is None else columns
    across, count = columns @ np.linalg.pinv(columns), columns.shape[1]
    nominal, off = points - across @ points, seen - across @ seen
    if turn is None:
        turn, shift, _ = rigid_fit(nominal, off, counted)
        off = off - shift[..., None, :]
        columns = np.column_stack([columns, np.ones(shape[2])])
    turn = np.broadcast_to(turn, (*shape[:2], 3, 3))
    left, target = off - nominal @ turn.swapaxes(2, 3), np.zeros((shape[0], 3))
    shifting = np.einsum("mk,ij->mikj", columns, np.eye(3)).reshape(shape[2], 3, -1)
    first = squares = np.full(shape[0], np.inf)
    for number in range(rounds):
        length = np.linalg.norm(left, axis=3)
        limit = 2.0 * np.maximum(middle_length(length, counted), RESOLUTION)[..., None]
        weights = np.where(counted, np.minimum(1.0, limit / np.maximum(length, RESOLUTION)), 0.0)[..., None, None]
        there = (points + (axes @ target[:, None, None, :, None])[..., 0]) @ turn.swapaxes(2, 3)
        turning = rigid_motion(there.reshape(-1, 3)).reshape(*shape, 3, 6)[..., 3 : 6 if unknown else 3]
        frames = np.concatenate([turning, np.broadcast_to(shifting, (*shape, *shifting.shape[1:]))], axis=4)
        weighted = (weights * frames).reshape(*shape[:2], 3 * shape[2], -1)
        left, moving = seen - there, turn[:, :, None] @ axes
        both = (weights * np.concatenate([moving, left[..., None]], axis=4)).reshape(*shape[:2], -1, 4)
        across = weighted.swapaxes(2, 3)
        solving = np.linalg.pinv(across @ weighted + RESOLUTION * np.eye(weighted.shape[3]), hermitian=True) @ across
        column, error = np.split((both - weighted @ (solving @ both)).reshape(shape[0], -1, 4), [3], axis=2)
        squares = (error**2).sum(axis=(1, 2))
        first = squares if number == 0 else first
        noise = np.maximum(squares / (3.0 * counted.sum(axis=(1, 2))), RESOLUTION**2)[:, None] / std**2
        information = column.swapaxes(1, 2) @ column + noise[..., None] * np.eye(3)
        step = np.linalg.solve(information, column.swapaxes(1, 2) @ error - (noise * target)[..., None])
        frame = solving @ (both[..., 3:] - both[..., :3] @ step[:, None])
        left = left - (moving @ step[:, None, None] + frames @ frame[:, :, None])[..., 0]
        target = target + step[..., 0]
        turn = rotations(frame[..., :3, 0].reshape(-1, 3)).reshape(turn.shape) @ turn if unknown else turn
        if np.linalg.norm(step) < SAME * std:
            break
    shifts = frame[..., 3 * unknown : 3 * (unknown + count), 0].reshape(*shape[:2], count, 3)
    return PlacedTarget(left, shifts, turn, target, outlier_limit(1) ** 2 * squares < first)


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

    def placed(self, q: Array, beside: Array | None = None) -> PlacedTarget:
        """Return the arm placed at (H, M, nq) positions [rad or m], with columns (M, k) that shift it, if any do."""
        return self.placed_tips(self.tips(q), np.broadcast_to(self.at, (*q.shape[:2], 3)), beside)

    def placed_tips(
        self, tips: Array, seen: Array, beside: Array | None = None, unknown: bool | None = None
    ) -> PlacedTarget:
        """Return the same by (H, M, 4, 4) poses of the tip and (H, M, 3) where its target was seen [m].

        `unknown` is whether the instrument may stand anywhere; where it is not given as the arm has it.
        """
        fixed, std = self.arm.instrument or Instrument(), self.arm.prior.tool or RESOLUTION
        unknown = self.arm.measurement.frame != "base" if unknown is None else unknown
        turn, seen = (None, seen) if unknown else (fixed.pose.rotation, seen - fixed.pose.translation)
        pieces = np.array_split(np.arange(len(tips)), max(1, tips[..., 0, 0].size // ROWS_AT_ONCE))

        def placed(piece: np.ndarray) -> PlacedTarget:
            axes = tips[piece, None, :, :3, :3]
            points = tips[piece, None, :, :3, 3] + axes @ fixed.target
            return place_target(points, axes, seen[piece, None], std, columns=beside, turn=turn)

        parts = [placed(piece) for piece in pieces]
        return PlacedTarget(
            *(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(PlacedTarget))
        )

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
