"""Whitened residuals, and how little a lost beam among them counts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.view import View
from armflex.parallel import in_threads
from armflex.readings.chance import median_length, outlier_limit

TOGETHER = 2048
"""Rows whose columns are made together: what they are made of takes some ten times their own memory."""


def whitened_regressors(blocks: Sequence[Block], view: View, weights: Array) -> Array:
    """Return (M d, P) columns of all blocks, whitened and weighted."""
    ends = np.cumsum([0, *(len(block.parameters) for block in blocks)])
    scale = np.sqrt(weights)[:, None] / view.sigma
    regressors = np.empty((*view.residual.shape, ends[-1]))
    placed = [(block, slice(*pair)) for block, pair in zip(blocks, pairwise(ends.tolist()), strict=True)]
    pieces = [np.arange(len(scale))[i : i + TOGETHER] for i in range(0, len(scale), TOGETHER)]
    local = [(block, place) for block, place in placed if block.by_row or len(pieces) < 2]

    def fill(some: np.ndarray) -> None:
        part = view if len(pieces) == 1 else view.some(some)
        for block, place in local:
            np.multiply(block.jacobian(part), scale[some, :, None], out=regressors[some[0] : some[-1] + 1, :, place])

    for _ in in_threads(fill, pieces):
        pass
    for block, place in placed:
        if (block, place) not in local:
            regressors[:, :, place] = block.jacobian(view) * scale[:, :, None]
    return regressors.reshape(view.residual.size, ends[-1])


def whitened_residual(view: View, weights: Array) -> Array:
    """Return (M d,) residuals, whitened and weighted."""
    return (np.sqrt(weights)[:, None] * view.whitened).ravel()


def robust_limit(view: View) -> float:
    """Return how many times what noise could make a row must be off to count less: 1, more while the model is wrong.

    While it is wrong all residuals are long; what is far is then judged by their median, not by the noise.
    """
    expected = _by_size(view, median_length)
    return max(1.0, float(np.median(np.linalg.norm(view.whitened, axis=1) / expected)))


def huber_weights(view: View, limit: float | None = None) -> Array:
    """Return the (M,) weights of the rows."""
    length = np.linalg.norm(view.whitened, axis=1)
    far = (limit or robust_limit(view)) * _by_size(view, outlier_limit)
    return np.minimum(1.0, far / np.maximum(length, 1e-300))


def objective(view: View, values: Array, prior: Array, limit: float) -> float:
    """Return the Huber cost plus the prior's, both as -2 log density."""
    length, far = np.linalg.norm(view.whitened, axis=1), limit * _by_size(view, outlier_limit)
    cost = np.where(length > far, 2.0 * far * length - far**2, length**2).sum()
    return float(cost + ((values / prior) ** 2).sum())


def _by_size(view: View, length: Callable[[int], float]) -> Array:
    """Return (M,) lengths by how many numbers a row has: an orientation that was not read is as uncertain as can be."""
    sizes, place = np.unique(np.isfinite(view.sigma).sum(axis=1), return_inverse=True)
    return np.array([length(size) for size in sizes.tolist()])[place]
