"""Blocks of parameters that a fit may move: each knows its prior, its columns, and how to apply its values.

Everything declared in [prior] is a block; an effect that was added becomes one, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pinocchio as pin

from armflex.calibrate.view import Setup, View
from armflex.conventions import TWIST_NAMES, Array
from armflex.effects.rigid import rigid_motion
from armflex.laws import LinearLaw, PositionDependentLaw
from armflex.laws.scaled import scaled
from armflex.measured.measurements import Measurements

MOUNTING = "mounting"
"""Name of the block of the target's orientation."""


class Block(Protocol):
    """Parameters that belong together."""

    @property
    def name(self) -> str:
        """Which part of the model it is."""
        ...

    @property
    def labels(self) -> tuple[str, ...]:
        """One name per parameter."""
        ...

    @property
    def units(self) -> tuple[str, ...]:
        """One unit per parameter."""
        ...

    @property
    def prior(self) -> Array:
        """(k,) standard deviations about zero; infinite where nothing is known."""
        ...

    @property
    def logarithmic(self) -> bool:
        """Whether a parameter is the logarithm of a factor: its column then changes as fast as what it stands for."""
        ...

    def columns(self, view: View) -> Array:
        """Return (M, d, k) changes of the readings per parameter at the view's setup."""
        ...

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with (k,) values added to the declared one."""
        ...


@dataclass(frozen=True)
class FrameBlock:
    """The instrument's pose about a first guess: shift and rotation vector in instrument axes, free."""

    start: pin.SE3
    level: bool
    name: str = "instrument"
    logarithmic: bool = False
    labels: tuple[str, ...] = TWIST_NAMES
    units: tuple[str, ...] = ("m",) * 3 + ("rad",) * 3

    @property
    def prior(self) -> Array:
        """Nothing is known."""
        return np.full(6, np.inf)

    def columns(self, view: View) -> Array:
        """Return the readings' change; with a level instrument the arm's gravity turns as well."""
        columns = rigid_motion(view.points, view.residual.shape[1])
        if self.level:
            rotation, gravity = view.setup.instrument.pose.rotation, view.setup.arm.robot.gravity
            turned = pin.skew(gravity) @ rotation.T  # base gravity R^T g when R becomes exp(w) R
            columns[:, :, 3:] += view.answer(view.line.gravity @ turned)
        return columns

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the instrument moved (and, when level, gravity turned with it)."""
        rotation = pin.exp3(values[3:]) @ self.start.rotation
        pose = pin.SE3(rotation, pin.exp3(values[3:]) @ self.start.translation + values[:3])
        moved = replace(setup, instrument=replace(setup.instrument, pose=pose))
        if not self.level:
            return moved
        down = rotation.T @ setup.arm.robot.gravity
        return replace(moved, arm=replace(setup.arm, robot=replace(setup.arm.robot, gravity=down)))


@dataclass(frozen=True)
class SessionBlock:
    """The instrument set up again: a small shift and rotation for every session."""

    sessions: tuple[str, ...]
    rows: tuple[str, ...]
    translation: float
    rotation: float
    name: str = "session_frame"
    logarithmic: bool = False

    @property
    def labels(self) -> tuple[str, ...]:
        """Session and component."""
        return tuple(f"{session} {axis}" for session in self.sessions for axis in TWIST_NAMES)

    @property
    def units(self) -> tuple[str, ...]:
        """Shift and rotation of each session."""
        return (("m",) * 3 + ("rad",) * 3) * len(self.sessions)

    @property
    def prior(self) -> Array:
        """As declared, the same for every session."""
        return np.tile(np.repeat([self.translation, self.rotation], 3), len(self.sessions))

    def columns(self, view: View) -> Array:
        """Return the rigid motions, each for its session's rows only."""
        motion = rigid_motion(view.points, view.residual.shape[1])
        own = [np.array([self.rows[row] == session for row in view.rows]) for session in self.sessions]
        return np.concatenate([motion * mask[:, None, None] for mask in own], axis=2)

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with every session's shift."""
        shifts = dict(zip(self.sessions, values.reshape(-1, 6), strict=True))
        return replace(setup, instrument=replace(setup.instrument, sessions=shifts))


@dataclass(frozen=True)
class TargetBlock:
    """The measured point in the tip frame."""

    std: float
    name: str = "tool"
    logarithmic: bool = False
    labels: tuple[str, ...] = TWIST_NAMES[:3]
    units: tuple[str, ...] = ("m",) * 3

    @property
    def prior(self) -> Array:
        """As declared."""
        return np.full(3, self.std)

    def columns(self, view: View) -> Array:
        """Return the tip's axes as the instrument sees them."""
        columns = np.zeros((*view.residual.shape, 3))
        columns[:, :3] = view.setup.instrument.axes(view.line.tip)
        return columns

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the target moved."""
        instrument = setup.instrument
        return replace(setup, instrument=replace(instrument, target=instrument.target + values))


@dataclass(frozen=True)
class MountingBlock:
    """How the target is turned on the tool, where orientations are read: nobody mounts a target to a milliradian."""

    start: Array
    name: str = MOUNTING
    logarithmic: bool = False
    labels: tuple[str, ...] = TWIST_NAMES[3:]
    units: tuple[str, ...] = ("rad",) * 3

    @property
    def prior(self) -> Array:
        """Nothing is known."""
        return np.full(3, np.inf)

    def columns(self, view: View) -> Array:
        """Return the tip's axes as the instrument sees them, for orientations alone."""
        columns = np.zeros((*view.residual.shape, 3))
        columns[:, 3:] = view.setup.instrument.axes(view.line.tip)[:, : view.residual.shape[1] - 3]
        return columns

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the target turned about its first guess, in tip axes."""
        turned = pin.log3(pin.exp3(values) @ pin.exp3(self.start))
        return replace(setup, instrument=replace(setup.instrument, mounting=turned))


@dataclass(frozen=True)
class OffsetBlock:
    """A constant error of every joint's position."""

    joints: tuple[str, ...]
    std: float
    units: tuple[str, ...]
    name: str = "joint_offset"
    logarithmic: bool = False

    @property
    def labels(self) -> tuple[str, ...]:
        """The joints."""
        return self.joints

    @property
    def prior(self) -> Array:
        """As declared."""
        return np.full(len(self.joints), self.std)

    def columns(self, view: View) -> Array:
        """Return the joints' columns, loads redistributing."""
        return view.answer(view.line.joints)

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the joints offset."""
        corrections = setup.arm.corrections
        pairs = zip(self.joints, values.tolist(), strict=True)
        offsets = {joint: corrections.joint_offset.get(joint, 0.0) + value for joint, value in pairs}
        return replace(setup, arm=replace(setup.arm, corrections=replace(corrections, joint_offset=offsets)))


@dataclass(frozen=True)
class GeometryBlock:
    """A constant twist of every joint's origin frame, in its own axes."""

    joints: tuple[str, ...]
    std: float
    name: str = "geometry"
    logarithmic: bool = False

    @property
    def labels(self) -> tuple[str, ...]:
        """Joint and component."""
        return tuple(f"{joint} {axis}" for joint in self.joints for axis in TWIST_NAMES)

    @property
    def units(self) -> tuple[str, ...]:
        """Shift and rotation of each frame."""
        return (("m",) * 3 + ("rad",) * 3) * len(self.joints)

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
class ComplianceBlock:
    """Logarithmic factors on the declared compliance of every axis: C becomes S C S with S = exp(values / 2)."""

    flexures: tuple[str, ...]
    axes: tuple[tuple[int, ...], ...]
    std: float
    name: str = "compliance"
    logarithmic: bool = True

    @property
    def labels(self) -> tuple[str, ...]:
        """Flexure and axis."""
        pairs = zip(self.flexures, self.axes, strict=True)
        return tuple(f"{name} {TWIST_NAMES[axis]}" for name, axes in pairs for axis in axes)

    @property
    def units(self) -> tuple[str, ...]:
        """Relative."""
        return ("1",) * len(self.labels)

    @property
    def prior(self) -> Array:
        """As declared."""
        return np.full(len(self.labels), self.std)

    def columns(self, view: View) -> Array:
        """Return half of (E C + C E) w for every axis, through the laws' answer."""
        line, names = view.line, view.setup.arm.flexure_names
        columns = []
        for name, axes in zip(self.flexures, self.axes, strict=True):
            index = names.index(name)
            answer, wrench = line.laws[:, :, index], line.flexure_wrenches[:, index]
            law = view.setup.arm.flexures[index].law  # without what effects add to it
            twist, tangent = law.twist(wrench, line.row), law.tangent(wrench, line.row)
            for axis in axes:
                unit = np.eye(6)[axis]
                back = tangent @ (unit * wrench[:, [axis]])[:, :, None]
                change = 0.5 * (unit * twist[:, [axis]] + back[:, :, 0])
                columns.append(answer @ change[:, :, None])
        return view.answer(np.concatenate(columns, axis=2))

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the laws scaled."""
        factors, start = {}, 0
        for name, axes in zip(self.flexures, self.axes, strict=True):
            factor = np.ones(6)
            factor[list(axes)] = np.exp(0.5 * values[start : start + len(axes)])
            factors[name], start = factor, start + len(axes)
        changed = tuple(
            replace(flexure, law=scaled(flexure.law, factors[flexure.name])) if flexure.name in factors else flexure
            for flexure in setup.arm.flexures
        )
        return replace(setup, arm=replace(setup.arm, flexures=changed))


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
    if measurements.rotation is not None:
        blocks.append(MountingBlock(setup.instrument.mounting))
    if prior.joint_offset:
        kinds = tuple("m" if joint.kind == "prismatic" else "rad" for joint in arm.robot.moving)
        blocks.append(OffsetBlock(arm.joint_names, prior.joint_offset, kinds))
    if prior.geometry:
        blocks.append(GeometryBlock(arm.joint_names, prior.geometry))
    if prior.compliance:
        blocks += _compliance_block(setup, prior.compliance)
    return tuple(blocks)


def _compliance_block(setup: Setup, std: float) -> Sequence[Block]:
    names, axes = [], []
    for flexure in setup.arm.flexures:
        law = flexure.law
        if flexure.learn is None and isinstance(law, LinearLaw | PositionDependentLaw):
            matrix = law.compliance if isinstance(law, LinearLaw) else np.abs(law.coefficients).sum(axis=0)
            given = tuple(np.flatnonzero(np.diag(matrix) > 0.0).tolist())
            if given:
                names.append(flexure.name)
                axes.append(given)
    return [ComplianceBlock(tuple(names), tuple(axes), std)] if names else []
