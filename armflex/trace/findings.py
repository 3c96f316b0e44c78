"""What tracing found: the account that a report prints and an arm.toml keeps, and how it is drawn up after a search.

What every effect is worth, what else would do, what is not identifiable, and what is left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import fdtrc

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import TWIST_NAMES, Array, said_of
from armflex.errors import FEW, Flag, listing
from armflex.estimate.calibrate import Calibration, far_from_declared, worse_than_declared
from armflex.estimate.fit import Fit, realise
from armflex.estimate.held_out import OfCampaign, by_campaign
from armflex.estimate.learn import with_posteriors
from armflex.estimate.outliers import Outlier, exchanged, outliers_of
from armflex.estimate.robust import BY_CHANCE
from armflex.estimate.view import View, foremost_rms, look
from armflex.files.arm_file import write_arm
from armflex.files.calibration_table import Campaign
from armflex.files.effect_file import effect_table
from armflex.laws.effects.effect import Effect
from armflex.measured.repeats import repeats
from armflex.parameters import ArmParameter
from armflex.plan.asking import RequestedRows
from armflex.result import Result
from armflex.trace.averaging import Averaged
from armflex.trace.families import Families
from armflex.trace.hypotheses import Hypothesis
from armflex.trace.resampling import RESAMPLES, Resampled
from armflex.trace.state import State, lost_of
from armflex.trace.unrecorded import RandomTwist, as_likely, noticed_from
from armflex.trace.validate import Compared, Proof

VARIANCE_RATIO = 2.0
"""Confidence: variance over that of repeats from which a residual without a place is reported at all."""

HELD_OUT_IS_OF = (
    "Effects were selected and fitted without the held-out poses; the final candidates and the families at every drive "
    "were selected from all rows."
)
"""What was decided without the poses that held-out errors are of, and what was not."""


@dataclass(frozen=True, eq=False)
class Found:
    """An effect that was added.

    Attributes:
        effect: With its fitted values.
        std: Standard uncertainty of each of them by name.
        evidence: Twice the log odds of it beside the others, over none.
        proof: Held-out rows.
        ranking: What competes for its place with twice the log odds, the best first.
        index: Its place among the effects of the final fit.
        number: Which of its name it is in the arm, see `numbers_of`.
        probability: Of it, law and place.
        credible: Single effects that with it make up the 95 % credible set, with the probability of each.
        determined: Whether its amplitudes differ from zero beyond chance, whatever all other fitted values are.
    """

    effect: Effect
    std: Mapping[str, float]
    evidence: float
    proof: Proof
    ranking: tuple[tuple[Hypothesis, float], ...]
    index: int
    number: int
    probability: float
    credible: tuple[tuple[Effect, float], ...] = ()
    determined: bool = True

    @property
    def title(self) -> str:
        """What it is in words."""
        return self.effect.title

    @property
    def equivalent(self) -> tuple[tuple[Effect, float], ...]:
        """Other candidates that these data do not distinguish from it, with how much less evidence they have."""
        own = max(self.probability, 1e-9)
        return tuple((effect, 2.0 * float(np.log(own / share))) for effect, share in self.credible)

    @property
    def is_named(self) -> bool:
        """Whether it is likelier than all else and nothing together, and has numbers that rows determine.

        A share of resamples that is one half has the standard error 1 / (2 sqrt(`RESAMPLES`)): what exceeds one half by
        less is a tie, of which another draw gives either side.
        """
        return self.probability > 0.5 * (1.0 + RESAMPLES**-0.5) and self.determined


@dataclass(frozen=True, eq=False)
class Replicated:
    """A name that one half of a campaign gives, and what the other half says of it; see `armflex.trace.halves`.

    Attributes:
        split: Which split it is of, such as 'random 1' or 'parts 1'.
        half: 1 or 2.
        effect: With the values that the half has.
        probability: That the half states.
        probability_there: That the other half gives the same law at the same place.
        in_other_half: Whether it is in a 95 % credible set there.
        numbers_agree: Whether all its values are within three combined standard uncertainties there; None where it is
            not found there, or has no values with an uncertainty.
    """

    split: str
    half: int
    effect: Effect
    probability: float
    probability_there: float
    in_other_half: bool
    numbers_agree: bool | None


@dataclass(frozen=True)
class Unexplained:
    """A residual above the noise without a cause.

    Attributes:
        site, axis: Where it acts, None where not even that is known.
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
    """A residual far above what is stated, of which no effect is the likely cause.

    Attributes:
        rms: RMS of the 3-D error that is left [m].
        stated: What the stated standard deviations alone would give [m].
        poses: Distinct poses that were fitted.
        likeliest: Probability of the likeliest effect.
        unit: In which `rms` and `stated` are, where it is not m.
    """

    rms: float
    stated: float
    poses: int
    likeliest: float
    unit: str = "m"

    @property
    def text(self) -> str:
        """In a sentence."""
        return (
            f"These data cannot decide what is missing: {said_of(self.rms, self.unit)} RMS are left where "
            f"{said_of(self.stated, self.unit)} are stated, and with {self.poses} distinct poses the likeliest effect "
            f"has a probability of {self.likeliest:.0%}: measure more poses."
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
        predicted: What `arm` has: the average over the models of resamples.
        found: Effects in the order added.
        unexplained: What is left above the noise, None when nothing is.
        places: Likeliest places of what was left at first.
        held_out_before, held_out_after: RMS of the 3-D error on held-out poses [m].
        held_out_sessions: The same before and after with whole sessions held out, None where none can judge.
        not_identifiable: Effects that could not have been identified.
        smallest: What the campaign could have shown at least.
        next_measurement: What to measure next, in words.
        asked: The rows that decide what is in question, where they were wanted.
        compared: Held-out poses, everything chosen and fitted without them; None where nothing was added.
        families: Which kinds of effect are in the arm beside what is named; where none is, which kinds the calibrated
            arm lacks before anything is named.
        undecided: What is left where these rows do not determine whether anything is missing, None where they can.
        unfinished: Whether it was ended at once: what was accepted is in `arm` and `accepted` alone, and what else
            would do, what is not identifiable and what to measure next is not worked out.
        nothing: Probability that no effect is missing at all; None where it is unfinished.
        suspects: Every single effect that competes with its probability, named or not, from 1 % on.
        resampled: The resamples of the campaign over which probabilities are averages; None where it is unfinished.
        halves: What halves of the campaign name; None where that was not asked.
        ended: What ended the search before nothing more was to be tried, in words, '' where nothing did.
    """

    FIELDS = (
        *("unfinished", "ended", "declared_rms", "calibrated_rms", "rms", "noise_rms", "held_out"),
        *("effects", "common", "unexplained", "not_identifiable", "next_measurement"),
    )
    ROWS = "effects"

    arm: Arm
    predicted: Averaged
    found: tuple[Found, ...]
    unexplained: Unexplained | None
    places: tuple[RandomTwist, ...]
    held_out_before: float
    held_out_after: float
    held_out_sessions: tuple[float, float] | None
    not_identifiable: tuple[Unidentifiable, ...] = ()
    smallest: tuple[Smallest, ...] = ()
    next_measurement: tuple[str, ...] = ()
    asked: RequestedRows | None = None
    compared: Compared | None = None
    families: Families | None = None
    undecided: Undecided | None = None
    unfinished: bool = False
    nothing: float | None = None
    suspects: tuple[tuple[Effect, float], ...] = ()
    resampled: Resampled | None = None
    halves: tuple[Replicated, ...] | None = None
    ended: str = ""

    def __repr__(self) -> str:
        """One line: what was found, and the error before and after it."""
        unit = self.state.measurements.readings.unit
        named = [one.title for one in self.named] if not self.unfinished else [one.title for one, _ in self.accepted]
        names = listing([*named, *self.common], FEW)
        after, held_out = (said_of(one, unit) for one in (self.rms, self.held_out[1]))
        errors = f"RMS {said_of(self.calibrated_rms, unit)} calibrated, {after} with it, {held_out} held out"
        return f"<Trace: {names}; {errors}{f'; ended {self.ended}' if self.ended else ''}>"

    @property
    def state(self) -> State:
        """The final fit, and the calibration before it."""
        return self.predicted.state

    @property
    def accepted(self) -> list[tuple[Effect, Mapping[str, float]]]:
        """Effects with their standard uncertainties by name: those found, or of an unfinished search all it has."""
        if self.unfinished:
            return list(zip(self.state.fitted, map(self.predicted.std_of, self.state.effects), strict=True))
        return [(one.effect, one.std) for one in self.found]

    @property
    def calibration(self) -> Calibration:
        """Before anything was added, lost beams and all."""
        return self.state.calibration

    @property
    def flags(self) -> tuple[Flag, ...]:
        """What is doubtful: as the calibration has it, but what is said of its result is said of the traced arm."""
        first = [one for one in self.calibration.flags if one.code not in ("beyond_priors", "worse_than_declared")]
        if len(first) < len(self.calibration.flags) and self.calibration.held_out is not None:
            errors = self.calibration.held_out[0], self.held_out[1]
            first += worse_than_declared(errors, self.state.fit.view.readings.unit)
        if (share := self.predicted.share) < 1.0:
            text = f"held-out poses are predicted best by {share:.0%} of what was found and of families"
            first.append(Flag("averaged", f"{text}, the rest by the calibrated arm: so the arm predicts", size=share))
        return (*first, *far_from_declared(self.state.fit, self.state.first.parameters, self.arm))

    @property
    def before(self) -> Fit:
        """The same, fitted to the rows that the final fit uses."""
        return self.state.calibrated

    @property
    def noise(self) -> float:
        """Standard deviation of the readings over the stated one, from the final residual."""
        return self.state.fit.noise

    @property
    def effects(self) -> list[dict[str, Any]]:
        """What was found: title, values and their standard uncertainties, in the order added."""
        return [
            {"effect": one.title, **one.named} | {f"std {name}": value for name, value in std.items()}
            for one, std in self.accepted
        ]

    @property
    def named(self) -> tuple[Found, ...]:
        """Those of `found` that are likelier than all else that they may be."""
        return tuple(one for one in self.found if one.is_named)

    @property
    def unsettled(self) -> tuple[Found, ...]:
        """Those of `found` that are there or something else is: no name."""
        return tuple(one for one in self.found if not one.is_named)

    @property
    def common(self) -> list[str]:
        """Families that are in the arm."""
        return list(self.state.background.names)

    @cached_property
    def judged_rows(self) -> np.ndarray:
        """(M,) which of the fitted rows every error is over."""
        return np.any(self.state.judged, axis=1)

    @property
    def rows(self) -> np.ndarray:
        """(K,) numbers of the fitted rows that every error is over."""
        return self.state.rows[self.judged_rows]

    @cached_property
    def unjudged(self) -> np.ndarray:
        """(U,) rows in which nothing says what an effect depends on: neither in the fit nor in any error."""
        state = self.state
        return state.asked[state.undirected & ~lost_of(state, heed=False)[1]]

    def _rms(self, view: View, errors: Array) -> float:
        """Return the RMS of (M, d) errors [m] of the fitted rows."""
        return foremost_rms(view.readings.where(self.state.judged), errors)

    @cached_property
    def campaigns(self) -> tuple[OfCampaign, ...]:
        """Errors of each of several campaigns, of the calibrated arm and with what was found."""
        return by_campaign(self.before.view, self.state.fit, self.state.judged, self.state.residual)

    @property
    def declared_rms(self) -> float:
        """RMS of the 3-D position error with only the instrument's frame fitted [m]."""
        placed = self.calibration.placed
        view = placed.some(np.flatnonzero(np.isin(placed.rows, self.state.rows)))
        return self._rms(view, view.residual)

    @property
    def calibrated_rms(self) -> float:
        """The same after calibration [m]."""
        return self._rms(self.before.view, self.before.view.residual)

    @property
    def rms(self) -> float:
        """The same with everything that can be predicted [m]."""
        return self._rms(self.state.fit.view, self.state.residual)

    @property
    def noise_rms(self) -> float:
        """What the stated standard deviations alone would give [m]."""
        return self._rms(self.state.fit.view, self.state.fit.view.sigma)

    @cached_property
    def outliers(self) -> tuple[Outlier, ...]:
        """All other rows that were to be used, and readings that were left out of rows, the worst first.

        Each is a 'lost beam', 'exchanged' with another, 'unexplained' (far off, and its neighbours too) or, still in
        the fit, 'counted less'.
        """
        state, whole = self.state, self.calibration.measurements
        rows = np.setdiff1d(state.asked, [*self.rows, *self.unjudged])
        gone = np.isin(state.asked, rows)
        far = lost_of(state, heed=False)[0] & (gone[:, None] | state.lost)
        view, alone, paired = (
            look(state.fit.setup, whole, state.asked),
            lost_of(state, heed=True)[1],
            np.zeros_like(far),
        )
        for place in exchanged(view, far):
            paired[place] = True
        found = list(outliers_of(view, far & (~gone[:, None] | paired), whole, "lost beam"))
        for i in np.flatnonzero(gone & ~np.isin(state.asked, [one.row for one in found])):
            row, error = int(state.asked[i]), float(np.sqrt(view.readings.row_squares(view.residual)[i]))
            kind = "counted less" if row in state.rows else "lost beam" if alone[i] else "unexplained"
            place = whole.places[row] if whole.places else None
            found.append(Outlier(row, place, error, kind, unit=view.readings.unit))
        return tuple(sorted(found, key=lambda one: -one.error_m))

    def outlier_count(self, kind: str) -> int:
        """Return how many outliers are of one kind."""
        return sum(one.kind == kind for one in self.outliers)

    @property
    def held_out(self) -> tuple[float, float]:
        """RMS of the 3-D error on held-out poses, of the calibrated arm and with what was found [m].

        Where something was found, what it is was chosen without them; `held_out_after` is of what all rows chose.
        """
        if self.compared is None:
            return self.held_out_before, self.held_out_after
        after = self.held_out_after if self.predicted.share == 1.0 else 0.0  # else it is not of what is predicted
        return self.compared.before, max(self.compared.after, after)

    @checked_kinds
    def write(self, path: str | Path) -> Path:
        """Write the declared arm.toml with its comments, [calibration], and an [[effect]] for everything found.

        A comment says of each whether it is named, of a family, or a rival that a part of the models has.

        What effects change in the model or the instrument is in their tables alone, so nothing is applied twice. What
        a search had accepted that was ended at once is marked `unfinished` in [calibration].

        Args:
            path: The arm.toml to write; files named in it are named relative to its folder.

        Raises:
            UnsupportedError: No arm.toml declares the arm, or it was changed in Python after it was read.
            FileError: It cannot be written.
        """
        assert self.arm.certainty is not None
        fit, state = self.state.fit, self.state
        campaign = Campaign(state.measurements.sha256, len(self.rows), self.rms, state.measurements.clock)
        tables = [effect_table(one, std) for one, std in self.predicted.stated(self.arm.certainty)]
        remarks = [f"named, {one.probability:.0%}" if one.is_named else f"{one.probability:.0%}" for one in self.found]
        remarks = remarks or [""] * len(state.effects)
        remarks += [f"of the family: {name}" for name in state.background.of[: len(state.background.effects)]]
        remarks += [f"in {share:.0%} of the models that are averaged" for share in self.predicted.shares]
        effects = list(zip(tables, remarks, strict=True))
        setup = realise(fit.declared, state.blocks, self.predicted.values)  # effects are written by themselves
        arm = replace(with_posteriors(setup.arm, fit, self.arm.certainty), instrument=setup.instrument)
        return write_arm(arm, campaign, Path(path), effects, self.unfinished)


def unexplained(state: State, places: tuple[RandomTwist, ...]) -> Unexplained | None:
    """Return what is left above the noise without a cause, None when nothing is.

    Args:
        state: The final fit.
        places: Where a random twist would explain its residual, the likeliest first.
    """
    if state.random is not None:
        random = state.random
        rms = state.fit.view.rms(state.residual - state.fit.view.residual)
        return Unexplained(random.site, random.axis, random.std, random.units[0], rms, random.alike)
    place = places[0]
    if place.ratio >= noticed_from(len(places)):
        rms = place.std * state.fit.view.rms(state.fit.view.to_twist(place.site)[:, :, TWIST_NAMES.index(place.axis)])
        return Unexplained(place.site, place.axis, place.std, place.unit, rms, as_likely(places))
    # Without a place, where it is larger than what repeats show, by an F test.
    known = repeats(state.measurements)
    if known is None:
        return None
    scatter, fit = known.same_session, state.fit
    noise = float((scatter.sigma**2).mean())
    where, whole = fit.view.foremost, fit.weights >= 1.0  # tails make a mean of squares anything
    squares = fit.view.residual[:, where][whole[:, where]] ** 2
    freedom = max(squares.size - (fit.view.count - fit.freedom), 1.0)
    left = float(squares.sum()) / freedom
    if left < VARIANCE_RATIO * noise or fdtrc(freedom, 3 * scatter.freedom, left / noise) > BY_CHANCE:
        return None
    return Unexplained(None, None, None, None, float(np.sqrt(3.0 * (left - noise))))
