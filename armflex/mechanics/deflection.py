"""One question to an arm with a payload, from joint positions that were checked to a `Deflection`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import ExtrapolationError, Flag
from armflex.laws import Row
from armflex.mechanics.equilibrium import Equilibrium, find_equilibrium, tangent_of
from armflex.mechanics.laws import LawStack
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.loads import Payload
from armflex.mechanics.pinocchio_model import LoadCase, Mechanics
from armflex.mechanics.structure import Names


class Asked(NamedTuple):
    """How a question is to be answered; see `Arm.deflection`."""

    method: str = "exact"
    enforce_limits: bool = True
    allow_large: bool = False
    strict: bool = False


@dataclass(frozen=True, init=False, repr=False, eq=False)
class Deflection:
    """The arm at one configuration under one load.

    Derivatives and covariance of the rotation are those of a further small rotation in base axes, which differ from
    those of the rotation vector itself by half its length (1 % at 22 mrad).

    The equilibrium is found, and refused where there is none, before there is a `Deflection`; what follows from it is
    computed when it is asked for, and kept.

    Attributes:
        solved: The equilibrium.
        asked_flags: Doubts about the question.
    """

    solved: Equilibrium
    asked_flags: tuple[Flag, ...] = ()

    def __init__(self, solved: Equilibrium, asked_flags: tuple[Flag, ...] = ()) -> None:
        # What a frozen dataclass makes itself takes as long as a third of a step to the equilibrium.
        self.__dict__["solved"], self.__dict__["asked_flags"] = solved, asked_flags

    def __repr__(self) -> str:
        """Two lines: how far the tip moves, and what is doubtful."""
        shift, turn = (float(np.linalg.norm(part)) for part in (self.displacement[:3], self.displacement[3:]))
        doubts = ", ".join(flag.code for flag in self.flags) or "none"
        moves = f"{self.names.tip} moves {shift * 1e3:.4g} mm and turns {turn * 1e3:.3g} mrad"
        return f"<Deflection: {moves} under {self.payload.mass:g} kg ({self.method}); doubts: {doubts}>"

    @property
    def q(self) -> Array:
        """(nq,) joint positions [rad or m]."""
        return self.solved.case.q

    @property
    def names(self) -> Names:
        """Joints, flexures, base and tip."""
        return self.solved.loaded.arm.names

    @property
    def payload(self) -> Payload:
        """What is carried."""
        return self.solved.loaded.payload

    @cached_property
    def displacement(self) -> Array:
        """(6,) flexed minus rigid: shift of the tip origin [m] and rotation vector [rad], base axes."""
        solved, mechanics = self.solved, self._mechanics
        found = mechanics.displacement(mechanics.flexed(solved.rigid, solved.motion), solved.case.q)
        found.flags.writeable = False
        return found

    @cached_property
    def pose(self) -> pin.SE3:
        """Tip pose of the flexed arm in the base frame."""
        return self._mechanics.frame_pose(self._configuration, self._mechanics.flex.tip)

    @cached_property
    def rigid_pose(self) -> pin.SE3:
        """Tip pose of the rigid arm."""
        return self._mechanics.rigid_tip_pose(self.q)

    @cached_property
    def flags(self) -> tuple[Flag, ...]:
        """Doubts about this result."""
        return (*self.asked_flags, *self.solved.loaded.sag_flags(self.displacement), *self.unseen)

    @cached_property
    def wrenches(self) -> Array:
        """(n_flexures, 6) loads on the flexures, local axes [N, Nm]."""
        return -self._at_rest[1][self._mechanics.flex.flexure_v].reshape(-1, 6)

    @cached_property
    def twists(self) -> Array:
        """(n_flexures, 6) local deflections [m, rad]."""
        return self._at_rest[0][self._mechanics.flex.flexure_v].reshape(-1, 6)

    @property
    def method(self) -> str:
        """How the equilibrium was found."""
        return self.solved.method

    @property
    def residuals(self) -> tuple[float, ...]:
        """Length of the equilibrium's residual before each step [m or rad]; empty for first order."""
        return tuple(float(size) ** 0.5 for size in self.solved.history)

    @cached_property
    def joint_loads(self) -> Array:
        """(nq, 6) wrench on the structure at every joint, in the joint's child frame [N, Nm]."""
        return self._mechanics.joint_loads(self._configuration, self.solved.case)

    @cached_property
    def tangent(self) -> Array:
        """(6 n, 6 n) tangent `I + C dτ/dtwist` at the solution."""
        known = self.solved.tangent
        return (
            tangent_of(self.solved._replace(motion=self._at_rest[0], torque=self._at_rest[1]))
            if known is None
            else known
        )

    @cached_property
    def flexure_jacobian(self) -> Array:
        """(6, 6 n) change of the tip (origin, rotation; base axes) per change of the flexures' twists."""
        body = self._mechanics.tip_jacobian(self._configuration)[:, self._mechanics.flex.flexure_v]
        return body @ self._mechanics.exponential_jacobian(self.solved.rigid, self._at_rest[0])

    @cached_property
    def joint_jacobian(self) -> Array:
        """(6, nq) change of the tip (origin, rotation; base axes) per joint, flexures held as they are."""
        return self._mechanics.tip_jacobian(self._configuration)[:, self._mechanics.flex.v_index]

    @cached_property
    def total_jacobian(self) -> Array:
        """(6, nq) change of the tip (origin, rotation; base axes) per joint, the flexures following their loads."""
        flex, wrenches, row = self._mechanics.flex, self.wrenches.ravel(), self._row
        turned = self._mechanics.stiffness(self._configuration, self.solved.case)[:, flex.v_index]
        given = self._stack.tangent(wrenches, row) @ turned[flex.flexure_v]
        following = self._stack.change_with_position(wrenches, row) - given
        return self.joint_jacobian + self.flexure_jacobian @ np.linalg.solve(self.tangent, following)

    @cached_property
    def contributions(self) -> Array:
        """(n_flexures, 6) of the displacement due to each flexure, first order; see `remainder`."""
        columns = self.flexure_jacobian.reshape(6, -1, 6)
        return np.einsum("ink,nk->ni", columns, self.twists)

    @cached_property
    def corrected(self) -> Array:
        """(6,) of the displacement due to `Arm.corrections`: the arm as it was calibrated, before it gives [m, rad]."""
        known = self.solved.loaded.arm.corrections
        if not (known.joint_offset or known.geometry):
            return np.zeros(6)
        return self._mechanics.displacement(self.solved.rigid, self.q)

    def shares(self, part: slice = slice(0, 3)) -> Array:
        """Return (n_flexures,) of each flexure along the tip's shift (0:3) [m] or turn (3:6) [rad]."""
        along = self.displacement[part]
        return self.contributions[:, part] @ along / (np.linalg.norm(along) or 1.0)

    def sigma(self, part: slice = slice(0, 3)) -> float | None:
        """Return the standard uncertainty of the length of the tip's shift or turn, None where no law carries one."""
        if self.covariance is None:
            return None
        along, covariance = self.displacement[part], self.covariance[part, part]
        length = float(np.linalg.norm(along))
        if length == 0.0:
            return float(np.sqrt(np.trace(covariance)))
        return float(np.sqrt(along @ covariance @ along)) / length

    @property
    def remainder(self) -> Array:
        """(6,) displacement minus `corrected` and the sum of `contributions`: what first order leaves out [m, rad]."""
        return self.displacement - self.corrected - self.contributions.sum(axis=0)

    @cached_property
    def compliance(self) -> Array:
        """(6, 6) displacement of the tip per wrench at the tip origin, base axes, about the solution [m/N, ...]."""
        tip = self._mechanics.tip_jacobian(self._configuration)[:, self._mechanics.flex.flexure_v]
        given = self._stack.tangent(self.wrenches.ravel(), self._row) @ tip.T
        return self.flexure_jacobian @ np.linalg.solve(self.tangent, given)

    @cached_property
    def covariance(self) -> Array | None:
        """(6, 6) covariance of the displacement, None where no law carries an uncertainty.

        It is of the laws alone: what a calibration or a trace fitted is left out; see `armflex.total_covariance`.
        """
        laws = self._stack.covariance(self.wrenches.ravel(), self._row)
        if laws is None:
            return None
        gain = np.linalg.solve(self.tangent.T, self.flexure_jacobian.T).T
        return gain @ laws @ gain.T

    @property
    def _mechanics(self) -> Mechanics:
        return self.solved.loaded.mechanics

    @property
    def _stack(self) -> LawStack:
        return self.solved.loaded.arm.stack

    @cached_property
    def _configuration(self) -> Array:
        return self._mechanics.flexed(self.solved.rigid, self.solved.motion)

    @cached_property
    def _at_rest(self) -> tuple[Array, Array]:
        """(nv,) motion and torque, the one what the laws say of the other to the last digit."""
        motion, torque, mechanics = self.solved.motion, self.solved.torque, self._mechanics
        if torque is not None:
            return motion, torque
        if mechanics.laws.changing:
            mechanics.laws.know(self._row)
        torque = mechanics.load(self.solved.case)(self._configuration)
        return mechanics.laws.motion(torque), torque

    @cached_property
    def _row(self) -> Row:
        return self.solved.loaded.row(self.q, self.solved.case.covariates)

    def check_seen(self) -> None:
        """Raise `ExtrapolationError` where a trained law was asked beyond the loads that it has seen."""
        if self.unseen:
            raise ExtrapolationError("; ".join(flag.text for flag in self.unseen))

    @cached_property
    def unseen(self) -> tuple[Flag, ...]:
        """Doubts about loads beyond those that a trained law has seen."""
        return self._stack.doubts(self.wrenches.ravel(), self._row) if self._stack.trained else ()

    def link_poses(self, magnification: float = 1.0) -> dict[str, Array]:
        """Return the (4, 4) pose of every link with the flexures' twists magnified; 0 gives the rigid arm."""
        mechanics = self._mechanics
        return mechanics.link_poses(mechanics.flexed(self.solved.rigid, magnification * self._at_rest[0]))


def deflect(
    loaded: LoadedArm, case: LoadCase, flags: tuple[Flag, ...], method: str, allow_large: bool = False
) -> Deflection:
    """Return what the arm does in a case; `flags` are the doubts about its joint positions.

    Raises:
        As `find_equilibrium`.
    """
    doubts = loaded.flags_under(case.wrenches, case.a is not None) if case.wrenches or case.moves else loaded.flags
    # Beyond its limits a joint may be farther out than the proof of stability knows of.
    found = find_equilibrium(loaded, case, method, allow_large, within=not flags)
    return Deflection(found, (*doubts, *flags) if flags else doubts)
