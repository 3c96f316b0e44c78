"""A cause that nobody recorded: where something unexplained acts, whatever it is, and its value in every pose.

For each site and axis the residual is taken as noise plus a random twist of unknown variance v, one per pose:
r ~ N(0, s^2 I + v J J'), and the likelihood is maximised over v and the noise's size s. s is not known for positions
from orientations: where both were read, each kind is first taken by its own size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.estimate.fit import Fit
from armflex.estimate.robust import BY_CHANCE
from armflex.laws.effects.context import Context
from armflex.laws.effects.location import LINK
from armflex.laws.effects.possible import USUAL_SHIFT, USUAL_TURN
from armflex.parameters import DOUBT
from armflex.trace.projection import LEAST_SCATTER, Projection

RATIOS = np.logspace(-4.0, 8.0, 61)
"""Tolerance: variances tried, in units of what the mean pose could show at all."""

LINK_BEHIND = 1.0
"""Prior: log-likelihood ratio by which a link's end must be likelier than a joint."""


def noticed_from(places: int) -> float:
    """Return the log-likelihood ratio that noise alone gives at any of so many places as rarely as `BY_CHANCE`."""
    return float(np.log(places / BY_CHANCE))


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

    @property
    def unit(self) -> str:
        """Of its size."""
        return "m" if self.axis.startswith("d") else "rad"

    @property
    def plausible(self) -> bool:
        """Whether a machine that works can be that far off from pose to pose."""
        return self.std <= (USUAL_SHIFT if self.unit == "m" else USUAL_TURN)


def localise(fit: Fit, context: Context, projection: Projection, groups: np.ndarray) -> tuple[RandomTwist, ...]:
    """Return every site and axis, the likeliest first; measured rows of one of (M,) groups, a pose, share a twist."""
    view, scale = fit.view, fit.scale
    residual, read = projection.residual.reshape(scale.shape), np.isfinite(view.sigma)
    # The RMS of each kind's residual where it was read, over that of all.
    squares, levels = np.where(read, residual**2, 0.0), np.ones(scale.shape[1])
    whole = squares.sum() / max(read.sum(), 1)
    for kind in view.readings.slices:
        mean = squares[:, kind].sum() / max(read[:, kind].sum(), 1)
        levels[kind] = np.sqrt(mean / whole) if mean > 0.0 else 1.0
    residual, scale = residual / levels, scale / levels
    total = float((residual**2).sum()) + projection.freedom * LEAST_SCATTER**2
    count = int(groups.max()) + 1
    found = []
    for site in context.sites:
        jacobian = view.to_twist(site) * scale[:, :, None]
        scores = np.einsum("md,mda->ma", residual, jacobian)
        squares = np.einsum("mda,mda->ma", jacobian, jacobian)
        for axis, name in enumerate(TWIST_NAMES):
            score = np.asarray(np.bincount(groups, scores[:, axis], count), float)
            square = np.asarray(np.bincount(groups, squares[:, axis], count), float)
            ratio, variance = _likelihood(score, square, total, projection.freedom)
            found.append(RandomTwist(site, name, ratio, float(np.sqrt(variance))))
    # What stands level goes by its joint rather than by the link that ends there.
    return tuple(sorted(found, key=lambda place: -place.ratio + LINK_BEHIND * place.site.startswith(LINK)))


def _likelihood(score: Array, square: Array, total: float, freedom: float) -> tuple[float, float]:
    """Return the largest log-likelihood ratio, the noise's size fitted for each variance, and the variance there.

    `score` and `square` are the (G,) products of every pose's column with its residual and itself, `total` the sum of
    squares of the residual.
    """
    mean = float(square.mean())
    if mean <= 0.0:
        return 0.0, 0.0
    # With noise s^2 the twist's variance is v s^2: the quadratic form and determinant of I + v j j' per pose.
    ratios = RATIOS / mean
    inflated = 1.0 + ratios[:, None] * square
    quadratic = total - (ratios[:, None] * score**2 / inflated).sum(axis=1)
    likelihood = -0.5 * freedom * np.log(quadratic / total) - 0.5 * np.log(inflated).sum(axis=1)
    best = int(likelihood.argmax())
    if likelihood[best] <= 0.0:
        return 0.0, 0.0
    return float(likelihood[best]), float(ratios[best] * quadratic[best] / freedom)


def as_likely(places: tuple[RandomTwist, ...]) -> tuple[RandomTwist, ...]:
    """Return the places that the residual does not distinguish from the first."""
    return tuple(place for place in places[1:] if place.ratio > places[0].ratio + np.log(DOUBT))
