"""Which effects a campaign speaks for: the exact evidence of every set of hypotheses, in the linear problem of a fit.

A hypothesis is a group of columns X whose amplitudes are b ~ N(0, tau^2), with one tau of `SCALES` for the group. A
column is scaled so that an amplitude of 1 moves the target by 1 mm RMS before the projection. The columns A of all that
is fitted anyway are projected out with their priors (`armflex.trace.projection`), M = 1 - A N^-1 A', which leaves n
degrees of freedom (tr M). For a model S, a set of hypotheses with their scales, and readings y of which J0 = y'My is
left without any,

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
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, pairwise, takewhile
from typing import Self
from weakref import ref

import numpy as np
from scipy.linalg.lapack import dtrtri
from scipy.special import log_ndtr

from armflex.conventions import Array
from armflex.estimate.fit import THOROUGH
from armflex.trace.hypotheses import Hypothesis

SCALES = np.array([0.1, 0.3, 1.0, 3.0, 10.0, 30.0])
"""Prior: standard deviations tau of an amplitude, by how far it moves the target [mm]."""

MOST_EFFECTS = 24
"""Tolerance: hypotheses in a model at most."""

MOST_ROUNDS = 12
"""Tolerance: fits of the arm with what was found at most, and steps of what is refined."""

MOST_TRIED = 4
"""Tolerance: so many of the likeliest are tried: starts of a refinement, pairs that are taken out together, places of
products, and hypotheses that are added before the arm is fitted anew, since a linear problem is wrong where much is
missing."""

MOST_COMPETING = 40
"""Tolerance: hypotheses that compete for a place at most, and of waves, bumps and products of each kind."""

RANKED = 512
"""Tolerance: the best of a scan, among which an exchange is sought once a climb has changed the model."""

MODELS_HELD = 64
"""Tolerance: models whose evidence is held at a time."""

BETTER = THOROUGH.flat
"""Tolerance: rise of the log posterior below which a model, or what is inside it, stays: fits are no closer."""

LINEAR_ERROR = 0.02
"""Tolerance: share of what a climb has gained by which the linear problem may be wrong; what adds less is not added."""


def log_likelihood(squares: Array | float, freedom: float) -> Array:
    """Return f(J) of sums of squares J with so many degrees of freedom; see the head of this module."""
    noise = np.maximum(np.asarray(squares) / freedom, 1.0)
    return -0.5 * freedom * np.log(noise) - 0.5 * squares / noise


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
        first: Number of the first of its columns.
        scale: (k,) amplitude of the law that moves the target by 1 mm RMS, zero where it does not move it.
    """

    hypothesis: Hypothesis
    first: int
    scale: Array

    @property
    def places(self) -> np.ndarray:
        """(k,) numbers of its columns."""
        return np.arange(self.first, self.first + len(self.scale))


Batch = tuple[np.ndarray, np.ndarray, Array, Array, np.ndarray]
"""Groups of one size: numbers, (g, k) columns and scales, (g, k, k) scaled parts of G, and which have a sign."""


def batch_of(groups: Sequence[Group], numbers: np.ndarray, places: np.ndarray, inside: Array) -> Batch:
    """Return groups of one size with the (g, k) places of their columns and their (g, k, k) parts of G."""
    scale = np.array([one.scale for one in groups])
    signed = np.array([one.hypothesis.positive for one in groups])
    return numbers, places, scale, inside * scale[:, :, None] * scale[:, None, :], signed


def joined(some: Sequence[Batch]) -> Batch:
    """Return batches of one size as one."""
    numbers, places, scale, inside, signed = (np.concatenate(part) for part in zip(*some, strict=True))
    return numbers, places, scale, inside, signed


def batches_of(groups: Sequence[Group], inside: Callable[[np.ndarray], Array]) -> tuple[Batch, ...]:
    """Return groups by their size; `inside` has the (g, k, k) parts of G at (g, k) columns."""
    sizes, found = np.array([len(one.scale) for one in groups], dtype=int), []
    for size in np.unique(sizes).tolist():
        numbers = np.flatnonzero(sizes == size)
        some = [groups[i] for i in numbers.tolist()]
        places = np.array([one.places for one in some])
        found.append(batch_of(some, numbers, places, inside(places)))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Block:
    """Hypotheses that a scan goes through together.

    Attributes:
        first: Number of the first; batches number hypotheses and columns from those of the block.
        batches: They by their size.
        scores: (K,) products X'My of their columns.
        priors: (H, T) log prior probability of every hypothesis at each of its scales.
        kept: Which of the columns are gone through, and numbered by batches, where not all are.
    """

    first: int
    batches: tuple[Batch, ...]
    scores: Array
    priors: Array
    kept: np.ndarray | None = None

    @cached_property
    def where(self) -> dict[int, tuple[int, int]]:
        """Of every hypothesis the batch, and the place in it."""
        pairs = enumerate(numbers.tolist() for numbers, *_ in self.batches)
        return {number: (i, j) for i, numbers in pairs for j, number in enumerate(numbers)}

    @property
    def key(self) -> tuple[int, bool]:
        """By which it is known while it grows."""
        return self.first, self.kept is not None

    def narrowed(self, numbers: np.ndarray) -> Block:
        """Return the block with some of its hypotheses, under their numbers."""
        kept, batches, count = list[np.ndarray](), list[Batch](), 0
        for own, places, *rest in self.batches:
            some = np.isin(own, numbers)
            kept.append(places[some].ravel())
            places = count + np.arange(len(kept[-1])).reshape(-1, places.shape[1])
            count += len(kept[-1])
            scale, inside, signed = (one[some] for one in rest)
            batches.append((own[some], places, scale, inside, signed))
        columns = np.concatenate([np.zeros(0, dtype=int), *kept])
        return replace(self, batches=tuple(batches), scores=self.scores[columns], kept=columns)


def prior_of(some: Iterable[Group]) -> Array:
    """Return the (H, T) log prior probability of hypotheses at each of their scales, all equally likely."""
    priors = np.array([one.hypothesis.prior for one in some])
    return np.repeat(priors[:, None] - np.log(len(SCALES)), len(SCALES), axis=1)


class Evidence(ABC):
    """Hypotheses in the linear problem of a fit: everything that the evidence of a model is made of.

    Attributes:
        groups: All hypotheses.
        blocks: The same, in the order of their numbers; only the last one grows.
        objective: J0.
        freedom: Degrees of freedom n: readings less what is fitted to them anyway.
        constant: Log likelihood that all models share, by which states of a search differ.
    """

    groups: list[Group]
    blocks: list[Block]
    objective: float
    freedom: float
    constant: float = 0.0
    ranked: np.ndarray = np.zeros(0, dtype=int)
    """Numbers of the hypotheses that were among the best of any scan of all since a climb began."""

    @abstractmethod
    def among(self, places: np.ndarray) -> tuple[Array, Array]:
        """Return the (k, k) products X'MX of some columns with one another, and (k,) X'My."""

    @abstractmethod
    def gram(self, block: int, places: np.ndarray) -> Array:
        """Return the (K, k) products X'MX of all columns of a block with some columns."""

    def charge(self, number: int, amplitudes: Array) -> float:
        """Return what (k,) amplitudes of a hypothesis [the law's unit] count against it [nats]."""
        return 0.0

    def sized(self, number: int) -> Array | float:
        """Return the (T,) log of how much likelier a scale of a hypothesis is than where all are equally likely."""
        return 0.0

    def block_of(self, number: int) -> int:
        """Return the place of the block that a hypothesis is in."""
        return max(i for i, block in enumerate(self.blocks) if block.first <= number)

    def prior(self, number: int) -> Array:
        """Return the (T,) log prior probability of a hypothesis at each of its scales."""
        block = self.blocks[self.block_of(number)]
        return block.priors[number - block.first] + self.sized(number)

    @property
    def priors(self) -> Array:
        """(H, T) log prior probability of every hypothesis at each of its scales, but for what is `sized`."""
        return np.concatenate([one.priors for one in self.blocks])

    @cached_property
    def _known(self) -> dict[Model, Beside]:
        return {}

    def beside(self, model: Model) -> Beside:
        """Return the problem beside a model."""
        found = self._known.pop(model, None) or Beside(self, model)
        self._known[model] = found  # the last used last
        if len(self._known) > MODELS_HELD:
            del self._known[next(iter(self._known))]
        return found

    @cached_property
    def scanned(self) -> dict[tuple[int, bool], tuple[list, Array]]:
        """Of every block what it was last scanned beside, and how; see `Beside.across`."""
        return {}

    @abstractmethod
    def narrow(self, some: bool) -> None:
        """Scan only what is `ranked` from now on, or all."""

    def log_posterior(self, model: Model) -> float:
        """Return the log posterior probability of a model, but for a constant."""
        return self.beside(model).log_posterior

    def with_readings(self, scores: Array, objective: float) -> Self:
        """Return the same hypotheses with other readings: (K,) scores of all columns, and J0."""
        other = copy(self)
        for name in ("_known", "scanned"):
            vars(other).pop(name, None)
        pairs = zip(self.blocks, self.parted(scores), strict=True)
        other.blocks, other.objective = [replace(a, scores=b) for a, b in pairs], objective
        return other

    def parted(self, scores: Array) -> list[Array]:
        """Return (K, ...) scores of all columns block by block."""
        return np.split(scores, np.cumsum([len(one.scores) for one in self.blocks[:-1]]))


Reduced = tuple[list[Array], Array]
"""Of a block beside a model: (g, k, k) scaled information of every batch, and (K,) scores of all columns."""


class Beside:
    """All hypotheses beside a model, of a problem that whoever asks holds.

    Attributes:
        model: What is in it.
        places, scale: (k,) numbers of its columns and their scales.
        held: (k,) prior precisions of their scaled amplitudes.
        root: (k, k) Cholesky factor of Q.
        pull: (k,) root^-1 s_S.
        volume: log|D^1/2 Q D^1/2|.
    """

    def __init__(self, evidence: Evidence, model: Model) -> None:
        self._evidence, self.model = ref(evidence), model  # which holds this: memory is free as soon as it is dropped
        some = [evidence.groups[one.number] for one in model]
        self.places = np.concatenate([np.zeros(0, dtype=int), *(one.places for one in some)])
        self.scale = np.concatenate([np.zeros(0), *(one.scale for one in some)])
        self._ends = np.cumsum([0, *(len(one.places) for one in some)]).tolist()
        self.held = np.repeat([SCALES[one.scale] ** -2.0 for one in model], np.diff(self._ends))
        own, scores = evidence.among(self.places)
        own = own * self.scale * self.scale[:, None] + np.diag(self.held)
        self.root = np.asarray(np.linalg.cholesky(0.5 * (own + own.T)), float)
        self.inverse = dtrtri(self.root, lower=1)[0] if len(self.root) else self.root
        self.pull = self.inverse @ (scores * self.scale)
        self.volume = 2.0 * float(np.log(np.diag(self.root)).sum()) - float(np.log(self.held).sum())
        self._reduced: dict[tuple[int, bool], tuple[Block, Reduced]] = {}
        self._odds: dict[tuple[int, bool], tuple[Block, Array]] = {}

    @property
    def evidence(self) -> Evidence:
        """The problem."""
        found = self._evidence()
        assert found is not None
        return found

    @cached_property
    def left(self) -> float:
        """J_S."""
        return max(self.evidence.objective - float(self.pull @ self.pull), 1e-9 * self.evidence.objective)

    @property
    def noise(self) -> float:
        """Standard deviation of the readings over that stated, 1 or more."""
        return float(np.sqrt(max(self.left / self.evidence.freedom, 1.0)))

    @cached_property
    def covariance(self) -> Array:
        """(k, k) posterior covariance of the scaled amplitudes [mm^2]."""
        return self.noise**2 * self.inverse.T @ self.inverse

    @cached_property
    def amplitudes(self) -> tuple[Array, ...]:
        """(k,) most probable amplitudes of each hypothesis in the model [the law's unit]."""
        values = self.inverse.T @ self.pull * self.scale
        return tuple(values[a:b] for a, b in pairwise(self._ends))

    @cached_property
    def log_posterior(self) -> float:
        """Log posterior probability of the model, but for a constant."""
        evidence, found = self.evidence, 0.0
        values = self.inverse.T @ self.pull
        for one, amplitudes, first in zip(self.model, self.amplitudes, self._ends, strict=False):
            found += float(evidence.prior(one.number)[one.scale]) - evidence.charge(one.number, amplitudes)
            if evidence.groups[one.number].hypothesis.positive:
                found += float(_sign(values[first] / np.sqrt(self.covariance[first, first])))
        return found + float(log_likelihood(self.left, evidence.freedom)) - 0.5 * self.volume + evidence.constant

    @property
    def odds(self) -> Array:
        """(H, T) log odds of the model with each hypothesis at each scale more, over the model; nothing is charged."""
        return np.concatenate([self._odds_in(which) for which in range(len(self.evidence.blocks))])

    def odds_at(self, number: int) -> Array:
        """Return the (T,) log odds of a further hypothesis at each scale, as likely as that is; nothing is charged."""
        which = self.evidence.block_of(number)
        return self._odds_in(which)[number - self.evidence.blocks[which].first] + self.evidence.sized(number)

    def _odds_in(self, which: int) -> Array:
        block = self.evidence.blocks[which]
        if block.key not in self._odds or self._odds[block.key][0] is not block:
            odds = self.odds_of(block.batches, *self.reduced(which), len(block.priors)) + block.priors
            self._odds[block.key] = block, odds
        return self._odds[block.key][1]

    def across(self, which: int) -> Array:
        """Return (K, k) products of a block's columns with the scaled ones of the model, by the root's inverse.

        Squares of it are what the model takes of their information. Columns of what the last model begins with, too,
        stand as they are: a climb adds at the end, and takes out one hypothesis after the other from there.
        """
        block, size = self.evidence.blocks[which], len(self.places)
        own = [block, *zip(self.places.tolist(), self.held.tolist(), strict=True)]
        last, found = self.evidence.scanned.get(block.key, ([], np.empty((0, 0))))
        if len(found) != len(block.scores) or found.shape[1] < size:
            last, found = [], np.empty((len(block.scores), size + size // 2))
        first = max(sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(own, last, strict=False))) - 1, 0)
        if first < size:
            inverse = self.inverse[first:, first:]  # of a triangle's end the inverse is the end of its inverse
            before = found[:, :first] @ (inverse @ self.root[first:, :first]).T
            found[:, first:size] = self.evidence.gram(which, self.places[first:]) @ (inverse * self.scale[first:]).T
            found[:, first:size] -= before
        self.evidence.scanned[block.key] = own, found
        return found[:, :size]

    def reduced(self, which: int) -> Reduced:
        """Return what the model leaves of a block's information and scores."""
        block = self.evidence.blocks[which]
        if block.key not in self._reduced or self._reduced[block.key][0] is not block:
            across = self.across(which)
            self._reduced[block.key] = block, (reduced(block.batches, across), block.scores - across @ self.pull)
        return self._reduced[block.key][1]

    def odds_of(self, batches: Sequence[Batch], insides: Sequence[Array], scores: Array, most: int) -> Array:
        """Return the (H, T) log evidence that hypotheses add to the model at each scale; none where not in batches.

        Args:
            batches: Of all of them.
            insides, scores: What the model leaves of their information and of their columns' scores.
            most: H.
        """
        freedom = self.evidence.freedom
        found = np.full((most, len(SCALES)), -np.inf)
        here, tight = float(log_likelihood(self.left, freedom)), SCALES[:, None] ** -2.0
        for (numbers, places, scale, _, signed), inside in zip(batches, insides, strict=True):
            score = scores[places] * scale
            if places.shape[1] == 1:
                values, turned = np.maximum(inside[:, 0], 0.0), score
            else:
                values, axes = np.linalg.eigh(inside)
                values, turned = np.maximum(values, 0.0), np.einsum("gki,gk->gi", axes, score)
            held = values[:, None, :] + tight
            left = np.maximum(self.left - (turned[:, None, :] ** 2 / held).sum(axis=2), 1e-9 * self.left)
            logs = log_likelihood(left, freedom) - here - 0.5 * np.log(held / tight).sum(axis=2)
            if signed.any():
                own = turned[signed, None, 0] / np.sqrt(held[signed, :, 0] * np.maximum(left[signed] / freedom, 1.0))
                logs[signed] += _sign(own)
            found[numbers] = logs
        return found

    def rough(self, top: float) -> float:
        """Return the least log odds on a grid with which a hypothesis may come as near to some others as `WITHIN`."""
        freedom, here = self.evidence.freedom, float(log_likelihood(self.left, self.evidence.freedom))
        wanted = here + top - WITHIN  # of which log likelihood J is
        left = freedom * np.exp(-1.0 - 2.0 * wanted / freedom) if wanted < -0.5 * freedom else max(-2.0 * wanted, 0.0)
        lacking = (left + GRID_ERROR * self.left) / (1.0 + GRID_ERROR)
        return min(float(log_likelihood(lacking, freedom)) - here, top - WITHIN)

    def amplitudes_of(self, number: int, scale: int) -> Array:
        """Return the (k,) most probable amplitudes of a further hypothesis beside the model [the law's unit]."""
        which = self.evidence.block_of(number)
        block, (insides, scores) = self.evidence.blocks[which], self.reduced(which)
        batch, row = block.where[number - block.first]
        _, places, scales, *_ = block.batches[batch]
        own = insides[batch][row] + np.eye(places.shape[1]) * SCALES[scale] ** -2.0
        return np.linalg.solve(own, scores[places[row]] * scales[row]) * scales[row]


def reduced(batches: Sequence[Batch], across: Array) -> list[Array]:
    """Return (g, k, k) information of batches beside a model; see `Beside.across`."""
    found, squares = [], np.einsum("km,km->k", across, across)
    for _, places, scale, inside, _ in batches:
        if places.shape[1] == 1:
            found.append(inside - (squares[places] * scale**2)[:, :, None])
        else:
            own = across[places] * scale[:, :, None]
            found.append(inside - own @ own.transpose(0, 2, 1))
    return found


def _sign(ratio: Array | float) -> Array:
    """Return how the evidence of an amplitude that must be positive differs: a half normal prior, by the normal."""
    return np.log(2.0) + log_ndtr(ratio)


@dataclass(frozen=True)
class Rival:
    """A hypothesis beside a model: log odds of adding it, all charged, at its best scale."""

    odds: float
    chosen: Chosen


Refine = Callable[[Beside, Sequence[Rival]], None]
"""Adds the best of some hypotheses to the evidence with what is inside them refined beside a model."""

Only = Callable[[Hypothesis], bool]
"""Whether a hypothesis may come into a model."""

WITHIN, GRID_ERROR, SHORT = 12.0, 0.1, 8
"""Tolerance: log odds below the best at which a hypothesis still competes; the share of what a hypothesis explains that
it may lack because its inner values lie on a grid (a wave a sixth of a period off lacks 9 %), and how many of each
compete at most."""


def rivals(beside: Beside, refine: Refine | None = None, only: Only | None = None, most: int = SHORT) -> list[Rival]:
    """Return the best hypotheses beside a model, one of each law and place, the best first."""
    evidence, found = beside.evidence, list[Rival]()
    known, rough, spots = len(evidence.groups), list[Rival](), set[tuple]()
    odds = beside.odds
    best = np.where(np.isfinite(odds), odds, -np.inf).max(axis=1)
    some = np.flatnonzero(best >= -WITHIN)
    order = some[np.argsort(-best[some], kind="stable")]
    evidence.ranked = np.union1d(evidence.ranked, order[:RANKED])
    top, least = -WITHIN, beside.rough(-WITHIN)
    for number in order.tolist():
        if len(found) + len(rough) >= 4 * most or best[number] < least:
            break
        hypothesis = evidence.groups[number].hypothesis
        if hypothesis.spot in spots or (only is not None and not only(hypothesis)):
            continue
        spots.add(hypothesis.spot)
        coarse = refine is not None and bool(hypothesis.one.fitted or hypothesis.one.searched)
        if not coarse and best[number] < top - WITHIN:
            continue
        own = odds[number] + evidence.sized(number)
        scale = int(own.argmax())
        charged = float(own[scale]) - evidence.charge(number, beside.amplitudes_of(number, scale))
        (rough if coarse else found).append(Rival(charged, Chosen(number, scale)))
        if charged > top:
            top, least = charged, beside.rough(charged)
    if refine is not None and rough:
        refine(beside, sorted(rough, key=lambda one: -one.odds)[:most])
        if len(evidence.groups) > known:
            return rivals(evidence.beside(beside.model), None, only, most)
    found = [one for one in (*found, *rough) if one.odds >= top - WITHIN]
    return sorted(found, key=lambda one: -one.odds)[:most]


def climbed(evidence: Evidence, model: Model = (), refine: Refine | None = None, most: int = MOST_EFFECTS) -> Model:
    """Return the model that no addition, deletion or exchange of one hypothesis, or of a pair, makes more probable.

    Nor does one hypothesis for each of two drives make it so in place of one for all drives.

    Args:
        evidence: The hypotheses; refined ones are added.
        model: Where to begin.
        refine: Refines what is inside the best hypotheses before one is chosen; None to take them as they are.
        most: Hypotheses at most.
    """
    begun, first, again = evidence.log_posterior(model), set(model), True
    evidence.ranked = np.zeros(0, dtype=int)
    model, value = _swept(evidence, model, begun, refine, most)
    while again:
        again = False
        families = [(i,) for i, one in enumerate(model) if evidence.groups[one.number].hypothesis.family]
        for gone in [*_sharing(evidence, model), *families]:
            rest = tuple(one for i, one in enumerate(model) if i not in gone)
            trial, found = rest, evidence.log_posterior(rest)
            evidence.narrow(set(model) != first)
            for _ in range(2):
                only = _is_single if len(gone) == 1 else None
                trial, found = _extended(evidence, trial, found, begun, refine, most, only)
            if found > value - WITHIN and set(trial) != set(model):
                trial, found = _swept(evidence, trial, begun, refine, most)
            if found > value + BETTER:
                model, value, again = trial, found, True
                break
    evidence.narrow(False)
    return model


def _extended(
    evidence: Evidence,
    model: Model,
    value: float,
    begun: float,
    refine: Refine | None,
    most: int,
    only: Only | None = None,
) -> tuple[Model, float]:
    """Return the model with the hypothesis more that makes it most probable, or the model itself."""
    if len(model) >= most:
        return model, value
    for rival in rivals(evidence.beside(model), refine, only)[:2]:
        found = evidence.log_posterior((*model, rival.chosen))
        if found > value + max(BETTER, LINEAR_ERROR * (found - begun)):
            return (*model, rival.chosen), found
    return model, value


def _is_single(hypothesis: Hypothesis) -> bool:
    return not hypothesis.family


def _swept(evidence: Evidence, model: Model, begun: float, refine: Refine | None, most: int) -> tuple[Model, float]:
    """Return a model, and its log posterior, that no one hypothesis more, less or exchanged makes more probable."""
    value, i, tried, first = evidence.log_posterior(model), 0, -1, model
    while tried < len(model):  # one after the other, and round again until none can go or be exchanged
        evidence.narrow(tried >= 0 and model is not first)
        if tried < 0:
            longer, value = _extended(evidence, model, value, begun, refine, most)
            model, tried = longer, 0 if len(longer) == len(model) else -1
            continue
        i, tried = (i if 0 < i <= len(model) else len(model)) - 1, tried + 1
        rest = (*model[:i], *model[i + 1 :])
        beside = evidence.beside(rest)
        trials = [(beside.log_posterior, rest)]
        for rival in rivals(beside, refine)[:2]:
            trial = (*model[:i], rival.chosen, *model[i + 1 :])
            trials.append((evidence.log_posterior(trial), trial))
        found, trial = max(trials, key=lambda one: one[0])
        if found > value + BETTER:
            model, value, tried = trial, found, -1
    return model, value


def _sharing(evidence: Evidence, model: Model) -> list[tuple[int, int]]:
    """Return the pairs of a model of which either member takes over most when the other goes."""
    if len(model) < 2:
        return []
    beside = evidence.beside(model)
    own = np.split(np.arange(len(beside.places)), np.cumsum([len(one) for one in beside.amplitudes[:-1]]))

    def worth(*gone: int) -> float:
        axes = beside.inverse[:, np.concatenate([own[i] for i in gone])]
        inside, values = axes.T @ axes, axes.T @ beside.pull
        left = beside.left + float(values @ np.linalg.solve(inside, values))
        fall = log_likelihood(beside.left, evidence.freedom) - log_likelihood(left, evidence.freedom)
        return float(fall + 0.5 * np.linalg.slogdet(inside)[1])

    alone = [worth(i) for i in range(len(model))]
    shared = {pair: worth(*pair) - alone[pair[0]] - alone[pair[1]] for pair in combinations(range(len(model)), 2)}
    pairs = sorted((pair for pair in shared if shared[pair] > 1.0), key=lambda pair: -shared[pair])
    return pairs[:MOST_TRIED]
