"""What a plan is: rows in the order to drive them, what they should determine, and what no tip reading does."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.estimate.block import EffectBlock
from armflex.estimate.identify import UNDETERMINED, partners_of
from armflex.files.dh_table import in_dh_words
from armflex.laws.effects.compliance import COMPLIANCE
from armflex.laws.effects.shapes import IN_THE_BASE, ON_THE_LINK
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import FRAMES, ParameterKind, numbered
from armflex.plan.design import Goal, IOptimal, TOptimal, instead, shows
from armflex.plan.design_model import CandidateBlock, DesignModel
from armflex.plan.effects_in_question import EffectInQuestion
from armflex.plan.instruments import Mounted, declaration, informing_levels
from armflex.plan.offer import Offer, Reach
from armflex.result import Result, record
from armflex.rows import Rows

DISTINGUISHED = 3.0
"""Standard deviations at which two effects are distinguished."""

UNKNOWN = 1.0
"""Standard deviation of a reading [m] beyond which nothing is known of where the instrument stands."""

UNLOADED = "pull the tip sideways with a known force"
"""For compliances that weight alone does not load enough to be seen."""

MOST_NAMES = 6
"""Parameters that one line of advice names."""


@dataclass(frozen=True)
class Blind:
    """A parameter on which no tip reading depends.

    Attributes:
        name: Block and label.
        moves: What one standard deviation of it moves a reading by at most [m].
        partners: Parameters that it can be exchanged for without the readings noticing; empty where it moves them too
            little to be seen beside the noise.
        instead: What would determine it.
    """

    name: str
    moves: float
    partners: tuple[str, ...]
    instead: str


def blind_spots(model: DesignModel, rows: Array, tip: Array, levels: Collection[str]) -> tuple[Blind, ...]:
    """Return the parameters that stay as uncertain as [prior] has them though all of (N, d, P) rows were measured.

    Only those of the arm: neither where the instrument stands nor what is in question. `tip` is the (N, 3, P) change
    of the tip's position [m] in those rows; `levels` are where a level would help, see `informing_levels`.
    """
    seen = np.tensordot(rows, rows, axes=([0, 1], [0, 1]))
    whole = model.known.with_rows(rows)
    left = model.std(whole) > UNDETERMINED * model.prior
    most = np.sqrt((tip**2).sum(axis=1)).max(axis=0)
    first = next(
        (parameter.group.of for parameter in model.parameters if parameter.group.kind is ParameterKind.GEOMETRY), None
    )
    directions = []
    for block in model.blocks:
        if block.kind in FRAMES or isinstance(block, CandidateBlock):
            continue
        law = block.looks_like
        for place in model.place(block)[left[model.place(block)]].tolist():
            faint = seen[place, place] < 1.0
            partners = () if faint else partners_of(seen, whole, place, model.names)
            unloaded = faint and block.kind in COMPLIANCE.stands_for
            of = block.effect.location.place if isinstance(block, EffectBlock) else model.parameters[place].group.of
            how = UNLOADED if unloaded else (shows(law, of or "", levels) if law is not None else "") or ON_THE_LINK
            if block.kind is ParameterKind.GEOMETRY and of == first:  # where the arm stands, not how it is built
                how = IN_THE_BASE
            directions.append(Blind(model.names[place], float(most[place]), partners, how))
    return tuple(directions)


@dataclass(frozen=True, repr=False, eq=False)
class Plan(Result):
    """Rows to measure, in the order to drive them, and what they are expected to determine.

    Attributes:
        rows: All stops; `measured` where a position is to be read, elsewhere the arm only comes from the right side.
        reach: What could be asked.
        goal: What was made as large as it can be.
        model: Parameters, and what is known before.
        known: What will be known after the rows, in units of `model.scale`.
        worth: (n,) dimensionless rise of the goal's value by each row read, the best first one alone, and so on.
        reached: (n + 1,) the goal's value, in its unit, after none, one, ... of them, the most informative first.
        random: (d, m + 1) the same, in the goal's unit, of d draws of poses at random.
        everything: The goal's value if all rows that were offered were measured.
        hypotheses: The effects in question, if any.
        blind: Parameters on which no tip reading depends.
        offered: Rows that were offered first, spread evenly.
        uncertainty: By title, (N,) standard deviation there of what the instrument would read, in 3-D [m]: before or,
            while nothing is known of where the instrument stands, after as many rows at random; and after the plan.
        way: Motion of all joints together, in ranges, and what it would be in the order in which rows were chosen.
        flags: Flags.
        mounts: Instruments whose places were chosen.
        units: Of the campaign before, by column; see `Measurements`.
    """

    rows: Rows
    reach: Reach
    goal: Goal
    model: DesignModel
    known: LinearGaussian
    worth: Array
    reached: Array
    random: Array
    everything: float
    hypotheses: tuple[EffectInQuestion, ...]
    blind: tuple[Blind, ...]
    offered: Offer
    uncertainty: Mapping[str, Array]
    way: tuple[float, float]
    flags: tuple[Flag, ...]
    mounts: tuple[Mounted, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    ROWS = "table"

    def content(self) -> dict[str, Any]:
        """Return the stops and what they are expected to give, SI; what was reached is as the terminal shows it."""
        goal, rows, read = self.goal, self.rows, iter(self.worth)
        worth = [next(read) if measured else None for measured in rows.measured]
        stops = zip(rows.pose, rows.payload, rows.q, worth, strict=True)
        reached = {"reached": self.reached, "random": self.random.mean(axis=0), "everything": self.everything}
        instruments = [
            record(mount, "reached without", name="sensor.name", link="sensor.link")
            | {"declare": declaration(mount.sensor), "elsewhere": dict(mount.others)}
            for mount in self.mounts
        ]
        return {
            "rows": len(self.worth),
            "stops": [
                {"pose": pose, "read": gain is not None, "payload": payload, "worth": gain}
                | {"q": dict(zip(rows.joint_names, q, strict=True))}
                for pose, payload, q, gain in stops
            ],
            "sigma_m": self.reach.sigma,
            "goal": goal.title,
            "expected": {name: goal.shown(value) for name, value in reached.items()} | record(self, "random_rows"),
            "parameters": self.certainties,
            "separation_sigmas": goal.shown(self.reached[-1]) if self.hypotheses else None,
            "between": [
                record(hypothesis, "name source")
                | {"size": dict(zip(hypothesis.candidate.labels, hypothesis.size, strict=True))}
                for hypothesis in self.hypotheses
            ],
            "not_told": [
                record(blind, "instead", parameter="name", trades_against="partners", moves_m="moves")
                for blind in self.blind
            ],
            "left_out": dict(self.offered.dropped),
            **({"instruments": instruments} if instruments else {}),
            "motion": {"ordered": self.way[0], "as_chosen": self.way[1]},
            **record(self, "advice flags"),
        }

    @property
    def certainties(self) -> list[dict[str, Any]]:
        """Every parameter that was not certain, with its standard deviation before and after, in its unit."""
        blind = {direction.name for direction in self.blind}
        values = zip(self.model.parameters, self.std_before.tolist(), self.std_after.tolist(), strict=True)
        return [
            record(parameter, "unit", name="label")
            | {"before": before, "after": after, "told_by_tip": parameter.label not in blind}
            for parameter, before, after in values
            if before > 0.0
        ]

    @property
    def table(self) -> dict[str, Any]:
        """Every stop in the order to drive them: pose, payload, joints [rad or m], whether something is read there."""
        rows = self.rows
        q = {f"q_{name}": rows.q[:, i] for i, name in enumerate(rows.joint_names)}
        return {"pose": rows.pose, "payload": rows.payload, **q, "measured": rows.measured}

    def __repr__(self) -> str:
        """One line: how much is to be read, and what it will give."""
        before, after = (self.figure(value) for value in self.reached[[0, -1]])
        return f"<Plan: {len(self.worth)} rows to read, {self.goal.title} {before} -> {after}>"

    def figure(self, value: float) -> str:
        """Return the goal's value as it is shown, "instrument not placed yet" beyond `UNKNOWN`."""
        if isinstance(self.goal, IOptimal) and -value > UNKNOWN**2:
            return "instrument not placed yet"
        return f"{float(self.goal.shown(value)):.3g}"

    @property
    def std_before(self) -> Array:
        """(P,) standard deviation of every parameter of `model.names` before, in its unit."""
        return self.model.std(self.model.known)

    @property
    def std_after(self) -> Array:
        """(P,) the same as it is expected to be after, in the parameters' units."""
        return self.model.std(self.known)

    @cached_property
    def random_rows(self) -> int | None:
        """How many poses at random reach as much on average, None where more than were tried."""
        enough = np.flatnonzero(self.random.mean(axis=0) >= self.reached[-1])
        return int(enough[0]) if len(enough) else None

    @cached_property
    def advice(self) -> tuple[str, ...]:
        """What no tip reading determines, and what would: a line for all that the same measurement would determine."""
        notes, words = list(_between(self)), in_dh_words(self.reach.arm.robot)
        for how in dict.fromkeys(direction.instead for direction in self.blind):
            alike = [direction for direction in self.blind if direction.instead == how]
            names = ", ".join(words.get(direction.name, (direction.name,))[0] for direction in alike[:MOST_NAMES])
            more = len(alike) - MOST_NAMES
            names += f", and {more} more" if more > 0 else ""
            most = max(direction.moves for direction in alike) * 1e3
            weight = f"under weight alone each moves the tip by {most:.1g} mm at most; where it matters"
            read = "No tip reading" if "" in self.reach.read else "None of these readings"
            notes.append(f"{read} determines {names}; {weight if how == UNLOADED else 'instead'}, {how}.")
        unread = [name for name in self.reach.arm.sensors if name not in self.reach.read]
        if unread and self.blind:
            also = ",".join([*(name or "tracker" for name in self.reach.read), *unread])
            notes.append(f"Not read in these rows: {', '.join(unread)}; --instruments {also} plans with all declared.")
        return tuple(notes)


def _between(plan: Plan) -> Iterator[str]:
    """Yield whether each two of the effects in question will be distinguished, and what else would distinguish them."""
    goal = plan.goal
    if not isinstance(goal, TOptimal):
        return
    places = [plan.model.place(hypothesis.candidate) for hypothesis in plan.hypotheses]
    named = [
        f"{hypothesis.candidate.effect.title}{numbered(hypothesis.candidate.number)}" for hypothesis in plan.hypotheses
    ]
    levels = informing_levels(plan.reach.arm, plan.reach.read)
    readings = "No tip reading" if "" in plan.reach.read else "None of these readings"
    for pair in combinations(range(len(places)), 2):
        # Of each effect as the true one, the other in its stead.
        truths = {
            i: truth
            for truth in goal.truths
            for i, j in (pair, pair[::-1])
            if truth.own[places[i]].any() and np.isin(places[j], truth.others).all()
        }
        said = " from ".join(named[i] for i in pair)
        effect, other = (plan.hypotheses[i].candidate.effect for i in pair)
        otherwise = instead(effect, other, levels)
        if not truths or goal.shown(plan.everything) < DISTINGUISHED:
            yield f"{readings} distinguishes {said}; instead, {otherwise}."
            continue
        if len(truths) == 1:
            (true,) = truths
            false = pair[0] + pair[1] - true
            yield (
                f"Were {named[false]} true, {named[true]} and what calibration frees would do as well whatever is "
                f"read; these rows are for the case that it is {named[true]}. Otherwise, {otherwise}."
            )
        apart = float(goal.shown(TOptimal(tuple(truths.values())).value(plan.known)))
        if apart < DISTINGUISHED:
            more = int(np.ceil((len(plan.reached) - 1) * (DISTINGUISHED / max(apart, 1e-9)) ** 2))
            yield (f"These rows do not distinguish {said}: {apart:.2g} standard deviations; about {more} rows would.")
