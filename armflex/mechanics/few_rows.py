"""How a tip responds in few rows, by Pinocchio: what compiled code says of many, where to compile would take longer.

The model has a free-flyer that does not move at every place where a twist may be inserted. With J the Jacobian of an
end, C the laws' tangent, G the geometric stiffness and E the derivative of exp6, all of them about the loaded arm,

    per law change      B = J_F E (I + C G_FF E)^-1       F: the flexures' coordinates
    per body motion x   J_x - B C G_Fx                    joints and every site, loads redistributing
    per wrench at a link with Jacobian K: B C K_F', and per change of gravity B C m (J_com)_F'

Of an arm with loops `Mechanism.linear` has the same, and how it answers to what opens them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.mechanics.equilibrium import Equilibrium
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.mechanism import Mechanism
from armflex.mechanics.pinocchio_model import (
    BASE_AXES,
    LoadCase,
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
        laws: (M, v, 6 n) body motion of everything per change of the flexures' laws.
        by_load: (M, v, v) per load on everything.
        by_gap: (M, v, 6 K) per twist in a closure of a loop; K is 0 on a chain.
        by_pin: (M, v, 6 P) per twist of a pin's frame on its link, in the axes of the link; see `Linkage.pins`.
        turned: (M, v, v) change of the torques per body motion of everything.
        ways: (M, 6 K, v) what closures open by that.
        weighed: (M, v, 3) loads on everything per gravity [per m/s^2].
        loads: (M, s, 6) on the structure at the sites, and in closures and pins behind them.
    """

    loaded: LoadedArm
    rows: np.ndarray
    tangents: Array
    poses: Array
    jacobians: Array
    laws: Array
    by_load: Array
    by_gap: Array
    by_pin: Array
    turned: Array
    ways: Array
    weighed: Array
    loads: Array

    def among(self, number: np.ndarray) -> FewRows:
        """Return those of its rows that have a (N,) number, under these numbers; -1 is none."""
        own = np.flatnonzero(number[self.rows] >= 0)
        some = {field.name: getattr(self, field.name)[own] for field in fields(self)[2:]}
        return replace(self, rows=number[self.rows[own]], **some)

    def by_law(self, end: str | None, q: Array, twists: Array) -> Array:
        """Return the (M, 6, n, 6) motion of an end per change of a flexure's twist law; None is the tip."""
        return (self._by_end(end) @ self.laws).reshape(len(self.rows), 6, -1, 6)

    def asked(self, what: str, end: str | None, q: Array, twists: Array, by_load: Array) -> Array:
        """Return one thing about the rows; see `Response`, whose members have these names.

        Args:
            what: "tip" (M, 1, 4, 4), "links" (M, l, 4, 4), "loads" (M, s, 6); or of an end "joints" (M, 6, nq), "sites"
                (M, 6, s, 6), "motions" (M, l, 6, 6), "gravity" (M, 6, 3).
            end: The link that is meant, None for the tip.
            q, twists: (M, nq) and (M, n, 6) of joints and flexures, which are known here.
            by_load: (M, 6, n, 6) motion of that end per change of a flexure's wrench, which is known, too.
        """
        if what in ("tip", "links"):
            return self.poses[:, -1:] if what == "tip" else self.poses[:, :-1]
        if what == "loads":
            return self.loads
        moved, count, linkage = self._by_end(end), len(self.rows), self.loaded.arm.robot.linkage
        per_load, per_gap = moved @ self.by_load, moved @ self.by_gap
        if what == "gravity":
            return per_load @ self.weighed
        if what == "motions":
            return per_load[:, None] @ np.swapaxes(self.jacobians[:, :-1], 2, 3)
        places = self.loaded.probed.flex.v_index if what == "joints" else self.loaded.probed_v
        found = moved[:, :, places] - per_load @ self.turned[:, :, places] - per_gap @ self.ways[:, :, places]
        if what == "joints":
            lengths = 6 * (len(linkage.loops) + np.arange(len(linkage.cylinders)))
            return np.concatenate([found, per_gap[:, :, lengths]], axis=2)
        return np.concatenate([found, per_gap, moved @ self.by_pin], axis=2).reshape(count, 6, -1, 6)

    def _by_end(self, end: str | None) -> Array:
        return self.jacobians[:, -1 if end is None else self.loaded.links.index(end)]


def linearised(
    loaded: LoadedArm, rows: np.ndarray, case: LoadCase, founds: Sequence[Equilibrium], tangents: Array
) -> FewRows:
    """Return some rows linearised where the arm rests.

    Args:
        loaded: The arm with its payload.
        rows: (M,) numbers of the rows.
        case: What acts in each.
        founds: Where it rests in each.
        tangents: (M, n, 6, 6) of the flexures' laws there.
    """
    probed, own = loaded.probed, loaded.mechanics.flex
    model, data, flex, nv = probed.model, probed.data, probed.flex, probed.model.nv
    ends, flexures, linkage = [*map(flex.frame, loaded.links), flex.tip], flex.flexure_v, loaded.arm.robot.linkage
    mass, e, n, k, p = (pin.computeTotalMass(model), len(ends), len(flexures), len(linkage.closures), len(linkage.pins))
    shapes = [(e, 4, 4), (e, 6, nv), (nv, n), (nv, nv), (nv, 6 * k), (nv, 6 * p), (nv, nv), (6 * k, nv), (nv, 3)]
    arrays = [np.empty((len(rows), *shape)) for shape in (*shapes, (len(loaded.probed_v) // 6 + k + p, 6))]
    for i, found in enumerate(founds):
        one, motion = case.some(i), np.zeros(flex.size)
        motion[flexures] = found.motion[own.flexure_v]
        if isinstance(probed, Mechanism):
            configuration, answers, loads = _closed(loaded, probed, found, motion, one)
        else:
            configuration = probed.flexed(probed.rigid_configuration(one.q), motion)
            loads, turned = -probed.load(one)(configuration), probed.stiffness(configuration, one)
            among, (bodily, law) = np.ix_(flexures, flexures), np.zeros((2, n, n))
            for number, part in enumerate(exponential_jacobian(motion[flexures].reshape(-1, 6))):
                some = slice(6 * number, 6 * number + 6)
                bodily[some, some], law[some, some] = part, tangents[i, number]
            by_law, by_load, none = np.zeros((nv, n)), np.zeros((nv, nv)), np.zeros((nv, 0))
            tangent = np.eye(n) + law @ turned[among] @ bodily
            by_law[flexures] = np.linalg.solve(tangent.T, bodily.T).T
            by_load[among] = by_law[flexures] @ law
            answers = by_law, by_load, none, none, turned, none.T
        weighed = mass * pin.jacobianCenterOfMass(model, data, configuration).reshape(3, nv).T
        place_frames(model, data, configuration)
        poses = np.array([data.oMf[frame].homogeneous for frame in ends])
        jacobians = np.array([frame_jacobian(model, data, configuration, frame, BASE_AXES) for frame in ends])
        # A pin bears what its closure does.
        borne = np.concatenate([loads[loaded.probed_v], loads[nv:], np.zeros(6 * p)]).reshape(-1, 6)
        for into, values in zip(arrays, (poses, jacobians, *answers, weighed, borne), strict=True):
            into[i] = values
    return FewRows(loaded, rows, tangents, *arrays)


def _closed(
    loaded: LoadedArm, probed: Mechanism, found: Equilibrium, motion: Array, case: LoadCase
) -> tuple[Array, tuple[Array, ...], Array]:
    """Return the configuration of a mechanism, its `FewRows.laws` to `ways`, and its (size,) loads.

    Args:
        loaded: The arm with its payload.
        probed: Its model with places to insert twists at.
        found: Where it rests.
        motion: (size,) of that model, without what closures give: that is filled in.
        case: What acts.
    """
    mechanics, row, nv = loaded.mechanics, loaded.row(case.q, case.covariates), probed.model.nv
    assert isinstance(mechanics, Mechanism) and found.torque is not None
    motion[nv:], torque = found.motion[mechanics.model.nv :], np.zeros(probed.flex.size)
    free = mechanics.flexed(found.rigid, found.motion)[mechanics.flex.free_q]
    configuration = probed.flexed(probed.true.configuration(case.q, free), motion)
    torque[nv:] = found.torque[mechanics.model.nv :]
    torque[:nv] = probed.held(configuration, case, torque)
    linear = probed.linear(configuration, motion, torque, case, row, mechanics.idle(case, row))
    turned, opened = probed.tied.pins(-torque[nv:])
    by_pin = -linear.by_load @ turned - linear.by_gap @ opened
    by_gap, ways = linear.by_gap @ linear.rows, linear.rows.T @ linear.ways
    return configuration, (linear.by_law, linear.by_load, by_gap, by_pin, linear.turned, ways), -torque
