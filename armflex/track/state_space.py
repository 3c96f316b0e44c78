"""What a tracker tracks: an arm's fitted parameters as blocks, where they start, and what a reading says of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Arm, Setup
from armflex.conventions import Array
from armflex.errors import InputError
from armflex.estimate.block import Block, learned_laws, parameters_of, with_laws
from armflex.estimate.blocks import blocks_of, declared_blocks, sensor_block
from armflex.estimate.fit import realise
from armflex.estimate.posterior import OTHER_PARAMETERS
from armflex.estimate.view import look, unclear_shifts
from armflex.laws.effects.in_arm import derived_directions
from armflex.parameters import FRAME, OF_SESSION, TARGET, ArmParameter, Certainty, ParameterGroup, ParameterKind, of_law
from armflex.readings.instrument import Instrument
from armflex.track.estimate import LinearisedReading
from armflex.track.reading import Reading, as_row

SIZES = {
    ParameterKind.COMPLIANCE: 0.2,
    ParameterKind.MASS: 0.05,
    ParameterKind.SPRING: 0.02,
    ParameterKind.OFFSET: 1e-3,
    ParameterKind.GEOMETRY: 1e-4,
    ParameterKind.TOOL: 1e-3,
    ParameterKind.MOUNTING: 1e-3,
}
"""Expected size of a change where [prior] declares none."""

BUMPED = np.repeat([1e-3, 1e-4], 3)
"""Expected shift [m] and turn [rad] of an instrument that was touched."""

LEAST = 0.1
"""A compliance may become this part of what it was in one step."""

CURVED, TURNED = 0.1, 2e-3
"""Change of a compliance, and turn of the instrument [rad], beyond which the arm should be linearised again."""

WIDE = 1e4
"""Standard deviation along a direction of which nothing is known, by the size of a change: metres, and a radian."""


@dataclass(frozen=True, eq=False)
class Changeable:
    """What may change as a whole: a law of the arm, or another group of parameters.

    Attributes:
        group: Which.
        places: (k,) of its parameters among all.
        sizes: (k,) standard deviation of a change that is worth announcing.
    """

    group: ParameterGroup
    places: np.ndarray
    sizes: Array


@dataclass(frozen=True, eq=False)
class StateSpace:
    """Parameters of an arm, and what they mean.

    Attributes:
        declared: Arm and instrument where all values are as they start; no session has a frame of its own.
        blocks: Of parameters.
        point: (P,) their values at the start.
        known: (P, P) their covariance then.
        restationed: (P,) variances that a new session adds.
        aside: What is known of what is not tracked: the arm's effects, and a twist without a cause.
        wide: (k, P) directions of which nothing is known, each as long as it is uncertain in `known`.
    """

    declared: Setup
    blocks: tuple[Block, ...]
    point: Array
    known: Array
    restationed: Array
    aside: Certainty
    wide: Array

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """All of them, in the order of the blocks."""
        return parameters_of(self.blocks)

    @cached_property
    def changeables(self) -> tuple[Changeable, ...]:
        """What may change as a whole."""
        return changeables_of(self.blocks, self.declared.arm)

    @cached_property
    def rigid(self) -> Array:
        """(P,) step of each from which on the arm should be linearised again: readings change as they do at first."""
        steps = [
            np.repeat([np.inf, TURNED], 3)
            if block.kind is ParameterKind.INSTRUMENT
            else np.full(len(block.parameters), CURVED if block.curved else np.inf)
            for block in self.blocks
        ]
        return np.concatenate(steps)

    @cached_property
    def logarithmic(self) -> np.ndarray:
        """(P,) whether a value is the logarithm of a factor: steps are of the factor, which the arm's sag follows."""
        return np.array([block.logarithmic for block in self.blocks for _ in block.parameters], dtype=bool)

    def at(self, point: Array, step: Array) -> Array:
        """Return the (P,) values a step away from a point."""
        return point + np.where(self.logarithmic, np.log(self.factor(step)), step)

    def factor(self, step: Array) -> Array:
        """Return (P,) by how much a unit of a value is a larger step there than where steps begin."""
        return np.where(self.logarithmic, np.maximum(1.0 + step, LEAST), 1.0)

    def setup(self, values: Array) -> Setup:
        """Return arm and instrument at (P,) values."""
        return realise(self.declared, self.blocks, values)

    def arm(self, values: Array, covariance: Array) -> Arm:
        """Return the arm at (P,) values with their covariance, open where no reading informed on them."""
        along = np.linalg.pinv(self.wide.T)
        left, turn = np.linalg.eigh(along @ covariance @ along.T)
        # Part of such a direction's variance that is left where no reading has informed on it.
        unknown = (turn.T @ self.wide)[left > 0.25]
        certainty = Certainty(self.parameters, covariance)
        if len(unknown):
            others = np.eye(len(covariance)) - unknown.T @ np.linalg.pinv(unknown.T)
            certainty = Certainty(self.parameters, others @ covariance @ others.T, directions=unknown)
        setup, laws = self.setup(values), {}
        for name, law in learned_laws(setup.arm).items():
            posterior = certainty.among(of_law(name, law))
            if posterior is not None:
                laws[name] = replace(law, posterior=posterior)
        return replace(with_laws(setup.arm, laws), instrument=setup.instrument, certainty=certainty.beside(self.aside))


def changeables_of(blocks: Sequence[Block], arm: Arm) -> tuple[Changeable, ...]:
    """Return what may change as a whole of all parameters, in the order of the blocks."""
    groups, sizes = [parameter.group for parameter in parameters_of(blocks)], []
    for block in blocks:
        if block.kind is ParameterKind.INSTRUMENT:
            sizes.append(BUMPED)
        elif block.kind in (ParameterKind.LAW, ParameterKind.SENSOR):
            sizes.append(block.prior)
        else:
            sizes.append(np.full(len(block.parameters), getattr(arm.prior, block.kind, 0.0) or SIZES[block.kind]))
    size = np.concatenate(sizes)
    places = {group: np.flatnonzero([other == group for other in groups]) for group in dict.fromkeys(groups)}
    return tuple(Changeable(group, place, size[place]) for group, place in places.items())


def _check_calibrated(arm: Arm) -> None:
    """Raise where an arm lacks what a tracker needs of a calibration, or has what it cannot follow."""
    learned = [flexure.name for flexure in arm.flexures if flexure.learn is not None and arm.certainty is None]
    turned = arm.instrument and any(motion[3:].any() for motion in arm.instrument.targets.values())
    for holds, text in (
        (arm.instrument is None and arm.measurement.frame != "base",
         "the place of the instrument is not known: calibrate the arm before it is tracked"),
        (turned, "sessions turned the target on the tool anew, which a tracker cannot follow: leave rx ry rz out"),
        (arm.certainty is None and arm.instrument is not None,
         "the arm's file holds no covariance of what was fitted: calibrate it again"),
        (learned, f"flexure {[*learned, ''][0]!r} is to be learned: calibrate the arm before it is tracked"),
    ):  # fmt: skip
        if holds:
            raise InputError(text)


def model_of(arm: Arm) -> StateSpace:
    """Return what is tracked of an arm.

    Of a calibrated arm that is what was fitted, without the frames of sessions that are over and without effects, else
    what [prior] frees.

    Raises:
        InputError: See `Tracker`.
    """
    _check_calibrated(arm)
    setup = Setup(arm, replace(arm.instrument or Instrument(), sessions={}, targets={}))
    aside = Certainty((), np.zeros((0, 0)))
    # What was found of sensors in sessions that are over says nothing of how they stand now.
    ended = any(sensor.found and "" not in sensor.found for sensor in arm.sensors.values())
    gone = (ParameterKind.SENSOR,) if ended else ()
    if ended:
        sensors = {name: replace(sensor, found={}) for name, sensor in arm.sensors.items()}
        arm = replace(arm, sensors=sensors)
        setup = replace(setup, arm=arm)
    if arm.certainty is not None:
        certainty = replace(arm.certainty, misfit=0.0)
        kinds = [parameter.group.kind for parameter in certainty.parameters]
        others = (ParameterKind.EFFECT, *OF_SESSION, *gone)
        kept = certainty.part([i for i, kind in enumerate(kinds) if kind not in others])
        aside = certainty.part([i for i, kind in enumerate(kinds) if kind is ParameterKind.EFFECT])
    else:
        middle = np.clip(np.zeros(len(arm.joint_names)), arm.robot.lower, arm.robot.upper)
        every = {name: np.zeros(sensor.unread(1).dimension) for name, sensor in arm.sensors.items()}
        alone = Setup(replace(arm, prior=replace(arm.prior, session_target=0.0)), setup.instrument)
        free = declared_blocks(alone, as_row(Reading(middle, np.zeros(3), 1.0, sensors=every), arm))
        prior = np.concatenate([np.zeros(0), *(block.prior for block in free)])
        kept = Certainty(parameters_of(free), np.diag(prior**2))
    restationing = np.repeat([arm.prior.session_translation, arm.prior.session_rotation], 3) ** 2
    if restationing.any() and FRAME[0].group not in kept.groups:
        kept = Certainty(FRAME, np.zeros((6, 6))).beside(kept)
    if arm.prior.session_target and TARGET[0].group not in kept.groups:
        kept = kept.beside(Certainty(TARGET, np.zeros((3, 3))))
    for name in arm.sensors if ended else ():
        fresh = sensor_block(setup, name, ("",))
        kept = kept.beside(Certainty(fresh.parameters, np.diag(fresh.prior**2)))
    blocks = blocks_of(kept.parameters, setup)
    if blocks is None:
        raise InputError(OTHER_PARAMETERS.text)
    if not blocks:
        raise InputError("nothing may move: the arm was not calibrated, and [prior] frees nothing")
    anew = {ParameterKind.INSTRUMENT: restationing, ParameterKind.TOOL: np.full(3, arm.prior.session_target**2)}
    added = [
        block.prior**2 if block.kind is ParameterKind.SENSOR else anew.get(block.kind, np.zeros(len(block.parameters)))
        for block in blocks
    ]
    sizes = np.ones(len(kept.parameters))
    for changeable in changeables_of(blocks, arm):
        sizes[changeable.places] = changeable.sizes
    wide = np.zeros((0, len(sizes))) if kept.directions is None else kept.directions
    wide = wide * (WIDE / np.abs(wide / sizes).max(axis=1, keepdims=True, initial=0.0))
    point = np.concatenate([block.start for block in blocks])
    return StateSpace(setup, tuple(blocks), point, kept.covariance + wide.T @ wide, np.concatenate(added), aside, wide)


@dataclass(frozen=True)
class LinearisedView:
    """How readings are seen at the point where the arm is linearised: a calibration's view of one row.

    Attributes:
        setup: Arm and instrument.
        blocks: What is tracked.
        unexplained: Twists without a cause: site, axis and size of each.
        beside: Standard deviation of the position beside the reading's own [m].
    """

    setup: Setup
    blocks: Sequence[Block]
    unexplained: tuple[tuple[str, str, float], ...] = ()
    beside: float = 0.0

    def __call__(self, reading: Reading) -> LinearisedReading:
        """Return a reading in standard deviations.

        Raises:
            InputError: q, the position or a standard deviation is no number of its kind; see `Arm.check_position`.
            UnknownNameError, MissingCovariateError: No such payload; an effect depends on what is not given.
            ConvergenceError, UnstableEquilibriumError: See `find_equilibrium`.
        """
        row = as_row(reading, self.setup.arm)
        derived_directions(self.setup.arm, row, np.arange(1))
        view = look(self.setup, row)
        jacobian = np.concatenate([block.jacobian(view) for block in self.blocks], axis=2)[0]
        noise = np.diag(view.sigma[0] ** 2)
        np.einsum("dd->d", noise)[view.foremost] += self.beside**2
        unknown = [unclear_shifts(self.setup, row, row.readings), view.at_random(self.unexplained)]
        shifts = np.concatenate(unknown)[:, 0]
        noise += shifts.T @ shifts
        factor = np.linalg.cholesky(noise)
        whitened = np.ascontiguousarray(np.linalg.solve(factor, jacobian))
        return LinearisedReading(np.linalg.solve(factor, view.residual[0]), whitened)
