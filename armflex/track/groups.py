"""Which parameters change together: the laws of the arm, one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.estimate.blocks import Block
from armflex.parameters import COMPLIANCE, INSTRUMENT, LAW, MOUNTING

OFFSET, GEOMETRY, TOOL = "joint_offset", "geometry", "tool"

SIZES = {COMPLIANCE: 0.2, OFFSET: 1e-3, GEOMETRY: 1e-4, TOOL: 1e-3, MOUNTING: 1e-3}
"""Expected size of a change where [prior] declares none."""

BUMPED = np.repeat([1e-3, 1e-4], 3)
"""Expected shift [m] and turn [rad] of an instrument that was touched."""


@dataclass(frozen=True, eq=False)
class Group:
    """A law of the arm, or another thing that may change as a whole.

    Attributes:
        name: Such as 'compliance A4', 'law A2', 'joint_offset A3', 'tool', 'instrument'.
        places: (k,) of its parameters among all.
        sizes: (k,) standard deviation of a change that is worth announcing.
    """

    name: str
    places: np.ndarray
    sizes: Array

    def in_steps(self, factor: Array) -> Group:
        """Return the group with sizes of steps, by (P,) how much larger those are; see `Model.factor`."""
        return replace(self, sizes=self.sizes * factor[self.places])


def groups_of(blocks: Sequence[Block], arm: Arm) -> tuple[Group, ...]:
    """Return the groups of all parameters, in the order of the blocks."""
    names = [_name(block, label) for block in blocks for label in block.labels]
    sizes = np.concatenate([_sizes(block, arm) for block in blocks])
    numbered = {name: np.flatnonzero([other == name for other in names]) for name in dict.fromkeys(names)}
    return tuple(Group(name, places, sizes[places]) for name, places in numbered.items())


def _name(block: Block, label: str) -> str:
    part = label if block.name == OFFSET else label.rpartition(" ")[0]
    return f"{block.name} {part}" if part else block.name


def _sizes(block: Block, arm: Arm) -> Array:
    if block.name == INSTRUMENT:
        return BUMPED
    if block.name == LAW:
        return block.prior
    prior = arm.prior
    declared = {COMPLIANCE: prior.compliance, OFFSET: prior.joint_offset, GEOMETRY: prior.geometry, TOOL: prior.tool}
    return np.full(len(block.labels), declared.get(block.name) or SIZES[block.name])
