"""Blocks of the instrument: where it stands, what it looks at, and how that is turned on the tool."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.estimate.block import Block
from armflex.estimate.view import View
from armflex.laws.effects.scene import Scene
from armflex.parameters import FRAME, MOUNTED, TARGET, ArmParameter, Kind, of_motions
from armflex.setup import Setup


@dataclass(frozen=True)
class FrameBlock(Block):
    """The instrument's pose about a first guess: shift and rotation vector in instrument axes, free."""

    guess: pin.SE3
    level: bool
    parameters: tuple[ArmParameter, ...] = FRAME

    @property
    def prior(self) -> Array:
        """Nothing is known."""
        return np.full(6, np.inf)

    def columns(self, view: View) -> Array:
        """Return the readings' change; with a level instrument the arm's gravity turns as well."""
        columns = view.by_frame
        if self.level:
            rotation, gravity = view.setup.instrument.pose.rotation, view.setup.arm.robot.gravity
            turned = pin.skew(gravity) @ rotation.T  # base gravity R^T g when R becomes exp(w) R
            columns[:, :, 3:] += view.answer(view.line.gravity @ turned)
        return columns

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the instrument moved (and, when level, gravity turned with it)."""
        rotation = pin.exp3(values[3:]) @ self.guess.rotation
        pose = pin.SE3(rotation, pin.exp3(values[3:]) @ self.guess.translation + values[:3])
        moved = replace(setup, instrument=replace(setup.instrument, pose=pose))
        if not self.level:
            return moved
        down = rotation.T @ setup.arm.robot.gravity
        return replace(moved, arm=replace(setup.arm, robot=replace(setup.arm.robot, gravity=down)))


@dataclass(frozen=True)
class SessionBlock(Block):
    """The instrument set up again: a small shift and rotation for every session."""

    sessions: tuple[str, ...]
    rows: tuple[str, ...]
    translation: float
    rotation: float

    @cached_property
    def parameters(self) -> tuple[ArmParameter, ...]:
        """Shift and rotation of each session."""
        return of_motions(Kind.SESSION, self.sessions)

    @property
    def prior(self) -> Array:
        """As declared, the same for every session."""
        return np.tile(np.repeat([self.translation, self.rotation], 3), len(self.sessions))

    def columns(self, view: View) -> Array:
        """Return the rigid motions, each for its session's rows only."""
        motion = view.by_frame
        number = {name: i for i, name in enumerate(self.sessions)}
        own = np.array([number.get(self.rows[row], -1) for row in view.rows])[:, None, None]
        return np.concatenate([motion * (own == i) for i in number.values()], axis=2)

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with every session's shift."""
        shifts = dict(zip(self.sessions, values.reshape(-1, 6), strict=True))
        return replace(setup, instrument=replace(setup.instrument, sessions=shifts))

    def of_rows(self, sessions: tuple[str, ...], scene: Scene | None) -> SessionBlock:
        """Return the block with the sessions of other rows."""
        return replace(self, rows=sessions)


@dataclass(frozen=True)
class TargetBlock(Block):
    """The measured point in the tip frame."""

    std: float
    parameters: tuple[ArmParameter, ...] = TARGET

    @property
    def prior(self) -> Array:
        """As declared."""
        return np.full(3, self.std)

    def columns(self, view: View) -> Array:
        """Return the tip's axes as the instrument sees them."""
        return view.by_target

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the target moved."""
        instrument = setup.instrument
        return replace(setup, instrument=replace(instrument, target=instrument.target + values))


@dataclass(frozen=True)
class MountingBlock(Block):
    """How the target is turned on the tool, where orientations are read: nobody mounts a target to a milliradian."""

    guess: Array
    parameters: tuple[ArmParameter, ...] = MOUNTED

    @property
    def prior(self) -> Array:
        """Nothing is known."""
        return np.full(3, np.inf)

    def columns(self, view: View) -> Array:
        """Return the tip's axes as the instrument sees them, for orientations alone."""
        return view.by_mounting

    def apply(self, setup: Setup, values: Array) -> Setup:
        """Return the setup with the target turned about its first guess, in tip axes."""
        turned = pin.log3(pin.exp3(values) @ pin.exp3(self.guess))
        return replace(setup, instrument=replace(setup.instrument, mounting=turned))
