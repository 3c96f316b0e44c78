"""Robots in other files than URDF: xacro, which a library expands, MJCF, which MuJoCo reads itself, and SDF.

All become links and joints as a URDF has them, and are judged as those are. Where a joint's axis is not through its
child's origin, as it is in a URDF, a link without mass stands between.
"""

from __future__ import annotations

import re
import subprocess
import sys
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from armflex.conventions import LARGEST, NUMBER, Array
from armflex.errors import Flag, Place, UntrustedError, UrdfError, did_you_mean, listing
from armflex.robot import xacro_process
from armflex.robot.urdf import (
    MAX_LINKS,
    MOVING,
    RESERVED,
    WIDEST,
    Fault,
    Inertial,
    Joint,
    Link,
    Urdf,
    parse_xml,
    read_urdf,
)
from armflex.storage.trust import is_trusted, sha256_of

UNLIMITED = 1e15
"""Limits beyond this are how SDF says that there are none [rad or m]."""

MODEL = "__model__"
"""What SDF calls the model that something is in."""

ROUNDED = 1e-3
"""How far from 1 the length of a quaternion may be that was written with few digits."""

FREE = (-np.inf, np.inf, np.inf, np.inf)
"""Lower and upper limit, effort and velocity of a joint of which nothing is said."""


def read_other(path: Path, root: etree._Element, strict: bool = True) -> Urdf:
    """Return the robot of a xacro file (by its suffix), MJCF or SDF (by their root elements).

    Raises:
        UrdfError: As `read_urdf`; the library that a format needs is not installed, or refuses the file.
        UntrustedError: A xacro file asks for the environment, or for a file elsewhere.
    """
    if path.suffix.lower() == ".xacro":
        return read_urdf(path, strict, parse_xml(path, _expanded(path)), translated=True)
    return _read_mjcf(path, root) if root.tag == "mujoco" else _read_sdf(path, root)


def _expanded(path: Path) -> bytes:
    """Return the URDF that a xacro file stands for, its arguments at their defaults; `xacro_process` has the limits."""
    if not any(find_spec(name) for name in xacro_process.LIBRARIES):
        text = "is a xacro file, which needs a library to be expanded: pip install xacrodoc (or xacro)"
        raise UrdfError(Place(path), f"{text}; or expand it yourself, xacro {path.name} > robot.urdf")
    digest = sha256_of(path)
    command = [sys.executable, "-P", xacro_process.__file__, path.name, "trusted" if is_trusted(digest) else ""]
    ended, limit = None, xacro_process.PATIENCE
    with suppress(subprocess.TimeoutExpired):
        ended = subprocess.run(command, cwd=path.parent, stdin=subprocess.DEVNULL, capture_output=True, timeout=limit)
    if ended is not None and ended.returncode == 0:
        return ended.stdout
    said = "" if ended is None else ended.stdout.decode("utf-8", "replace")
    if ended is not None and ended.returncode == xacro_process.REFUSED:
        raise UntrustedError(Place(path), f"is xacro that {said}", digest)
    if not said:
        said = f"cannot be expanded within {xacro_process.SECONDS} s and {xacro_process.MEMORY >> 20} MB"
    raise UrdfError(Place(path), said)


class _Tree:
    """The links and joints of a file as they are met."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.links: dict[str, Link] = {}
        self.joints: dict[str, Joint] = {}
        self.flags: list[Flag] = []
        self.gravity: tuple[float, float, float] | None = None

    def link(self, name: str, inertial: Inertial | None, line: int = 0, between: bool = False) -> None:
        """Add a link."""
        place = Place(self.path, line)
        if name in self.links:
            raise UrdfError(place, f"second link named {name!r}; the first is at {self.links[name].place}")
        if len(self.links) >= MAX_LINKS:
            raise UrdfError(Place(self.path), f"has more than the {MAX_LINKS} links allowed")
        self.links[name] = Link(name, inertial, (), place, between=between)

    def joint(
        self,
        name: str,
        kind: str,
        ends: tuple[str, str],
        at: pin.SE3,
        rest: pin.SE3,
        axis: Array,
        limits: tuple[float, float, float, float] = FREE,
        line: int = 0,
        problem: str = "",
    ) -> None:
        """Add a joint from a parent's to a child's link: its frame in the parent's, the child's frame in its own.

        A `problem` is an error only where the joint is one of the chain.
        """
        place, (parent, child) = Place(self.path, line), ends
        if name in self.joints:
            raise UrdfError(place, f"second joint named {name!r}; the first is at {self.joints[name].place}")
        if RESERVED.fullmatch(name):
            raise UrdfError(place, f"joint {name!r}: this name is taken by the mechanics, choose another")
        if limits[0] > limits[1]:
            raise UrdfError(place, f"joint {name!r}: lower limit {limits[0]:g} exceeds upper limit {limits[1]:g}")
        if kind == "revolute" and WIDEST < max(abs(limits[0]), abs(limits[1])) < np.inf:
            text = f"joint {name!r}: limits {limits[0]:g} to {limits[1]:g} rad exceed two turns: degrees?"
            self.flags.append(Flag("limit_in_degrees", f"{place}: {text}"))
        faults = (Fault(UrdfError(place, problem), "chain", "it is held as it stands"),) if problem else ()
        if kind == "fixed" or problem:
            at, rest = at * rest, pin.SE3.Identity()
        between = child
        if not rest.isIdentity(1e-12):
            between = f"{child}/{name}"
            self.link(between, None, line, between=True)
            self.joint(f"{name}/{child}", "fixed", (between, child), rest, pin.SE3.Identity(), axis, FREE, line)
        pose = (at.translation.copy(), at.rotation.copy())
        self.joints[name] = Joint(name, kind, parent, between, *pose, axis, *limits, None, place, faults)

    def robot(self, name: str) -> Urdf:
        """Return all of them.

        Raises:
            UrdfError: There is none.
        """
        if not self.links:
            raise UrdfError(Place(self.path), f"{name!r} has no links")
        return Urdf(name, self.path, self.links, self.joints, tuple(self.flags), translated=True, gravity=self.gravity)


def _read_mjcf(path: Path, root: etree._Element) -> Urdf:
    """Return the bodies and joints of MJCF as MuJoCo compiles them; sites are links as well, without mass.

    Joints turn and slide from where `ref` says that they stand. Meshes are opened where masses follow from them.
    """
    try:
        mujoco: Any = import_module("mujoco")
    except ImportError:
        raise UrdfError(Place(path), "is MJCF, which MuJoCo itself reads: pip install mujoco") from None
    model, flags = _compiled(mujoco, path)
    lines = {(str(one.tag), one.get("name")): one.sourceline or 0 for one in root.iter() if isinstance(one.tag, str)}
    tree, kinds = _Tree(path), mujoco.mjtJoint
    named = {int(kinds.mjJNT_HINGE): "revolute", int(kinds.mjJNT_SLIDE): "prismatic", int(kinds.mjJNT_BALL): "ball"}
    bodies = [model.body(i).name or f"body{i}" for i in range(model.nbody)]
    joints = [model.joint(i).name or f"joint{i}" for i in range(model.njnt)]
    sites = [model.site(i).name for i in range(model.nsite)]
    for kind, names in (("body", bodies), ("joint", joints), ("site", sites)):
        for key in ("pos", "quat", "axis", "ipos", "iquat", "mass", "inertia"):
            found = getattr(model, f"{'jnt' if kind == 'joint' else kind}_{key}", None)
            if found is None or not names:
                continue
            for i in np.flatnonzero(~(np.abs(found.reshape(len(names), -1)) <= LARGEST).all(axis=1)):
                where, numbers = Place(path, lines.get((kind, names[i]), 0)), listing(map(str, np.ravel(found[i])))
                raise UrdfError(where, f"{kind} {names[i]!r}: {key} is {numbers}, expected finite numbers")
    loops = _loops(mujoco, model, bodies)
    efforts = np.where(model.jnt_actfrclimited, np.abs(model.jnt_actfrcrange).max(axis=1, initial=0.0), np.inf)
    for i in range(model.nu):
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_forcelimited[i]:
            own, gear = model.actuator_trnid[i, 0], abs(float(model.actuator_gear[i, 0]))
            efforts[own] = min(efforts[own], gear * float(np.abs(model.actuator_forcerange[i]).max()) or np.inf)
    tree.link("world" if bodies[0] == "body0" else bodies[0], None)
    for i in range(1, model.nbody):
        line = lines.get(("body", bodies[i]), 0)
        inertial = None
        if model.body_mass[i] > 0.0:
            turn, moments = _turn(model.body_iquat[i]), np.diag(model.body_inertia[i])
            inertial = Inertial(float(model.body_mass[i]), model.body_ipos[i].copy(), turn, moments, Place(path, line))
        tree.link(bodies[i], inertial, line)
        if model.body_gravcomp[i]:
            text = f"{Place(path, line)}: body {bodies[i]!r} has gravcomp, which is a controller's: it weighs here"
            tree.flags.append(Flag("gravcomp", text))
        parent, here = bodies[model.body_parentid[i]], pin.SE3(_turn(model.body_quat[i]), model.body_pos[i].copy())
        own = range(model.body_jntadr[i], model.body_jntadr[i] + model.body_jntnum[i])
        if not own:
            tree.joint(f"{bodies[i]}_fixed", "fixed", (parent, bodies[i]), here, pin.SE3.Identity(), np.eye(3)[0],
                       line=line)  # fmt: skip
        for j in own:
            kind, axis = (
                named.get(int(model.jnt_type[j]), "floating"),
                model.jnt_axis[j] / np.linalg.norm(model.jnt_axis[j]),
            )
            shift, where = pin.SE3(np.eye(3), model.jnt_pos[j].copy()), lines.get(("joint", joints[j]), line)
            problem = loops.get(i, "")
            if kind in ("ball", "floating"):
                known = ", ".join(MOVING)
                problem = f"joint {joints[j]!r}: type {kind!r} is not supported; {known}, fixed are"
                shift = pin.SE3.Identity()
            limits = (-np.inf, np.inf, float(efforts[j]), np.inf)
            if model.jnt_limited[j]:
                limits = (float(model.jnt_range[j, 0]), float(model.jnt_range[j, 1]), *limits[2:])
            elif kind == "revolute":
                kind = "continuous"
            ref = 0.0 if problem else -float(model.qpos0[model.jnt_qposadr[j]])
            back = pin.SE3(np.eye(3), ref * axis) if kind == "prismatic" else pin.SE3(pin.exp3(ref * axis), np.zeros(3))
            last = j == own[-1]
            child = bodies[i] if last else f"{bodies[i]}/{joints[j]}"
            if not last:
                tree.link(child, None, line, between=True)
            ends, at = (parent, child), here * shift * back
            rest = shift.inverse() if last else pin.SE3.Identity()
            tree.joint(joints[j], kind, ends, at, rest, axis.copy(), limits, where, problem)
            parent, here = child, shift.inverse()
    for i, name in enumerate(sites):
        if name and name not in tree.links:
            line = lines.get(("site", name), 0)
            tree.link(name, None, line)
            place = pin.SE3(_turn(model.site_quat[i]), model.site_pos[i].copy())
            ends = (bodies[model.site_bodyid[i]], name)
            tree.joint(f"{name}_fixed", "fixed", ends, place, pin.SE3.Identity(), np.eye(3)[0], line=line)
    tree.flags += flags
    if root.find("option[@gravity]") is not None:
        x, y, z = model.opt.gravity.tolist()
        tree.gravity = (x, y, z)
    return tree.robot(root.get("model") or path.stem)


def _compiled(mujoco: Any, path: Path) -> tuple[Any, list[Flag]]:
    """Return MuJoCo's model of a file, without its meshes where these are missing and no mass follows from them.

    What MuJoCo warns of are flags; it would write them to a file where the program runs.
    """
    warned: list[str] = []
    mujoco.set_mju_user_warning(warned.append)
    try:
        model, flags = _with_meshes_or_without(mujoco, path)
    finally:
        mujoco.set_mju_user_warning(None)
    if wrong := [text for text in warned if "nan" in text.lower()]:
        raise UrdfError(Place(path), f"MuJoCo says: {' '.join(wrong[0].split())}")
    return model, [*flags, *(Flag("mujoco", f"{path}: {' '.join(text.split())}") for text in warned)]


def _with_meshes_or_without(mujoco: Any, path: Path) -> tuple[Any, list[Flag]]:
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        try:
            return spec.compile(), []
        except ValueError as error:
            spec = mujoco.MjSpec.from_file(str(path))
            meshed = [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH]
            if not meshed or not all(geom.parent.explicitinertial or geom.mass == 0.0 for geom in meshed):
                raise
            for one in (*meshed, *spec.meshes):
                spec.delete(one)
            text = f"{path}: its meshes are left out, as no mass follows from them ({' '.join(str(error).split())})"
            return spec.compile(), [Flag("visual", text)]
    except ValueError as error:
        told = " ".join(str(error).split())
        line = re.search(r"line (\d+)", told)
        raise UrdfError(Place(path, int(line[1]) if line else 0), f"MuJoCo cannot read it: {told}") from None


def _loops(mujoco: Any, model: Any, bodies: list[str]) -> dict[int, str]:
    """Return what is said of the bodies that close a loop with others, by number."""
    found: dict[int, str] = {}
    tied, follows = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)), int(mujoco.mjtEq.mjEQ_JOINT)
    for i in np.flatnonzero(model.eq_active0):
        ends = (int(model.eq_obj1id[i]), int(model.eq_obj2id[i]))
        if int(model.eq_type[i]) in tied:
            if int(model.eq_objtype[i]) == int(mujoco.mjtObj.mjOBJ_SITE):
                ends = (int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]]))
            ways = []
            for end in ends:
                way = [end]
                while way[-1]:
                    way.append(int(model.body_parentid[way[-1]]))
                ways.append(way)
            pair = " to ".join(repr(bodies[end]) for end in ends)
            for body in set(ways[0]) ^ set(ways[1]):
                found[body] = f"an equality ties body {pair}, which closes a loop; closed loops are not supported"
        elif int(model.eq_type[i]) == follows:
            joint, master = ends
            whom = repr(model.joint(master).name) if master >= 0 else "a constant"
            text = f"an equality makes joint {model.joint(joint).name!r} follow {whom}, which is not supported"
            found[int(model.jnt_bodyid[joint])] = text
    return found


def _turn(quaternion: Array) -> Array:
    """Return the (3, 3) rotation of w x y z."""
    w, vector = float(quaternion[0]), quaternion[1:]
    size = float(np.linalg.norm(vector))
    return pin.exp3(2.0 * np.arctan2(size, w) * (vector / size if size else np.eye(3)[0]))


def _read_sdf(path: Path, root: etree._Element) -> Urdf:
    """Return the links and joints of the one model of an SDF; those of a model inside it are named `model::link`."""

    def fail(element: etree._Element, problem: str) -> UrdfError:
        return UrdfError(Place(path, element.sourceline or 0), problem)

    def numbers(element: etree._Element | None, count: int, default: str) -> Array:
        words = ((element.text if element is not None else None) or default).split()
        tag = "" if element is None else element.tag
        known = {"relative_to", "expressed_in", "frame", "degrees", "rotation_format"}
        if element is not None and (odd := set(map(str, element.attrib)) - known):
            raise fail(element, f"<{tag} {min(odd)}=...> is not supported: write metres, radians, roll pitch yaw")
        fine = [NUMBER.fullmatch(word) is not None and abs(float(word)) <= LARGEST for word in words]
        if len(words) != count or not all(fine):
            expected = "a finite number" if count == 1 else f"{count} finite numbers"
            raise fail(root if element is None else element, f"<{tag}> {' '.join(words)!r}: expected {expected}")
        return np.array([float(word) for word in words])

    def number(parent: etree._Element, tag: str, default: str | None = None) -> float:
        element = parent.find(tag)
        if element is None and default is None:
            raise fail(parent, f"<{parent.tag}> needs <{tag}>")
        return float(numbers(element, 1, default or "0")[0])

    def chosen(element: etree._Element, key: str, choices: dict[str, Any]) -> Any:
        """Return what one of the words that an attribute may be stands for; the first is meant where it is absent."""
        word = element.get(key) or next(iter(choices))
        if word not in choices:
            raise fail(element, f"<{element.tag} {key}={word!r}>: expected {' or '.join(choices)}")
        return choices[word]

    def relative(element: etree._Element) -> str:
        given = element.find("pose")
        return "" if given is None else (given.get("relative_to") or given.get("frame") or "")

    def posed(element: etree._Element) -> pin.SE3:
        given = element.find("pose")
        if given is None:
            return pin.SE3.Identity()
        unit = chosen(given, "degrees", {"false": 1.0, "true": np.pi / 180.0, "0": 1.0, "1": np.pi / 180.0})
        if chosen(given, "rotation_format", {"euler_rpy": True, "quat_xyzw": False}):
            values = numbers(given, 6, "0 0 0 0 0 0")
            return pin.SE3(pin.rpy.rpyToMatrix(unit * values[3:]), values[:3])
        values = numbers(given, 7, "0 0 0 0 0 0 1")
        if unit != 1.0 or abs(np.linalg.norm(values[3:]) - 1.0) > ROUNDED:
            raise fail(given, "a quaternion x y z w is a unit vector, and has no degrees")
        return pin.SE3(_turn(values[[6, 3, 4, 5]]), values[:3])

    models = [*root.findall("model"), *root.findall("world/model")]
    if len(models) != 1:
        raise fail(root, f"has {len(models)} models, expected one")
    parts: dict[str, etree._Element] = {}
    scopes: dict[str, str] = {}

    def collect(model: etree._Element, scope: str) -> None:
        for nested in model.findall("include"):
            raise fail(nested, f"<{nested.tag}> inside <model> is not supported: merge the models into one first")
        for kind in ("link", "joint", "frame", "model"):
            for element in model.findall(kind):
                if not (name := (element.get("name") or "").strip()):
                    raise fail(element, f"<{element.tag}> needs a non-empty 'name'")
                if "::" in name or name in ("world", MODEL):
                    raise fail(element, f"{element.tag} {name!r}: this name means something else in SDF")
                if scope + name in parts:
                    raise fail(element, f"second {element.tag} or frame named {scope + name!r}; the first is at line "
                                        f"{parts[scope + name].sourceline}")  # fmt: skip
                parts[scope + name], scopes[scope + name] = element, scope
                if kind == "model":
                    if (element.findtext("static") or "").strip() in ("1", "true"):
                        raise fail(element, f"model {scope + name!r} is static inside another: fix it by a joint")
                    collect(element, f"{scope}{name}::")

    def named(scope: str, name: str) -> str:
        """Return what a name means inside a model, whose own is the scope without the colons at its end."""
        if name in ("", MODEL):
            return scope[:-2] or MODEL
        return name if name == "world" else scope + name

    def canonical(name: str) -> str:
        """Return the link that a model stands for."""
        element, scope = (models[0], "") if name == MODEL else (parts[name], f"{name}::")
        if given := element.get("canonical_link"):
            return named(scope, given)
        links = [one for one, part in parts.items() if part.tag == "link" and one.startswith(scope)]
        return next((one for one in links if scopes[one] == scope), (links or [name])[0])

    collect(models[0], "")

    def end(joint: str, tag: str) -> str:
        text = (parts[joint].findtext(tag) or "").strip()
        name = named(scopes[joint], text) if text else ""
        seen = [name]
        while name == MODEL or (name in parts and parts[name].tag in ("frame", "model")):
            frame = name != MODEL and parts[name].tag == "frame"
            name = named(scopes[name], parts[name].get("attached_to") or "") if frame else canonical(name)
            if name in seen:
                raise fail(parts[joint], f"frames are attached in a circle: {' -> '.join([*seen, name])}")
            seen.append(name)
        if name != "world" and (name not in parts or parts[name].tag != "link"):
            known = [one for one, element in parts.items() if element.tag == "link"]
            hint = f"{did_you_mean(name, known)} (known: {listing(known)})"
            raise fail(parts[joint], f"joint {joint!r}, {tag}: no link named {name!r}{hint}")
        return name

    places: dict[str, pin.SE3] = {MODEL: pin.SE3.Identity()}

    def place(name: str, asked: tuple[str, ...] = ()) -> pin.SE3:
        """Return the pose of a part in the model."""
        if name in places:
            return places[name]
        if name not in parts and name != "world":
            raise fail(models[0], f"no frame named {name!r}{did_you_mean(name, parts)}")
        if name in asked:
            raise fail(parts[name], f"poses are relative to each other in a circle: {' -> '.join([*asked, name])}")
        if name == "world":
            if relative(models[0]) not in ("", "world"):
                raise fail(models[0], f"the model's pose is relative to {relative(models[0])!r}, expected the world")
            places[name] = through(models[0], "", asked) * posed(models[0]).inverse()
            return places[name]
        element, scope = parts[name], scopes[name]
        if given := relative(element):
            origin = named(scope, given)
        elif element.tag == "joint":
            origin = end(name, "child")
        else:
            origin = named(scope, (element.get("attached_to") or "") if element.tag == "frame" else "")
        found = place(origin, (*asked, name)) * posed(element)
        if element.tag == "model":
            found = found * through(element, f"{name}::", (*asked, name)).inverse()
        places[name] = found
        return found

    def through(model: etree._Element, scope: str, asked: tuple[str, ...]) -> pin.SE3:
        """Return where in a model the frame is that its pose is of."""
        if not (frame := model.get("placement_frame")):
            return pin.SE3.Identity()
        before = dict(places)
        places[named(scope, "")] = pin.SE3.Identity()
        found = place(named(scope, frame), asked)
        places.clear()
        places.update(before)
        return found

    tree = _Tree(path)
    for name, element in parts.items():
        if element.tag != "link":
            continue
        inertial, given = None, element.find("inertial")
        if given is not None:
            if relative(given):
                raise fail(given, f"link {name!r}: the pose of <inertial> is in the link, not relative to another")
            pose, inertia, matrix = posed(given), given.find("inertia"), np.zeros((3, 3))
            for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
                tag = f"i{'xyz'[i]}{'xyz'[j]}"
                if inertia is not None:
                    matrix[i, j] = matrix[j, i] = number(inertia, tag, "0" if i != j else None)
            mass = number(given, "mass")
            if mass < 0.0:
                raise fail(given, f"link {name!r}: mass is {mass:g} kg, expected more than 0")
            where = Place(path, given.sourceline or 0)
            inertial = Inertial(mass, pose.translation.copy(), pose.rotation.copy(), matrix, where)
        tree.link(name, inertial, element.sourceline or 0)
    for name, element in parts.items():
        if element.tag != "joint":
            continue
        parent, child, kind = end(name, "parent"), end(name, "child"), element.get("type") or ""
        if parent == "world" and "world" not in tree.links:
            tree.link("world", None)
        axis, limits, problem, given = np.eye(3)[0], FREE, "", element.find("axis")
        if kind not in (*MOVING, "fixed"):
            known = ", ".join(MOVING)
            problem = f"joint {name!r}: type {kind!r} is not supported; {known}, fixed are"
        elif kind != "fixed":
            if given is None:
                raise fail(element, f"joint {name!r} has no <axis>")
            xyz = given.find("xyz")
            axis = numbers(xyz, 3, "0 0 1")
            if not (size := float(np.linalg.norm(axis))):
                raise fail(given, f"joint {name!r}: axis is zero")
            frame = None if xyz is None else xyz.get("expressed_in") or None
            if (given.findtext("use_parent_model_frame") or "").strip() in ("1", "true"):
                frame = MODEL
            turn = np.eye(3)
            if frame is not None:
                turn = place(name).rotation.T @ place(named(scopes[name], frame)).rotation
            if given.find("mimic") is not None:
                problem = f"joint {name!r} follows another by <mimic>, which is not supported"
            axis, limit = turn @ axis / size, given.find("limit")
            if limit is not None:
                lower, upper = number(limit, "lower", "-1e16"), number(limit, "upper", "1e16")
                effort, velocity = number(limit, "effort", "-1"), number(limit, "velocity", "-1")
                lower, upper = (float(np.copysign(np.inf, x)) if abs(x) >= UNLIMITED else x for x in (lower, upper))
                effort, velocity = (x if x > 0.0 else np.inf for x in (effort, velocity))
                limits = (lower, upper, effort, velocity)
            if kind == "revolute" and np.isinf(limits[:2]).all():
                kind = "continuous"
        at = place(parent).inverse() * place(name)
        rest = place(name).inverse() * place(child)
        tree.joint(name, kind, (parent, child), at, rest, axis, limits, element.sourceline or 0, problem)
    light = [one.child for one in tree.joints.values() if one.child in parts and tree.links[one.child].inertial is None]
    if light:
        text = f"{path}: {listing(light)}: no <inertial>, which is 1 kg in SDF; here they have no mass"
        tree.flags.append(Flag("default_mass", text))
    return tree.robot(models[0].get("name") or path.stem)
