"""Rows that decide between the causes that a campaign left possible, in the order to drive them.

First rows are chosen, whatever goes before them, by the bound on the probability of a wrong name that they leave
(`armflex.plan.design.Named`). Then their order, as what remembers the rows before, and the side that a joint comes
from, follow from it: orders at random, and the best of them with rows exchanged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.estimate.block import amplitude_prior
from armflex.estimate.blocks import sensor_block
from armflex.estimate.view import View, look
from armflex.laws.effects.effect import Effect
from armflex.laws.row import MASS
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import numbers_of
from armflex.plan.design import Named, Truth, exchanged, greedy
from armflex.plan.design_model import NOWHERE, Before, CandidateBlock, DesignModel, answers, learning, model_of
from armflex.plan.drive import driving_order
from armflex.plan.instruments import unlike
from armflex.plan.offer import Offer, Reach, around, spread_evenly
from armflex.plan.planned_rows import DISTINGUISHED
from armflex.plan.planning import reach_of
from armflex.readings import Position, Readings
from armflex.readings.encoder import Shaft
from armflex.readings.sensor import Sensor
from armflex.rows import Rows
from armflex.rows.rows import APPROACH, STILL, last_motion

OFFERED, ROUNDS, WIDTH, NEAR = 256, 2, 0.2, 8
"""Tolerance: rows among which the first choice is made, a power of two; how often rows near the chosen ones are tried,
how near [share of the range] at first, and how many for each."""

ORDERS, IMPROVED = 32, 3
"""Tolerance: orders of the rows that are tried, and how often as many with two rows of the best one exchanged are."""

APART = 600.0
"""Time between two rows [s]."""

READ, SPLIT = 20, 5.0
"""Rows of the campaign in which another instrument is thought of, and the expected difference in standard deviations
from which it distinguishes two causes: by more than the odds within which causes are in question."""

SPLITTING = {
    "level": "a level on {place}",
    "encoder": "an encoder on the links of {place}",
    "wire": "a wire to {place}",
}
"""Instruments that are thought of, and how they are named."""


@dataclass(frozen=True, eq=False)
class Cause:
    """What may be in one place of a model.

    Attributes:
        effect: The effect, with values inside its law; None where there may be none.
        probability: Of it.
        ordinal: Its place among the effects of the arm, `NOWHERE` where the arm has it not.
    """

    effect: Effect | None
    probability: float
    ordinal: int = NOWHERE


Pair = tuple[Cause, Cause]
"""Two causes of which one may stand in the other's place, the first one an effect."""


@dataclass(frozen=True, eq=False)
class Question:
    """Causes that are possible, and how any row could distinguish them.

    Attributes:
        before: Arm and campaign.
        reach: What can be asked of the arm.
        pairs: The causes.
        offer: Rows spread over all that can be asked.
        model: What is free.
        goal: The bound; pairs that no row distinguishes have no part in it.
        open: (K,) which pairs rows distinguish.
    """

    before: Before
    reach: Reach
    pairs: tuple[Pair, ...]
    offer: Offer
    model: DesignModel
    goal: Named
    open: np.ndarray

    @staticmethod
    def of(before: Before, pairs: Sequence[Pair], settable: Mapping[str, Sequence[float]], count: int) -> Question:
        """Return the question put to `count` rows, a power of two.

        Args:
            before: Arm and campaign, everything that was found in it.
            pairs: The causes.
            settable: Values that can be set of recorded columns; others stay as they were last.
            count: Of the rows that are offered.

        Raises:
            ArmflexError: The arm holds none of them.
        """
        measured = before.measured
        assert measured is not None
        causes = list({id(cause): cause for pair in pairs for cause in pair if cause.effect is not None}.values())
        effects = [cause.effect for cause in causes if cause.effect is not None]
        reach = _reach(before, effects, settable)
        before, offer = learning(before, spread_evenly(reach, before.setup, count, 0))
        numbers, blocks = numbers_of(before.setup.arm.effects), dict[int, CandidateBlock]()
        for cause, effect in zip(causes, effects, strict=True):
            number = 1 if cause.ordinal == NOWHERE else numbers[cause.ordinal]
            prior = amplitude_prior(effect, (), measured.view, measured.view.context)
            blocks[id(cause)] = CandidateBlock(effect, (), offer.view.context, cause.ordinal, prior, number=number)
        model = model_of(before, offer, list(blocks.values()))
        foreign = np.concatenate(
            [np.zeros(0, int), *(model.place(blocks[id(cause)]) for cause in causes if cause.ordinal == NOWHERE)]
        )
        kinds, truths = measured.view.readings.kinds, []
        noise = np.concatenate([np.full(kind.dimension, before.noises.get(kind.name, 1.0)) for kind in kinds])
        left = measured.view.whitened * measured.weights / noise**2
        for cause, other in pairs:
            step, block = np.zeros(len(model.scale)), blocks[id(cause)]
            place = model.place(block)
            rival = model.place(blocks[id(other)]) if other.effect is not None else place[:0]
            others = np.setdiff1d(np.arange(len(step)), np.setdiff1d([*foreign, *place], rival))
            if cause.ordinal != NOWHERE:
                step[place] = block.effect.acting / model.scale[place]
            else:  # as it is fitted to what everything else leaves
                score, kept = np.zeros(len(step)), np.append(np.setdiff1d(others, rival), place)
                # The products of its whitened columns with what the campaign's fit leaves.
                score[place] = (
                    np.tensordot(answers([block], measured.view), left, axes=([0, 1], [0, 1])) * model.scale[place]
                )
                step[place] = model.known.conditional(kept).solve(score[kept])[-len(place) :]
            truths.append(Truth(step, others, float(step @ step)))
        now = np.array([truth.chi_square(model.known, truth.departure(model.known)) for truth in truths])
        chances = np.sqrt([cause.probability * other.probability for cause, other in pairs])
        goal = Named(tuple(truths), chances, now)
        distinct = goal.apart(model.known.with_rows(model.rows(offer))) >= DISTINGUISHED**2
        goal = replace(goal, chances=np.where(distinct, chances, 0.0))
        return Question(before, reach, tuple(pairs), offer, model, goal, distinct)

    def rows(self, count: int, stem: str) -> RequestedRows | None:
        """Return the rows that decide most, None where none decides anything.

        Args:
            count: How many.
            stem: How their poses begin, and their session.
        """
        if not self.open.any():
            return None
        gram, rng, here, width = self.model.known, np.random.default_rng(0), self.offer, WIDTH
        near = self.model.rows(here)
        chosen = exchanged(self.goal, gram, near, greedy(self.goal, gram, near, count), 1)
        for _ in range(ROUNDS):
            here = around(self.reach, self.before.setup, here.box[chosen], width, NEAR, rng)
            near = self.model.rows(here)
            chosen = exchanged(self.goal, gram, near, range(count), 1)
            width *= 0.5
        rows = here.rows.some(chosen)
        measured = self.before.measured
        assert measured is not None
        q, span = measured.campaign.q[-1], np.maximum(self.reach.upper - self.reach.lower, STILL)
        short = driving_order(rows.q, rows.payload, q, span)
        orders = [np.array(short), *(rng.permutation(count) for _ in range(ORDERS))]
        if not self.depends_on_order:
            orders = orders[:1]
        values = self._values(rows, orders)
        for _ in range(IMPROVED if len(orders) > 1 else 0):
            best = orders[int(values.argmax())]
            more = [best.copy() for _ in range(ORDERS)]
            for order in more:  # two of its rows in each other's place
                first, other = rng.choice(count, 2, replace=False)
                order[[first, other]] = order[[other, first]]
            orders, values = [*orders, *more], np.append(values, self._values(rows, more))
        best = orders[int(values.argmax())]
        names = tuple(f"{stem} {i + 1}" for i in range(len(best)))
        approach = last_motion(np.vstack([q, rows.q[best]]))[1:]
        kept = replace(rows.some(best), pose=names, approach=approach, session=(stem,) * count)
        given = measured.campaign.derived
        named = tuple(name for name in self.reach.arm.joint_names if f"{APPROACH}{name}" not in given)
        stated = self.reach.sigma / self.before.noises.get("", 1.0)  # however far readings scatter
        reach = replace(self.reach, approached=named, sigma=stated)
        return RequestedRows(
            kept, reach, dict(measured.campaign.units), stem, -self.goal.value(gram), -float(values.max())
        )

    @property
    def depends_on_order(self) -> bool:
        """Whether a cause, or an effect of the arm, remembers the rows before or depends on where joints come from."""
        effects = [
            *self.before.setup.arm.effects,
            *(effect.effect for pair in self.pairs for effect in pair if effect.effect),
        ]
        return any(
            effect.remembers or any(APPROACH in name for name in effect.location.covariates) for effect in effects
        )

    def _values(self, rows: Rows, orders: Sequence[np.ndarray]) -> Array:
        """Return the goal after (n,) rows in each of some orders, the campaign's last row before them."""
        measured = self.before.measured
        assert measured is not None
        count = len(rows)
        way = rows.some(np.concatenate([[order[0], *order] for order in orders]))
        q = way.q.reshape(len(orders), count + 1, -1).copy()
        q[:, 0] = measured.campaign.q[-1]
        approach = np.concatenate([last_motion(positions) for positions in q])
        names = tuple(f"{number}" for number in range(len(orders)) for _ in range(count + 1))
        time = measured.campaign.time[-1] + APART * np.tile(np.arange(1.0, count + 2), len(orders))
        way = replace(way, q=q.reshape(len(way), -1), approach=approach, campaign=names, time=time)
        view = look(self.before.setup, way, readings=self.reach.unread(way))
        seen = answers(self.model.blocks, view) * self.model.scale
        seen = seen.reshape(len(orders), count + 1, *seen.shape[1:])[:, 1:]
        return np.array([self.goal.value(self.model.known.with_rows(seen_rows)) for seen_rows in seen])

    @cached_property
    def _unread(self) -> tuple[View, Array, dict[str, Sensor]]:
        """Rows of the campaign with every instrument that nobody has, how its readings answer, and them by name."""
        assert self.before.measured is not None
        view = self.before.measured.view
        declared, read = view.arm.sensors, view.readings.names
        sampled = view.some(np.unique(np.linspace(0, len(view.rows) - 1, READ).astype(int)))
        sensors = {sensor.name: sensor for word in SPLITTING for sensor in unlike(view.arm, word, read)}
        sensors = {name: sensor for name, sensor in sensors.items() if name not in declared}
        setup = replace(view.setup, arm=replace(view.arm, sensors={**declared, **sensors}))
        kinds = tuple(sensor.kind.unread(len(sampled.rows), sensor.sigma, sensor.name) for sensor in sensors.values())
        readings = Readings(len(sampled.rows), kinds)
        here = replace(sampled, setup=setup, readings=readings, residual=np.zeros((len(sampled.rows), readings.size)))
        here = replace(here, readings=readings.within_range(here.at))
        after = answers([block.of_rows(view.context) for block in self.model.blocks], here) * self.model.scale
        return here, after, sensors

    def split_by(self, number: int) -> tuple[tuple[str, float], ...]:
        """Return the best of each sort of instrument nobody has that distinguishes a pair, and by how much [sigma].

        Each is read in some rows of the campaign. What is open of an instrument itself is found from the same readings.
        """
        gram, truth = self.model.known, self.goal.truths[number]
        others, departure = gram.conditional(truth.others), truth.departure(gram)
        here, after, sensors = self._unread
        assert self.before.measured is not None
        view, best = self.before.measured.view, dict[str, tuple[str, float]]()
        unread = [sensor for name, sensor in view.arm.sensors.items() if name not in view.readings.names]
        for kind, place in here.readings.placed:
            open_of_it = sensor_block(here.setup, kind.name, ("",))
            columns = open_of_it.jacobian(here)[:, place] / here.sigma[:, place, None]
            rows = after[:, place].reshape(-1, len(truth.own))
            there, columns = rows[:, truth.others], columns.reshape(len(rows), -1)
            # What no reading determined so far is found from these, too.
            free = np.hstack([columns, there @ others.null_space.T])
            precision = np.append(open_of_it.prior**-2.0, np.zeros(len(others.null_space)))
            spread = np.eye(len(rows)) + there @ others.solve(there.T)
            left = np.linalg.solve(spread, rows @ departure)
            score, information = free.T @ left, free.T @ np.linalg.solve(spread, free)
            taken = score @ LinearGaussian(information + np.diag(precision)).solve(score)
            more = float((rows @ departure) @ left - taken)
            word, sensor, sigmas = kind.name.partition("_")[0], sensors[kind.name], float(np.sqrt(max(more, 0.0)))
            if sigmas > max(SPLIT, best.get(word, ("", 0.0))[1]):
                link = "the tip" if sensor.link == view.arm.robot.tip else sensor.link
                text = SPLITTING[word].format(place=sensor.about.joint if isinstance(sensor.about, Shaft) else link)
                there = any(other.link == sensor.link and other.kind is sensor.kind for other in unread)
                best[word] = f"another {text.split(' ', 1)[1]}" if there else text, sigmas
        return tuple(sorted(best.values(), key=lambda option: -option[1]))


@dataclass(frozen=True, eq=False)
class RequestedRows:
    """Rows to drive and to read, in their order; the side that joints come from follows from it.

    Attributes:
        rows: They.
        reach: What could be asked.
        units: Of the campaign, by column.
        stem: How their poses begin.
        before, after: The most that the probability of a wrong name can be, of the pairs that rows distinguish.
    """

    rows: Rows
    reach: Reach
    units: Mapping[str, str]
    stem: str
    before: float
    after: float


def _reach(before: Before, effects: Sequence[Effect], settable: Mapping[str, Sequence[float]]) -> Reach:
    """Return what can be asked of the arm so that what effects depend on is known."""
    assert before.measured is not None
    campaign, arm = before.measured.campaign, before.setup.arm
    recorded = campaign.known
    needed = {name for effect in (*arm.effects, *effects) for name in effect.columns}
    needed = {name for name in needed if not name.startswith(("q_", APPROACH)) and name != MASS}
    levels = {name: settable.get(name, (float(recorded[name][-1]),)) for name in sorted(needed) if name != "time"}
    if "hold" in levels and "hold" not in settable:  # waiting needs nothing
        levels["hold"] = (float(recorded["hold"].min()), float(recorded["hold"].max()))
    last = {"time": (float(campaign.time[-1]) + APART,)} if "time" not in campaign.derived else {}
    reach, _ = reach_of(
        before, effects, None, levels | ({"time": last["time"]} if "time" in needed else {}), None, None
    )
    at_tip = any(isinstance(kind, Position) and not kind.name for kind in campaign.readings.kinds)
    read = tuple(name for name in campaign.readings.names if name or at_tip)
    blank = tuple(name for name, values in levels.items() if len(values) == 1)
    return replace(reach, levels=levels | last, read=read, blank=(*blank, *last))
