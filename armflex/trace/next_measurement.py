"""What to measure next: rows that tell an effect from its hypotheses best, or what no row of this kind will ever tell.

Sequential T-optimality (Atkinson and Fedorov 1975; Hunter and Reiner 1965): of many rows that the arm could be driven
to, the one where the effect and its best imitation by a hypothesis, refitted to the campaign, differ most in standard
deviations of the reading and of what is uncertain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from armflex.conventions import Array, said_of
from armflex.errors import ArmflexError
from armflex.estimate.blocks import sensor_block
from armflex.estimate.posterior import context_of
from armflex.estimate.view import View, look
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Effect
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.measurements import Measurements
from armflex.parameters import numbered
from armflex.plan.design import Truth, instead
from armflex.plan.instruments import usual
from armflex.readings import Readings
from armflex.rows import Rows
from armflex.rows.rows import APPROACH, LEVEL_OF
from armflex.trace.candidates import candidate_regressors
from armflex.trace.state import State, candidate_of

OFFERED = 120
"""Rows among which the best is chosen."""

APART = 600.0
"""Time between offered rows [s]."""

TELLING = 1.0
"""Expected difference, in standard deviations of one reading, below which a row tells nothing."""

HYPOTHESES = 2

SPLIT = 3.0
"""Expected difference, in standard deviations of one reading, from which another instrument is named."""

SPLITTING = {
    "level": "a level on {place}",
    "encoder": "an encoder on the links of {place}",
    "wire": "a wire to the tip",
}
"""Instruments that are thought of, and how they are named."""

RIDGE = 1e-12
"""Prior precision relative to a column's square: what the readings leave open is next to unknown.

Without it that would be the null space, of which `LinearGaussian.covariance` says nothing, and a row that only seems to
tell two effects apart would be proposed. So it is above `linear_gaussian.ROUNDING`.
"""


def next_rows(state: State, hypotheses: Sequence[Sequence[Effect]]) -> tuple[str, ...]:
    """Return in words what would tell each effect from its leading hypotheses.

    Args:
        state: The final fit.
        hypotheses: For every effect, those that fit as well, the closest first.
    """
    if not any(hypotheses):
        return ()
    setup, offer = state.fit.setup, _offered(state.measurements)
    known = len(state.declared.arm.effects) + len(state.effects)  # a random twist knows only the poses it was fitted to
    setup = replace(setup, arm=replace(setup.arm, effects=setup.arm.effects[:known]))
    kinds = []
    for kind in state.measurements.readings.kinds:
        read = np.isfinite(kind.sigma).all(axis=1) & state.measurements.measured
        kinds.append(kind.unread(OFFERED, np.median(kind.sigma[read], axis=0), kind.name))
    try:
        view = look(setup, offer, readings=Readings(OFFERED, tuple(kinds)))
    except ArmflexError:  # a mixture of positions that the arm does not hold: no proposal is better than a wrong one
        return ()
    context, told = context_of(view, offer), []
    for index, others in enumerate(hypotheses):
        own = state.fitted[index]
        for hypothesis in others[:HYPOTHESES]:
            pair = f"{own.title}{numbered(state.effects[index].number)} from {hypothesis.title}"
            row, sigmas, difference = _apart(state, index, hypothesis, view, context)
            if sigmas < SPLIT and (better := _splitting(state, index, hypothesis, view, context)):
                name, more, place = better
                what = f"No more rows like those recorded tell {pair}" if sigmas < TELLING else f"To tell {pair}"
                at = _described(own, hypothesis, offer, place)
                told.append(f"{what}; {name} would: read it at {at} ({more:.2g} standard deviations).")
                continue
            if sigmas < TELLING:
                told.append(f"No more rows like those recorded tell {pair}; instead, {instead(own, hypothesis)}.")
                continue
            size = f"{said_of(difference, view.readings.unit)} apart, {sigmas:.2g} standard deviations"
            told.append(f"To tell {pair}: measure at {_described(own, hypothesis, offer, row)} ({size}).")
    return tuple(told)


def _splitting(
    state: State, index: int, hypothesis: Effect, view: View, context: Context
) -> tuple[str, float, int] | None:
    """Return the instrument that would tell an effect from a hypothesis best, by how much, and the row; None if none.

    Looked at is one instrument more at a time, wherever it could be; one that was there is of the campaign.
    """
    arm, best = view.arm, None
    for word, named in SPLITTING.items():
        for sensor in usual(arm, word):
            setup = replace(view.setup, arm=replace(arm, sensors={**arm.sensors, sensor.name: sensor}))
            kinds = (*view.readings.kinds, sensor.kind.unread(OFFERED, sensor.sigma, sensor.name))
            read = Readings(OFFERED, kinds)
            here = replace(view, setup=setup, readings=read, residual=np.zeros((OFFERED, read.size)))
            here = replace(here, readings=read.within_range(here.at))
            row, sigmas, _ = _apart(state, index, hypothesis, here, context, sensor.name)
            if sigmas >= SPLIT and (best is None or sigmas > best[1]):
                place = sensor.shaft.joint if sensor.shaft else sensor.link
                best = (named.format(place=place), sigmas, row)
    return best


def _offered(known: Measurements) -> Rows:
    """Return rows with every joint, payload, approach and covariate somewhere in what was recorded, mixed anew.

    Every numeric covariate is at one end or the other of what was recorded, every text as some row has it.
    """
    rng = np.random.default_rng(0)
    *joints, _, payload = (rng.integers(0, len(known), OFFERED) for _ in range(len(known.joint_names) + 2))
    q = np.column_stack([known.q[rows, i] for i, rows in enumerate(joints)])
    covariates: dict[str, Array | tuple[str, ...]] = {
        name: np.where(rng.random(OFFERED) < 0.5, values.min(), values.max())
        if isinstance(values, np.ndarray)
        else tuple(rng.choice(values, OFFERED).tolist())
        for name, values in known.covariates.items()
    }
    return Rows(
        joint_names=known.joint_names,
        pose=tuple(f"next {i}" for i in range(OFFERED)),
        session=(known.session[-1],) * OFFERED,
        payload=tuple(known.payload[row] for row in payload),
        time=float(known.time.max()) + APART * np.arange(1, OFFERED + 1, dtype=float),
        q=q,
        covariates=covariates,
        approach=rng.choice([-1.0, 1.0], q.shape),
        measured=np.ones(OFFERED, dtype=bool),
        hold=None if known.hold is None else rng.choice(known.hold, OFFERED),
        derived=known.derived,
    )


def _apart(
    state: State, index: int, hypothesis: Effect, view: View, context: Context, sensor: str = ""
) -> tuple[int, float, float]:
    """Return the offered row at which an effect and a hypothesis in its stead differ most, by how much [sigma, m].

    `sensor` is one that nothing was read of yet.
    """
    fit, own = state.fit, state.fitted[index]
    kept = [block for block in (*state.blocks, *state.effects) if block is not state.effects[index]]
    places = np.concatenate([np.zeros(0, dtype=int), *(fit.places(block) for block in kept)])
    imitation = candidate_regressors(candidate_of(hypothesis), fit, state.context)
    effect = candidate_regressors(candidate_of(own), fit, state.context) @ own.acting
    measured = np.hstack([fit.regressors[:, places], imitation, effect[:, None]])
    precision = np.concatenate([fit.precision[places], np.zeros(len(hypothesis.location.terms) + 1)])
    known = LinearGaussian.of(measured, precision + RIDGE * (measured**2).sum(axis=0))
    there = [block.of_rows(context).jacobian(view) for block in kept]
    if sensor:
        new = sensor_block(view.setup, sensor, ("",))
        places = len(new.parameters)
        known = LinearGaussian(np.asarray(block_diag(np.diag(new.prior**-2.0), known.information)))
        precision = np.append(np.ones(places), precision)
        there.insert(0, new.jacobian(view))
    there.append(view.effect_jacobian(hypothesis, context))
    there.append((view.effect_jacobian(own, context) @ own.acting)[:, :, None])
    after = np.concatenate(there, axis=2)
    truth = Truth(np.eye(len(precision))[-1], np.arange(len(precision) - 1))
    sigmas = np.sqrt(truth.apart(known, after / view.sigma[:, :, None])[1])
    best = int(sigmas.argmax())
    apart = (after[best] @ truth.departure(known))[view.foremost]
    return best, float(sigmas[best]), float(np.linalg.norm(apart))


def _described(own: Effect, hypothesis: Effect, offer: Rows, row: int) -> str:
    """Return an offered row in words, with the values of the columns that either effect depends on."""
    where = ", ".join(f"{name}={offer.q[row, j]:.3g}" for j, name in enumerate(offer.joint_names))
    told = [f"{where} with payload {offer.payload[row]}"]
    for name in dict.fromkeys((*own.location.covariates, *hypothesis.location.covariates)):
        if name.startswith(APPROACH):
            joint = name.removeprefix(APPROACH)
            upwards = offer.approach[row, offer.joint_names.index(joint)] > 0.0
            told.append(f"{joint} approached from {'below' if upwards else 'above'}")
        elif LEVEL_OF in name:
            column = name.partition(LEVEL_OF)[0]
            told.append(f"{column} {offer.covariates[column][row]}")
        elif name in offer.covariates:
            told.append(f"{name} {offer.covariates[name][row]:.3g}")
        elif name == "hold" and offer.hold is not None:
            told.append(f"held {offer.hold[row]:.3g} s")
    return ", ".join(told)


def lacking(measurements: Measurements) -> tuple[str, ...]:
    """Return in words what would make a campaign able to show more."""
    told, used = [], measurements.measured
    kinds = len({payload for payload, read in zip(measurements.payload, used, strict=True) if read})
    if kinds < 3:
        told.append(
            f"Measure with three payloads, one in between: {kinds} cannot tell a curved law from a straight one."
        )
    if len(set(measurements.session)) < 2:
        told.append(
            "Set the instrument up again half way: one session cannot tell a drift of the base from one of the arm."
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
    if len(set(zip(measurements.pose, measurements.payload, strict=True))) == len(measurements):
        told.append("Repeat ten poses or more: repeats give the noise without any model.")
    return tuple(told)
