"""What tracing found: the account that a report prints and an arm.toml keeps, and how it is drawn up after a search.

What every effect is worth, what else would do, what could not be told, and what is left.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import fdtrc

from armflex.arm import Arm, Setup
from armflex.conventions import TWIST_NAMES, Array, said_of
from armflex.estimate.calibrate import Calibration
from armflex.estimate.fit import Fit, realise
from armflex.estimate.held_out import held_out, judged_by, pose_folds
from armflex.estimate.learn import with_posteriors
from armflex.estimate.outliers import Outlier, exchanged, outliers_of
from armflex.estimate.posterior import certainty_of
from armflex.estimate.view import View, foremost_rms, look
from armflex.files.arm_file import write_arm
from armflex.files.calibration_table import Campaign
from armflex.files.effect_file import effect_table
from armflex.laws.effects.effect import Effect
from armflex.measured.repeats import repeats
from armflex.parameters import ArmParameter
from armflex.result import Result
from armflex.trace.accept import ENOUGH, MARGIN, Kin, Proof, null_maximum, prove, sessions_held_out
from armflex.trace.exchange import equivalents, pruned, worth_of
from armflex.trace.next_measurement import lacking, next_rows
from armflex.trace.polish import Polished
from armflex.trace.projection import project
from armflex.trace.search import Round
from armflex.trace.state import State, lost_in, lost_of, lost_rows, sorted_out, without
from armflex.trace.unrecorded import NOTICED, RandomTwist, as_likely, localise
from armflex.trace.withdraw import Compared, Withdrawn, never_worse

ALMOST = 1e-4
"""Share of a column's square below which what is left of it cannot be seen at any plausible size."""

SHOWN = 23.0
"""Gain at which an effect would have been accepted among thousands of candidates."""

STILL = 1e-12
"""Share of what an amplitude of 1 does to the readings at the place where it does most, below which it is rounding."""

UNLIKELY = 1e-4
"""Probability below which a residual larger than the repeats' scatter is no chance."""

LARGER = 2.0
"""Variance over that of repeats from which a residual without a place is told at all."""


@dataclass(frozen=True, eq=False)
class Found:
    """An effect that was added.

    Attributes:
        effect: With its fitted values.
        std: Standard uncertainty of each fitted value by name.
        evidence: Fall of the information criterion that it is worth beside the others.
        proof: Held-out rows.
        equivalent: Other candidates that these data cannot tell from it, with how much less evidence they have.
        ranking: What was considered when it was added, the best first.
        witness: Whether it is believed for the priors' sake: held-out errors barely move, parameters no longer do.
        index: Its place among the effects of the final fit.
        family: Number of the family with which it was added, whose proof it is; None where it stands alone.
        survives: Share of the folds of the poses without which the same law at the same place is chosen again; None
            where that was not asked.
        probability: Of it, law and place; None where no posterior was worked out.
        credible: Other candidates that with it make up the 95 % credible set, with the probability of each.
    """

    effect: Effect
    std: Mapping[str, float]
    evidence: float
    proof: Proof
    equivalent: tuple[tuple[Effect, float], ...]
    ranking: tuple[Polished, ...]
    witness: bool
    index: int = 0
    family: int | None = None
    survives: float | None = None
    probability: float | None = None
    credible: tuple[tuple[Effect, float], ...] = ()

    @property
    def believed(self) -> str:
        """Why: it predicts held-out rows better, or it ends what strained the priors and predicts them no worse."""
        return "strained priors" if self.witness else "held-out rows"


@dataclass(frozen=True, eq=False)
class FoundFamily:
    """One law at every drive, believed together: errors of a size that all of them have, few of which show alone.

    Attributes:
        kin: Number, size and evidence.
        members: The law at each drive with its fitted values, and the standard uncertainty of each by name.
        proof: Held-out rows, of all families that were added at once.
    """

    kin: Kin
    members: tuple[tuple[Effect, Mapping[str, float]], ...]
    proof: Proof

    @property
    def title(self) -> str:
        """Law, values that all have in common, and that it is everywhere."""
        effect = self.members[0][0]
        inner = dict(list(effect.named.items())[len(effect.location.terms) :])
        said = "".join(f" {name} = {value:.3g}" for name, value in inner.items())
        return f"{effect.law.name.replace('_', ' ')}{said} at every drive"

    @property
    def unit(self) -> str:
        """Of the size of its twists."""
        return "rad" if self.members[0][0].location.turns else "m"


@dataclass(frozen=True)
class Unexplained:
    """A residual above the noise without a cause.

    Attributes:
        site, axis: Where it acts, None where not even that can be told.
        std: Size of the random twist there [unit].
        unit: 'rad' or 'm'.
        rms: RMS of the 3-D error that it makes [m].
        equivalent: Other places that fit as well.
    """

    site: str | None
    axis: str | None
    std: float | None
    unit: str | None
    rms: float
    equivalent: tuple[RandomTwist, ...] = ()


@dataclass(frozen=True)
class Undecided:
    """A residual far above what is stated, from poses too few to tell an effect from chance.

    Attributes:
        rms: RMS of the 3-D error that is left [m].
        stated: What the stated standard deviations alone would give [m].
        poses: Distinct poses that were fitted.
        evidence, chance: That of the best candidate, and the best that random signs of the residual gave.
        unit: In which `rms` and `stated` are, where it is not m.
    """

    rms: float
    stated: float
    poses: int
    evidence: float
    chance: float
    unit: str = "m"

    @property
    def text(self) -> str:
        """In a sentence."""
        return (
            f"These data cannot decide what is missing: {said_of(self.rms, self.unit)} RMS are left where "
            f"{said_of(self.stated, self.unit)} are stated, and with {self.poses} distinct poses chance explains as "
            f"much as the best effect does (evidence {self.chance:.0f} beside {self.evidence:.0f}): measure more poses."
        )


@dataclass(frozen=True)
class Unidentifiable:
    """An effect that this campaign could not have shown.

    Attributes:
        effect, site: Law and place.
        partner: The fitted parameter that takes most of its place, None where it does not move what is read.
    """

    effect: str
    site: str
    partner: ArmParameter | None

    @property
    def reason(self) -> str:
        """Why, in words."""
        if self.partner is None:
            return "does not move the target"
        return f"is taken over by fitted parameters, most by {self.partner.label}"


@dataclass(frozen=True)
class Smallest:
    """The smallest effect of a law that this campaign would have shown, over its places: RMS at the tip [m]."""

    effect: str
    least: float
    most: float


@dataclass(frozen=True, repr=False, eq=False)
class Trace(Result):
    """A traced arm and an account of it.

    Every error in it is over the same `rows`: those that the final fit, or the calibration, comes near.

    Attributes:
        arm: With everything fitted and every effect added.
        calibration: Before anything was added, lost beams and all.
        before: The same, fitted to the rows that the final fit uses.
        state: The final fit.
        found: Effects in the order added; of families, the members that show by themselves.
        unexplained: What is left above the noise, None when nothing is.
        places: Likeliest places of what was left at first.
        noise: Standard deviation of the readings over the stated one, from the final residual.
        held_out_before, held_out_after: RMS of the 3-D error on held-out poses [m].
        held_out_sessions: The same before and after with whole sessions held out, None where none can judge.
        not_identifiable: Effects that could not have been told.
        smallest: What the campaign could have shown at least.
        next_measurement: What to measure next, in words.
        compared: Held-out poses, everything chosen and fitted without them; None where nothing was added.
        withdrawn: What was accepted and taken out again, because held-out poses were predicted worse with it.
        families: Laws that all drives have.
        undecided: What is left where these rows cannot tell whether anything is missing, None where they can.
        unfinished: Whether the search was still going on: what else would do, what could not be told and what to
            measure next is not worked out yet.
        stopped_at: How many effects the search had accepted where that many are its limit, None where it ended because
            nothing was left to be found.
        nothing: Probability that no effect is missing at all; None where no posterior was worked out.
    """

    TOLD = (
        *("unfinished", "declared_rms", "calibrated_rms", "rms", "noise_rms", "held_out"),
        *("effects", "common", "unexplained", "not_identifiable", "next_measurement"),
    )
    ROWS = "effects"

    arm: Arm
    calibration: Calibration
    before: Fit
    state: State
    found: tuple[Found, ...]
    unexplained: Unexplained | None
    places: tuple[RandomTwist, ...]
    noise: float
    held_out_before: float
    held_out_after: float
    held_out_sessions: tuple[float, float] | None
    not_identifiable: tuple[Unidentifiable, ...] = ()
    smallest: tuple[Smallest, ...] = ()
    next_measurement: tuple[str, ...] = ()
    compared: Compared | None = None
    withdrawn: tuple[Withdrawn, ...] = ()
    families: tuple[FoundFamily, ...] = ()
    undecided: Undecided | None = None
    unfinished: bool = False
    stopped_at: int | None = None
    nothing: float | None = None

    @property
    def effects(self) -> list[dict[str, Any]]:
        """What was found: title, values and their standard uncertainties, in the order added."""
        return [
            {"effect": one.effect.title, **one.effect.named} | {f"std {name}": std for name, std in one.std.items()}
            for one in self.found
        ]

    @property
    def common(self) -> list[str]:
        """Laws that all drives have, in words."""
        return [family.title for family in self.families]

    @cached_property
    def believed(self) -> np.ndarray:
        """(M,) which of the fitted rows every error is over."""
        return np.any(self.judged, axis=1)

    @cached_property
    def judged(self) -> np.ndarray:
        """(M, d) which of their readings every error is over."""
        return judged_by(self.before, self.state.fit)

    @property
    def rows(self) -> np.ndarray:
        """(K,) numbers of the fitted rows that every error is over."""
        return self.state.rows[self.believed]

    @cached_property
    def unjudged(self) -> np.ndarray:
        """(U,) rows in which nothing tells what an effect depends on: not in the fit, but in the RMS over all rows.

        There the effect is predicted halfway, as the search takes it.
        """
        state = self.state
        return state.asked[state.untold & ~lost_rows(state, heed=False)]

    def _rms(self, view: View, errors: Array, others: Setup) -> float:
        """Return the RMS of (M, d) errors [m] of the fitted rows, and of what is left of the others at a setup."""
        judged = view.readings.where(self.judged)
        squares, count = judged.row_squares(errors).sum(), np.count_nonzero(judged.foremost_count)
        if len(self.unjudged):
            rest = look(others, self.state.measurements, self.unjudged)
            squares += rest.readings.row_squares(rest.residual).sum()
            count += np.count_nonzero(rest.readings.foremost_count)
        return float(np.sqrt(squares / max(count, 1)))

    @property
    def declared_rms(self) -> float:
        """RMS of the 3-D position error with only the instrument's frame fitted [m]."""
        placed = self.calibration.placed
        view = placed.some(np.flatnonzero(np.isin(placed.rows, self.state.rows)))
        return self._rms(view, view.residual, placed.setup)

    @property
    def calibrated_rms(self) -> float:
        """The same after calibration [m]."""
        return self._rms(self.before.view, self.before.view.residual, self.before.setup)

    @property
    def rms(self) -> float:
        """The same with everything that can be predicted [m]."""
        return self._rms(self.state.fit.view, self.residual, self.state.fit.setup)

    @property
    def noise_rms(self) -> float:
        """What the stated standard deviations alone would give [m]."""
        return foremost_rms(self.state.fit.view.readings.where(self.judged), self.state.fit.view.sigma)

    @cached_property
    def outliers(self) -> tuple[Outlier, ...]:
        """All other rows that were to be used, and readings that were left out of rows, the worst first.

        Each is a 'lost beam', 'exchanged' with another, 'unexplained' (far off, and its neighbours too) or, still in
        the fit, 'counted less'.
        """
        state, whole = self.state, self.calibration.measurements
        rows = np.setdiff1d(state.asked, [*self.rows, *self.unjudged])
        gone = np.isin(state.asked, rows)
        far = lost_of(state, heed=False) & (gone[:, None] | lost_in(state))
        view, alone = look(state.fit.setup, whole, state.asked), lost_rows(state, heed=True)
        found = list(outliers_of(view, far & (~gone[:, None] | self._paired(view, far)), whole, "lost beam"))
        for i in np.flatnonzero(gone & ~np.isin(state.asked, [one.row for one in found])):
            row, error = int(state.asked[i]), float(np.sqrt(view.readings.row_squares(view.residual)[i]))
            kind = "counted less" if row in state.rows else "lost beam" if alone[i] else "unexplained"
            place = whole.places[row] if whole.places else None
            found.append(Outlier(row, place, error, kind, unit=view.readings.unit))
        return tuple(sorted(found, key=lambda one: -one.error_m))

    @staticmethod
    def _paired(view: View, far: np.ndarray) -> np.ndarray:
        """Return (A, G) which of the readings that are far off stand in each other's row."""
        paired = np.zeros_like(far)
        for place in exchanged(view, far):
            paired[place] = True
        return paired

    @property
    def numbers(self) -> tuple[int, ...]:
        """Which of its name every effect that was found is in the arm, see `numbers_of`."""
        return tuple(self.state.effects[one.index].number for one in self.found)

    @property
    def added(self) -> Iterator[tuple[Effect, dict[str, float]]]:
        """Every effect of the final fit with the standard uncertainty of each of its values by name."""
        for block, effect in zip(self.state.effects, self.state.fitted, strict=True):
            yield effect, block.std(self.state.values_of(block), self.state.stds_of(block))

    def told(self, kind: str) -> int:
        """Return how many outliers are of one kind."""
        return sum(one.kind == kind for one in self.outliers)

    @property
    def said_of_limit(self) -> str:
        """That the search ended at its limit, in a sentence; '' where it did not."""
        if self.stopped_at is None:
            return ""
        count = "1 effect" if self.stopped_at == 1 else f"{self.stopped_at} effects"
        return f"The search ended at its limit of {count}: more may be missing."

    @property
    def held_out(self) -> tuple[float, float]:
        """RMS of the 3-D error on held-out poses, of the calibrated arm and with what was found [m].

        Where something was found, what it is was chosen without them; `held_out_after` is of what all rows chose.
        """
        if self.compared is None:
            return self.held_out_before, self.held_out_after
        return self.compared.before, max(self.compared.after, self.held_out_after)

    @property
    def said_of_held_out(self) -> str:
        """What was decided without the poses that held-out errors are of, and what was not, in a sentence."""
        return (
            "laws, places and values were selected and fitted without these poses, and so was the decision to add an "
            "effect; the final candidates and the families at every drive were selected from all rows."
        )

    @property
    def residual(self) -> Array:
        """(M, d) measured minus predicted; what is random is not predicted [m, rad]."""
        return predictable_residual(self.state)


def predictable_residual(state: State) -> Array:
    """Return the (M, d) residual without the random twists, whose values nobody can know beforehand."""
    view = state.fit.view
    if state.random is None:
        return view.residual
    return view.residual + state.random.jacobian(view) @ state.values_of(state.random)


def so_far(state: State, places: tuple[RandomTwist, ...]) -> Trace:
    """Return the account of a search that goes on: what was accepted, with what is known without comparing it.

    `places` are the likeliest of what was left at first.
    """
    left = unexplained(state, localise(state.fit, state.context, project(state.fit), state.groups))
    found = tuple(_found(state, index, worth, ()) for index, worth in _by_themselves(state))
    return _summed_up(state, places, found, left, unfinished=True)


def conclude(state: State, places: tuple[RandomTwist, ...]) -> Trace:
    """Return the account of a search that has come to its end, after second thoughts about what it added."""
    state.say("weighing every effect beside the others")
    *_, state = (state, *pruned(state))
    state, withdrawn, compared = never_worse(sorted_out(state))
    state.say(f"searching what {len(state.rows)} rows still show")
    looked = state.looked  # which costs nothing where nothing changed
    state.say("comparing what else would do")
    found = tuple(_found(state, i, *equivalents(state, i), compared) for i, _ in _by_themselves(state))
    left = unexplained(state, looked.places)
    together = np.setdiff1d(state.asked[~(lost_rows(state, heed=True) | state.untold)], state.rows)
    if left is None and len(together):  # rows left out although their neighbours are far off, too
        view = look(state.fit.setup, state.measurements, together)
        squares = view.readings.row_squares(view.residual)
        left = Unexplained(None, None, None, None, float(np.sqrt(squares.sum() / len(state.asked))))
    state.say("finding what is not observable, and what to measure next")
    undecided = None if state.effects or left is not None or withdrawn else _undecided(state, looked)
    others = {one.index: [hypothesis for hypothesis, _ in one.equivalent] for one in found}
    hypotheses = [others.get(index, []) for index in range(len(state.effects))]
    return _summed_up(
        state,
        places,
        found,
        left,
        undecided=undecided,
        not_identifiable=not_identifiable(looked, state),
        smallest=smallest(looked, state),
        next_measurement=(*next_rows(state, hypotheses), *lacking(state.measurements)),
        compared=compared,
        withdrawn=withdrawn,
    )


def _summed_up(
    state: State, places: tuple[RandomTwist, ...], found: tuple[Found, ...], left: Unexplained | None, **more: Any
) -> Trace:
    """Return the account, with what more there is to tell."""
    fit, calibration = state.fit, state.calibration
    folds, judged = pose_folds(state.groups), judged_by(state.calibrated, fit)
    # A random twist stays behind, because nobody can foresee it.
    effects = (*calibration.arm.effects, *state.fitted)
    arm = with_posteriors(fit.setup.arm, fit, certainty_of(fit))
    return Trace(
        arm=replace(arm, effects=effects, instrument=fit.setup.instrument),
        calibration=calibration,
        before=state.calibrated,
        state=state,
        found=found,
        families=_families(state),
        unexplained=left,
        places=places,
        noise=fit.noise,
        held_out_before=held_out(state.calibrated, folds, judged=judged).rms,
        held_out_after=held_out(fit, folds, judged=judged).rms,
        held_out_sessions=sessions_held_out(state.calibrated, fit, state.effects, state.sessions),
        **more,
    )


def _undecided(state: State, looked: Round) -> Undecided | None:
    """Return what is left where it is much and the best candidate is no better than chance, None elsewhere."""
    fit, best = state.fit, looked.ranking[0].evidence
    if fit.noise**2 < LARGER:
        return None
    chance = max(float(null_maximum(sifted, state.groups).max()) for sifted in looked.sifted)
    if best >= chance + MARGIN:
        return None  # what was found was refused for other reasons than chance
    poses, stated = int(state.groups.max()) + 1, fit.view.rms(fit.view.sigma)
    return Undecided(fit.rms, stated, poses, best, chance, fit.view.readings.unit)


def _by_themselves(state: State) -> Iterator[tuple[int, float]]:
    """Yield place and evidence of every effect that was added alone, and of members of families that show alone."""
    for unit in sorted(state.units):
        for index in unit:
            worth = worth_of(state, index)
            if len(unit) == 1 or worth >= ENOUGH:
                yield index, worth


def _families(state: State) -> tuple[FoundFamily, ...]:
    found = []
    for unit in state.units:
        step = state.steps[unit[0]]
        if step is not None and step.kin is not None:
            blocks = [state.effects[i] for i in unit]
            stds = [block.std(state.values_of(block), state.stds_of(block)) for block in blocks]
            members = tuple(zip((state.fitted[i] for i in unit), stds, strict=True))
            found.append(FoundFamily(step.kin, members, step.proof))
    return tuple(found)


def _found(
    state: State, index: int, worth: float, others: tuple[tuple[Effect, float], ...], compared: Compared | None = None
) -> Found:
    block, step = state.effects[index], state.steps[index]
    assert step is not None
    proof = step.proof
    if step.exchanged:
        proof = prove(without(state, index), state, proof.null, [block])
    std = block.std(state.values_of(block), state.stds_of(block))
    effect, family = state.fitted[index], None if step.kin is None else step.kin.number
    names = compared.names[index] if compared is not None else ()
    survives = names.count(effect.name) / len(names) if names else None
    return Found(effect, std, worth, proof, others, step.ranking, step.witness, index, family, survives)


def not_identifiable(looked: Round, state: State) -> tuple[Unidentifiable, ...]:
    """Return laws and sites of which fitted parameters take over all but nothing, with the parameter that does most."""
    bank, regressors = looked.sifted[0].bank, state.fit.regressors
    whole, inside = _left_over(looked)
    sizes = np.maximum(np.sqrt((regressors**2).sum(axis=0)), 1e-300)
    found: dict[tuple[str, str], Unidentifiable] = {}
    added = {(effect.law.name, effect.location) for effect in state.fitted}
    for index, candidate in enumerate(bank.candidates):
        key = (candidate.law.name, candidate.location.place)
        if key in found or bank.sizes[index] != 1 or (candidate.law.name, candidate.location) in added:
            continue
        if whole[index] > 0.0 and inside[index] > ALMOST * whole[index]:
            continue
        partner: ArmParameter | None = None
        if whole[index] > 0.0:  # the parameter whose column is most like its own
            own = bank.group(index)[:, 0]
            likeness = np.abs(regressors.T @ own) / (sizes * float(np.linalg.norm(own)))
            partner = state.fit.parameters[int(likeness.argmax())]
        found[key] = Unidentifiable(*key, partner)
    return tuple(found.values())


def smallest(looked: Round, state: State) -> tuple[Smallest, ...]:
    """Return for every law the range over its places of the tip motion (RMS) that would just have been accepted."""
    bank, fit, where = looked.sifted[0].bank, state.fit, state.fit.view.foremost
    noise = max(1.0, looked.projection.objective / looked.projection.count)
    # (G,) RMS of the 3-D motion of the target per unit of each group's first amplitude [m].
    sigma, raw = fit.view.sigma[:, where], np.zeros(len(bank.candidates))
    scale = np.where(np.isfinite(sigma), sigma, 0.0) / np.sqrt(fit.weights[:, where])
    for part in bank.parts:
        first = np.isin(part.places, bank.starts[:-1])
        regressors = part.regressors[:, first].reshape(*fit.view.sigma.shape, -1)[:, where] * scale[:, :, None]
        each = np.maximum(fit.view.readings.foremost_count, 1)[:, None]
        raw[part.groups] = np.sqrt(((regressors**2).sum(axis=1) / each).mean(axis=0))
    found: dict[str, list[float]] = {}
    whole, inside = _left_over(looked)
    for index in np.flatnonzero((bank.sizes == 1) & (inside > ALMOST * whole)):
        size = float(np.sqrt(SHOWN * noise / inside[index]) * raw[index])
        found.setdefault(bank.candidates[index].law.name, []).append(size)
    return tuple(Smallest(name, min(sizes), max(sizes)) for name, sizes in found.items())


def _left_over(looked: Round) -> tuple[np.ndarray, np.ndarray]:
    """Return the (G,) squares of the first column of every named candidate, and what the fit leaves of them.

    Both are zero where a column is only rounding: an axis through the target moves it by 1e-17, not by nothing.
    """
    named = looked.sifted[0]
    whole, inside, most = np.zeros(len(named.bank.candidates)), np.zeros(len(named.bank.candidates)), {}
    for groups, squares, left in named.inside:
        whole[groups], inside[groups] = squares[:, 0, 0], left[:, 0, 0]
    alike = [(one.law.name, one.location.turns, one.location.terms) for one in named.bank.candidates]  # of a unit
    for kind, square in zip(alike, whole.tolist(), strict=True):
        most[kind] = max(square, most.get(kind, 0.0))
    moves = whole > STILL**2 * np.array([most[kind] for kind in alike])
    return np.where(moves, whole, 0.0), np.where(moves, inside, 0.0)


def unexplained(state: State, places: tuple[RandomTwist, ...]) -> Unexplained | None:
    """Return what is left above the noise without a cause, None when nothing is.

    Args:
        state: The final fit.
        places: Where a random twist would explain its residual, the likeliest first.
    """
    if state.random is not None:
        random = state.random
        rms = state.fit.view.rms(predictable_residual(state) - state.fit.view.residual)
        return Unexplained(random.site, random.axis, random.std, random.units[0], rms, random.alike)
    place = places[0]
    if place.ratio >= NOTICED:
        rms = place.std * state.fit.view.rms(state.fit.view.to_twist(place.site)[:, :, TWIST_NAMES.index(place.axis)])
        return Unexplained(place.site, place.axis, place.std, place.unit, rms, as_likely(places))
    # Without a place, where it is larger than what repeats show, by an F test.
    known = repeats(state.measurements)
    if known is None:
        return None
    scatter, fit = known.same_session, state.fit
    noise = float((scatter.sigma**2).mean())
    squares = (
        fit.view.residual[:, fit.view.foremost][(fit.weights >= 1.0)[:, fit.view.foremost]] ** 2
    )  # tails make a mean of squares anything
    freedom = max(squares.size - (fit.view.count - fit.freedom), 1.0)
    left = float(squares.sum()) / freedom
    if left < LARGER * noise or fdtrc(freedom, 3 * scatter.freedom, left / noise) > UNLIKELY:
        return None
    return Unexplained(None, None, None, None, float(np.sqrt(3.0 * (left - noise))))


def write_traced(declared: Path, trace: Trace, path: Path) -> Path:
    """Write the declared arm.toml with its comments, [calibration], and an [[effect]] for everything that was found.

    What effects change in the model or the instrument is in their tables alone, so nothing is applied twice. What a
    search has found that still goes on is marked `unfinished` in [calibration].

    Args:
        declared: The arm.toml that was traced.
        trace: What was found.
        path: The arm.toml to write; files named in it are named relative to its folder.
    """
    fit = trace.state.fit
    campaign = Campaign(trace.state.measurements.sha256, len(trace.rows) + len(trace.unjudged), trace.rms)
    effects = [
        effect_table(effect, {name: one for name, one in std.items() if np.isfinite(one)})
        for effect, std in trace.added
    ]
    setup = realise(fit.declared, trace.state.blocks, fit.values)  # effects are written by themselves
    assert trace.arm.certainty is not None
    arm = replace(with_posteriors(setup.arm, fit, trace.arm.certainty), instrument=setup.instrument)
    return write_arm(declared, arm, campaign, path, effects, trace.unfinished)
