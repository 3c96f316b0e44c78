"""An arm with one payload: its models, its laws where the models have them, and the proof that it stays."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin

from armflex.conventions import Array
from armflex.errors import Flag
from armflex.laws import Row
from armflex.laws.effects.scene import MASS
from armflex.mechanics.certificate import Softening, bound_softening
from armflex.mechanics.chain import Chain, Frames, chain_of, frames_of, link_frame
from armflex.mechanics.doubts import payload_doubts
from armflex.mechanics.laws import PlacedLaws
from armflex.mechanics.loads import Load, Payload
from armflex.mechanics.pinocchio_model import LoadCase, Mechanics
from armflex.mechanics.solver import Solver
from armflex.mechanics.structure import Structure
from armflex.robot import FlexModel, Site, build_model

TOOL = "what is at the tool"


@dataclass(frozen=True, eq=False)
class LoadedArm:
    """What every question about an arm with a payload has in common. Shared between threads."""

    arm: Structure
    payload: Payload
    _local: threading.local = field(default_factory=threading.local, repr=False)

    def __reduce__(self) -> tuple:
        """Return what it is made of; a workspace belongs to its thread."""
        return _again, (self.arm, self.payload)

    @cached_property
    def mechanics(self) -> Mechanics:
        """Pinocchio models, rigid and flexible."""
        return Mechanics(build_model(self.arm.robot, (), self._body), self._model())

    @property
    def _body(self) -> pin.Inertia | None:
        return self.payload.body if self.payload.mass else None

    def _model(self, *extra: Site) -> FlexModel:
        return build_model(self.arm.robot, (*self.arm.sites, *extra), self._body, self.arm.corrections)

    @cached_property
    def laws(self) -> PlacedLaws:
        """The arm's laws in Pinocchio's generalized velocities."""
        return self.arm.placed_laws(self.mechanics.flex)

    @cached_property
    def flags(self) -> tuple[Flag, ...]:
        """Doubts about the arm, and about its standing still with the payload."""
        return (*self.arm.flags, *payload_doubts(self.arm, self.payload, accelerated=False))

    @cached_property
    def softening(self) -> Softening | None:
        """How far the weight can soften the arm; None where nobody can say beforehand, see `softening_under`."""
        return self.softening_under(self.arm.pulls)

    def softening_under(self, loads: Sequence[Load]) -> Softening | None:
        """Return how far the weight and dead loads can soften the arm; None where a joint can go any way, or a load."""
        robot, model = self.arm.robot, self.mechanics.flex.model
        ranges = {joint.name: (joint.lower, joint.upper) for joint in robot.moving}
        travel = {
            model.getJointId(joint.name): float(np.abs(ranges[joint.name]).max())
            for joint in robot.moving
            if joint.kind == "prismatic"
        }
        if not (all(load.dead for load in loads) and np.isfinite(list(travel.values())).all()):
            return None
        dead = []
        for load in loads:
            _, joint, _, pose = link_frame(model, self.mechanics.flex.frame(load.frame))
            dead.append((joint, pose.translation, load.at(np.eye(4))))
        found = bound_softening(model, self.flexure_joints, self.arm.stack, ranges, travel, dead)
        return found if np.isfinite(found.answer).all() else None

    @cached_property
    def flexure_joints(self) -> tuple[int, ...]:
        """Pinocchio joints of the flexures, in order."""
        starts = {joint.idx_v: joint.id for joint in self.mechanics.flex.model.joints if joint.nv == 6}
        return tuple(starts[place] for place in self.mechanics.flex.flexure_v[::6].tolist())

    @cached_property
    def chain(self) -> Chain:
        """The arm as arrays, for compiled code."""
        return chain_of(self.mechanics.flex, self.flexure_joints)

    @cached_property
    def _with_tool(self) -> FlexModel:
        """The flexible model in which what is at the tool is a body of its own."""
        return self._model(Site(TOOL, self.arm.robot.chain[-1].name))

    @cached_property
    def sited_chain(self) -> Chain:
        """The same as `chain`, with an element more for what is at the tool."""
        return chain_of(self._with_tool, self.flexure_joints)

    @cached_property
    def sites(self) -> Frames:
        """Where twists may be inserted into `sited_chain`, from base to tool.

        A joint's site is outboard of its motion; where it gives it is its last flexure's. A link's is its end: the
        origin frame of the joint there, inboard of its motion, without the offset that calibration found.
        """
        model, arm, here = self._with_tool.model, self.arm, pin.SE3.Identity()
        last = {
            site.joint: joint for site, joint in zip(arm.sites, self.flexure_joints, strict=True) if not site.before
        }
        base = last.get(None, 0)
        found = [("base", base, base, here)]
        for joint in arm.robot.moving:
            k = model.getJointId(joint.name)
            origin = model.jointPlacements[k] * arm.corrections.zero(joint).inverse()
            number = last.get(joint.name, k)
            found += [(f"link:{joint.name}", k - 1, k, origin), (joint.name, number, number, here)]
        end = arm.robot.chain[-1].name
        tool = model.njoints - 1 if end in arm.joint_names else last.get(end, model.njoints - 1)
        return frames_of([*found, ("tool", tool, tool, here)])

    @cached_property
    def link_frames(self) -> Frames:
        """The links at and beyond the base, in `sited_chain`."""
        flex = self._with_tool
        return frames_of([link_frame(flex.model, flex.frame(link)) for link in flex.links])

    @cached_property
    def tip_frame(self) -> Frames:
        """The tip, in `sited_chain`."""
        return frames_of([link_frame(self._with_tool.model, self._with_tool.tip)])

    @cached_property
    def plain_link_frames(self) -> Frames:
        """The same in `chain`."""
        flex = self.mechanics.flex
        return frames_of([link_frame(flex.model, flex.frame(link)) for link in flex.links])

    @cached_property
    def nominal(self) -> Chain | None:
        """The rigid arm as the controller knows it, as arrays; None where corrections leave it where `chain` is."""
        if not self.arm.corrections.move:
            return None
        return chain_of(self.mechanics.rigid, ())

    @property
    def solver(self) -> Solver:
        """This thread's workspace."""
        try:
            return self._local.solver
        except AttributeError:
            self._local.solver = Solver(self.mechanics, self.laws)
            return self._local.solver

    def case(self, q: Array) -> LoadCase:
        """Return the arm standing still at (nq,) or (N, nq) positions under its own weight and what pulls at it."""
        return LoadCase(q, wrenches=self.arm.pulls)

    def row(self, q: Array, covariates: dict[str, Array]) -> Row:
        """Return what the laws may know at (nq,) or (N, nq) positions."""
        return Row(q, self.arm.joint_index, {MASS: np.asarray(self.payload.mass), **covariates})

    @cached_property
    def links(self) -> tuple[str, ...]:
        """Names of the links at and beyond the base."""
        return tuple(self.mechanics.flex.links)

    @cached_property
    def mass(self) -> float:
        """Of everything that moves, the payload included [kg]."""
        return float(pin.computeTotalMass(self.mechanics.rigid.model))


def _again(arm: Structure, payload: Payload) -> LoadedArm:
    return arm.loaded(payload)
