"""The arm as a URDF: the file it was declared by, with the geometry, joint zeros and masses that were found."""

import math
from collections.abc import Container
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from armflex.arm import Arm
from armflex.conventions import Array
from armflex.errors import UnsupportedError
from armflex.export import Exported
from armflex.export.rigid import HOLDS_AT, left_out, measured_points, said_holds, with_constants
from armflex.measured.measurements import read_measurements
from armflex.robot.urdf import MOVING, Urdf, parse_xml


def export(arm: Arm, over: Path | None = None) -> Exported:
    """Return the arm's URDF as calibrated; what is not corrected, comments too, stays as it was written.

    Corrections are put into the origins of joints, so that every position goes on meaning what the controller reports
    and limits hold as they are. The tip of the file at any positions is that of the rigid, calibrated arm; the target,
    and every other point of the arm that was measured, is a link of its own.

    Args:
        arm: The arm.
        over: Rows over which what a URDF cannot carry is stated; the joints' limits when None.

    Raises:
        UrdfError: The file that the arm was read from can no longer be read.
        TableError, MissingCovariateError: The rows cannot be used.
    """
    whole = with_constants(arm)
    corrections, rows = whole.corrections, None if over is None else read_measurements(over, arm, inputs_only=True)
    root = _as_xml(arm.robot.urdf) if arm.robot.urdf.translated else parse_xml(arm.robot.urdf.path)
    joints = {(element.get("name") or "").strip(): element for element in root.findall("joint")}
    if whole.robot.tool_joint is not None and whole.robot.tool_joint not in joints:
        joint = whole.robot.urdf.joints[whole.robot.tool_joint]
        place = {"xyz": _spaced(joint.origin), "rpy": _spaced(pin.rpy.matrixToRpy(joint.rotation))}
        joints[joint.name] = _fixed(root, joint.name, joint.parent, joint.child, place)
    links = {(element.get("name") or "").strip(): element for element in root.findall("link")}
    for joint in whole.robot.places:
        moved = corrections.frame(joint) * corrections.zero(joint)
        if not moved.isIdentity(0.0):
            place = pin.SE3(joint.rotation, joint.origin) * moved
            turn = _spaced(pin.rpy.matrixToRpy(place.rotation))
            _child(joints[joint.name], "origin").attrib.update({"xyz": _spaced(place.translation), "rpy": turn})
    weighed = {name: np.zeros(4) for name in whole.masses if name in links}
    for name, extra in {**weighed, **corrections.bodies}.items():
        body = corrections.body(name, whole.robot.urdf.links[name].inertial)
        if body is None:
            continue
        new, inertial = links[name].find("inertial") is None, _child(links[name], "inertial")
        _child(inertial, "mass").set("value", repr(float(body.mass)))
        nominal = whole.robot.urdf.links[name].inertial
        centre = extra[1:] if nominal is None else nominal.origin + extra[1:]
        _child(inertial, "origin").set("xyz", _spaced(centre))
        tensor = _child(inertial, "inertia")
        if name in weighed:  # the moments of inertia with it, in their own axes
            factor = math.exp(whole.masses[name])
            tensor.attrib.update({key: repr(factor * float(value)) for key, value in tensor.attrib.items()})
        if new:
            tensor.attrib.update(dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), "0"))
    for name, (link, place) in measured_points(whole).items():
        name = _unused(name, links, joints)
        joints[name] = _fixed(root, f"{name}_joint", link, name, {"xyz": _spaced(place), "rpy": "0.0 0.0 0.0"})
    for comment in [*root.iterchildren(etree.Comment)]:  # of the arm that the file was of before
        if (comment.text or "").strip().startswith(HOLDS_AT):
            root.remove(comment)
    for line in said_holds(whole):
        root.insert(0, comment := etree.Comment(f" {line.replace('--', '- -')} "))
        comment.tail = "\n"
    notes, numbers = left_out(whole, rows, points=True)
    if whole.robot.tool_joint is not None:
        notes += (
            f"The tool is a link of the file, {whole.robot.tip!r}: an arm.toml of it names that tip, and no tool.",
        )
    if any(link.between for link in whole.robot.urdf.links.values()):
        notes += ("Links without mass stand between joints of one body: an arm.toml of it has allow_massless = true.",)
    meshes = [mesh.get("filename") or "" for mesh in root.iter("mesh")]
    beside = [name for name in meshes if "://" not in name and not Path(name).is_absolute()]
    if beside:
        notes += (
            f"{len(beside)} meshes are named from the folder of {arm.robot.urdf.path.name}, such as {beside[0]!r}.",
        )
    text = etree.tostring(root.getroottree(), encoding="utf-8", xml_declaration=True).decode()
    return Exported(text + "\n", notes, numbers)


def _fixed(root: etree._Element, name: str, parent: str, child: str, place: dict[str, str]) -> etree._Element:
    """Add a link that is fixed to another one, and return its joint."""
    etree.SubElement(root, "link", {"name": child})
    joint = etree.SubElement(root, "joint", {"name": name, "type": "fixed"})
    etree.SubElement(joint, "origin", place)
    for end, link in (("parent", parent), ("child", child)):
        etree.SubElement(joint, end, {"link": link})
    return joint


def _as_xml(urdf: Urdf) -> etree._Element:
    """Return a robot of another format as a URDF."""
    root = etree.Element("robot", {"name": urdf.name})
    for link in urdf.links.values():
        element = etree.SubElement(root, "link", {"name": link.name})
        if link.inertial is not None:
            body, turned, axes = etree.SubElement(element, "inertial"), link.inertial.turned, "xyz"
            etree.SubElement(body, "origin", {"xyz": _spaced(link.inertial.origin)})
            etree.SubElement(body, "mass", {"value": repr(link.inertial.mass)})
            pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
            etree.SubElement(body, "inertia", {f"i{axes[i]}{axes[j]}": repr(float(turned[i, j])) for i, j in pairs})
    for joint in urdf.joints.values():
        kind = joint.kind if joint.kind in (*MOVING, "fixed") else "fixed"
        if kind == "prismatic" and not np.isfinite([joint.lower, joint.upper]).all():
            raise UnsupportedError(f"joint {joint.name!r} slides without limits, which no URDF can say")
        element = etree.SubElement(root, "joint", {"name": joint.name, "type": kind})
        place = {"xyz": _spaced(joint.origin), "rpy": _spaced(pin.rpy.matrixToRpy(joint.rotation))}
        etree.SubElement(element, "origin", place)
        for end, link in (("parent", joint.parent), ("child", joint.child)):
            etree.SubElement(element, end, {"link": link})
        if kind in MOVING:
            etree.SubElement(element, "axis", {"xyz": _spaced(joint.axis)})
            limits = {"lower": joint.lower, "upper": joint.upper, "effort": joint.effort, "velocity": joint.velocity}
            finite = {name: repr(float(value)) for name, value in limits.items() if np.isfinite(value)}
            etree.SubElement(element, "limit", {"effort": "0", "velocity": "0"} | finite)
        if joint.mimic is not None:
            attributes = zip(("joint", "multiplier", "offset"), joint.mimic, strict=True)
            etree.SubElement(element, "mimic", {key: str(value) for key, value in attributes})
    return root


def _unused(name: str, *names: Container[str]) -> str:
    """Return a name that nothing has, and no joint's by which it hangs."""
    while any(candidate in names_taken for names_taken in names for candidate in (name, f"{name}_joint")):
        name += "_"
    return name


def _child(element: etree._Element, tag: str) -> etree._Element:
    """Return an element's child of a name, a new one where there is none."""
    child = element.find(tag)
    return etree.SubElement(element, tag) if child is None else child


def _spaced(values: Array) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)
