"""A composed joint learned about a declared one: the logarithm of a factor for every axis of every linear sub-joint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.laws.joint.linear import LinearLaw
from armflex.laws.joint.scaled import scaled
from armflex.laws.joint.structural import StructuralLaw
from armflex.laws.law import Law, Row
from armflex.laws.learned.compliance_part import LOOSE
from armflex.laws.learned.part import Group


@dataclass(frozen=True, eq=False)
class StructuralPart:
    """A structure whose sub-joints' compliances C are S C S, S = exp(values / 2).

    Attributes:
        declared: The structure; sub-joints of other than linear laws stay as they are.
    """

    declared: StructuralLaw

    @property
    def groups(self) -> tuple[Group, ...]:
        """One per sub-joint, as uncertain as it was declared."""
        groups = []
        for number, axes in self._free:
            sub = self.declared.subjoints[number]
            labels = tuple(f"{number + 1}@{sub.node}:{TWIST_NAMES[axis]}" for axis in axes)
            groups.append(Group(f"sub-joint {number + 1}", labels, sub.law.relative_std or LOOSE, False))
        return tuple(groups)

    @property
    def start(self) -> Array:
        """Zero: the declared structure."""
        return np.zeros(sum(len(axes) for _, axes in self._free))

    def twist(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return the twist of the structure at the values."""
        return self._at(values).twist(wrench, row)

    def tangent(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return its derivative by the wrench."""
        return np.broadcast_to(self._at(values).tangent(wrench, row), (*wrench.shape[:-1], 6, 6))

    def by_values(self, values: Array, wrench: Array, row: Row) -> Array:
        """Return its derivative by the values."""
        structure, flat = self._at(values), wrench.reshape(-1, 6)
        rows = row.spread(len(flat))
        each = [self._one(structure, load, rows.some(i)) for i, load in enumerate(flat)]
        return np.array(each).reshape(*wrench.shape[:-1], 6, -1)

    def law(self, values: Array) -> Law | None:
        """Return the structure."""
        return self._at(values)

    def _one(self, structure: StructuralLaw, wrench: Array, row: Row) -> Array:
        """Return the (6, k) derivative at one load: what a sub-joint gives more, seen from the tip node."""
        answers = structure.shares(wrench, row)
        columns = []
        for number, axes in self._free:
            compliance, (gain, load) = structure.subjoints[number].law.compliance, answers[number]
            for axis in axes:
                unit = np.eye(6)[axis]
                change = 0.5 * (unit * (compliance @ load) + compliance @ (unit * load))
                columns.append(gain @ change)
        return np.array(columns).T

    def _at(self, values: Array) -> StructuralLaw:
        key = values.tobytes()
        made = self._known.get(key)
        if made is None:
            made = self._made(values)
            self._known.clear()
            self._known[key] = made
        return made

    def _made(self, values: Array) -> StructuralLaw:
        left, subjoints = iter(values), list(self.declared.subjoints)
        for number, axes in self._free:
            factor = np.ones(6)
            factor[list(axes)] = [np.exp(0.5 * next(left)) for _ in axes]
            subjoints[number] = replace(subjoints[number], law=scaled(subjoints[number].law, factor))
        return replace(self.declared, subjoints=tuple(subjoints))

    @cached_property
    def _known(self) -> dict[bytes, StructuralLaw]:
        """The structure at the last values: it is asked for many loads at each."""
        return {}

    @cached_property
    def _free(self) -> list[tuple[int, tuple[int, ...]]]:
        """Number and axes of every sub-joint that is learned."""
        found = []
        for number, (sub, (_, own)) in enumerate(zip(self.declared.subjoints, self.declared.held, strict=True)):
            if isinstance(sub.law, LinearLaw):
                found.append((number, tuple(int(axis) for axis in own if sub.law.compliance[axis, axis] > 0.0)))
        return found
