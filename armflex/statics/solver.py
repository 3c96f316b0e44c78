"""Where an arm under its own weight comes to rest, as fast as Python and Pinocchio allow.

`find_equilibrium` is the general way. This one is for joint positions within their limits, no motion and no loads from
outside, in generalized velocities of Pinocchio's model so that nothing is gathered or copied. What it finds is an
answer where `Softening` proves that the arm stays; otherwise it is left to the general way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.laws import Law, Row
from armflex.statics.equilibrium import TOLERANCE
from armflex.statics.law_stack import PlacedLaws
from armflex.statics.mechanics import Mechanics

gravity, integrate = pin.computeGeneralizedGravity, pin.integrate
place_frames, log3 = pin.framesForwardKinematics, pin.log3

STEPS = range(24)
ENOUGH = TOLERANCE * TOLERANCE
"""Squared length of the last step, at most."""
NEXT = 4e-30
"""Squared length of the step after it, were it to shrink as the last one did: a lever of metres magnifies it."""
SLOWEST = 0.1
"""Where a squared step is not shorter than this part of the one before it, Newton is quicker."""

Motion = Callable[[Array], Array]


class Solver:
    """One thread's workspace for an arm with its payload; never to be shared between threads."""

    def __init__(self, mechanics: Mechanics, laws: PlacedLaws) -> None:
        flex, rigid = mechanics.flex, mechanics.rigid
        self.model, self.data = flex.model, flex.model.createData()
        self.rigid, self.rigid_data = rigid.model, rigid.model.createData()
        self._neutral, self._q_index = flex.neutral, flex.q_index
        # Views into Pinocchio's own memory: to ask for them costs more than to compute what they show.
        tip, rigid_tip = self.data.oMf[flex.tip], self.rigid_data.oMf[rigid.tip]
        self._shift, self._turn = tip.translation, tip.rotation
        self._rigid_shift, self._rigid_turn = rigid_tip.translation, rigid_tip.rotation.T
        self._laws, self._row = laws, None
        self._compliances: dict[int, Array] = {}
        self.motion = _together(laws, laws.matrix)
        """(nv,) generalized torques to the (nv,) twists, among zeros, that the laws give."""

    def straight(self, q: Array) -> Array:
        """Return the configuration with the joints at (nq,) positions and every flexure at zero."""
        configuration = self._neutral.copy()
        configuration[self._q_index] = q
        return configuration

    def know(self, row: Row) -> None:
        """Take in the row of the questions to come; needed where laws depend on more than the load."""
        matrix, curved = self._laws.matrix.copy(), []
        offset = np.zeros(len(matrix))
        self._row, self._compliances = row, {}
        for _, here, law in self._laws.others:
            affine = law.affine(row)
            if affine is None:
                curved.append((here, law))
                continue
            offset[here] += affine[0]
            matrix[here[:, None], here] -= affine[1]
            self._compliances[id(law)] = affine[1]
        self.motion = _with_others(_together(self._laws, matrix), offset, curved, row)

    def tangent(self, law: Law, load: Array) -> Array:
        """Return the (6, 6) tangent of one of the laws under a (6,) load, at the row that is known."""
        known = self._compliances.get(id(law))
        return law.tangent(load, self._row) if known is None else known

    def first_order(self, straight: Array) -> tuple[Array, Array]:
        """Return (nv,) motion and (nv,) torque: what the laws give under the loads of the straight arm."""
        torque = gravity(self.model, self.data, straight)
        return self.motion(torque), torque

    def settle(self, straight: Array) -> tuple[Array, list[float]] | None:
        """Return the (nv,) motion at rest and the squared lengths of the steps to it; None where they shrink slowly."""
        model, data, law = self.model, self.data, self.motion
        motion = law(gravity(model, data, straight))
        before = motion.dot(motion)
        sizes = [before]
        for _ in STEPS:
            moved = law(gravity(model, data, integrate(model, straight, motion)))
            step = moved - motion
            size = step.dot(step)
            sizes.append(size)
            if size <= ENOUGH and size * size <= NEXT * before:
                return moved, sizes
            if not size < SLOWEST * before:  # not a number is not, either
                return None
            motion, before = moved, size
        return None

    def torque(self, configuration: Array) -> Array:
        """Return the (nv,) generalized torque under the weight."""
        return gravity(self.model, self.data, configuration)

    def bent(self, straight: Array, motion: Array) -> Array:
        """Return the configuration with the flexures at exp6 of their twists."""
        return integrate(self.model, straight, motion)

    def displacement(self, configuration: Array, q: Array) -> Array:
        """Return the (6,) displacement of the tip from where the rigid arm has it at (nq,) positions."""
        place_frames(self.model, self.data, configuration)
        place_frames(self.rigid, self.rigid_data, q)
        found = np.empty(6)
        np.subtract(self._shift, self._rigid_shift, found[:3])
        found[3:] = log3(self._turn.dot(self._rigid_turn))
        return found


def _together(laws: PlacedLaws, matrix: Array) -> Motion:
    """Return the map of the laws that need not be asked one by one."""
    linear = _product(matrix)
    if not len(laws.bias):
        return linear
    hidden = np.ones(len(laws.bias) + 1)
    inner, units, bias, gains, tanh = hidden[:-1], laws.units.dot, laws.bias, laws.gains.dot, np.tanh

    def networks(torque: Array) -> Array:
        units(torque, inner)
        np.add(inner, bias, inner)
        tanh(inner, inner)
        return gains(hidden)

    def both(torque: Array) -> Array:
        return linear(torque) + networks(torque)

    return both if matrix.any() else networks


def _product(matrix: Array) -> Motion:
    """Return the product with a matrix; diagonal compliances are the usual ones and take a third of the time."""
    diagonal = np.diag(matrix).copy()
    if np.count_nonzero(matrix) == np.count_nonzero(diagonal):
        return partial(np.multiply, diagonal)
    return matrix.dot


def _with_others(together: Motion, offset: Array, curved: Sequence[tuple[np.ndarray, Law]], row: Row) -> Motion:
    """Return the map with what the other laws give in a row."""

    def everything(torque: Array) -> Array:
        found = together(torque)
        found += offset
        for here, law in curved:
            found[here] += law.twist(-torque[here], row)
        return found

    return everything
