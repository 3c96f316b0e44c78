"""Whitened residuals, and how little a lost beam among them counts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armflex.calibrate.blocks import Block
from armflex.calibrate.view import View
from armflex.conventions import Array

FAR = {3: 4.0, 6: 4.7}
"""Whitened length of so many numbers beyond which they count less: one in a thousand exceeds it by chance."""

MEDIAN_LENGTH = {3: 1.538, 6: 2.313}
"""Median length of so many standard normal numbers."""


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
    """Return the whitened length beyond which a row counts less.

    While the model is wrong all residuals are long; what is far is then judged by their median, not by the noise.
    """
    length = np.linalg.norm(view.whitened, axis=1)
    size = view.residual.shape[1]
    return FAR[size] * max(1.0, float(np.median(length)) / MEDIAN_LENGTH[size])


def huber_weights(view: View, limit: float | None = None) -> Array:
    """Return the (M,) weights of the rows."""
    length = np.linalg.norm(view.whitened, axis=1)
    return np.minimum(1.0, (limit or robust_limit(view)) / np.maximum(length, 1e-300))


def objective(view: View, values: Array, prior: Array, limit: float) -> float:
    """Return the Huber cost plus the prior's, both as -2 log density."""
    length = np.linalg.norm(view.whitened, axis=1)
    cost = np.where(length > limit, 2.0 * limit * length - limit**2, length**2).sum()
    return float(cost + ((values / prior) ** 2).sum())
