"""Blocks of the arm: its joints' positions, its geometry, and how much its flexures give."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.view import View
from armflex.laws.joint.scaled import scaled
from armflex.parameters import ArmParameter, Kind, of_compliance, of_motions, of_offsets
from armflex.robot import Robot
from armflex.setup import Setup


@dataclass(frozen=True)
class OffsetBlock(Block):
    """A constant error of every joint's position."""

    robot: Robot
    std: float

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """The joints'."""
        return of_offsets(self.robot)

    @property
    def prior(self) -> Array:
        """As declared."""
        return np.full(len(self.parameters), self.std)

    def columns(self, view: View) -> Array:
        """Return the joints' columns, loads redistributing."""
        return view.answer(view.line.joints)

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the joints offset."""
        corrections = setup.arm.corrections
        pairs = zip(self.robot.joint_names, values.tolist(), strict=True)
        offsets = {joint: corrections.joint_offset.get(joint, 0.0) + value for joint, value in pairs}
        return replace(setup, arm=replace(setup.arm, corrections=replace(corrections, joint_offset=offsets)))


@dataclass(frozen=True)
class GeometryBlock(Block):
    """A constant twist of every joint's origin frame, in its own axes."""

    joints: tuple[str, ...]
    std: float

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """Shift and rotation of each frame."""
        return of_motions(Kind.GEOMETRY, self.joints)

    @property
    def prior(self) -> Array:
        """As declared, the same number in m and rad."""
        return np.full(6 * len(self.joints), self.std)

    def columns(self, view: View) -> Array:
        """Return the columns of the links' ends."""
        return np.concatenate([view.answer(view.line.site(f"link:{joint}")) for joint in self.joints], axis=2)

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the origin frames twisted."""
        before = setup.arm.corrections.geometry
        pairs = zip(self.joints, values.reshape(-1, 6), strict=True)
        geometry = {joint: before.get(joint, np.zeros(6)) + value for joint, value in pairs}
        corrections = replace(setup.arm.corrections, geometry=geometry)
        return replace(setup, arm=replace(setup.arm, corrections=corrections))


@dataclass(frozen=True)
class ComplianceBlock(Block):
    """Logarithmic factors on the declared compliance of every axis: C becomes S C S with S = exp(values / 2)."""

    flexures: tuple[str, ...]
    axes: tuple[tuple[int, ...], ...]
    std: float
    logarithmic = True

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """Those axes of every flexure."""
        pairs = zip(self.flexures, self.axes, strict=True)
        return tuple(one for name, axes in pairs for one in of_compliance(name, axes))

    @property
    def prior(self) -> Array:
        """As declared."""
        return np.full(len(self.parameters), self.std)

    def columns(self, view: View) -> Array:
        """Return half of (E C + C E) w for every axis, through the laws' answer."""
        line, names = view.line, view.setup.arm.flexure_names
        columns = []
        for name, axes in zip(self.flexures, self.axes, strict=True):
            index = names.index(name)
            answer, wrench = line.laws[:, :, index], line.flexure_wrenches[:, index]
            law = view.setup.arm.flexures[index].law  # without what effects add to it
            twist, tangent = law.twist(wrench, line.row), law.tangent(wrench, line.row)
            change = 0.5 * (np.eye(6) * twist[:, None] + tangent * wrench[:, None])
            columns.append(answer @ change[:, :, list(axes)])
        return view.answer(np.concatenate(columns, axis=2))

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the laws scaled."""
        parts = np.split(values, np.cumsum([len(axes) for axes in self.axes])[:-1])
        steps = {name: np.zeros(6) for name in self.flexures}
        for name, axes, part in zip(self.flexures, self.axes, parts, strict=True):
            steps[name][list(axes)] = part
        arm, before = setup.arm, setup.arm.factors
        changed = tuple(
            replace(flexure, law=scaled(flexure.law, np.exp(0.5 * steps[flexure.name])))
            if flexure.name in steps
            else flexure
            for flexure in arm.flexures
        )
        factors = {**before, **{name: before.get(name, np.zeros(6)) + step for name, step in steps.items()}}
        return replace(setup, arm=replace(arm, flexures=changed, factors=factors))
