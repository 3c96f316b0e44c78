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
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, pairwise
from typing import NamedTuple
from weakref import WeakKeyDictionary, ref

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal, get_lapack_funcs
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
"""Tolerance: fits of the arm with what was found at most, a third of the states of a search, and steps of what is
refined."""

MOST_TRIED = 4
"""Tolerance: so many of the likeliest are tried: starts of a refinement, pairs that are taken out together, places of
products, and hypotheses that are added before the arm is fitted anew, since a linear problem is wrong where much is
missing."""

MOST_COMPETING = 40
"""Tolerance: hypotheses that compete for a place at most, and of waves, bumps and products of each kind."""

MODELS_HELD = 64
"""Tolerance: models whose evidence is held at a time."""

WITHIN, GRID_ERROR, SHORT = 12.0, 0.1, 8
"""Tolerance: log odds below the best at which a hypothesis still competes; the share of what a hypothesis explains that
it may lack because its inner values lie on a grid (a wave a sixth of a period off lacks 9 %), and how many of each
compete at most."""

BETTER = THOROUGH.flat
"""Tolerance: rise of the log posterior below which a model, or what is inside it, stays: fits are no closer."""


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


def without(model: Model, *gone: int) -> Model:
    """Return a model without the hypotheses at some places."""
    return tuple(chosen for i, chosen in enumerate(model) if i not in gone)


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


class Batch(NamedTuple):
    """Groups of one size: numbers, (g, k) columns, (g, k, k) parts of G, and which have a sign."""

    numbers: np.ndarray
    places: np.ndarray
    inside: Array
    signed: np.ndarray


def batches_of(groups: Sequence[Group], inside: Callable[[np.ndarray], Array]) -> tuple[Batch, ...]:
    """Return groups by their size; `inside` has the (g, k, k) parts of G at (g, k) columns."""
    sizes, batches = np.array([len(group.scale) for group in groups], dtype=int), []
    for size in np.unique(sizes).tolist():
        numbers = np.flatnonzero(sizes == size)
        alike = [groups[i] for i in numbers.tolist()]
        places = np.array([group.places for group in alike])
        batches.append(Batch(numbers, places, inside(places), np.array([group.hypothesis.positive for group in alike])))
    return tuple(batches)


@dataclass(frozen=True, eq=False)
class ScanBlock:
    """Hypotheses that a scan goes through together.

    Attributes:
        batches: They by their size; hypotheses and columns are numbered from the first of the block.
        scores: (K,) products X'My of their columns.
        priors: (H, T) log prior probability of every hypothesis at each of its scales.
        gram: Returns the (K, k) products X'MX of their columns with some of all columns.
        axes: By size, eigenvalues and -vectors of a batch beside nothing: whatever is read, they are the same.
    """

    batches: tuple[Batch, ...]
    scores: Array
    priors: Array
    gram: Callable[[np.ndarray], Array]
    axes: dict[int, tuple[Array, Array]] = field(default_factory=dict, repr=False)

    def joined(self, more: ScanBlock, gram: Callable[[np.ndarray], Array]) -> ScanBlock:
        """Return this block with another behind it."""
        by_size = {batch.places.shape[1]: batch for batch in self.batches}
        for numbers, places, *rest in more.batches:
            batch = Batch(numbers + len(self.priors), places + len(self.scores), *rest)
            if before := by_size.get(places.shape[1]):
                batch = Batch(*map(np.concatenate, zip(before, batch, strict=True)))
            by_size[places.shape[1]] = batch
        scores, priors = np.append(self.scores, more.scores), np.concatenate([self.priors, more.priors])
        return ScanBlock(tuple(by_size.values()), scores, priors, gram)


def prior_of(groups: Iterable[Group]) -> Array:
    """Return the (H, T) log prior probability of hypotheses at each of their scales, all equally likely."""
    priors = np.array([group.hypothesis.prior for group in groups], dtype=float)
    return np.repeat(priors[:, None] - np.log(len(SCALES)), len(SCALES), axis=1)


class Evidence(ABC):
    """Hypotheses in the linear problem of a fit: everything that the evidence of a model is made of.

    Attributes:
        groups: All hypotheses.
        blocks: The same, in the order of their numbers; only the last one grows.
        objective: J0.
        freedom: Degrees of freedom n: readings less what is fitted to them anyway.
        constant: Log likelihood that all models share, by which states of a search differ.
        error: Share of what a climb has gained by which the linear problem may be wrong; what adds less is not added.
        doubled: Variance of how often a reading counts, of a resample. Every amplitude that the readings determine is
            expected to gain half as many nats by noise that counts twice, which are taken off.
    """

    groups: list[Group]
    blocks: list[ScanBlock]
    objective: float
    freedom: float
    error: float
    constant: float = 0.0
    doubled: float = 0.0

    @abstractmethod
    def among(self, places: np.ndarray) -> tuple[Array, Array]:
        """Return the (k, k) products X'MX of some columns with one another, and (k,) X'My."""

    def charge(self, number: int, amplitudes: Array) -> float:
        """Return what (k,) amplitudes of a hypothesis [the law's unit] count against it [nats]."""
        return 0.0

    def charge_beside(self, beside: Beside, number: int, scale: int) -> float:
        """Return the `charge` of a further hypothesis at its most probable amplitudes beside a model [nats]."""
        return 0.0

    def sized(self, number: int) -> Array | float:
        """Return the (T,) log of how much likelier a scale of a hypothesis is than where all are equally likely."""
        return 0.0

    def block_of(self, number: int) -> tuple[ScanBlock, int]:
        """Return the block that a hypothesis is in, and its number there."""
        for block in self.blocks[:-1]:
            if number < len(block.priors):
                return block, number
            number -= len(block.priors)
        return self.blocks[-1], number

    def prior(self, number: int) -> Array:
        """Return the (T,) log prior probability of a hypothesis at each of its scales."""
        block, place = self.block_of(number)
        return block.priors[place] + self.sized(number)

    @property
    def priors(self) -> Array:
        """(H, T) log prior probability of every hypothesis at each of its scales, but for what is `sized`."""
        return np.concatenate([block.priors for block in self.blocks])

    @cached_property
    def _known(self) -> dict[Model, Beside]:
        return {}

    @cached_property
    def across(self) -> dict[Beside, WeakKeyDictionary[ScanBlock, Array]]:
        """What `Beside.across` holds."""
        return {}

    def beside(self, model: Model) -> Beside:
        """Return the problem beside a model."""
        beside = self._known.pop(model, None) or Beside(self, model)
        self._known[model] = beside  # the last used last
        if len(self._known) > MODELS_HELD:
            del self._known[next(iter(self._known))]
        return beside

    def log_posterior(self, model: Model) -> float:
        """Return the log posterior probability of a model, but for a constant."""
        return self.beside(model).log_posterior


class Beside:
    """All hypotheses beside a model, of a problem that whoever asks holds.

    Attributes:
        model: What is in it.
        places: (k,) numbers of its columns.
        held: (k,) prior precisions of their scaled amplitudes.
        root: (k, k) Cholesky factor of Q.
        pull: (k,) root^-1 s_S.
        volume: log|D^1/2 Q D^1/2|.
    """

    def __init__(self, evidence: Evidence, model: Model) -> None:
        self._evidence, self.model = ref(evidence), model  # which holds this: memory is free as soon as it is dropped
        groups = [evidence.groups[chosen.number] for chosen in model]
        self.places = np.concatenate([np.zeros(0, dtype=int), *(group.places for group in groups)])
        self._ends = np.cumsum([0, *(len(group.places) for group in groups)]).tolist()
        self.held = np.repeat([SCALES[chosen.scale] ** -2.0 for chosen in model], np.diff(self._ends))
        information, scores = evidence.among(self.places)
        information = information + np.diag(self.held)
        self.root = np.asarray(np.linalg.cholesky(0.5 * (information + information.T)), float)
        self.inverse = dtrtri(self.root, lower=1)[0] if len(self.root) else self.root
        self.pull = self.inverse @ scores
        self.volume = 2.0 * float(np.log(np.diag(self.root)).sum()) - float(np.log(self.held).sum())
        self._whole: tuple[Beside, Array] | None = None
        self._reduced = WeakKeyDictionary[ScanBlock, tuple[list[Array], Array]]()
        self._odds = WeakKeyDictionary[ScanBlock, Array]()

    @property
    def evidence(self) -> Evidence:
        """The problem."""
        evidence = self._evidence()
        assert evidence is not None
        return evidence

    @cached_property
    def left(self) -> float:
        """J_S."""
        return max(self.evidence.objective - float(self.pull @ self.pull), 1e-9 * self.evidence.objective)

    @property
    def noise(self) -> float:
        """Standard deviation of the readings over that stated, 1 or more."""
        return float(np.sqrt(max(self.left / self.evidence.freedom, 1.0)))

    @cached_property
    def values(self) -> Array:
        """(k,) most probable scaled amplitudes of all hypotheses in the model."""
        return self.inverse.T @ self.pull

    @property
    def own(self) -> tuple[slice, ...]:
        """Places of each hypothesis among `places`."""
        return tuple(slice(a, b) for a, b in pairwise(self._ends))

    @property
    def amplitudes(self) -> tuple[Array, ...]:
        """The same for each hypothesis [the law's unit]."""
        groups = self.evidence.groups
        return tuple(
            self.values[place] * groups[chosen.number].scale for chosen, place in zip(self.model, self.own, strict=True)
        )

    @cached_property
    def log_posterior(self) -> float:
        """Log posterior probability of the model, but for a constant."""
        evidence, prior = self.evidence, 0.0
        for chosen, amplitudes, first in zip(self.model, self.amplitudes, self._ends, strict=False):
            prior += float(evidence.prior(chosen.number)[chosen.scale]) - evidence.charge(chosen.number, amplitudes)
            if evidence.groups[chosen.number].hypothesis.positive:
                std = self.noise * float(np.linalg.norm(self.inverse[:, first]))
                prior += float(_sign(float(self.inverse[:, first] @ self.pull) / std))
        determined = len(self.places) - float(self.held @ (self.inverse**2).sum(axis=0))
        prior += evidence.constant - 0.5 * evidence.doubled * determined
        return prior + float(log_likelihood(self.left, evidence.freedom)) - 0.5 * self.volume

    @property
    def odds(self) -> Array:
        """(H, T) log odds of the model with each hypothesis at each scale more, over the model; nothing is charged."""
        return np.concatenate([self.odds_in(block) for block in self.evidence.blocks])

    def odds_at(self, number: int) -> Array:
        """Return the (T,) log odds of a further hypothesis at each scale, as likely as that is; nothing is charged."""
        block, place = self.evidence.block_of(number)
        return self.odds_in(block)[place] + self.evidence.sized(number)

    def odds_in(self, block: ScanBlock) -> Array:
        """Return the `odds` of a block's hypotheses."""
        if block in self._odds:
            return self._odds[block]
        freedom, (insides, scores) = self.evidence.freedom, self.reduced(block)
        odds = np.empty(block.priors.shape)
        here, tight = float(log_likelihood(self.left, freedom)), SCALES[:, None] ** -2.0
        axes_of = {} if self.model else block.axes
        for (numbers, places, _, signed), inside in zip(block.batches, insides, strict=True):
            score, size = scores[places], places.shape[1]
            if size > 1 and len(numbers) == 1:  # a family, most often: eigenvectors of its many columns take long
                odds[numbers[0]] = self._likelihood_of_one(inside[0], score[0]) - here
                continue
            if size == 1:
                values, turned = np.maximum(inside[:, 0], 0.0), score
            else:
                values, axes = axes_of[size] if size in axes_of else axes_of.setdefault(size, np.linalg.eigh(inside))
                values, turned = np.maximum(values, 0.0), np.einsum("gki,gk->gi", axes, score)
            held = values[:, None, :] + tight
            left = np.maximum(self.left - (turned[:, None, :] ** 2 / held).sum(axis=2), 1e-9 * self.left)
            logs = log_likelihood(left, freedom) - here - 0.5 * np.log(held / tight).sum(axis=2)
            logs -= 0.5 * self.evidence.doubled * (values[:, None, :] / held).sum(axis=2)
            if signed.any():
                std = np.sqrt(held[signed, :, 0] * np.maximum(left[signed] / freedom, 1.0))
                logs[signed] += _sign(turned[signed, None, 0] / std)
            odds[numbers] = logs
        self._odds[block] = odds + block.priors
        return self._odds[block]

    def _likelihood_of_one(self, inside: Array, score: Array) -> Array:
        """Return the (T,) log likelihood with a further hypothesis at each scale.

        In the basis of Lanczos that begins with the score the information is tridiagonal.

        Args:
            inside: (k, k) what the model leaves of the information of its columns.
            score: (k,) and of their products with the readings.
        """
        bordered = np.zeros((len(score) + 1, len(score) + 1))
        bordered[1:, 1:], bordered[1:, 0] = inside, score
        tridiagonal, solved = get_lapack_funcs(("sytrd", "ptsv"), (bordered,))
        _, diagonal, beside, *_ = tridiagonal(bordered, lower=1)
        length, diagonal, beside, first = beside[0], diagonal[1:], beside[1:], np.eye(len(score), 1)
        held = SCALES**-2.0
        values = np.maximum(eigvalsh_tridiagonal(diagonal, beside), 0.0) + held[:, None]
        pulls = [length**2 * float(solved(diagonal + least, beside, first)[2][0, 0]) for least in held.tolist()]
        left = np.maximum(self.left - np.array(pulls), 1e-9 * self.left)
        logs = log_likelihood(left, self.evidence.freedom) - 0.5 * np.log(values / held[:, None]).sum(axis=1)
        return logs - 0.5 * self.evidence.doubled * (1.0 - held[:, None] / values).sum(axis=1)

    def without(self, place: int) -> Beside:
        """Return the problem beside the model without one hypothesis, which a scan of the whole model makes quick."""
        fewer = self.evidence.beside(without(self.model, place))
        self._whole = None  # what of itself is scanned from now on is scanned directly: no chain of models is held
        if fewer.model and fewer._whole is None:
            fewer._whole = self, self.inverse[:, slice(*self._ends[place : place + 2])]
        return fewer

    def reduced(self, block: ScanBlock) -> tuple[list[Array], Array]:
        """Return what the model leaves of the (g, k, k) information of every batch, and of the (K,) scores."""
        if block not in self._reduced:
            if self._whole is None:
                insides, scores, sign = [batch.inside for batch in block.batches], block.scores, -1.0
                across, pull = self.across(block), self.pull
            else:  # what the hypothesis that is gone took of them, given the rest, is left again
                (whole, axes), sign = self._whole, 1.0
                insides, scores = whole.reduced(block)
                unit = axes @ np.linalg.inv(np.linalg.cholesky(axes.T @ axes)).T
                across, pull = whole.across(block) @ unit, unit.T @ whole.pull
            squares, left = sign * np.einsum("km,km->k", across, across), list[Array]()
            for (_, places, *_), inside in zip(block.batches, insides, strict=True):
                if places.shape[1] == 1:
                    left.append(inside + squares[places][:, :, None])
                else:
                    products = across[places]
                    left.append(inside + sign * products @ products.transpose(0, 2, 1))
            self._reduced[block] = left, scores + sign * across @ pull
        return self._reduced[block]

    def across(self, block: ScanBlock) -> Array:
        """Return (K, k) products of a block's columns with those of the model, by the root's inverse.

        Squares of it are what the model takes of their information. It is held of the last model that was asked.
        """
        held = self.evidence.across
        if self not in held:
            held.clear()
        products = held.setdefault(self, WeakKeyDictionary[ScanBlock, Array]())
        if block not in products:
            products[block] = block.gram(self.places) @ self.inverse.T
        return products[block]

    def rough(self, top: float, within: float = WITHIN) -> float:
        """Return the least log odds on a grid with which a hypothesis may come so near to some others."""
        freedom, here = self.evidence.freedom, float(log_likelihood(self.left, self.evidence.freedom))
        wanted = here + top - within  # of which log likelihood J is
        left = freedom * np.exp(-1.0 - 2.0 * wanted / freedom) if wanted < -0.5 * freedom else max(-2.0 * wanted, 0.0)
        lacking = (left + GRID_ERROR * self.left) / (1.0 + GRID_ERROR)
        return min(float(log_likelihood(lacking, freedom)) - here, top - within)

    def amplitudes_of(self, number: int, scale: int) -> Array:
        """Return the (k,) most probable amplitudes of a further hypothesis beside the model [the law's unit]."""
        block, place = self.evidence.block_of(number)
        insides, scores = self.reduced(block)
        for (numbers, places, *_), inside in zip(block.batches, insides, strict=True):
            for row in np.flatnonzero(numbers == place):
                whole = inside[row] + np.eye(places.shape[1]) * SCALES[scale] ** -2.0
                return np.linalg.solve(whole, scores[places[row]]) * self.evidence.groups[number].scale
        raise KeyError(number)


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


def rivals(
    beside: Beside,
    refine: Refine | None = None,
    only: Only | None = None,
    most: int = SHORT,
    within: float = WITHIN,
) -> list[Rival]:
    """Return the hypotheses beside a model whose log odds are `within` the best, one of each law and place."""
    evidence, exact, rough, spots = beside.evidence, list[Rival](), list[Rival](), set[tuple]()
    count = len(evidence.groups)
    odds = beside.odds
    best = np.where(np.isfinite(odds), odds, -np.inf).max(axis=1)
    near = np.flatnonzero(best >= -within)
    order = near[np.argsort(-best[near], kind="stable")]
    top, least = -within, beside.rough(-within, within)
    for number in order.tolist():
        if len(exact) + len(rough) >= 4 * most or best[number] < least:
            break
        hypothesis = evidence.groups[number].hypothesis
        if hypothesis.spot in spots or (only is not None and not only(hypothesis)):
            continue
        spots.add(hypothesis.spot)
        coarse = refine is not None and bool(hypothesis.one.fitted or hypothesis.one.searched)
        if not coarse and best[number] < top - within:
            continue
        of_scales = odds[number] + evidence.sized(number)
        scale = int(of_scales.argmax())
        charged = float(of_scales[scale]) - evidence.charge_beside(beside, number, scale)
        (rough if coarse else exact).append(Rival(charged, Chosen(number, scale)))
        if charged > top:
            top, least = charged, beside.rough(charged, within)
    if refine is not None and rough:
        least = beside.rough(top, min(within, WITHIN))  # what is further off competes as it is on the grid
        refine(beside, [rival for rival in sorted(rough, key=lambda rival: -rival.odds)[:most] if rival.odds >= least])
        if len(evidence.groups) > count:
            return rivals(evidence.beside(beside.model), None, only, most, within)
    likely = [rival for rival in (*exact, *rough) if rival.odds >= top - within]
    return sorted(likely, key=lambda rival: -rival.odds)[:most]


def climbed(evidence: Evidence, model: Model = (), refine: Refine | None = None, most: int = MOST_EFFECTS) -> Model:
    """Return the model that no addition, deletion or exchange of one hypothesis, or of a pair, makes more probable.

    It begins with a model and has so many hypotheses at most; those that are refined are added to the evidence.
    """
    worth, begun = evidence.log_posterior, evidence.log_posterior(model)

    def extended(model: Model) -> Model:
        for rival in rivals(evidence.beside(model), refine)[:2] if len(model) < most else ():
            longer = (*model, rival.chosen)
            if worth(longer) > worth(model) + max(BETTER, evidence.error * (worth(longer) - begun)):
                return longer
        return model

    def swept(model: Model) -> Model:  # one after the other, and round again until none can go or be exchanged
        i, tried = 0, -1
        while tried < len(model):
            if tried < 0:
                longer = extended(model)
                model, tried = longer, 0 if longer is model else -1
                continue
            i, tried = (i if 0 < i <= len(model) else len(model)) - 1, tried + 1
            others = rivals(evidence.beside(model).without(i), refine)[:2]
            trials = [without(model, i), *((*model[:i], other.chosen, *model[i + 1 :]) for other in others)]
            trial = max(trials, key=worth)
            if worth(trial) > worth(model) + BETTER:
                model, tried = trial, -1
        return model

    model = swept(model)
    pairs = _sharing(evidence, model)
    while pairs:
        trial = extended(extended(without(model, *pairs.pop(0))))
        if worth(trial) > worth(model) - WITHIN and set(trial) != set(model):
            trial = swept(trial)
        if worth(trial) > worth(model) + BETTER:
            model, pairs = trial, _sharing(evidence, trial)
    return model


def _sharing(evidence: Evidence, model: Model) -> list[tuple[int, int]]:
    """Return the pairs of a model of which either member takes over most when the other goes."""
    if len(model) < 2:
        return []
    beside = evidence.beside(model)

    def worth(*gone: int) -> float:
        axes = np.hstack([beside.inverse[:, beside.own[i]] for i in gone])
        inside, values = axes.T @ axes, axes.T @ beside.pull
        left = beside.left + float(values @ np.linalg.solve(inside, values))
        fall = log_likelihood(beside.left, evidence.freedom) - log_likelihood(left, evidence.freedom)
        return float(fall + 0.5 * np.linalg.slogdet(inside)[1])

    alone = [worth(i) for i in range(len(model))]
    shared = {pair: worth(*pair) - alone[pair[0]] - alone[pair[1]] for pair in combinations(range(len(model)), 2)}
    pairs = sorted((pair for pair in shared if shared[pair] > 1.0), key=lambda pair: -shared[pair])
    return pairs[:MOST_TRIED]
