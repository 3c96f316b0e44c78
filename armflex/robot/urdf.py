"""A URDF as plain data, links and joints with their line numbers; and the kinematic tree that these should form."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
import pinocchio as pin
from lxml import etree

from armflex.conventions import Array
from armflex.errors import Flag, Place, UnknownNameError, UrdfError, did_you_mean, listing
from armflex.robot.reader import Fault, Reader, parse_xml

MAX_LINKS = 500

MOVING = ("revolute", "continuous", "prismatic")
UNSUPPORTED = ("floating", "planar")
JOINT_TYPES = (*MOVING, *UNSUPPORTED, "fixed")
RESERVED = re.compile("universe|flexure:.*")
"""Names of joints that the mechanics' own model has."""

FARTHEST = 100.0
"""A joint further from its parent link's frame [m] is doubted."""

WIDEST = 4.0 * np.pi
"""A revolute joint with wider limits [rad] is doubted."""

SHAPE_SIZES = {"box": ("size", 3), "cylinder": ("radius length", 1), "sphere": ("radius", 1)}


@dataclass(frozen=True)
class Inertial:
    """Mass [kg], pose of the inertia frame in the link frame, inertia (3, 3) about the CoM [kg m^2]."""

    mass: float
    origin: Array
    rotation: Array
    inertia: Array
    place: Place

    @property
    def turned(self) -> Array:
        """The (3, 3) inertia in link axes, symmetric to the last digit."""
        turned = self.rotation @ self.inertia @ self.rotation.T
        return 0.5 * (turned + turned.T)


@dataclass(frozen=True)
class Visual:
    """One shape: kind 'box', 'cylinder', 'sphere' or 'mesh', size [m], pose (4, 4) in the link frame."""

    kind: str
    size: tuple[float, ...]
    pose: Array
    color: str | None = None
    mesh: str | None = None


@dataclass(frozen=True)
class Link:
    """A rigid body by name; `inertial` is None where the file gives none, or none that can be read.

    One that only stands `between` two joints of a body is in no file: nothing of it could weigh.
    """

    name: str
    inertial: Inertial | None
    visuals: tuple[Visual, ...]
    place: Place
    faults: tuple[Fault, ...] = ()
    between: bool = False


@dataclass(frozen=True)
class Joint:
    """A joint as written: origin of the child frame in the parent link, unit `axis` in the child frame.

    What `faults` says could not be read has a default: no offset, the x axis, no limits, no mimic.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Array
    rotation: Array
    axis: Array
    lower: float
    upper: float
    effort: float
    velocity: float
    mimic: tuple[str, float, float] | None
    place: Place
    faults: tuple[Fault, ...] = ()

    def motion(self, position: float) -> pin.SE3:
        """Return where the joint at a position [rad or m] takes its child frame from its origin frame."""
        if self.kind == "prismatic":
            return pin.SE3(np.eye(3), position * self.axis)
        return pin.SE3(pin.exp3(position * self.axis), np.zeros(3))


def drive_of(joint: Joint) -> Array:
    """Return the (6,) unit twist of a joint's own motion, zero for a fixed one."""
    twist = np.zeros(6)
    if joint.kind == "prismatic":
        twist[:3] = joint.axis
    elif joint.kind in ("revolute", "continuous"):
        twist[3:] = joint.axis
    return twist


@dataclass(frozen=True)
class Urdf:
    """A URDF as data; `flags` are the flags met while reading, `translated` whether its file is in another format."""

    name: str
    path: Path
    links: dict[str, Link]
    joints: dict[str, Joint]
    flags: tuple[Flag, ...] = field(default=())
    translated: bool = False

    @cached_property
    def children(self) -> dict[str, list[Joint]]:
        """Every link's child joints, in file order."""
        children: dict[str, list[Joint]] = {name: [] for name in self.links}
        for joint in self.joints.values():
            children[joint.parent].append(joint)
        return children

    @cached_property
    def parents(self) -> dict[str, Joint]:
        """The joint that ends at each link but the root."""
        return {joint.child: joint for joint in self.joints.values()}

    def below(self, link: str) -> list[str]:
        """Return a link and all that descend from it, last branches first."""
        stack, found = [link], []
        while stack:
            found.append(name := stack.pop())
            stack.extend(joint.child for joint in self.children[name])
        return found


Named = TypeVar("Named", Link, Joint)


def read_urdf(path: Path, strict: bool = True, made: etree._Element | None = None, translated: bool = False) -> Urdf:
    """Read a URDF into links and joints; `translated` where the root `made` from the file has other lines.

    Raises:
        UrdfError: Not well-formed, over a cap, unknown or misplaced tags in the root (a flag when not `strict`),
            duplicate or missing names. What is wrong inside a link or joint is among its `faults`: whether it is an
            error depends on the chain that is asked about.
    """
    root: etree._Element = parse_xml(path) if made is None else made
    reader = Reader(path, strict, lines=not translated)
    if root.tag != "robot":
        raise reader.fail(root, f"root element is <{root.tag}>, expected <robot>")
    elements = reader.children(root)
    count = sum(element.tag == "link" for element in elements)
    if count == 0:
        raise reader.fail(root, "<robot> has no links")
    if count > MAX_LINKS:
        raise reader.fail(root, f"has {count} links, more than the {MAX_LINKS} allowed")
    materials = _materials(reader, root)
    links = [_link(reader, element, materials) for element in elements if element.tag == "link"]
    joints = [_joint(reader, element) for element in elements if element.tag == "joint"]
    return Urdf(root.get("name") or path.stem, path, _by_name(links), _by_name(joints), tuple(reader.flags), translated)


def _by_name(items: list[Named]) -> dict[str, Named]:
    named: dict[str, Named] = {}
    for item in items:
        if item.name in named:
            kind = type(item).__name__.lower()
            raise UrdfError(item.place, f"second {kind} named {item.name!r}; the first is at {named[item.name].place}")
        named[item.name] = item
    return named


def _link(reader: Reader, element: etree._Element, materials: dict[str, str]) -> Link:
    """Read one <link>; nothing is computed from shapes, so a garbled one is flagged and left out."""
    name, children, inertial, visuals = reader.text(element, "name"), reader.children(element), None, []
    inertials = [child for child in children if child.tag == "inertial"]
    with reader.fault("carried", "the link has no body"):
        if len(inertials) > 1:
            raise reader.fail(inertials[1], "<link> has more than one <inertial>")
        inertial = _inertial(reader, inertials[0], name) if inertials else None
    for child in children:
        if child.tag == "visual":
            try:
                visuals.append(_visual(reader, child, materials))
            except UrdfError as error:
                reader.flags.append(Flag("visual", f"{error.place}: {error.problem}; the shape is not drawn"))
    shapes = tuple(shape for shape in visuals if shape is not None)
    return Link(name, inertial, shapes, reader.place(element), reader.taken_faults())


def _inertial(reader: Reader, element: etree._Element, link: str) -> Inertial:
    """Read one <inertial>; mass and inertia are required, but without the latter there is still a weight."""
    reader.children(element)
    mass = reader.number(reader.needed(element, "mass"), "value")
    if mass < 0.0:
        raise reader.fail(element, f"link {link!r}: mass is {mass:g} kg, expected more than 0")
    origin, rotation = reader.pose(element)
    inertia = np.zeros((3, 3))
    with reader.fault("moved", "the body counts as a point"):
        given = reader.needed(element, "inertia")
        xx, yy, zz = (reader.number(given, key) for key in ("ixx", "iyy", "izz"))
        xy, xz, yz = (reader.number(given, key, "0") for key in ("ixy", "ixz", "iyz"))
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Inertial(mass, origin, rotation, inertia, reader.place(element))


def _materials(reader: Reader, root: etree._Element) -> dict[str, str]:
    """Return colour '#rrggbb' by material name, from materials with a colour anywhere in the file.

    Nothing is computed from colours, so a garbled one is flagged and left out.
    """
    found = {}
    for element in root.iter("material"):
        color = element.find("color")
        if color is not None and color.get("rgba") and element.get("name"):
            try:
                rgba = reader.numbers(color, "rgba", 4)
            except UrdfError as error:
                reader.flag(color, "color", error.problem)
                continue
            red, green, blue = (round(255 * value) for value in np.clip(rgba[:3], 0.0, 1.0))
            found[element.get("name")] = f"#{red:02x}{green:02x}{blue:02x}"
    return found


def _visual(reader: Reader, element: etree._Element, materials: dict[str, str]) -> Visual | None:
    """Read one <visual> as a primitive or a mesh's file name, which is never opened here; None for other shapes."""
    geometry = element.find("geometry")
    shape = next((child for child in (() if geometry is None else geometry) if isinstance(child.tag, str)), None)
    if shape is None:
        return None
    position, rotation = reader.pose(element)
    pose = np.block([[rotation, position[:, None]], [np.zeros(3), np.ones(1)]])
    material = element.find("material")
    color = materials.get(material.get("name", "")) if material is not None else None
    if shape.tag == "mesh":
        scale = reader.numbers(shape, "scale", 3, "1 1 1")
        return Visual("mesh", tuple(scale), pose, color, reader.text(shape, "filename"))
    if shape.tag not in SHAPE_SIZES:
        return None
    keys, count = SHAPE_SIZES[shape.tag]
    size = np.concatenate([reader.numbers(shape, key, count) for key in keys.split()])
    return Visual(shape.tag, tuple(size), pose, color)


def _joint(reader: Reader, element: etree._Element) -> Joint:
    """Read one <joint>; types that have no single position are faults, and what they join is held as it stands."""
    reader.children(element)
    name, kind = reader.text(element, "name"), reader.text(element, "type")
    with reader.fault("chain", "it is held as it stands"):
        if RESERVED.fullmatch(name):
            raise reader.fail(element, f"joint {name!r}: this name is taken by the mechanics, choose another")
        if kind not in JOINT_TYPES:
            raise reader.fail(element, f"joint {name!r}: unknown type {kind!r}{did_you_mean(kind, JOINT_TYPES)}")
        if kind in UNSUPPORTED:
            known = f"{', '.join(MOVING)}, fixed are"
            raise reader.fail(element, f"joint {name!r}: type {kind!r} is not supported; {known}")
    origin, rotation, axis = np.zeros(3), np.eye(3), np.array([1.0, 0.0, 0.0])
    with reader.fault("carried", "its child link is taken to be where its parent is"):
        origin, rotation = reader.pose(element)
    if np.linalg.norm(origin) > FARTHEST:
        text = f"joint {name!r}: origin is {np.linalg.norm(origin):g} m from its parent link: millimetres?"
        reader.flag(element, "origin_in_millimetres", text)
    ends = []
    for tag in ("parent", "child"):
        if (end := reader.only(element, tag)) is None:
            raise reader.fail(element, f"joint {name!r} has no <{tag}>")
        ends.append(reader.text(end, "link"))
    parent, child = ends
    limits, mimic = (-np.inf, np.inf, np.inf, np.inf), None
    with reader.fault("chain", "the joint is held at 0"):
        axis = _axis(reader, element, name, axis) if kind in MOVING else axis
        limits = _limits(reader, element, name, kind) or limits
        if (given := reader.only(element, "mimic")) is not None:
            master = reader.text(given, "joint")
            mimic = master, reader.number(given, "multiplier", "1"), reader.number(given, "offset", "0")
    place = reader.place(element)
    faults = reader.taken_faults()
    return Joint(name, kind, parent, child, origin, rotation, axis, *limits, mimic, place, faults)


def _axis(reader: Reader, element: etree._Element, name: str, default: Array) -> Array:
    axis = reader.only(element, "axis")
    if axis is None:
        reader.flag(element, "axis_missing", f"joint {name!r} has no <axis>: x is taken, the specification's default")
        return default
    vector = reader.numbers(axis, "xyz", 3)
    norm = float(np.linalg.norm(vector))
    if norm < 1e-6:
        raise reader.fail(axis, f"joint {name!r}: axis is zero")
    if abs(norm - 1.0) > 1e-6:
        reader.flag(axis, "axis_not_unit", f"joint {name!r}: axis has length {norm:.6g}, normalised")
    return vector / norm


def _limits(reader: Reader, element: etree._Element, name: str, kind: str) -> tuple[float, float, float, float] | None:
    """Return a joint's lower and upper limit, effort and velocity; None where it needs none and has none."""
    limit = reader.only(element, "limit")
    if kind not in MOVING or (limit is None and kind == "continuous"):
        return None
    if limit is None:
        raise reader.fail(element, f"joint {name!r}: a {kind} joint needs <limit lower= upper= effort= velocity=>")
    # A limit of zero effort or velocity is how files say 'not given'; the specification's default is 0.
    effort, velocity = reader.number(limit, "effort", "0"), reader.number(limit, "velocity", "0")
    if effort < 0.0 or velocity < 0.0:
        raise reader.fail(limit, f"joint {name!r}: effort and velocity limits must not be negative")
    if kind == "continuous":
        return -np.inf, np.inf, effort or np.inf, velocity or np.inf
    if limit.get("lower") is None and limit.get("upper") is None:
        raise reader.fail(limit, f"joint {name!r}: a {kind} joint needs lower and upper limits")
    lower, upper = reader.number(limit, "lower", "0"), reader.number(limit, "upper", "0")
    if lower > upper:
        raise reader.fail(limit, f"joint {name!r}: lower limit {lower:g} exceeds upper limit {upper:g}")
    if kind == "revolute" and max(abs(lower), abs(upper)) > WIDEST:
        text = f"joint {name!r}: limits {lower:g} to {upper:g} rad exceed two turns: degrees?"
        reader.flag(limit, "limit_in_degrees", text)
    return lower, upper, effort or np.inf, velocity or np.inf


def check_tree(urdf: Urdf) -> str:
    """Return the root link of a URDF whose joints form one tree.

    Raises:
        UrdfError: A joint names a missing link, joins a link to itself, gives a link a second parent or closes
            a loop; there is no root or more than one.
    """
    parents: dict[str, Joint] = {}
    for joint in urdf.joints.values():
        for end, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in urdf.links:
                missing = UnknownNameError("link", link, urdf.links)
                raise UrdfError(joint.place, f"joint {joint.name!r}, {end}: {missing}")
        if joint.parent == joint.child:
            raise UrdfError(joint.place, f"joint {joint.name!r} joins link {joint.parent!r} to itself")
        first = parents.setdefault(joint.child, joint).name
        if first != joint.name:
            raise UrdfError(joint.place, f"link {joint.child!r} has two parent joints, {first!r} and {joint.name!r}")
    rooted: set[str] = set()
    for link in urdf.links:
        path: list[str] = []
        while link in parents and link not in rooted:
            if link in path:
                loop = " -> ".join(reversed(path[path.index(link) :]))
                raise UrdfError(parents[link].place, f"joints form a loop: {loop}")
            path.append(link)
            link = parents[link].parent
        rooted.update(path)
    roots = [name for name in urdf.links if name not in parents]
    if len(roots) > 1:
        raise UrdfError(Place(urdf.path), f"has {len(roots)} root links, expected one: {listing(roots)}")
    return roots[0]


def find_chain(urdf: Urdf, base: str, tip: str | None) -> tuple[Joint, ...]:
    """Return the joints from link `base` to link `tip`, fixed ones included, in order.

    Args:
        urdf: A checked tree.
        base: Link that the chain begins at.
        tip: Link that it ends at; the only leaf below `base` when not given.

    Raises:
        UnknownNameError: No such link.
        UrdfError: `tip` is one of several, does not descend from `base`, or nothing moves between them; a joint of the
            chain cannot be read or mimics another.
    """
    if tip is None:
        leaves = [link for link in urdf.below(base) if not urdf.children[link]]
        if len(leaves) > 1:
            text = f"name the tip link with tip= or --tip, there are {len(leaves)} ends: {listing(leaves)}"
            raise UrdfError(Place(urdf.path), text)
        tip = leaves[0]
    if tip not in urdf.links:
        raise UnknownNameError("link", tip, urdf.links)
    chain: list[Joint] = []
    link = tip
    while link != base:
        if link not in urdf.parents:
            raise UrdfError(urdf.links[tip].place, f"tip {tip!r} does not descend from base {base!r}")
        chain.insert(0, urdf.parents[link])
        link = urdf.parents[link].parent
    for joint in chain:
        if joint.faults:
            raise joint.faults[0].error
    if not any(joint.kind in MOVING for joint in chain):
        raise UrdfError(urdf.links[tip].place, f"no joint moves between base {base!r} and tip {tip!r}")
    for joint in chain:
        if joint.mimic and joint.kind in MOVING:
            master, factor, offset = joint.mimic
            if master not in urdf.joints:
                missing = UnknownNameError("joint", master, urdf.joints)
                raise UrdfError(joint.place, f"joint {joint.name!r}, mimic: {missing}")
            text = f"joint {joint.name!r} of the chain mimics {master!r}, which is not supported: remove the <mimic> "
            own = (
                f"tag and give its position as a column of its own, q_{joint.name} = {factor:g} q_{master} + {offset:g}"
            )
            raise UrdfError(joint.place, text + own)
    return tuple(chain)
