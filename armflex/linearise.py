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
from armflex.equilibrium import Equilibrium, LawStack, find_equilibrium
from armflex.laws import Row
from armflex.loads import Payload
from armflex.mechanics import LoadCase, Mechanics
from armflex.robot import FlexModel, Site, build_model

Progress = Callable[[int, int], None]


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
    ) -> Linearisation:
        """Return the linearisation at (N, nq) joint positions with a payload each, and (N,) covariates by name."""
        parts = []
        for i, (position, payload) in enumerate(zip(q, payloads, strict=True)):
            known = {name: values[i] for name, values in (covariates or {}).items()}
            parts.append(self._row(position, self.arm.payload(payload), known))
            if progress:
                progress(i + 1, len(q))
        models = self._model(self.arm.payload(payloads[0]))
        stacked = {key: np.array([part[key] for part in parts]) for key in parts[0]}
        row = Row(q, self._joint_index, covariates or {})
        return Linearisation(models.site_names, row=row, link_names=models.sited.flex.links, **stacked)

    def _model(self, payload: Payload) -> _Models:
        key = (payload.mass, tuple(payload.com))
        if key not in self._models:
            known = next(iter(self._models.values()), None)
            self._models[key] = _build(self.arm, payload, known)
        return self._models[key]

    def _row(self, q: Array, payload: Payload, known: Mapping[str, Array]) -> dict[str, Array]:
        models = self._model(payload)
        row = Row(q, self._joint_index, {"payload_mass": np.asarray(payload.mass), **known})
        case = LoadCase(q, wrenches=self.arm.pulls)
        found = find_equilibrium(models.mechanics, self.arm.stack, case, row)
        return _answers(models, self.arm.stack, row, case, found)


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


def _answers(models: _Models, stack: LawStack, row: Row, case: LoadCase, found: Equilibrium) -> dict[str, Array]:
    sited, large, twists, wrenches = models.sited, models.sited.flex, found.twists, found.wrenches
    bent, exponential = _bend(models, case.q, twists)
    torque = np.array(sited.torque(bent, case))
    geometric = sited.stiffness(bent, case)[models.flexures]
    tip = sited.tip_jacobian(bent)
    pin.framesForwardKinematics(large.model, sited.data, bent)
    turns = models.turns()
    law = stack.tangent(wrenches, row)
    tangent = np.eye(len(twists)) + law @ geometric[:, models.flexures] @ exponential
    per_law = np.linalg.solve(tangent.T, (tip[:, models.flexures] @ exponential).T).T
    per_load = per_law @ law
    answer = tip - per_load @ geometric
    links, link_loads = _links(models, bent, per_load)
    n = len(models.flexures) // 6
    return {
        "tip": sited.data.oMf[large.tip].homogeneous,
        "joints": answer[:, large.v_index],
        "twists": (answer[:, models.places].transpose(1, 0, 2) @ turns).transpose(1, 0, 2),
        "laws": per_law.reshape(6, n, 6),
        "per_load": per_load.reshape(6, n, 6),
        "wrenches": -(turns.transpose(0, 2, 1) @ torque[models.places][:, :, None])[:, :, 0],
        "flexure_wrenches": wrenches.reshape(n, 6),
        "links": links,
        "link_loads": link_loads,
        "gravity": _gravity(models, bent, per_load),
    }


def _bend(models: _Models, q: Array, twists: Array) -> tuple[Array, Array]:
    """Return the large model's configuration and the (6 n, 6 n) right Jacobian of the flexures' exponential."""
    large, model = models.sited.flex, models.sited.flex.model
    straight = large.neutral.copy()
    straight[large.q_index] = q
    velocity = np.zeros(model.nv)
    velocity[models.flexures] = twists
    whole = pin.dIntegrate(model, straight, velocity, pin.ArgumentPosition.ARG1)
    return pin.integrate(model, straight, velocity), whole[np.ix_(models.flexures, models.flexures)]


def _links(models: _Models, bent: Array, per_load: Array) -> tuple[Array, Array]:
    """Return every link's (4, 4) pose and the (6, 6) tip motion per wrench at its origin in base axes."""
    large, model, data = models.sited.flex, models.sited.flex.model, models.sited.data
    pin.computeJointJacobians(model, data, bent)
    pin.updateFramePlacements(model, data)
    frames = [large.frame(link) for link in large.links]
    poses = np.array([data.oMf[frame].homogeneous for frame in frames])
    jacobians = [pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED) for frame in frames]
    return poses, np.array([per_load @ jacobian[:, models.flexures].T for jacobian in jacobians])


def _gravity(models: _Models, bent: Array, per_load: Array) -> Array:
    """Return the (6, 3) tip motion per change of gravity; loads are linear in gravity, so three weighings do."""
    columns = []
    for model in models.weighing:
        columns.append(-pin.computeGeneralizedGravity(model, models.sited.data, bent)[models.flexures])
    return per_load @ np.array(columns).T
