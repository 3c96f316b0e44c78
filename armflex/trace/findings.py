"""What tracing found: the account that a report prints and an arm.toml keeps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.estimate.calibrate import Calibration, Outlier
from armflex.estimate.fit import Fit, realise
from armflex.estimate.held_out import believed
from armflex.estimate.learn import with_posteriors
from armflex.estimate.posterior import certainty_of
from armflex.estimate.view import View, foremost_rms, look
from armflex.files.arm_file import write_arm
from armflex.files.calibration_table import Campaign
from armflex.files.effect_file import effect_table
from armflex.laws.effects.effect import Effect
from armflex.parameters import ArmParameter
from armflex.result import Result
from armflex.trace.accept import Kin, Proof
from armflex.trace.polish import Polished
from armflex.trace.state import State, lost_rows
from armflex.trace.unrecorded import RandomTwist
from armflex.trace.withdraw import Compared, Withdrawn


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

    @property
    def believed(self) -> str:
        """Why: it predicts held-out rows better, or it ends what strained the priors and predicts them no worse."""
        return "strained priors" if self.witness else "held-out rows"


@dataclass(frozen=True, eq=False)
class Family:
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
    """

    rms: float
    stated: float
    poses: int
    evidence: float
    chance: float

    @property
    def text(self) -> str:
        """In a sentence."""
        return (
            f"These data cannot decide what is missing: {1e3 * self.rms:.3g} mm RMS are left where "
            f"{1e3 * self.stated:.3g} mm are stated, and with {self.poses} distinct poses chance explains as much "
            f"as the best effect does (evidence {self.chance:.0f} beside {self.evidence:.0f}): measure more poses."
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
    families: tuple[Family, ...] = ()
    undecided: Undecided | None = None
    unfinished: bool = False
    stopped_at: int | None = None

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
        return believed(self.before, self.state.fit)

    @property
    def rows(self) -> np.ndarray:
        """(K,) numbers of the rows that every error is over."""
        return self.state.rows[self.believed]

    @property
    def declared_rms(self) -> float:
        """RMS of the 3-D position error with only the instrument's frame fitted [m]."""
        placed = self.calibration.placed
        return _rms_of(placed, placed.residual, np.isin(placed.rows, self.rows))

    @property
    def calibrated_rms(self) -> float:
        """The same after calibration [m]."""
        return _rms_of(self.before.view, self.before.view.residual, self.believed)

    @property
    def rms(self) -> float:
        """The same with everything that can be predicted [m]."""
        return _rms_of(self.state.fit.view, self.residual, self.believed)

    @property
    def noise_rms(self) -> float:
        """What the stated standard deviations alone would give [m]."""
        return _rms_of(self.state.fit.view, self.state.fit.view.sigma, self.believed)

    @cached_property
    def outliers(self) -> tuple[Outlier, ...]:
        """All other rows that were to be used, the worst first.

        Each is a 'lost beam', 'unexplained' (far off, and its neighbours too), 'direction unknown' (of a joint that had
        not moved yet; an effect depends on it) or, still in the fit, 'counted less'.
        """
        state = self.state
        rows = np.setdiff1d(state.asked, self.rows)
        if not len(rows):
            return ()
        places, used = state.measurements.places, np.isin(rows, state.rows)
        alone = np.isin(rows, state.asked[lost_rows(state, heed=True)])
        untold = np.isin(rows, state.asked[state.untold])
        left = np.where(untold, "direction unknown", np.where(alone, "lost beam", "unexplained"))
        kinds = np.where(used, "counted less", left).tolist()
        view = look(state.fit.setup, state.measurements, rows)
        errors = np.linalg.norm(view.residual[:, view.foremost], axis=1)
        return tuple(
            Outlier(int(rows[i]), places[rows[i]] if places else None, float(errors[i]), kinds[i])
            for i in np.argsort(-errors)
        )

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
            "laws, places and values were chosen and fitted without them, and whether an effect is added at all; "
            "which laws competed at last, and what drives have in common, with all rows in sight."
        )

    @property
    def residual(self) -> Array:
        """(M, d) measured minus predicted; what is random is not predicted [m, rad]."""
        return predictable_residual(self.state)


def _rms_of(view: View, errors: Array, some: np.ndarray) -> float:
    """Return the RMS of (M, d) errors over the rows of a (M,) mask; see `View.rms`."""
    return foremost_rms(view.readings.some(np.flatnonzero(some)), errors[some])


def predictable_residual(state: State) -> Array:
    """Return the (M, d) residual without the random twists, whose values nobody can know beforehand."""
    view = state.fit.view
    if state.random is None:
        return view.residual
    return view.residual + state.random.jacobian(view) @ state.values_of(state.random)


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
    campaign = Campaign(trace.state.measurements.sha256, len(trace.rows), trace.rms)
    effects = [
        effect_table(effect, {name: one for name, one in std.items() if np.isfinite(one)})
        for effect, std in trace.added
    ]
    setup = realise(fit.declared, trace.state.blocks, fit.values)  # effects are written by themselves
    arm = replace(with_posteriors(setup.arm, fit), instrument=setup.instrument, certainty=certainty_of(fit))
    return write_arm(declared, arm, campaign, path, effects, trace.unfinished)
