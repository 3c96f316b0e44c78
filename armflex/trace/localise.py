"""Where something unexplained acts, without asking for its cause: one variance per site and axis.

For each site and axis the residual is taken as noise plus a random twist of unknown variance v, one per pose:
r ~ N(0, s^2 I + v J J'), and the likelihood is maximised over v and the noise's size s. Nobody knows s for positions
from orientations: where both were read, each kind is first taken by its own size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.estimate.fit import Fit
from armflex.laws.effects.location import LINK
from armflex.laws.effects.scene import Scene
from armflex.trace.projection import Projection

RATIOS = np.logspace(-4.0, 8.0, 61)
"""Variances tried, in units of what the mean pose could tell at all."""

LEVEL = 1.0
"""Log-likelihood ratio by which a link's end must be likelier than a joint."""

NOTICED = 10.0
"""Log-likelihood ratio from which a place counts; noise alone stays below about 3."""


@dataclass(frozen=True)
class RandomTwist:
    """A site and axis where a random twist explains the residual.

    Attributes:
        site, axis: Where.
        ratio: Log-likelihood ratio to noise alone.
        std: Standard deviation of the twist [m or rad].
    """

    site: str
    axis: str
    ratio: float
    std: float


def localise(fit: Fit, scene: Scene, projection: Projection, groups: np.ndarray) -> tuple[RandomTwist, ...]:
    """Return every site and axis, the likeliest first.

    Args:
        fit: The fit whose residual is looked at.
        scene: The campaign.
        projection: The same fit's.
        groups: (M,) number of the pose of every measured row: rows of one pose share a twist.
    """
    view, scale = fit.view, np.sqrt(fit.weights)[:, None] / fit.view.sigma
    residual = projection.residual.reshape(scale.shape)
    levels = _levels(residual, np.isfinite(view.sigma), view.readings.slices)
    residual, scale = residual / levels, scale / levels
    count = int(groups.max()) + 1
    found = []
    for site in scene.sites:
        columns = view.to_twist(site) * scale[:, :, None]
        scores = np.einsum("md,mda->ma", residual, columns)
        squares = np.einsum("mda,mda->ma", columns, columns)
        for axis, name in enumerate(TWIST_NAMES):
            score = np.asarray(np.bincount(groups, scores[:, axis], count), float)
            square = np.asarray(np.bincount(groups, squares[:, axis], count), float)
            ratio, variance = _likelihood(score, square, residual, view.count)
            found.append(RandomTwist(site, name, ratio, float(np.sqrt(variance))))
    # What stands level goes by its joint rather than by the link that ends there.
    return tuple(sorted(found, key=lambda place: -place.ratio + LEVEL * place.site.startswith(LINK)))


def _levels(residual: Array, read: np.ndarray, kinds: Sequence[slice]) -> Array:
    """Return (d,) the RMS of each kind's residual where read, over that of all."""
    squares = np.where(read, residual**2, 0.0)
    means = [squares[:, kind].sum() / max(read[:, kind].sum(), 1) for kind in kinds]
    whole = squares.sum() / max(read.sum(), 1)
    levels = [np.sqrt(mean / whole) if mean > 0.0 else 1.0 for mean in means]
    return np.repeat(levels, [kind.stop - kind.start for kind in kinds])


def _likelihood(score: Array, square: Array, residual: Array, count: int) -> tuple[float, float]:
    """Return the largest log-likelihood ratio, the noise's size fitted for each variance, and the variance there."""
    total = float((residual**2).sum())
    mean = float(square.mean())
    if mean <= 0.0:
        return 0.0, 0.0
    # With noise s^2 the twist's variance is v s^2: the quadratic form and determinant of I + v j j' per pose.
    ratios = RATIOS / mean
    inflated = 1.0 + ratios[:, None] * square
    quadratic = total - (ratios[:, None] * score**2 / inflated).sum(axis=1)
    likelihood = -0.5 * count * np.log(quadratic / total) - 0.5 * np.log(inflated).sum(axis=1)
    best = int(likelihood.argmax())
    if likelihood[best] <= 0.0:
        return 0.0, 0.0
    return float(likelihood[best]), float(ratios[best] * quadratic[best] / count)
