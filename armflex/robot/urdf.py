"""A URDF as plain data, links and joints with their line numbers, and its safe reading: typed, with file and line.

There are caps on size and depth, no DTD and no entities. `float()` takes '1_000' and full-width digits, C's `strtod`
takes '0x64' and stops at the comma of '1,5'; no two URDF readers agree on such files, so they are refused.
"""

import codecs
import difflib
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import pinocchio as pin
from lxml import etree

from armflex.conventions import LARGEST, NUMBER, Array, unprintable
from armflex.errors import Flag, Place, UrdfError, did_you_mean
from armflex.storage.read_file import read_file

MAX_LINKS = 500
MAX_BYTES = 5_000_000
MAX_DEPTH = 64

PASSED_OVER = frozenset(
    {
        *("material", "gazebo", "transmission", "ros2_control", "sensor", "hardwareInterface"),
        *("safety_controller", "calibration", "dynamics", "self_collision_checking", "contact"),
        *("verbose", "joint_properties", "group", "disable_collisions"),
        *("kinematic", "gravity", "selfCollide", "turnGravityOff", "surface"),
        *("self_filter", "collision_checking"),
    }
)
"""Tags that say nothing about mass, geometry or motion; skipped with all they hold."""

CHILDREN: dict[str, frozenset[str]] = {
    "robot": frozenset({"link", "joint"}),
    "link": frozenset({"inertial", "visual", "collision"}),
    "joint": frozenset({"parent", "child", "origin", "axis", "limit", "mimic"}),
    "inertial": frozenset({"mass", "origin", "inertia"}),
}
"""Which tags are meant where; anything else is misplaced."""

LEAVES = frozenset({"parent", "child", "origin", "axis", "limit", "mimic", "mass", "inertia"})
"""Tags that have attributes alone: what they hold would be lost."""

ATTRIBUTES = {
    "origin": ("xyz", "rpy"),
    "inertia": ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"),
    "limit": ("lower", "upper", "effort", "velocity"),
    "mimic": ("joint", "multiplier", "offset"),
}
"""What an element that has defaults may say; a misspelt one would silently mean the default."""

WEIGHING = ("inertial", "mass", "inertia", "origin")
"""Tags without which a body weighs less, or elsewhere."""

DECLARATION = re.compile(
    rb"""(\s|<!--.*?-->)*(?P<declaration><\?xml\s[^>]*?(\sencoding\s*=\s*["'](?P<encoding>[\w.:-]+)["'][^>]*?)?\?>)""",
    re.DOTALL,
)
"""What stands before the root element of a file that says its encoding."""

Matters = Literal["chain", "carried", "moved"]

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
class Fault:
    """What is wrong with a link or joint, an error only where the question depends on it.

    Attributes:
        error: What is raised there.
        matters: On what it bears: "chain" if the element is between base and tip, "carried" if it is that or hangs on
            it, "moved" as "chain", and for a body that is only carried where it is asked to move.
        instead: What is done where it does not matter.
    """

    error: UrdfError
    matters: Matters
    instead: str


@dataclass(frozen=True)
class Inertial:
    """Mass [kg], pose of the inertia frame in the link frame, inertia (3, 3) about the CoM [kg m^2].

    A `point` is declared without moments of inertia, which are then zero. Where it is `distributed` they are counted
    elsewhere: it stands for mass of a link that a mesh distributes.
    """

    mass: float
    origin: Array
    rotation: Array
    inertia: Array
    place: Place
    point: bool = False
    distributed: bool = False

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
    """A URDF as data; `flags` are the flags met while reading, `translated` whether its file is in another format.

    `dh` is the form of the Denavit-Hartenberg rows that it was made of, '' of others.
    `gravity` is that of the file in its root's axes [m/s^2], which a URDF has none of.
    `declared` has the loops, springs and passive joints of an MJCF, as tables of an arm.toml.
    """

    name: str
    path: Path
    links: dict[str, Link]
    joints: dict[str, Joint]
    flags: tuple[Flag, ...] = field(default=())
    translated: bool = False
    dh: str = ""
    gravity: tuple[float, float, float] | None = None
    declared: Mapping[str, Any] = field(default_factory=dict)

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

    def turned(self, link: str) -> tuple[Array, Joint | None]:
        """Return the (3, 3) rotation of a link in its root's axes with all joints at 0, and the last that moves it."""
        rotation, moving = np.eye(3), None
        while link in self.parents:
            joint = self.parents[link]
            rotation, link = joint.rotation @ rotation, joint.parent
            moving = moving or (joint if joint.kind in MOVING else None)
        return rotation, moving

    def below(self, link: str) -> list[str]:
        """Return a link and all that descend from it, last branches first."""
        stack, links = [link], []
        while stack:
            links.append(name := stack.pop())
            stack.extend(joint.child for joint in self.children[name])
        return links


def parse_xml(path: Path, text: bytes | None = None) -> etree._Element:
    """Return the root element of an XML file, or of a text that was made from it.

    Raises:
        UrdfError: The file is missing, empty, larger than `MAX_BYTES`, not of the encoding that it declares (UTF-8
            where it declares none), truncated, deeper than `MAX_DEPTH`, has a text that cannot be shown, or a document
            type definition (entities could read files or explode).
    """
    try:
        data = read_file(path, MAX_BYTES) if text is None else text
    except OSError as error:
        raise UrdfError(Place(path), f"cannot be read: {error.strerror}") from None
    if len(data) > MAX_BYTES:
        raise UrdfError(Place(path), f"is {len(data)} bytes, more than the {MAX_BYTES} allowed")
    root = _root(path, _as_utf8(path, data))
    if root.getroottree().docinfo.doctype:  # pyright: ignore[reportAttributeAccessIssue] - lxml has it, its stubs not
        raise UrdfError(Place(path, 1), "has a document type definition (DTD); entities are refused")
    stack = [(root, 1)]  # the interpreter's own stack must not be the limit
    while stack:
        element, depth = stack.pop()
        where = Place(path, element.sourceline or 0)
        if depth > MAX_DEPTH:
            raise UrdfError(where, f"nested deeper than {MAX_DEPTH} elements")
        # Of a default namespace: Drake's files have one, and other readers look at none.
        if element.prefix is None and str(element.tag).startswith("{"):
            element.tag = etree.QName(element).localname
        for name, value in element.attrib.items():
            if bad := unprintable(str(value)):
                raise UrdfError(where, f"<{element.tag} {name}={value!r}> {bad[1]}")
        stack.extend((child, depth + 1) for child in element if isinstance(child.tag, str))
    return root


def _as_utf8(path: Path, data: bytes) -> bytes:
    """Return XML as UTF-8 with the same lines and without a declaration, whose encoding is followed.

    A byte order mark, blank lines and comments may stand before the declaration, as other readers have it.
    """
    marks = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}
    mark = next((mark for mark in marks if data.startswith(mark)), b"")
    data, encoding = data[len(mark) :], marks.get(mark, "utf-8")
    if not mark and (declared := DECLARATION.match(data)) and declared["encoding"]:
        encoding = declared["encoding"].decode()
    if not data.strip():
        raise UrdfError(Place(path), "is empty")
    try:
        letters = str(data, encoding)  # which no codec passes that is none of text
    except (UnicodeError, LookupError) as error:
        text = f"is not {encoding.upper()} text" if isinstance(error, UnicodeError) else str(error)
        raise UrdfError(Place(path), f"{text}; expected UTF-8, or the encoding that its <?xml ..?> declares") from None
    if "\0" in letters:
        raise UrdfError(Place(path), "holds NUL characters: binary or UTF-16 without a byte order mark?")
    plain = letters.encode("utf-8", "surrogatepass").removeprefix(codecs.BOM_UTF8)
    if declaration := DECLARATION.match(plain):
        start, end = declaration.span("declaration")
        plain = plain[:start] + b"\n" * plain.count(b"\n", start, end) + plain[end:]
    return plain


def _root(path: Path, data: bytes) -> etree._Element:
    """Return the root element; a prefix that nothing declares is a part of the name, `gazebo:x`."""
    safe: dict[str, Any] = {"resolve_entities": False, "no_network": True, "load_dtd": False, "huge_tree": False}
    parser = etree.XMLParser(encoding="utf-8", **safe)
    try:
        return etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        if all(entry.type_name == "NS_ERR_UNDEFINED_NAMESPACE" for entry in parser.error_log):
            return etree.fromstring(data, etree.XMLParser(encoding="utf-8", recover=True, **safe))
        raise UrdfError(Place(path, error.lineno or 0), f"not well-formed XML: {error.msg}") from None


class Reader:
    """Typed access to one file's elements; collects flags and words every error with file and line."""

    def __init__(self, path: Path, strict: bool, lines: bool = True, hint: str = "") -> None:
        self.path, self.strict, self._lines, self._hint = path, strict, lines, hint
        self.flags: list[Flag] = []
        self.faults: list[Fault] = []

    def place(self, element: etree._Element) -> Place:
        return Place(self.path, (element.sourceline or 0) if self._lines else 0)

    def fail(self, element: etree._Element, problem: str) -> UrdfError:
        return UrdfError(self.place(element), problem + self._hint)

    def flag(self, element: etree._Element, code: str, text: str) -> None:
        self.flags.append(Flag(code, f"{self.place(element)}: {text}"))

    @contextmanager
    def fault(self, matters: Matters, instead: str) -> Iterator[None]:
        """Keep an error met inside until it is known whether the element matters."""
        try:
            yield
        except UrdfError as error:
            self.faults.append(Fault(error, matters, instead))

    def taken_faults(self) -> tuple[Fault, ...]:
        """Return the faults of the element that was read last."""
        faults, self.faults = tuple(self.faults), []
        return faults

    def text(self, element: etree._Element, key: str) -> str:
        """Return a non-empty attribute, or fail saying which is missing."""
        value = (element.get(key) or "").strip()
        if not value:
            raise self.fail(element, f"<{element.tag}> needs a non-empty {key!r}")
        return value

    def numbers(self, element: etree._Element, key: str, count: int, default: str | None = None) -> Array:
        """Return `count` finite numbers of an attribute separated by blanks."""
        text = element.get(key)
        if text is None:
            strange = [str(name) for name in element.attrib if name not in ATTRIBUTES.get(element.tag, ())]
            near = [name for name in strange if did_you_mean(name, [key])]
            placed = [name for name in strange if element.tag == "origin" and not name.startswith("{")]  # quat_xyzw
            misspelt = next(iter(near + placed), None)
            if default is None or misspelt:
                hint = f"; {misspelt!r} is not known" if misspelt else ""
                raise self.fail(element, f"<{element.tag}> needs {key!r}{hint}")
            text = default
        words, problem = text.split(), ""
        bad = [word for word in words if not NUMBER.fullmatch(word) or not np.isfinite(float(word))]
        if bad:
            problem = f"{bad[0]!r} is not a finite decimal number"
        # Limits of 1e308 stand for none.
        elif element.tag != "limit" and any(abs(float(word)) > LARGEST for word in words):
            problem = f"beyond {LARGEST:g}, which nothing is in SI units"
        elif len(words) != count:
            problem = f"expected {count} numbers, got {len(words)}"
        if problem:
            raise self.fail(element, f"<{element.tag} {key}={text!r}>: {problem}")
        return np.array([float(word) for word in words])

    def number(self, element: etree._Element, key: str, default: str | None = None) -> float:
        return float(self.numbers(element, key, 1, default)[0])

    def children(self, element: etree._Element) -> list[etree._Element]:
        """Return the children that mean something here; an unknown tag is a fault, or a flag when lax."""
        allowed = CHILDREN[element.tag]
        kept = [child for child in element if isinstance(child.tag, str)]
        loop = next((child for child in kept if child.tag == "loop_joint"), None)
        if loop is not None:
            raise self.fail(loop, "<loop_joint> closes a chain of joints; closed loops are not supported")
        for child in kept:
            if child.tag not in allowed | PASSED_OVER:
                self._refuse_tag(element, child, allowed)
            for inner in child.iterchildren("*") if child.tag in LEAVES else ():
                if inner.tag not in PASSED_OVER:
                    self._refuse_tag(child, inner, frozenset())
        return [child for child in kept if child.tag in allowed]

    def _refuse_tag(self, element: etree._Element, child: etree._Element, allowed: frozenset[str]) -> None:
        """Keep an unknown or misplaced tag as a fault; flag it where what it could have meant is given anyway."""
        owner = next((tag for tag, inside in CHILDREN.items() if child.tag in inside), None)
        hint = f"; it belongs inside <{owner}>" if owner else did_you_mean(child.tag, allowed)
        if "xacro" in child.tag:
            hint = ": this is a xacro file, expand it first"
        problem = f"<{child.tag}> is not known inside <{element.tag}>{hint}"
        near = difflib.get_close_matches(child.tag, allowed, n=1, cutoff=0.5)
        if element.tag == "robot":
            harmless = not (near or owner or "xacro" in child.tag)
        else:
            meant = [part for part in element if child.tag in CHILDREN.get(part.tag, ())]
            harmless = bool(meant) and all(part.find(child.tag) is not None for part in meant)
        if harmless or not self.strict:
            self.flag(child, "unknown_tag", f"{problem}: passed over")
        elif element.tag == "robot":
            raise self.fail(child, problem)
        else:
            weighs = child.tag in WEIGHING or any(tag in WEIGHING for tag in near)
            self.faults.append(Fault(self.fail(child, problem), "carried" if weighs else "chain", "it is passed over"))

    def only(self, element: etree._Element, tag: str) -> etree._Element | None:
        elements = element.findall(tag)
        if len(elements) > 1:
            raise self.fail(elements[1], f"<{element.tag}> has more than one <{tag}>")
        return elements[0] if elements else None

    def needed(self, element: etree._Element, tag: str) -> etree._Element:
        child = self.only(element, tag)
        if child is None:
            raise self.fail(element, f"<{element.tag}> needs <{tag}>")
        return child

    def pose(self, element: etree._Element) -> tuple[Array, Array]:
        """Return (3,) position and (3, 3) rotation of the element's <origin>, identity when absent."""
        origin = self.only(element, "origin")
        if origin is None:
            return np.zeros(3), np.eye(3)
        xyz, rpy = (self.numbers(origin, key, 3, "0 0 0") for key in ("xyz", "rpy"))
        if np.abs(rpy).max() > 2.0 * np.pi:
            self.flag(origin, "rpy_in_degrees", f"rpy {origin.get('rpy')!r} exceeds a full turn: degrees?")
        return xyz, pin.rpy.rpyToMatrix(rpy)


Named = TypeVar("Named", Link, Joint)


def read_urdf(
    path: Path, strict: bool = True, made: etree._Element | None = None, translated: bool = False, hint: str = ""
) -> Urdf:
    """Read a URDF into links and joints; `translated` where the root `made` from the file has other lines.

    `hint` ends what is said of everything that is wrong.

    Raises:
        UrdfError: Not well-formed, over a cap, unknown or misplaced tags in the root (a flag when not `strict`),
            duplicate or missing names. What is wrong inside a link or joint is among its `faults`: whether it is an
            error depends on the chain that is asked about.
    """
    root: etree._Element = parse_xml(path) if made is None else made
    reader = Reader(path, strict, not translated, hint)
    if root.tag != "robot":
        raise reader.fail(root, f"root element is <{root.tag}>, expected <robot>")
    _flag_prefixes(reader, root)
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


def _flag_prefixes(reader: Reader, root: etree._Element) -> None:
    """Flag prefixes that nothing declares; what they stand before is judged as any other element is."""
    first: dict[str, etree._Element] = {}
    for element in root.iter("*"):
        for name in (str(element.tag), *map(str, element.attrib)):
            if ":" in name and not name.startswith("{"):
                first.setdefault(name.partition(":")[0], element)
    for prefix, element in first.items():
        reader.flag(element, "undeclared_prefix", f"no xmlns declares the prefix {prefix!r} of <{element.tag}>")


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
    colours = {}
    for element in root.iter("material"):
        color = element.find("color")
        if color is not None and color.get("rgba") and element.get("name"):
            try:
                rgba = reader.numbers(color, "rgba", 4)
            except UrdfError as error:
                reader.flag(color, "color", error.problem)
                continue
            red, green, blue = (round(255 * value) for value in np.clip(rgba[:3], 0.0, 1.0))
            colours[element.get("name")] = f"#{red:02x}{green:02x}{blue:02x}"
    return colours


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
            kinds = f"{', '.join(MOVING)}, fixed are"
            raise reader.fail(element, f"joint {name!r}: type {kind!r} is not supported; {kinds}")
    origin, rotation, axis = np.zeros(3), np.eye(3), np.array([1.0, 0.0, 0.0])
    with reader.fault("carried", "its child link is taken to be where its parent is"):
        origin, rotation = reader.pose(element)
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
