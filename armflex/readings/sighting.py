"""Where a camera and a board are, from their pictures alone: the closed forms that a fit begins from.

Each picture has a homography (Hartley 1997), all together the lens (Zhang 2000), each then the board's pose before the
camera, and with the poses of the arm the camera's mounting and the board's place (Shah 2013). Points off one plane have
no homography, their pose follows from the direct linear transformation. None of it weighs what it finds: that is the
fit's.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.readings.end import rigid_motion
from armflex.readings.lens import distorted

FEWEST = 4
"""Points of a picture, and pictures, without which there is no closed form."""

ROUNDS = 10
"""Of weights, by which a picture that another row's joints belong to counts little, and of steps of a pose."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """What a camera saw.

    Attributes:
        points: (C, 3) of the board [m].
        corners: (N, C, 2) where they were in each picture [px], not a number where they were not found.
        links: (N, 4, 4) pose of the link that the camera is on, in that of the board [m].
        image: (2,) width and height of a picture [px], None where they are not known.
    """

    points: Array
    corners: Array
    links: Array
    image: Array | None = None


Found = tuple[Array, Array, Array, Array, Array, Array]
"""(2,) focal lengths and (2,) centre [px], place (3,) [m] and rotation vector (3,) [rad] of the camera on its link, and
of the board on its own."""


def sighted(sight: Sighting, focal: Array | None, centre: Array | None, lens: Array) -> Found | None:
    """Return lens, mounting and board in closed form, None where too little of the board was seen.

    Focal lengths and centre are (2,) [px], None where they are not known, the distortion (5,).
    """
    given = [None if parameter is None else parameter.tobytes() for parameter in (focal, centre, sight.image)]
    boards = _boards(sight.points.tobytes(), sight.corners.tobytes(), lens.tobytes(), *given)
    if boards is None:
        return None
    focal, centre, rows, poses = boards
    return (focal, centre, *_hand_eye(sight.links[rows], poses))


@lru_cache(maxsize=16)
def _boards(
    points: bytes, corners: bytes, lens: bytes, focal: bytes | None, centre: bytes | None, image: bytes | None
) -> tuple[Array, Array, np.ndarray, Array] | None:
    """Return lens, numbers of the (M,) pictures that show enough, and the board before the camera in these (M, 4, 4).

    Arrays are given by their bytes: of the same pictures it is asked once, whatever the arm.
    """
    board, bent = np.frombuffer(points).reshape(-1, 3), np.frombuffer(lens)
    f, c, size = (None if raw is None else np.frombuffer(raw) for raw in (focal, centre, image))
    every = np.frombuffer(corners).reshape(-1, len(board), 2)
    flat = bool(np.ptp(board[:, 2]) < 1e-9)
    seen = np.all(np.isfinite(every), axis=2)
    rows = [i for i in range(len(seen)) if seen[i].sum() >= (FEWEST if flat else 6) and _spread(board[seen[i]])]
    if len(rows) < FEWEST:
        return None
    if c is None:
        c = 0.5 * (every[seen].min(axis=0) + every[seen].max(axis=0) if size is None else size)
    if f is None:
        f = _focal([_homography(board[seen[i], :2], every[i, seen[i]] - c) for i in rows]) if flat else None
        if f is None:
            return None
    poses = [pose_of(board[seen[i]], _ideal((every[i, seen[i]] - c) / f, bent)) for i in rows]
    return f, c, np.array(rows), np.array(poses)


def _spread(points: Array) -> bool:
    """Return whether points are off one line."""
    size = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(size[1] > 1e-3 * size[0])


def _ideal(bent: Array, lens: Array) -> Array:
    """Return (C, 2) x, y whose distorted ones are given, by Newton's steps."""
    ideal = bent.copy()
    for _ in range(ROUNDS if lens.any() else 0):
        there, change = distorted(ideal, np.broadcast_to(lens, (len(ideal), 5)))
        ideal = ideal + np.linalg.solve(change, (bent - there)[..., None])[..., 0]
    return ideal


def _homography(points: Array, pictures: Array) -> Array:
    """Return the (3, 3) homography from (C, 2) points of a plane to (C, 2) pictures, both normalised before."""
    scales = []
    for each in (points, pictures):
        middle = each.mean(axis=0)
        size = np.sqrt(2.0) / max(float(np.linalg.norm(each - middle, axis=1).mean()), 1e-12)
        scales.append(np.array([[size, 0.0, -size * middle[0]], [0.0, size, -size * middle[1]], [0.0, 0.0, 1.0]]))
    there, other = (np.column_stack([each, np.ones(len(each))]) @ scale.T
                  for each, scale in zip((points, pictures), scales, strict=True))  # fmt: skip
    zero = np.zeros_like(there)
    rows = np.vstack(
        [np.hstack([there, zero, -other[:, :1] * there]), np.hstack([zero, there, -other[:, 1:2] * there])]
    )
    homography = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    return np.linalg.solve(scales[1], homography) @ scales[0]


def _focal(homographies: list[Array]) -> Array | None:
    """Return (2,) one focal length for both axes that homographies about the centre agree on, None where none does.

    Two axes of a plane are square to each other and of one length: of h1 and h2, h1' w h2 = 0 and h1' w h1 = h2' w h2
    with w = diag(1/f^2, 1/f^2, 1). A board that faces the camera says nothing.
    """
    rows = []
    for homography in homographies:
        h1, h2 = (homography / np.linalg.norm(homography[:, :2])).T[:2]
        rows += [(h1[:2] @ h2[:2], -h1[2] * h2[2]), (h1[:2] @ h1[:2] - h2[:2] @ h2[:2], h2[2] ** 2 - h1[2] ** 2)]
    left, right = np.array(rows).T
    inverse = float(left @ right) / max(float(left @ left), 1e-300)
    for _ in range(ROUNDS):  # some pictures are poor
        off = np.abs(left * inverse - right)
        weights = 1.0 / np.maximum(off, np.median(off) + 1e-300)
        inverse = float((weights * left) @ right) / max(float((weights * left) @ left), 1e-300)
    return np.full(2, inverse**-0.5) if inverse > 0.0 else None


def pose_of(points: Array, pictures: Array) -> Array:
    """Return the (4, 4) pose of (C, 3) points before a camera that has them at (C, 2) x, y [m].

    A plane from its homography, else by the direct linear transformation; then steps of least squares.
    """
    pose = np.eye(4)
    if np.ptp(points[:, 2]) < 1e-9:
        plane = _homography(points[:, :2], pictures)
        plane /= np.sqrt(np.linalg.norm(plane[:, 0]) * np.linalg.norm(plane[:, 1]))
        plane *= np.sign((plane @ np.append(points[:, :2].mean(axis=0), 1.0))[2])
        axes, place = np.column_stack([plane[:, :2], np.cross(plane[:, 0], plane[:, 1])]), plane[:, 2]
        place = place - axes[:, 2] * points[0, 2]
    else:
        augmented, zero = np.column_stack([points, np.ones(len(points))]), np.zeros((len(points), 4))
        rows = [
            np.hstack([augmented, zero, -pictures[:, :1] * augmented]),
            np.hstack([zero, augmented, -pictures[:, 1:] * augmented]),
        ]
        whole = np.linalg.svd(np.vstack(rows))[2][-1].reshape(3, 4)
        whole *= np.sign(np.linalg.det(whole[:, :3]))
        whole /= np.cbrt(np.linalg.det(whole[:, :3]))
        axes, place = whole[:, :3], whole[:, 3]
    pose[:3, :3], pose[:3, 3] = _nearest(axes), place
    for _ in range(ROUNDS):
        there = points @ pose[:3, :3].T + pose[:3, 3]
        depth = there[:, 2:]
        if (depth <= 0.0).any():
            break
        flat = there[:, :2] / depth
        change = np.zeros((len(points), 2, 3))
        change[:, 0, 0], change[:, 1, 1], change[:, :, 2] = 1.0, 1.0, -flat
        rows = (change / depth[:, :, None] @ rigid_motion(there)).reshape(-1, 6)
        step = np.linalg.lstsq(rows, (pictures - flat).ravel(), rcond=None)[0]
        turn: Array = pin.exp3(np.asarray(step[3:], dtype=float))
        pose[:3, :3], pose[:3, 3] = turn @ pose[:3, :3], turn @ pose[:3, 3] + step[:3]
    return pose


def _nearest(turn: Array) -> Array:
    """Return the (3, 3) rotation nearest to a matrix."""
    left, _, right = np.linalg.svd(turn)
    return left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right


def _hand_eye(links: Array, boards: Array) -> tuple[Array, Array, Array, Array]:
    """Return place (3,) [m] and rotation vector (3,) [rad] of X and of Z in A X B = Z, weighed anew by what is left.

    A (N, 4, 4) is the link that the camera is on, in that of the board; B (N, 4, 4) the board before the camera [m].
    """
    weights, eye, board = np.ones(len(links)), np.eye(4), np.eye(4)
    for _ in range(ROUNDS):
        # vec(Z) = (B' x A) vec(X) for rotations: the largest singular pair of the sum (Shah 2013).
        total = np.einsum("n,nji,nkl->ikjl", weights, boards[:, :3, :3], links[:, :3, :3]).reshape(9, 9)
        left, _, right = np.linalg.svd(total)
        first, last = (turn.reshape(3, 3).T for turn in (right[0], left[:, 0]))
        sign = np.sign(np.linalg.det(first)) or 1.0
        eye[:3, :3], board[:3, :3] = _nearest(sign * first), _nearest(sign * last)
        rows = np.concatenate([links[:, :3, :3], np.tile(-np.eye(3), (len(links), 1, 1))], axis=2)
        right_side = -links[:, :3, 3] - np.einsum("nij,nj->ni", links[:, :3, :3] @ eye[:3, :3], boards[:, :3, 3])
        root = np.sqrt(weights)[:, None]
        shifts = np.linalg.lstsq((root[..., None] * rows).reshape(-1, 6), (root * right_side).ravel(), rcond=None)[0]
        eye[:3, 3], board[:3, 3] = shifts[:3], shifts[3:]
        off = np.linalg.norm(links @ eye @ boards - board, axis=(1, 2))
        weights = 1.0 / np.maximum(off, np.median(off) + 1e-12)
        weights /= weights.max()
    return eye[:3, 3], pin.log3(eye[:3, :3]), board[:3, 3], pin.log3(board[:3, :3])
