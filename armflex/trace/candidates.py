"""Candidates: every law at every spot with every starting value of its inner parameters, as columns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from armflex.calibrate.fit import Fit
from armflex.conventions import Array
from armflex.effects.law import Effect, EffectLaw, Values, full
from armflex.effects.scene import Scene
from armflex.effects.spot import Spot
from armflex.trace.projection import Projection, evidence
from armflex.trace.telling import Tell, silent


@dataclass(frozen=True)
class Candidate:
    """A law at a spot with values of its inner parameters."""

    law: EffectLaw
    spot: Spot
    inner: Values

    @property
    def name(self) -> str:
        """Law, site and axis."""
        return Effect(self.law, self.spot, ()).name

    @property
    def parameters(self) -> int:
        """How many numbers it takes: amplitudes, and inner parameters that are searched and in use, or not as usual."""
        inner = zip(self.law.inner, self.inner, strict=True)
        unusual = sum(one.usual is not None and value != one.usual for one, value in inner)
        return len(self.spot.terms) + len(self.searched) + unusual

    @property
    def searched(self) -> tuple[int, ...]:
        """Inner parameters that are searched; a positive one at zero is switched off."""
        return tuple(
            i
            for i, (inner, value) in enumerate(zip(self.law.inner, self.inner, strict=True))
            if inner.polished and not (inner.positive and value <= 0.0)
        )

    def effect(self, amplitudes: Array) -> Effect:
        """Return the effect with amplitudes of the acting terms."""
        return Effect(self.law, self.spot, full(amplitudes, self.spot, len(self.law.amplitudes)) + self.inner)


@dataclass(frozen=True, eq=False)
class Bank:
    """Candidates with their whitened columns at one fit.

    Attributes:
        candidates: One per group of columns.
        columns: (n, K) all columns side by side.
        starts: (G + 1,) first column of every group.
    """

    candidates: tuple[Candidate, ...]
    columns: Array
    starts: np.ndarray

    @cached_property
    def sizes(self) -> np.ndarray:
        """(G,) columns of each group."""
        return np.diff(self.starts)

    @cached_property
    def parameters(self) -> np.ndarray:
        """(G,) numbers that each candidate takes."""
        return np.array([candidate.parameters for candidate in self.candidates])

    def group(self, index: int) -> Array:
        """Return the (n, k) columns of one candidate."""
        return self.columns[:, self.starts[index] : self.starts[index + 1]]


def candidate_columns(candidate: Candidate, fit: Fit, scene: Scene) -> Array:
    """Return the (n, k) whitened and weighted columns of a candidate at a fit."""
    return whiten(candidate.law.columns(candidate.spot, candidate.inner, fit.view, scene), fit)


def whiten(columns: Array, fit: Fit) -> Array:
    """Return (n, k) whitened and weighted (M, d, k) columns."""
    scale = np.sqrt(fit.weights)[:, None] / fit.view.sigma
    return (columns * scale[:, :, None]).reshape(fit.view.residual.size, -1)


def grid(law: EffectLaw, spot: Spot, scene: Scene) -> Iterator[Values]:
    """Yield starting values of a law's inner parameters."""
    yield from product(*(tuple(float(v) for v in inner.grid(spot, scene)) for inner in law.inner))


def candidates_of(laws: Iterable[EffectLaw], scene: Scene) -> Iterator[Candidate]:
    """Yield every candidate of some laws in a campaign."""
    for law in laws:
        for spot in law.spots(scene):
            for inner in grid(law, spot, scene):
                yield Candidate(law, spot, inner)


def bank(candidates: Iterable[Candidate], fit: Fit, scene: Scene, tell: Tell = silent) -> Bank:
    """Return candidates with their columns at a fit."""
    known, parts = tuple(candidates), []
    for number, candidate in enumerate(known):
        tell("screening candidates", number, len(known))
        parts.append(candidate_columns(candidate, fit, scene))
    starts = np.concatenate([[0], np.cumsum([part.shape[1] for part in parts])]).astype(int)
    return Bank(known, np.hstack([np.zeros((fit.residual.size, 0)), *parts]), starts)


@dataclass(frozen=True, eq=False)
class Screening:
    """What every candidate of a bank could explain.

    Attributes:
        bank: The candidates.
        gains: (G,) falls of the objective.
        evidence: (G,) falls of the information criterion.
    """

    bank: Bank
    gains: Array
    evidence: Array

    def ranked(self) -> np.ndarray:
        """Return the candidates' numbers, the best evidence first."""
        return np.argsort(-self.evidence, kind="stable")


@dataclass(frozen=True, eq=False)
class Sifted:
    """A bank, projected: everything that does not depend on the residual."""

    bank: Bank
    projection: Projection
    seen: Array
    """(P, K) L^-1 A'X."""

    def score(self, residuals: Array, stationary: bool) -> Array:
        """Return (K, F) scores of (n, F) residuals, projected where they are not those of the fit itself."""
        raw = self.bank.columns.T @ residuals
        return raw if stationary else raw - self.seen.T @ (self.projection.half @ residuals)

    @cached_property
    def solvers(self) -> list[tuple[np.ndarray, Array]]:
        """For every group size: groups, and (g, k, k) factors W with gain = |W' score|^2."""
        found = []
        for size in np.unique(self.bank.sizes):
            groups = np.flatnonzero(self.bank.sizes == size)
            places = self.bank.starts[groups][:, None] + np.arange(size)
            columns = self.bank.columns[:, places].transpose(1, 2, 0)
            seen = self.seen[:, places].transpose(1, 2, 0)
            whole = columns @ columns.transpose(0, 2, 1)
            found.append((groups, _factors(whole - seen @ seen.transpose(0, 2, 1), whole, self.projection.shy)))
        return found

    def gains(self, residuals: Array, stationary: bool = True) -> Array:
        """Return the (G, F) gains of all candidates for (n, F) residuals."""
        scores = self.score(residuals, stationary)
        gains = np.zeros((len(self.bank.candidates), residuals.shape[1]))
        for groups, factors in self.solvers:
            places = self.bank.starts[groups][:, None] + np.arange(factors.shape[1])
            gains[groups] = ((factors.transpose(0, 2, 1) @ scores[places]) ** 2).sum(axis=1)
        return gains


def _factors(inside: Array, whole: Array, shy: float) -> Array:
    """Return (g, k, k) square roots of the groups' inverses."""
    squares = np.einsum("gkk->gk", whole)
    seen = squares > 0.0
    scale = np.where(seen, 1.0 / np.sqrt(np.where(seen, squares, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(inside * scale[:, :, None] * scale[:, None, :])
    roots = 1.0 / np.sqrt(np.maximum(values, 0.0) + shy)
    return scale[:, :, None] * vectors * roots[:, None, :]


def sift(candidates: Bank, projection: Projection) -> Sifted:
    """Return a bank projected on a fit."""
    return Sifted(candidates, projection, projection.half @ candidates.columns)


def screen(sifted: Sifted) -> Screening:
    """Return what every candidate could explain of the fit's residual."""
    gains = sifted.gains(sifted.projection.residual[:, None])[:, 0]
    projection, parameters = sifted.projection, sifted.bank.parameters
    worth = evidence(gains, projection.objective, projection.count, parameters)
    return Screening(sifted.bank, gains, np.asarray(worth))


def best_per_spot(screening: Screening, most: int) -> Sequence[int]:
    """Return the numbers of the best candidates, one per law and spot, the best first."""
    chosen: dict[tuple[str, Spot], int] = {}
    for index in screening.ranked():
        candidate = screening.bank.candidates[index]
        chosen.setdefault((candidate.law.name, candidate.spot), int(index))
        if len(chosen) >= most:
            break
    return list(chosen.values())
