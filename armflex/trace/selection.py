"""Which effects a campaign speaks for: the exact evidence of every set of hypotheses, in the linear problem of a fit.

A hypothesis is a group of columns X whose amplitudes are b ~ N(0, tau^2), with one tau of `SCALES` for the group. A
column is scaled so that an amplitude of 1 moves the target by 1 mm RMS before the projection. The columns A of all that
is fitted anyway are projected out with their priors (`armflex.trace.projection`), M = 1 - A N^-1 A'. For a model S, a
set of hypotheses with their scales, and readings y of which J0 = y'My is left without any,

    G = X'MX,    s = X'My,    D = diag(tau^2),    Q = G_SS + D^-1,    J_S = J0 - s_S' Q^-1 s_S
    log p(y | S) = -1/2 log|D^1/2 Q D^1/2| + f(J_S),    f(J) = max over noise factors v >= 1 of -n/2 log v - J / 2v

(Zellner's and MacKay's evidence of a linear model; noise is no smaller than it was stated). The posterior of a model is
that times its prior. Given a model, one *scan* returns the same for the model with any one hypothesis more, for all of
them at once, from those rows of G that belong to the model: a hypothesis c has the information
G_cc - G_cS Q^-1 G_Sc and the score s_c - G_cS Q^-1 s_S beside the others. Adding, deleting and exchanging hypotheses
are scans, and so is a step of Gibbs' sampler: one hypothesis is taken out and drawn anew beside the others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.special import log_ndtr

from armflex.conventions import Array
from armflex.trace.hypotheses import Hypothesis

SCALES = np.array([0.1, 0.3, 1.0, 3.0, 10.0, 30.0])
"""Prior: standard deviations tau of an amplitude, by how far it moves the target [mm], all equally likely."""

MOST = 24
"""Hypotheses in a model at most."""

PAIRS = 3
"""Pairs of hypotheses, those that share most, that are taken out together once nothing else improves a model."""

KEPT = 2**24
"""Tolerance: numbers of models beside which all hypotheses are known that are kept at a time."""

BETTER = 1e-2
"""Tolerance: rise of the log posterior below which a model is not changed."""

LINEAR = 0.02
"""Tolerance: share of what a climb has gained by which the linear problem may be wrong; what adds less is not added."""


def log_likelihood(squares: Array | float, count: int) -> Array:
    """Return f(J) of sums of squares J of so many readings; see the head of this module."""
    noise = np.maximum(np.asarray(squares) / count, 1.0)
    return -0.5 * count * np.log(noise) - 0.5 * squares / noise


@dataclass(frozen=True)
class Chosen:
    """A hypothesis of a model, by its number, and the place of its tau in `SCALES`."""

    number: int
    scale: int


Model = tuple[Chosen, ...]


@dataclass(frozen=True, eq=False)
class Group:
    """A hypothesis with its columns.

    Attributes:
        hypothesis: What it says.
        places: (k,) numbers of its columns.
        scale: (k,) amplitude of the law that moves the target by 1 mm RMS, zero where it does not move it.
    """

    hypothesis: Hypothesis
    places: np.ndarray
    scale: Array


Batch = tuple[np.ndarray, np.ndarray, Array, Array, np.ndarray]
"""Groups of one size: numbers, (g, k) columns and scales, (g, k, k) scaled parts of G, and which have a sign."""


def batch_of(groups: Sequence[Group], numbers: np.ndarray, inside: Array) -> Batch:
    """Return groups of one size with their (g, k, k) parts of G."""
    some = [groups[i] for i in numbers.tolist()]
    scale = np.array([one.scale for one in some])
    signed = np.array([one.hypothesis.positive for one in some])
    scaled = inside * scale[:, :, None] * scale[:, None, :]
    return numbers, np.array([one.places for one in some]), scale, scaled, signed


class Evidence(ABC):
    """Hypotheses in the linear problem of a fit: everything that the evidence of a model is made of.

    Attributes:
        groups: All hypotheses.
        scores: (K,) products X'My of all columns.
        objective: J0.
        count: Number of readings n.
        constant: Log likelihood that all models share, by which states of a search differ.
    """

    groups: list[Group]
    scores: Array
    objective: float
    count: int
    constant: float = 0.0

    @abstractmethod
    def gram(self, places: np.ndarray) -> Array:
        """Return (K, k) products X'MX of all columns with some."""

    @abstractmethod
    def insides(self) -> list[tuple[np.ndarray, Array]]:
        """Return for every group size k the (g,) numbers of such groups and their (g, k, k) parts of G."""

    def charge(self, number: int, amplitudes: Array) -> float:
        """Return what the size of (k,) amplitudes of a hypothesis [the law's unit] counts against it [nats]."""
        return 0.0

    @cached_property
    def batches(self) -> list[Batch]:
        """Of all groups, by their size."""
        return [batch_of(self.groups, numbers, inside) for numbers, inside in self.insides()]

    @cached_property
    def priors(self) -> Array:
        """(H,) log prior probability of every hypothesis at each of its scales."""
        return np.array([one.hypothesis.prior for one in self.groups]) - np.log(len(SCALES))

    @cached_property
    def _known(self) -> dict[Model, Beside]:
        return {}

    def grown(self) -> None:
        """Forget what was known of all hypotheses, of which there are more now."""
        for name in ("batches", "priors", "_known"):
            if name in vars(self):
                delattr(self, name)

    def beside(self, model: Model) -> Beside:
        """Return the problem beside a model."""
        if model not in self._known:
            self._known[model] = self._beside(model)
            held = sum(one.across.size for one in self._known.values())
            while held > KEPT and len(self._known) > 1:
                held -= self._known.pop(next(iter(self._known))).across.size
        return self._known[model]

    def _beside(self, model: Model) -> Beside:
        some = [self.groups[one.number] for one in model]
        places = np.concatenate([np.zeros(0, dtype=int), *(one.places for one in some)])
        scale = np.concatenate([np.zeros(0), *(one.scale for one in some)])
        held = np.concatenate(
            [np.zeros(0), *(np.full(len(self.groups[one.number].places), SCALES[one.scale] ** -2.0) for one in model)]
        )
        rows = self.gram(places) * scale
        own = rows[places] * scale[:, None] + np.diag(held)
        root = np.linalg.cholesky(0.5 * (own + own.T))
        inverse = np.linalg.inv(root)
        volume = 2.0 * float(np.log(np.diag(root)).sum()) - float(np.log(held).sum())
        across = np.ascontiguousarray(rows @ inverse.T)
        return Beside(self, model, across, root, inverse @ (self.scores[places] * scale), volume)

    def log_posterior(self, model: Model) -> float:
        """Return the log posterior probability of a model, but for a constant."""
        return self.beside(model).log_posterior


@dataclass(frozen=True, eq=False)
class Beside:
    """All hypotheses beside a model.

    Attributes:
        evidence: The problem.
        model: What is in it.
        across: (K, k) products of all columns with those of the model, by the inverse of `root`'s transpose.
        root: (k, k) Cholesky factor of Q.
        pull: (k,) root^-1 s_S.
        volume: log|D^1/2 Q D^1/2|.
    """

    evidence: Evidence
    model: Model
    across: np.ndarray
    root: np.ndarray
    pull: np.ndarray
    volume: float

    @property
    def left(self) -> float:
        """J_S."""
        return max(self.evidence.objective - float(self.pull @ self.pull), 1e-9 * self.evidence.objective)

    @property
    def noise(self) -> float:
        """Standard deviation of the readings over that stated, 1 or more."""
        return float(np.sqrt(max(self.left / self.evidence.count, 1.0)))

    @cached_property
    def covariance(self) -> Array:
        """(k, k) posterior covariance of the scaled amplitudes [mm^2]."""
        inverse = np.linalg.inv(self.root)
        return self.noise**2 * inverse.T @ inverse

    @cached_property
    def amplitudes(self) -> tuple[Array, ...]:
        """(k,) most probable amplitudes of each hypothesis in the model [the law's unit]."""
        values, found, first = np.linalg.solve(self.root.T, self.pull), [], 0
        for one in self.model:
            group = self.evidence.groups[one.number]
            found.append(values[first : first + len(group.places)] * group.scale)
            first += len(group.places)
        return tuple(found)

    @cached_property
    def log_posterior(self) -> float:
        """Log posterior probability of the model, but for a constant."""
        evidence, first, found = self.evidence, 0, 0.0
        values = np.linalg.solve(self.root.T, self.pull)
        for one, amplitudes in zip(self.model, self.amplitudes, strict=True):
            found += float(evidence.priors[one.number]) - evidence.charge(one.number, amplitudes)
            if evidence.groups[one.number].hypothesis.positive:
                found += float(_sign(values[first] / np.sqrt(self.covariance[first, first])))
            first += len(amplitudes)
        return found + float(log_likelihood(self.left, evidence.count)) - 0.5 * self.volume + evidence.constant

    @cached_property
    def odds(self) -> Array:
        """(H, T) log odds of the model with each hypothesis at each scale more, over the model; sizes not charged."""
        evidence = self.evidence
        return self.odds_of(evidence.batches, self.across, evidence.scores) + evidence.priors[:, None]

    def odds_of(self, batches: Sequence[Batch], across: Array, scores: Array) -> Array:
        """Return the (H, T) log evidence that hypotheses add to the model at each scale.

        Args:
            batches: Of all of them.
            across: (K, k) products of their columns with those of the model, as `across` has them.
            scores: (K,) products of their columns with the readings.
        """
        count, scores = self.evidence.count, scores - across @ self.pull
        found = np.full((sum(len(numbers) for numbers, *_ in batches), len(SCALES)), -np.inf)
        here, tight = float(log_likelihood(self.left, count)), SCALES[:, None] ** -2.0
        for numbers, places, scale, inside, signed in batches:
            taken, score = across[places] * scale[:, :, None], scores[places] * scale
            if places.shape[1] == 1:
                values, turned = np.maximum(inside[:, 0] - (taken**2).sum(axis=2), 0.0), score
            else:
                values, axes = np.linalg.eigh(inside - taken @ taken.transpose(0, 2, 1))
                values, turned = np.maximum(values, 0.0), np.einsum("gki,gk->gi", axes, score)
            held = values[:, None, :] + tight
            left = np.maximum(self.left - (turned[:, None, :] ** 2 / held).sum(axis=2), 1e-9 * self.left)
            logs = log_likelihood(left, count) - here - 0.5 * np.log(held / tight).sum(axis=2)
            if signed.any():
                ratio = turned[:, None, 0] / np.sqrt(held[:, :, 0] * np.maximum(left / count, 1.0))
                logs = logs + np.where(signed[:, None], _sign(ratio), 0.0)
            found[numbers] = logs
        return found

    def amplitudes_of(self, number: int, scale: int) -> Array:
        """Return the (k,) most probable amplitudes of a further hypothesis beside the model [the law's unit]."""
        for numbers, places, scales, inside, _ in self.evidence.batches:
            row = np.flatnonzero(numbers == number)
            if len(row):
                i = int(row[0])
                taken = self.across[places[i]] * scales[i][:, None]
                own = inside[i] - taken @ taken.T + np.eye(len(taken)) * SCALES[scale] ** -2.0
                score = (self.evidence.scores[places[i]] - self.across[places[i]] @ self.pull) * scales[i]
                return np.linalg.solve(own, score) * scales[i]
        raise KeyError(number)


def _sign(ratio: Array | float) -> Array:
    """Return how the evidence of an amplitude that must be positive differs: a half normal prior, by the normal."""
    return np.log(2.0) + log_ndtr(ratio)


@dataclass(frozen=True)
class Rival:
    """A hypothesis beside a model: log odds of adding it, its size charged, at its best scale."""

    odds: float
    chosen: Chosen


Refine = Callable[[Beside, Sequence[Rival]], None]
"""Adds the best of some hypotheses to the evidence with what is inside them refined beside a model."""

Only = Callable[[Hypothesis], bool]
"""Whether a hypothesis may come into a model."""

WITHIN, ROUGH, SHORT = 12.0, 0.2, 8
"""Tolerance: log odds below the best at which a hypothesis still competes; the share of the best's odds below them at
which one competes whose inner values lie on a grid, and how many of each do at most."""


def rivals(
    beside: Beside, refine: Refine | None = None, only: Only | None = None, within: float = WITHIN, most: int = SHORT
) -> list[Rival]:
    """Return the best hypotheses beside a model, one of each law and place, the best first."""
    evidence, found = beside.evidence, list[Rival]()
    known, rough = len(evidence.groups), list[Rival]()
    best = np.where(np.isfinite(beside.odds), beside.odds, -np.inf).max(axis=1)
    spots, top = set[object](), -np.inf
    for number in np.argsort(-best, kind="stable").tolist():
        if best[number] < -within or len(found) + len(rough) >= 4 * most:
            break
        hypothesis = evidence.groups[number].hypothesis
        if only is not None and not only(hypothesis):
            continue
        coarse = refine is not None and bool(hypothesis.one.fitted or hypothesis.one.searched)
        if hypothesis.spot in spots or best[number] < top - (max(within, ROUGH * top) if coarse else within):
            continue
        scale = int(beside.odds[number].argmax())
        odds = float(best[number]) - evidence.charge(number, beside.amplitudes_of(number, scale))
        spots.add(hypothesis.spot)
        (rough if coarse else found).append(Rival(odds, Chosen(number, scale)))
        top = max(top, odds)
    if refine is not None and rough:
        refine(beside, sorted(rough, key=lambda one: -one.odds)[:most])
        if len(evidence.groups) > known:
            return rivals(evidence.beside(beside.model), None, only, within, most)
    found = [one for one in (*found, *rough) if one.odds >= top - within]
    return sorted(found, key=lambda one: -one.odds)[:most]


def climbed(evidence: Evidence, model: Model = (), refine: Refine | None = None, most: int = MOST) -> Model:
    """Return the model that no addition, deletion or exchange of one hypothesis, or of a pair, makes more probable.

    Args:
        evidence: The hypotheses; refined ones are added.
        model: Where to begin.
        refine: Refines what is inside the best hypotheses before one is chosen; None to take them as they are.
        most: Hypotheses at most.
    """
    begun = evidence.log_posterior(model)
    model, value = _swept(evidence, model, begun, refine, most)
    again = True
    while again:
        again = False
        for pair in _sharing(evidence, model):
            rest = tuple(one for i, one in enumerate(model) if i not in pair)
            trial, found = rest, evidence.log_posterior(rest)
            for _ in pair:
                trial, found = _extended(evidence, trial, found, begun, refine, most)
            if found > value - WITHIN and set(trial) != set(model):
                trial, found = _swept(evidence, trial, begun, refine, most)
            if found > value + BETTER:
                model, value, again = trial, found, True
                break
    return model


def _extended(
    evidence: Evidence,
    model: Model,
    value: float,
    begun: float,
    refine: Refine | None,
    most: int,
) -> tuple[Model, float]:
    """Return the model with the hypothesis more that makes it most probable, or the model itself."""
    if len(model) >= most:
        return model, value
    for rival in rivals(evidence.beside(model), refine)[:2]:
        found = evidence.log_posterior((*model, rival.chosen))
        if found > value + max(BETTER, LINEAR * (found - begun)):
            return (*model, rival.chosen), found
    return model, value


def _swept(evidence: Evidence, model: Model, begun: float, refine: Refine | None, most: int) -> tuple[Model, float]:
    """Return a model, and its log posterior, that no one hypothesis more, less or exchanged makes more probable."""
    value, changed = evidence.log_posterior(model), True
    while changed:
        before = value
        model, value = _extended(evidence, model, value, begun, refine, most)
        for i in range(len(model) - 1, -1, -1):
            rest = (*model[:i], *model[i + 1 :])
            beside = evidence.beside(rest)
            trials = [(beside.log_posterior, rest)]
            for rival in rivals(beside, refine)[:2]:
                trial = (*model[:i], rival.chosen, *model[i + 1 :])
                trials.append((evidence.log_posterior(trial), trial))
            found, trial = max(trials, key=lambda one: one[0])
            if found > value + BETTER:
                model, value = trial, found
                break
        changed = value > before
    return model, value


def _sharing(evidence: Evidence, model: Model) -> list[tuple[int, int]]:
    """Return the pairs of a model of which either member takes over most when the other goes."""
    if len(model) < 2:
        return []
    whole = evidence.log_posterior(model)

    def worth(*gone: int) -> float:
        return whole - evidence.log_posterior(tuple(one for i, one in enumerate(model) if i not in gone))

    alone = [worth(i) for i in range(len(model))]
    shared = {pair: worth(*pair) - alone[pair[0]] - alone[pair[1]] for pair in combinations(range(len(model)), 2)}
    pairs = sorted((pair for pair in shared if shared[pair] > 1.0), key=lambda pair: -shared[pair])
    return pairs[:PAIRS]
