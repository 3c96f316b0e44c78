"""Blocks of parameters that a fit may move: each knows its prior, its columns, and how to apply its values.

Everything declared in [prior] is a block, of the instrument (`instrument_blocks`) or of the arm (`arm_blocks`); an
effect that was added becomes one, too (`effect_block`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armflex.estimate.arm_blocks import ComplianceBlock, GeometryBlock, OffsetBlock
from armflex.estimate.block import Block
from armflex.estimate.instrument_blocks import FrameBlock, MountingBlock, SessionBlock, TargetBlock
from armflex.laws.law import anywhere
from armflex.measured.measurements import Measurements
from armflex.readings import Orientation
from armflex.setup import Setup


def declared_blocks(setup: Setup, measurements: Measurements) -> tuple[Block, ...]:
    """Return the blocks that an arm's [prior] and [measurement] free; `setup` holds the first guess."""
    arm, prior = setup.arm, setup.arm.prior
    blocks: list[Block] = []
    if arm.measurement.frame == "unknown":
        blocks.append(FrameBlock(setup.instrument.pose, arm.measurement.gravity_in == "measurement"))
    sessions = tuple(dict.fromkeys(measurements.session))
    if len(sessions) > 1 and (prior.session_translation or prior.session_rotation):
        blocks.append(SessionBlock(sessions, measurements.session, prior.session_translation, prior.session_rotation))
    if prior.tool:
        blocks.append(TargetBlock(prior.tool))
    if measurements.readings.of(Orientation):
        blocks.append(MountingBlock(setup.instrument.mounting))
    if prior.joint_offset:
        blocks.append(OffsetBlock(arm.robot, prior.joint_offset))
    if prior.geometry:
        blocks.append(GeometryBlock(arm.joint_names, prior.geometry))
    if prior.compliance:
        blocks += _compliance_block(setup, prior.compliance)
    return tuple(blocks)


def _compliance_block(setup: Setup, std: float) -> Sequence[Block]:
    row = anywhere(setup.arm.robot)
    given = {f.name: f.law.freed(row) for f in setup.arm.flexures if f.learn is None}
    free = {name: axes for name, axes in given.items() if axes}
    return [ComplianceBlock(tuple(free), tuple(free.values()), std)] if free else []


def places_of(block: Block, blocks: Sequence[Block]) -> np.ndarray:
    """Return the places of one block's parameters among those of all."""
    start = 0
    for other in blocks:
        if other is block:
            return np.arange(start, start + len(other.parameters))
        start += len(other.parameters)
    raise KeyError(block.name)
