"""`Tracker`: calibration kept up with the arm, one reading at a time, for a controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import NamedTuple

import numpy as np

from armflex.arguments import checked_kinds
from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import ArmflexError, InputError, ModelFileError, Place, UnknownNameError
from armflex.rows.rows import APPROACH, last_motion
from armflex.storage.digest import digest
from armflex.track.estimate import Estimate, estimate_of, expected_variance, recentred, take, widen
from armflex.track.reading import Reading, as_row, number, sensible
from armflex.track.state_space import LinearisedView, StateSpace, model_of
from armflex.track.tracker_file import LAYOUT, TrackerState, read_state, write_state
from armflex.track.watch import WINDOW, Anchor, Change, Watch, contradicted, fainter, seek

EVERY, PATIENCE = 16, 0.02
"""Drift is added to the covariance at every sixteenth reading at the latest, and before a reading where it has come to
this part of a parameter's variance: a new square root costs more than a reading."""


FASTEST = 10
"""A rate, per unit of time, at most, by what is expected of a change."""


class Step(NamedTuple):
    """What became of a reading.

    Attributes:
        weight: 1 for most; less the farther a reading is from what was expected, 0 where it was left out.
        distance: How far it is, in standard deviations of what was expected (Mahalanobis).
        change: What is announced with it, None for most.
    """

    weight: float
    distance: float
    change: Change | None


class Tracker:
    """The streaming form of `calibrate`; for one thread. Without drift it is the same least squares, to rounding.

    It starts from what a calibration left of certainty (`Arm.certainty`), or where there is none from [prior]. Frames
    of the campaign's sessions are left behind: every new session's frame is uncertain as [prior] says. Effects of the
    arm stay as they are; where one derives from which side a joint came (`Effect.derived`), readings show it by their
    order unless they give it. Directions of parameters that calibration left open are as uncertain as can be until a
    reading informs on them. A reading that is off counts less; where several agree that a law has changed, the law is
    announced, and followed from where it changed. What is not among the parameters cannot be distinguished from what
    is.

    While too little is known to distinguish a gross reading from a true one (the arm is as declared, or the session is
    new), the readings so far, 48 at most, are judged again by one another after every reading, and no change is
    announced.

    Memory is constant. An update takes some tenths of a millisecond, one that judges readings again or looks for a
    change some milliseconds. The first reading with a payload takes ten milliseconds more; the first tracker of all on
    a machine takes some seconds to make: it compiles, and what it compiled is kept.

    Args:
        arm: A calibrated arm, or one that is measured in its base.
        rates: How fast what drifts, one standard deviation of a random walk per square root of a second where readings
            have a time, else per square root of a reading; by the beginning of parameters' labels ('compliance A4'), in
            their units. What is not named does not drift.
        sigma: What the arm does that no parameter explains [m], one standard deviation, beside that of every reading: 0
            where the calibration came down to the noise.

    Raises:
        InputError: It is not known where the instrument stands, or nothing may move; a rate or sigma is no number of
            its kind, or absurd.
        UnknownNameError: A rate is for no parameter.
    """

    @checked_kinds
    def __init__(self, arm: Arm, rates: Mapping[str, float] | None = None, sigma: float = 0.0) -> None:
        self._arm, self._model, self._sigma = arm, model_of(arm), number(sigma, "sigma")
        if self._sigma:
            sensible(self._sigma, "sigma")
        rates = {} if rates is None else rates
        self._variance = _variances(rates, self._model)
        self._rates = {name: float(rate) for name, rate in rates.items()}
        self._derived = tuple({name: None for effect in arm.effects for name in effect.derived})
        self._drifting = np.flatnonzero(self._variance)
        estimate = estimate_of(self._model.known)
        start = Anchor(estimate, 0, 0.0)
        self._state = TrackerState(estimate, self._model.point, Watch(start, start))
        self._sight = self._sight_at(self._state.point)

    @property
    def labels(self) -> tuple[str, ...]:
        """Block and parameter of each, as calibration names them."""
        return tuple(parameter.label for parameter in self._model.parameters)

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of what can be announced to have changed."""
        return tuple(changeable.group.name for changeable in self._model.changeables)

    @property
    def values(self) -> Array:
        """(P,) deviations from the first arm in the parameters' units; values of learned laws as they are."""
        return self._model.at(self._state.point, self._state.estimate.values)

    @property
    def covariance(self) -> Array:
        """(P, P) covariance in the parameters' units, drift up to now included."""
        state, model = self._state, self._model
        factor, drifted = model.factor(state.estimate.values), self._variance * (state.clock - state.drifted)
        return state.estimate.covariance / np.outer(factor, factor) + np.diag(drifted)

    @property
    def std(self) -> Array:
        """(P,) standard deviations in the parameters' units."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def readings(self) -> int:
        """How many readings were taken in."""
        return self._state.count

    @property
    def outliers(self) -> int:
        """How many of them counted less than in full."""
        return self._state.outliers

    @property
    def changes(self) -> tuple[Change, ...]:
        """What was announced, the last hundred, the latest last."""
        return tuple(self._state.changes)

    @property
    def arm(self) -> Arm:
        """The arm as it is known now, with its certainty: for `compensate`, `deflection`, or another tracker."""
        return self._model.arm(self.values, self.covariance)

    @property
    def stale(self) -> bool:
        """Whether the estimate is so far from where the arm was linearised that `relinearise` is worth its time."""
        if self._state.watch.unsettled and self._state.watch.part == 1.0:
            return False
        return bool((np.abs(self._state.estimate.values) > self._model.rigid).any())

    def update(self, reading: Reading) -> Step:
        """Take in a reading.

        Raises:
            InputError, UnknownNameError, MissingCovariateError, ConvergenceError, UnstableEquilibriumError: The reading
                cannot be used, see `LinearisedView`, or its time runs backwards; the tracker is as it was before.
        """
        if not isinstance(reading, Reading):
            raise InputError(f"expected a Reading, got {reading!r}")
        reading, moved = self._directed(reading)
        seen, clock, state = self._sight(reading), self._clock_at(reading), self._state
        if moved is not None:
            state.q, state.approach = moved
        if reading.session != state.session:  # its frame is uncertain, readings before it say nothing of its changes
            state.session = reading.session
            if self._model.restationed.any():
                state.estimate = widen(state.estimate, self._model.restationed)
            state.watch.restart(state.now)
        state.clock, state.timed = clock, reading.time is not None
        state.time = None if reading.time is None else float(reading.time)
        self._drift()
        watch = state.watch
        if watch.turning:
            watch.turn(state.now)
        before, state.count = state.estimate, state.count + 1
        state.estimate, weight, distance = take(before, seen)
        state.outliers += weight < 1.0
        try:
            if watch.unsettled:
                watch.add_unsettled(reading, seen, weight, expected_variance(before, seen))
                # The window's readings are judged again, each by all others.
                base = self._before
                lost, part = contradicted(watch.window, base)
                if min(part, watch.part) < 1.0 or lost != [weight == 0.0 for weight in watch.weights]:
                    self._take_again(base, lost, part)
                return Step(watch.weights[-1], distance, None)
            suspicious = watch.add(seen, weight, distance)
            return Step(weight, distance, self._look() if suspicious else None)
        except np.linalg.LinAlgError as error:
            text = f"what is known and the last readings differ too much in size ({error}): begin a new tracker"
            raise InputError(text) from None

    def relinearise(self) -> None:
        """Linearise the arm about the present estimate: some milliseconds, not for a tick of a controller.

        Raises:
            ConvergenceError, UnstableEquilibriumError: The arm would not stay there; the tracker is as it was before.
        """
        state, model, step = self._state, self._model, self._state.estimate.values
        factor, point = model.factor(step), model.at(state.point, step)
        sight = self._sight_at(point)
        anew = [sight(reading) for reading in state.watch.readings]
        state.point, self._sight = point, sight
        state.estimate = recentred(state.estimate, step, factor)
        state.watch.recentre(step, factor)
        if anew:
            state.watch.window = anew
            self._take_again(self._before, *contradicted(anew, self._before))

    @checked_kinds
    def save(self, path: str | Path) -> Path:
        """Write all that is known to a file, whole or not at all; return its path."""
        about = {"arm": digest(self._arm), "rates": self._rates, "sigma": self._sigma}
        return write_state(self._state, about, Path(path))

    @classmethod
    @checked_kinds
    def restore(cls, path: str | Path, arm: Arm) -> Tracker:
        """Return a tracker that goes on where it was saved, to the last bit; `arm` is the one that it began with.

        Raises:
            ModelFileError: Missing, damaged, no tracker's state, or that of another arm.
        """
        try:
            state, about = read_state(Path(path), arm)
            tracker = cls(arm, about["rates"], about["sigma"])
            if len(state.point) != len(tracker.labels):
                raise InputError(f"{len(state.point)} parameters, expected the arm's {len(tracker.labels)}")
            tracker._state = state
            tracker._sight = tracker._sight_at(state.point)
            if state.q is not None:
                arm.check_position(state.q)
            for reading in state.watch.readings:
                arm.payload(reading.payload)
                as_row(reading, arm)
            tracker._check_numbers()
        except ModelFileError:
            raise
        except ArmflexError as error:
            raise ModelFileError(Place(Path(path)), f"does not hold {LAYOUT.what} of this arm: {error}") from None
        return tracker

    def _check_numbers(self) -> None:
        """Raise `InputError` where a state's numbers differ so much in size that rounding leaves nothing of them."""
        state, watch = self._state, self._state.watch
        try:
            for before in (self._before, watch.first.estimate, watch.later.estimate, state.estimate):
                through_root = [float(np.abs(seen.jacobian @ before.root).max()) for seen in watch.window]
                # What is not known of a reading, in its standard deviations, at most: a kilometre where it is read to a
                # nanometre
                if max(through_root, default=0.0) > 1e12:
                    raise InputError("a reading says less of the parameters than rounding leaves")
                if watch.window:
                    contradicted(watch.window, before)
        except np.linalg.LinAlgError as error:
            raise InputError(f"its window cannot be judged again: {error}") from None
        if not np.isfinite(self.covariance).all():
            raise InputError("its covariance is not finite")

    def _sight_at(self, point: Array) -> LinearisedView:
        model = self._model
        return LinearisedView(model.setup(point), model.blocks, model.aside.unexplained, self._sigma)

    def _directed(self, reading: Reading) -> tuple[Reading, tuple[list[float], list[float]] | None]:
        """Return a reading with the directions that follow from the readings before, and the motion.

        What a reading gives itself counts; where none before says a direction, it stays open.
        """
        if not self._derived:
            return reading, None
        q, state, names = self._arm.check_position(reading.q)[0], self._state, self._arm.joint_names
        moved = last_motion(np.array([q if state.q is None else state.q, q]))[1]
        approach = np.where(moved == 0.0, np.zeros(len(q)) if state.approach is None else state.approach, moved)
        sides = {f"{APPROACH}{name}": side for name, side in zip(names, approach.tolist(), strict=True) if side}
        remembered = {name: sides[name] for name in self._derived if name in sides}
        return replace(reading, covariates={**remembered, **reading.covariates}), (q.tolist(), approach.tolist())

    def _clock_at(self, reading: Reading) -> float:
        """Return the time that drift depends on, at a reading."""
        state, timed = self._state, reading.time is not None
        if state.timed is not None and timed != state.timed:
            raise InputError("time: given for some readings and not for others")
        if not timed:
            return state.clock + 1.0
        time = number(reading.time, "time")
        if not isfinite(time):
            raise InputError(f"time: expected a finite number of seconds, got {time:g}")
        if state.time is not None and time < state.time:
            raise InputError(f"time: {time:.12g} s after {state.time:.12g} s, expected readings in order")
        return state.clock + (time - state.time if state.time is not None else 0.0)

    def _drift(self) -> None:
        """Add what has drifted, where it is time."""
        state = self._state
        state.waiting += 1
        passed = state.clock - state.drifted
        if not len(self._drifting) or (state.waiting < EVERY and passed < state.patience):
            return
        rate = self._rate(state.estimate)
        state.estimate = widen(state.estimate, rate * passed)
        root, state.drifted, state.waiting = state.estimate.root[self._drifting], state.clock, 0
        state.patience = PATIENCE * float(((root**2).sum(axis=1) / rate[self._drifting]).min())

    def _rate(self, estimate: Estimate) -> Array:
        """Return (P,) variances that steps gain per unit of time; those of logarithms are of the factor."""
        return self._variance * self._model.factor(estimate.values) ** 2

    @property
    def _before(self) -> Estimate:
        """The estimate from before the window, with what has drifted since."""
        first = self._state.watch.first
        elapsed = self._state.clock - first.drifted
        return widen(first.estimate, self._rate(first.estimate) * elapsed) if len(self._drifting) else first.estimate

    def _take_again(self, base: Estimate, lost: Sequence[bool], part: float) -> None:
        """Let a part of the window's readings count, but for the lost ones, from the estimate before all of them."""
        state, watch, weights = self._state, self._state.watch, []
        for place, (seen, gone) in enumerate(zip(watch.window, lost, strict=True)):
            if place == WINDOW:
                watch.later = Anchor(base, watch.first.count + place, state.clock)
            base, weight, _ = (base, 0.0, 0.0) if gone else take(base, fainter(seen, part))
            weights.append(weight * part**2)
        state.estimate, state.drifted = base, state.clock
        state.outliers += sum(weight < 1.0 for weight in weights) - sum(weight < 1.0 for weight in watch.weights)
        watch.weights, watch.part = weights, part

    def _look(self) -> Change | None:
        """Look for a change; where there is one, take the window's readings again with what changed open from there."""
        state, watch, base, model = self._state, self._state.watch, self._before, self._model
        factor = model.factor(state.estimate.values)
        in_steps = [
            replace(changeable, sizes=changeable.sizes * factor[changeable.places]) for changeable in model.changeables
        ]
        step = seek(watch, base, in_steps)
        if step is None:
            return None
        places, (jump, opened) = step.what.places, np.zeros((2, len(factor)))
        jump[places], opened[places] = step.size, step.what.sizes**2
        size = (model.at(state.point, base.values + jump) - model.at(state.point, base.values))[places]
        state.estimate, state.drifted, since = base, state.clock, watch.first.count + step.start + 1
        for place, (seen, gone) in enumerate(zip(watch.window, step.lost, strict=True)):
            if place == step.start:
                state.estimate = widen(state.estimate, opened)
            if not gone:
                state.estimate = take(state.estimate, seen)[0]
        watch.restart(state.now)
        parameters = tuple(model.parameters[i] for i in places)
        std, others = step.std / factor[places], step.others
        change = Change(parameters, step.probability, state.count, since, size, std, others)
        state.changes = [*state.changes, change][-100:]  # changes that are remembered
        return change


def _variances(rates: Mapping[str, float], model: StateSpace) -> Array:
    """Return (P,) variances per unit of time; the longest name that fits a label counts."""
    labels = [parameter.label for parameter in model.parameters]
    if not isinstance(rates, Mapping) or not all(isinstance(name, str) for name in rates):
        raise InputError(f"rates: expected a mapping such as {{{labels[0]!r}: 1e-3}}, got {rates!r}")
    variance, most = np.zeros(len(labels)), np.zeros(len(labels))
    for changeable in model.changeables:
        most[changeable.places] = FASTEST * changeable.sizes
    for name in sorted(rates, key=len):
        rated = [label == name or label.startswith(f"{name} ") for label in labels]
        if not any(rated):
            raise UnknownNameError("parameter", name, labels)
        rate, limit = number(rates[name], f"rate of {name!r}"), float(most[rated].max())
        if not 0.0 <= rate <= limit:
            expected = f"{limit:.3g}, {FASTEST} times the size of a change of it"
            raise InputError(f"rate of {name!r}: expected a number from 0 to {expected}, got {rate:g}")
        variance[rated] = rate**2
    return variance
