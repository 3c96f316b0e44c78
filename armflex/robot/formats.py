"""Robots in other files than URDF: xacro, which a library expands, and MJCF, which MuJoCo reads itself.

All become links and joints as a URDF has them, and are judged as those are. Where a joint's axis is not through its
child's origin, as it is in a URDF, a link without mass stands between.
"""

import re
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from armflex.conventions import LARGEST, STANDARD_GRAVITY
from armflex.errors import Flag, Place, UrdfError, listing
from armflex.robot import xacro_process
from armflex.robot.tree import FileTree, rotation_of
from armflex.robot.urdf import MOVING, Inertial, Urdf, parse_xml, read_urdf
from armflex.storage.read_file import MOST_BYTES, check_file

XACRO = re.compile(r"https?://(www\.)?ros\.org/wiki/xacro/?")
"""The namespace of its tags, as it was and as it is."""


def is_xacro(path: Path, root: etree._Element) -> bool:
    """Return whether a file is to be expanded: by its suffix, or as it has tags or expressions of xacro."""
    if path.suffix.lower() == ".xacro":
        return True
    if not any(XACRO.fullmatch(uri) for uri in root.nsmap.values()):
        return False
    values = (str(value) for element in root.iter("*") for value in element.attrib.values())
    return any(_is(element) for element in root.iter("*")) or any("${" in value or "$(" in value for value in values)


def _is(element: etree._Element, tag: str = "") -> bool:
    """Return whether an element is one of xacro's, of a tag or of any."""
    name = etree.QName(element) if "{" in str(element.tag) else None
    return name is not None and XACRO.fullmatch(name.namespace or "") is not None and tag in ("", name.localname)


def read_other(
    path: Path,
    root: etree._Element,
    strict: bool = True,
    loops: bool = False,
    arguments: Mapping[str, str] | None = None,
) -> Urdf:
    """Return the robot of a xacro file, see `is_xacro`, or MJCF (by its root element).

    With `loops` those of an MJCF are `Urdf.declared`; they are refused otherwise.

    Raises:
        UrdfError: As `read_urdf`; the library that a format needs is not installed, or refuses the file; it is SDF.
    """
    if is_xacro(path, root):
        named = [name for element in root.iter("*") if _is(element, "arg") and (name := element.get("name"))]
        left = [name for name in named if name not in (arguments or {})]
        hint = f"; it was expanded with its own values of {listing(left)}, which [robot] xacro_arguments gives others"
        return read_urdf(path, strict, parse_xml(path, _expanded(path, arguments or {})), True, hint if left else "")
    if root.tag == "sdf":
        convert = f"sdf2mjcf {path.name} {path.stem}.xml (pip install sdformat-mjcf) makes MJCF of it, which is read"
        raise UrdfError(Place(path, root.sourceline or 0), f"is SDF, which only its own library reads: {convert}")
    return _read_mjcf(path, root, loops)


def _expanded(path: Path, arguments: Mapping[str, str]) -> bytes:
    """Return the URDF that a xacro file stands for with some arguments; `xacro_process` has the limits."""
    if not find_spec(xacro_process.LIBRARY):
        text = "is a xacro file, which needs a library to be expanded: pip install xacrodoc (or xacro)"
        raise UrdfError(Place(path), f"{text}; or expand it yourself, xacro {path.name} > robot.urdf")
    given = [f"{name}:={value}" for name, value in arguments.items()]
    command = [sys.executable, "-P", xacro_process.__file__, path.name, *given]
    ended, limit = None, xacro_process.PATIENCE
    with suppress(subprocess.TimeoutExpired):
        ended = subprocess.run(command, cwd=path.parent, stdin=subprocess.DEVNULL, capture_output=True, timeout=limit)
    if ended is not None and ended.returncode == 0:
        return ended.stdout
    said = "" if ended is None else ended.stdout.decode("utf-8", "replace")
    if ended is not None and ended.returncode == xacro_process.REFUSED:
        remedy = f"expand it yourself: xacro {path.name} > robot.urdf"
        raise UrdfError(Place(path), f"is xacro that {said}, which no robot file may; read it, and {remedy}")
    if not said:
        said = f"cannot be expanded within {xacro_process.SECONDS} s and {xacro_process.MEMORY >> 20} MB"
    raise UrdfError(Place(path), said)


def _read_mjcf(path: Path, root: etree._Element, declares: bool) -> Urdf:
    """Return the bodies and joints of MJCF as MuJoCo compiles them; sites are links as well, without mass.

    Joints turn and slide from where `ref` says that they stand. Meshes are opened where masses follow from them.
    """
    try:
        mujoco: Any = import_module("mujoco")
    except ImportError:
        raise UrdfError(Place(path), "is MJCF, which MuJoCo itself reads: pip install mujoco") from None
    _check_named(path, root)
    model, flags = _compiled(mujoco, path)
    lines = {
        (str(element.tag), element.get("name")): element.sourceline or 0
        for element in root.iter()
        if isinstance(element.tag, str)
    }
    tree, kinds = FileTree(path), mujoco.mjtJoint
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
    joined = _joined(mujoco, model, bodies) if declares else {}
    followers = _followers(mujoco, model, joints)
    loops = _loops(mujoco, model, bodies, joined, followers)
    efforts = np.where(model.jnt_actfrclimited, np.abs(model.jnt_actfrcrange).max(axis=1, initial=0.0), np.inf)
    for i in range(model.nu):
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_forcelimited[i]:
            joint, gear = model.actuator_trnid[i, 0], abs(float(model.actuator_gear[i, 0]))
            efforts[joint] = min(efforts[joint], gear * float(np.abs(model.actuator_forcerange[i]).max()) or np.inf)
    tree.link("world" if bodies[0] == "body0" else bodies[0], None)
    for i in range(1, model.nbody):
        line = lines.get(("body", bodies[i]), 0)
        inertial = None
        if model.body_mass[i] > 0.0:
            turn, moments = rotation_of(model.body_iquat[i]), np.diag(model.body_inertia[i])
            inertial = Inertial(float(model.body_mass[i]), model.body_ipos[i].copy(), turn, moments, Place(path, line))
        tree.link(bodies[i], inertial, line)
        if model.body_gravcomp[i]:
            text = f"{Place(path, line)}: body {bodies[i]!r} has gravcomp, which is a controller's: it weighs here"
            tree.flags.append(Flag("gravcomp", text))
        parent = bodies[model.body_parentid[i]]
        here = pin.SE3(rotation_of(model.body_quat[i]), model.body_pos[i].copy())
        hung = range(model.body_jntadr[i], model.body_jntadr[i] + model.body_jntnum[i])
        if not hung:
            tree.joint(f"{bodies[i]}_fixed", "fixed", (parent, bodies[i]), here, pin.SE3.Identity(), np.eye(3)[0],
                       line=line)  # fmt: skip
        for j in hung:
            kind = named.get(int(model.jnt_type[j]), "floating")
            axis = model.jnt_axis[j] / np.linalg.norm(model.jnt_axis[j])
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
            last = j == hung[-1]
            child = bodies[i] if last else f"{bodies[i]}/{joints[j]}"
            if not last:
                tree.link(child, None, line, between=True)
            ends, at = (parent, child), here * shift * back
            rest = shift.inverse() if last else pin.SE3.Identity()
            tree.joint(joints[j], kind, ends, at, rest, axis.copy(), limits, where, problem, followers.get(j))
            parent, here = child, shift.inverse()
    for i, name in enumerate(sites):
        if name and name not in tree.links:
            line = lines.get(("site", name), 0)
            tree.link(name, None, line)
            place = pin.SE3(rotation_of(model.site_quat[i]), model.site_pos[i].copy())
            ends = (bodies[model.site_bodyid[i]], name)
            tree.joint(f"{name}_fixed", "fixed", ends, place, pin.SE3.Identity(), np.eye(3)[0], line=line)
    tree.flags += flags
    tree.declared = _declared(mujoco, model, (bodies, joints), joined, followers) if declares else {}
    declared = {**tree.declared["spring"], **tree.declared["cylinder"]} if declares else {}
    for i in range(model.ntendon):
        name = model.tendon(i).name or f"tendon{i}"
        if name not in declared:
            text = f"{path}: tendon {name!r} is no spring or cylinder between two sites: it is left out"
            tree.flags.append(Flag("tendon", text))
    for j in np.flatnonzero(model.jnt_stiffness).tolist():
        text = f"joint {joints[j]!r} has a spring of {float(model.jnt_stiffness[j]):g} beside its drive"
        text = f"{Place(path, lines.get(('joint', joints[j]), 0))}: {text}: it is left out, and bears nothing here"
        tree.flags.append(Flag("joint_spring", text))
    x, y, z = model.opt.gravity.tolist()
    if root.find("option[@gravity]") is not None or (x, y, z) != (0.0, 0.0, -STANDARD_GRAVITY):  # of an included file
        tree.gravity = (x, y, z)
    return tree.robot(root.get("model") or path.stem)


def _check_named(path: Path, root: etree._Element) -> None:
    """Raise where a file that an MJCF names is there and none: MuJoCo would wait for a named pipe."""
    settings = [pair for compiler in root.iter("compiler") for pair in compiler.items()]
    folders = {"", *(str(value) for key, value in settings if str(key).endswith("dir"))}
    for element in root.iter("*"):
        for place in (path.parent / folder / (element.get("file") or "") for folder in folders if element.get("file")):
            try:
                if place.exists():
                    check_file(place, MOST_BYTES)
            except OSError as error:
                text = f"<{element.tag} file={element.get('file')!r}> cannot be read: {error.strerror}"
                raise UrdfError(Place(path, element.sourceline or 0), text) from None


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
            for mesh in (*meshed, *spec.meshes):
                spec.delete(mesh)
            text = f"{path}: its meshes are left out, as no mass follows from them ({' '.join(str(error).split())})"
            return spec.compile(), [Flag("visual", text)]
    except ValueError as error:
        message = " ".join(str(error).split())
        line = re.search(r"line (\d+)", message)
        raise UrdfError(Place(path, int(line[1]) if line else 0), f"MuJoCo cannot read it: {message}") from None


def _joined(mujoco: Any, model: Any, bodies: list[str]) -> dict[int, dict[str, Any]]:
    """Return the equalities that are loops, by number, as tables of an arm.toml.

    A weld is one where its links are as it wants them in the reference configuration.
    """
    data, loops = mujoco.MjData(model), {}
    mujoco.mj_kinematics(model, data)
    connect, weld = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)
    for i in np.flatnonzero(model.eq_active0).tolist():
        kind, numbers = int(model.eq_type[i]), model.eq_data[i]
        if kind not in (connect, weld):
            continue
        ends = [int(model.eq_obj1id[i]), int(model.eq_obj2id[i])]
        # What MuJoCo keeps of a weld between bodies begins with the second one's point.
        points = [numbers[:3], numbers[3:6]] if kind == connect else [numbers[3:6], numbers[:3]]
        turns, wanted = data.xmat, rotation_of(numbers[6:10]) if kind == weld else np.eye(3)
        if int(model.eq_objtype[i]) == int(mujoco.mjtObj.mjOBJ_SITE):
            points, turns, wanted = [model.site_pos[end] for end in ends], data.site_xmat, np.eye(3)
            sites, ends = ends, [int(model.site_bodyid[end]) for end in ends]
        else:
            sites = ends
        first, second = (turns[site].reshape(3, 3) for site in sites)
        # How far links may be from where a weld wants them in the reference configuration, as numbers of a rotation
        if kind == weld and np.abs(first.T @ second - wanted).max() > 1e-6:
            continue
        name, what = model.equality(i).name or f"equality{i}", "spherical" if kind == connect else "fixed"
        table = {"name": name, "link": bodies[ends[0]], "at": points[0].tolist(), "kind": what}
        loops[i] = {**table, "to": bodies[ends[1]], "at_to": points[1].tolist()}
    return loops


def _followers(mujoco: Any, model: Any, joints: list[str]) -> dict[int, tuple[str, float, float]]:
    """Return the joints that an equality ties to another in proportion: whom, by what factor and from what offset.

    MuJoCo counts both positions in the polynomial from those of the reference configuration.
    """
    followers, ref = {}, model.qpos0[model.jnt_qposadr]
    for i in np.flatnonzero(model.eq_active0 & (model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT))).tolist():
        joint, master, numbers = int(model.eq_obj1id[i]), int(model.eq_obj2id[i]), model.eq_data[i]
        if master >= 0 and not numbers[2:5].any():
            factor = float(numbers[1])
            followers[joint] = joints[master], factor, float(ref[joint] + numbers[0] - factor * ref[master])
    return followers


def _declared(
    mujoco: Any,
    model: Any,
    names: tuple[list[str], list[str]],
    joined: dict[int, dict[str, Any]],
    followers: dict[int, tuple[str, float, float]],
) -> dict[str, Any]:
    """Return loops, springs, cylinders and passive joints as tables of an arm.toml.

    A tendon that an actuator drives is a cylinder: as stiff as the actuator where that holds a position, else rigid.
    In a file with actuators the joints around its loops and cylinders that none of them moves are passive.
    """
    (bodies, joints), springs, moved, around, site = names, {}, set(), set(), int(mujoco.mjtWrap.mjWRAP_SITE)
    driving = {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)}
    cylinders: dict[str, dict[str, Any]] = {}
    for i in range(model.ntendon):
        first, rate, (short, long) = model.tendon_adr[i], float(model.tendon_stiffness[i]), model.tendon_lengthspring[i]
        sites = model.wrap_objid[first : first + model.tendon_num[i]].tolist()
        plain = len(sites) == 2 and set(model.wrap_type[first : first + 2].tolist()) == {site}
        if not plain:
            continue
        name = model.tendon(i).name or f"tendon{i}"
        ends = [(bodies[model.site_bodyid[site]], model.site_pos[site].tolist()) for site in sites]
        table = dict(zip(("link", "at", "to", "at_to"), (*ends[0], *ends[1]), strict=True))
        if rate > 0.0 and short == long > 0.0:
            springs[name] = {**table, "rate": rate, "free_length": float(long)}
        drives = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON)) & (model.actuator_trnid[:, 0] == i)
        for u in np.flatnonzero(drives).tolist():
            gear, held = float(model.actuator_gear[u, 0]), -float(model.actuator_biasprm[u, 1])
            cylinders[name] = table | ({"stiffness": held * gear**2} if held > 0.0 else {})
            limits = model.tendon_range[i] if model.tendon_limited[i] else np.zeros(2)
            if not model.tendon_limited[i] and held > 0.0 and model.actuator_ctrllimited[u]:
                limits = np.sort(model.actuator_ctrlrange[u] / gear)
            cylinders[name] |= dict(zip(("lower", "upper"), limits.tolist(), strict=True)) if limits.any() else {}
            if model.actuator_forcelimited[u]:
                cylinders[name]["effort"] = abs(gear) * float(np.abs(model.actuator_forcerange[u]).max())
    for i in range(model.nu):
        if int(model.actuator_trntype[i]) in driving:
            moved.add(int(model.actuator_trnid[i, 0]))
    for closure in (*joined.values(), *cylinders.values()):
        around |= _ways(model, bodies.index(closure["link"])) ^ _ways(model, bodies.index(closure["to"]))
    free = [i for i in range(model.njnt) if int(model.jnt_bodyid[i]) in around and i not in {*moved, *followers}]
    passive = {joints[i]: {"passive": True} for i in free} if model.nu else {}
    return {"loop": [*joined.values()], "spring": springs, "cylinder": cylinders, "joint": passive}


def _ways(model: Any, body: int) -> set[int]:
    """Return a body and all between it and the world."""
    joints = set()
    while body:
        joints.add(body)
        body = int(model.body_parentid[body])
    return joints


def _loops(
    mujoco: Any, model: Any, bodies: list[str], joined: dict[int, Any], followers: dict[int, Any]
) -> dict[int, str]:
    """Return what is said of the bodies that close a loop with others, by number; not of loops that are declared."""
    texts: dict[int, str] = {}
    tied, follows = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)), int(mujoco.mjtEq.mjEQ_JOINT)
    for i in np.flatnonzero(model.eq_active0):
        if int(i) in joined:
            continue
        ends = (int(model.eq_obj1id[i]), int(model.eq_obj2id[i]))
        if int(model.eq_type[i]) in tied:
            if int(model.eq_objtype[i]) == int(mujoco.mjtObj.mjOBJ_SITE):
                ends = (int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]]))
            pair = " to ".join(repr(bodies[end]) for end in ends)
            text = f"an equality ties body {pair}, which closes a loop: that needs an arm.toml, and a weld that is met"
            texts |= dict.fromkeys(_ways(model, ends[0]) ^ _ways(model, ends[1]), text)
        elif int(model.eq_type[i]) == follows and ends[0] not in followers:
            joint, master = ends
            whom = f"{model.joint(master).name!r} by a curve" if master >= 0 else "a constant"
            text = f"an equality makes joint {model.joint(joint).name!r} follow {whom}"
            text += ", which is not supported: in proportion (polycoef = a b 0 0 0) it is"
            texts[int(model.jnt_bodyid[joint])] = text
    return texts
