"""SDF: the one model of a file, and those inside it, as links and joints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from armflex.conventions import LARGEST, NUMBER, Array
from armflex.errors import Flag, Place, UrdfError, did_you_mean, listing
from armflex.robot.tree import FREE, Tree, rotation_of
from armflex.robot.urdf import MOVING, Inertial, Urdf

UNLIMITED = 1e15
"""Limits beyond this are how SDF says that there are none [rad or m]."""

MODEL = "__model__"
"""What SDF calls the model that something is in."""

ROUNDED = 1e-3
"""How far from 1 the length of a quaternion may be that was written with few digits."""

BOOLEAN = {"false": 1.0, "true": np.pi / 180.0, "0": 1.0, "1": np.pi / 180.0}
"""What an angle is multiplied by where `degrees` says so."""

Limits = tuple[float, float, float, float]


def read_sdf(path: Path, root: etree._Element) -> Urdf:
    """Return the links and joints of the one model of an SDF; those of a model inside it are named `model::link`.

    Raises:
        UrdfError: What is meant is not clear, or not supported.
    """
    models = [*root.findall("model"), *root.findall("world/model")]
    if len(models) != 1:
        raise _Values(path).fail(root, f"has {len(models)} models, expected one")
    model, tree = _Model(path, models[0]), Tree(path)
    for name, element in model.parts.items():
        if element.tag == "link":
            tree.link(name, _inertial(model, name, element), element.sourceline or 0)
    for name, element in model.parts.items():
        if element.tag == "joint":
            _add_joint(tree, model, name, element)
    joints = tree.joints.values()
    light = [one.child for one in joints if one.child in model.parts and tree.links[one.child].inertial is None]
    if light:
        text = f"{path}: {listing(light)}: no <inertial>, which is 1 kg in SDF; here they have no mass"
        tree.flags.append(Flag("default_mass", text))
    return tree.robot(models[0].get("name") or path.stem)


def _inertial(model: _Model, name: str, element: etree._Element) -> Inertial | None:
    """Return the mass of a link, about its centre in the link's frame."""
    given, matrix = element.find("inertial"), np.zeros((3, 3))
    if given is None:
        return None
    if _relative(given):
        raise model.fail(given, f"link {name!r}: the pose of <inertial> is in the link, not relative to another")
    pose, inertia = model.pose(given), given.find("inertia")
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        if inertia is not None:
            value = model.number(inertia, f"i{'xyz'[i]}{'xyz'[j]}", "0" if i != j else None)
            matrix[i, j] = matrix[j, i] = value
    mass = model.number(given, "mass")
    if mass < 0.0:
        raise model.fail(given, f"link {name!r}: mass is {mass:g} kg, expected more than 0")
    where = Place(model.path, given.sourceline or 0)
    return Inertial(mass, pose.translation.copy(), pose.rotation.copy(), matrix, where)


def _add_joint(tree: Tree, model: _Model, name: str, element: etree._Element) -> None:
    """Add a joint to the tree, and the world where it stands on that."""
    parent, child, kind = model.end(name, "parent"), model.end(name, "child"), element.get("type") or ""
    if parent == "world" and "world" not in tree.links:
        tree.link("world", None)
    axis, limits, problem, given = np.eye(3)[0], FREE, "", element.find("axis")
    if kind not in (*MOVING, "fixed"):
        problem = f"joint {name!r}: type {kind!r} is not supported; {', '.join(MOVING)}, fixed are"
    elif kind != "fixed":
        if given is None:
            raise model.fail(element, f"joint {name!r} has no <axis>")
        axis, limits = _axis(model, name, given), _limits(model, given.find("limit"))
        if given.find("mimic") is not None:
            problem = f"joint {name!r} follows another by <mimic>, which is not supported"
        if kind == "revolute" and np.isinf(limits[:2]).all():
            kind = "continuous"
    at = model.place(parent).inverse() * model.place(name)
    rest = model.place(name).inverse() * model.place(child)
    tree.joint(name, kind, (parent, child), at, rest, axis, limits, element.sourceline or 0, problem)


def _axis(model: _Model, name: str, given: etree._Element) -> Array:
    """Return the (3,) unit vector of a joint's axis in its own frame."""
    xyz = given.find("xyz")
    axis = model.numbers(xyz, 3, "0 0 1")
    if not (size := float(np.linalg.norm(axis))):
        raise model.fail(given, f"joint {name!r}: axis is zero")
    frame = None if xyz is None else xyz.get("expressed_in") or None
    if (given.findtext("use_parent_model_frame") or "").strip() in ("1", "true"):
        frame = MODEL
    if frame is not None:
        axis = model.place(name).rotation.T @ model.place(model.named(model.scopes[name], frame)).rotation @ axis
    return axis / size


def _limits(model: _Model, limit: etree._Element | None) -> Limits:
    """Return lower and upper limit, effort and velocity."""
    if limit is None:
        return FREE
    lower, upper = model.number(limit, "lower", "-1e16"), model.number(limit, "upper", "1e16")
    effort, velocity = model.number(limit, "effort", "-1"), model.number(limit, "velocity", "-1")
    lower, upper = (float(np.copysign(np.inf, x)) if abs(x) >= UNLIMITED else x for x in (lower, upper))
    effort, velocity = (x if x > 0.0 else np.inf for x in (effort, velocity))
    return lower, upper, effort, velocity


def _relative(element: etree._Element) -> str:
    """Return what the pose of an element is relative to, '' where that is its parent."""
    given = element.find("pose")
    return "" if given is None else (given.get("relative_to") or given.get("frame") or "")


class _Values:
    """Numbers and poses of a file's elements."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def fail(self, element: etree._Element, problem: str) -> UrdfError:
        """Return an error that names the element's line."""
        return UrdfError(Place(self.path, element.sourceline or 0), problem)

    def numbers(self, element: etree._Element | None, count: int, default: str) -> Array:
        """Return (count,) numbers that an element has for its text."""
        words = ((element.text if element is not None else None) or default).split()
        tag = "" if element is None else element.tag
        known = {"relative_to", "expressed_in", "frame", "degrees", "rotation_format"}
        if element is not None and (odd := set(map(str, element.attrib)) - known):
            raise self.fail(element, f"<{tag} {min(odd)}=...> is not supported: write metres, radians, roll pitch yaw")
        fine = [NUMBER.fullmatch(word) is not None and abs(float(word)) <= LARGEST for word in words]
        if element is not None and (len(words) != count or not all(fine)):
            expected = "a finite number" if count == 1 else f"{count} finite numbers"
            raise self.fail(element, f"<{tag}> {' '.join(words)!r}: expected {expected}")
        return np.array([float(word) for word in words])

    def number(self, parent: etree._Element, tag: str, default: str | None = None) -> float:
        """Return the number of an element's child."""
        element = parent.find(tag)
        if element is None and default is None:
            raise self.fail(parent, f"<{parent.tag}> needs <{tag}>")
        return float(self.numbers(element, 1, default or "0")[0])

    def chosen(self, element: etree._Element, key: str, choices: dict[str, Any]) -> Any:
        """Return what one of the words that an attribute may be stands for; the first is meant where it is absent."""
        word = element.get(key) or next(iter(choices))
        if word not in choices:
            raise self.fail(element, f"<{element.tag} {key}={word!r}>: expected {' or '.join(choices)}")
        return choices[word]

    def pose(self, element: etree._Element) -> pin.SE3:
        """Return the pose that an element gives."""
        given = element.find("pose")
        if given is None:
            return pin.SE3.Identity()
        unit = self.chosen(given, "degrees", BOOLEAN)
        if self.chosen(given, "rotation_format", {"euler_rpy": True, "quat_xyzw": False}):
            values = self.numbers(given, 6, "0 0 0 0 0 0")
            return pin.SE3(pin.rpy.rpyToMatrix(unit * values[3:]), values[:3])
        values = self.numbers(given, 7, "0 0 0 0 0 0 1")
        if unit != 1.0 or abs(np.linalg.norm(values[3:]) - 1.0) > ROUNDED:
            raise self.fail(given, "a quaternion x y z w is a unit vector, and has no degrees")
        return pin.SE3(rotation_of(values[[6, 3, 4, 5]]), values[:3])


class _Model(_Values):
    """A model and what is inside it: links, joints, frames and models by name, and where they are.

    Attributes:
        parts: Elements by name, those of a model inside as `model::name`.
        scopes: What of each name is the model that it is in, with the colons at its end.
    """

    def __init__(self, path: Path, model: etree._Element) -> None:
        super().__init__(path)
        self.parts: dict[str, etree._Element] = {}
        self.scopes: dict[str, str] = {}
        self._model, self._places = model, {MODEL: pin.SE3.Identity()}
        self._collect(model, "")

    def _collect(self, model: etree._Element, scope: str) -> None:
        parts, scopes = self.parts, self.scopes
        for nested in model.findall("include"):
            raise self.fail(nested, f"<{nested.tag}> inside <model> is not supported: merge the models into one first")
        for kind in ("link", "joint", "frame", "model"):
            for element in model.findall(kind):
                if not (name := (element.get("name") or "").strip()):
                    raise self.fail(element, f"<{element.tag}> needs a non-empty 'name'")
                if "::" in name or name in ("world", MODEL):
                    raise self.fail(element, f"{element.tag} {name!r}: this name means something else in SDF")
                if scope + name in parts:
                    first = parts[scope + name].sourceline
                    text = f"second {element.tag} or frame named {scope + name!r}; the first is at line {first}"
                    raise self.fail(element, text)
                parts[scope + name], scopes[scope + name] = element, scope
                if kind == "model":
                    if (element.findtext("static") or "").strip() in ("1", "true"):
                        text = f"model {scope + name!r} is static inside another: fix it by a joint"
                        raise self.fail(element, text)
                    self._collect(element, f"{scope}{name}::")

    def named(self, scope: str, name: str) -> str:
        """Return what a name means inside a model, whose own is the scope without the colons at its end."""
        if name in ("", MODEL):
            return scope[:-2] or MODEL
        return name if name == "world" else scope + name

    def canonical(self, name: str) -> str:
        """Return the link that a model stands for."""
        element, scope = (self._model, "") if name == MODEL else (self.parts[name], f"{name}::")
        if given := element.get("canonical_link"):
            return self.named(scope, given)
        links = [one for one, part in self.parts.items() if part.tag == "link" and one.startswith(scope)]
        return next((one for one in links if self.scopes[one] == scope), (links or [name])[0])

    def end(self, joint: str, tag: str) -> str:
        """Return the link that a joint calls its parent or child, through the frames and models between."""
        parts = self.parts
        text = (parts[joint].findtext(tag) or "").strip()
        name = self.named(self.scopes[joint], text) if text else ""
        passed = [name]
        while name == MODEL or (name in parts and parts[name].tag in ("frame", "model")):
            frame = name != MODEL and parts[name].tag == "frame"
            attached = frame and (parts[name].get("attached_to") or "")
            name = self.named(self.scopes[name], attached or "") if frame else self.canonical(name)
            if name in passed:
                raise self.fail(parts[joint], f"frames are attached in a circle: {' -> '.join([*passed, name])}")
            passed.append(name)
        if name != "world" and (name not in parts or parts[name].tag != "link"):
            known = [one for one, element in parts.items() if element.tag == "link"]
            hint = f"{did_you_mean(name, known)} (known: {listing(known)})"
            raise self.fail(parts[joint], f"joint {joint!r}, {tag}: no link named {name!r}{hint}")
        return name

    def place(self, name: str, asked: tuple[str, ...] = ()) -> pin.SE3:
        """Return the pose of a part in the model."""
        places, parts, model = self._places, self.parts, self._model
        if name in places:
            return places[name]
        if name not in parts and name != "world":
            raise self.fail(model, f"no frame named {name!r}{did_you_mean(name, parts)}")
        if name in asked:
            raise self.fail(parts[name], f"poses are relative to each other in a circle: {' -> '.join([*asked, name])}")
        if name == "world":
            if _relative(model) not in ("", "world"):
                raise self.fail(model, f"the model's pose is relative to {_relative(model)!r}, expected the world")
            places[name] = self._through(model, "", asked) * self.pose(model).inverse()
            return places[name]
        element, scope = parts[name], self.scopes[name]
        if given := _relative(element):
            origin = self.named(scope, given)
        elif element.tag == "joint":
            origin = self.end(name, "child")
        else:
            origin = self.named(scope, (element.get("attached_to") or "") if element.tag == "frame" else "")
        found = self.place(origin, (*asked, name)) * self.pose(element)
        if element.tag == "model":
            found = found * self._through(element, f"{name}::", (*asked, name)).inverse()
        places[name] = found
        return found

    def _through(self, model: etree._Element, scope: str, asked: tuple[str, ...]) -> pin.SE3:
        """Return where in a model the frame is that its pose is of."""
        if not (frame := model.get("placement_frame")):
            return pin.SE3.Identity()
        before = dict(self._places)
        self._places[self.named(scope, "")] = pin.SE3.Identity()
        found = self.place(self.named(scope, frame), asked)
        self._places.clear()
        self._places.update(before)
        return found
