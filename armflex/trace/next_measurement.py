"""What to measure next: rows that tell an effect from its rivals best, or what no row of this kind will ever tell.

Sequential T-optimality (Atkinson and Fedorov 1975; Hunter and Reiner 1965): of many rows that the arm could be driven
to, the one where the effect and its best imitation by a rival, refitted to the campaign, differ most in standard
deviations of the reading and of what is uncertain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armflex.conventions import Array
from armflex.errors import ArmflexError
from armflex.estimate.spread import scene_of
from armflex.estimate.view import View, look
from armflex.laws.effects.effect import Effect
from armflex.laws.effects.scene import Scene
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import numbered
from armflex.plan.information import Truth
from armflex.plan.recommend import instead
from armflex.readings import Position, unread
from armflex.rows import Rows
from armflex.rows.rows import LEVEL_OF
from armflex.trace.candidates import Candidate, candidate_columns
from armflex.trace.state import State

OFFERED = 120
"""Rows among which the best is chosen."""

APART = 600.0
"""Time between offered rows [s]."""

TELLING = 1.0
"""Expected difference, in standard deviations of one reading, below which a row tells nothing."""

RIVALS = 2

RIDGE = 1e-12
"""Prior precision relative to a column's square: what the readings leave open is next to unknown.

Without it that would be the null space, of which `LinearGaussian.covariance` says nothing, and a row that only seems to
tell two effects apart would be proposed. So it is above `linear_gaussian.ROUNDING`.
"""


@dataclass(frozen=True)
class Proposal:
    """A row to measure, and how far apart two explanations are there.

    Attributes:
        rival: What it is told from.
        row: Number of the offered row.
        sigmas: Expected difference in standard deviations.
        difference: The same in metres.
    """

    rival: Effect
    row: int
    sigmas: float
    difference: float


def next_rows(state: State, rivals: Sequence[Sequence[Effect]]) -> tuple[str, ...]:
    """Return in words what would tell each effect from its leading rivals.

    Args:
        state: The final fit.
        rivals: For every effect, those that fit as well, the closest first.
    """
    if not any(rivals):
        return ()
    offer = _offered(state)
    view = _seen(state, offer)
    if view is None:
        return ()
    scene = scene_of(view, offer)
    told = []
    for index, others in enumerate(rivals):
        block = state.effects[index]
        own, number = block.at(state.values_of(block)), block.number
        for rival in others[:RIVALS]:
            told.append(_in_words(own, number, _propose(state, index, rival, offer, view, scene), rival, offer))
    return tuple(told)


def _offered(state: State, seed: int = 0) -> Rows:
    """Return rows with every joint, payload, approach and covariate somewhere in what was recorded, mixed anew."""
    rng, known = np.random.default_rng(seed), state.measurements
    pick = [rng.integers(0, len(known), OFFERED) for _ in range(len(known.joint_names) + 2)]
    q = np.column_stack([known.q[rows, i] for i, rows in enumerate(pick[:-2])])
    return Rows(
        joint_names=known.joint_names,
        pose=tuple(f"next {i}" for i in range(OFFERED)),
        session=(known.session[-1],) * OFFERED,
        payload=tuple(known.payload[row] for row in pick[-1]),
        time=float(known.time.max()) + APART * np.arange(1, OFFERED + 1, dtype=float),
        q=q,
        covariates=_extremes(known, rng),
        approach=rng.choice([-1.0, 1.0], q.shape),
        measured=np.ones(OFFERED, dtype=bool),
        hold=None if known.hold is None else rng.choice(known.hold, OFFERED),
        derived=known.derived,
    )


def _extremes(known: Rows, rng: np.random.Generator) -> dict[str, Array | tuple[str, ...]]:
    """Return every numeric covariate at one end or the other of what was recorded, every text as some row has it."""
    return {
        name: np.where(rng.random(OFFERED) < 0.5, values.min(), values.max())
        if isinstance(values, np.ndarray)
        else tuple(rng.choice(values, OFFERED).tolist())
        for name, values in known.covariates.items()
    }


def _seen(state: State, offer: Rows) -> View | None:
    arm = state.fit.setup.arm
    known = len(state.declared.arm.effects) + len(state.effects)  # a random twist knows only the poses it was fitted to
    arm = replace(arm, effects=arm.effects[:known])
    sigma = np.median(state.measurements.sigma[state.measurements.measured], axis=0)
    readings = unread(OFFERED, Position, sigma=sigma)
    try:
        return look(replace(state.fit.setup, arm=arm), offer, np.arange(OFFERED), readings=readings)
    except ArmflexError:  # a mixture of positions that the arm does not hold: no proposal is better than a wrong one
        return None


def _propose(state: State, index: int, rival: Effect, offer: Rows, view: View, scene: Scene) -> Proposal:
    """Return the offered row at which an effect and a rival in its stead differ most."""
    fit, block = state.fit, state.effects[index]
    own = block.at(state.values_of(block))
    kept = [other for other in (*state.blocks, *state.effects) if other is not block]
    places = np.concatenate([np.zeros(0, dtype=int), *(fit.places(other) for other in kept)])
    imitation = Candidate(rival.law, rival.location, rival.inner)
    parts = [fit.columns[:, places], candidate_columns(imitation, fit, state.scene)]
    effect = candidate_columns(Candidate(own.law, own.location, own.inner), fit, state.scene) @ own.acting
    measured = np.hstack([*parts, effect[:, None]])
    precision = np.concatenate([fit.precision[places], np.zeros(len(rival.location.terms) + 1)])
    known = LinearGaussian.of(measured, precision + RIDGE * (measured**2).sum(axis=0))
    there = [other.of_rows(scene).columns(view) for other in kept]
    there.append(view.effect_columns(rival, scene))
    there.append((view.effect_columns(own, scene) @ own.acting)[:, :, None])
    after = np.concatenate(there, axis=2)
    truth = Truth(np.eye(len(precision))[-1], np.arange(len(precision) - 1))
    sigmas = np.sqrt(truth.apart(known, after / view.sigma[:, :, None])[1])
    best = int(sigmas.argmax())
    return Proposal(rival, best, float(sigmas[best]), float(np.linalg.norm(after[best] @ truth.departure(known))))


def _in_words(own: Effect, number: int, proposal: Proposal, rival: Effect, offer: Rows) -> str:
    pair = f"{own.title}{numbered(number)} from {rival.title}"
    if proposal.sigmas < TELLING:
        return f"No more rows like those recorded tell {pair}; instead, {instead(own, rival)}."
    i = proposal.row
    where = ", ".join(f"{name}={offer.q[i, j]:.3g}" for j, name in enumerate(offer.joint_names))
    extra = _conditions(own, rival, offer, i)
    size = f"{proposal.difference * 1e3:.2g} mm apart, {proposal.sigmas:.2g} standard deviations"
    return f"To tell {pair}: measure at {where} with payload {offer.payload[i]}{extra} ({size})."


def _conditions(own: Effect, rival: Effect, offer: Rows, row: int) -> str:
    """Return the values of the columns that either effect depends on."""
    told = []
    for name in dict.fromkeys((*own.location.covariates, *rival.location.covariates)):
        if name.startswith("approach_"):
            joint = name.removeprefix("approach_")
            upwards = offer.approach[row, offer.joint_names.index(joint)] > 0.0
            told.append(f"{joint} approached from {'below' if upwards else 'above'}")
        elif LEVEL_OF in name:
            column = name.partition(LEVEL_OF)[0]
            told.append(f"{column} {offer.covariates[column][row]}")
        elif name in offer.covariates:
            told.append(f"{name} {offer.covariates[name][row]:.3g}")
        elif name == "hold" and offer.hold is not None:
            told.append(f"held {offer.hold[row]:.3g} s")
    return "".join(f", {text}" for text in told)
