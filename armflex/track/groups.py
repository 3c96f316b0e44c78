"""Which parameters change together: the laws of the arm, one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.estimate.block import Block, parameters_of
from armflex.parameters import Kind

SIZES = {Kind.COMPLIANCE: 0.2, Kind.OFFSET: 1e-3, Kind.GEOMETRY: 1e-4, Kind.TOOL: 1e-3, Kind.MOUNTING: 1e-3}
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
    groups = [parameter.group for parameter in parameters_of(blocks)]
    sizes = np.concatenate([_sizes(block, arm) for block in blocks])
    places = {group: np.flatnonzero([other == group for other in groups]) for group in dict.fromkeys(groups)}
    return tuple(Group(group.name, own, sizes[own]) for group, own in places.items())


def _sizes(block: Block, arm: Arm) -> Array:
    if block.kind is Kind.INSTRUMENT:
        return BUMPED
    if block.kind is Kind.LAW:
        return block.prior
    return np.full(len(block.parameters), getattr(arm.prior, block.kind, 0.0) or SIZES[block.kind])
