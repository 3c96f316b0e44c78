"""Where an effect acts: a named site and axis of one arm, and what is known about the arm there."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armflex.conventions import TWIST_NAMES, Array
from armflex.laws import Law
from armflex.laws.declared import Flexure
from armflex.robot import Robot, Site
from armflex.robot.urdf import Joint, drive_of

BASE, TOOL, LINK = "base", "tool", "link:"


@dataclass(frozen=True)
class Location:
    """A law's place among all places: what distinguishes one candidate from another, hashable.

    Attributes:
        site: 'base', a joint, 'link:JOINT' (the link that the joint ends), or 'tool'.
        axis: One of dx dy dz rx ry rz, None where the law has no single axis.
        covariates: Columns it depends on, in the law's order.
        terms: Which of the law's amplitudes act; the others are zero.
        partner: Second axis, session or payload where a law needs one.
    """

    site: str
    axis: str | None = None
    covariates: tuple[str, ...] = ()
    terms: tuple[int, ...] = (0,)
    partner: str = ""

    @property
    def place(self) -> str:
        """The site as files name it: a link has the name of the joint that ends it."""
        return self.site.removeprefix(LINK)

    @property
    def turns(self) -> bool:
        """Whether the axis is a rotation."""
        return self.axis is None or self.axis.startswith("r")

    @property
    def key(self) -> str:
        """Site and axis in one word, for names of derived covariates."""
        return "_".join(part for part in (self.place, self.axis) if part)


def with_terms(locations: Iterable[Location], *choices: tuple[int, ...]) -> list[Location]:
    """Return each location once per choice of acting amplitudes."""
    return [replace(location, terms=terms) for location in locations for terms in choices]


def all_and_each(names: Sequence[str]) -> tuple[str, ...]:
    """Return '' for all of some payloads together, and the name of each where there are several."""
    return ("", *names) if len(names) > 1 else ("",) * len(names)


@dataclass(frozen=True)
class Here:
    """A location on one arm.

    Attributes:
        location: Which place it is.
        robot: The robot.
        base_law: The declared law of the flexure there, None where the arm is rigid.
    """

    location: Location
    robot: Robot
    base_law: Law | None

    @cached_property
    def joint(self) -> Joint | None:
        """The joint whose motion the site follows, None at the base."""
        name = self.location.place
        if name == BASE:
            return None
        if name == TOOL:
            return self.robot.chain[-1]
        return joint_named(name, self.robot)

    @cached_property
    def direction(self) -> Array:
        """(6,) unit twist of the axis in the site's frame."""
        return np.eye(6)[TWIST_NAMES.index(self.location.axis)] if self.location.axis else np.zeros(6)

    @cached_property
    def drive(self) -> Array:
        """(6,) unit twist of the joint's own motion."""
        assert self.joint is not None
        return drive_of(self.joint)

    @cached_property
    def length(self) -> Array:
        """(3,) vector along the link to its end, the tip for the last, in the site's frame [m]."""
        assert self.joint is not None
        to_tip = self.location.place == TOOL
        path = list(self.robot.chain) if to_tip else path_to(self.joint, self.robot)
        moving = [i for i, joint in enumerate(path[: len(path) - (not to_tip)]) if joint in self.robot.jointed]
        vector = np.zeros(3)
        for joint in path[moving[-1] + 1 if moving else 0 :]:
            vector = joint.rotation.T @ (vector + joint.origin)
        return vector

    @cached_property
    def stretch(self) -> Array:
        """(6,) twist that adds `length` to the link [m]."""
        return np.concatenate([self.length, np.zeros(3)])


def joint_named(name: str, robot: Robot) -> Joint | None:
    """Return the joint or cylinder of a name, None of a loop's pin."""
    return next((joint for joint in (*robot.places, *robot.moving) if joint.name == name), None)


def path_to(joint: Joint, robot: Robot) -> list[Joint]:
    """Return the joints from the base to one, which is the last."""
    path = [joint]
    while path[0].parent != robot.base:
        path.insert(0, robot.urdf.parents[path[0].parent])
    return path


def drive_axis(joint: Joint) -> str:
    """Return the axis that is nearest to a joint's own motion."""
    return TWIST_NAMES[int(np.abs(drive_of(joint)).argmax())]


def resolve(location: Location, robot: Robot, flexures: Sequence[Flexure]) -> Here:
    """Return what is known about an arm at a location."""
    place = site_of(location.site, robot)
    laws = [flexure.law for flexure in flexures if same_site(flexure.site, place)]
    return Here(location, robot, laws[-1] if laws else None)


def site_of(name: str, robot: Robot) -> Site:
    """Return the site of a model of the arm that has a name."""
    if name == BASE:
        return Site(name, None)
    if name == TOOL:
        return Site(name, robot.chain[-1].name)
    return Site(name, name.removeprefix(LINK), before=name.startswith(LINK))


def link_of(site: str, robot: Robot) -> str:
    """Return the name of the link that a load at a site acts on: the one that ends in the site's joint."""
    name = site.removeprefix(LINK)
    if name in (TOOL, BASE):
        return robot.tip if name == TOOL else robot.base
    return next(joint.parent for joint in robot.places if joint.name == name)


def same_site(site: Site, other: Site) -> bool:
    """Return whether two sites are the same place of the chain."""
    return (site.joint, site.before) == (other.joint, other.before)


def site_names(robot: Robot) -> tuple[str, ...]:
    """Return every site of an arm from base to tool, 'base', 'link:A2', 'A2', ..., 'tool', and what closes loops."""
    moving = robot.jointed if robot.linkage else robot.moving
    names = [name for joint in moving for name in (LINK + joint.name, joint.name)]
    return (BASE, *names, TOOL, *robot.linkage.closures)
