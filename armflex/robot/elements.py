"""The URDF's elements one by one, as plain data: link, inertial, visual, joint."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from lxml import etree

from armflex.conventions import Array
from armflex.errors import Flag, Place, UrdfError, did_you_mean
from armflex.robot.reader import Fault, Reader

MOVING = ("revolute", "continuous", "prismatic")
UNSUPPORTED = ("floating", "planar")
JOINT_TYPES = (*MOVING, *UNSUPPORTED, "fixed")
RESERVED = re.compile("universe|flexure:.*")
"""Names of joints that the mechanics' own model has."""

FARTHEST = 100.0
"""A joint further from its parent link's frame [m] is doubted."""

WIDEST = 4.0 * np.pi
"""A revolute joint with wider limits [rad] is doubted."""

UNLIMITED = (-np.inf, np.inf, np.inf, np.inf)
"""Lower and upper limit, effort and velocity of a joint that has none."""

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
    """A rigid body by name; `inertial` is None where the file gives none, or none that can be read."""

    name: str
    inertial: Inertial | None
    visuals: tuple[Visual, ...]
    place: Place
    faults: tuple[Fault, ...] = ()


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


def motion(joint: Joint, position: float) -> pin.SE3:
    """Return where a joint at a position [rad or m] takes its child frame from its origin frame."""
    if joint.kind == "prismatic":
        return pin.SE3(np.eye(3), position * joint.axis)
    return pin.SE3(pin.exp3(position * joint.axis), np.zeros(3))


def read_link(reader: Reader, element: etree._Element, materials: dict[str, str]) -> Link:
    """Read one <link>; shapes of unknown kind are left out, since nothing is computed from them."""
    name = reader.text(element, "name")
    children = reader.children(element)
    inertials = [child for child in children if child.tag == "inertial"]
    inertial = None
    with reader.fault("carried", "the link has no body"):
        if len(inertials) > 1:
            raise reader.fail(inertials[1], "<link> has more than one <inertial>")
        inertial = read_inertial(reader, inertials[0], name) if inertials else None
    shapes = [read_visual(reader, child, materials) for child in children if child.tag == "visual"]
    visuals = tuple(shape for shape in shapes if shape is not None)
    return Link(name, inertial, visuals, reader.place(element), reader.taken_faults())


def read_inertial(reader: Reader, element: etree._Element, link: str) -> Inertial:
    """Read one <inertial>; mass and inertia are required, but without the latter there is still a weight."""
    reader.children(element)
    value = reader.number(_needed(reader, element, "mass"), "value")
    if value < 0.0:
        raise reader.fail(element, f"link {link!r}: mass is {value:g} kg, expected more than 0")
    origin, rotation = reader.pose(element)
    inertia = np.zeros((3, 3))
    with reader.fault("moved", "the body counts as a point"):
        inertia = _inertia(reader, _needed(reader, element, "inertia"))
    return Inertial(value, origin, rotation, inertia, reader.place(element))


def _needed(reader: Reader, element: etree._Element, tag: str) -> etree._Element:
    found = reader.only(element, tag)
    if found is None:
        raise reader.fail(element, f"<{element.tag}> needs <{tag}>")
    return found


def _inertia(reader: Reader, element: etree._Element) -> Array:
    xx, yy, zz = (reader.number(element, key) for key in ("ixx", "iyy", "izz"))
    xy, xz, yz = (reader.number(element, key, "0") for key in ("ixy", "ixz", "iyz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def read_materials(reader: Reader, root: etree._Element) -> dict[str, str]:
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
                reader.doubt(color, "color", error.problem)
                continue
            red, green, blue = (round(255 * value) for value in np.clip(rgba[:3], 0.0, 1.0))
            found[element.get("name")] = f"#{red:02x}{green:02x}{blue:02x}"
    return found


def read_visual(reader: Reader, element: etree._Element, materials: dict[str, str]) -> Visual | None:
    """Read one <visual> as a primitive or a mesh's file name; the mesh itself is never opened here.

    Nothing is computed from shapes, so a garbled one is flagged and left out.
    """
    try:
        return _visual(reader, element, materials)
    except UrdfError as error:
        reader.flags.append(Flag("visual", f"{error.place}: {error.problem}; the shape is not drawn"))
        return None


def _visual(reader: Reader, element: etree._Element, materials: dict[str, str]) -> Visual | None:
    geometry = element.find("geometry")
    shapes = [] if geometry is None else [child for child in geometry if isinstance(child.tag, str)]
    if not shapes:
        return None
    position, rotation = reader.pose(element)
    pose = np.block([[rotation, position[:, None]], [np.zeros(3), np.ones(1)]])
    material = element.find("material")
    color = materials.get(material.get("name", "")) if material is not None else None
    return _shape(reader, shapes[0], pose, color)


def _shape(reader: Reader, shape: etree._Element, pose: Array, color: str | None) -> Visual | None:
    if shape.tag == "mesh":
        scale = reader.numbers(shape, "scale", 3, "1 1 1")
        return Visual("mesh", tuple(scale), pose, color, reader.text(shape, "filename"))
    if shape.tag not in SHAPE_SIZES:
        return None
    keys, count = SHAPE_SIZES[shape.tag]
    size = np.concatenate([reader.numbers(shape, key, count) for key in keys.split()])
    return Visual(shape.tag, tuple(size), pose, color)


def read_joint(reader: Reader, element: etree._Element) -> Joint:
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
        reader.doubt(element, "origin_in_millimetres", text)
    parent, child = (_end(reader, element, name, tag) for tag in ("parent", "child"))
    limits, mimic = UNLIMITED, None
    with reader.fault("chain", "the joint is held at 0"):
        axis = _axis(reader, element, name) if kind in MOVING else axis
        limits = _limits(reader, element, name, kind)
        mimic = _mimic(reader, element)
    place = reader.place(element)
    return Joint(name, kind, parent, child, origin, rotation, axis, *limits, mimic, place, reader.taken_faults())


def _end(reader: Reader, element: etree._Element, name: str, tag: str) -> str:
    end = reader.only(element, tag)
    if end is None:
        raise reader.fail(element, f"joint {name!r} has no <{tag}>")
    return reader.text(end, "link")


def _axis(reader: Reader, element: etree._Element, name: str) -> Array:
    axis = reader.only(element, "axis")
    if axis is None:
        reader.doubt(element, "axis_missing", f"joint {name!r} has no <axis>: x is taken, the specification's default")
        return np.array([1.0, 0.0, 0.0])
    vector = reader.numbers(axis, "xyz", 3)
    norm = float(np.linalg.norm(vector))
    if norm < 1e-6:
        raise reader.fail(axis, f"joint {name!r}: axis is zero")
    if abs(norm - 1.0) > 1e-6:
        reader.doubt(axis, "axis_not_unit", f"joint {name!r}: axis has length {norm:.6g}, normalised")
    return vector / norm


def _limits(reader: Reader, element: etree._Element, name: str, kind: str) -> tuple[float, float, float, float]:
    limit = reader.only(element, "limit")
    if kind not in MOVING or (kind == "continuous" and limit is None):
        return UNLIMITED
    if limit is None:
        raise reader.fail(element, f"joint {name!r}: a {kind} joint needs <limit lower= upper= effort= velocity=>")
    # A limit of zero effort or velocity is how files say 'not given'; the specification's default is 0.
    effort, velocity = reader.number(limit, "effort", "0"), reader.number(limit, "velocity", "0")
    if effort < 0.0 or velocity < 0.0:
        raise reader.fail(limit, f"joint {name!r}: effort and velocity limits must not be negative")
    lower, upper = (-np.inf, np.inf) if kind == "continuous" else _range(reader, limit, name, kind)
    return lower, upper, effort or np.inf, velocity or np.inf


def _range(reader: Reader, limit: etree._Element, name: str, kind: str) -> tuple[float, float]:
    if limit.get("lower") is None and limit.get("upper") is None:
        raise reader.fail(limit, f"joint {name!r}: a {kind} joint needs lower and upper limits")
    lower, upper = reader.number(limit, "lower", "0"), reader.number(limit, "upper", "0")
    if lower > upper:
        raise reader.fail(limit, f"joint {name!r}: lower limit {lower:g} exceeds upper limit {upper:g}")
    if kind == "revolute" and max(abs(lower), abs(upper)) > WIDEST:
        text = f"joint {name!r}: limits {lower:g} to {upper:g} rad exceed two turns: degrees?"
        reader.doubt(limit, "limit_in_degrees", text)
    return lower, upper


def _mimic(reader: Reader, element: etree._Element) -> tuple[str, float, float] | None:
    mimic = reader.only(element, "mimic")
    if mimic is None:
        return None
    return (
        reader.text(mimic, "joint"),
        reader.number(mimic, "multiplier", "1"),
        reader.number(mimic, "offset", "0"),
    )
