"""What tracing found: the account that a report prints and an arm.toml keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

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
from armflex.parameters import ArmParameter, numbers_of
from armflex.trace.accept import Proof
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
    """

    effect: Effect
    std: Mapping[str, float]
    evidence: float
    proof: Proof
    equivalent: tuple[tuple[Effect, float], ...]
    ranking: tuple[Polished, ...]
    witness: bool

    @property
    def believed(self) -> str:
        """Why: it predicts held-out rows better, or it ends what strained the priors and predicts them no worse."""
        return "strained priors" if self.witness else "held-out rows"


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


@dataclass(frozen=True, eq=False)
class Trace:
    """A traced arm and an account of it.

    Every error in it is over the same `rows`: those that the final fit, or the calibration, comes near.

    Attributes:
        arm: With everything fitted and every effect added.
        calibration: Before anything was added, lost beams and all.
        before: The same, fitted to the rows that the final fit uses.
        state: The final fit.
        found: Effects in the order added.
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
        unfinished: Whether the search was still going on: what else would do, what could not be told and what to
            measure next is not worked out yet.
        stopped_at: How many effects the search had accepted where that many are its limit, None where it ended because
            nothing was left to be found.
    """

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
    unfinished: bool = False
    stopped_at: int | None = None

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
        known = self.calibration.arm.effects
        return numbers_of((*known, *(one.effect for one in self.found)))[len(known) :]

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
    stated = [{name: std for name, std in found.std.items() if np.isfinite(std)} for found in trace.found]
    effects = [effect_table(found.effect, std) for found, std in zip(trace.found, stated, strict=True)]
    setup = realise(fit.declared, trace.state.blocks, fit.values)  # effects are written by themselves
    arm = replace(with_posteriors(setup.arm, fit), instrument=setup.instrument, certainty=certainty_of(fit))
    return write_arm(declared, arm, campaign, path, effects, trace.unfinished)
