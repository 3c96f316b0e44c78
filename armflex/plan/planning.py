"""From a question to rows to measure: what is known, what could be asked, the best of it, and what it determines."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from numbers import Integral

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import SLACK, Arm
from armflex.configurations import drawn_range
from armflex.conventions import Array
from armflex.errors import Flag, InputError, did_you_mean, listing, shown
from armflex.estimate.misreadings import USUAL_PRIOR
from armflex.estimate.view import look
from armflex.laws.effects.context import TEMPERATURE
from armflex.laws.effects.effect import Effect
from armflex.laws.row import MASS
from armflex.measured.measurements import Measurements, as_measurements
from armflex.measured.table import Tabular
from armflex.parameters import OF_SESSION, of_offsets
from armflex.plan.design import DsOptimal, Goal, IOptimal, TOptimal, Truth, exchanged, greedy, path
from armflex.plan.design_model import Before, DesignModel, answers, known_before, learning, model_of, noises_of
from armflex.plan.drive import driven
from armflex.plan.effects_in_question import (
    EffectInQuestion,
    candidate_of,
    hypothesis_of,
    named_effect,
    refitted,
    spelled,
)
from armflex.plan.instruments import TRACKER, Mounted, choose, informing_levels, offered
from armflex.plan.offer import Offer, Reach, around, rows_at, spread_evenly
from armflex.plan.planned_rows import DISTINGUISHED, UNKNOWN, Plan, blind_spots
from armflex.readings import Position, TouchingSensor, unread
from armflex.readings.sensor import LONGEST, Sensor
from armflex.rows.rows import APPROACH
from armflex.trajectory import Trajectory, as_trajectory

MOST_ROWS = 500

COARSEST = 0.01
"""Standard deviation of a position read, as a share of the arm's reach, beyond which it is no measurement."""

READING = 2e-4
"""Standard deviation of a position read [m] where nobody says: a laser tracker some metres away."""

CLEAR, NARROW = 3.0, 0.01
"""Standard deviations of a joint's zero by which rows keep clear of its limits, and the most of its range."""

OFFERED = 1024
"""Rows among which the first choice is made, a power of two."""

CHOOSING, FEWEST = 256, 40
"""Rows among which places of instruments are compared, a power of two, and how many are read there at least."""

ROUNDS, WIDTH, NARROWER, NEAR = 5, 0.3, 0.6, 20
"""How often rows near the chosen ones are tried, how near [share of the range] at first, how much nearer each time, and
how many for each."""

DRAWS, FURTHER = 8, 3
"""Random choices that a plan is compared with, and how many times as many rows they have."""


@checked_kinds
def plan(
    arm: Arm,
    rows: int = 20,
    *,
    after: Measurements | Tabular | None = None,
    along: Trajectory | Tabular | None = None,
    between: Sequence[str] | None = None,
    payloads: Sequence[str] | None = None,
    covariates: Mapping[str, Sequence[float]] | None = None,
    sigma: float | None = None,
    floor: float | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    instruments: Sequence[str] | None = None,
) -> Plan:
    """Return the rows to measure next, in the order to drive them, and what they are expected to determine.

    Without `along` or `between` the rows make the parameters that [prior] frees, and those of the arm's effects, as
    certain as can be, wherever the instrument stands.

    Args:
        arm: The arm, declared or calibrated; of a calibrated one the stored covariance is what is known before.
        rows: How many positions will be read.
        after: What was measured already; an arm that is not calibrated is calibrated with it.
        along: Make the predicted readings along this trajectory as certain as can be instead.
        between: Distinguish these effects instead, two or more, each spelled LAW:SITE[:AXIS[:PARTNER]], as `trace`
            names them; the second effect of the arm with such a spelling ends in #2.
        payloads: What may be carried; every payload of the arm, and nothing, when not given.
        covariates: Values that can be set of what effects depend on, by name.
        sigma: Standard deviation of a position read [m]; that of `after`, else 0.2 mm, when not given.
        floor: Lowest height of any link, target or payload in the base frame [m]; when not given, 0, the
            height of the base, and none for an arm that hangs below it wherever it is.
        seed: Of the rows that are offered.
        progress: Called with (steps done, steps in all).
        instruments: What is read in the rows: names that the arm file declares, or 'wire', 'level', 'accelerometer',
            'encoder', 'target', whose best place is then chosen, and 'tracker'; that alone when not given.

    Raises:
        InputError: Nothing is free, no row is possible, a number is out of its range, or no values are given of what an
            effect depends on.
        UnknownNameError: No such payload, effect or site.
        UnsupportedError: What an effect in question does depends on the rows before.
        ArmflexError: The campaign cannot be that of this arm, see `calibrate`.
    """
    after = None if after is None else as_measurements(after, arm)
    along = None if along is None else as_trajectory(along, arm)
    settable, tick = covariates or {}, progress or (lambda done, total: None)
    _check(rows, seed, along, between, sigma, floor, settable)
    effects = _rivals(between or (), arm, tuple(settable))
    before = known_before(arm, after, as_stated=bool(effects))
    reach, flags = reach_of(before, effects, payloads, settable, sigma, floor)
    path_flags = () if along is None else along.derived_directions(before.setup.arm)
    flags = (*before.flags, *path_flags, *flags)
    mounts: tuple[Mounted, ...] = ()
    touching = [name for name, sensor in arm.sensors.items() if isinstance(sensor, TouchingSensor)]
    if instruments is None and touching and not (after and after.readings.of(Position)):
        instruments = touching
    if instruments is not None:
        if not len(instruments):
            raise InputError("instruments is empty: name what is read, such as 'tracker', or leave it out")
        before, reach, mounts = _mounted(before, reach, effects, instruments, rows, along, seed)
        # Sockets are where they are.
        mounts = tuple(mount for mount in mounts if not isinstance(mount.sensor, TouchingSensor))
    offer = spread_evenly(reach, before.setup, OFFERED, seed)
    if len(offer.rows) < rows:
        raise InputError(f"{rows} rows: only {len(offer.rows)} of {OFFERED} that were offered can be measured")
    before, offer = learning(before, offer)
    candidates = [candidate_of(effect, reach.arm, offer) for effect in effects]
    refits = [refitted(candidate, before) for candidate in candidates]
    fits = [before.measured.fit, *filter(None, refits)] if before.measured else []
    best = min(fits, key=lambda fit: max(fit.noise * max(fit.factors, default=1.0), 1.0), default=None)
    if best is not None and best is not fits[0]:  # one of them is what makes readings scatter
        before = replace(before, noises=noises_of(best))
        reach = replace(reach, sigma=_sigma_of(before, sigma), sigmas=before.sigmas)
        offer = offer.read_by(reach, before.setup)
    model = model_of(before, offer, candidates)
    flags = (*flags, *_scattered(before))
    pairs = zip(candidates, refits, strict=True)
    hypotheses = tuple(hypothesis_of(candidate, refit, offer) for candidate, refit in pairs)
    if not hypotheses and not model.moving.any():
        raise InputError(
            "nothing is free: [prior] has neither joint_offset, compliance nor geometry, no law is to be learned, and "
            "the arm has no effect"
        )
    every = model.rows(offer)
    goal = _goal(before, model, every, hypotheses, along)
    tick(1, ROUNDS + 1)

    gram = model.known
    here, best, informing = _chosen(before, reach, offer, model, goal, rows, seed, every, tick)

    reached = path(goal, gram, informing)
    start = np.clip(np.zeros(len(reach.lower)), reach.lower, reach.upper)
    stops, order, way = driven(here.rows.some(best), reach, start if before.campaign is None else before.campaign.q[-1])
    rng, most = np.random.default_rng(seed), min(FURTHER * rows, len(every))
    draws = [rng.choice(len(every), most, False) for _ in range(DRAWS)]
    return Plan(
        rows=stops,
        reach=reach,
        goal=goal,
        model=model,
        known=gram.with_rows(informing),
        worth=np.diff(reached)[order],
        reached=reached,
        random=np.array([path(goal, gram, every[drawn]) for drawn in draws]),
        everything=goal.value(gram.with_rows(every)),
        hypotheses=hypotheses,
        blind=blind_spots(model, every, _tip_rows(before, model, offer), informing_levels(reach.arm, reach.read)),
        offered=offer,
        uncertainty=_uncertainties(model, _tip_rows(before, model, offer), every, informing, seed),
        mounts=mounts,
        way=way,
        flags=flags,
        units={} if after is None else after.units,
    )


def _chosen(
    before: Before,
    reach: Reach,
    offer: Offer,
    model: DesignModel,
    goal: Goal,
    count: int,
    seed: int,
    every: Array,
    tick: Callable[[int, int], None],
) -> tuple[Offer, np.ndarray, Array]:
    """Return rows, the numbers of the best of them, the most informative first, and what these inform.

    The best of all that is offered, then of what is near it.
    """
    rng, here, near, gram, width = np.random.default_rng(seed), offer, every, model.known, WIDTH
    chosen = exchanged(goal, gram, every, greedy(goal, gram, every, count), 3)
    for number in range(ROUNDS):
        here = around(reach, before.setup, here.box[chosen], width, NEAR, rng)
        near = model.rows(here)
        chosen = exchanged(goal, gram, near, range(count), 2)
        width *= NARROWER
        tick(number + 2, ROUNDS + 1)
    best = np.array(chosen)[greedy(goal, gram, near[chosen], count)]
    return here, best, near[best]


def _rivals(between: Sequence[str], arm: Arm, settable: tuple[str, ...]) -> list[Effect]:
    """Return the effects that are to be distinguished, each of them once."""
    effects = [named_effect(text, arm, settable) for text in between]
    for effect in [effect for i, effect in enumerate(effects) if effect in effects[:i]]:
        raise InputError(f"{spelled(effect)} cannot be distinguished from itself: name two effects")
    return effects


def _scattered(before: Before) -> Iterator[Flag]:
    """Yield a flag on each instrument whose readings scatter more than a plan that relies on them may have it."""
    for name, noise in before.noises.items():
        if noise > 1.5:  # noise over the stated one beyond which a plan that relies on it is doubtful
            whose = f"readings of {name}" if name else "readings"
            text = f"{whose} scatter {noise:.2g} times as much as stated: something is missing, trace it first"
            yield Flag("unexplained_residual", text)


def _check(
    rows: int,
    seed: int,
    along: Trajectory | None,
    between: Sequence[str] | None,
    sigma: float | None,
    floor: float | None,
    covariates: Mapping[str, Sequence[float]],
) -> None:
    """Raise `InputError` where a number is out of its range, or two goals are asked for."""
    for name, value, least, most in (("rows", rows, 1, MOST_ROWS), ("seed", seed, 0, sys.maxsize)):
        if not isinstance(value, Integral):
            raise InputError(f"{name} is {shown(value, 60)}, expected a whole number")
        if not least <= value <= most:
            raise InputError(f"{name} is {shown(value, 60)}, expected {least} to {most}")
    if along is not None and between:
        raise InputError("a plan is for a trajectory or for effects to distinguish, not for both")
    if between is not None and len(between) < 2:
        raise InputError(f"between is {list(between)}, expected two effects or more")
    if sigma is not None and not 0.0 < sigma < np.inf:
        raise InputError(f"sigma is {sigma:g} m, expected more than 0")
    if floor is not None and np.isnan(floor):
        raise InputError("floor is not a number")
    for name, values in covariates.items():
        if not len(values) or not np.isfinite(values).all():
            raise InputError(f"covariate {name!r}: expected the values that can be set, got {list(values)}")


def reach_of(
    before: Before,
    effects: Sequence[Effect],
    payloads: Sequence[str] | None,
    covariates: Mapping[str, Sequence[float]],
    sigma: float | None,
    floor: float | None,
) -> tuple[Reach, tuple[Flag, ...]]:
    """Return what may be asked of the arm, and flags.

    Raises:
        InputError: Values of what an effect depends on are missing, or given for what none does; payloads are given
            twice; sigma is absurd.
        UnknownNameError: No such payload.
    """
    arm, campaign = before.setup.arm, before.campaign
    approached = _approached(arm, effects, covariates)
    lower, upper, flags = drawn_range(arm)
    zeros = np.array([arm.prior.of(parameter)[1] or USUAL_PRIOR.joint_offset for parameter in of_offsets(arm.robot)])
    # A controller, whose zeros are elsewhere, refuses what stands on a limit or a little beyond it.
    clear = np.minimum(CLEAR * zeros, NARROW * (upper - lower))
    lower, upper = np.maximum(lower, arm.robot.lower + clear), np.minimum(upper, arm.robot.upper - clear)
    # Once round is as far as a joint need go, unless what an effect does is not the same then.
    turning = np.array([joint.kind == "revolute" for joint in arm.robot.moving])
    named = {name for effect in (*arm.effects, *effects) for name in effect.location.covariates}
    far = (upper - lower > 2.0 * np.pi + SLACK) & turning & [f"q_{name}" not in named for name in arm.joint_names]
    if far.any():
        middle = 0.5 * (lower + upper)
        lower, upper = np.where(far, middle - np.pi, lower), np.where(far, middle + np.pi, upper)
        names = listing(name for name, is_far in zip(arm.joint_names, far, strict=True) if is_far)
        flags = (*flags, Flag("one_turn", f"{names}: can go round more than once, planned within the middle turn"))
    kept = [effect.title for effect in arm.effects if effect.remembers]
    if kept:
        text = f"{listing(kept)} depends on the rows before: kept as it is, where it settles"
        flags = (*flags, Flag("memory_settled", text))
    session = "planned"
    while campaign is not None and session in campaign.session:
        session += "'"
    if payloads is None:  # all that is declared, and nothing where none of it is nothing
        empty = any(payload.mass == 0.0 for payload in arm.payloads.values())
        payloads = (*arm.payloads, *(() if empty else ("none",)))
    else:
        payloads = (payloads,) if isinstance(payloads, str) else payloads
        if not payloads or len(set(payloads)) < len(payloads):
            raise InputError(f"payloads {list(payloads)}: expected one name or several different ones")
        for name in payloads:
            arm.payload(name)
    spread = _sigma_of(before, sigma)
    if arm.robot.reach == 0.0:
        raise InputError(f"tip {arm.robot.tip!r} stands on the axes of all joints: give a tip that they move")
    if spread.max() > COARSEST * arm.robot.reach:
        text = f"sigma is {spread.max():.3g} m, more than {COARSEST:.0%} of the arm's reach of {arm.robot.reach:.3g} m"
        raise InputError(f"{text}: is it in another unit?")
    levels = {name: tuple(float(x) for x in dict.fromkeys(values)) for name, values in covariates.items()}
    asked = arm, lower, upper, tuple(payloads), approached, levels, session, spread, floor
    return Reach(*asked, sigmas=before.sigmas), flags


def _approached(arm: Arm, effects: Sequence[Effect], covariates: Mapping[str, Sequence[float]]) -> tuple[str, ...]:
    """Return the joints whose approach effects depend on; raise where no values of what else they do are given."""
    needed = [  # beside joint positions and payloads
        (effect, name)
        for effect in (*arm.effects, *effects)
        for name in effect.columns
        if not name.startswith("q_") and name != MASS
    ]
    settable = list(dict.fromkeys(name for _, name in needed if not name.startswith(APPROACH)))
    for name in covariates:
        if name not in settable:
            hint = did_you_mean(name, settable)
            raise InputError(f"no effect depends on {name!r}{hint} (values can be set of: {listing(settable)})")
    for effect, name in needed:
        if name in settable and name not in covariates:
            example = "10,35" if TEMPERATURE.search(name) else "LOW,HIGH"
            text = f"{effect.title} depends on {name!r}: give values of it that can be set"
            raise InputError(f"{text}, such as --covariates {name}={example}")
    columns = {name for _, name in needed}
    return tuple(name for name in arm.joint_names if f"{APPROACH}{name}" in columns)


def _sigma_of(before: Before, sigma: float | None) -> Array:
    """Return (3,) the standard deviation of a position read [m]: as asked, as was found, or that of a tracker."""
    if sigma is not None:
        return np.full(3, sigma)
    if before.campaign is None:
        return np.full(3, READING)
    return before.sigmas.get("", np.full(3, READING))


def _goal(
    before: Before, model: DesignModel, every: Array, hypotheses: Sequence[EffectInQuestion], along: Trajectory | None
) -> Goal:
    """Return what is to be made as large as can be, where (N, 3, P) changes of the readings are offered."""
    if hypotheses:
        truths = []
        for hypothesis, rival in permutations(hypotheses, 2):
            departure, places = np.zeros(len(model.scale)), model.place(hypothesis.candidate)
            departure[places] = hypothesis.size / model.scale[places]
            gone = [model.place(other.candidate) for other in hypotheses if other is not rival]
            truths.append(
                Truth(
                    departure,
                    np.setdiff1d(np.arange(len(departure)), np.concatenate(gone)),
                    float(departure @ departure),
                )
            )
        # One law may hold the other as a special case: then rows are for the case that the wider one is true.
        whole = model.known.with_rows(every)
        distinguished = [truth for truth in truths if TOptimal((truth,)).value(whole) >= DISTINGUISHED**2]
        return TOptimal(tuple(distinguished or truths))
    if along is None:
        return DsOptimal(np.flatnonzero(model.moving))
    # The (P, P) mean over the trajectory of what parameters do to its readings, squared [m^2].
    # Rows of a trajectory that are looked at, evenly, where it has more.
    thinned = np.unique(np.linspace(0, len(along) - 1, min(len(along), 400)).astype(int))
    ordered = along.for_arm(before.setup.arm)
    columns = {name: values[thinned] for name, values in ordered.known.items()}
    rows = rows_at(before.setup.arm, ordered.q[thinned], tuple(along.payload[i] for i in thinned), columns)
    view = look(before.setup, rows, readings=unread(len(thinned), Position))
    seen = answers(model.blocks, view) * model.scale
    return IOptimal(np.tensordot(seen, seen, axes=([0, 1], [0, 1])) / len(thinned))


def _mounted(
    before: Before,
    reach: Reach,
    effects: Sequence[Effect],
    words: Sequence[str],
    rows: int,
    along: Trajectory | None,
    seed: int,
) -> tuple[Before, Reach, tuple[Mounted, ...]]:
    """Return arm and reach with the wanted instruments where they inform most in rows at random, and what each buys."""
    wanted = offered(before.setup.arm, words)

    def having(sensors: Sequence[Sensor]) -> tuple[Before, Reach]:
        units = list(LONGEST)
        every = {**reach.arm.sensors, **{sensor.name: sensor for sensor in sensors}}
        ordered = dict(sorted(every.items(), key=lambda pair: units.index(pair[1].kind.unit)))
        arm = replace(reach.arm, sensors=ordered)
        setup = replace(before.setup, arm=replace(before.setup.arm, sensors=ordered))
        read = (*([""] if TRACKER in words else []), *(sensor.name for sensor in sensors))
        return before.seen_by(setup), replace(reach, arm=arm, read=read)

    setting, everywhere = having([sensor for options in wanted.values() for sensor in options])
    for name, sockets in everywhere.touching.items():
        if not sockets:
            text = f"[instrument.{name}]: no place of a socket is known, and poses are to be on the contact"
            about = "place = { socket = [x, y, z] } and place_std = 0.02 under it, or --after with the touches so far"
            raise InputError(f"{text}: give {about}")
    offer = spread_evenly(everywhere, setting.setup, CHOOSING, seed)
    setting, offer = learning(setting, offer)
    candidates = [candidate_of(effect, everywhere.arm, offer) for effect in effects]
    model = model_of(setting, offer, candidates)
    hypotheses = [hypothesis_of(candidate, refitted(candidate, setting), offer) for candidate in candidates]
    every = model.rows(offer)
    goal = _goal(setting, model, every, hypotheses, along)
    sampled = np.random.default_rng(seed).choice(len(every), min(max(rows, FEWEST), len(every)), False)
    places = {kind.name: place for kind, place in offer.view.readings.placed}
    mounts = choose(wanted, places, goal, model, every[sampled])
    return *having([mount.sensor for mount in mounts]), mounts


def _tip_rows(before: Before, model: DesignModel, offer: Offer) -> Array:
    """Return (N, 3, P) changes of the tip's position in the offered rows [m] per parameter, in units of its scale."""
    readings = unread(len(offer.rows), Position)
    return answers(model.blocks, look(before.setup, offer.rows, readings=readings, line=offer.view.line)) * model.scale


def _uncertainties(model: DesignModel, tip: Array, every: Array, rows: Array, seed: int) -> dict[str, Array]:
    """Return what to draw by its title: (N,) standard deviations of what would be read in 3-D [m].

    How the next session moves the instrument is no part of it: that is not of the arm.
    """
    shown = tip * np.array([parameter.group.kind not in OF_SESSION for parameter in model.parameters])
    states = {
        "known now": model.known,
        f"after {len(rows)} readings at random": model.known.with_rows(
            every[np.random.default_rng(seed).choice(len(every), len(rows), False)]
        ),
        f"after {len(rows)} planned readings": model.known.with_rows(rows),
    }
    now, at_random, planned = (
        (title, np.sqrt(np.maximum(np.einsum("ndp,pq,ndq->n", shown, state.covariance, shown, optimize=True), 0.0)))
        for title, state in states.items()
    )
    return dict((at_random if now[1].min() > UNKNOWN else now, planned))
