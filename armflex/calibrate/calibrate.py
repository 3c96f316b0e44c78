"""`calibrate`: everything that [prior] frees, fitted to a campaign through the deflected arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Arm
from armflex.calibrate.blocks import Block, declared_blocks
from armflex.calibrate.enough import check_readings
from armflex.calibrate.fit import Fit, fit
from armflex.calibrate.identify import Parameter, parameters
from armflex.calibrate.law_block import law_block
from armflex.calibrate.learn import fit_learning, settled
from armflex.calibrate.spread import FRAMES, INSTRUMENT, certainty_of
from armflex.calibrate.view import Progress, Setup, View, look, position_rms
from armflex.calibrate.weigh import ROUNDS, Weighed
from armflex.conventions import Array
from armflex.effects.catalogue import CATALOGUE
from armflex.effects.law import LoadLaw, TwistLaw
from armflex.effects.remember import derived_directions, known_rows
from armflex.errors import Flag, InputError, Place, UnsupportedError, listing
from armflex.laws.learned import Seen
from armflex.measured.instrument import Instrument, fit_frame, fit_mounting
from armflex.measured.measurements import Measurements
from armflex.mechanics.response import respond

OUTLIER = 0.5
"""Robust weight below which a row is listed as an outlier."""

FEWEST_ROWS = 4


@dataclass(frozen=True)
class Outlier:
    """A row that the fit does not believe: its place, its error [m], and what became of it."""

    row: int
    place: Place | None
    error_m: float
    kind: str = "counted less"


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated arm and an account of it.

    Attributes:
        arm: The arm with its fitted compliances and corrections, and the instrument that saw it.
        fit: The fit itself: values, covariance, residuals.
        placed: The rows as the declared arm explains them, only the instrument's frame fitted.
        measurements: The campaign.
        flags: Doubts about the learned laws: a search that did not settle.
    """

    arm: Arm
    fit: Fit
    placed: View
    measurements: Measurements
    flags: tuple[Flag, ...] = ()

    @property
    def declared_rms(self) -> float:
        """RMS of the 3-D position error with only the instrument's frame fitted [m]."""
        return position_rms(self.placed.residual)

    @property
    def noise_rms(self) -> float:
        """What the stated standard deviations alone would give [m]."""
        return position_rms(self.placed.sigma)

    @property
    def rms(self) -> float:
        """RMS of the 3-D position error after calibration [m]."""
        return self.fit.rms

    @property
    def weighed(self) -> float:
        """Factor on the stated noise by which the fit weighed the readings: 1, more where they scatter more."""
        return self.fit.factor

    @property
    def scatter(self) -> float:
        """Standard deviation of the readings over the stated one, if what is left of them is nothing else."""
        return self.weighed * self.fit.noise

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Every fitted parameter."""
        return parameters(self.fit)

    @property
    def findings(self) -> tuple[Parameter, ...]:
        """Parameters that moved by more than their prior allows."""
        return tuple(parameter for parameter in self.parameters if parameter.surprising)

    @property
    def undetermined(self) -> tuple[Parameter, ...]:
        """Parameters that these data say nothing about."""
        return tuple(parameter for parameter in self.parameters if not parameter.determined)

    @property
    def outliers(self) -> tuple[Outlier, ...]:
        """Rows with little weight, the worst first."""
        view = self.fit.view
        error = np.linalg.norm(view.residual[:, :3], axis=1)
        far = np.flatnonzero(self.fit.weights < OUTLIER)
        places = self.measurements.places
        ordered = far[np.argsort(-error[far])]
        return tuple(
            Outlier(int(view.rows[i]), places[view.rows[i]] if places else None, float(error[i])) for i in ordered
        )


def calibrate(
    arm: Arm,
    measurements: Measurements,
    rows: np.ndarray | None = None,
    progress: Progress | None = None,
    keep: bool = False,
    as_stated: bool = False,
    seen: Mapping[str, Seen] | None = None,
) -> Calibration:
    """Return the arm with everything that its [prior] frees fitted to a campaign.

    Readings that scatter more than they state, because the arm lacks something, are weighed by their scatter: else what
    is free would be driven far beyond its prior to make up for it. An arm that was calibrated before is fitted about
    what it was calibrated to.

    Args:
        arm: The arm as declared; its prior says what may move and how far.
        measurements: Where the tip was seen.
        rows: Row numbers to use; every measured row when not given.
        progress: Called with (steps done, steps at most).
        keep: Keep what an earlier campaign was fitted to: only the instrument's and the sessions' frames, and how the
            target is turned on the tool, are fitted. The covariance of what is kept stays as it was, as if it were
            independent of the new frames'.
        as_stated: Weigh readings by their stated noise alone, as a search for what the arm lacks must.
        seen: Loads that learned laws are made for, by flexure; those of the rows when not given.

    Raises:
        InputError: Too few rows were measured, or see `check_readings`.
        MissingCovariateError: An effect of the arm depends on what the campaign does not give.
        UnsupportedError: The arm has effects that change masses, gravity or the instrument.
        ConvergenceError: The fit did not settle.
    """
    used = np.flatnonzero(measurements.measured) if rows is None else rows
    _check_fit(arm, measurements, used)
    declared, placed = _placed(arm if keep else replace(arm, certainty=None), measurements, used)
    blocks = [block for block in declared_blocks(declared, measurements) if not keep or block.name in FRAMES]
    laws = None if keep else law_block(declared, placed, seen)

    begun, rounds = Weighed(measurements), 0 if as_stated else ROUNDS
    if laws is None:
        found, flags = _fit(declared, blocks, begun, used, rounds, progress), ()
    else:
        found, flags = fit_learning(declared, blocks, laws, begun, used, not as_stated, progress)
    known = {"instrument": found.setup.instrument, "certainty": certainty_of(found)}
    calibrated = replace(settled(found.setup.arm, found), **known)
    return Calibration(calibrated, found, placed, measurements, flags)


def _fit(
    declared: Setup,
    blocks: Sequence[Block],
    weighed: Weighed,
    used: np.ndarray,
    rounds: int,
    progress: Progress | None,
) -> Fit:
    """Return a fit to readings that scatter as they are weighed."""
    found = fit(declared, blocks, weighed.measurements, used, progress=progress)
    for _ in range(rounds):
        better = weighed.again(found)
        if better.close_to(weighed):
            break
        weighed, found = better, fit(declared, blocks, better.measurements, used, found.values, progress)
    return replace(found, factor=weighed.factor)


def loads_seen(arm: Arm, measurements: Measurements) -> dict[str, Seen]:
    """Return the loads that a campaign puts on each flexure that learns, as the declared arm has them.

    Raises:
        As `calibrate`, before its fit.
    """
    used = np.flatnonzero(measurements.measured)
    _check_fit(arm, measurements, used)
    laws = law_block(*_placed(replace(arm, certainty=None), measurements, used))
    return {} if laws is None else {name: law.seen for name, law in zip(laws.flexures, laws.laws, strict=True)}


def _placed(arm: Arm, measurements: Measurements, used: np.ndarray) -> tuple[Setup, View]:
    """Return the first guess, and the rows with only the instrument's frame fitted."""
    declared = first_guess(arm, measurements, used)
    frame = [block for block in declared_blocks(declared, measurements) if block.name == INSTRUMENT]
    view = fit(declared, frame, measurements, used).view if frame else look(declared, measurements, used)
    return declared, view


def _check_fit(arm: Arm, measurements: Measurements, used: np.ndarray) -> None:
    """Raise where an arm cannot be fitted to some rows of a campaign; see `calibrate`."""
    if len(used) < FEWEST_ROWS:
        raise InputError(f"{len(used)} measured rows, expected {FEWEST_ROWS} or more")
    fixed = [effect.name for effect in arm.effects if not isinstance(effect.law, TwistLaw | LoadLaw)]
    if fixed:
        text = f"effects that change the model itself cannot be fitted about: {listing(fixed)}"
        others = listing(name for name, law in CATALOGUE.items() if not isinstance(law, TwistLaw | LoadLaw))
        raise UnsupportedError(f"{text} (such are {others}); leave them out of the arm that is fitted")
    derived_directions(arm, measurements, used)


def first_guess(arm: Arm, measurements: Measurements, rows: np.ndarray) -> Setup:
    """Return the arm with its instrument, placed by a best rigid fit where its frame is unknown."""
    instrument = arm.instrument or Instrument()
    known = {name: values[rows] for name, values in known_rows(arm, measurements).items()}
    line = respond(arm, measurements.q[rows], [measurements.payload[row] for row in rows], known)
    points = line.tip[:, :3, 3] + line.tip[:, :3, :3] @ instrument.target
    check_readings(arm, points, measurements, rows)
    if arm.measurement.frame != "base":
        instrument = replace(instrument, pose=fit_frame(points, measurements.position[rows]))
    return Setup(arm, _mounted(instrument, line.tip, measurements, rows))


def _mounted(instrument: Instrument, tip: Array, measurements: Measurements, rows: np.ndarray) -> Instrument:
    """Return the instrument with its target turned on the tool as read orientations have it."""
    if measurements.rotation is None:
        return instrument
    read = np.isfinite(measurements.sigma_r[rows])
    if not read.any():
        return instrument
    return replace(instrument, mounting=fit_mounting(instrument.axes(tip[read]), measurements.rotation[rows[read]]))
