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
from armflex.robot import Site, build_model

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

    def __init__(self, arm: Arm, sites: Sites | None = None) -> None:
        self.arm = arm
        self.sites = sites or all_sites(arm)
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
        names = self.sites.names
        links = self._model(self.arm.payload(payloads[0])).sited.flex.links
        stacked = {key: np.array([part[key] for part in parts]) for key in parts[0]}
        return Linearisation(sites=names, link_names=links, row=Row(q, self._joint_index, covariates or {}), **stacked)

    def _model(self, payload: Payload) -> _Models:
        key = (payload.mass, tuple(payload.com))
        if key not in self._models:
            self._models[key] = _build(self.arm, self.sites, payload)
        return self._models[key]

    def _row(self, q: Array, payload: Payload, known: Mapping[str, Array]) -> dict[str, Array]:
        models = self._model(payload)
        row = Row(q, self._joint_index, {"payload_mass": np.asarray(payload.mass), **known})
        case = LoadCase(q, wrenches=self.arm.pulls)
        found = find_equilibrium(models.mechanics, self.arm.stack, case, row)
        return _answers(models, self.arm.stack, row, case, found)


@dataclass(frozen=True)
class _Models:
    mechanics: Mechanics
    sited: Mechanics
    flexures: np.ndarray
    sites: np.ndarray

    @cached_property
    def weighing(self) -> tuple[pin.Model, ...]:
        """The same model under 1 m/s^2 along each axis."""
        models = []
        for axis in np.eye(3):
            model = pin.Model(self.sited.flex.model)
            model.gravity.linear = axis
            models.append(model)
        return tuple(models)


def _build(arm: Arm, sites: Sites, payload: Payload) -> _Models:
    body = payload.body if payload.mass else None
    flexures = [replace(flexure.site, name=f"flexure {flexure.name}") for flexure in arm.modelled]
    rigid = build_model(arm.robot, (), body)
    small = Mechanics(rigid, build_model(arm.robot, flexures, body, arm.corrections))
    large = build_model(arm.robot, [*flexures, *sites.sites], body, arm.corrections)
    split = 6 * len(flexures)
    places = large.flexure_v
    return _Models(small, Mechanics(rigid, large), places[:split], places[split:])


def _answers(models: _Models, stack: LawStack, row: Row, case: LoadCase, found: Equilibrium) -> dict[str, Array]:
    sited, large, twists, wrenches = models.sited, models.sited.flex, found.twists, found.wrenches
    bent, exponential = _bend(models, case.q, twists)
    torque = np.array(sited.torque(bent, case))
    geometric = sited.stiffness(bent, case)[models.flexures]
    tip = sited.tip_jacobian(bent)
    law = stack.tangent(wrenches, row)
    tangent = np.eye(len(twists)) + law @ geometric[:, models.flexures] @ exponential
    per_law = np.linalg.solve(tangent.T, (tip[:, models.flexures] @ exponential).T).T
    per_load = per_law @ law
    answer = tip - per_load @ geometric
    links, link_loads = _links(models, bent, per_load)
    n, s = len(models.flexures) // 6, len(models.sites) // 6
    return {
        "tip": sited.data.oMf[large.tip].homogeneous,
        "joints": answer[:, large.v_index],
        "twists": answer[:, models.sites].reshape(6, s, 6),
        "laws": per_law.reshape(6, n, 6),
        "per_load": per_load.reshape(6, n, 6),
        "wrenches": -torque[models.sites].reshape(s, 6),
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
