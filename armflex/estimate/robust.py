"""Whitened residuals, and how little a lost beam among them counts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.view import View
from armflex.parallel import in_pieces, in_threads

BY_CHANCE = 1e-3
"""Confidence: probability of what is still by chance: of a row to be farther off, of instruments to scatter more, of
rows held out to be worse, of a machine to have changed, of a sister to be a stranger, of a campaign to be another's."""

EVEN = 0.05
"""Tolerance: change of the logarithm of a standard deviation below which it is found."""

TAILS = 4.0
"""Prior: degrees of freedom of the distribution of what is mostly near and sometimes far (Lange, Little and Taylor
1989): readings, and how large what a joint has not got may be."""


@cache
def outlier_limit(size: int) -> float:
    """Return the whitened length of so many numbers beyond which they count less, to one decimal: 4.0 of three."""
    return round(chi_squared(size, BY_CHANCE) ** 0.5, 1)


@cache
def median_length(size: int) -> float:
    """Return the median length of so many standard normal numbers, to three decimals."""
    return round(chi_squared(size, 0.5) ** 0.5, 3)


def chi_squared(size: float, probability: float) -> float:
    """Return what a chi-squared number of so many degrees of freedom exceeds with a probability."""
    from scipy.special import chdtri  # not needed to import the package

    return float(chdtri(size, probability))


ROWS_AT_ONCE = 2048
"""Tolerance: rows whose columns are made together: what they are made of takes some ten times their own memory."""


def whitened_regressors(blocks: Sequence[Block], view: View, weights: Array) -> Array:
    """Return (M d, P) columns of all blocks, whitened and weighted by the (M, d) weights."""
    ends = np.cumsum([0, *(len(block.parameters) for block in blocks)])
    scale = np.sqrt(weights) / view.sigma
    regressors = np.empty((*view.residual.shape, ends[-1]))
    placed = [(block, slice(*pair)) for block, pair in zip(blocks, pairwise(ends.tolist()), strict=True)]
    pieces = in_pieces(np.arange(len(scale)), ROWS_AT_ONCE)
    local = [(block, place) for block, place in placed if block.by_row or len(pieces) < 2]

    def fill(piece: np.ndarray) -> None:
        part = view if len(pieces) == 1 else view.some(piece)
        for block, place in local:
            np.multiply(block.jacobian(part), scale[piece, :, None], out=regressors[piece[0] : piece[-1] + 1, :, place])

    for _ in in_threads(fill, pieces):
        pass
    for block, place in placed:
        if (block, place) not in local:
            regressors[:, :, place] = block.jacobian(view) * scale[:, :, None]
    return regressors.reshape(view.residual.size, ends[-1])


def whitened_residual(view: View, weights: Array) -> Array:
    """Return (M d,) residuals, whitened and weighted."""
    return (np.sqrt(weights) * view.whitened).ravel()


def robust_limit(view: View) -> Array:
    """Return how many times what noise makes a reading must be off to count less: 1, more while the model is wrong.

    While it is wrong all residuals are long; what is far is then judged by their median, not by the noise: (G,), one of
    each instrument's own.
    """
    return np.maximum([median_scatter(view, number) for number in range(len(view.readings.groups))], 1.0)


def median_scatter(view: View, number: int) -> float:
    """Return the scatter of what an instrument read over its standard deviations, by the median; 0 of nothing."""
    length, expected, read = list(_lengths(view, median_length))[number]
    return float(np.median(length[read] / expected[read])) if read.any() else 0.0


def instrument_weights(view: View, limit: Array | float | None = None) -> Array:
    """Return the (M, G) weights of what each instrument read in a row: a level is no worse for a lost beam."""
    return np.concatenate([np.empty((len(view.residual), 0)), *_weights(view, limit, False)], axis=1)


def huber_weights(view: View, limit: Array | float | None = None) -> Array:
    """Return the (M, d) weights of the numbers of the rows: the same for all that an instrument read in one look."""
    huber = np.ones(view.residual.shape)
    for place, weights in zip(view.readings.groups, _weights(view, limit, True), strict=True):
        huber[:, place] = np.repeat(weights, (place.stop - place.start) // weights.shape[1], axis=1)
    return huber


def _weights(view: View, limit: Array | float | None, apart: bool) -> Iterator[Array]:
    """Yield of every instrument the (M, k) weights of what it read; see `_lengths`."""
    limits = np.broadcast_to(robust_limit(view) if limit is None else limit, len(view.readings.groups))
    for bound, (length, expected, _) in zip(limits, _lengths(view, outlier_limit, apart), strict=True):
        yield 1.0 / np.maximum(length / (bound * expected), 1.0)


def objective(view: View, values: Array, prior: Array, limit: Array | float) -> float:
    """Return the Huber cost plus the prior's, both as -2 log density."""
    cost, limits = ((values / prior) ** 2).sum(), np.broadcast_to(limit, len(view.readings.groups))
    for bound, (length, expected, _) in zip(limits, _lengths(view, outlier_limit, True), strict=True):
        far = bound * expected
        cost += np.where(length > far, 2.0 * far * np.where(length > far, length, 0.0) - far**2, length**2).sum()
    return float(cost)


def _lengths(
    view: View, length: Callable[[int], float], apart: bool = False
) -> Iterator[tuple[Array, Array, np.ndarray]]:
    """Yield of every instrument the (M, k) whitened lengths of what it read, what is expected of as many numbers, and
    where it read: an orientation that was not read is as uncertain as can be.

    k is 1, or where `apart` is asked for, how many of its numbers may be outliers each without the others.
    """
    apart_in = {place.start: kind.apart for kind, place in view.readings.placed}
    for place in view.readings.groups:
        size = place.stop - place.start
        size = apart_in[place.start] or size if apart else size
        read = np.isfinite(view.sigma[:, place]).reshape(len(view.sigma), -1, size)
        sizes, back = np.unique(read.sum(axis=2), return_inverse=True)
        expected = np.array([length(max(size, 1)) for size in sizes.tolist()])[back].reshape(read.shape[:2])
        yield np.linalg.norm(view.whitened[:, place].reshape(read.shape), axis=2), expected, np.any(read, axis=2)
