"""What a tracker tracks: an arm's fitted parameters as blocks, and where their estimate starts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.arm import Arm
from armflex.calibrate.blocks import Block, declared_blocks
from armflex.calibrate.fit import realise
from armflex.calibrate.law_block import LawBlock, with_laws
from armflex.calibrate.spread import EFFECT, INSTRUMENT, OTHER_PARAMETERS, SESSIONS, blocks_of, labels_of
from armflex.calibrate.view import Setup
from armflex.certainty import Certainty
from armflex.conventions import TWIST_NAMES, Array
from armflex.errors import InputError
from armflex.measured.instrument import Instrument
from armflex.tracking.groups import Group, groups_of
from armflex.tracking.reading import Reading, as_row

LEAST = 0.1
"""A compliance may become this part of what it was in one step."""


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
    """

    declared: Setup
    blocks: tuple[Block, ...]
    point: Array
    known: Array
    restationed: Array
    aside: Certainty

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Block and parameter of each."""
        return labels_of(self.blocks)

    @cached_property
    def curved(self) -> np.ndarray:
        """(P,) whether a value is a logarithm, or one of a learned law."""
        each = [block.logarithmic or isinstance(block, LawBlock) for block in self.blocks for _ in block.labels]
        return np.array(each, dtype=bool)

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
        setup, start, laws = self.setup(values), 0, {}
        fitted = {flexure.name: flexure.law for flexure in setup.arm.flexures}
        for block in self.blocks:
            if isinstance(block, LawBlock):
                places = block.split(np.arange(start, start + len(block.labels)))
                for name, own in zip(block.flexures, places, strict=True):
                    laws[name] = replace(fitted[name], spread=covariance[np.ix_(own, own)])
            start += len(block.labels)
        known = _beside(Certainty(self.labels, covariance), self.aside)
        return replace(with_laws(setup.arm, laws), instrument=setup.instrument, certainty=known)


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
    return Model(setup, tuple(blocks), np.concatenate(starts), kept.covariance, np.concatenate(added), aside)


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
    parts = [
        Certainty(tuple(certainty.labels[i] for i in places), certainty.covariance[np.ix_(places, places)])
        for places in (kept, aside)
    ]
    return parts[0], replace(parts[1], unexplained=certainty.unexplained)


def _beside(one: Certainty, other: Certainty) -> Certainty:
    """Return both, as independent."""
    count, size = len(one.labels), len(one.labels) + len(other.labels)
    covariance = np.zeros((size, size))
    covariance[:count, :count], covariance[count:, count:] = one.covariance, other.covariance
    return Certainty((*one.labels, *other.labels), covariance, other.unexplained)
