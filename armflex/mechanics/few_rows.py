"""How a tip responds in few rows, by Pinocchio: what `kernel` says of many, where to compile that would take longer.

The model has a free-flyer that does not move at every place where a twist may be inserted. With J the Jacobian of an
end, C the laws' tangent, G the geometric stiffness and E the derivative of exp6, all of them about the loaded arm,

    per law change      B = J_F E (I + C G_FF E)^-1       F: the flexures' coordinates
    per body motion x   J_x - B C G_Fx                    joints and every site, loads redistributing
    per wrench at a link with Jacobian K: B C K_F', and per change of gravity B C m (J_com)_F'
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.mechanics.equilibrium import Equilibrium
from armflex.mechanics.laws import LawStack
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.mechanism import Mechanism
from armflex.mechanics.pinocchio_model import (
    BASE_AXES,
    LoadCase,
    by_mass_centre,
    exponential_jacobian,
    frame_jacobian,
    place_frames,
)


@dataclass(frozen=True, eq=False)
class FewRows:
    """Some rows of one payload, linearised; ends are the links and, last, the tip.

    Attributes:
        loaded: The arm with the payload.
        rows: (M,) their numbers.
        tangents: (M, n, 6, 6) of the laws.
        poses: (M, l + 1, 4, 4) of the ends.
        jacobians: (M, l + 1, 6, v) motion of the ends' origins, base axes, per body motion of everything.
        following: (M, 6 n, 6 n) body motion of the flexures per change of their laws' twists.
        turned: (M, 6 n, v) change of the flexures' torques per body motion of everything.
        weighed: (M, 6 n, 3) loads on the flexures per gravity [per m/s^2].
        loads: (M, s, 6) on the structure at the sites.
    """

    loaded: LoadedArm
    rows: np.ndarray
    tangents: Array
    poses: Array
    jacobians: Array
    following: Array
    turned: Array
    weighed: Array
    loads: Array

    def among(self, number: np.ndarray) -> FewRows:
        """Return those of its rows that have a (N,) number, under these numbers; -1 is none."""
        return _among(self, number)

    def by_law(self, end: str | None, q: Array, twists: Array) -> Array:
        """Return the (M, 6, n, 6) motion of an end per change of a flexure's twist law; None is the tip."""
        places = self.loaded.probed.flex.flexure_v
        jacobian = self.jacobians[:, self._end(end)][:, :, places]
        return (jacobian @ self.following).reshape(len(self.rows), 6, -1, 6)

    def asked(self, what: str, end: str | None, q: Array, twists: Array, by_load: Array) -> Array:
        """Return one thing about the rows; see `Response`, whose members have these names.

        Args:
            what: "tip" (M, 1, 4, 4), "links" (M, l, 4, 4), "loads" (M, s, 6); or of an end "joints" (M, 6, nq), "sites"
                (M, 6, s, 6), "motions" (M, l, 6, 6), "gravity" (M, 6, 3).
            end: The link that is meant, None for the tip.
            q, twists: (M, nq) and (M, n, 6) of joints and flexures, which are known here.
            by_load: (M, 6, n, 6) motion of that end per change of a flexure's wrench.
        """
        if what in ("tip", "links"):
            return self.poses[:, -1:] if what == "tip" else self.poses[:, :-1]
        if what == "loads":
            return self.loads
        flex, count = self.loaded.probed.flex, len(self.rows)
        per_load = by_load.reshape(count, 6, -1)
        if what == "gravity":
            return per_load @ self.weighed
        if what == "motions":
            links = self.jacobians[:, :-1][..., flex.flexure_v]
            return per_load[:, None] @ np.swapaxes(links, 2, 3)
        places = flex.v_index if what == "joints" else self.loaded.probed_v
        found = self.jacobians[:, self._end(end)][:, :, places] - per_load @ self.turned[:, :, places]
        return found if what == "joints" else found.reshape(count, 6, -1, 6)

    def _end(self, end: str | None) -> int:
        return -1 if end is None else self.loaded.links.index(end)


def linearised(loaded: LoadedArm, rows: np.ndarray, case: LoadCase, twists: Array, tangents: Array) -> FewRows:
    """Return some rows linearised where the arm rests.

    Args:
        loaded: The arm with its payload.
        rows: (M,) numbers of the rows.
        case: What acts in each.
        twists: (M, 6 n) of the flexures.
        tangents: (M, n, 6, 6) of their laws there.
    """
    mechanics = loaded.probed
    model, data, flex = mechanics.model, mechanics.data, mechanics.flex
    count, flexures, ends = len(rows), flex.flexure_v, [*map(flex.frame, loaded.links), flex.tip]
    poses, jacobians = np.empty((count, len(ends), 4, 4)), np.empty((count, len(ends), 6, model.nv))
    turned, weighed = np.empty((count, len(flexures), model.nv)), np.empty((count, len(flexures), 3))
    loads, motion = np.empty((count, len(loaded.probed_v) // 6, 6)), np.zeros(model.nv)
    mass = pin.computeTotalMass(model)
    for i in range(count):
        one, motion[flexures] = case.some(i), twists[i]
        configuration = mechanics.flexed(mechanics.rigid_configuration(one.q), motion)
        loads[i] = -mechanics.load(one)(configuration)[loaded.probed_v].reshape(-1, 6)
        turned[i] = mechanics.stiffness(configuration, one)[flexures]
        weighed[i] = mass * by_mass_centre(model, data, configuration).T[flexures]
        place_frames(model, data, configuration)
        for k, frame in enumerate(ends):
            poses[i, k] = data.oMf[frame].homogeneous
            jacobians[i, k] = frame_jacobian(model, data, configuration, frame, BASE_AXES)
    bodily = _in_blocks(exponential_jacobian(twists.reshape(count, -1, 6)))
    tangent = np.eye(len(flexures)) + _in_blocks(tangents) @ turned[:, :, flexures] @ bodily
    following = np.empty_like(bodily)
    following[:] = np.linalg.solve(tangent.swapaxes(1, 2), bodily.swapaxes(1, 2)).swapaxes(1, 2)
    return FewRows(loaded, rows, tangents, poses, jacobians, following, turned, weighed, loads)


Linearised = TypeVar("Linearised", "FewRows", "MechanismRows")


def _among(rows: Linearised, number: np.ndarray) -> Linearised:
    """Return those rows that have a (N,) number, under these numbers; every array but their numbers has a row each."""
    own = np.flatnonzero(number[rows.rows] >= 0)
    some = {field.name: getattr(rows, field.name)[own] for field in fields(rows)[2:]}
    return replace(rows, rows=number[rows.rows[own]], **some)


@dataclass(frozen=True, eq=False)
class MechanismRows:
    """Some rows of one payload of an arm with loops, linearised: `FewRows`' questions, answered as `Linear` does.

    Attributes:
        loaded, rows, tangents, poses, jacobians, loads: As of `FewRows`; sites have the closures behind them.
        laws: (M, v, 6 n) body motion of everything per change of the flexures' laws.
        by_load: (M, v, v) per load on everything.
        by_motion: (M, v, v) per body motion of anything.
        by_gap: (M, v, 6 K) per twist in a closure.
        by_pin: (M, v, 6 P) per twist of a pin's frame on its link, in the axes of the link; see `Linkage.pins`.
        weighed: (M, v, 3) loads on everything per gravity [per m/s^2].
    """

    loaded: LoadedArm
    rows: np.ndarray
    tangents: Array
    poses: Array
    jacobians: Array
    laws: Array
    by_load: Array
    by_motion: Array
    by_gap: Array
    by_pin: Array
    weighed: Array
    loads: Array

    def among(self, number: np.ndarray) -> MechanismRows:
        """See `FewRows`."""
        return _among(self, number)

    def by_end(self, end: str | None) -> Array:
        """Return the (M, 6, v) motion of an end per body motion of everything; None is the tip."""
        return self.jacobians[:, -1 if end is None else self.loaded.links.index(end)]

    def by_law(self, end: str | None, q: Array, twists: Array) -> Array:
        """See `FewRows`."""
        return (self.by_end(end) @ self.laws).reshape(len(self.rows), 6, -1, 6)

    def asked(self, what: str, end: str | None, q: Array, twists: Array, by_load: Array) -> Array:
        """See `FewRows`."""
        if what in ("tip", "links"):
            return self.poses[:, -1:] if what == "tip" else self.poses[:, :-1]
        if what == "loads":
            return self.loads
        moved, count = self.by_end(end), len(self.rows)
        if what == "gravity":
            return moved @ self.by_load @ self.weighed
        if what == "motions":
            return (moved @ self.by_load)[:, None] @ np.swapaxes(self.jacobians[:, :-1], 2, 3)
        by_motion, by_gap, linkage = moved @ self.by_motion, moved @ self.by_gap, self.loaded.arm.robot.linkage
        if what == "joints":
            lengths = 6 * (len(linkage.loops) + np.arange(len(linkage.cylinders)))
            return np.concatenate([by_motion[:, :, self.loaded.probed.flex.v_index], by_gap[:, :, lengths]], axis=2)
        sites = by_motion[:, :, self.loaded.probed_v]
        return np.concatenate([sites, by_gap, moved @ self.by_pin], axis=2).reshape(count, 6, -1, 6)


def linearised_mechanism(
    loaded: LoadedArm, rows: np.ndarray, case: LoadCase, founds: Sequence[Equilibrium], tangents: Array
) -> MechanismRows:
    """Return some rows of an arm with loops linearised where it rests; arguments as of `linearised`."""
    mechanics, probed = loaded.mechanics, loaded.probed
    assert isinstance(mechanics, Mechanism) and isinstance(probed, Mechanism)
    model, data, flex, nv = probed.model, probed.data, probed.flex, probed.model.nv
    ends, parts = [*map(flex.frame, loaded.links), flex.tip], []
    own = mechanics.flex
    for i, found in enumerate(founds):
        assert found.torque is not None
        one, row = case.some(i), loaded.row(case.q[i], case.some(i).covariates)
        motion, torque = np.zeros(flex.size), np.zeros(flex.size)
        motion[flex.flexure_v], motion[nv:] = found.motion[own.flexure_v], found.motion[mechanics.model.nv :]
        free = mechanics.flexed(found.rigid, found.motion)[own.free_q]
        configuration = probed.flexed(probed.configuration(one.q, free), motion)
        torque[nv:] = found.torque[mechanics.model.nv :]
        torque[:nv] = probed.held(configuration, one, torque)
        linear = probed.linear(configuration, motion, torque, one, row, mechanics.idle(one, row))
        turned, opened = probed.tied.pins(-torque[nv:])
        by_pin = -linear.by_load @ turned - linear.by_gap @ opened
        weighed = pin.computeTotalMass(model) * by_mass_centre(model, data, configuration).T
        place_frames(model, data, configuration)
        poses = np.array([data.oMf[frame].homogeneous for frame in ends])
        jacobians = np.array([frame_jacobian(model, data, configuration, frame, BASE_AXES) for frame in ends])
        none = np.zeros(6 * len(loaded.arm.robot.linkage.pins))  # a pin bears what its closure does
        loads = -np.concatenate([torque[loaded.probed_v], torque[nv:], none]).reshape(-1, 6)
        by_gap, answers = linear.by_gap @ linear.rows, (linear.by_law, linear.by_load, linear.by_motion)
        parts.append((poses, jacobians, *answers, by_gap, by_pin, weighed, loads))
    return MechanismRows(loaded, rows, tangents, *map(np.array, zip(*parts, strict=True)))


def tangents_of(stack: LawStack, loaded: LoadedArm, case: LoadCase, loads: Array) -> Array:
    """Return the (M, n, 6, 6) tangents of the laws under (M, n, 6) loads in the rows of a case."""
    row = loaded.row(case.q, case.covariates)
    whole = stack.tangent(loads.reshape(len(loads), -1), row)
    n = loads.shape[1]
    return np.einsum("mkikj->mkij", whole.reshape(len(loads), n, 6, n, 6))


def _in_blocks(parts: Array) -> Array:
    """Return (M, 6 n, 6 n) block-diagonal matrices of (M, n, 6, 6)."""
    count, n = parts.shape[:2]
    found = np.zeros((count, n, 6, n, 6))
    np.einsum("mkikj->mkij", found)[:] = parts
    return found.reshape(count, 6 * n, 6 * n)
