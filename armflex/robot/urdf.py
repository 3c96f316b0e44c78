"""URDF text to plain data: links and joints with their line numbers, nothing interpreted yet."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from lxml import etree

from armflex.errors import Flag, UrdfError
from armflex.robot.elements import Joint, Link, read_joint, read_link, read_materials
from armflex.robot.reader import Reader
from armflex.robot.xml import parse_xml

MAX_LINKS = 500
Named = TypeVar("Named", Link, Joint)


@dataclass(frozen=True)
class Urdf:
    """A URDF as data; `flags` are the doubts met while reading."""

    name: str
    path: Path
    links: dict[str, Link]
    joints: dict[str, Joint]
    flags: tuple[Flag, ...] = field(default=())


def read_urdf(path: Path, strict: bool = True) -> Urdf:
    """Read a URDF into links and joints.

    Raises:
        UrdfError: Not well-formed, over a cap, unknown or misplaced tags in the root (a flag when not `strict`),
            duplicate or missing names. What is wrong inside a link or joint is among its `faults`: whether it is an
            error depends on the chain that is asked about.
    """
    root = parse_xml(path)
    reader = Reader(path, strict)
    if root.tag != "robot":
        raise reader.fail(root, f"root element is <{root.tag}>, expected <robot>")
    elements = reader.children(root)
    _check_counts(reader, root, elements)
    materials = read_materials(reader, root)
    links = [read_link(reader, element, materials) for element in elements if element.tag == "link"]
    joints = [read_joint(reader, element) for element in elements if element.tag == "joint"]
    name = root.get("name") or path.stem
    return Urdf(name, path, _by_name(links), _by_name(joints), tuple(reader.flags))


def _check_counts(reader: Reader, root: etree._Element, elements: list[etree._Element]) -> None:
    links = sum(element.tag == "link" for element in elements)
    if links == 0:
        raise reader.fail(root, "<robot> has no links")
    if links > MAX_LINKS:
        raise reader.fail(root, f"has {links} links, more than the {MAX_LINKS} allowed")


def _by_name(items: list[Named]) -> dict[str, Named]:
    named: dict[str, Named] = {}
    for item in items:
        if item.name in named:
            kind = type(item).__name__.lower()
            raise UrdfError(item.place, f"second {kind} named {item.name!r}; the first is at {named[item.name].place}")
        named[item.name] = item
    return named
