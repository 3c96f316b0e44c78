"""How the tip of a loaded arm answers to small twists, changed laws and added loads, row by row.

Everything an arm does beyond its model is a small twist at a place or a load on a link. Both change the loads on the
flexures as well, so their effect on the tip goes through the equilibrium. With J the tip's Jacobian, C the laws'
tangent, G the geometric stiffness and M = I + C G J_exp the equilibrium's tangent,

    tip per law change   B = J_F M^-1
    tip per body twist   A = J - B C G        (joints and every site, loads redistributing)
    tip per load change  B C                  (change of the flexures' wrenches)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.equilibrium import LawStack, find_equilibrium
from armflex.laws import Row
from armflex.loads import Payload
from armflex.mechanics import LoadCase, Mechanics
from armflex.robot import FlexModel, Site, build_model

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Sites:
    """Where a twist may be missing: base, every link's end, every joint, and the tool; `names` gives their order."""

    sites: tuple[Site, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names such as 'base', 'link:A2' (before A2's motion), 'A2' (after it), 'tool'."""
        return tuple(site.name for site in self.sites)


def all_sites(arm: Arm) -> Sites:
    """Return every site of an arm, from base to tool."""
    sites = [Site("base", None)]
    for joint in arm.joint_names:
        sites += [Site(f"link:{joint}", joint, before=True), Site(joint, joint)]
    return Sites((*sites, Site("tool", arm.robot.chain[-1].name)))


@dataclass(frozen=True)
class Linearisation:
    """An arm solved at N rows, and the tip's answers; all motions of the tip are at its origin in base axes.

    Attributes:
        sites: Names of the sites, in order.
        tip: (N, 4, 4) tip pose in the base.
        joints: (N, 6, nq) per joint, loads redistributing.
        twists: (N, 6, s, 6) per body twist at a site, loads redistributing.
        laws: (N, 6, n, 6) per change of a flexure's twist law.
        per_load: (N, 6, n, 6) per change of a flexure's wrench.
        wrenches: (N, s, 6) load on the structure at every site, local axes.
        flexure_wrenches: (N, n, 6) the same at the flexures.
        flexure_twists: (N, n, 6) the flexures' twists.
        tangents: (N, n, 6, 6) derivative of each flexure's twist with respect to its wrench.
        links: (N, l, 4, 4) pose of every link that `link_names` lists.
        link_names: Links at and beyond the base.
        link_loads: (N, l, 6, 6) tip motion per wrench at a link's origin, base axes.
        gravity: (N, 6, 3) tip motion per change of gravity in base axes [per m/s^2].
    """

    sites: tuple[str, ...]
    tip: Array
    joints: Array
    twists: Array
    laws: Array
    per_load: Array
    wrenches: Array
    flexure_wrenches: Array
    flexure_twists: Array
    tangents: Array
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

    def __init__(self, arm: Arm, sites: Sites | None = None) -> None:
        self.arm = arm
        self.sites = sites or all_sites(arm)
        self._models: dict[tuple, _Models] = {}

    def rows(self, q: Array, payloads: Sequence[str], progress: Progress | None = None) -> Linearisation:
        """Return the linearisation at (N, nq) joint positions with a payload each."""
        parts = []
        for i, (position, payload) in enumerate(zip(q, payloads, strict=True)):
            parts.append(self._row(position, self.arm.payload(payload)))
            if progress:
                progress(i + 1, len(q))
        names = self.sites.names
        links = self._model(self.arm.payload(payloads[0])).large.links
        stacked = {key: np.array([part[key] for part in parts]) for key in parts[0]}
        return Linearisation(sites=names, link_names=links, **stacked)

    def _model(self, payload: Payload) -> _Models:
        key = (payload.mass, tuple(payload.com))
        if key not in self._models:
            self._models[key] = _build(self.arm, self.sites, payload)
        return self._models[key]

    def _row(self, q: Array, payload: Payload) -> dict[str, Array]:
        models = self._model(payload)
        row = Row(q, {name: i for i, name in enumerate(self.arm.joint_names)})
        case = LoadCase(q)
        stack = self.arm.stack
        found = find_equilibrium(models.mechanics, stack, case, row)
        return _answers(models, stack, row, q, found.twists, found.wrenches)


@dataclass(frozen=True)
class _Models:
    mechanics: Mechanics
    large: FlexModel
    data: pin.Data
    flexures: np.ndarray
    sites: np.ndarray


def _build(arm: Arm, sites: Sites, payload: Payload) -> _Models:
    body = payload.body if payload.mass else None
    flexures = [Site(f"flexure {flexure.name}", flexure.joint) for flexure in arm.flexures]
    small = Mechanics(build_model(arm.robot, (), body), build_model(arm.robot, flexures, body, arm.corrections))
    large = build_model(arm.robot, [*flexures, *sites.sites], body, arm.corrections)
    split = 6 * len(flexures)
    places = large.flexure_v
    return _Models(small, large, large.model.createData(), places[:split], places[split:])


def _answers(models: _Models, stack: LawStack, row: Row, q: Array, twists: Array, wrenches: Array) -> dict[str, Array]:
    large, model, data = models.large, models.large.model, models.data
    bent, exponential = _bend(models, q, twists)
    torque = np.array(pin.computeGeneralizedGravity(model, data, bent))
    geometric = np.array(pin.computeGeneralizedGravityDerivatives(model, data, bent))[models.flexures]
    tip = pin.computeFrameJacobian(model, data, bent, large.tip, pin.LOCAL_WORLD_ALIGNED)
    law = stack.tangent(wrenches, row)
    tangent = np.eye(len(twists)) + law @ geometric[:, models.flexures] @ exponential
    per_law = np.linalg.solve(tangent.T, (tip[:, models.flexures] @ exponential).T).T
    per_load = per_law @ law
    answer = tip - per_load @ geometric
    links, link_loads = _links(models, bent, per_load)
    n, s = len(models.flexures) // 6, len(models.sites) // 6
    return {
        "tip": data.oMf[large.tip].homogeneous,
        "joints": answer[:, large.v_index],
        "twists": answer[:, models.sites].reshape(6, s, 6),
        "laws": per_law.reshape(6, n, 6),
        "per_load": per_load.reshape(6, n, 6),
        "wrenches": -torque[models.sites].reshape(s, 6),
        "flexure_wrenches": wrenches.reshape(n, 6),
        "flexure_twists": twists.reshape(n, 6),
        "tangents": np.array([law[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i in range(n)]).reshape(n, 6, 6),
        "links": links,
        "link_loads": link_loads,
        "gravity": _gravity(models, bent, per_load),
    }


def _bend(models: _Models, q: Array, twists: Array) -> tuple[Array, Array]:
    """Return the large model's configuration and the (6 n, 6 n) right Jacobian of the flexures' exponential."""
    model = models.large.model
    straight = models.large.neutral.copy()
    straight[models.large.q_index] = q
    velocity = np.zeros(model.nv)
    velocity[models.flexures] = twists
    whole = pin.dIntegrate(model, straight, velocity, pin.ArgumentPosition.ARG1)
    return pin.integrate(model, straight, velocity), whole[np.ix_(models.flexures, models.flexures)]


def _links(models: _Models, bent: Array, per_load: Array) -> tuple[Array, Array]:
    """Return every link's (4, 4) pose and the (6, 6) tip motion per wrench at its origin in base axes."""
    model, data = models.large.model, models.data
    pin.computeJointJacobians(model, data, bent)
    pin.updateFramePlacements(model, data)
    frames = [models.large.frame(link) for link in models.large.links]
    poses = np.array([data.oMf[frame].homogeneous for frame in frames])
    jacobians = [pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED) for frame in frames]
    return poses, np.array([per_load @ jacobian[:, models.flexures].T for jacobian in jacobians])


def _gravity(models: _Models, bent: Array, per_load: Array) -> Array:
    """Return the (6, 3) tip motion per change of gravity; loads are linear in gravity, so three weighings do."""
    model = pin.Model(models.large.model)
    columns = []
    for axis in np.eye(3):
        model.gravity.linear = axis
        columns.append(-pin.computeGeneralizedGravity(model, models.data, bent)[models.flexures])
    return per_load @ np.array(columns).T
