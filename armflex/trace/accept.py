"""Whether a gain is real: a sign-flip maximum null over all candidates, and rows that the fit has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.fit import Fit
from armflex.estimate.held_out import HeldOut, held_out, judged_by, pose_folds, told_by_others
from armflex.parameters import OF_SESSION
from armflex.trace.candidates import Sifted
from armflex.trace.polish import Polished

if TYPE_CHECKING:
    from armflex.trace.state import State

FLIPS = 200

ENOUGH = 16.0
"""Evidence that an effect must be worth at least: thousands are looked at, and noise gives the best of them 3 to 10.

A large residual of a piece gives far more even with its signs turned at random, which `MARGIN` is counted from.
"""

MARGIN = 3.0
"""Evidence that it must have beyond the best that random signs gave."""

APART = 2.0
"""Standard errors by which held-out errors must fall."""

SHOWN = 2.0
"""Standard deviations by which an effect must still show for rows that were left out to say anything about it."""

FARTHEST = 5.0
"""Times the median error beyond which an error is no larger for the proof: about where a row is believed no more."""


@dataclass(frozen=True)
class Proof:
    """Errors of rows that were not used, before and after an effect [m].

    Attributes:
        before, after: RMS of the 3-D error, poses held out.
        sessions_before, sessions_after: The same with whole sessions held out, over those without which it
            still shows; None where there are none.
        errors_apart: Standard errors by which the mean squared error falls.
        null: Best evidence that any competing candidate had under random signs of the residual, 200 times.
    """

    before: float
    after: float
    sessions_before: float | None
    sessions_after: float | None
    errors_apart: float
    null: float

    @property
    def sessions_agree(self) -> bool:
        """Whether whole sessions, where any can judge, are predicted better."""
        if self.sessions_before is None or self.sessions_after is None:
            return True
        return self.sessions_after < self.sessions_before


@dataclass(frozen=True)
class Kin:
    """A family that effects were accepted with: one law at every drive (`armflex.trace.families`).

    Attributes:
        number: Which family it is.
        std: Standard deviation of its members' twists, RMS over the rows [rad or m].
        worth: Twice the logarithm of its evidence over none.
    """

    number: int
    std: float
    worth: float


@dataclass(frozen=True, eq=False)
class Step:
    """What is kept of an accepted effect; a search itself is hundreds of megabytes.

    Attributes:
        ranking: What was considered when it was added, the best first.
        proof: Held-out rows.
        witness: Whether it is believed for the priors' sake: held-out errors barely move, parameters no longer do.
        exchanged: Whether another effect has taken its place since, so that the proof is of what stood there before.
        kin: The family with which it was added, whose proof it is; None where it stands alone.
    """

    ranking: tuple[Polished, ...]
    proof: Proof
    witness: bool
    exchanged: bool = False
    kin: Kin | None = None


def prove(before: State, after: State, null: float, new: Sequence[Block]) -> Proof:
    """Return the errors of held-out poses and sessions before and after, and with what became `new` between them."""
    folds, judged = pose_folds(before.groups), judged_by(before.fit, after.fit)
    poses = [held_out(state.fit, folds, judged=judged) for state in (before, after)]
    sessions = sessions_held_out(before.fit, after.fit, new, after.sessions)
    return Proof(poses[0].rms, poses[1].rms, *(sessions or (None, None)), improvement(*poses), null)


def null_maximum(
    sifted: Sifted, groups: np.ndarray, laws: frozenset[str] | None = None, seed: int = 0, flips: int = FLIPS
) -> Array:
    """Return (F,) the best evidence of any candidate when the residual of every pose has a random sign.

    Winkler et al. 2014 (NeuroImage 92): signs of exchangeable blocks, reduced-model residuals, maximum statistic.

    Args:
        sifted: Projected candidates.
        groups: (M,) pose number of every row.
        laws: Names of those that compete; all when not given.
        seed: Of the signs.
        flips: How many.
    """
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (int(groups.max()) + 1, flips))
    competes = [laws is None or candidate.law.name in laws for candidate in sifted.bank.candidates]
    if not any(competes):
        return np.full(flips, -np.inf)
    return sifted.evidence_of(sifted.gains(signs[groups]))[competes].max(axis=0)


def session_folds(fit: Fit, sessions: Sequence[str]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return (M,) the session of every row as a number, and for each session its frame's parameters."""
    names = list(dict.fromkeys(sessions))
    folds = np.array([names.index(session) for session in sessions])
    owners = [one.group.of if one.group.kind in OF_SESSION else None for one in fit.parameters]
    return folds, [np.array([i for i, of in enumerate(owners) if of == name], dtype=int) for name in names]


def sessions_held_out(
    before: Fit, after: Fit, new: Sequence[Block], sessions: Sequence[str]
) -> tuple[float, float] | None:
    """Return the RMS of the 3-D error with whole sessions held out, before and after new blocks came in [m].

    Over the sessions without which the others still show what is new: whether a tool slipped before the second of two
    sessions nobody can tell from one of them. None where there are no such sessions.
    """
    if len(set(sessions)) < 2 or not new:
        return None
    folds, frames = session_folds(after, sessions)
    able = _showing(after, np.concatenate([after.places(block) for block in new]), folds)
    if not able.any():
        return None
    judged = judged_by(before, after)
    if not (able & (before.view.readings.where(judged).foremost_count > 0)).any():
        return None
    first = held_out(before, *session_folds(before, sessions), judged=judged)
    return first.rms_of(able), held_out(after, folds, frames, judged).rms_of(able)


def _showing(fit: Fit, some: np.ndarray, folds: np.ndarray) -> np.ndarray:
    """Return (M,) whether the rows of other folds than a row's own still show some parameters."""
    values, able = fit.values[some], np.zeros(len(folds), bool)
    for number, left in enumerate(told_by_others(fit, folds)):
        told = np.isfinite(left.std[some])  # what nothing determines without them shows nothing
        known = left.covariance[np.ix_(some[told], some[told])]
        able[folds == number] = (
            values[told] @ np.linalg.pinv(known, hermitian=True) @ values[told] > len(some) * SHOWN**2
        )
    return able


def improvement(before: HeldOut, after: HeldOut) -> float:
    """Return how many standard errors the mean squared error falls by, over rows that both believe.

    What is farther than `FARTHEST` counts as that far: the few rows that an effect moves most would be all its scatter.
    """
    both = before.believed & after.believed
    squares = [errors.squares[both] for errors in (before, after)]
    most = FARTHEST**2 * min(float(np.median(one)) for one in squares)
    fall = np.minimum(squares[0], most) - np.minimum(squares[1], most)
    return float(fall.mean() / (fall.std() / np.sqrt(len(fall)) + 1e-300))
