"""What a tracker tracks: an arm's fitted parameters as blocks, and where their estimate starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Arm
from armflex.certainty import Certainty
from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import InputError
from armflex.estimate.blocks import Block, declared_blocks
from armflex.estimate.fit import realise
from armflex.estimate.law_block import LawBlock, with_laws
from armflex.estimate.spread import OTHER_PARAMETERS, blocks_of, labels_of
from armflex.parameters import EFFECT, INSTRUMENT, SESSIONS
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
        return labels_of(self.blocks)

    @cached_property
    def straight(self) -> Array:
        """(P,) step of each from which on the arm should be linearised again."""
        return np.concatenate([_straight(block) for block in self.blocks])

    @cached_property
    def logarithmic(self) -> np.ndarray:
        """(P,) whether a value is the logarithm of a factor: steps are of the factor, which the arm's sag follows."""
        return np.array([block.logarithmic for block in self.blocks for _ in block.labels], dtype=bool)

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
        setup, start, laws, known = self.setup(values), 0, {}, self._known(covariance)
        fitted = {flexure.name: flexure.law for flexure in setup.arm.flexures}
        for block in self.blocks:
            if isinstance(block, LawBlock):
                places = block.split(np.arange(start, start + len(block.labels)))
                for name, own in zip(block.flexures, places, strict=True):
                    laws[name] = replace(fitted[name], spread=known.covariance[np.ix_(own, own)])
            start += len(block.labels)
        certainty = _beside(known, self.aside)
        return replace(with_laws(setup.arm, laws), instrument=setup.instrument, certainty=certainty)

    def _known(self, covariance: Array) -> Certainty:
        """Return what (P, P) tells, apart from the directions of which no reading told anything."""
        along = np.linalg.pinv(self.wide.T)
        left, turn = np.linalg.eigh(along @ covariance @ along.T)
        unknown = (turn.T @ self.wide)[left > UNTOLD]
        if not len(unknown):
            return Certainty(self.labels, covariance)
        others = np.eye(len(covariance)) - unknown.T @ np.linalg.pinv(unknown.T)
        return Certainty(self.labels, others @ covariance @ others.T, directions=unknown)


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
    if restationing.any() and not any(label.startswith(f"{INSTRUMENT} ") for label in kept.labels):
        frame = Certainty(tuple(f"{INSTRUMENT} {axis}" for axis in TWIST_NAMES), np.zeros((6, 6)))
        kept = _beside(frame, kept)
    blocks = blocks_of(kept.labels, setup, ())
    if blocks is None or labels_of(blocks) != kept.labels:
        raise InputError(OTHER_PARAMETERS.text)
    starts = [block.start if isinstance(block, LawBlock) else np.zeros(len(block.labels)) for block in blocks]
    if not starts:
        raise InputError("nothing may move: the arm was not calibrated, and [prior] frees nothing")
    of_frame = [block.name == INSTRUMENT for block in blocks]
    added = [restationing if own else np.zeros(len(block.labels)) for block, own in zip(blocks, of_frame, strict=True)]
    wide = _wide(kept, groups_of(blocks, arm))
    known = kept.covariance + wide.T @ wide
    return Model(setup, tuple(blocks), np.concatenate(starts), known, np.concatenate(added), aside, wide)


def _wide(certainty: Certainty, groups: Sequence[Group]) -> Array:
    """Return the (k, P) undetermined directions, as long as nobody would expect."""
    sizes = np.ones(len(certainty.labels))
    for group in groups:
        sizes[group.places] = group.sizes
    none = np.zeros((0, len(sizes)))
    directions = none if certainty.directions is None else certainty.directions
    return directions * (WIDE / np.abs(directions / sizes).max(axis=1, keepdims=True, initial=0.0))


def _straight(block: Block) -> Array:
    """Return the (k,) steps of a block's parameters over which readings change as they do at first."""
    if block.name == INSTRUMENT:
        return np.repeat([np.inf, TURNED], 3)
    return np.full(len(block.labels), CURVED if block.logarithmic or isinstance(block, LawBlock) else np.inf)


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
    return Certainty(labels_of(blocks), np.diag(np.concatenate([np.zeros(0), *(one.prior for one in blocks)]) ** 2))


def _split(certainty: Certainty) -> tuple[Certainty, Certainty]:
    """Return what is tracked, without the frames of sessions that are over, and what is not: effects."""
    kinds = [label.split(" ", 1)[0] for label in certainty.labels]
    kept = [i for i, kind in enumerate(kinds) if kind not in (EFFECT, SESSIONS)]
    aside = [i for i, kind in enumerate(kinds) if kind == EFFECT]
    parts = [_part(certainty, places) for places in (kept, aside)]
    return parts[0], replace(parts[1], unexplained=certainty.unexplained)


def _part(certainty: Certainty, places: Sequence[int]) -> Certainty:
    """Return what is known of some of the parameters."""
    labels, covariance = tuple(certainty.labels[i] for i in places), certainty.covariance[np.ix_(places, places)]
    if certainty.directions is None:
        return Certainty(labels, covariance)
    directions = certainty.directions[:, places]
    directions = directions[directions.any(axis=1)]
    return Certainty(labels, covariance, directions=directions if len(directions) else None)


def _beside(one: Certainty, other: Certainty) -> Certainty:
    """Return both, as independent."""
    count, size = len(one.labels), len(one.labels) + len(other.labels)
    covariance = np.zeros((size, size))
    covariance[:count, :count], covariance[count:, count:] = one.covariance, other.covariance
    padded = [
        np.pad(part.directions, ((0, 0), beside))
        for part, beside in ((one, (0, size - count)), (other, (count, 0)))
        if part.directions is not None
    ]
    directions = np.vstack(padded) if padded else None
    return Certainty((*one.labels, *other.labels), covariance, other.unexplained, directions)
