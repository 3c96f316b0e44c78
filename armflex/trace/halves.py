"""A campaign traced in halves: what one half names, and what the other half says of it.

The measure of stated probabilities that needs no truth: a name that one half is sure of is to be in the credible set of
the other, with numbers that agree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from armflex.arm import Arm
from armflex.errors import InputError, naming
from armflex.estimate.held_out import PARTS, POSE_FOLDS, apart_folds
from armflex.laws.effects.candidate import Candidate
from armflex.laws.effects.effect import Effect
from armflex.measured.measurements import Measurements
from armflex.trace.findings import Found, Replicated, Trace
from armflex.trace.hypotheses import Hypothesis


def in_halves(
    arm: Arm,
    measurements: Measurements,
    rows: np.ndarray,
    count: int,
    traced: Callable[[Arm, Measurements, np.ndarray], Trace],
    report: Callable[[str], None],
) -> tuple[Replicated, ...]:
    """Return every name of the halves of a campaign: of so many random splits, and as many by parts of joint space.

    Args:
        arm: The arm as declared.
        measurements: The campaign.
        rows: (M,) numbers of the rows that were traced.
        count: Splits of each kind.
        traced: Traces some rows of a campaign.
        report: Called with what is being done, in words.

    Raises:
        InputError: There are not ten poses.
        ArmflexError: A half cannot be traced; the message says which.
    """
    pose = measurements.pose_number[rows]
    if len(set(pose)) < 2 * POSE_FOLDS:
        raise InputError(f"{len(set(pose))} poses are too few for two halves, expected at least {2 * POSE_FOLDS}")
    found = list[Replicated]()
    for split, first in _splits(measurements.q[rows], pose, count):
        halves = list[Trace]()
        for half, chosen in ((1, first), (2, ~first)):
            report(f"tracing half {half} of the split {split}")
            with naming(f"half {half} of the split {split}"):
                halves.append(traced(arm, measurements, rows[chosen]))
        for half, (own, other) in enumerate((halves, halves[::-1]), 1):
            found += [_replicated(split, half, one, other) for one in own.found]
    return tuple(found)


def _splits(q: np.ndarray, pose: np.ndarray, count: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yield what a split is called and (M,) which rows are of its first half; rows of a pose stay together."""
    poses, first, groups = np.unique(pose, return_index=True, return_inverse=True)
    rng, parts = np.random.default_rng(0), apart_folds(q[first], 4 * PARTS)
    for i in range(count):
        yield f"random {i + 1}", (rng.permutation(len(poses)) < len(poses) // 2)[groups]
    for i in range(count):
        yield f"parts {i + 1}", (rng.permutation(4 * PARTS) < 2 * PARTS)[parts][groups]


def _replicated(split: str, half: int, own: Found, other: Trace) -> Replicated:
    """Return what another half says of an effect."""

    def same(effect: Effect) -> bool:
        return _of(effect).alike(_of(own.effect))

    there = [one for one in other.found if same(one.effect)]
    in_set = bool(there) or any(same(effect) for one in other.found for effect, _ in one.credible)
    chance = max((share for effect, share in other.suspects if same(effect)), default=0.0)
    agree = [verdict for one in there if (verdict := _agree(own, one)) is not None]
    return Replicated(split, half, own.effect, own.probability, chance, in_set, any(agree) if agree else None)


def _of(effect: Effect) -> Hypothesis:
    return Hypothesis(Candidate(effect.law, effect.location, effect.inner), 0.0)


def _agree(one: Found, other: Found) -> bool | None:
    """Return whether the values of two effects of a law agree, None where none has an uncertainty in both."""
    values, others = one.effect.named, other.effect.named
    stds = {name: np.hypot(one.std[name], other.std[name]) for name in values if name in one.std and name in other.std}
    apart = [abs(values[name] - others[name]) / std for name, std in stds.items() if 0.0 < std < np.inf]
    return max(apart) <= 3.0 if apart else None


@dataclass(frozen=True)
class Counted:
    """Names of halves whose stated probability is in a range.

    Attributes:
        least: The lower end of the range: 0.9, 0.5, 0.2 or 0.
        names: How many.
        stated, there: Mean probability that is stated, and that the other half gives.
        inside: Share in the credible sets of the other half.
        agree: Of those that are found there the share whose numbers agree, None where there are none.
    """

    least: float
    names: int
    stated: float
    there: float
    inside: float
    agree: float | None

    @property
    def cells(self) -> list[str]:
        """As a row of a table."""
        head = f"{self.least:.1f} and more" if self.least else "less"
        shares = (self.stated, self.there, self.inside, self.agree)
        return [head, str(self.names), *("-" if share is None else f"{share:.0%}" for share in shares)]


def counted(names: Sequence[Replicated]) -> list[Counted]:
    """Return names of halves by the probability that is stated, the surest first."""
    table = list[Counted]()
    for least, most in ((0.9, np.inf), (0.5, 0.9), (0.2, 0.5), (0.0, 0.2)):
        some = [one for one in names if least <= one.probability < most]
        agree = [one.numbers_agree for one in some if one.numbers_agree is not None]
        if some:
            stated = float(np.mean([one.probability for one in some]))
            there = float(np.mean([one.probability_there for one in some]))
            inside = float(np.mean([one.in_other_half for one in some]))
            table.append(Counted(least, len(some), stated, there, inside, float(np.mean(agree)) if agree else None))
    return table
