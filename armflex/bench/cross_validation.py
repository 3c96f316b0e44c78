"""Errors on rows held out from a learner, and the choice among models by them.

All are compared on the same held-out rows, and the plainest within one standard error is taken. The choice itself is
part of what is held out: `assess` chooses anew inside every fold, so that the error it reports is that of "let armflex
choose", not that of the winner on the rows that made it win.
"""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armflex.bench.fitted import Fitted, Learner, predicted, stated_std
from armflex.conventions import Array
from armflex.errors import ConvergenceError, InputError
from armflex.measured.joint_data import JointData

BAND = 1.96
"""Standard deviations each side of a 95 % band."""

FOLDS, REPEATS = 10, 2
OUTER = 10
INNER = 5

Step = Callable[[Array], bool | None]


@dataclass(frozen=True)
class HeldOutFolds:
    """Every row as a fit without it saw it.

    Attributes:
        residual: (N, k) measured minus predicted [m, rad].
        std: (N, k) predicted standard deviation, noise included; nan where a law carries none.
        how: How rows were held out.
    """

    residual: Array
    std: Array
    how: str

    @property
    def rms(self) -> Array:
        """(k,) RMS of each column [m, rad]."""
        return np.sqrt((self.residual**2).mean(axis=0))

    @property
    def coverage(self) -> float | None:
        """Share of held-out numbers inside their 95 % band, None where a law carries no uncertainty."""
        if not np.isfinite(self.std).all():
            return None
        return float((np.abs(self.residual) <= BAND * self.std).mean())


def random_folds(count: int, folds: int, seed: int) -> np.ndarray:
    """Return (N,) folds of nearly equal size, drawn by seed."""
    return np.random.default_rng(seed).permutation(count) % min(folds, count)


def hold_out(
    learner: Learner, data: JointData, fold: np.ndarray, seed: int = 0, step: Step | None = None
) -> HeldOutFolds:
    """Return every row's error from a fit without its fold.

    Args:
        learner: What is held out.
        data: The rows.
        fold: (N,) label of each row's fold.
        seed: Of the learner.
        step: Called after every fold with the (N, k) residuals so far, nan where a row has not had its turn; the rest
            is left where it returns False.

    Raises:
        InputError: The other rows do not determine the model.
        ConvergenceError: A chain on the other rows has not converged.
    """
    residual, std = np.full_like(data.deflections, np.nan), np.full_like(data.deflections, np.nan)
    labels = np.unique(fold)
    for label in labels:
        out = fold == label
        rows = f"data row {int(out.argmax()) + 1}{f' and {out.sum() - 1} others' if out.sum() > 1 else ''}"
        try:
            law = learner(data.loads[~out], data.deflections[~out], seed).law
        except InputError as error:
            raise InputError(f"the held-out error needs more rows: without {rows}, {error}") from None
        except ConvergenceError as error:
            raise ConvergenceError(f"held-out error, without {rows}: {error}", error.history) from None
        residual[out] = data.deflections[out] - predicted(law, data.loads[out])
        std[out] = stated_std(law, data.loads[out])
        if step and step(residual) is False:
            break
    return HeldOutFolds(residual, std, "leave-one-out" if len(labels) == len(data) else f"{len(labels)}-fold")


@dataclass(frozen=True)
class ModelCandidate:
    """A model that may be chosen, by a `name` that states its options; candidates are listed the plainest first."""

    name: str
    model: str
    learner: Learner


@dataclass(frozen=True)
class ModelScore:
    """A candidate and its held-out errors.

    Attributes:
        name, model: Of the candidate.
        squares: (N, k) mean squared error of every number over the repeats; infinite where it could not be fitted.
        reason: Why it could not, or that it was left because it could not be chosen any more.
        seconds: How long it took.
    """

    name: str
    model: str
    squares: Array
    reason: str = ""
    seconds: float = 0.0

    @property
    def rms(self) -> Array:
        """(k,) RMS of each column [m, rad]."""
        return np.sqrt(self.squares.mean(axis=0))


def compare(
    candidates: Sequence[ModelCandidate],
    data: JointData,
    seed: int = 0,
    folds: int = FOLDS,
    repeats: int = REPEATS,
    step: Step | None = None,
) -> tuple[ModelScore, ...]:
    """Return every candidate's errors over repeats of the same random folds, or why it has none; `step` as above."""
    compared = []
    for candidate in candidates:
        began, reason = time.perf_counter(), ""
        try:
            parts = [
                hold_out(candidate.learner, data, random_folds(len(data), folds, run), run, step).residual ** 2
                for run in range(seed, seed + repeats)
            ]
            squares = np.mean(parts, axis=0)
            if np.isnan(squares).any():
                squares, reason = np.full_like(squares, np.inf), "it could not be chosen any more"
        except InputError as error:  # too few rows for this model: it is no candidate
            squares, reason = np.full_like(data.deflections, np.inf), str(error)
        compared.append(ModelScore(candidate.name, candidate.model, squares, reason, time.perf_counter() - began))
    return tuple(compared)


def race(candidates: Sequence[ModelCandidate], data: JointData, seed: int, folds: int, least: Array) -> int:
    """Return what `chosen` makes of `compare`, without fits that no longer matter.

    The last candidate, which takes longest, is chosen only where its mean loss is the smallest of all. Its squares can
    but add up: once those of the rows that it has seen, with nothing for the others, are as large in every column as
    the best candidate's over all rows, and its loss above the best one's, it cannot be, and the scale of no column is
    its own.
    """
    compared = compare(candidates[:-1], data, seed, folds, 1)
    means = np.array([candidate.squares.mean(axis=0) for candidate in compared])
    scale = np.maximum(means.min(axis=0), np.square(least))
    best = float((means / scale).mean(axis=1).min()) if np.isfinite(scale).all() else np.inf

    def step(residual: Array) -> bool:
        at_least = np.nansum(residual**2, axis=0) / len(residual)
        return bool((at_least < means.min(axis=0)).any() or (at_least / scale).mean() <= best)

    return chosen([*compared, *compare(candidates[-1:], data, seed, folds, 1, step)], least)


def negligible(deflections: Array) -> Array:
    """Return the (k,) RMS errors below which models of (N, k) deflections are equally good."""
    moved = np.sqrt((deflections**2).mean(axis=0))
    # Part of what a deflection moves that no bench distinguishes from zero.
    return 1e-6 * np.where(moved > 0.0, moved, moved.max())


def chosen(compared: Sequence[ModelScore], least: Array | float = 0.0) -> int:
    """Return the number of the plainest candidate within one standard error of the best.

    Columns count alike: each is measured by the smallest held-out error that any candidate reaches on it, or by the
    (k,) `least` error that counts.

    Raises:
        InputError: None of them could be fitted.
    """
    scale = np.maximum(np.min([candidate.squares.mean(axis=0) for candidate in compared], axis=0), np.square(least))
    if not np.isfinite(scale).all():
        raise InputError(f"no model could be fitted, not even {compared[0].name!r}: {compared[0].reason}")
    losses = [(candidate.squares / scale).mean(axis=1) for candidate in compared]
    means = [float(loss.mean()) for loss in losses]
    best = int(np.argmin(means))
    limit = means[best] + float(losses[best].std(ddof=1)) / np.sqrt(len(losses[best]))
    return next(i for i, mean in enumerate(means) if mean <= limit)


def assess(
    candidates: Sequence[ModelCandidate], data: JointData, seed: int = 0, step: Step | None = None
) -> tuple[HeldOutFolds, dict[str, int]]:
    """Return the errors of choosing among candidates anew in each fold, and how often each was chosen.

    `step` is as above.
    """
    count: Counter[str] = Counter()

    def learner(loads: Array, deflections: Array, inner_seed: int) -> Fitted:
        part = replace(data, loads=loads, deflections=deflections)
        candidate = candidates[race(candidates, part, inner_seed, INNER, negligible(deflections))]
        count[candidate.name] += 1
        return candidate.learner(loads, deflections, inner_seed)

    held = hold_out(learner, data, random_folds(len(data), OUTER, seed), seed, step)
    return replace(held, how=f"{held.how}, choice inside"), dict(count)
