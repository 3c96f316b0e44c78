"""What tracing found: the account that a report prints and an arm.toml keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armflex.arm import Arm
from armflex.calibrate.calibrate import Calibration
from armflex.conventions import Array
from armflex.effects.law import Effect
from armflex.trace.localise import Place
from armflex.trace.polish import Polished
from armflex.trace.state import State


@dataclass(frozen=True)
class Proof:
    """Errors of rows that were not used, before and after an effect [m].

    Attributes:
        before, after: RMS of the 3-D error, poses held out.
        sessions_before, sessions_after: The same with whole sessions held out, over those without which it
            still shows; None where there are none.
        errors_apart: Standard errors by which the mean squared error falls.
        null: Best evidence that any candidate had under random signs, 200 times.
    """

    before: float
    after: float
    sessions_before: float | None
    sessions_after: float | None
    errors_apart: float
    null: float


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
    equivalent: tuple[Place, ...] = ()


@dataclass(frozen=True)
class Unidentifiable:
    """An effect that this campaign could not have shown: law and site, and what takes its place."""

    effect: str
    site: str
    reason: str


@dataclass(frozen=True)
class Smallest:
    """The smallest effect of a law that this campaign would have shown, over its places: RMS at the tip [m]."""

    effect: str
    least: float
    most: float


@dataclass(frozen=True, eq=False)
class Trace:
    """A traced arm and an account of it.

    Attributes:
        arm: With everything fitted and every effect added.
        calibration: Before anything was added.
        state: The final fit.
        found: Effects in the order added.
        unexplained: What is left above the noise, None when nothing is.
        places: Likeliest places of what was left at first.
        not_identifiable: Effects that could not have been told.
        smallest: What the campaign could have shown at least.
        noise: Standard deviation of the readings over the stated one, from the final residual.
        held_out_before, held_out_after: RMS of the 3-D error on held-out poses [m].
        held_out_sessions: The same before and after with whole sessions held out, None where none can judge.
        next_measurement: What to measure next, in words.
    """

    arm: Arm
    calibration: Calibration
    state: State
    found: tuple[Found, ...]
    unexplained: Unexplained | None
    places: tuple[Place, ...]
    not_identifiable: tuple[Unidentifiable, ...]
    smallest: tuple[Smallest, ...]
    noise: float
    held_out_before: float
    held_out_after: float
    held_out_sessions: tuple[float, float] | None
    next_measurement: tuple[str, ...]

    @property
    def rms(self) -> float:
        """RMS of the 3-D position error with everything that can be predicted [m]."""
        return float(np.sqrt((self.residual[:, :3] ** 2).sum(axis=1).mean()))

    @property
    def residual(self) -> Array:
        """(M, d) measured minus predicted; what is random is not predicted [m, rad]."""
        return predictable_residual(self.state)


def predictable_residual(state: State) -> Array:
    """Return the (M, d) residual without the random twists, whose values nobody can know beforehand."""
    view = state.fit.view
    if state.random is None:
        return view.residual
    return view.residual + state.random.columns(view) @ state.values_of(state.random)
