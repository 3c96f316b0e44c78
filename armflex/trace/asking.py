"""What to measure next: what is still in question after a trace, and the rows that decide it.

In question are an effect and what else it may be, and, where nothing was found, what may be missing.
`armflex.plan.asking` has the rows, and says what no row of this kind distinguishes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from armflex.errors import ArmflexError, listing
from armflex.estimate.posterior import certainty_of
from armflex.estimate.view import look
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.link_mass import LINK_MASS
from armflex.laws.effects.location import link_of
from armflex.measured.measurements import Measurements
from armflex.plan.asking import OFFERED, Asked, Cause, Pair, Question
from armflex.plan.design import instead
from armflex.plan.design_model import Before, Measured, noises_of
from armflex.plan.instruments import informing_levels
from armflex.robot.robot import Robot
from armflex.trace.hypotheses import Hypothesis
from armflex.trace.probabilities import CREDIBLE, Credible
from armflex.trace.state import State

DOUBT = 1.0 - CREDIBLE
"""Confidence: probability from which it is in question whether something is missing."""

POSSIBLE, RIVALS = 0.01, 4
"""Tolerance: probability from which a cause is in question, and how many are in the place of one effect."""

LOOKED = 64
"""Tolerance: rows, a power of two, by which it is judged whether any decides, where none are asked for."""

ABSURD_MASS = 0.25
"""Prior: share of a link's declared mass by which none differs from that."""

STEMS = ("ask", "ask_2")
"""How the poses of rows that were asked for begin, and their files are called: twice at most."""


@dataclass(frozen=True, eq=False)
class Ask:
    """That rows are wanted.

    Attributes:
        rows: How many; none where 0.
        settable: Values that can be set of recorded columns, by name.
    """

    rows: int = 0
    settable: Mapping[str, Sequence[float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Next:
    """What to measure next.

    Attributes:
        texts: In words.
        asked: The rows; None where none were wanted, or none decide anything.
    """

    texts: tuple[str, ...]
    asked: Asked | None = None


def next_measurement(state: State, credible: Sequence[Credible], wanted: Ask) -> Next:
    """Return what would decide what is in question.

    Args:
        state: The final fit.
        credible: What every hypothesis may be, and last what may be missing.
        wanted: Whether rows are.
    """
    stem = next((one for one in STEMS if not any(f"{one} " in pose for pose in state.measurements.pose)), None)
    groups = _groups(state, credible)
    pairs = [pair for group in groups for pair in group]
    if not pairs:
        return Next(())
    try:
        question = Question.of(_before(state), pairs, wanted.settable, OFFERED if wanted.rows else LOOKED)
        asked = question.rows(wanted.rows, stem) if wanted.rows and stem is not None else None
    except ArmflexError as error:  # no proposal is better than a wrong one
        return Next((f"No rows are proposed: {error}",))
    texts, first = list[str](), 0
    for group in groups:
        told = question.open[first : first + len(group)]
        if told.any():
            texts.append(f"{_odds(group)}: {_how(asked, wanted, stem)}")
        for i in np.flatnonzero(~told)[:RIVALS]:
            texts.append(_elsewhere(question, first + int(i)))
        first += len(group)
    return Next(tuple(texts), asked)


def _how(asked: Asked | None, wanted: Ask, stem: str | None) -> str:
    if stem is None:
        return "rows were asked for twice already; more of this kind hardly decide it."
    if asked is None:
        return "`armflex trace --ask 12` writes the rows to measure that decide."
    return (
        f"measure these {wanted.rows} rows to decide ({stem}.csv; the probability of a wrong name is then at most "
        f"{min(asked.after, 1.0):.1%}, now {min(asked.before, 1.0):.1%})."
    )


def _odds(group: Sequence[Pair]) -> str:
    """Return the causes of some pairs with their probabilities, as '92 % this, 6 % that'."""
    causes = sorted({id(one): one for pair in group for one in pair}.values(), key=lambda one: -one.probability)
    return ", ".join(f"{one.probability:.0%} {one.effect.title if one.effect else 'nothing'}" for one in causes)


def _elsewhere(question: Question, number: int) -> str:
    """Return in words what distinguishes a pair that no row does."""
    one, other = question.pairs[number]
    assert one.effect is not None
    readings = question.before.measured.view.readings if question.before.measured else None
    names = [] if readings is None else readings.names
    alike = f"More rows like those recorded do not distinguish {one.effect.title} from "
    alike += other.effect.title if other.effect else "nothing"
    splitting = " or ".join(f"{name} ({more:.2g} standard deviations)" for name, more in question.split_by(number))
    if splitting:
        return f"{alike}; {splitting}, read in 20 of them, would."
    if other.effect is None:
        return f"{alike}."
    levels = informing_levels(question.before.setup.arm, names)
    return f"{alike}; instead, {instead(one.effect, other.effect, levels)}."


def _groups(state: State, credible: Sequence[Credible]) -> list[list[Pair]]:
    """Return for every effect, or for what may be missing, the pairs of causes that are in question."""
    found, known = list[list[Pair]](), len(state.declared.arm.effects)
    for number, (unit, one) in enumerate(zip(state.units, credible, strict=False)):
        if state.known[number].family:
            continue
        own = Cause(state.fitted[unit[0]], one.probability, known + unit[0])
        rivals = [Cause(*pair) for pair in _possible(one)]
        rivals += [Cause(None, one.nothing)] if one.nothing >= DOUBT else []
        found.append([(own, other) for other in rivals])
    missing = credible[-1]
    if not state.known and DOUBT < 1.0 - missing.nothing < CREDIBLE:
        some, none = [Cause(*pair) for pair in _possible(missing)], Cause(None, missing.nothing)
        found.append([*((one, none) for one in some), *combinations(some, 2)])
    return [group for group in found if group]


def _possible(one: Credible) -> list[tuple[Effect, float]]:
    pairs = [(_effect(each), chance) for each, chance in one.others if not each.family and chance >= POSSIBLE]
    return pairs[:RIVALS]


def _effect(one: Hypothesis) -> Effect:
    return one.one.effect(np.zeros(len(one.one.location.terms)))


def _before(state: State) -> Before:
    """Return arm and campaign as a plan takes them; a random twist knows only the poses it was fitted to."""
    fit, campaign = state.fit, state.measurements
    count = len(state.declared.arm.effects) + len(state.effects)
    setup = replace(fit.setup, arm=replace(fit.setup.arm, effects=fit.setup.arm.effects[:count]))
    weights = np.zeros((len(campaign), fit.view.readings.size))
    weights[fit.view.rows] = fit.weights / certainty_of(fit).design_effect
    view = look(setup, campaign)
    left = fit.view.readings.row_squares(view.whitened[fit.view.rows] * np.sqrt(fit.weights))
    scatter = float(np.sqrt(left.sum() / max(fit.view.count, 1)))
    noises = {name: max(noise, scatter if state.random is not None else 1.0) for name, noise in noises_of(fit).items()}
    return Before(setup, Measured(campaign, view, weights, fit), noises)


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


def lacking(measurements: Measurements, context: Context) -> tuple[str, ...]:
    """Return in words what would make a campaign able to show more."""
    told, used = [], measurements.measured
    kinds = len({payload for payload, read in zip(measurements.payload, used, strict=True) if read})
    if kinds < 3:
        told.append(
            f"Measure with three payloads, one in between: {kinds} cannot distinguish a curved law from a linear one."
        )
    if len(set(measurements.session)) < 2:
        told.append(
            "Set the instrument up again half way: one session cannot distinguish a drift of the base "
            "from one of the arm."
        )
    turned = measurements.approach[used]
    one_way = [name for i, name in enumerate(measurements.joint_names) if len(set(turned[:, i].tolist()) - {0.0}) < 2]
    if one_way:
        told.append(f"Approach poses from both sides with {', '.join(one_way[:4])}: backlash does not show otherwise.")
    derived = [name for name in measurements.derived if name != "time"]
    if derived:
        told.append(
            f"Write down {', '.join(derived[:4])}: the direction a joint came from was taken from the rows before."
        )
    if "time" in measurements.derived:
        told.append("Write down the time of every row: nothing that drifts, lags or slips was looked for.")
    cylinders = [one.name for one in context.robot.linkage.cylinders]
    if cylinders and "hold" not in context.recorded:
        told.append(
            f"Write down in a column `hold` how long each pose has stood [s], and let it differ: whether "
            f"{listing(cylinders)} leaks was not looked for."
        )
    if len(set(zip(measurements.pose, measurements.payload, strict=True))) == len(measurements):
        told.append("Repeat ten poses or more: repeats give the noise without any model.")
    return tuple(told)
