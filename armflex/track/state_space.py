"""What a tracker tracks: an arm's fitted parameters as blocks, and where their estimate starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Arm
from armflex.certainty import Certainty
from armflex.conventions import Array
from armflex.errors import InputError
from armflex.estimate.block import Block, parameters_of
from armflex.estimate.blocks import blocks_of, declared_blocks
from armflex.estimate.fit import realise
from armflex.estimate.law_block import learned_laws, with_laws
from armflex.estimate.spread import OTHER_PARAMETERS
from armflex.parameters import FRAME, Kind, of_law
from armflex.readings.instrument import Instrument
from armflex.setup import Setup
from armflex.track.groups import Group, groups_of
from armflex.track.reading import Reading, as_row

LEAST = 0.1
"""A compliance may become this part of what it was in one step."""

CURVED, TURNED = 0.1, 2e-3
"""Change of a compliance, and turn of the instrument [rad], beyond which the arm should be linearised again."""

WIDE = 1e4
"""Standard deviation along a direction of which nothing is known, by the size of a change: metres, and a radian."""

UNTOLD = 0.25
"""Part of such a direction's variance that is left where no reading has told of it."""


@dataclass(frozen=True, eq=False)
class Model:
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
    def labels(self) -> tuple[str, ...]:
        """Block and parameter of each."""
        return tuple(parameter.label for parameter in parameters_of(self.blocks))

    @cached_property
    def rigid(self) -> Array:
        """(P,) step of each from which on the arm should be linearised again."""
        return np.concatenate([_straight(block) for block in self.blocks])

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

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """What may change as a whole."""
        return groups_of(self.blocks, self.declared.arm)

    def setup(self, values: Array) -> Setup:
        """Return arm and instrument at (P,) values."""
        return realise(self.declared, self.blocks, values)

    def arm(self, values: Array, covariance: Array) -> Arm:
        """Return the arm at (P,) values with their covariance."""
        setup, known = self.setup(values), self._known(covariance)
        learned = learned_laws(setup.arm).items()
        spread = {name: known.among(of_law(name, law)) for name, law in learned}
        laws = {name: replace(law, spread=spread[name]) for name, law in learned if spread[name] is not None}
        certainty = known.beside(self.aside)
        return replace(with_laws(setup.arm, laws), instrument=setup.instrument, certainty=certainty)

    def _known(self, covariance: Array) -> Certainty:
        """Return what (P, P) tells, apart from the directions of which no reading told anything."""
        along = np.linalg.pinv(self.wide.T)
        left, turn = np.linalg.eigh(along @ covariance @ along.T)
        unknown = (turn.T @ self.wide)[left > UNTOLD]
        if not len(unknown):
            return Certainty(parameters_of(self.blocks), covariance)
        others = np.eye(len(covariance)) - unknown.T @ np.linalg.pinv(unknown.T)
        return Certainty(parameters_of(self.blocks), others @ covariance @ others.T, directions=unknown)


def model_of(arm: Arm) -> Model:
    """Return what is tracked of an arm.

    Raises:
        InputError: See `Tracker`.
    """
    if arm.instrument is None and arm.measurement.frame != "base":
        raise InputError("nobody knows where the instrument stands: calibrate the arm before it is tracked")
    setup = Setup(arm, replace(arm.instrument or Instrument(), sessions={}))
    kept, aside = _split(arm.certainty) if arm.certainty else (_declared(setup), Certainty((), np.zeros((0, 0))))
    restationing = np.repeat([arm.prior.session_translation, arm.prior.session_rotation], 3) ** 2
    if restationing.any() and FRAME[0].group not in kept.groups:
        kept = Certainty(FRAME, np.zeros((6, 6))).beside(kept)
    blocks = blocks_of(kept.parameters, setup)
    if blocks is None:
        raise InputError(OTHER_PARAMETERS.text)
    if not blocks:
        raise InputError("nothing may move: the arm was not calibrated, and [prior] frees nothing")
    added = [restationing if block.kind is Kind.INSTRUMENT else np.zeros(len(block.parameters)) for block in blocks]
    wide = _wide(kept, groups_of(blocks, arm))
    known = kept.covariance + wide.T @ wide
    return Model(
        setup,
        tuple(blocks),
        np.concatenate([block.start for block in blocks]),
        known,
        np.concatenate(added),
        aside,
        wide,
    )


def _wide(certainty: Certainty, groups: Sequence[Group]) -> Array:
    """Return the (k, P) undetermined directions, as long as nobody would expect."""
    sizes = np.ones(len(certainty.parameters))
    for group in groups:
        sizes[group.places] = group.sizes
    none = np.zeros((0, len(sizes)))
    directions = none if certainty.directions is None else certainty.directions
    return directions * (WIDE / np.abs(directions / sizes).max(axis=1, keepdims=True, initial=0.0))


def _straight(block: Block) -> Array:
    """Return the (k,) steps of a block's parameters over which readings change as they do at first."""
    if block.kind is Kind.INSTRUMENT:
        return np.repeat([np.inf, TURNED], 3)
    return np.full(len(block.parameters), CURVED if block.curved else np.inf)


def _declared(setup: Setup) -> Certainty:
    """Return what [prior] says of an arm that nobody calibrated."""
    arm = setup.arm
    if arm.instrument is not None:
        raise InputError("the arm's file holds no covariance of what was fitted: calibrate it again")
    learned = [flexure.name for flexure in arm.flexures if flexure.learn is not None]
    if learned:
        raise InputError(f"flexure {learned[0]!r} is to be learned: calibrate the arm before it is tracked")
    middle = np.clip(np.zeros(len(arm.joint_names)), arm.robot.lower, arm.robot.upper)
    blocks = declared_blocks(setup, as_row(Reading(middle, np.zeros(3), 1.0), arm))
    return Certainty(parameters_of(blocks), np.diag(np.concatenate([np.zeros(0), *(one.prior for one in blocks)]) ** 2))


def _split(certainty: Certainty) -> tuple[Certainty, Certainty]:
    """Return what is tracked, without the frames of sessions that are over, and what is not: effects."""
    told = replace(certainty, misfit=0.0)
    kinds = [parameter.group.kind for parameter in told.parameters]
    kept = [i for i, kind in enumerate(kinds) if kind not in (Kind.EFFECT, Kind.SESSION)]
    aside = [i for i, kind in enumerate(kinds) if kind is Kind.EFFECT]
    return told.part(kept), told.part(aside)
