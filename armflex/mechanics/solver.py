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
from armflex.laws.law import NOTHING, UNLOADED
from armflex.mechanics.equilibrium import fixed_point
from armflex.mechanics.laws import PlacedLaws
from armflex.mechanics.pinocchio_model import Mechanics

gravity, integrate = pin.computeGeneralizedGravity, pin.integrate
place_frames, log3 = pin.framesForwardKinematics, pin.log3

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
        self.curved = True
        """Whether the laws' tangents depend on the load, in the row that is known."""
        self._compliances: dict[int, Array] = {}
        self._networks = _networks(laws) if len(laws.bias) else None
        self._softer: list[slice] = []
        self._matrix, self._usual = laws.matrix.copy(), _sum(_product(laws.matrix), self._networks)
        self.motion = self._usual
        """(nv,) generalized torques to the (nv,) twists, among zeros, that the laws give."""

    def straight(self, q: Array) -> Array:
        """Return the configuration with the joints at (nq,) positions and every flexure at zero."""
        configuration = self._neutral.copy()
        configuration[self._q_index] = q
        return configuration

    def know(self, row: Row) -> None:
        """Take in the row of the questions to come; needed where laws depend on more than the load."""
        offset, curved = np.zeros(self.model.nv), []
        self._row, self._compliances = row, {}
        for here in self._softer:
            self._matrix[here, here] = self._laws.matrix[here, here]
        self._softer = []
        for _, here, law in self._laws.others:
            affine = law.affine(row)
            if affine is None:
                curved.append((here, law))
                continue
            twist, compliance = affine
            self._compliances[id(law)] = compliance
            if twist is not NOTHING:
                offset[here] += twist
            if compliance is not UNLOADED:
                self._matrix[here, here] -= compliance
                self._softer.append(here)
        self.curved = bool(curved)
        together = _sum(self._matrix.dot, self._networks) if self._softer else self._usual
        self.motion = _with_others(together, offset, curved, row)

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
        model, data = self.model, self.data

        def load(motion: Array) -> Array:
            return gravity(model, data, integrate(model, straight, motion))

        found, sizes = fixed_point(self.motion, load, gravity(model, data, straight))
        return None if found is None else (found, sizes)

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


def _networks(laws: PlacedLaws) -> Motion:
    """Return the map of the networks."""
    hidden = np.ones(len(laws.bias) + 1)
    inner, units, bias, gains, tanh = hidden[:-1], laws.units.dot, laws.bias, laws.gains.dot, np.tanh

    def networks(torque: Array) -> Array:
        units(torque, inner)
        np.add(inner, bias, inner)
        tanh(inner, inner)
        return gains(hidden)

    return networks


def _sum(linear: Motion | None, networks: Motion | None) -> Motion:
    """Return the map of the laws that need not be asked one by one."""
    if linear is None or networks is None:
        return networks or linear or np.zeros_like

    def both(torque: Array) -> Array:
        return linear(torque) + networks(torque)

    return both


def _product(matrix: Array) -> Motion | None:
    """Return the product with a matrix, None with zero; diagonal ones are the usual and take a third of the time."""
    if not matrix.any():
        return None
    diagonal = np.diag(matrix).copy()
    if np.count_nonzero(matrix) == np.count_nonzero(diagonal):
        return partial(np.multiply, diagonal)
    return matrix.dot


def _with_others(together: Motion, offset: Array, curved: Sequence[tuple[slice, Law]], row: Row) -> Motion:
    """Return the map with what the other laws give in a row."""

    def everything(torque: Array) -> Array:
        found = together(torque)
        found += offset
        for here, law in curved:
            found[here] += law.twist(-torque[here], row)
        return found

    return everything
