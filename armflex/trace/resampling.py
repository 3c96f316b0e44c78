"""Bootstrap resamples of a campaign in parts (poses, regions, times), so that no probability is overconfident.

A posterior is calibrated only if some hypothesis is true and readings scatter independently. Where something is missing
that no hypothesis describes, neighbours share it: the log evidence of one model over another differs between parts of
a campaign by more than readings scatter, and every further row makes the least wrong name more certain. The average of
the posterior over bootstrap resamples, the bagged posterior, is certain of what resamples agree on (Huggins and Miller
2023, "Reproducible model selection using bagged posteriors", Bayesian Analysis 18).

A resample has as many parts as there are, drawn with replacement, where parts differ by more than chance allows: of
names that halves of measured campaigns are sure of, those that the other half has, too, are as many as is stated only
so. Where they do not it has twice as many, each of which counts half: less is repeated by chance, and nothing shows
that the model is true. In between the probability of so large a difference by chance decides.

Which parts are drawn follows from what they show. Let residuals of two models differ by d. A reading with the error e,
predicted from other folds with everything chosen and fitted without its own, changes the log evidence of one model over
the other by d e + d^2 / 2. Sums of that over each of P parts have the scatter v, and where the model is true and
readings scatter independently they have s. Those parts are drawn of which v / s is largest, poses where none is larger
than by chance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, chdtri

from armflex.conventions import Array
from armflex.estimate.held_out import PARTS, POSE_FOLDS, apart_folds
from armflex.parameters import DOUBT
from armflex.trace.screen import Dense
from armflex.trace.selection import MOST_TRIED, WITHIN, Model, rivals, without
from armflex.trace.state import State
from armflex.trace.validate import Folds

RESAMPLES = 50
"""Tolerance: resamples of a campaign, a fifth where all is sure; an average over them is off by 0.07 at most (one
standard error)."""

POSES = "poses"


@dataclass(frozen=True, eq=False)
class Resampled:
    """How often the readings of a campaign count in its resamples.

    Attributes:
        by: What is drawn: 'poses', 'parts of joint space', 'parts of time' or 'sessions'.
        parts: (M,) number of that in every row.
        mismatch: v / s of it, divided by its 95 % quantile under chance; see the head of this module.
        times: (R, n) how often every reading counts, 1 on average.
    """

    by: str
    parts: np.ndarray
    mismatch: float
    times: Array

    @property
    def few(self) -> Array:
        """A fifth of them, which are enough for what is sure."""
        return self.times[: RESAMPLES // 5]


def resampled(evidence: Dense, own: Model, parted: Mapping[str, np.ndarray], poses: Folds, seed: int = 0) -> Resampled:
    """Return resamples of a campaign by the parts of it that a model foresees worst.

    Args:
        evidence: What competes.
        own: The model, of `evidence`.
        parted: (M,) part of every row, for each way to part them; see `parted_by`.
        poses: The same problem in folds of poses.
        seed: Of what is drawn.
    """
    noise, here = evidence.beside(own).noise, evidence.left(own)
    apart = [evidence.left(other) - here for other in _others(evidence, own)]
    apart = [one for one in apart if one @ one > 0.0]
    by, most, drawn, by_chance = POSES, 1.0, parted[POSES], 1.0
    count = len(here) // len(drawn)
    for name, parts in parted.items() if apart and len(set(drawn)) >= POSE_FOLDS else ():
        folds = poses if name == POSES else Folds(evidence, parts % POSE_FOLDS, own)
        freedom = int(parts.max())
        ratio = float(np.median(_mismatches(folds, apart, np.repeat(parts, count), noise)))
        if (beyond := ratio * freedom / float(chdtri(freedom, DOUBT))) > most:
            by, most, drawn = name, beyond, parts
            by_chance = float(chdtrc(freedom, ratio * freedom)) / DOUBT
    number = int(drawn.max()) + 1
    size = round(number * (1.0 + by_chance))
    rng, draws = np.random.default_rng(seed), list[Array]()
    for _ in range(5):  # each part as often as another in a fifth of them: their mean is the campaign
        parts = rng.permutation(np.resize(rng.permutation(number), RESAMPLES // 5 * size))
        draws += [np.bincount(part, minlength=number) for part in parts.reshape(-1, size)]
    return Resampled(by, drawn, most, np.repeat((np.array(draws) * number / size)[:, drawn], count, axis=1))


def parted_by(state: State) -> dict[str, np.ndarray]:
    """Return (M,) the part of every row, for each way to part a campaign; rows of a pose stay together."""
    first, count = np.unique(state.groups, return_index=True)[1], 4 * PARTS
    found, sessions = {POSES: state.groups}, np.unique(state.sessions, return_inverse=True)[1]
    if len(first) >= 2 * count:
        found["parts of joint space"] = apart_folds(state.measurements.q[state.rows[first]], count)[state.groups]
        found["parts of time"] = (np.argsort(np.argsort(first)) * count // len(first))[state.groups]
    return found | ({"sessions": sessions} if sessions.max() + 1 >= count else {})


def _others(evidence: Dense, own: Model) -> Iterator[Model]:
    """Yield models that one has to be preferred to: without an effect, with another in its place, with one more."""
    for i in range(len(own)):
        yield without(own, i)
        for rival in rivals(evidence.beside(own).without(i), most=MOST_TRIED, within=4.0 * WITHIN):
            if rival.chosen.number != own[i].number:
                yield (*own[:i], rival.chosen, *own[i + 1 :])
    for rival in rivals(evidence.beside(own), most=MOST_TRIED, within=4.0 * WITHIN):
        yield (*own, rival.chosen)


def _mismatches(folds: Folds, apart: list[Array], parts: np.ndarray, noise: float) -> list[float]:
    """Return v / s for (n,) differences of residuals, by (n,) parts of the readings; see the head of this module."""
    errors, spread, found, count = folds.left(folds.anew), folds.spread, [], int(parts.max()) + 1

    def scatter(values: Array) -> float:
        return count * float(np.bincount(parts, values, count).var()) * count / (count - 1)

    for one in apart:
        expected = noise**2 * float(one @ one) + scatter(0.5 * one**2)
        for rows, root in spread:  # what the other folds leave uncertain errs alike in a part
            sums = np.zeros((count, root.shape[1]))
            np.add.at(sums, parts[rows], one[rows, None] * root)
            expected += noise**2 * float((sums**2).sum())
        found.append(scatter(one * errors + 0.5 * one**2) / expected)
    return found
