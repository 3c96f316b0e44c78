"""What to measure next: rows that best distinguish an effect from its hypotheses, or what no such row does.

Sequential T-optimality (Atkinson and Fedorov 1975; Hunter and Reiner 1965): of many rows that the arm could be driven
to, the one where the effect and its best imitation by a hypothesis, refitted to the campaign, differ most in standard
deviations of the reading and of what is uncertain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from armflex.conventions import Array, said_of
from armflex.errors import ArmflexError
from armflex.estimate.block import Block
from armflex.estimate.blocks import sensor_block
from armflex.estimate.view import View, look
from armflex.laws.effects.context import Context
from armflex.laws.effects.effect import Effect
from armflex.linear_gaussian import LinearGaussian
from armflex.measured.measurements import Measurements
from armflex.parameters import numbered
from armflex.plan.design import Truth, instead
from armflex.plan.instruments import levels_tell, unlike
from armflex.readings import Readings
from armflex.rows import Rows
from armflex.rows.rows import APPROACH, LEVEL_OF
from armflex.trace.candidates import candidate_of, candidate_regressors
from armflex.trace.state import State

OFFERED = 120
"""Rows among which the best is chosen."""

APART = 600.0
"""Time between offered rows [s]."""

TELLING = 1.0
"""Expected difference, in standard deviations of one reading, below which a row distinguishes nothing."""

HYPOTHESES = 2

READ, SPLIT = 20, 5.0
"""Readings of another instrument in so many rows, and the expected difference in standard deviations from which it is
said to distinguish two effects: by more than the evidence within which candidates are equivalent."""

SPLITTING = {
    "level": "a level on {place}",
    "encoder": "an encoder on the links of {place}",
    "wire": "a wire to {place}",
}
"""Instruments that are thought of, and how they are named."""

RIDGE = 1e-12
"""Prior precision relative to a column's square: what the readings leave open is next to unknown.

Without it that would be the null space, of which `LinearGaussian.covariance` says nothing, and a row that only seems to
distinguish two effects would be proposed. So it is above `linear_gaussian.ROUNDING`.
"""


def next_rows(state: State, hypotheses: Sequence[Sequence[Effect]]) -> tuple[str, ...]:
    """Return in words what would distinguish each effect from its leading hypotheses.

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
    context, told = view.context, []
    others_read, levels = _with_instruments(state.fit.view), levels_tell(setup.arm, view.readings.names)
    for index, hypothesis in ((i, one) for i, several in enumerate(hypotheses) for one in several[:HYPOTHESES]):
        own, imitated = state.fitted[index], _Imitated.of(state, index, hypothesis)
        pair = f"{own.title}{numbered(state.effects[index].number)} from {hypothesis.title}"
        row, sigmas, difference = imitated.apart(view, context)
        splitting = imitated.split_by(others_read, state.context)
        would = " or ".join(f"{name} ({more:.2g} standard deviations)" for name, more in splitting)
        other = f"{would}, read in {READ} of these rows, would" if splitting else ""
        if sigmas < TELLING and other:
            told.append(f"More rows like those recorded do not distinguish {pair}; {other}.")
        elif sigmas < TELLING:
            told.append(
                f"More rows like those recorded do not distinguish {pair}; instead, {instead(own, hypothesis, levels)}."
            )
        else:
            size = f"{said_of(difference, view.readings.unit)} apart, {sigmas:.2g} standard deviations"
            where = f"measure at {_described(own, hypothesis, offer, row)} ({size})"
            told.append(f"To distinguish {pair}: {where}{f'; or {other}' if other else ''}.")
    return tuple(told)


def _with_instruments(view: View) -> View:
    """Return some rows of a campaign as instruments would read them that nobody has, each wherever it could be."""
    some = view.some(np.unique(np.linspace(0, len(view.rows) - 1, READ).astype(int)))
    count, known = len(some.rows), view.arm.sensors
    places = (one for word in SPLITTING for one in unlike(view.arm, word, view.readings.names))
    sensors = {one.name: one for one in places if one.name not in known}
    setup = replace(view.setup, arm=replace(view.arm, sensors={**known, **sensors}))
    read = Readings(count, tuple(one.kind.unread(count, one.sigma, one.name) for one in sensors.values()))
    here = replace(some, setup=setup, readings=read, residual=np.zeros((count, read.size)))
    return replace(here, readings=read.within_range(here.at))


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


@dataclass(frozen=True, eq=False)
class _Imitated:
    """An effect and a hypothesis in its stead, which are to be distinguished.

    Attributes:
        kept: What else is free, before the hypothesis and the effect itself.
        pair: The hypothesis, and the effect.
        known: The information of the campaign on all of them, the amplitude of the effect being one.
    """

    kept: tuple[Block, ...]
    pair: tuple[Effect, Effect]
    known: LinearGaussian

    @staticmethod
    def of(state: State, index: int, hypothesis: Effect) -> _Imitated:
        fit, own = state.fit, state.fitted[index]
        kept = tuple(block for block in (*state.blocks, *state.effects) if block is not state.effects[index])
        places = np.concatenate([np.zeros(0, dtype=int), *(fit.places(block) for block in kept)])
        imitation = candidate_regressors(candidate_of(hypothesis), fit, state.context)
        effect = candidate_regressors(candidate_of(own), fit, state.context) @ own.acting
        measured = np.hstack([fit.regressors[:, places], imitation, effect[:, None]])
        precision = np.concatenate([fit.precision[places], np.zeros(len(hypothesis.location.terms) + 1)])
        ridge = RIDGE * (measured**2).sum(axis=0)
        return _Imitated(kept, (hypothesis, own), LinearGaussian.of(measured, precision + ridge))

    def seen(self, view: View, context: Context) -> Array:
        """Return the (N, d, P) changes of the readings of a view, in their units."""
        hypothesis, own = self.pair
        there = [block.of_rows(context).jacobian(view) for block in self.kept]
        there.append(view.effect_jacobian(hypothesis, context))
        there.append((view.effect_jacobian(own, context) @ own.acting)[:, :, None])
        return np.concatenate(there, axis=2)

    def apart(self, view: View, context: Context) -> tuple[int, float, float]:
        """Return the row at which the two differ most when it is read once, and by how much [sigma, unit read]."""
        after, truth = self.seen(view, context), _last_of(self.known)
        sigmas = np.sqrt(truth.apart(self.known, after / view.sigma[:, :, None])[1])
        best = int(sigmas.argmax())
        departure = (after[best] @ truth.departure(self.known))[view.foremost]
        return best, float(sigmas[best]), float(np.linalg.norm(departure))

    def split_by(self, view: View, context: Context) -> tuple[tuple[str, float], ...]:
        """Return the best of each sort among the instruments of a view that distinguish both, and by how much [sigma].

        What is open of an instrument itself is found from the same readings.
        """
        after, best = self.seen(view, context) / view.sigma[:, :, None], dict[str, tuple[str, float]]()
        known = [one for name, one in view.arm.sensors.items() if name not in view.readings.names]
        before = _chi_square(self.known)
        for kind, place in view.readings.placed:
            sensor = view.arm.sensors[kind.name]
            open_of_it = sensor_block(view.setup, kind.name, ("",))
            own = open_of_it.jacobian(view)[:, place] / view.sigma[:, place, None]
            information = np.asarray(block_diag(np.diag(open_of_it.prior**-2.0), self.known.information))
            both = LinearGaussian(information).with_rows(np.concatenate([own, after[:, place]], axis=2))
            sigmas = float(np.sqrt(max(_chi_square(both) - before, 0.0)))
            word = kind.name.partition("_")[0]
            if sigmas > max(SPLIT, best.get(word, ("", 0.0))[1]):
                link = "the tip" if sensor.link == view.arm.robot.tip else sensor.link
                text = SPLITTING[word].format(place=sensor.shaft.joint if sensor.shaft else link)
                there = any(one.link == sensor.link and one.kind is sensor.kind for one in known)
                best[word] = f"another {text.split(' ', 1)[1]}" if there else text, sigmas
        return tuple(sorted(best.values(), key=lambda one: -one[1]))


def _last_of(known: LinearGaussian) -> Truth:
    """Return the last parameter as the truth, everything else as what may imitate it."""
    size = len(known.information)
    return Truth(np.eye(size)[-1], np.arange(size - 1))


def _chi_square(known: LinearGaussian) -> float:
    """Return the chi-square between what is true and its best imitation."""
    truth = _last_of(known)
    return truth.chi_square(known, truth.departure(known))


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
    if len(set(zip(measurements.pose, measurements.payload, strict=True))) == len(measurements):
        told.append("Repeat ten poses or more: repeats give the noise without any model.")
    return tuple(told)
