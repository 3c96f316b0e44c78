"""Safe reading of a URDF's XML, and typed access to its elements: numbers by an own grammar, known tags, file and line.

There are caps on size and depth, no DTD and no entities. `float()` takes '1_000' and full-width digits, C's `strtod`
takes '0x64' and stops at the comma of '1,5'; no two URDF readers agree on such files, so they are refused.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from lxml import etree

from armflex.conventions import LARGEST, NUMBER, Array, unprintable
from armflex.errors import Flag, Place, UrdfError, did_you_mean

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

ATTRIBUTES = {
    "origin": ("xyz", "rpy"),
    "inertia": ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"),
    "limit": ("lower", "upper", "effort", "velocity"),
    "mimic": ("joint", "multiplier", "offset"),
}
"""What an element that has defaults may say; a misspelt one would silently mean the default."""

WEIGHING = ("inertial", "mass", "inertia", "origin")
"""Tags without which a body weighs less, or elsewhere."""

Matters = Literal["chain", "carried", "moved"]


def parse_xml(path: Path, text: bytes | None = None) -> etree._Element:
    """Return the root element of an XML file, or of a text that was made from it.

    Raises:
        UrdfError: The file is missing, empty, larger than `MAX_BYTES`, not UTF-8, truncated, deeper than
            `MAX_DEPTH`, has a text that cannot be shown, or a document type definition (entities could read files or
            explode).
    """
    try:
        if (size := path.stat().st_size if text is None else len(text)) > MAX_BYTES:
            raise UrdfError(Place(path), f"is {size} bytes, more than the {MAX_BYTES} allowed")
        data = path.read_bytes() if text is None else text
        if not data.strip():
            raise UrdfError(Place(path), "is empty")
        if "\0" in data.decode("utf-8"):
            raise UrdfError(Place(path), "holds NUL characters: binary or UTF-16?")
        parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
        root = etree.fromstring(data, parser)
    except OSError as error:
        raise UrdfError(Place(path), f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UrdfError(Place(path), "is not UTF-8 text (binary or UTF-16?)") from None
    except etree.XMLSyntaxError as error:
        raise UrdfError(Place(path, error.lineno or 0), f"not well-formed XML: {error.msg}") from None
    if root.getroottree().docinfo.doctype:  # pyright: ignore[reportAttributeAccessIssue] - lxml has it, its stubs not
        raise UrdfError(Place(path, 1), "has a document type definition (DTD); entities are refused")
    stack = [(root, 1)]  # the interpreter's own stack must not be the limit
    while stack:
        element, depth = stack.pop()
        where = Place(path, element.sourceline or 0)
        if depth > MAX_DEPTH:
            raise UrdfError(where, f"nested deeper than {MAX_DEPTH} elements")
        for name, value in element.attrib.items():
            if found := unprintable(str(value)):
                raise UrdfError(where, f"<{element.tag} {name}={value!r}> {found[1]}")
        stack.extend((child, depth + 1) for child in element if isinstance(child.tag, str))
    return root


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


class Reader:
    """Typed access to one file's elements; collects flags and words every error with file and line."""

    def __init__(self, path: Path, strict: bool, lines: bool = True) -> None:
        self.path, self.strict, self._lines = path, strict, lines
        self.flags: list[Flag] = []
        self.faults: list[Fault] = []

    def place(self, element: etree._Element) -> Place:
        return Place(self.path, (element.sourceline or 0) if self._lines else 0)

    def fail(self, element: etree._Element, problem: str) -> UrdfError:
        return UrdfError(self.place(element), problem)

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
        found, self.faults = tuple(self.faults), []
        return found

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
            misspelt = next((name for name in strange if did_you_mean(name, [key])), None)
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
        found = element.findall(tag)
        if len(found) > 1:
            raise self.fail(found[1], f"<{element.tag}> has more than one <{tag}>")
        return found[0] if found else None

    def needed(self, element: etree._Element, tag: str) -> etree._Element:
        found = self.only(element, tag)
        if found is None:
            raise self.fail(element, f"<{element.tag}> needs <{tag}>")
        return found

    def pose(self, element: etree._Element) -> tuple[Array, Array]:
        """Return (3,) position and (3, 3) rotation of the element's <origin>, identity when absent."""
        origin = self.only(element, "origin")
        if origin is None:
            return np.zeros(3), np.eye(3)
        rpy = self.numbers(origin, "rpy", 3, "0 0 0")
        if np.abs(rpy).max() > 2.0 * np.pi:
            self.flag(origin, "rpy_in_degrees", f"rpy {origin.get('rpy')!r} exceeds a full turn: degrees?")
        return self.numbers(origin, "xyz", 3, "0 0 0"), rotation_of(rpy)


def rotation_of(rpy: Array) -> Array:
    """Return the (3, 3) rotation of fixed-axis roll, pitch, yaw [rad] (URDF: Rz(y) Ry(p) Rx(r))."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
