"""What a machine has at every joint: one law at all drives, of which no joint's need show by itself.

Joints of one make err alike: each cable slackens, each encoder is mounted a little off its axis. Seven errors of which
none stands out add up to more than one that does. A family is a law at every drive whose amplitudes come from one
distribution: as twists, RMS over the rows, they are N(0, t^2). Its variance t^2 is that which makes the readings most
probable (evidence maximisation; MacKay 1992, "Bayesian interpolation"; Tipping 2001 for groups of regressors): where
the machine has nothing of the kind t goes to zero, and where it has, each amplitude is drawn towards zero by as much as
the others tell. With N and s the information and the score of a family's regressors after projection
(`armflex.linear_gaussian`), the logarithm of the evidence over that of no family is

    L(t) = -1/2 log det(1 + t^2 N) + 1/2 s' (N + 1 / t^2)^-1 s.

A family is no named cause: it says what kind of error the drives have, how large, and at which joints for certain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from armflex.conventions import Array
from armflex.errors import listing
from armflex.estimate.block import EffectBlock
from armflex.estimate.fit import Fit
from armflex.laws.effects.backlash import BACKLASH
from armflex.laws.effects.compliance import COMPLIANCE
from armflex.laws.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from armflex.laws.effects.encoder_scale import ENCODER_SCALE
from armflex.laws.effects.friction_windup import FRICTION_WINDUP
from armflex.laws.effects.gear_harmonic import GEAR_HARMONIC
from armflex.laws.effects.location import drive_axis
from armflex.linear_gaussian import LinearGaussian, squared
from armflex.trace.accept import APART, ENOUGH, MARGIN, Kin, Step, prove
from armflex.trace.candidates import Candidate, candidate_regressors, grid
from armflex.trace.polish import Polished
from armflex.trace.projection import Projection, evidence, project, projected
from armflex.trace.search import one_by_one
from armflex.trace.state import State, refit, stands, with_starts

LAWS = (BACKLASH, FRICTION_WINDUP, ENCODER_ECCENTRICITY, ENCODER_SCALE, GEAR_HARMONIC, COMPLIANCE)
"""What every drive of a machine may have."""

SCALES = np.logspace(-7.0, -1.0, 61)
"""Standard deviations of a family's twists that are tried [rad or m]."""

LEAST = 0.1
"""Share of the largest shape of a law at any drive below which another's is left out: no load shows no compliance."""

FLIPS, SWEEPS, FEWEST, MOST = 100, 20, 2, 8

STEPS = 6
"""Effects at most that families compete with."""


@dataclass(frozen=True, eq=False)
class Family:
    """A law at several drives, with its regressors at a fit.

    Attributes:
        members: The law at each of them.
        regressors: (n, k) whitened and weighted change of the readings per unit twist (RMS), all members in order.
        unit: (k,) amplitude that is such a twist, in its unit.
        scale: Standard deviation of the twists [rad or m], 0 where it is not known.
    """

    members: tuple[Candidate, ...]
    regressors: Array
    unit: Array
    scale: float = 0.0


def families(state: State) -> list[Family]:
    """Return every family of a campaign: turning and sliding drives apart, one wave number for all gears."""
    context, joints = state.context, {joint.name: joint for joint in state.context.robot.moving}
    taken = {(effect.law, effect.location, effect.inner) for effect in state.fitted}
    grouped: dict[tuple, list[tuple[Candidate, Array]]] = {}
    for law in LAWS:
        places = [one for one in law.places(context.records) if one.site in joints]
        places = [one for one in places if one.axis == drive_axis(joints[one.site])]
        # Of the orders of gears those of the drive that goes farthest, the finest; poses may not tell one from aliases.
        told = [(one, inners) for one in places if (inners := list(grid(law, one, context)))]
        told.sort(key=lambda one: -float(np.ptp(context.row.position(one[0].place))))
        for location in places:
            for inner in next((inners for one, inners in told if one.turns == location.turns), []):
                if (law, location, inner) in taken:
                    continue
                twists = law.features(location, inner, state.fit.view, context)
                size = np.sqrt((twists**2).sum(axis=2).mean(axis=0))
                kind = (law.name, location.turns, location.terms, inner)
                grouped.setdefault(kind, []).append((Candidate(law, location, inner), size))
    found = []
    for members in grouped.values():
        most = np.max([size for _, size in members], axis=0)
        kept = [(one, size) for one, size in members if (size > LEAST * most).all()]  # also: no load, no compliance
        if len(kept) >= FEWEST:
            columns = [candidate_regressors(one, state.fit, context) / size for one, size in kept]
            units = np.concatenate([1.0 / size for _, size in kept])
            found.append(Family(tuple(one for one, _ in kept), np.concatenate(columns, axis=1), units))
    return found


def _worths(
    families: Sequence[Family], problem: Projection, noise: float, flipped: Array
) -> list[tuple[float, float, float]]:
    """Return twice each family's log-evidence at its best scale, that scale, and the best for (F, n) flipped residuals.

    All columns go through the projection together.
    """
    if not families:
        return []
    columns = np.concatenate([one.regressors for one in families], axis=1) / noise
    seen, cleared = problem.half @ columns, problem.cleared(columns)
    # Signs other than the fit's own are projected.
    scores = np.vstack([problem.residual @ columns, flipped @ cleared - (flipped @ problem.half.T) @ seen])
    variance, found = SCALES[:, None] ** 2, []
    ends = np.cumsum([0, *(one.regressors.shape[1] for one in families)]).tolist()
    for first, last in pairwise(ends):
        own = columns[:, first:last]
        values, axes = np.linalg.eigh(own.T @ cleared[:, first:last] - seen[:, first:last].T @ seen[:, first:last])
        larger = 1.0 + variance * np.maximum(values, 0.0)
        told = ((scores[:, first:last] @ axes) ** 2) @ (variance / larger).T - np.log(larger).sum(axis=1)
        found.append((float(told[0].max()), float(SCALES[told[0].argmax()]), float(told[1:].max(initial=-np.inf))))
    return found


def _rescaled(fit: Fit, data: Array, accepted: Sequence[Family], noise: float) -> tuple[list[Family], float]:
    """Return families at the scales that make the readings most probable together, and the noise that is left."""
    families = list(accepted)
    ends = np.cumsum([len(fit.values), *(one.regressors.shape[1] for one in families)])
    columns = np.concatenate([fit.regressors, *(one.regressors for one in families)], axis=1)
    told, score = squared(columns), columns.T @ data
    for _ in range(SWEEPS):
        held = np.concatenate([fit.precision, *(np.full(one.regressors.shape[1], one.scale**-2.0) for one in families)])
        known = LinearGaussian(told / noise**2).with_precision(held)
        values, taken = known.solve(score / noise**2), 1.0 - held * np.diag(known.covariance)
        before = [one.scale for one in families]
        for i, (first, last) in enumerate(pairwise(ends.tolist())):
            fixed = float((values[first:last] ** 2).sum() / max(taken[first:last].sum(), 1e-9))
            families[i] = replace(families[i], scale=float(np.clip(np.sqrt(fixed), SCALES[0], SCALES[-1])))
        left = data - columns @ values
        noise = float(np.sqrt(left @ left / max(fit.view.count - taken.sum(), 1.0)))
        if np.allclose(before, [one.scale for one in families], rtol=0.01):
            break
    return families, noise


def _refined(family: Family, state: State, problem: Projection, noise: float) -> Family:
    """Return a family at the wave number that it is worth most at, between those that were tried beside its own."""
    law, inner = family.members[0].law, family.members[0].inner
    if not inner:
        return family
    every = sorted({value for one in family.members for (value,) in grid(law, one.location, state.context)})
    if len(every) < 2:
        return family
    step = 0.5 * float(np.median(np.diff(every)))

    def at(value: float) -> Family:
        members = tuple(replace(one, inner=(value,)) for one in family.members)
        columns = [candidate_regressors(one, state.fit, state.context) for one in members]
        return replace(family, members=members, regressors=np.concatenate(columns, axis=1) * family.unit)

    silence = np.zeros((0, len(problem.residual)))
    bounds = (max(inner[0] - step, every[0]), inner[0] + step)
    best: Any = minimize_scalar(
        lambda value: -_worths([at(value)], problem, noise, silence)[0][0],
        bounds=bounds,
        method="bounded",
        options={"xatol": 0.01 * step},
    )
    return at(float(best.x))


def with_families(state: State, rival: Polished | None) -> State | None:
    """Return the state with every family that the readings speak for, refitted; None where they speak for none.

    What bends at every drive explains some of whatever is missing, so families must be worth more than what can be
    named, one effect after the other.

    Args:
        state: The search so far.
        rival: The best effect that could be added by itself, which the first family must be worth more than; None where
            none was accepted.
    """
    fit, tried = state.fit, families(state)
    data, count = fit.residual + fit.regressors @ fit.values, fit.view.count
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (FLIPS, int(state.groups.max()) + 1))[:, state.groups]
    signs = np.repeat(signs, len(data) // len(state.rows), axis=1)
    accepted, noise = _rescaled(fit, data, [], 1.0)
    kins: list[tuple[float, float]] = []
    while len(accepted) < MOST:
        columns = np.concatenate([fit.regressors, *(one.regressors for one in accepted)], axis=1)
        held = np.concatenate([fit.precision, *(np.full(one.regressors.shape[1], one.scale**-2.0) for one in accepted)])
        problem = projected(columns / noise, held, data / noise, 0.0, count)
        flipped = problem.residual * signs
        taken = {(one.members[0].law, one.members[0].inner) for one in accepted}
        competing = [one for one in tried if (one.members[0].law, one.members[0].inner) not in taken]
        if not competing:
            break
        state.tell("a law at every drive", len(accepted), 0)
        worths = _worths(competing, problem, noise, flipped)
        (worth, _, _), best = max(zip(worths, competing, strict=True), key=lambda one: one[0][0])
        chance = max(one[2] for one in worths)
        alone = _alone(best, problem, noise) if rival is None or accepted else _evidence(rival, state)
        if worth < max(ENOUGH, chance + MARGIN, alone):
            break
        best = _refined(best, state, problem, noise)
        ((worth, scale, _),) = _worths([best], problem, noise, flipped[:0])
        kins.append((worth, chance))
        accepted, noise = _rescaled(fit, data, [*accepted, replace(best, scale=scale)], noise)
    if not accepted:
        return None
    if rival is not None:  # to choose among so many costs each of either kind
        named = [one.evidence - state.physical.charge for one in one_by_one(state.physical, project(fit), STEPS)]
        together = _together(state, accepted, noise) - 2.0 * len(accepted) * float(np.log(len(tried)))
        if together < sum(one for one in named if one > 0.0):
            return None
    return _proven(state, accepted, kins, noise)


def _together(state: State, accepted: Sequence[Family], noise: float) -> float:
    """Return twice the log-evidence of families together over none, the noise's size as it is found."""
    fit = state.fit
    columns = np.concatenate([one.regressors for one in accepted], axis=1)
    held = np.concatenate([np.full(one.regressors.shape[1], (noise / one.scale) ** 2) for one in accepted])
    before = project(fit)
    known = LinearGaussian(before.information(columns)[0]).with_precision(held)
    score = columns.T @ before.residual
    gain = float(score @ known.solve(score))
    return float(evidence(gain, before.objective, before.count, 0)) - float(
        np.linalg.slogdet(known.information / held)[1]
    )


def _evidence(rival: Polished, state: State) -> float:
    """Return the fall of the information criterion by an effect, the noise's size as it is found rather than stated."""
    whole, count = float(project(state.fit).objective), state.fit.view.count
    left = max(whole - rival.gain, 1e-3 * whole)
    return count * float(np.log(whole / left)) - rival.candidate.parameters * float(np.log(count))


def _alone(family: Family, problem: Projection, noise: float) -> float:
    """Return the fall of the information criterion by the member of a family that has most of it by itself."""
    first, most = 0, -np.inf
    for one in family.members:
        last = first + len(one.location.terms)
        gain, _ = problem.gain(family.regressors[:, first:last] / noise)
        most, first = max(most, gain - one.parameters * float(np.log(problem.count))), last
    return most


def _proven(
    state: State, accepted: Sequence[Family], kins: Sequence[tuple[float, float]], noise: float
) -> State | None:
    """Return the state with families refitted; None where poses held out do not speak for them."""
    fit, known = state.fit, len(state.declared.arm.effects)
    numbers = 1 + max((step.kin.number for step in state.steps if step is not None and step.kin is not None), default=0)
    # A fit weighs readings by what they state, so priors are stated by the same measure.
    prior = np.concatenate([one.scale * one.unit for one in accepted]) / noise
    columns = np.hstack([fit.regressors, *(one.regressors / one.unit for one in accepted)])
    told = LinearGaussian.of(columns, np.concatenate([fit.precision, prior**-2.0]))
    values = told.solve(columns.T @ (fit.residual + fit.regressors @ fit.values))
    added, blocks = values[len(fit.values) :], list(state.effects)
    starts = [values[fit.places(block)] for block in blocks]
    for member in (member for one in accepted for member in one.members):
        count = len(member.location.terms)
        derived = tuple(name for name in member.location.covariates if name in state.measurements.derived)
        effect = replace(member.effect(added[:count]), derived=derived)
        blocks.append(EffectBlock(effect, (), state.context, known + len(blocks), prior[:count]))
        starts.append(added[:count])
        added, prior = added[count:], prior[count:]
    kinds = list(dict.fromkeys(one.members[0].law.name.replace("_", " ") for one in accepted))
    state.say(f"refitting with {listing(kinds)} at every drive")
    steps = (*state.steps, *(None for _ in range(len(blocks) - len(state.effects))))
    start = with_starts(state, values[: len(fit.values)], starts)
    after = refit(replace(state, steps=steps), tuple(blocks), state.random, start)
    proof = prove(state, after, max(chance for _, chance in kins), after.effects[len(state.effects) :])
    if not (stands(after) and proof.errors_apart > APART and proof.sessions_agree):
        return None
    own = [
        Step((), proof, False, kin=Kin(numbers + i, one.scale, worth))
        for i, (one, (worth, _)) in enumerate(zip(accepted, kins, strict=True))
        for _ in one.members
    ]
    return replace(after, steps=(*state.steps, *own))
