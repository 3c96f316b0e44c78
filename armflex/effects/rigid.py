"""Small rigid motions of many points at once."""

from __future__ import annotations

import numpy as np

from armflex.conventions import Array


def cross_matrices(vectors: Array) -> Array:
    """Return the (N, 3, 3) matrices of v x for (N, 3) vectors."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)


def rigid_motion(points: Array, size: int) -> Array:
    """Return (M, d, 6) changes of the readings per shift and rotation vector of the instrument frame."""
    columns = np.zeros((len(points), size, 6))
    columns[:, :3, :3] = np.eye(3)
    columns[:, :3, 3:] = -cross_matrices(points)
    if size == 6:
        columns[:, 3:, 3:] = np.eye(3)
    return columns


def cross(one: Array, other: Array) -> Array:
    """Return (..., 3) cross products; for single vectors a quarter of numpy's time."""
    (a, b, c), (x, y, z) = ([part[..., i] for i in range(3)] for part in (one, other))
    first = np.asarray(b * z - c * y)
    found = np.empty((*first.shape, 3))
    found[..., 0], found[..., 1], found[..., 2] = first, c * x - a * z, a * y - b * x
    return found
