"""From a question to rows to measure: what is known, what could be asked, the best of it, and what it will tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import Flag, InputError
from armflex.estimate.spread import scene_of
from armflex.estimate.view import look
from armflex.laws.effects.effect import Effect
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.measurements import Measurements
from armflex.parameters import Kind
from armflex.plan.choose import exchanged, greedy, path
from armflex.plan.design_model import Before, Model, answers, known_before, learning, model_of
from armflex.plan.drive import driven
from armflex.plan.information import DsOptimal, Goal, IOptimal, TOptimal, Truth
from armflex.plan.offer import Offer, Reach, around, rows_at, spread
from armflex.plan.question import Question, check, reach_of, sigma_of
from armflex.plan.recommend import blind_spots
from armflex.plan.result import TOLD, UNKNOWN, Plan
from armflex.plan.rivals import Rival, named_effect, refitted, rival_of, spelled, suspect_of
from armflex.readings import Position, unread
from armflex.rows import Rows
from armflex.trajectory import Trajectory

Progress = Callable[[int, int], None]

OFFERED = 1024
"""Rows among which the first choice is made, a power of two."""

ROUNDS, WIDTH, NARROWER, NEAR = 5, 0.3, 0.6, 20
"""How often rows near the chosen ones are tried, how near [share of the range] at first, how much nearer each time, and
how many for each."""

PATH_ROWS = 400
"""Rows of a trajectory that are looked at, evenly, where it has more."""

DRAWS, FURTHER = 8, 3
"""Random choices that a plan is held against, and how many times as many rows they have."""

SCATTER = 1.5
"""Noise over the stated one beyond which a plan that goes by it is doubtful."""


def make(arm: Arm, after: Measurements | None, asked: Question, progress: Progress | None) -> Plan:
    """Return the plan; `armflex.plan` says what goes in."""
    check(asked)
    tick = progress or (lambda done, total: None)
    effects = [named_effect(text, arm, tuple(asked.covariates)) for text in asked.between or ()]
    if effects and effects[0] == effects[1]:
        raise InputError(f"{spelled(effects[0])} is to be told from itself: name two effects")
    task = _task(known_before(arm, after, as_stated=bool(effects)), asked, effects)
    tick(1, ROUNDS + 1)
    return _concluded(task, *_chosen(task, tick))


@dataclass(frozen=True, eq=False)
class _Task:
    """A question with everything that is known about it; see `Plan`."""

    asked: Question
    before: Before
    reach: Reach
    doubts: tuple[Flag, ...]
    offer: Offer
    model: Model
    rivals: tuple[Rival, ...]
    goal: Goal


def _task(before: Before, asked: Question, effects: Sequence[Effect]) -> _Task:
    arm = before.setup.arm
    reach, doubts = reach_of(before, asked, effects)
    path = () if asked.along is None else asked.along.derived_directions(arm)
    doubts = (*before.flags, *path, *doubts)
    offer = spread(reach, before.setup, OFFERED, asked.seed)
    if len(offer.rows) < asked.rows:
        raise InputError(f"{asked.rows} rows: only {len(offer.rows)} of {OFFERED} that were offered can be measured")
    before, offer = learning(before, offer)
    suspects = [suspect_of(effect, arm, offer) for effect in effects]
    refits = [refitted(suspect, before) for suspect in suspects]
    explained = min((max(found.noise, 1.0) for found in refits if found), default=before.noise)
    if explained < before.noise:  # one of them is what makes readings scatter
        before = replace(before, noise=explained)
        reach = replace(reach, sigma=sigma_of(before, asked.sigma))
        offer = offer.with_sigma(reach.sigma)
    model = model_of(before, offer, suspects)
    if before.noise > SCATTER:
        text = f"readings scatter {before.noise:.2g} times as much as stated: something is missing, trace it first"
        doubts = (*doubts, Flag("unexplained_residual", text))
    rivals = tuple(rival_of(suspect, found, offer) for suspect, found in zip(suspects, refits, strict=True))
    return _Task(asked, before, reach, doubts, offer, model, rivals, _goal(before, model, offer, rivals, asked))


def _goal(before: Before, model: Model, offer: Offer, rivals: Sequence[Rival], asked: Question) -> Goal:
    """Return what is to be made as large as can be."""
    if rivals:
        truths = tuple(_truth(model, rival) for rival in rivals)
        every = model.known.with_rows(model.rows(offer))
        # One law may hold the other as a special case: then rows are for the case that the wider one is true.
        tellable = tuple(truth for truth in truths if TOptimal((truth,)).value(every) >= TOLD**2)
        return TOptimal(tellable or truths)
    if not model.moving.any():
        raise InputError(
            "nothing is free: [prior] has neither joint_offset, compliance nor geometry, no law is to be learned, and "
            "the arm has no effect"
        )
    if asked.along is None:
        return DsOptimal(np.flatnonzero(model.moving))
    return IOptimal(_weight(before, model, asked.along))


def _truth(model: Model, rival: Rival) -> Truth:
    places = model.place(rival.suspect)
    own = np.zeros(len(model.scale))
    own[places] = rival.size / model.scale[places]
    return Truth(own, np.setdiff1d(np.arange(len(own)), places), float(own @ own))


def _weight(before: Before, model: Model, trajectory: Trajectory) -> Array:
    """Return the (P, P) mean over a trajectory of what parameters do to its readings, squared [m^2]."""
    arm = before.setup.arm
    some = np.unique(np.linspace(0, len(trajectory) - 1, min(len(trajectory), PATH_ROWS)).astype(int))
    ordered = trajectory.for_arm(arm)
    known = {name: values[some] for name, values in ordered.known.items()}
    payload = tuple(trajectory.payload[i] for i in some)
    rows = rows_at(arm, ordered.q[some], payload, known)
    view = look(before.setup, rows, np.arange(len(some)), readings=unread(len(some), Position))
    seen = answers(model.blocks, view, scene_of(view, rows)) * model.scale
    return np.tensordot(seen, seen, axes=([0, 1], [0, 1])) / len(some)


def _chosen(task: _Task, tick: Progress) -> tuple[Rows, Array]:
    """Return the rows chosen, and their (n, 3, P) changes; first of all that are offered, then of what is near."""
    goal, known, offer, count = task.goal, task.model.known, task.offer, task.asked.rows
    rng = np.random.default_rng(task.asked.seed)
    rows = task.model.rows(offer)
    chosen = exchanged(goal, known, rows, greedy(goal, known, rows, count), 3)
    width = WIDTH
    for number in range(ROUNDS):
        offer = around(task.reach, task.before.setup, offer.box[chosen], width, NEAR, rng)
        rows = task.model.rows(offer)
        chosen = exchanged(goal, known, rows, range(count), 2)
        width *= NARROWER
        tick(number + 2, ROUNDS + 1)
    told = rows[chosen]
    best = greedy(goal, known, told, count)
    return offer.rows.some(np.array(chosen)[best]), told[best]


def _concluded(task: _Task, chosen: Rows, rows: Array) -> Plan:
    """Return the plan of rows chosen, the most telling first, and their (n, 3, P) changes."""
    model, reach, goal, campaign = task.model, task.reach, task.goal, task.before.campaign
    every, known = model.rows(task.offer), model.known.with_rows(rows)
    reached = path(goal, model.known, rows)
    start = np.clip(np.zeros(len(reach.lower)), reach.lower, reach.upper)
    stops, order, way = driven(chosen, reach, start if campaign is None else campaign.q[-1])
    return Plan(
        rows=stops,
        reach=reach,
        goal=goal,
        model=model,
        known=known,
        worth=np.diff(reached)[order],
        reached=reached,
        random=_at_random(goal, model, every, FURTHER * len(rows), task.asked.seed),
        everything=goal.value(model.known.with_rows(every)),
        rivals=task.rivals,
        blind=blind_spots(model, every, float(reach.sigma.max())),
        offered=task.offer,
        doubt=_doubts(model, reach, every, rows, task.asked.seed),
        way=way,
        flags=task.doubts,
    )


def _at_random(goal: Goal, model: Model, rows: Array, count: int, seed: int) -> Array:
    """Return (DRAWS, m + 1) what the goal reaches with rows at random."""
    rng = np.random.default_rng(seed)
    most = min(count, len(rows))
    return np.array([path(goal, model.known, rows[rng.choice(len(rows), most, False)]) for _ in range(DRAWS)])


def _doubts(model: Model, reach: Reach, every: Array, rows: Array, seed: int) -> dict[str, Array]:
    """Return what to draw by its title: (N,) standard deviations of what would be read in 3-D [m].

    How the next session moves the instrument is no part of it: that is not of the arm.
    """
    chosen = np.random.default_rng(seed).choice(len(every), len(rows), False)
    states, measured = {"known now": model.known}, every
    every = every * np.array([one.group.kind is not Kind.SESSION for one in model.parameters])
    if _doubt(reach, every, model.known).min() > UNKNOWN:
        states = {f"after {len(rows)} readings at random": model.known.with_rows(measured[chosen])}
    states[f"after {len(rows)} planned readings"] = model.known.with_rows(rows)
    return {title: _doubt(reach, every, known) for title, known in states.items()}


def _doubt(reach: Reach, rows: Array, known: LinearGaussian) -> Array:
    seen = rows * reach.sigma[:, None]
    return np.sqrt(np.maximum(np.einsum("ndp,pq,ndq->n", seen, known.covariance, seen, optimize=True), 0.0))
