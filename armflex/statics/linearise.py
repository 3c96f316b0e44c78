"""How the tip of a loaded arm answers to small twists, changed laws and added loads, row by row.

Everything an arm does beyond its model is a small twist at a place or a load on a link. Both change the loads on the
flexures as well, so their effect on the tip goes through the equilibrium. With J the tip's Jacobian, C the laws'
tangent, G the geometric stiffness and M = I + C G J_exp the equilibrium's tangent,

    tip per law change   B = J_F M^-1
    tip per body twist   A = J - B C G        (joints and every site, loads redistributing)
    tip per load change  B C                  (change of the flexures' wrenches)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.laws import Row
from armflex.robot import FlexModel, Site, build_model
from armflex.statics.equilibria import find_equilibria
from armflex.statics.loads import Payload
from armflex.statics.mechanics import LoadCase, Mechanics

Progress = Callable[[int, int], None]

CHUNK = 256
"""Rows at a time: each takes a few hundred kilobytes on the way."""


@dataclass(frozen=True)
class Linearisation:
    """An arm solved at N rows, and the tip's answers; all motions of the tip are at its origin in base axes.

    Attributes:
        sites: Names of the sites in order: 'base', 'link:A2' (before A2's motion), 'A2' (after it), ..., 'tool'.
        row: What was known in the rows: joint positions and covariates.
        tip: (N, 4, 4) tip pose in the base.
        joints: (N, 6, nq) per joint, loads redistributing.
        twists: (N, 6, s, 6) per body twist at a site, loads redistributing.
        laws: (N, 6, n, 6) per change of a flexure's twist law.
        per_load: (N, 6, n, 6) per change of a flexure's wrench.
        wrenches: (N, s, 6) load on the structure at every site, local axes.
        flexure_wrenches: (N, n, 6) the same at the flexures.
        flexure_twists: (N, 6 n) what the flexures do under them.
        links: (N, l, 4, 4) pose of every link that `link_names` lists.
        link_names: Links at and beyond the base.
        link_loads: (N, l, 6, 6) tip motion per wrench at a link's origin, base axes.
        gravity: (N, 6, 3) tip motion per change of gravity in base axes [per m/s^2].
    """

    sites: tuple[str, ...]
    row: Row
    tip: Array
    joints: Array
    twists: Array
    laws: Array
    per_load: Array
    wrenches: Array
    flexure_wrenches: Array
    flexure_twists: Array
    links: Array
    link_names: tuple[str, ...]
    link_loads: Array
    gravity: Array

    def site(self, name: str) -> Array:
        """Return the (N, 6, 6) answer of the tip to a body twist at a site."""
        return self.twists[:, :, self.sites.index(name), :]

    def load_at(self, name: str) -> Array:
        """Return the (N, 6) wrench at a site, local axes."""
        return self.wrenches[:, self.sites.index(name)]


class Linearizer:
    """Solves and linearises one arm; keeps the models of each payload."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self._joint_index = {name: i for i, name in enumerate(arm.joint_names)}
        self._models: dict[tuple, _Models] = {}

    def rows(
        self,
        q: Array,
        payloads: Sequence[str],
        covariates: Mapping[str, Array] | None = None,
        progress: Progress | None = None,
        start: Array | None = None,
    ) -> Linearisation:
        """Return the linearisation at (N, nq) joint positions with a payload each, and (N,) covariates by name.

        `start` are (N, 6 n) twists of the flexures near those at rest, where known.
        """
        known = {name: np.asarray(values) for name, values in (covariates or {}).items()}
        bodies = [self.arm.payload(payload) for payload in payloads]
        models = [self._model(body) for body in bodies]
        row = Row(q, self._joint_index, {"payload_mass": np.array([body.mass for body in bodies]), **known})
        parts = []
        for first in range(0, len(q), CHUNK):
            some = np.arange(first, min(first + CHUNK, len(q)))
            before = None if start is None else start[some]
            parts.append(self._chunk(q[some], models[first : first + CHUNK], row.some(some), before))
            if progress:
                progress(int(some[-1]) + 1, len(q))
        stacked = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
        names, links = models[0].site_names, models[0].sited.flex.links
        return Linearisation(names, row=Row(q, self._joint_index, known), link_names=links, **stacked)

    def _chunk(self, q: Array, models: Sequence[_Models], row: Row, start: Array | None) -> dict[str, Array]:
        stack = self.arm.stack
        cases = [LoadCase(position, wrenches=self.arm.pulls) for position in q]
        found = find_equilibria([one.mechanics for one in models], stack, cases, row, start)
        seen = [_pose(one, case, twists) for one, case, twists in zip(models, cases, found.twists, strict=True)]
        posed = {key: np.array([one[key] for one in seen]) for key in seen[0]}
        return _answers(models[0], stack.tangent(found.wrenches, row), posed) | {
            "tip": posed["tip"],
            "links": posed["links"],
            "flexure_twists": found.twists,
            "flexure_wrenches": found.wrenches.reshape(len(q), -1, 6),
        }

    def _model(self, payload: Payload) -> _Models:
        key = (payload.mass, tuple(payload.com))
        if key not in self._models:
            known = next(iter(self._models.values()), None)
            self._models[key] = _build(self.arm, payload, known)
        return self._models[key]


@dataclass(frozen=True)
class _Models:
    """Models of an arm with one payload.

    The second has a free-flyer at every joint, at the base and at the tool. What moves the same bodies needs no
    free-flyer of its own: the end of a link, before its end joint's motion, goes by the joint's.

    Attributes:
        mechanics: With the arm's flexures alone, to solve.
        sited: With all free-flyers, to linearise.
        flexures: (6 n,) places of the arm's flexures in the second.
        bearing: For every site, the Pinocchio joint that moves its bodies.
        joints: For every site, the Pinocchio joint whose origin frame it is in, 0 where it is in its bearer's.
        zeros: For those joints, the origin frame before the joint's offset.
    """

    mechanics: Mechanics
    sited: Mechanics
    flexures: np.ndarray
    site_names: tuple[str, ...]
    bearing: tuple[int, ...]
    joints: tuple[int, ...]
    zeros: Mapping[int, pin.SE3]

    @cached_property
    def weighing(self) -> tuple[pin.Model, ...]:
        """The same model under 1 m/s^2 along each axis."""
        models = []
        for axis in np.eye(3):
            model = pin.Model(self.sited.flex.model)
            model.gravity.linear = axis
            models.append(model)
        return tuple(models)

    @cached_property
    def frames(self) -> tuple[int, ...]:
        """Frames of the links, whose names are looked up once."""
        return tuple(self.sited.flex.frame(link) for link in self.sited.flex.links)

    @cached_property
    def places(self) -> np.ndarray:
        """(s, 6) places of the bearers' twists."""
        starts = [self.sited.flex.model.joints[joint].idx_v for joint in self.bearing]
        return np.array([[start + axis for axis in range(6)] for start in starts])

    def turns(self) -> Array:
        """Return (s, 6, 6): a twist of the bearer per twist at the site, at the configuration last computed."""
        model, data = self.sited.flex.model, self.sited.data
        actions = np.broadcast_to(np.eye(6), (len(self.bearing), 6, 6)).copy()
        for i, (bearer, joint) in enumerate(zip(self.bearing, self.joints, strict=True)):
            if joint:
                origin = data.oMi[model.parents[joint]] * model.jointPlacements[joint] * self.zeros[joint]
                actions[i] = data.oMi[bearer].actInv(origin).action
        return actions


def _build(arm: Arm, payload: Payload, like: _Models | None) -> _Models:
    body = payload.body if payload.mass else None
    flexures = [replace(flexure.site, name=f"flexure {flexure.name}") for flexure in arm.modelled]
    borne = {(site.joint, site.before): site for site in flexures}
    last = arm.robot.chain[-1].name
    wanted = [("base", None), *((name, name) for name in arm.joint_names), ("tool", last)]
    extra = [
        Site(f"site {name}", joint)
        for name, joint in wanted
        if (joint, False) not in borne or (name == "tool" and last in arm.joint_names)
    ]
    rigid = build_model(arm.robot, (), body)
    small = Mechanics(rigid, build_model(arm.robot, flexures, body, arm.corrections))
    large = build_model(arm.robot, [*flexures, *extra], body, arm.corrections)
    # The workspace of a model of a hundred freedoms takes longer to make than ten rows to compute.
    sited = Mechanics(rigid, large) if like is None else replace(like.sited, rigid=rigid, flex=large)
    names, bearing, joints = _bearers(arm, [*flexures, *extra], large)
    moving = {large.model.getJointId(joint.name): joint for joint in arm.robot.moving}
    zeros = {number: arm.corrections.zero(joint).inverse() for number, joint in moving.items()}
    return _Models(small, sited, large.flexure_v[: 6 * len(flexures)], names, bearing, joints, zeros)


def _bearers(
    arm: Arm, sites: Sequence[Site], large: FlexModel
) -> tuple[tuple[str, ...], tuple[int, ...], tuple[int, ...]]:
    """Return every site's name, the Pinocchio joint that moves its bodies, and the joint whose origin it is at."""
    number = {site.name: large.model.getJointId(f"flexure:{site.name}") for site in sites}
    at = {site.joint: number[site.name] for site in sites if not site.before and site.name != "site tool"}
    last = arm.robot.chain[-1].name
    names, bearing, joints = ["base"], [at[None]], [0]
    for joint in arm.joint_names:
        names += [f"link:{joint}", joint]
        bearing += [at[joint], at[joint]]
        joints += [large.model.getJointId(joint), 0]
    tool = number.get("site tool", at.get(last))
    return (*names, "tool"), (*bearing, tool), (*joints, 0)


def _pose(models: _Models, case: LoadCase, twists: Array) -> dict[str, Array]:
    """Return what Pinocchio says of the large model in one row, bent as it is at rest."""
    sited, large = models.sited, models.sited.flex
    bent, exponential = _bend(models, case.q, twists)
    torque = np.array(sited.torque(bent, case))
    geometric = sited.stiffness(bent, case)[models.flexures]
    gravity = [-pin.computeGeneralizedGravity(model, sited.data, bent)[models.flexures] for model in models.weighing]
    pin.computeJointJacobians(large.model, sited.data, bent)
    pin.updateFramePlacements(large.model, sited.data)
    return {
        "tip": sited.data.oMf[large.tip].homogeneous,
        "exponential": exponential,
        "torque": torque,
        "geometric": geometric,
        "gravity": np.array(gravity).T,
        "jacobian": _frame_jacobian(large, sited.data, large.tip),
        "turns": models.turns(),
        "links": np.array([sited.data.oMf[frame].homogeneous for frame in models.frames]),
        "at_links": np.array([_frame_jacobian(large, sited.data, f)[:, models.flexures] for f in models.frames]),
    }


def _frame_jacobian(flex: FlexModel, data: pin.Data, frame: int) -> Array:
    return pin.getFrameJacobian(flex.model, data, frame, pin.LOCAL_WORLD_ALIGNED)


def _answers(models: _Models, law: Array, posed: Mapping[str, Array]) -> dict[str, Array]:
    """Return the tip's answers in M rows from the laws' (M, 6 n, 6 n) tangents and what `_pose` found."""
    flexures, places = models.flexures, models.places
    exponential, geometric, tip = posed["exponential"], posed["geometric"], posed["jacobian"]
    tangent = np.eye(len(flexures)) + law @ (geometric[:, :, flexures] @ exponential)
    per_law = _transposed(np.linalg.solve(_transposed(tangent), _transposed(tip[:, :, flexures] @ exponential)))
    per_load = per_law @ law
    answer = tip - per_load @ geometric
    rows, n = len(law), len(flexures) // 6
    return {
        "joints": answer[:, :, models.sited.flex.v_index],
        "twists": (answer[:, :, places].transpose(0, 2, 1, 3) @ posed["turns"]).transpose(0, 2, 1, 3),
        "laws": per_law.reshape(rows, 6, n, 6),
        "per_load": per_load.reshape(rows, 6, n, 6),
        "wrenches": -(_transposed(posed["turns"]) @ posed["torque"][:, places][..., None])[..., 0],
        "link_loads": per_load[:, None] @ _transposed(posed["at_links"]),
        "gravity": per_load @ posed["gravity"],
    }


def _transposed(matrices: Array) -> Array:
    return np.swapaxes(matrices, -1, -2)


def _bend(models: _Models, q: Array, twists: Array) -> tuple[Array, Array]:
    """Return the large model's configuration and the (6 n, 6 n) right Jacobian of the flexures' exponential."""
    large, model = models.sited.flex, models.sited.flex.model
    straight = large.neutral.copy()
    straight[large.q_index] = q
    velocity = np.zeros(model.nv)
    velocity[models.flexures] = twists
    whole = pin.dIntegrate(model, straight, velocity, pin.ArgumentPosition.ARG1)
    return pin.integrate(model, straight, velocity), whole[np.ix_(models.flexures, models.flexures)]
