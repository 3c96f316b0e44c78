"""What a fit sees of a campaign at one state of the arm: readings, residuals, and how readings answer to tip motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.effects.law import Effect
from armflex.effects.remember import directions, known_rows
from armflex.effects.rigid import cross_matrices
from armflex.effects.scene import APPROACH
from armflex.effects.spot import same_site, site_of
from armflex.measured.instrument import Instrument
from armflex.measured.measurements import Measurements
from armflex.mechanics.response import Response, respond

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Setup:
    """An arm and the instrument that looks at it: everything a fit may move."""

    arm: Arm
    instrument: Instrument

    def with_effect(self, effect: Effect) -> Setup:
        """Return the setup with an effect added to its arm's list."""
        return replace(self, arm=replace(self.arm, effects=(*self.arm.effects, effect)))


@dataclass(frozen=True)
class View:
    """A campaign at one setup, measured rows only, whitened rows first.

    Attributes:
        setup: The state it was computed at.
        rows: (M,) numbers of the measured rows.
        line: The linearised arm at those rows.
        points: (M, 3) target in the instrument frame, sessions left out.
        residual: (M, d) measured minus predicted, d = 3, or 6 with rotations [m, rad].
        sigma: (M, d) one standard deviation of each; infinite where a row has no orientation.
        seen: (M, d, 6) change of a reading per motion of the tip (origin, base axes).
    """

    setup: Setup
    rows: np.ndarray
    line: Response
    points: Array
    residual: Array
    sigma: Array
    seen: Array

    @property
    def whitened(self) -> Array:
        """(M, d) residual in standard deviations."""
        return self.residual / self.sigma

    @property
    def count(self) -> int:
        """Number of readings: an orientation that was not read is none."""
        return int(np.isfinite(self.sigma).sum())

    def answer(self, motion: Array) -> Array:
        """Return (M, d, k) changes of the readings for (M, 6, k) motions of the tip."""
        return self.seen @ motion

    def to_twist(self, site: str) -> Array:
        """Return (M, d, 6) changes of the readings per twist added to what a site gives."""
        if site not in self._to_twist:
            place = site_of(site, self.setup.arm.robot)
            known = [i for i, flexure in enumerate(self.setup.arm.modelled) if same_site(flexure.site, place)]
            motion = self.line.laws[:, :, known[-1]] if known else self.line.site(site)
            self._to_twist[site] = self.answer(motion)
        return self._to_twist[site]

    @cached_property
    def _to_twist(self) -> dict[str, Array]:
        return {}

    def to_load(self, link: str) -> Array:
        """Return (M, d, 6) changes of the readings per wrench at a link's origin, base axes."""
        if link not in self._to_load:
            self._to_load[link] = self.answer(self.line.link_loads[:, self.line.link_names.index(link)])
        return self._to_load[link]

    @cached_property
    def _to_load(self) -> dict[str, Array]:
        return {}


def look(
    setup: Setup,
    measurements: Measurements,
    rows: np.ndarray,
    progress: Progress | None = None,
) -> View:
    """Return the view of some rows of a campaign at one setup."""
    payloads = [measurements.payload[row] for row in rows]
    known = {name: values[rows] for name, values in known_rows(setup.arm, measurements).items()}
    line = respond(setup.arm, measurements.q[rows], payloads, known, progress)
    sessions = [measurements.session[row] for row in rows]
    instrument = setup.instrument
    residual = measurements.position[rows] - instrument.readings(line.tip, sessions)
    sigma = measurements.sigma[rows]
    seen = _seen_position(instrument, line.tip)
    if measurements.rotation is not None:
        spread = np.repeat(measurements.sigma_r[rows, None], 3, axis=1)
        turns = _rotation_residual(instrument.rotations(line.tip, sessions), measurements.rotation[rows])
        residual = np.hstack([residual, np.where(np.isfinite(spread), turns, 0.0)])
        sigma = np.hstack([sigma, spread])
        seen = np.concatenate([seen, _seen_rotation(instrument, len(rows))], axis=1)
    return View(setup, rows, line, instrument.points(line.tip), residual, sigma, seen)


def untold_shifts(setup: Setup, rows: Measurements) -> Array:
    """Return (K, N, d) by how much readings are off halfway where nothing tells from which side a joint came [m, rad].

    One for each direction that effects derive from the order of the rows (`Effect.derived`), zero where the rows tell
    it: the joint came from either side, so it is the standard deviation of what is read, too.
    """
    effects = setup.arm.effects
    untold = {name: unknown for name, effect, unknown in directions(effects, rows) if name in effect.derived}
    shifts = np.zeros((len(untold), len(rows), 3 if rows.rotation is None else 6))
    for shift, (name, unknown) in zip(shifts, untold.items(), strict=True):
        some, sides = np.flatnonzero(unknown), []
        joint = rows.joint_names.index(name.removeprefix(APPROACH))
        for side in (-1.0, 1.0) if len(some) else ():
            approach = rows.approach.copy()
            approach[some, joint] = side
            sides.append(look(setup, replace(rows, approach=approach), some).residual)
        if sides:
            shift[some] = 0.5 * (sides[0] - sides[1])
    return shifts


def _seen_position(instrument: Instrument, tip: Array) -> Array:
    lever = tip[:, :3, :3] @ instrument.target
    there = np.broadcast_to(np.eye(3), (len(tip), 3, 3))
    return instrument.pose.rotation @ np.concatenate([there, -cross_matrices(lever)], axis=2)


def _seen_rotation(instrument: Instrument, count: int) -> Array:
    turned = np.hstack([np.zeros((3, 3)), instrument.pose.rotation])
    return np.broadcast_to(turned, (count, 3, 6))


def _rotation_residual(predicted: Array, measured: Array) -> Array:
    turns = [pin.log3(pin.exp3(vector) @ rotation.T) for vector, rotation in zip(measured, predicted, strict=True)]
    return np.array(turns)


def position_rms(errors: Array) -> float:
    """Return the RMS of the 3-D position error [m] of (M, 3) or (M, 6) errors."""
    return float(np.sqrt((errors[:, :3] ** 2).sum(axis=1).mean()))
