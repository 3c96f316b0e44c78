"""One round of the search: screen everything, refine the best, and say which candidate explains most."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from armflex.estimate.fit import Fit
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.effect import EffectLaw
from armflex.laws.effects.location import LINK, Location
from armflex.laws.effects.scene import Scene
from armflex.laws.effects.unnamed import BUMP, LEVEL, PRODUCT, WAVE, WAVE_PRODUCT, suspects
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
from armflex.trace.localise import RandomTwist, localise
from armflex.trace.polish import Polished, polish
from armflex.trace.projection import Projection, project
from armflex.trace.sensible import sensible
from armflex.trace.telling import Tell

REFINED = 14
"""Best candidates whose inner parameters are refined."""

LOOKED_AT = 120
"""Best candidates among which the possible ones are sought."""

SHAPED = 10
"""Best free shapes whose place is searched for waves and bumps."""

PLACES = 4
"""Likeliest places at which products of two columns are tried."""

PREFERRED = 6.0
"""Evidence by which a candidate that bends must beat a plainer one."""

TIE = 2.0
"""Evidence within which the plainer candidate is taken."""

SECOND_BEST = (4, 1, 1)
"""How many of the shapes that are sought are refined: waves and bumps, products, products with waves."""

CLOSE, SHARE, SHORT = 10.0, 0.03, 4
"""Evidence, or share of it, within which candidates are refitted in full before one is chosen, and how many at most."""

MORE = 5.0
"""Times of an effect's size at one place that make another place with the same law less likely."""

ALIKE = 0.05
"""Difference of gains below which two candidates are the same to the data."""

TRIED_FIRST = 0.25
"""Share of the best evidence from which a plain law is tried first."""

MUCH = 0.6
"""Share of the excess that a candidate must explain for products not to be tried."""


@dataclass(frozen=True, eq=False)
class Round:
    """What one round of the search found.

    Attributes:
        projection: Of the fit that was searched.
        named: The catalogue, screened.
        sifted: Everything that was tried, projected: for nulls.
        places: Where a random twist would explain the residual, the likeliest first.
        ranking: Refined candidates, the best first.
        plain: Laws that are tried first.
    """

    projection: Projection
    named: Screening
    sifted: tuple[Sifted, ...]
    places: tuple[RandomTwist, ...]
    ranking: tuple[Polished, ...]
    plain: frozenset[str]

    @property
    def best(self) -> Polished:
        """The candidate to believe first: a plain law where one explains a fair part of what the best of all does.

        While several effects are missing, whatever bends most wins by fitting some of each.
        """
        return preferred(self.eligible)

    @property
    def eligible(self) -> tuple[Polished, ...]:
        """The candidates among which `best` is, the best first."""
        first = self.ranking[0]
        return (
            self._some(self._is_plain, TRIED_FIRST * first.evidence)
            or self._some(_is_physical, first.evidence - PREFERRED)
            or self.ranking
        )

    @property
    def contender(self) -> Polished | None:
        """What bends more than `best` and explains clearly more; to be believed where it leaves nothing unexplained."""
        first = self.ranking[0]
        if first.evidence < self.best.evidence + PREFERRED:
            return None
        return preferred(self._some(_is_physical, first.evidence - PREFERRED) or self.ranking)

    @property
    def could(self) -> bool:
        """Whether the contender may leave nothing unexplained."""
        excess = self.projection.objective - self.projection.count
        return self.contender is not None and self.contender.gain > MUCH * excess

    @property
    def first(self) -> Polished:
        """The candidate that is looked at first."""
        return self.contender if self.contender is not None and self.could else self.best

    @property
    def shortlist(self) -> tuple[Polished, ...]:
        """`best` and what comes close to it, as far as the data can tell them apart at all."""
        best = self.best
        close = [one for one in self.eligible if one.evidence > best.evidence - max(CLOSE, SHARE * best.evidence)]
        distinct = [best]
        for one in close:
            if all(abs(one.gain - other.gain) > ALIKE for other in distinct):
                distinct.append(one)
        return tuple(distinct[:SHORT])

    def _is_plain(self, law: EffectLaw) -> bool:
        return law.name in self.plain

    def _some(self, belongs: Callable[[EffectLaw], bool], asked: float) -> tuple[Polished, ...]:
        """Return the candidates of some laws, none where their best has not the evidence asked for."""
        some = tuple(one for one in self.ranking if belongs(one.candidate.law))
        return some if some and some[0].evidence > asked else ()


def _is_physical(law: EffectLaw) -> bool:
    return law.physical


def preferred(ranking: Sequence[Polished]) -> Polished:
    """Return the plainest of those that the data hardly tell from the best."""
    return plainest([one for one in ranking if one.evidence > ranking[0].evidence - TIE])


def plainest(alike: Sequence[Polished]) -> Polished:
    """Return the plainest of some candidates, the best first, that the data do not tell apart.

    First what is constant, then in the order of the catalogue, a joint's before a link's; one law at several places
    not where more than `MORE` times of it is needed, 1 mrad counted as 1 mm, and rather where it turns: joints do.
    """
    least = min(_kind(one) for one in alike)
    same = [one for one in alike if _kind(one) == least]
    most = MORE * min(_size(one) for one in same)
    little = [one for one in same if _size(one) <= most]
    return min(little, key=lambda one: not one.candidate.location.turns)


def _kind(one: Polished) -> tuple[bool, int, bool]:
    law = one.candidate.law
    return not law.constant, list(EVERY).index(law.name), one.candidate.location.site.startswith(LINK)


def _size(one: Polished) -> float:
    return float(np.abs(one.amplitudes).sum())


def search(named: Bank, groups: np.ndarray) -> Round:
    """Return what the catalogue and free shapes could explain of a fit's residual.

    Args:
        named: Everything physical, at the fit with everything that is known so far.
        groups: (M,) pose number of every measured row.
    """
    fit, scene, tell = named.fit, named.scene, named.tell
    projection = project(fit)
    free = bank(
        candidates_of((law for law in EVERY.values() if not (law.physical or law.sought)), scene), fit, scene, tell
    )
    tell("projecting candidates", 0, 0)
    sifted = (sift(named, projection), sift(free, projection))
    screened, shaped = (screen(one) for one in sifted)
    places = localise(fit, scene, projection, groups)
    chosen = _possible(screened, fit, scene, projection, REFINED)
    chosen += _possible(shaped, fit, scene, projection, 3)
    second = _second_look(shaped, places, fit, scene, projection, float(screened.gains.max(initial=0.0)), tell)
    for tried, most in zip(second, SECOND_BEST, strict=False):
        chosen += _best(tried, most)
    refined = []
    for number, candidate in enumerate(chosen):
        tell(f"refining {candidate.name}", number, len(chosen))
        refined.append(polish(candidate, fit, scene, projection))
    ranking = tuple(sorted(refined, key=lambda one: -one.evidence))
    return Round(projection, screened, (*sifted, *second), places, ranking, _plain(scene))


def searched(sifted: Sifted, fit: Fit, scene: Scene, most: int) -> Round:
    """Return the round of some candidates alone, the best for every law and location that is possible, none refined."""
    screened, projection = screen(sifted), sifted.projection
    found = []
    for index in best_per_spot(screened, most):
        candidate, gain = screened.bank.candidates[index], float(screened.gains[index])
        amplitudes = projection.gain(screened.bank.group(index))[1]
        if gain > 0.0 and sensible(candidate, amplitudes, fit, scene):
            found.append(Polished(candidate, gain, float(screened.evidence[index]), amplitudes, ()))
    return Round(projection, screened, (sifted,), (), tuple(found), _plain(scene))


def _plain(scene: Scene) -> frozenset[str]:
    """Return the names of plain laws; in a single session nothing can be held out against those of time alone."""
    several = len(set(scene.sessions)) > 1
    return frozenset(law.name for law in EVERY.values() if law.plain and (several or not law.timed))


def _possible(screened: Screening, fit: Fit, scene: Scene, projection: Projection, most: int) -> list[Candidate]:
    """Return the best candidates, one per law and location, whose amplitudes are possible."""
    found: list[Candidate] = []
    for index in best_per_spot(screened, LOOKED_AT):
        candidate = screened.bank.candidates[index]
        amplitudes = projection.gain(screened.bank.group(index))[1]
        if screened.gains[index] > 0.0 and sensible(candidate, amplitudes, fit, scene):
            found.append(candidate)
        if len(found) >= most:
            break
    return found


def _second_look(
    shaped: Screening,
    places: tuple[RandomTwist, ...],
    fit: Fit,
    scene: Scene,
    projection: Projection,
    most: float,
    tell: Tell,
) -> list[Sifted]:
    """Return waves and bumps where a free shape did well, and products of columns where much is left, projected."""
    locations = {
        Location(one.location.site, one.location.axis, one.location.covariates)
        for one in (shaped.bank.candidates[i] for i in best_per_spot(shaped, SHAPED))
        if one.law is not LEVEL
    }
    tried = (
        _with(law, location, inner)
        for law in (WAVE, BUMP)
        for location in sorted(locations, key=str)
        for inner in grid(law, location, scene)
    )
    found = [sift(bank(tried, fit, scene, tell), projection)]
    excess = projection.objective - projection.count
    if most < MUCH * excess:
        products = sift(bank(_products(places, scene), fit, scene, tell), projection)
        waves = _product_waves(_best(products, 1), places, scene)
        found += [products, sift(bank(waves, fit, scene, tell), projection)]
    return found


def _product_waves(best: Sequence[Candidate], places: tuple[RandomTwist, ...], scene: Scene) -> Iterable[Candidate]:
    """Yield the products in which one of the two columns goes in waves."""
    for product in best:
        for place in places[:PLACES]:
            for pair in permutations(product.location.covariates):
                location = Location(place.site, place.axis, pair)
                for inner in grid(WAVE_PRODUCT, location, scene):
                    yield _with(WAVE_PRODUCT, location, inner)


def _with(law, location: Location, inner) -> Candidate:
    terms = tuple(range(len(law.amplitudes)))
    return Candidate(law, Location(location.site, location.axis, location.covariates, terms), inner)


def _products(places: tuple[RandomTwist, ...], scene: Scene) -> Iterable[Candidate]:
    for place in places[:PLACES]:
        for pair in permutations(suspects(scene.records), 2):
            location = Location(place.site, place.axis, pair)
            for inner in grid(PRODUCT, location, scene):
                yield _with(PRODUCT, location, inner)


def _best(sifted: Sifted, most: int) -> list[Candidate]:
    return [sifted.bank.candidates[i] for i in best_per_spot(screen(sifted), most)]
