"""What to measure next: which causes are in question, the rows that decide between them, and what a campaign lacks.

`armflex.plan.asking` has the rows, and says what no row of this kind distinguishes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from armflex.errors import ArmflexError, listing
from armflex.laws.effects.context import TEMPERATURE, Context
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.link_mass import LINK_MASS
from armflex.laws.effects.location import link_of
from armflex.measured.measurements import Measurements
from armflex.parameters import DOUBT
from armflex.plan.asking import OFFERED, Cause, Pair, Question, RequestedRows
from armflex.plan.design import instead
from armflex.plan.design_model import Before
from armflex.plan.instruments import informing_levels
from armflex.robot.robot import Robot

POSSIBLE, RIVALS = 0.01, 4
"""Tolerance: probability from which a cause is in question, and how many are in the place of one effect."""


ABSURD_MASS = 0.25
"""Prior: share of a link's declared mass by which none differs from that."""

STEMS = ("ask", "ask_2")
"""How the poses of rows that were asked for begin, and their files are called: twice at most."""


@dataclass(frozen=True, eq=False)
class Alternatives:
    """What may be in one place of a model.

    Attributes:
        found: The cause that was found; None where nothing was.
        others: What else it may be, the likeliest first.
        nothing: Probability that there is no effect.
    """

    found: Cause | None
    others: Sequence[Cause]
    nothing: float

    @property
    def pairs(self) -> list[Pair]:
        """The pairs of causes that are in question."""
        rivals = [rival for rival in self.others if rival.probability >= POSSIBLE][:RIVALS]
        none = Cause(None, self.nothing)
        if self.found is not None:
            return [(self.found, other) for other in [*rivals, *([none] if self.nothing >= DOUBT else [])]]
        if not DOUBT < self.nothing < 1.0 - DOUBT:
            return []
        return [*((rival, none) for rival in rivals), *combinations(rivals, 2)]


def next_measurement(
    before: Before, places: Sequence[Alternatives], rows: int, settable: Mapping[str, Sequence[float]]
) -> tuple[tuple[str, ...], RequestedRows | None]:
    """Return in words what would decide what is in question, and the rows that do.

    Args:
        before: Arm and campaign, everything that was found in it.
        places: What may be in every place where something is in question.
        rows: How many rows are wanted; None are returned where 0, or where none decide anything.
        settable: Values that can be set of recorded columns; others stay as they were last.
    """
    assert before.measured is not None
    poses = before.measured.campaign.pose
    stem = next((word for word in STEMS if not any(f"{word} " in pose for pose in poses)), None)
    groups = [place.pairs for place in places]
    pairs = [pair for group in groups for pair in group]
    try:
        # Rows, a power of two, by which it is judged whether any decides, where none are asked for
        question = Question.of(before, pairs, settable, OFFERED if rows else 64)
        asked = question.rows(rows, stem) if rows and stem is not None else None
    except ArmflexError as error:  # no proposal is better than a wrong one
        return (f"No rows are proposed: {error}",), None
    texts, first = list[str](), 0
    for group in groups:
        open_of_it = question.open[first : first + len(group)]
        if open_of_it.any():
            texts.append(f"{_odds(group)}: {_how(asked, rows, stem)}")
        for i in np.flatnonzero(~open_of_it)[:RIVALS]:
            texts.append(_elsewhere(question, first + int(i)))
        first += len(group)
    return tuple(texts), asked


def _how(asked: RequestedRows | None, rows: int, stem: str | None) -> str:
    if stem is None:
        return "rows were asked for twice already; more of this kind hardly decide it."
    if asked is None:
        return "`armflex trace --ask 12` writes the rows to measure that decide."
    return (
        f"measure these {rows} rows to decide ({stem}.csv; the probability of a wrong name is then at most "
        f"{min(asked.after, 1.0):.1%}, now {min(asked.before, 1.0):.1%})."
    )


def _odds(group: Sequence[Pair]) -> str:
    """Return the causes of some pairs with their probabilities, as '92 % this, 6 % that'."""
    causes = sorted(
        {id(cause): cause for pair in group for cause in pair}.values(), key=lambda cause: -cause.probability
    )
    return ", ".join(f"{cause.probability:.0%} {cause.effect.title if cause.effect else 'nothing'}" for cause in causes)


def _elsewhere(question: Question, number: int) -> str:
    """Return in words what distinguishes a pair that no row does."""
    cause, other = question.pairs[number]
    assert cause.effect is not None
    readings = question.before.measured.view.readings if question.before.measured else None
    names = [] if readings is None else readings.names
    alike = f"More rows like those recorded do not distinguish {cause.effect.title} from "
    alike += other.effect.title if other.effect else "nothing"
    splitting = " or ".join(f"{name} ({more:.2g} standard deviations)" for name, more in question.split_by(number))
    if splitting:
        return f"{alike}; {splitting}, read in 20 of them, would."
    if other.effect is None:
        return f"{alike}."
    levels = informing_levels(question.before.setup.arm, names)
    return f"{alike}; instead, {instead(cause.effect, other.effect, levels)}."


def misplaced_centres(effects: Sequence[Effect], robot: Robot) -> tuple[str, ...]:
    """Return in words that masses which no link has may be centres of mass at wrong places: they load joints alike."""
    far = {}
    for effect in effects:
        if effect.law is LINK_MASS and effect.named.get("mass"):
            link = robot.urdf.links[link_of(effect.location.site, robot)]
            declared = link.inertial.mass if link.inertial else 0.0
            if abs(effect.named["mass"]) > ABSURD_MASS * declared:
                far[link.name] = f"{link.name} by {effect.named['mass']:+.3g} kg of {declared:.3g} kg"
    if not far:
        return ()
    text = f"Masses differ more from the declared ones than a link's does ({listing(far.values())})"
    return (
        f"{text}: check the declared centres of mass of these links and their neighbours, which load joints alike.",
    )


def warming(effects: Sequence[Effect], recorded: Sequence[str]) -> tuple[str, ...]:
    """Return in words that links which grow with time may do so with a temperature that no column has."""
    growing = dict.fromkeys(
        effect.location.site
        for effect in effects
        if "time" in effect.location.covariates
        and not effect.location.turns
        and effect.location.site not in ("base", "tool")
    )
    if len(growing) < 2 or any(TEMPERATURE.search(name) for name in recorded):
        return ()
    text = f"Lengths at {listing(growing)} change with time, as links do that warm up: record a column `temperature`"
    return (f"{text}, with which they grow alike (steel by 12, aluminium by 23 millionths per K).",)


def lacking(measurements: Measurements, context: Context) -> tuple[str, ...]:
    """Return in words what would make a campaign able to show more."""
    texts, used = [], measurements.measured
    kinds = len({payload for payload, read in zip(measurements.payload, used, strict=True) if read})
    if kinds < 3:
        texts.append(
            f"Measure with three payloads, one in between: {kinds} cannot distinguish a curved law from a linear one."
        )
    if len(set(measurements.session)) < 2:
        texts.append(
            "Set the instrument up again half way: one session cannot distinguish a drift of the base "
            "from one of the arm."
        )
    turned = measurements.approach[used]
    one_way = [name for i, name in enumerate(measurements.joint_names) if len(set(turned[:, i].tolist()) - {0.0}) < 2]
    if one_way:
        texts.append(f"Approach poses from both sides with {', '.join(one_way[:4])}: backlash does not show otherwise.")
    derived = [name for name in measurements.derived if name != "time"]
    if derived:
        texts.append(
            f"Write down {', '.join(derived[:4])}: the direction a joint came from was taken from the rows before."
        )
    if "time" in measurements.derived:
        texts.append("Write down the time of every row: nothing that drifts, lags or slips was looked for.")
    cylinders = [cylinder.name for cylinder in context.robot.linkage.cylinders]
    if cylinders and "hold" not in context.recorded:
        texts.append(
            f"Write down in a column `hold` how long each pose has stood [s], and let it differ: whether "
            f"{listing(cylinders)} leaks was not looked for."
        )
    if len(set(zip(measurements.pose, measurements.payload, strict=True))) == len(measurements):
        texts.append("Repeat ten poses or more: repeats give the noise without any model.")
    return tuple(texts)
