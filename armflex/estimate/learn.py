"""Laws learned on the whole arm, with how far they may be from what was declared found by evidence.

How large couplings, terms or a network's output are to be expected nobody knows beforehand. Each group's prior standard
deviation is the one under which the readings are most probable (MacKay 1992, "Bayesian interpolation": the sum of
squares over the number of values that the data determine), so that what a joint has not got costs nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import ConvergenceError, Flag
from armflex.estimate.block import Block
from armflex.estimate.fit import Effort, Fit, fit
from armflex.estimate.law_block import LawBlock, learned_laws, with_laws
from armflex.estimate.view import Progress
from armflex.estimate.weigh import Weighed
from armflex.laws.learned import LearnedLaw
from armflex.measured.measurements import Measurements
from armflex.parameters import Kind
from armflex.setup import Setup

FIRM = 4.0
"""How many values' worth the expected size of a group is: a scale that the data hardly tell must not run to nothing,
which would leave what they cannot tell without any doubt."""

MOST = 4.0
"""Times what is expected beforehand that a group may be at most. Where an arm lacks something else, the readings would
have corrections explain it at any size: many times what the joint gives, until the arm buckles."""

ROUNDS = 8
"""Fits at most in search of the scales."""

BRISK = Effort(10, 8, 0.3, content=True)
"""For the fits in search of the scales; far from the truth a network's steps need much damping."""

PATIENT = Effort(150, 8, 0.05, content=True)
"""For the last fit. Networks have long valleys: one that is left halfway has values, and bands, that are not its own;
only where nothing is gained but rounding it is no matter where one ends."""

SETTLED = 0.2
"""Logarithm of a change of every scale below which the search ends."""

NEARLY, FAR = 0.5, 10.0
"""Falls of the cost still to be had beyond which it is said that the laws might fit better, and beyond which they are
not those of the readings: 10 is what three standard deviations of one value make."""


def fit_learning(
    declared: Setup,
    blocks: Sequence[Block],
    laws: LawBlock,
    weighed: Weighed,
    rows: np.ndarray,
    by_scatter: bool,
    progress: Progress | None = None,
) -> tuple[Fit, tuple[Flag, ...]]:
    """Return the most probable values of all blocks and laws together, and doubts.

    The laws' scales are found by evidence, and with them the weights of readings that scatter more than they state.

    Args:
        declared, blocks, rows, progress: See `fit`.
        laws: What is learned, with the scales where their search starts.
        weighed: The readings as they are weighed at first.
        by_scatter: Whether they may be weighed otherwise.

    Raises:
        ConvergenceError: The last fit ended far from settled.
        ArmflexError: See `fit`.
    """
    start = _plain_first(declared, blocks, laws, weighed.measurements, rows)
    for _ in range(ROUNDS):
        found = fit(declared, (*blocks, laws), weighed.measurements, rows, start, progress, BRISK)
        own, before = found.places(laws), weighed
        better, start = rescaled(laws, found.values[own], np.diag(found.posterior.covariance)[own]), found.values
        laws, change = better, moved(better, laws)
        weighed = weighed.again(found) if by_scatter else weighed
        if change < SETTLED and weighed.close_to(before):
            break
    found = fit(declared, (*blocks, laws), weighed.measurements, rows, start, progress=progress, effort=PATIENT)
    if found.left > FAR:
        text = f"the learned laws did not settle: -2 log posterior density would fall by {found.left:.3g} or more"
        hint = "a simpler model (polynomial, then linear), fewer flexures that learn, or `armflex trace` may help"
        raise ConvergenceError(f"{text}; {hint}", found.history)
    return replace(found, factor=weighed.factor), tuple(_unsettled(found, change))


def _unsettled(found: Fit, change: float) -> Iterator[Flag]:
    """Yield doubts about where a search ended: what its last fit left, the last change of its scales."""
    if found.left > NEARLY:
        text = f"the learned laws may fit a little better: -2 log posterior density would fall by {found.left:.2g} more"
        yield Flag("unsettled", text)
    if change >= SETTLED:
        text = f"how large couplings and corrections are still changed by {np.expm1(change):.0%} after {ROUNDS} fits"
        yield Flag("unsettled", text)


def _plain_first(
    declared: Setup, blocks: Sequence[Block], laws: LawBlock, measurements: Measurements, rows: np.ndarray
) -> Array:
    """Return the values from which to learn: the best ones without corrections, which then have the rest to explain.

    Free from the first step on, a network that still means nothing may lead compliances far astray.
    """
    plain = replace(laws, laws=tuple(law.without_correction() for law in laws.laws))
    found = fit(declared, (*blocks, plain), measurements, rows, effort=BRISK).values
    others, own = np.split(found, [len(found) - len(plain.labels)])
    pairs = zip(plain.split(own), laws.laws, strict=True)
    return np.concatenate([others, *(part for values, law in pairs for part in (values, law.values[len(values) :]))])


def settled(arm: Arm, found: Fit) -> Arm:
    """Return a fitted arm whose learned laws carry the covariance of their values, and how far corrections go."""
    for block in found.blocks:
        if block.kind is Kind.LAW:
            return with_laws(arm, _settled(arm, found, block))
    return arm


def _settled(arm: Arm, found: Fit, block: LawBlock) -> dict[str, LearnedLaw]:
    laws, line, names = learned_laws(arm), found.view.line, arm.flexure_names
    settled, own = {}, block.split(found.places(block))
    for name, places in zip(block.flexures, own, strict=True):
        spread = found.posterior.covariance[np.ix_(places, places)]
        settled[name] = laws[name].settled(spread, line.flexure_wrenches[:, names.index(name)], line.row)
    return settled


def rescaled(block: LawBlock, values: Array, variance: Array) -> LawBlock:
    """Return the block with every group's scale by evidence.

    Args:
        block: The laws and the scales that they were fitted with.
        values: (k,) fitted values.
        variance: (k,) their posterior variances.
    """
    pairs = zip(block.laws, block.split(values), block.split(variance), strict=True)
    return replace(block, laws=tuple(_rescaled(law, own, spread) for law, own, spread in pairs))


def _rescaled(law: LearnedLaw, values: Array, variance: Array) -> LearnedLaw:
    pairs = [
        (group, std, values[group.places], variance[group.places])
        for group, std in zip(law.groups, law.scales, strict=True)
    ]
    scales = (_scale(group.std, std, own, known) if group.sized else std for group, std, own, known in pairs)
    return replace(law, scales=tuple(scales))


def _scale(expected: float, std: float, values: Array, variance: Array) -> float:
    """Return a group's better scale, with `FIRM` values of the size expected beforehand thrown in."""
    determined = np.clip(1.0 - variance / std**2, 0.0, 1.0).sum()
    return min(float(np.sqrt((values @ values + FIRM * expected**2) / (determined + FIRM))), MOST * expected)


def moved(block: LawBlock, other: LawBlock) -> float:
    """Return the largest factor between the scales of two blocks, as a logarithm."""
    pairs = zip(block.laws, other.laws, strict=True)
    return float(max(np.abs(np.log(np.divide(a.scales, b.scales))).max(initial=0.0) for a, b in pairs))
