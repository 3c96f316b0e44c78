"""How an arm responds in some rows by Pinocchio alone: what the engine says of them is compared with it.

The model has a free-flyer that does not move at every place where a twist may be inserted. With J the Jacobian of an
end, C the laws' tangent, G the geometric stiffness and E the derivative of exp6, all of them about the loaded arm,

    per law change      B = J_F E (I + C G_FF E)^-1       F: the flexures' coordinates
    per body motion x   J_x - B C G_Fx                    joints and every site, loads redistributing
    per wrench at a link with Jacobian K: B C K_F', and per change of gravity B C m (J_com)_F'

Of an arm with loops `Mechanism.linear` has the same, and how it answers to what opens them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from armflex import Arm, Payload, Wrench
from armflex.mechanics.equilibrium import Equilibrium, find_equilibrium
from armflex.mechanics.loaded import LoadedArm
from armflex.mechanics.mechanism import Mechanism, Placed
from armflex.mechanics.pinocchio_model import BASE_AXES, LoadCase, build_model, carrying, frame_jacobian
from armflex.mechanics.ties import Ties
from armflex.robot import Site


@dataclass(frozen=True)
class Linearised:
    """Arrays of M rows; ends are the links and, last, the tip.

    Attributes:
        loaded: The arm with its payload.
        founds: Where it rests.
        tangents: (M, n, 6, 6) of the laws.
        arrays: poses (l + 1, 4, 4), jacobians (l + 1, 6, v), laws (v, 6 n), by_load (v, v), by_gap (v, 6 K),
            by_pin (v, 6 P), turned (v, v), ways (6 K, v), weighed (v, 3), loads (s, 6), each with a leading M.
        places: Velocities of the joints, and of the sites.
    """

    loaded: LoadedArm
    founds: list[Equilibrium]
    tangents: np.ndarray
    arrays: tuple[np.ndarray, ...]
    places: tuple[np.ndarray, np.ndarray]

    def response(self, end: str | None) -> dict[str, np.ndarray]:
        """Return what `Response` says of a link's origin, of the tip for None, by its names."""
        poses, jacobians, laws, by_load, by_gap, by_pin, turned, ways, weighed, loads = self.arrays
        linkage, flexures, count = self.loaded.arm.robot.linkage, self.loaded.flex.flexure_v, len(self.founds)
        place = -1 if end is None else self.loaded.links.index(end)
        moved = jacobians[:, place]
        per_law, per_load, per_gap = moved @ laws, moved @ by_load, moved @ by_gap

        def motion(some: np.ndarray) -> np.ndarray:
            return moved[:, :, some] - per_load @ turned[:, :, some] - per_gap @ ways[:, :, some]

        lengths = 6 * (len(linkage.loops) + np.arange(len(linkage.cylinders)))
        by_law = per_law.reshape(count, 6, -1, 6)
        wrenches = [-one.placed.torque[flexures].reshape(-1, 6) for one in self.founds]
        return {
            "flexure_wrenches": np.array(wrenches),
            "flexure_twists": np.array([one.placed.motion[flexures] for one in self.founds]),
            "laws": by_law,
            "per_load": np.einsum("mbni,mnij->mbnj", by_law, self.tangents),
            "tip": poses[:, place],
            "links": poses[:, :-1],
            "joints": np.concatenate([motion(self.places[0]), per_gap[:, :, lengths]], axis=2),
            "twists": np.concatenate([motion(self.places[1]), per_gap, moved @ by_pin], axis=2).reshape(
                count, 6, -1, 6
            ),
            "wrenches": loads,
            "link_loads": per_load[:, None] @ np.swapaxes(jacobians[:, :-1], 2, 3),
            "gravity": per_load @ weighed,
        }


def linearised_rows(arm: Arm, q: np.ndarray, payload: str | Payload, wrenches: Sequence[Wrench] = ()) -> Linearised:
    """Return an arm linearised where it rests at (M, nq) joint positions under loads that are the same in all."""
    loaded = arm.loaded(payload)
    probed, probed_v = _probed(loaded)
    cases = [LoadCase(row, wrenches=tuple(wrenches)) for row in q]
    founds = [find_equilibrium(loaded, case, "newton") for case in cases]
    tangents = np.array([_tangents(one) for one in founds])
    rows = [
        _row(loaded, probed, probed_v, one, tangent, case)
        for one, tangent, case in zip(founds, tangents, cases, strict=True)
    ]
    arrays = tuple(np.array(part) for part in zip(*rows, strict=True))
    return Linearised(loaded, founds, tangents, arrays, (probed.flex.v_index, probed_v))


def _tangents(found: Equilibrium) -> np.ndarray:
    """Return the (n, 6, 6) derivative of every flexure's twist by its load."""
    laws = found.loaded.arm.stack.laws
    return np.array([law.tangent(load, found.row) for law, load in zip(laws, found.rest.loads, strict=True)])


def _probed(loaded: LoadedArm) -> tuple:
    """Return Pinocchio's arm with a free-flyer, which does not move, at each of its sites, and their velocities."""
    robot, own, arm = loaded.robot, list(loaded.arm.sites), loaded.arm
    end, places = robot.chain[-1].name, [Site("base", None)]
    for joint in robot.jointed:
        places += [Site(f"link:{joint.name}", joint.name, True), Site(joint.name, joint.name)]
    last, numbers = {site.joint: i for i, site in enumerate(own) if not site.before}, []
    for place in (*places, Site("tool", end)):
        apart = place.before or (place.name == "tool" and robot.chain[-1] in robot.jointed)
        numbers.append(len(own) if apart else last.get(place.joint, len(own)))
        if numbers[-1] == len(own):
            own.append(replace(place, name=f"probe:{place.name}"))
    flex = carrying(build_model(robot, own, arm.corrections), loaded.payload.body, robot.gravity)
    at_sites = flex.flexure_v.reshape(-1, 6)[numbers].ravel()
    return loaded.mechanism(replace(flex, flexure_v=flex.flexure_v[: 6 * len(arm.sites)])), at_sites


def _row(loaded: LoadedArm, probed, probed_v: np.ndarray, found: Equilibrium, tangent: np.ndarray, case: LoadCase):
    """Return the arrays of one row; see `Linearised`."""
    own, model, data, flex, nv = loaded.mechanics.flex, probed.model, probed.data, probed.flex, probed.model.nv
    ends = [*(own.frame(name) for name in loaded.links), own.tip]
    flexures, linkage = flex.flexure_v, loaded.arm.robot.linkage
    n, motion = len(flexures), np.zeros(flex.size)
    motion[flexures] = found.placed.motion[own.flexure_v]
    if linkage:
        configuration, answers, loads = _closed(loaded, probed, found, motion, case)
    else:
        configuration = probed.flexed(probed.rigid_configuration(case.q), motion)
        loads, turned = -probed.load(case)(configuration), probed.stiffness(configuration, case)
        among, (bodily, law) = np.ix_(flexures, flexures), np.zeros((2, n, n))
        for number, part in enumerate(exponential_jacobian(motion[flexures].reshape(-1, 6))):
            some = slice(6 * number, 6 * number + 6)
            bodily[some, some], law[some, some] = part, tangent[number]
        by_law, by_load, none = np.zeros((nv, n)), np.zeros((nv, nv)), np.zeros((nv, 0))
        by_law[flexures] = np.linalg.solve((np.eye(n) + law @ turned[among] @ bodily).T, bodily.T).T
        by_load[among] = by_law[flexures] @ law
        answers = by_law, by_load, none, none, turned, none.T
    weighed = pin.computeTotalMass(model) * pin.jacobianCenterOfMass(model, data, configuration).reshape(3, nv).T
    pin.framesForwardKinematics(model, data, configuration)
    poses = np.array([data.oMf[frame].homogeneous for frame in ends])
    jacobians = np.array([frame_jacobian(model, data, configuration, frame, BASE_AXES) for frame in ends])
    # A pin bears what its closure does.
    borne = np.concatenate([loads[probed_v], loads[nv:], np.zeros(6 * len(linkage.pins))]).reshape(-1, 6)
    return poses, jacobians, *answers, weighed, borne


def _closed(loaded: LoadedArm, probed: Mechanism, found: Equilibrium, motion: np.ndarray, case: LoadCase) -> tuple:
    """Return the configuration of a mechanism, its `laws` to `ways` of `Linearised`, and its (size,) loads."""
    mechanics, row, nv = loaded.mechanics, loaded.row(case.q, case.covariates), probed.model.nv
    motion[nv:], torque = found.placed.motion[mechanics.model.nv :], np.zeros(probed.flex.size)
    rigid = probed.true.configuration(case.q, found.rest.flexed)
    configuration = probed.flexed(rigid, motion)
    torque[nv:] = found.placed.torque[mechanics.model.nv :]
    at = Placed(case, row, rigid, motion, torque, configuration)
    torque[:nv] = probed.held(at)
    linear = probed.linear(at, mechanics.idle(case, row))
    turned, opened = _pins(probed.tied, -torque[nv:])
    by_pin = -linear.by_load @ turned - linear.by_gap @ opened
    by_gap, ways = linear.by_gap @ linear.rows, linear.rows.T @ linear.ways
    return configuration, (linear.by_law, linear.by_load, by_gap, by_pin, linear.turned, ways), -torque


def _pins(ties: Ties, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (nv, 6 P) changes of torques and (m, 6 P) of gaps per twist of a pin's frame on its link.

    Pins are those of `Linkage.pins`, twists in the axes of the link. All must have been placed.
    """
    jacobian, torques, gaps, row = ties.data.J.reshape(6, ties.model.nv), [], [], 0
    for k, one in enumerate(ties.joined):
        closed, shift = one.place()[1], one.shift(forces[6 * k : 6 * k + 6])
        sign = one.ends[1].moved - one.ends[0].moved
        for end, side, change in zip(one.ends, (-1.0, 1.0), (shift.by_first, shift.by_second), strict=True):
            turn, screw = end.turn @ end.axes, np.zeros((6, 6))
            screw[:3, :3] = screw[3:, 3:] = turn
            screw[:3, 3:] = pin.skew(end.here) @ turn
            torques.append(sign[:, None] * (jacobian.T @ (change @ screw)))
            gap = np.zeros((len(ties.rows), 6))
            gap[row : row + len(closed)] = side * closed @ screw
            gaps.append(gap)
        row += len(closed)
    nothing = np.zeros((ties.model.nv, 0)), np.zeros((len(ties.rows), 0))
    return np.concatenate([nothing[0], *torques], axis=1), np.concatenate([nothing[1], *gaps], axis=1)


def exponential_jacobian(twists: np.ndarray) -> np.ndarray:
    """Return the (..., 6, 6) body motion per change of (..., 6) exponential coordinates; Pinocchio's is good to 7e-9.

    The series `sum (-ad)^k / (k + 1)!` of the right Jacobian of SE(3) (Barfoot, State Estimation for Robotics, 7.83),
    which ends below rounding for turns of a radian.
    """
    turning, found = np.zeros((*twists.shape, 6)), np.eye(6)
    for place in ((0, 0), (1, 1), (0, 1)):
        vector = twists[..., 3:] if place[0] == place[1] else twists[..., :3]
        skew = np.cross(vector[..., None, :], np.eye(3)).swapaxes(-1, -2)
        turning[..., 3 * place[0] : 3 * place[0] + 3, 3 * place[1] : 3 * place[1] + 3] = skew
    for k in range(20, 0, -1):
        found = np.eye(6) - turning @ found / (k + 1)
    return found
