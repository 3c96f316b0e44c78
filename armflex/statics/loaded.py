"""An arm with one payload: its models, its laws where the models have them, and the proof that it stays."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from armflex.arm_doubts import payload_doubts
from armflex.batch.chain import Chain, chain_of
from armflex.conventions import Array
from armflex.errors import Flag
from armflex.laws import Row
from armflex.robot import build_model
from armflex.statics.law_stack import PlacedLaws
from armflex.statics.loads import Payload
from armflex.statics.mechanics import LoadCase, Mechanics
from armflex.statics.softening import Softening, bound_softening
from armflex.statics.solver import Solver

if TYPE_CHECKING:
    from armflex.arm import Arm


@dataclass(frozen=True, eq=False)
class LoadedArm:
    """What every question about an arm with a payload has in common. Shared between threads."""

    arm: Arm
    payload: Payload
    _local: threading.local = field(default_factory=threading.local, repr=False)

    def __reduce__(self) -> tuple:
        """Return what it is made of; a workspace belongs to its thread."""
        return _again, (self.arm, self.payload)

    @cached_property
    def mechanics(self) -> Mechanics:
        """Pinocchio models, rigid and flexible."""
        arm, body = self.arm, self.payload.body if self.payload.mass else None
        sites = [flexure.site for flexure in arm.modelled]
        return Mechanics(build_model(arm.robot, (), body), build_model(arm.robot, sites, body, arm.corrections))

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
        """How far the weight can soften the arm; None where a joint can go any way, or more than weight pulls."""
        robot, model = self.arm.robot, self.mechanics.flex.model
        ranges = {joint.name: (joint.lower, joint.upper) for joint in robot.moving}
        travel = {
            model.getJointId(joint.name): float(np.abs(ranges[joint.name]).max())
            for joint in robot.moving
            if joint.kind == "prismatic"
        }
        if self.arm.pulls or not np.isfinite(list(travel.values())).all():
            return None
        found = bound_softening(model, self.flexure_joints, self.arm.stack, ranges, travel)
        return found if np.isfinite(found.answer).all() else None

    @cached_property
    def flexure_joints(self) -> tuple[int, ...]:
        """Pinocchio joints of the flexures, in order."""
        starts = {joint.idx_v: joint.id for joint in self.mechanics.flex.model.joints if joint.nv == 6}
        return tuple(starts[place] for place in self.mechanics.flex.flexure_v[::6].tolist())

    @cached_property
    def chain(self) -> Chain:
        """The arm as arrays, for many configurations at once."""
        return chain_of(self.mechanics.flex, self.flexure_joints)

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
        return Row(q, self.arm.joint_index, {"payload_mass": np.asarray(self.payload.mass), **covariates})

    @cached_property
    def links(self) -> tuple[str, ...]:
        """Names of the links at and beyond the base."""
        return tuple(self.mechanics.flex.links)

    @cached_property
    def mass(self) -> float:
        """Of everything that moves, the payload included [kg]."""
        return float(pin.computeTotalMass(self.mechanics.rigid.model))


def _again(arm: Arm, payload: Payload) -> LoadedArm:
    return arm.loaded(payload)
