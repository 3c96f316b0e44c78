"""One round of the search: screen everything, refine the best, and say which candidate explains most."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from armflex.calibrate.fit import Fit
from armflex.effects.catalogue import EVERY, LAWS
from armflex.effects.scene import Scene
from armflex.effects.spot import Spot
from armflex.effects.unnamed import BUMP, LINE, PRODUCT, SHAPES, SPLINE, SPLINE_COMPLIANCE, WAVE, suspects
from armflex.trace.candidates import (
    Bank,
    Candidate,
    Screening,
    Sifted,
    bank,
    best_per_spot,
    candidates_of,
    grid,
    screen,
    sift,
)
from armflex.trace.localise import Place, localise
from armflex.trace.polish import Polished, polish
from armflex.trace.projection import Projection, project

REFINED = 14
"""Best candidates whose inner parameters are refined."""

SHAPED = 10
"""Best free shapes whose place is searched for waves and bumps."""

PLACES = 4
"""Likeliest places at which products of two columns are tried."""

PREFERRED = 6.0
"""Evidence by which a free shape must beat a law of the catalogue, where it completes the explanation."""

TIE = 2.0
"""Evidence within which the plainer candidate is taken."""

ORDER = tuple(EVERY)

HALF = 0.5
"""Share of a free shape's evidence from which a law is preferred where neither completes the explanation."""

COMPLETE = 1.15
"""Objective per reading up to which nothing is left to explain."""

MUCH = 0.6
"""Share of the excess that a candidate must explain for products not to be tried."""


@dataclass(frozen=True, eq=False)
class Round:
    """What one round of the search found.

    Attributes:
        projection: Of the fit that was searched.
        named: The catalogue, screened.
        sifted: The catalogue and free shapes, projected: for nulls.
        places: Where a random twist would explain the residual, the likeliest first.
        ranking: Refined candidates, the best first.
    """

    projection: Projection
    named: Screening
    sifted: Sifted
    places: tuple[Place, ...]
    ranking: tuple[Polished, ...]

    @property
    def best(self) -> Polished:
        """The candidate to believe: a law of the catalogue where no free shape is clearly better."""
        if self.ranking[0].candidate.law.name not in SHAPES:
            return preferred([one for one in self.ranking if one.candidate.law.name not in SHAPES])
        first = preferred(self.ranking)
        named = [one for one in self.ranking if one.candidate.law.name not in SHAPES]
        left = (self.projection.objective - first.gain) / self.projection.count
        asked = first.evidence - PREFERRED if left < COMPLETE else HALF * first.evidence
        return preferred(named) if named and named[0].evidence > asked else first


def preferred(ranking: Sequence[Polished]) -> Polished:
    """Return the plainest of those that the data hardly tell from the best: catalogue order, then a joint's drive."""
    level = [one for one in ranking if one.evidence > ranking[0].evidence - TIE]
    return min(level, key=lambda one: (ORDER.index(one.candidate.law.name), not one.candidate.spot.turns))


def search(fit: Fit, scene: Scene, groups: np.ndarray) -> Round:
    """Return what the catalogue and free shapes could explain of a fit's residual.

    Args:
        fit: The fit with everything that is known so far.
        scene: The campaign.
        groups: (M,) pose number of every measured row.
    """
    projection = project(fit)
    named = bank(candidates_of(LAWS, scene), fit, scene)
    free = bank(candidates_of((LINE, SPLINE, SPLINE_COMPLIANCE), scene), fit, scene)
    screened, shaped = screen(sift(named, projection)), screen(sift(free, projection))
    places = localise(fit, scene, projection, groups)
    chosen = [named.candidates[i] for i in best_per_spot(screened, REFINED)]
    chosen += [free.candidates[i] for i in best_per_spot(shaped, 3)]
    chosen += _second_look(shaped, places, fit, scene, projection, float(screened.gains.max(initial=0.0)))
    refined = [polish(candidate, fit, scene, projection) for candidate in chosen]
    ranking = tuple(sorted(refined, key=lambda one: -one.evidence))
    return Round(projection, screened, sift(_joined(named, free), projection), places, ranking)


def _joined(one: Bank, other: Bank) -> Bank:
    starts = np.concatenate([one.starts, one.starts[-1] + other.starts[1:]])
    return Bank(one.candidates + other.candidates, np.hstack([one.columns, other.columns]), starts)


def _second_look(
    shaped: Screening, places: tuple[Place, ...], fit: Fit, scene: Scene, projection: Projection, most: float
) -> list[Candidate]:
    """Return waves and bumps where a free shape did well, and products of columns where much is left."""
    spots = {
        Spot(spot.site, spot.axis, spot.covariates)
        for spot in (shaped.bank.candidates[i].spot for i in best_per_spot(shaped, SHAPED))
    }
    tried = [
        _with(law, spot, inner)
        for law in (WAVE, BUMP)
        for spot in sorted(spots, key=str)
        for inner in grid(law, spot, scene)
    ]
    found = _best(tried, fit, scene, projection, 4)
    excess = projection.objective - projection.count
    if most < MUCH * excess:
        found += _best(_products(places, scene), fit, scene, projection, 1)
    return found


def _with(law, spot: Spot, inner) -> Candidate:
    terms = tuple(range(len(law.amplitudes)))
    return Candidate(law, Spot(spot.site, spot.axis, spot.covariates, terms), inner)


def _products(places: tuple[Place, ...], scene: Scene) -> Iterable[Candidate]:
    for place in places[:PLACES]:
        for pair in permutations(suspects(scene), 2):
            spot = Spot(place.site, place.axis, pair)
            for inner in grid(PRODUCT, spot, scene):
                yield _with(PRODUCT, spot, inner)


def _best(tried: Iterable[Candidate], fit: Fit, scene: Scene, projection: Projection, most: int) -> list[Candidate]:
    candidates = bank(tried, fit, scene)
    if not candidates.candidates:
        return []
    return [candidates.candidates[i] for i in best_per_spot(screen(sift(candidates, projection)), most)]
