"""What mechanics knows of an arm, what it may carry, and both together: their models, and the proof that it stays."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.conventions import Array, finite_array
from armflex.errors import Flag, InputError, PayloadError, UnknownNameError
from armflex.laws import Row
from armflex.laws.effects.effect import Manipulator
from armflex.laws.row import MASS
from armflex.mechanics.certificate import StabilityBound, bound_stability
from armflex.mechanics.engine.tables import Frames, Tree
from armflex.mechanics.laws import LawStack
from armflex.mechanics.mechanism import Mechanism
from armflex.mechanics.pinocchio_model import FlexModel, Load, build_model, carrying
from armflex.mechanics.spring import Spring
from armflex.mechanics.ties import Ties
from armflex.mechanics.tree import frames_of, link_frame, tree_of
from armflex.robot import Corrections, Robot, Site
from armflex.robot.robot import MILLIMETRES
from armflex.rows.wrench import Wrench

TOOL = "what is at the tool"

FORCE_BAND = 10.0
"""External forces beyond this many times the arm's weight are flagged: kN or kgf given as N?"""

SAG_BAND = 0.1
"""Displacements beyond this fraction of the reach are flagged."""


@dataclass(frozen=True)
class Payload:
    """A body fixed to the tip.

    Attributes:
        mass: [kg], 0 or more.
        com: (3,) centre of mass in the tip frame [m].
        inertia: (6,) ixx iyy izz ixy ixz iyz about the centre of mass [kg m^2]; only motion needs it.

    Raises:
        PayloadError: Negative, not finite, or an inertia that no body has.
    """

    mass: float
    com: Array
    inertia: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", float(_vector(self.mass, "payload mass")))
        if self.mass < 0.0:
            raise PayloadError(f"payload mass is {self.mass}, expected 0 kg or more")
        object.__setattr__(self, "com", _vector(self.com, "payload com", 3))
        if self.inertia is not None:
            object.__setattr__(self, "inertia", _vector(self.inertia, "payload inertia", 6))
            moments = np.linalg.eigvalsh(self.inertia_matrix)
            if moments[0] < -1e-9 * moments[2] or moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-6) + 1e-12:
                raise PayloadError(f"payload inertia has principal moments {moments.tolist()}, which no body has")

    @property
    def inertia_matrix(self) -> Array:
        """(3, 3) inertia about the centre of mass [kg m^2], zero when none is given."""
        if self.inertia is None:
            return np.zeros((3, 3))
        xx, yy, zz, xy, xz, yz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    @property
    def body(self) -> pin.Inertia | None:
        """The same as Pinocchio holds it, None where nothing is carried."""
        if not self.mass:
            return None
        inertia = self.inertia_matrix  # what rounding left of a moment of zero may be below it
        np.fill_diagonal(inertia, np.diag(inertia).clip(0.0))
        return pin.Inertia(self.mass, self.com, inertia)


def _vector(values: ArrayLike, name: str, *shape: int) -> Array:
    try:
        return finite_array(values, name, shape)
    except InputError as error:
        raise PayloadError(str(error)) from None


NO_PAYLOAD = Payload(0.0, np.zeros(3))


@dataclass(frozen=True)
class Names:
    """What the rows and columns of a result stand for, and the frames it is meant in."""

    joints: tuple[str, ...]
    flexures: tuple[str, ...]
    base: str
    tip: str


class Structure(Manipulator, Protocol):
    """What mechanics knows of an arm beside what effects do; immutable.

    Attributes:
        corrections: Constant errors of its kinematics, bodies included.
        payload_rating: Heaviest rated payload [kg], None when not stated.
        flags: Flags about it as declared.
        sites: Of its flexures, in order; `stack` has their laws, with the effects at work there.
        distributed: `Flexure.inertia` of those that have one, by number.
        pulls: Loads that effects put on its links.
        springs: Between points of its links.
        names: Of joints and flexures, base and tip.
        joint_index: Place of every joint in q.
        bounds: Least and largest positions of all joints that are within their limits and of sensible size.
        within_limits: Whether numbers are such positions.
        new_payload: A flag where it was measured under other payloads alone.
        link_names: Links at and beyond the base.
    """

    @property
    def corrections(self) -> Corrections: ...
    @property
    def payload_rating(self) -> float | None: ...
    @property
    def flags(self) -> tuple[Flag, ...]: ...
    @property
    def sites(self) -> tuple[Site, ...]: ...
    @property
    def distributed(self) -> dict[int, Array]: ...
    @property
    def stack(self) -> LawStack: ...
    @property
    def pulls(self) -> Sequence[Load]: ...
    def within_limits(self, values: Sequence[float]) -> bool: ...
    def new_payload(self, payload: Payload) -> tuple[Flag, ...]: ...
    @property
    def springs(self) -> tuple[Spring, ...]: ...
    @property
    def names(self) -> Names: ...
    @property
    def joint_names(self) -> tuple[str, ...]: ...
    @property
    def joint_index(self) -> dict[str, int]: ...
    @property
    def bounds(self) -> tuple[list[float], list[float]]: ...
    @property
    def link_names(self) -> tuple[str, ...]: ...

    def payload(self, payload: str | Payload | None) -> Payload:
        """Return a payload by name."""
        ...

    def loaded(self, payload: str | Payload | None) -> LoadedArm:
        """Return the arm with a payload, whose models are kept."""
        ...

    def check_position(self, q: ArrayLike, enforce_limits: bool = True) -> tuple[Array, tuple[Flag, ...]]:
        """Return q as (nq,) floats [rad or m] with the flags about it."""
        ...

    def checked(self, values: ArrayLike, name: str) -> Array:
        """Return an (nq,) copy of a number for each joint [rad or m]."""
        ...


@dataclass(frozen=True, eq=False)
class LoadedArm:
    """What every question about an arm with a payload has in common. Shared between threads.

    Attributes:
        arm, payload: What they are of.
        gravity: (3,) in base axes [m/s^2] where it is not that of the arm's robot.
        kept: What each thread keeps of it: Pinocchio's workspace, and the engine under the loads asked about last.
    """

    arm: Structure
    payload: Payload
    gravity: Array | None = None
    kept: threading.local = field(default_factory=threading.local, repr=False)

    def __reduce__(self) -> tuple:
        """Return what it is made of; a workspace belongs to its thread."""
        return _again, (self.arm, self.payload, self.gravity)

    def under(self, gravity: Array) -> LoadedArm:
        """Return it under another (3,) gravity in base axes [m/s^2], as of a base that was moved."""
        return LoadedArm(self.arm, self.payload, gravity)

    @property
    def robot(self) -> Robot:
        """The arm's robot under the gravity that holds here."""
        return self.arm.robot if self.gravity is None else replace(self.arm.robot, gravity=self.gravity)

    @property
    def mechanics(self) -> Mechanism:
        """This thread's Pinocchio."""
        try:
            return self.kept.mechanics
        except AttributeError:
            self.kept.mechanics = self.mechanism(self.flex)
            return self.kept.mechanics

    def mechanism(self, flex: FlexModel) -> Mechanism:
        """Return Pinocchio's arm with a model of its flexures."""
        arm = self.arm
        return Mechanism(self.rigid, flex, arm.stack, arm.pulls, arm.springs, arm.robot, arm.corrections)

    @property
    def site_names(self) -> tuple[str, ...]:
        """Names of the places where a twist may be inserted: of `sites`, and then of closures and their pins."""
        robot = self.arm.robot
        if not robot.linkage:
            return self.sites.names
        joints = (name for joint in robot.jointed for name in (f"link:{joint.name}", joint.name))
        pins = (f"link:{name}" for name in robot.linkage.pins)
        return ("base", *joints, "tool", *robot.linkage.closures, *pins)

    @cached_property
    def rigid(self) -> FlexModel:
        """The model without flexures, where the controller knows it to be."""
        return self._as_bare("rigid") or build_model(self.robot)

    @cached_property
    def flex(self) -> FlexModel:
        """The model with flexures, corrected."""
        return self._as_bare("flex") or build_model(self.robot, self.arm.sites, self.arm.corrections)

    def _as_bare(self, name: str) -> FlexModel | None:
        """Return a model of the arm without payload with this one's, which is quicker than anew; None of that arm."""
        bare = self.arm.loaded(None)
        return None if bare is self else carrying(getattr(bare, name), self.payload.body, self.robot.gravity)

    @cached_property
    def flags(self) -> tuple[Flag, ...]:
        """Flags about the arm, and about its standing still with the payload.

        Raises:
            PayloadError: The payload's centre of mass is `MILLIMETRES` times the reach away.
        """
        arm, payload = self.arm, self.payload
        distance = float(np.linalg.norm(payload.com))
        urdf, flags = arm.robot.urdf, arm.flags
        if payload.mass and arm.robot.times_reach(distance) > 1.0:
            text = f"payload CoM is {distance:g} m from the tip, more than the arm's reach: millimetres?"
            if arm.robot.times_reach(distance) > MILLIMETRES:
                raise PayloadError(text)
            flags = (*flags, Flag("long", text))
        rated = arm.payload_rating is not None and payload.mass <= arm.payload_rating
        if arm.payload_rating is not None and not rated:
            text = f"payload of {payload.mass:g} kg exceeds the rated {arm.payload_rating:g} kg"
            flags = (*flags, Flag("beyond_rating", text, size=payload.mass))
        own = sum(one.mass for name in urdf.below(arm.robot.base) if (one := urdf.links[name].inertial))
        if 0.0 < own < payload.mass and not rated:
            text = f"payload of {payload.mass:g} kg is heavier than the arm itself, {own:.4g} kg: grams?"
            flags = (*flags, Flag("heavy_payload", text, size=payload.mass))
        return (*flags, *arm.new_payload(payload))

    def flags_under(self, wrenches: Sequence[Wrench], moves: bool) -> tuple[Flag, ...]:
        """Return `flags` with the flags about loads from outside [N, Nm] and about what moves.

        Raises:
            PayloadError, UnknownNameError: As `flags`; a load is at no link of the arm.
        """
        arm, known, flags = self.arm, self.flags, []
        if moves and self.arm.robot.points:
            flags.append(Flag("point_masses", "the masses of links are points, so their turning adds no load"))
        if moves and self.payload.mass and self.payload.inertia is None:
            flags.append(Flag("no_inertia", "the payload's inertia is not given, so its turning adds no load"))
        for wrench in wrenches:
            if wrench.frame not in arm.link_names:
                raise UnknownNameError("link", wrench.frame, arm.link_names)
            if wrench.hangs and moves:
                text = f"what hangs on {wrench.frame!r} beside the chain weighs, but is not accelerated"
                flags.append(Flag("branch_at_rest", text))
            if not (wrench.dead or wrench.hangs):
                text = f"the load at {wrench.frame!r} turns with its link; buckling is checked, flutter is not"
                flags.append(Flag("follower_load", text))
            size = wrench.sizes[0]
            if 0.0 < FORCE_BAND * arm.weight < size:
                text = f"{size:.3g} N at {wrench.frame!r} is over {FORCE_BAND:g} times the arm's weight: kN or kgf?"
                flags.append(Flag("large_force", text, size=size))
        return (*known, *flags) if flags else known

    def sag_flags(self, displacement: Array) -> tuple[Flag, ...]:
        """Return a flag where the tip's (6,) displacement [m, rad] is a good part of the reach."""
        sag = float(np.linalg.norm(displacement[:3]))
        if sag <= SAG_BAND * self.arm.robot.reach:
            return ()
        return (Flag("large_sag", f"the tip moves {sag:.3g} m, over {SAG_BAND:.0%} of the reach", size=sag),)

    @cached_property
    def stability_bound(self) -> StabilityBound | None:
        """How far weight and what pulls at it can soften the arm; None where a joint or a pull can go any way.

        A spring or a loop may soften an arm as well as its weight may: with one there is no bound, and the tangent is
        looked at.
        """
        if self.tied:
            return None
        ranges = {joint.name: (joint.lower, joint.upper) for joint in self.arm.robot.moving}
        model, flex, slides = self.flex.model, self.flex, [j for j in self.arm.robot.moving if j.kind == "prismatic"]
        travel = {model.getJointId(joint.name): max(abs(joint.lower), abs(joint.upper)) for joint in slides}
        if not np.isfinite(list(travel.values())).all():
            return None
        drives = [model.getJointId(joint.name) for joint in self.arm.robot.moving]

        def link(name: str) -> tuple[int, Array]:
            _, joint, _, pose = link_frame(model, flex.frame(name))
            return joint, pose.translation

        carriers = {joint.idx_v: joint.id for joint in model.joints}
        joints = [carriers[start] for start in flex.flexure_v[::6].tolist()]
        bound = bound_stability(model, joints, self.arm.stack, ranges, travel, drives, link)
        return bound.under(self.arm.pulls)

    @cached_property
    def tied(self) -> bool:
        """Whether loops or springs tie its links: else it is a chain, whose rows follow from nothing but themselves."""
        return bool(self.arm.springs or self.arm.robot.linkage)

    @cached_property
    def tree(self) -> Tree:
        """The arm as arrays, for the engine; what is at the tool is an element of its own."""
        arm, flex = self.arm, self.with_tool
        if not self.tied:
            return tree_of(flex)
        ties = Ties(flex.model, flex.model.createData(), arm.robot.linkage, arm.springs, arm.corrections.geometry)
        return tree_of(flex, ties, self.mechanics.true.offsets)

    @cached_property
    def nominal(self) -> Tree | None:
        """The rigid arm as the controller knows it, as arrays; None where corrections leave it where `tree` is."""
        if not self.arm.corrections.move:
            return None
        closing = self.mechanics.nominal
        return tree_of(self.rigid, closing.ties, closing.offsets) if self.tied else tree_of(self.rigid)

    @cached_property
    def with_tool(self) -> FlexModel:
        """The flexible model in which what is at the tool is a body of its own."""
        if (carried := self._as_bare("with_tool")) is not None:
            return carried
        sites = (*self.arm.sites, Site(TOOL, self.arm.robot.chain[-1].name))
        found = build_model(self.robot, sites, self.arm.corrections)
        return replace(found, flexure_v=found.flexure_v[:-6])

    @cached_property
    def sites(self) -> Frames:
        """Where twists may be inserted into `tree`, from base to tool.

        A joint's site is outboard of its motion; where it gives it is its last flexure's. A link's is its end: the
        origin frame of the joint there, inboard of its motion, without the offset that calibration found.
        """
        model, arm, here = self.with_tool.model, self.arm, pin.SE3.Identity()
        own = [site for site in arm.sites if site.joint not in arm.robot.linkage.joined]
        in_tree = [element for element in self.tree.flexures.tolist() if element >= 0]
        pairs = zip(own, in_tree, strict=True)
        last = {site.joint: joint for site, joint in pairs if not site.before}
        base = last.get(None, 0)
        found = [("base", base, base, here)]
        for joint in arm.robot.jointed:
            k = model.getJointId(joint.name)
            origin = model.jointPlacements[k] * arm.corrections.zero(joint).inverse()
            number = last.get(joint.name, k)
            found += [(f"link:{joint.name}", model.supports[k][-2], k, origin), (joint.name, number, number, here)]
        end = arm.robot.chain[-1].name
        apart = model.getJointId(f"flexure:{TOOL}")
        tool = apart if end in (joint.name for joint in arm.robot.jointed) else last.get(end, apart)
        return frames_of([*found, ("tool", tool, tool, here)])

    @cached_property
    def link_frames(self) -> Frames:
        """The links at and beyond the base, in `tree`."""
        flex = self.with_tool
        return frames_of([link_frame(flex.model, flex.frame(link)) for link in flex.links])

    @cached_property
    def flexure_frames(self) -> Frames:
        """The frames that the flexures move, in their order, and the tip last, in `tree`."""
        chain = self.tree
        elements = np.append(chain.flexures, int(chain.elements[-1, 15]))
        same = np.tile(np.append(np.eye(3).ravel(), np.zeros(3)), (len(chain.flexures), 1))
        return Frames((), np.array([elements, elements]), np.concatenate([same, chain.elements[-1:, :12]]))

    def row(self, q: Array, covariates: Mapping[str, Array]) -> Row:
        """Return what the laws may know at (nq,) or (N, nq) positions [rad or m]."""
        return Row(q, self.arm.joint_index, {MASS: np.asarray(self.payload.mass), **covariates})

    @cached_property
    def links(self) -> tuple[str, ...]:
        """Names of the links at and beyond the base."""
        return tuple(self.flex.links)

    @cached_property
    def mass(self) -> float:
        """Of everything that moves, the payload included [kg]."""
        return float(pin.computeTotalMass(self.rigid.model))


def _again(arm: Structure, payload: Payload, gravity: Array | None) -> LoadedArm:
    return arm.loaded(payload) if gravity is None else LoadedArm(arm, payload, gravity)
