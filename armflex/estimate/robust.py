"""Whitened residuals, and how little a lost beam among them counts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.view import View
from armflex.readings.chance import median_length, outlier_limit


def whitened_columns(blocks: Sequence[Block], view: View, weights: Array) -> Array:
    """Return (M d, P) columns of all blocks, whitened and weighted."""
    size = view.residual.size
    scale = (np.sqrt(weights)[:, None] / view.sigma)[:, :, None]
    parts = [(block.columns(view) * scale).reshape(size, -1) for block in blocks]
    return np.hstack([np.zeros((size, 0)), *parts])


def whitened_residual(view: View, weights: Array) -> Array:
    """Return (M d,) residuals, whitened and weighted."""
    return (np.sqrt(weights)[:, None] * view.whitened).ravel()


def robust_limit(view: View) -> float:
    """Return how many times what noise could make a row must be off to count less: 1, more while the model is wrong.

    While it is wrong all residuals are long; what is far is then judged by their median, not by the noise.
    """
    expected = np.array([median_length(size) for size in _sizes(view)])
    return max(1.0, float(np.median(np.linalg.norm(view.whitened, axis=1) / expected)))


def huber_weights(view: View, limit: float | None = None) -> Array:
    """Return the (M,) weights of the rows."""
    length = np.linalg.norm(view.whitened, axis=1)
    return np.minimum(1.0, (limit or robust_limit(view)) * _far(view) / np.maximum(length, 1e-300))


def objective(view: View, values: Array, prior: Array, limit: float) -> float:
    """Return the Huber cost plus the prior's, both as -2 log density."""
    length, far = np.linalg.norm(view.whitened, axis=1), limit * _far(view)
    cost = np.where(length > far, 2.0 * far * length - far**2, length**2).sum()
    return float(cost + ((values / prior) ** 2).sum())


def _far(view: View) -> Array:
    return np.array([outlier_limit(size) for size in _sizes(view)])


def _sizes(view: View) -> list[int]:
    """Return how many numbers every row has: an orientation that was not read is as uncertain as can be."""
    return np.isfinite(view.sigma).sum(axis=1).tolist()
