"""Laws learned on the whole arm, with how far they may be from what was declared found by evidence, and what they say.

How large couplings, terms or a network's output are to be expected is not known beforehand. Each group's prior standard
deviation is the one under which the readings are most probable (MacKay 1992, "Bayesian interpolation": the sum of
squares over the number of values that the data determine), so that what a joint has not got costs nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armflex.arm import Arm, Setup
from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import ConvergenceError, Flag
from armflex.estimate.block import Block, LawBlock, learned_laws, with_laws
from armflex.estimate.fit import ROUGH, THOROUGH, Fit, WeighedReadings, fit
from armflex.estimate.identify import UNDETERMINED
from armflex.estimate.robust import EVEN, TAILS, outlier_limit
from armflex.estimate.sample import LawSamples
from armflex.laws.learned import LearnedLaw
from armflex.parameters import Certainty
from armflex.progress import Progress
from armflex.readings.instrument import ROUNDS


def fit_learning(
    declared: Setup,
    blocks: Sequence[Block],
    laws: LawBlock,
    weighed: WeighedReadings,
    rows: np.ndarray,
    by_scatter: bool,
    progress: Progress | None = None,
) -> tuple[Fit, tuple[Flag, ...]]:
    """Return the most probable values of all blocks and laws together, and flags.

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
    # From the best values without corrections, which then have the rest to explain: free from the first step on, a
    # network that still means nothing may lead compliances far astray.
    plain = replace(laws, laws=tuple(law.without_correction() for law in laws.laws))
    values = fit(declared, (*blocks, plain), weighed.measurements, rows, effort=ROUGH).values
    others, of_law = np.split(values, [len(values) - len(plain.parameters)])
    pairs = zip(plain.split(of_law), laws.laws, strict=True)
    start = np.concatenate(
        [others, *(part for part_of_law, law in pairs for part in (part_of_law, law.values[len(part_of_law) :]))]
    )

    for _ in range(ROUNDS):
        fitted = fit(declared, (*blocks, laws), weighed.measurements, rows, start, progress, ROUGH)
        places, before = fitted.places(laws), weighed
        better, start = (
            rescaled(laws, fitted.values[places], np.diag(fitted.posterior.covariance)[places]),
            fitted.values,
        )
        pairs = zip(better.laws, laws.laws, strict=True)
        change = float(max(np.abs(np.log(np.divide(a.scales, b.scales))).max(initial=0.0) for a, b in pairs))
        laws = better
        weighed = weighed.again(fitted) if by_scatter else weighed
        if change < EVEN and weighed.close_to(before):
            break
    # Networks have long valleys: one that is left halfway has values, and bands, that are not its own; only where
    # nothing is gained but rounding it is no matter where one ends.
    patient = replace(THOROUGH, content=True)
    settled = fit(declared, (*blocks, laws), weighed.measurements, rows, start, progress=progress, effort=patient)
    if settled.left > outlier_limit(1) ** 2:  # a value is off beyond chance
        text = f"the learned laws did not settle: -2 log posterior density would fall by {settled.left:.3g} or more"
        hint = "a simpler model (polynomial, then linear), fewer flexures that learn, or `armflex trace` may help"
        raise ConvergenceError(f"{text}; {hint}", settled.history)
    flags = []
    if settled.left > 1.0:  # one standard deviation of one value
        text = (
            f"the learned laws may fit a little better: -2 log posterior density would fall by {settled.left:.2g} more"
        )
        flags.append(Flag("unsettled", text))
    if change >= EVEN:
        text = f"how large couplings and corrections are still changed by {np.expm1(change):.0%} after {ROUNDS} fits"
        flags.append(Flag("unsettled", text))
    return replace(settled, factors=weighed.factors), tuple(flags)


def with_posteriors(arm: Arm, fit: Fit, certainty: Certainty) -> Arm:
    """Return a fitted arm with how well it is known, of which learned laws carry their part, and how far they go."""
    arm = replace(arm, certainty=certainty)
    block = next((block for block in fit.blocks if isinstance(block, LawBlock)), None)
    if block is None:
        return arm
    line, names, covariance = fit.view.line, arm.flexure_names, certainty.among(block.parameters)
    assert covariance is not None
    places = dict(zip(block.flexures, block.split(np.arange(len(covariance))), strict=True))
    laws = learned_laws(arm)
    return with_laws(
        arm,
        {
            name: laws[name].with_posterior(
                covariance[np.ix_(place, place)], line.flexure_wrenches[:, names.index(name)], line.row
            )
            for name, place in places.items()
        },
    )


def rescaled(block: LawBlock, values: Array, variance: Array) -> LawBlock:
    """Return the block with every group's scale by evidence, `TAILS` values of the size expected beforehand thrown in.

    A scale that the data hardly determine must not run to nothing, which would leave what they leave open without any
    flag. Nor beyond what is by chance: where an arm lacks something else, corrections would explain it at any size,
    until the arm buckles.

    Args:
        block: The laws and the scales that they were fitted with.
        values: (k,) fitted values.
        variance: (k,) their posterior variances.
    """
    laws = []
    for law, part, variance_of_law in zip(block.laws, block.split(values), block.split(variance), strict=True):
        scales = list(law.scales)
        for i, places in enumerate(law.groups):
            expected = law.expected[places[0]]
            if expected.sized:
                determined = np.clip(1.0 - variance_of_law[places] / scales[i] ** 2, 0.0, 1.0).sum()
                squares = part[places] @ part[places] + TAILS * expected.prior**2
                scales[i] = min(float(np.sqrt(squares / (determined + TAILS))), outlier_limit(1) * expected.prior)
        laws.append(replace(law, scales=tuple(scales)))
    return replace(block, laws=tuple(laws))


@dataclass(frozen=True, eq=False)
class LearnedAxis:
    """One axis of a learned law over the loads of the campaign; RMS over its rows [m or rad].

    Attributes:
        flexure, axis: Which.
        declared: Twist of the law as declared.
        learned: Twist of the law as learned.
        change: What was learned, learned minus declared.
        correction: The part of it that no compliance can express.
        std: Standard uncertainty of the learned twist.
        before: The same of the law as declared, by what was expected of its parameters before the campaign.
        sampled: Standard deviation of the twist among sampled laws, None where none were.
    """

    flexure: str
    axis: str
    declared: float
    learned: float
    change: float
    correction: float
    std: float
    before: float
    sampled: float | None = None

    @property
    def determined(self) -> bool:
        """Whether the readings say anything about it; else its prior holds it."""
        return self.std < UNDETERMINED * self.before


def learned_axes(fit: Fit, laws: Mapping[str, LearnedLaw], samples: LawSamples | None) -> tuple[LearnedAxis, ...]:
    """Return every axis of every learned law that is compliant at all.

    Args:
        fit: The fit.
        laws: The laws with the covariance of their values, by flexure.
        samples: Sampled laws, None where none were drawn.
    """
    line, names, axes = fit.view.line, fit.setup.arm.flexure_names, []
    for name, law in laws.items():
        loads, row, start = line.flexure_wrenches[:, names.index(name)], line.row, law.at(law.start)
        declared, learned = start.twist(loads, row), law.twist(loads, row)
        correction = np.zeros_like(loads) if law.correction is None else law.correction.twist(loads, row)
        assert law.posterior is not None
        expected = np.diag([prior.prior**2 for prior in law.expected])
        std, before = law.std(law.posterior, loads, row), start.std(expected, loads, row)
        drawn = [] if samples is None else [samples.twists(name, loads, row).std(axis=0)]
        columns = (declared, learned, learned - declared, correction, std, before, *drawn)
        rms = np.sqrt([(values**2).mean(axis=0) for values in columns])
        for i, axis in enumerate(TWIST_NAMES):
            if rms[0, i] > 0.0:
                axes.append(LearnedAxis(name, axis, *rms[:, i].tolist()))
    return tuple(axes)
