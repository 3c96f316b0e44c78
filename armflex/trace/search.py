"""One round of the search: screen everything, refine the best, and say which candidate explains most."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations

import numpy as np

from armflex.estimate.fit import Fit
from armflex.laws.effects.catalogue import EVERY
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import EffectLaw
from armflex.laws.effects.location import LINK, Location
from armflex.laws.effects.unnamed import BUMP, LEVEL, PRODUCT, WAVE, WAVE_PRODUCT, candidate_columns
from armflex.trace.accept import ENOUGH
from armflex.trace.candidates import (
    Bank,
    Candidate,
    Sifted,
    bank,
    best_per_spot,
    candidate_regressors,
    candidates_of,
    grid,
    sift,
)
from armflex.trace.polish import Polished, polish, sensible
from armflex.trace.projection import Projection, evidence, project
from armflex.trace.unrecorded import RandomTwist, localise

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

TOGETHER, SWEEPS = 6, 3
"""Effects at most that are sought together, and how often each is sought again beside the others."""

MOST = 0.8
"""Share of the excess that one effect explains where hardly anything else is missing."""

MUCH = 0.6
"""Share of the excess that a candidate must explain for products not to be tried."""


@dataclass(frozen=True, eq=False)
class Round:
    """What one round of the search found.

    Attributes:
        projection: Of the fit that was searched.
        sifted: Everything that was tried, projected: the catalogue first.
        places: Where a random twist would explain the residual, the likeliest first.
        ranking: Refined candidates, the best first.
        plain: Laws that are tried first.
    """

    projection: Projection
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
        plain = tuple(one for one in self.ranking if one.candidate.law.name in self.plain)
        if plain and plain[0].evidence > TRIED_FIRST * self.ranking[0].evidence:
            return plain
        return self._physical

    @property
    def _physical(self) -> tuple[Polished, ...]:
        """The candidates of the catalogue; all where its best has clearly less evidence."""
        some = tuple(one for one in self.ranking if one.candidate.law.physical)
        return some if some and some[0].evidence > self.ranking[0].evidence - PREFERRED else self.ranking

    @property
    def contender(self) -> Polished | None:
        """What bends more than `best` and explains clearly more; to be believed where it leaves nothing unexplained."""
        clear = self.ranking[0].evidence >= self.best.evidence + PREFERRED
        return preferred(self._physical) if clear else None

    @property
    def excess(self) -> float:
        """How much there is to be explained beyond the noise."""
        return self.projection.objective - self.projection.count

    @cached_property
    def together(self) -> tuple[Polished, ...]:
        """Effects that explain most together, each beside the others, the best first; none where one explains most."""
        if not self.ranking or max(one.gain for one in self.ranking) > MOST * self.excess:
            return ()
        found = together(self.sifted[0].bank, self.projection, TOGETHER)
        return tuple(found) if len(found) > 1 else ()

    @cached_property
    def explained(self) -> tuple[float, float]:
        """How much those explain together, and their evidence when each is charged for having been chosen."""
        bank, projection = self.sifted[0].bank, self.projection
        if not self.together:
            return 0.0, -np.inf
        chosen = [one.candidate for one in self.together]
        columns = np.hstack([candidate_regressors(one, bank.fit, bank.context) for one in chosen])
        gain, count = projection.objective - projection.beside(columns).objective, sum(one.parameters for one in chosen)
        told = float(evidence(gain, projection.objective, projection.count, count))
        return gain, told - len(chosen) * bank.charge

    @property
    def could(self) -> bool:
        """Whether the contender may leave nothing unexplained."""
        return self.contender is not None and self.contender.gain > MUCH * self.excess

    @property
    def first(self) -> Polished:
        """The candidate that is looked at first."""
        return self.contender if self.contender is not None and self.could else self.best

    @property
    def shortlist(self) -> tuple[Polished, ...]:
        """`best` and what comes close to it, as far as the data can tell them apart at all."""
        best = self.best
        distinct = [best]
        for one in self.eligible:
            close = one.evidence > best.evidence - max(CLOSE, SHARE * best.evidence)
            if close and all(abs(one.gain - other.gain) > ALIKE for other in distinct):
                distinct.append(one)
        return tuple(distinct[:SHORT])


def preferred(ranking: Sequence[Polished]) -> Polished:
    """Return the plainest of those that the data hardly tell from the best."""
    return plainest([one for one in ranking if one.evidence > ranking[0].evidence - TIE])


def plainness(candidate: Candidate) -> tuple[bool, int, bool]:
    """Return how plain a candidate is, the less the plainer."""
    law = candidate.law
    return not law.constant, list(EVERY).index(law.name), candidate.location.site.startswith(LINK)


def plainest(alike: Sequence[Polished]) -> Polished:
    """Return the plainest of some candidates, the best first, that the data do not tell apart.

    First what is constant, then in the order of the catalogue, a joint's before a link's; one law at several places
    not where more than `MORE` times of it is needed, 1 mrad counted as 1 mm, and rather where it turns: joints do.
    """
    kinds, sizes = [plainness(one.candidate) for one in alike], [float(np.abs(one.amplitudes).sum()) for one in alike]
    least = min(kinds)
    most = MORE * min(size for kind, size in zip(kinds, sizes, strict=True) if kind == least)
    little = [one for one, kind, size in zip(alike, kinds, sizes, strict=True) if kind == least and size <= most]
    return min(little, key=lambda one: not one.candidate.location.turns)


def search(named: Bank, groups: np.ndarray) -> Round:
    """Return what the catalogue and free shapes could explain of a fit's residual.

    Waves and bumps are tried where a free shape did well, and products of columns where much is left.

    Args:
        named: Everything physical, at the fit with everything that is known so far.
        groups: (M,) pose number of every measured row.
    """
    fit, context, tell = named.fit, named.context, named.tell
    projection = project(fit)
    unnamed = (law for law in EVERY.values() if not (law.physical or law.sought))
    free = bank(candidates_of(unnamed, context), fit, context, tell)
    tell("projecting candidates", 0, 0)
    sifted = [sift(named, projection), sift(free, projection)]
    screened, shaped = sifted
    places = localise(fit, context, projection, groups)
    chosen = [one.candidate for one in _possible(screened, fit, context, LOOKED_AT, REFINED)]
    chosen += [one.candidate for one in _possible(shaped, fit, context, LOOKED_AT, 3)]

    def best_of(most: int, laws: Sequence[EffectLaw], locations: Sequence[Location]) -> list[Candidate]:
        """Return the best of shapes that are sought, with every starting value, all their terms acting."""
        tried = [
            Candidate(one, replace(location, terms=tuple(range(len(one.amplitudes)))), inner)
            for one in laws
            for location in locations
            for inner in grid(one, location, context)
        ]
        sifted.append(sift(bank(tried, fit, context, tell), projection))
        return [tried[i] for i in best_per_spot(sifted[-1], most)]

    did_well = [shaped.bank.candidates[i] for i in best_per_spot(shaped, SHAPED)]
    did_well = [one.location for one in did_well if one.law is not LEVEL]
    spots = {Location(one.site, one.axis, one.covariates) for one in did_well}
    chosen += best_of(SECOND_BEST[0], (WAVE, BUMP), sorted(spots, key=str))
    if float(screened.gain.max(initial=0.0)) < MUCH * (projection.objective - projection.count):
        likely = places[:PLACES]
        pairs = list(permutations(candidate_columns(context.records), 2))
        products = best_of(
            SECOND_BEST[1], [PRODUCT], [Location(p.site, p.axis, pair) for p in likely for pair in pairs]
        )
        # In products one of the two columns may go in waves.
        pairs = [pair for product in products for pair in permutations(product.location.covariates)]
        waves = [Location(p.site, p.axis, pair) for p in likely for pair in pairs]
        chosen += [*products, *best_of(SECOND_BEST[2], [WAVE_PRODUCT], waves)]
    refined = []
    for number, candidate in enumerate(chosen):
        tell(f"refining {candidate.name}", number, len(chosen))
        refined.append(polish(candidate, fit, context, projection))
    ranking = tuple(sorted(refined, key=lambda one: -one.evidence))
    return Round(projection, tuple(sifted), places, ranking, _plain(context))


def searched(sifted: Sifted, fit: Fit, context: Context, most: int) -> Round:
    """Return the round of some candidates alone, the best for every law and location that is possible, none refined."""
    found = _possible(sifted, fit, context, most, most)
    return Round(sifted.projection, (sifted,), (), tuple(found), _plain(context))


def one_by_one(named: Bank, problem: Projection, most: int) -> Iterator[Polished]:
    """Yield the effects of a bank that explain most, each beside those before, with what it explains beside them.

    None is refined, and one is the last that is worth no more than what it is charged for.
    """
    for _ in range(most):
        found = _possible(sift(named, problem), named.fit, named.context, LOOKED_AT, 1)
        if not found or found[0].evidence <= 0.0:
            return
        yield found[0]
        problem = problem.beside(candidate_regressors(found[0].candidate, named.fit, named.context))


def together(named: Bank, problem: Projection, most: int) -> list[Polished]:
    """Return the effects of a bank that explain most together, each refined beside the others, the best first.

    Greedy order misleads where several causes are missing: what explains some of each comes first and hides them. So
    whenever one more has been taken, each of them is sought again beside the others (Efroymson 1960, with exchanges).
    """
    fit, context, chosen = named.fit, named.context, list[Candidate]()

    def beside(some: Sequence[Candidate]) -> Projection:
        return problem.beside(np.hstack([candidate_regressors(one, fit, context) for one in some])) if some else problem

    def best_beside(some: Sequence[Candidate], own: Candidate | None = None) -> Candidate | None:
        left = beside(some)
        found = _possible(sift(named, left), fit, context, LOOKED_AT, SHORT)
        if own is None:
            return preferred(found).candidate if found and found[0].evidence >= ENOUGH else None
        gain = left.gain(candidate_regressors(own, fit, context))[0]
        worth = float(evidence(gain, left.objective, left.count, own.parameters))
        return preferred(found).candidate if found and found[0].evidence > worth + TIE else own

    while len(chosen) < most and (one := best_beside(chosen)) is not None:
        chosen.append(one)
        for _ in range(SWEEPS):
            before = list(chosen)
            for i in range(len(chosen)):
                chosen[i] = best_beside([*chosen[:i], *chosen[i + 1 :]], chosen[i]) or chosen[i]
            if chosen == before:
                break
    found = [polish(one, fit, context, beside([other for other in chosen if other is not one])) for one in chosen]
    return sorted(found, key=lambda one: -one.evidence)


def _plain(context: Context) -> frozenset[str]:
    """Return the names of plain laws; in a single session nothing can be held out against those of time alone."""
    several = len(set(context.sessions)) > 1
    return frozenset(law.name for law in EVERY.values() if law.plain and (several or not law.timed))


def _possible(sifted: Sifted, fit: Fit, context: Context, looked_at: int, most: int) -> list[Polished]:
    """Return the best candidates, one per law and location, whose amplitudes are possible; none refined."""
    found: list[Polished] = []
    for index in best_per_spot(sifted, looked_at):
        candidate, gain = sifted.bank.candidates[index], float(sifted.gain[index, 0])
        amplitudes = sifted.projection.gain(sifted.bank.group(index))[1]
        if gain > 0.0 and sensible(candidate, amplitudes, fit, context):
            found.append(Polished(candidate, gain, float(sifted.evidence[index]), amplitudes, ()))
        if len(found) >= most:
            break
    return found
