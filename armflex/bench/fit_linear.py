"""Laws that are linear in what is fitted: a compliance, a polynomial, and a polynomial of terms found one at a time.

Least squares in closed form, with their uncertainty: the loads are taken as exact, and every deflection column has its
own noise, found from the residuals.

Terms are found as the closed loop finds effects. Each deflection starts with its own load alone. Candidates are the
coupling of the axes (every other load, on every deflection) and each feature that is not linear in the load, along a
direction of its own, that is on every deflection at once: a contact pushes one way, whatever the axes are called. The
candidate with the most evidence joins if it beats what random signs of the residual give the best of all candidates
(Winkler et al. 2014), and everything is fitted again. What no longer earns its place goes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armflex.bench.fitted import Fitted, check_determined, check_span, seen_loads, wrenches
from armflex.conventions import WRENCH_NAMES, Array
from armflex.errors import IdentifiabilityError, InputError, did_you_mean
from armflex.laws.joint.linear import LinearFit, LinearLaw
from armflex.laws.joint.polynomial import FEATURES, PolynomialLaw, feature_values, features_of
from armflex.laws.law import embed
from armflex.linear_gaussian import LinearGaussian

ROUNDS = 100
"""Most reweightings by the rows' own scatter."""

STRUCTURES = ("full", "symmetric", "diagonal")

COUPLING = "axis coupling"


LEAST = 6.0
"""Evidence (fall of the Bayesian information criterion) that a term must be worth, added or kept."""


@dataclass(frozen=True)
class FittedCompliance:
    """A (k, k) compliance [m/N, ...] with the (k, k, k) covariance of its rows and (k,) residual scatter."""

    compliance: Array
    row_covariance: Array
    residual_std: Array

    def law(self, loads: Array) -> LinearLaw:
        """Return the law, remembering the (N, k) loads it was fitted on."""
        fit = LinearFit(self.row_covariance, self.residual_std, seen_loads(loads))
        return LinearLaw(embed(self.compliance), fit=fit)


def fit_compliance(loads: Array, deflections: Array, structure: str = "full") -> FittedCompliance:
    """Return the compliance of (N, k) loads and deflections.

    Args:
        loads: (N, k) [N, N m].
        deflections: (N, k) [m, rad].
        structure: "full", "symmetric" (Betti) or "diagonal" (the paper's eq. (7)).

    Raises:
        InputError: No such structure, or no more rows than components.
        IdentifiabilityError: The loads do not span the components, so that some entries are not determined.
    """
    basis = basis_of(loads.shape[1], structure)
    if len(loads) <= loads.shape[1]:
        raise InputError(f"{len(loads)} rows of loads do not determine {loads.shape[1]} components")
    check_span(loads)
    regressors, count, scatter = np.einsum("pik,nk->nip", basis, loads), len(basis), np.ones(loads.shape[1])
    for _ in range(ROUNDS if structure == "symmetric" else 1):  # rows share parameters: weigh them by their own scatter
        before, weighted = scatter, regressors / scatter[:, None]
        theta = least_squares(weighted.reshape(-1, count), (deflections / scatter).ravel())
        scatter = scatter_of(deflections, deflections - regressors @ theta, count / loads.shape[1])
        if np.allclose(scatter, before, rtol=1e-9, atol=0.0):
            break
    covariance = LinearGaussian.of((regressors / scatter[:, None]).reshape(-1, count), np.zeros(count)).covariance
    rows = np.einsum("pik,pq,qil->ikl", basis, covariance, basis)
    return FittedCompliance(np.tensordot(theta, basis, axes=1), rows, scatter)


def basis_of(size: int, structure: str) -> Array:
    """Return the (P, k, k) matrices that the compliance is a sum of."""
    if structure not in STRUCTURES:
        hint = did_you_mean(str(structure), STRUCTURES)
        raise InputError(f"structure {structure!r} is not known{hint} (known: {', '.join(STRUCTURES)})")
    entries = np.eye(size * size).reshape(size, size, size, size)
    if structure == "diagonal":
        return entries[np.arange(size), np.arange(size)]
    if structure == "symmetric":
        return np.maximum(entries, entries.swapaxes(2, 3))[np.triu_indices(size)]
    return entries.reshape(-1, size, size)


def least_squares(regressors: Array, readings: Array) -> Array:
    """Return the (F, ...) coefficients of (N, F) regressors that fit (N, ...) readings best."""
    scale = np.maximum(np.linalg.norm(regressors, axis=0), 1e-300)
    return (np.linalg.lstsq(regressors / scale, readings, rcond=None)[0].T / scale).T


def scatter_of(deflections: Array, residual: Array, parameters: float) -> Array:
    """Return the standard deviation of each column of (N, ...) residuals, of which so many parameters were fitted."""
    freedom = max(len(residual) - parameters, 1.0)
    least = max(1e-12 * float(np.abs(deflections).max()), 1e-30)  # a column may be followed exactly
    return np.maximum(np.sqrt((residual**2).sum(axis=0) / freedom), least)


def fit_polynomial(loads: Array, deflections: Array, features: str | Sequence[str]) -> PolynomialLaw:
    """Return the polynomial law of (N, k) loads [N, Nm] and deflections [m, rad], linear in loads and `features_of`.

    Raises:
        UnknownNameError: No such feature.
        IdentifiabilityError: The loads do not determine a coefficient for every feature.
    """
    names = features_of(features, loads.shape[1])
    values = _values(loads, names)
    if len(values) <= len(names):
        problem = f"{len(values)} rows of loads do not determine {len(names)} features"
        raise IdentifiabilityError(problem, min(values.shape), np.inf, names)
    check_determined(values, names, "loads do not distinguish the features of a polynomial")
    return _law(names, values, loads, deflections, [range(len(names))] * loads.shape[1])


def _values(loads: Array, names: Sequence[str]) -> Array:
    """Return the (N, F) features of (N, k) loads."""
    return feature_values(wrenches(loads))[:, [FEATURES.index(name) for name in names]]


def _law(
    names: Sequence[str], values: Array, loads: Array, deflections: Array, places_of: Sequence[Sequence[int]]
) -> PolynomialLaw:
    """Return the law of (N, F) features in which each deflection follows `places_of` of them."""
    used, size = sorted({place for places in places_of for place in places}), len(places_of)
    coefficients, covariance = np.zeros((len(used), size)), np.zeros((size, len(used), len(used)))
    scatter = np.zeros(size)
    for i, places in enumerate(places_of):
        inside, target, at = values[:, list(places)], deflections[:, i], np.searchsorted(used, places)
        coefficients[at, i] = least_squares(inside, target)
        scatter[i] = scatter_of(deflections, target - inside @ coefficients[at, i], len(at))
        covariance[i][np.ix_(at, at)] = scatter[i] ** 2 * LinearGaussian.of(inside, np.zeros(len(at))).covariance
    return PolynomialLaw(tuple(names[i] for i in used), coefficients, covariance, scatter, seen_loads(loads))


@dataclass(frozen=True, eq=False)
class _Bench:
    """(N, k) deflections and every feature of the loads, (N, F) of length one; rows in all are exchangeable."""

    deflections: Array
    features: Array
    names: tuple[str, ...]

    def places(self, terms: Sequence[str], column: int) -> list[int]:
        """Return the features of one deflection with some terms, its own load first."""
        along = WRENCH_NAMES[column]
        others = [name for name in WRENCH_NAMES[: self.deflections.shape[1]] if name != along]
        names = [along, *(others if COUPLING in terms else ()), *(term for term in terms if term != COUPLING)]
        return [self.names.index(name) for name in names]

    def left(self, places: Sequence[int], values: Array) -> tuple[Array, int]:
        """Return what some features do not follow of (N, ...) values, and how many of them are independent."""
        span, sizes, _ = np.linalg.svd(self.features[:, list(places)], full_matrices=False)
        span = span[:, sizes > 1e-6 * sizes[0]]
        return values - span @ (span.T @ values), span.shape[1]

    def residual(self, terms: Sequence[str]) -> Array:
        """Return the (N, k) residual of a fit with some terms."""
        columns = enumerate(self.deflections.T)
        return np.stack([self.left(self.places(terms, i), target)[0] for i, target in columns], axis=1)

    def evidence(self, terms: Sequence[str], candidate: str, residuals: Array) -> Array:
        """Return the (R,) evidence of a candidate beside some terms for (N, k, R) residuals."""
        count, size = self.deflections.shape
        total, added = np.zeros(residuals.shape[2]), 0
        for i in range(size):
            inside, before = self.left(self.places(terms, i), residuals[:, i])
            left, after = self.left(self.places([*terms, candidate], i), inside)
            whole = np.maximum((inside**2).sum(axis=0), 1e-300)
            total -= count * np.log(np.maximum((left**2).sum(axis=0) / whole, 1e-12))
            added += after - before
        return total - added * np.log(count) if added else np.full(residuals.shape[2], -np.inf)

    def worth(self, terms: Sequence[str], candidate: str) -> float:
        """Return the evidence of a candidate beside some terms, in the data."""
        return float(self.evidence(terms, candidate, self.residual(terms)[:, :, None])[0])


def fit_terms(loads: Array, deflections: Array, seed: int) -> Fitted:
    """Return a polynomial law of the terms that (N, k) loads and deflections show, and how they were found.

    Each term that joined is reported by its name, the evidence it had, and the evidence that the best of all candidates
    reaches by chance, once in twenty. Rows may be too few (`InputError`), or their loads not span the components
    (`IdentifiabilityError`).
    """
    size = loads.shape[1]
    if len(loads) < size + 4:
        raise InputError(f"{len(loads)} rows are too few to look for terms, expected {size + 4} or more")
    check_span(loads)
    names = features_of(("radial", "magnitude", "absolute", "quadratic"), size)
    values = _values(loads, names)
    bench = _Bench(deflections, values / np.maximum(np.linalg.norm(values, axis=0), 1e-300), names)
    terms: list[dict[str, str | float]] = []
    kept: list[str] = []
    while (term := _next(bench, kept, np.random.default_rng(seed))) is not None:
        terms.append(term)
        kept.append(str(term["name"]))
    while kept:
        worth = {name: bench.worth([other for other in kept if other != name], name) for name in kept}
        weakest = min(kept, key=lambda name: worth[name])
        if worth[weakest] >= LEAST:
            break
        kept.remove(weakest)
    earning = [_earning(bench, i, bench.places(kept, i)) for i in range(size)]
    return Fitted(_law(names, values, loads, deflections, earning), {"terms": terms, "kept": kept})


def _next(bench: _Bench, terms: list[str], rng: np.random.Generator) -> dict[str, str | float] | None:
    """Return the candidate with the most evidence, None where chance does as well or rows run out."""
    count, size = bench.deflections.shape
    left = [name for name in (COUPLING, *bench.names) if name not in (*WRENCH_NAMES, *terms)]
    taken = 1 + sum(size - 1 if name == COUPLING else 1 for name in terms)
    if not left or count - taken < size + 2:
        return None
    evidence = [bench.worth(terms, name) for name in left]
    flipped = bench.residual(terms)[:, :, None] * rng.choice([-1.0, 1.0], (count, 1, 400))
    best = np.max([bench.evidence(terms, name, flipped) for name in left], axis=0)
    # Share of random signs whose best candidate may be as good as a term that is added
    chance, first = float(np.quantile(best, 1.0 - 0.05)), int(np.argmax(evidence))
    if evidence[first] <= max(LEAST, chance):
        return None
    return {"name": left[first], "evidence": evidence[first], "chance": chance}


def _earning(bench: _Bench, column: int, places: list[int]) -> list[int]:
    """Return the features that one deflection is better off with; its own load stays."""
    count = len(bench.deflections)

    def cost(chosen: list[int]) -> float:
        left, _ = bench.left(chosen, bench.deflections[:, column])
        return count * float(np.log(max(float(left @ left), 1e-300))) + len(chosen) * float(np.log(count))

    while len(places) > 1:
        best = min(([other for other in places if other != place] for place in places[1:]), key=cost)
        if cost(best) > cost(places):
            break
        places = best
    return places
