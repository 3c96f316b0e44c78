"""A joint's terms found one at a time: what the residual of a diagonal compliance lacks, traced and added.

The closed loop on a bench. Each deflection starts with its own load alone. Candidates are the coupling of the axes
(every other load, on every deflection) and each feature that is not linear in the load, along a direction of its own,
that is on every deflection at once: a contact pushes one way, whatever the axes are called. The candidate with the most
evidence joins if it beats what random signs of the residual give the best of all candidates (Winkler et al. 2014), and
everything is fitted again. What no longer earns its place goes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armflex.bench.cross_validation import wrenches
from armflex.bench.fit_linear import least_squares, scatter_of, seen_loads
from armflex.bench.fitted import Fitted
from armflex.bench.span import check_span
from armflex.conventions import WRENCH_NAMES, Array
from armflex.errors import InputError
from armflex.laws.joint.polynomial import FEATURES, PolynomialLaw, feature_values, features_of
from armflex.linear_gaussian import LinearGaussian

FLIPS = 400
CHANCE = 0.05
"""Share of random signs whose best candidate may be as good as a term that is added."""

LEAST = 6.0
"""Evidence (fall of the Bayesian information criterion) that a term must be worth, added or kept."""

COUPLING = "axis coupling"


@dataclass(frozen=True)
class Term:
    """What joined: the coupling of the axes, or a feature of the load on every deflection.

    Attributes:
        name: Of the feature, or `COUPLING`.
        evidence: Fall of the information criterion when it joined.
        chance: What the best of all candidates reaches by chance, once in twenty.
    """

    name: str
    evidence: float
    chance: float


@dataclass(frozen=True, eq=False)
class Bench:
    """Deflections and every feature of the loads, features scaled to length one; rows in all are exchangeable.

    Attributes:
        deflections: (N, k).
        features: (N, F).
        lengths: (F,) that the features were divided by.
        names: Of the features.
        loads: (N, k).
    """

    deflections: Array
    features: Array
    lengths: Array
    names: tuple[str, ...]
    loads: Array

    @property
    def candidates(self) -> tuple[str, ...]:
        """The coupling, and every feature that is not linear in the load."""
        return (COUPLING, *(name for name in self.names if name not in WRENCH_NAMES))

    def places(self, terms: Sequence[str], column: int) -> list[int]:
        """Return the features of one deflection with some terms."""
        own = self.names.index(WRENCH_NAMES[column])
        size = self.deflections.shape[1]
        others = [self.names.index(name) for name in WRENCH_NAMES[:size] if name != WRENCH_NAMES[column]]
        return [own, *(others if COUPLING in terms else []), *(self.names.index(t) for t in terms if t != COUPLING)]

    def residual(self, terms: Sequence[str]) -> Array:
        """Return the (N, k) residual of a fit with some terms."""
        return np.stack([self.left(self.places(terms, i), i) for i in range(self.deflections.shape[1])], axis=1)

    def left(self, places: Sequence[int], column: int) -> Array:
        """Return the (N,) residual of one deflection fitted with some features."""
        inside, target = self.features[:, places], self.deflections[:, column]
        return target - inside @ least_squares(inside, target)

    def evidence(self, terms: Sequence[str], candidate: str, residuals: Array) -> Array:
        """Return the (R,) evidence of a candidate beside some terms for (N, k, R) residuals."""
        count, size = self.deflections.shape
        total, added = np.zeros(residuals.shape[2]), 0
        for i in range(size):
            before, after = (self._span(names, i) for names in (terms, [*terms, candidate]))
            inside = residuals[:, i] - before @ (before.T @ residuals[:, i])
            left = inside - after @ (after.T @ inside)
            whole = np.maximum((inside**2).sum(axis=0), 1e-300)
            total -= count * np.log(np.maximum((left**2).sum(axis=0) / whole, 1e-12))
            added += after.shape[1] - before.shape[1]
        return total - added * np.log(count) if added else np.full(residuals.shape[2], -np.inf)

    def _span(self, terms: Sequence[str], column: int) -> Array:
        """Return an orthonormal basis of what one deflection can follow."""
        left, values, _ = np.linalg.svd(self.features[:, self.places(terms, column)], full_matrices=False)
        return left[:, values > 1e-6 * values[0]]


def fit_terms(loads: Array, deflections: Array, seed: int) -> Fitted:
    """Return a polynomial law of the terms that (N, k) loads and deflections show, and how they were found.

    Raises:
        InputError: There are too few rows.
        IdentifiabilityError: The loads do not span the components: a deflection's own load must be there.
    """
    size = loads.shape[1]
    if len(loads) < size + 4:
        raise InputError(f"{len(loads)} rows are too few to look for terms, expected {size + 4} or more")
    check_span(loads)
    names = features_of(("radial", "magnitude", "absolute", "quadratic"), size)
    values = feature_values(wrenches(loads))[:, [FEATURES.index(name) for name in names]]
    lengths = np.maximum(np.linalg.norm(values, axis=0), 1e-300)
    bench = Bench(deflections, values / lengths, lengths, names, loads)
    found: list[Term] = []
    while (term := _next(bench, [term.name for term in found], np.random.default_rng(seed))) is not None:
        found.append(term)
    kept = _pruned(bench, [term.name for term in found])
    return Fitted(_law(bench, kept), {"terms": [vars(term) for term in found], "kept": kept})


def _next(bench: Bench, terms: list[str], rng: np.random.Generator) -> Term | None:
    """Return the candidate with the most evidence, None where chance does as well or rows run out."""
    count, size = bench.deflections.shape
    left = [name for name in bench.candidates if name not in terms]
    taken = 1 + sum(size - 1 if name == COUPLING else 1 for name in terms)
    if not left or count - taken < size + 2:
        return None
    residual = bench.residual(terms)
    evidence = [_worth(bench, name, terms) for name in left]
    flipped = residual[:, :, None] * rng.choice([-1.0, 1.0], (count, 1, FLIPS))
    best = np.max([bench.evidence(terms, name, flipped) for name in left], axis=0)
    chance = float(np.quantile(best, 1.0 - CHANCE))
    first = int(np.argmax(evidence))
    return Term(left[first], evidence[first], chance) if evidence[first] > max(LEAST, chance) else None


def _pruned(bench: Bench, terms: list[str]) -> list[str]:
    """Return the terms without those that are no longer worth `LEAST` beside the others."""
    while terms:
        worth = {name: _worth(bench, name, [other for other in terms if other != name]) for name in terms}
        weakest = min(worth, key=lambda name: worth[name])
        if worth[weakest] >= LEAST:
            break
        terms = [name for name in terms if name != weakest]
    return terms


def _worth(bench: Bench, name: str, rest: Sequence[str]) -> float:
    """Return the evidence of a candidate beside some terms, in the data."""
    return float(bench.evidence(rest, name, bench.residual(rest)[:, :, None])[0])


def _earning(bench: Bench, column: int, places: list[int]) -> list[int]:
    """Return the features that one deflection is better off with; its own load stays."""
    count = len(bench.deflections)

    def cost(chosen: list[int]) -> float:
        left = bench.left(chosen, column)
        return count * float(np.log(max(float(left @ left), 1e-300))) + len(chosen) * float(np.log(count))

    while len(places) > 1:
        rests = [[places[0], *(other for other in places[1:] if other != place)] for place in places[1:]]
        best = min(rests, key=cost)
        if cost(best) > cost(places):
            break
        places = best
    return places


def _law(bench: Bench, terms: Sequence[str]) -> PolynomialLaw:
    size = bench.deflections.shape[1]
    columns = [_earning(bench, i, bench.places(terms, i)) for i in range(size)]
    used = sorted({place for places in columns for place in places})
    coefficients, covariance, scatter = np.zeros((len(used), size)), np.zeros((size, len(used), len(used))), []
    for i, target in enumerate(bench.deflections.T):
        own = columns[i]
        places, scale = [used.index(place) for place in own], bench.lengths[own]
        inside = bench.features[:, own]
        values = least_squares(inside, target)
        scatter.append(float(scatter_of(target, target - inside @ values, len(own))))
        inverse = LinearGaussian.of(inside, np.zeros(len(own))).covariance
        coefficients[places, i] = values / scale
        covariance[i][np.ix_(places, places)] = scatter[-1] ** 2 * inverse / np.outer(scale, scale)
    names, seen = tuple(bench.names[i] for i in used), seen_loads(bench.loads)
    return PolynomialLaw(names, coefficients, covariance, np.array(scatter), seen)
