"""What a loaded arm does: one configuration, or many."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.equilibrium import Equilibrium, LawStack, tangent_of
from armflex.errors import Flag
from armflex.laws import Row
from armflex.loads import Payload
from armflex.mechanics import LoadCase, Mechanics


@dataclass(frozen=True)
class Names:
    """What the rows and columns of a result stand for, and the frames it is meant in."""

    joints: tuple[str, ...]
    flexures: tuple[str, ...]
    base: str
    tip: str


@dataclass(frozen=True, repr=False, eq=False)
class Deflection:
    """The arm at one configuration under one load.

    Derivatives and covariance of the rotation are those of a further small rotation in base axes, which differ from
    those of the rotation vector itself by half its length (1 % at 22 mrad).

    Attributes:
        q: (nq,) joint positions [rad or m].
        pose: Tip pose of the flexed arm in the base frame.
        rigid_pose: Tip pose of the rigid arm.
        displacement: (6,) flexed minus rigid: shift of the tip origin [m] and rotation vector [rad], base axes.
        names: Joints, flexures, base and tip.
        payload: What is carried.
        flags: Doubts about this result.
    """

    q: Array
    pose: pin.SE3
    rigid_pose: pin.SE3
    displacement: Array
    names: Names
    payload: Payload
    flags: tuple[Flag, ...]
    _mechanics: Mechanics
    _stack: LawStack
    _case: LoadCase
    _row: Row
    _equilibrium: Equilibrium

    def __repr__(self) -> str:
        """Two lines: how far the tip moves, and what is doubtful."""
        shift, turn = (float(np.linalg.norm(part)) for part in (self.displacement[:3], self.displacement[3:]))
        doubts = ", ".join(flag.code for flag in self.flags) or "none"
        moves = f"{self.names.tip} moves {shift * 1e3:.4g} mm and turns {turn * 1e3:.3g} mrad"
        return f"<Deflection: {moves} under {self.payload.mass:g} kg ({self.method}); doubts: {doubts}>"

    @property
    def wrenches(self) -> Array:
        """(n_flexures, 6) loads on the flexures, local axes [N, Nm]."""
        return self._equilibrium.wrenches.reshape(-1, 6)

    @property
    def twists(self) -> Array:
        """(n_flexures, 6) local deflections [m, rad]."""
        return self._equilibrium.twists.reshape(-1, 6)

    @property
    def method(self) -> str:
        """How the equilibrium was found."""
        return self._equilibrium.method

    @property
    def residuals(self) -> tuple[float, ...]:
        """Largest residual of the equilibrium before each step [m or rad]; empty for first order."""
        return self._equilibrium.history

    @cached_property
    def joint_loads(self) -> Array:
        """(nq, 6) wrench on the structure at every joint, in the joint's child frame [N, Nm]."""
        return self._mechanics.joint_loads(self._equilibrium.configuration, self._case)

    @cached_property
    def tangent(self) -> Array:
        """(6 n, 6 n) tangent `I + C dτ/dtwist` at the solution."""
        known = self._equilibrium.tangent
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
        """(6,) displacement minus the sum of `contributions`: what first order leaves out [m, rad]."""
        return self.displacement - self.contributions.sum(axis=0)

    @cached_property
    def compliance(self) -> Array:
        """(6, 6) displacement of the tip per wrench at the tip origin, base axes, about the solution [m/N, ...]."""
        tip = self._mechanics.tip_jacobian(self._equilibrium.configuration)[:, self._mechanics.flex.flexure_v]
        given = self._stack.tangent(self._equilibrium.wrenches, self._row) @ tip.T
        return self.flexure_jacobian @ np.linalg.solve(self.tangent, given)

    @cached_property
    def covariance(self) -> Array | None:
        """(6, 6) covariance of the displacement, None where no law carries an uncertainty."""
        laws = self._stack.covariance(self._equilibrium.wrenches, self._row)
        if laws is None:
            return None
        gain = np.linalg.solve(self.tangent.T, self.flexure_jacobian.T).T
        return gain @ laws @ gain.T

    def link_poses(self, magnification: float = 1.0) -> dict[str, Array]:
        """Return the (4, 4) pose of every link with the flexures' twists magnified; 0 gives the rigid arm."""
        twists = magnification * self._equilibrium.twists
        return self._mechanics.link_poses(self._mechanics.bent(self._equilibrium.straight, twists))


@dataclass(frozen=True, repr=False, eq=False)
class DeflectionBatch:
    """The arm at N configurations; the arrays of `Deflection` with a leading N.

    Attributes:
        q: (N, nq) joint positions.
        pose, rigid_pose: (N, 4, 4) tip poses in the base frame.
        displacement: (N, 6) flexed minus rigid, base axes [m, rad].
        wrenches, twists: (N, n_flexures, 6) local loads and deflections.
        contributions: (N, n_flexures, 6) first-order share of each flexure in the displacement.
        covariance: (N, 6, 6), or None where no law carries an uncertainty.
        names: Joints, flexures, base and tip.
        flags: Doubts, each with the first row it concerns.
    """

    q: Array
    pose: Array
    rigid_pose: Array
    displacement: Array
    wrenches: Array
    twists: Array
    contributions: Array
    covariance: Array | None
    names: Names
    flags: tuple[Flag, ...]

    def __repr__(self) -> str:
        """One line: how many rows and the largest shift."""
        most = float(np.linalg.norm(self.displacement[:, :3], axis=1).max(initial=0.0))
        return f"<DeflectionBatch: {len(self.q)} rows, {self.names.tip} moves up to {most * 1e3:.4g} mm>"


def stack_rows(q: Array, rows: Iterable[Deflection], names: Names) -> DeflectionBatch:
    """Return many single results as one batch; each is let go once its numbers are taken."""
    flags: dict[str, Flag] = {}
    taken = [_take(number, row, flags) for number, row in enumerate(rows)]
    shapes = {"pose": (4, 4), "rigid_pose": (4, 4), "displacement": (6,), "covariance": (6, 6)}
    shapes |= dict.fromkeys(("wrenches", "twists", "contributions"), (len(names.flexures), 6))
    arrays = {name: np.array([part[name] for part in taken]).reshape(-1, *shape) for name, shape in shapes.items()}
    certain = not taken or all(part["certain"] for part in taken)
    if certain:
        arrays["covariance"] = None
    return DeflectionBatch(q=q, names=names, flags=tuple(flags.values()), **arrays)


def _take(number: int, row: Deflection, flags: dict[str, Flag]) -> dict[str, Array | bool]:
    for flag in row.flags:
        flags.setdefault(flag.code, Flag(flag.code, f"row {number}: {flag.text}"))
    covariance = row.covariance
    return {
        "pose": row.pose.homogeneous,
        "rigid_pose": row.rigid_pose.homogeneous,
        "displacement": row.displacement,
        "wrenches": row.wrenches,
        "twists": row.twists,
        "contributions": row.contributions,
        "covariance": np.zeros((6, 6)) if covariance is None else covariance,
        "certain": covariance is None,
    }
