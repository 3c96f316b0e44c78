"""What a loaded arm does at one configuration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.laws import Row
from armflex.mechanics.doubts import sag_doubts
from armflex.mechanics.equilibrium import Equilibrium, tangent_of
from armflex.mechanics.laws import LawStack
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.loads import Payload
from armflex.mechanics.pinocchio_model import LoadCase, Mechanics
from armflex.mechanics.structure import Names


class Solved(NamedTuple):
    """What the solver leaves, in the order and signs of Pinocchio's flexible model.

    Attributes:
        loaded: The arm with its payload.
        straight: Configuration with flexures at zero.
        motion: (nv,) exponential coordinates of the flexures, zero for joints [m, rad].
        torque: (nv,) generalized torque: minus the loads on the flexures [N, Nm]; None for that of the motion.
        method: How it was found.
        history: Squared length of the residual before each step [m^2 or rad^2].
        flags: Doubts about the question.
        covariates: What the laws know beyond positions.
        case: Motion and loads from outside, None where there are none.
        tangent: (6 n, 6 n), where stability was checked with it.
    """

    loaded: LoadedArm
    straight: Array
    motion: Array
    torque: Array | None
    method: str
    history: Sequence[float]
    flags: tuple[Flag, ...]
    covariates: dict[str, Array]
    case: LoadCase | None = None
    tangent: Array | None = None


@dataclass(frozen=True, repr=False, eq=False)
class Deflection:
    """The arm at one configuration under one load.

    Derivatives and covariance of the rotation are those of a further small rotation in base axes, which differ from
    those of the rotation vector itself by half its length (1 % at 22 mrad).

    The equilibrium is found, and refused where there is none, before there is a `Deflection`; what follows from it is
    computed when it is asked for, and kept.

    Attributes:
        q: (nq,) joint positions [rad or m].
        solved: What the solver left.
    """

    q: Array
    solved: Solved

    def __repr__(self) -> str:
        """Two lines: how far the tip moves, and what is doubtful."""
        shift, turn = (float(np.linalg.norm(part)) for part in (self.displacement[:3], self.displacement[3:]))
        doubts = ", ".join(flag.code for flag in self.flags) or "none"
        moves = f"{self.names.tip} moves {shift * 1e3:.4g} mm and turns {turn * 1e3:.3g} mrad"
        return f"<Deflection: {moves} under {self.payload.mass:g} kg ({self.method}); doubts: {doubts}>"

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
        found = self.solved.loaded.solver.displacement(self._configuration, self.q)
        found.flags.writeable = False
        return found

    @cached_property
    def pose(self) -> pin.SE3:
        """Tip pose of the flexed arm in the base frame."""
        return self._mechanics.tip_pose(self._configuration)

    @cached_property
    def rigid_pose(self) -> pin.SE3:
        """Tip pose of the rigid arm."""
        return self._mechanics.rigid_tip_pose(self.q)

    @cached_property
    def flags(self) -> tuple[Flag, ...]:
        """Doubts about this result."""
        return (*self.solved.flags, *sag_doubts(self.solved.loaded.arm, self.displacement), *self.unseen)

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
        return self._mechanics.joint_loads(self._equilibrium.configuration, self._case)

    @cached_property
    def tangent(self) -> Array:
        """(6 n, 6 n) tangent `I + C dτ/dtwist` at the solution."""
        known = self.solved.tangent
        if known is not None:
            return known
        return tangent_of(self._mechanics, self._stack, self._case, self._row, self._equilibrium)

    @cached_property
    def flexure_jacobian(self) -> Array:
        """(6, 6 n) change of the tip (origin, rotation; base axes) per change of the flexures' twists."""
        places = self._mechanics.flex.flexure_v
        body = self._mechanics.tip_jacobian(self._equilibrium.configuration)[:, places]
        return body @ self._mechanics.exponential_jacobian(self._equilibrium.straight, self._equilibrium.twists)

    @cached_property
    def joint_jacobian(self) -> Array:
        """(6, nq) change of the tip (origin, rotation; base axes) per joint, flexures held as they are."""
        jacobian = self._mechanics.tip_jacobian(self._equilibrium.configuration)
        return jacobian[:, self._mechanics.flex.v_index]

    @cached_property
    def total_jacobian(self) -> Array:
        """(6, nq) change of the tip (origin, rotation; base axes) per joint, the flexures following their loads."""
        flex = self._mechanics.flex
        wrenches, row = self._equilibrium.wrenches, self._row
        turned = self._mechanics.stiffness(self._equilibrium.configuration, self._case)[:, flex.v_index]
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
        return self.solved.loaded.solver.displacement(self.solved.straight, self.q)

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
        tip = self._mechanics.tip_jacobian(self._equilibrium.configuration)[:, self._mechanics.flex.flexure_v]
        given = self._stack.tangent(self._equilibrium.wrenches, self._row) @ tip.T
        return self.flexure_jacobian @ np.linalg.solve(self.tangent, given)

    @cached_property
    def covariance(self) -> Array | None:
        """(6, 6) covariance of the displacement, None where no law carries an uncertainty.

        It is of the laws alone: what a calibration or a trace fitted is left out; see `armflex.total_covariance`.
        """
        laws = self._stack.covariance(self._equilibrium.wrenches, self._row)
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
        return self.solved.loaded.solver.bent(self.solved.straight, self.solved.motion)

    @cached_property
    def _at_rest(self) -> tuple[Array, Array]:
        """(nv,) motion and torque, the one what the laws say of the other to the last digit."""
        motion, torque, loaded = self.solved.motion, self.solved.torque, self.solved.loaded
        if torque is not None:
            return motion, torque
        solver = loaded.solver
        if loaded.laws.others:
            solver.know(self._row)
        torque = solver.torque(self._configuration)
        return solver.motion(torque), torque

    @cached_property
    def _case(self) -> LoadCase:
        known = self.solved.case
        return self.solved.loaded.case(self.q) if known is None else known

    @cached_property
    def _row(self) -> Row:
        return self.solved.loaded.row(self.q, self.solved.covariates)

    @cached_property
    def unseen(self) -> tuple[Flag, ...]:
        """Doubts about loads beyond those that a trained law has seen."""
        return self._stack.doubts(self.wrenches.ravel(), self._row) if self._stack.trained else ()

    @cached_property
    def _equilibrium(self) -> Equilibrium:
        solved, loads = self.solved, (self.twists.ravel(), self.wrenches.ravel())
        return Equilibrium(*loads, solved.straight, self._configuration, solved.method, self.residuals, solved.tangent)

    def link_poses(self, magnification: float = 1.0) -> dict[str, Array]:
        """Return the (4, 4) pose of every link with the flexures' twists magnified; 0 gives the rigid arm."""
        twists = magnification * self._equilibrium.twists
        return self._mechanics.link_poses(self._mechanics.bent(self._equilibrium.straight, twists))
