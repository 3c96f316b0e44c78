"""Inner parameters, refined in the projected linear problem before anything is refitted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from armflex.conventions import Array
from armflex.estimate.fit import Fit
from armflex.laws.effects.effect import Inner
from armflex.laws.effects.scene import Scene
from armflex.trace.candidates import Candidate, candidate_columns
from armflex.trace.projection import Projection, evidence
from armflex.trace.sensible import sensible

FINE = 1e-3
"""Relative precision to which inner parameters are refined before the full fit takes over."""


@dataclass(frozen=True)
class Polished:
    """A candidate at its best inner values.

    Attributes:
        candidate: With those values.
        gain: Fall of the objective.
        evidence: Fall of the information criterion.
        amplitudes: Of the acting terms.
        free: Inner parameters that a fit may go on moving.
    """

    candidate: Candidate
    gain: float
    evidence: float
    amplitudes: Array
    free: tuple[int, ...]


def polish(candidate: Candidate, fit: Fit, scene: Scene, projection: Projection) -> Polished:
    """Return a candidate with those inner parameters refined that are worth their number."""
    return max((_polish(one, fit, scene, projection) for one in _variants(candidate)), key=lambda one: one.evidence)


def _variants(candidate: Candidate) -> Iterator[Candidate]:
    """Yield a candidate, and the same with other values of inner parameters that are chosen rather than refined."""
    yield candidate
    for index, inner in enumerate(candidate.law.inner):
        for value in inner.tried:
            yield replace(candidate, inner=(*candidate.inner[:index], value, *candidate.inner[index + 1 :]))


def _polish(candidate: Candidate, fit: Fit, scene: Scene, projection: Projection) -> Polished:
    plain = _weigh(candidate, (), fit, scene, projection)
    for index, inner in enumerate(candidate.law.inner):
        if inner.polished and not inner.smooth:
            plain = _scan(plain, index, fit, scene, projection)
    free = tuple(i for i in plain.candidate.searched if candidate.law.inner[i].smooth)
    if not free or plain.gain <= 0.0:
        return plain
    return _refine(plain, free, fit, scene, projection)


def _weigh(candidate: Candidate, free: Sequence[int], fit: Fit, scene: Scene, projection: Projection) -> Polished:
    columns = candidate_columns(candidate, fit, scene)
    gain, amplitudes = projection.gain(columns) if np.isfinite(columns).all() else (0.0, np.zeros(columns.shape[1]))
    if gain > 0.0 and not sensible(candidate, amplitudes, fit, scene):
        gain, amplitudes = 0.0, np.zeros(len(amplitudes))
    worth = float(evidence(gain, projection.objective, projection.count, candidate.parameters))
    return Polished(candidate, gain, worth, amplitudes, tuple(free))


def _scan(start: Polished, index: int, fit: Fit, scene: Scene, projection: Projection) -> Polished:
    """Return the best of all moments between two rows around the coarse grid's choice."""
    time = np.unique(scene.column("time"))
    between = 0.5 * (time[1:] + time[:-1])
    here = start.candidate.inner[index]
    reach = max(1, len(between) // 20)
    middle = int(np.searchsorted(between, here))
    tried = [start]
    for moment in between[max(0, middle - reach) : middle + reach + 1]:
        inner = (*start.candidate.inner[:index], float(moment), *start.candidate.inner[index + 1 :])
        tried.append(_weigh(replace(start.candidate, inner=inner), (), fit, scene, projection))
    return max(tried, key=lambda one: one.gain)


def _refine(start: Polished, free: tuple[int, ...], fit: Fit, scene: Scene, projection: Projection) -> Polished:
    inners = [start.candidate.law.inner[i] for i in free]
    size = np.array([_size(inner, i, start.candidate, scene) for inner, i in zip(inners, free, strict=True)])

    def placed(steps: Array) -> Candidate:
        inner = list(start.candidate.inner)
        for place, i in enumerate(free):
            inner[i] = inners[place].moved(inner[i], float(size[place] * steps[place]))
        return replace(start.candidate, inner=tuple(inner))

    def loss(steps: Array) -> float:
        return -_weigh(placed(steps), free, fit, scene, projection).gain

    simplex = np.vstack([np.zeros(len(free)), np.eye(len(free))])
    options = {"xatol": FINE, "fatol": 1e-2, "maxfev": 40 * len(free), "initial_simplex": simplex}
    found = minimize(loss, np.zeros(len(free)), method="Nelder-Mead", options=options)
    return _weigh(placed(found.x), free, fit, scene, projection)


def _size(inner: Inner, index: int, candidate: Candidate, scene: Scene) -> float:
    """Return a first step: half the distance to the next value of the search grid."""
    values = np.array(
        sorted({float(v) for v in inner.grid(candidate.location, scene)} - ({0.0} if inner.positive else set()))
    )
    raw = np.log(values) if inner.positive else values
    if len(raw) < 2:
        return 0.3 if inner.positive else max(abs(candidate.inner[index]), 1.0) * 0.3
    return 0.5 * float(np.median(np.diff(raw)))
