"""arm.toml: an arm as declared, read whole or refused with file, line and the nearest valid name, and one as fitted.

What a fit found is written beside what was declared, comments and all: [calibration] and further [[effect]]s.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armflex.arguments import checked_kinds
from armflex.arm import Arm, Flexure, Measurement, Prior, Setup, warn
from armflex.conventions import SMALLEST_STD, TWIST_NAMES
from armflex.declaration import Declaration, Source, read_toml
from armflex.errors import (
    ArmFileError,
    Flag,
    InputError,
    PayloadError,
    UnknownNameError,
    UnsupportedError,
    UrdfError,
    did_you_mean,
    listing,
)
from armflex.files.calibration_table import (
    REMARKS,
    Campaign,
    calibration_table,
    certainty_table,
    doubts,
    read_calibration,
    with_certainty,
    with_covariance,
)
from armflex.files.dh_table import FLANGE, read_dh
from armflex.files.effect_file import read_effect
from armflex.files.link_table import pins_off_root, read_link
from armflex.files.linkage_table import read_linkage
from armflex.files.requires_table import check_requires, requires_of
from armflex.files.sensor_table import read_sensors
from armflex.files.spring_table import positive, read_spring
from armflex.laws import read_law
from armflex.laws.declared import law_name, soft
from armflex.laws.effects.location import drive_axis
from armflex.laws.effects.payload_mass import PAYLOAD_MASS, masses_with
from armflex.laws.joint.carried import AtNode
from armflex.laws.joint.linear import SOFTEST
from armflex.laws.joint.meshed import MeshedLaw
from armflex.laws.law import Travel, anywhere
from armflex.laws.learned import Learning, read_learning
from armflex.mechanics.loaded import Payload
from armflex.mechanics.spring import Spring
from armflex.parameters import ParameterKind, of_compliance, of_masses, of_motions, of_offsets, of_springs
from armflex.readings.instrument import Instrument
from armflex.result import plain
from armflex.robot import Robot, load_robot
from armflex.robot.robot import MILLIMETRES
from armflex.robot.urdf import MAX_LINKS, MOVING, Joint, drive_of
from armflex.storage.whole_file import together, write_whole

ROBOTS = (".urdf", ".xacro", ".xml", ".mjcf", ".sdf")
"""Suffixes of files that hold a robot and no arm."""

FROM_PYTHON = Path("make_arm")
"""Stands for the file in messages about an arm that has none."""

RIGID = 1e-6
"""Share of the largest compliance below which a joint does not give about an axis."""

SAGS = np.radians(3.0)
"""Turn of a joint under the weight of what it carries, stretched out, that no drive in service has [rad]."""


LEVEL = 1e-3
"""Share of gravity by which it may differ from what a mount makes of it: so far are numbers rounded."""


@checked_kinds
def load_arm(path: str | Path, *, preset: str | None = None, tip: str | None = None, strict: bool = True) -> Arm:
    """Read an arm.toml and the URDF it names.

    Args:
        path: The arm.toml; a URDF, xacro or MJCF is taken as an arm without flexures.
        preset: Name of a [preset.NAME] table whose flexures replace or join the declared ones.
        tip: Link whose motion is reported, for a bare URDF with several ends; an arm.toml names its own.
        strict: Refuse unknown URDF tags on the chain, and motion with impossible inertias, instead of flagging them.

    Raises:
        ArmFileError: The file is not valid TOML, misses a key, has an unknown one, or its numbers are not physical.
        UrdfError: The URDF is no robot that can be computed with.
        UnknownNameError: There is no such preset.
    """
    path = Path(path)
    is_urdf = path.suffix.lower() in ROBOTS
    if not is_urdf and tip is not None:
        raise InputError(f"{path} names its own tip, to which its payloads are fixed; tip is for a bare URDF")
    if is_urdf and preset is not None:
        raise UnknownNameError("preset", preset, ())
    if is_urdf:
        robot = load_robot(path, tip, strict=strict)
        arm = Arm(robot, flags=(*robot.flags, Flag("rigid", "no arm.toml, so no flexures: the arm is rigid")))
        quoted = (json.dumps(text, ensure_ascii=False) for text in (str(path.absolute()), robot.tip))
        text = "[robot]\nurdf = {}\ntip = {}\n".format(*quoted)
    else:
        root = read_toml(path)
        arm, text = _read(root, preset, strict), root.source.text
    if preset is None:
        arm = replace(arm, source=Source(path.absolute(), text))
    warn(arm.flags)
    return arm


@checked_kinds
def make_arm(
    urdf: str | Path,
    stiffness: Mapping[str, ArrayLike],
    payloads: Mapping[str, Payload] | None = None,
    *,
    relative_std: float | Mapping[str, float] = 0.0,
    tip: str | None = None,
    strict: bool = True,
    **robot: Any,
) -> Arm:
    """Return an arm from its URDF and what a data sheet says of its joints, without a file::

        import armflex
        gripper = armflex.Payload(40.0, [0.0, 0.0, 0.15])
        arm = armflex.make_arm("robot.urdf", {"J1": 2.5e6, "J2": 3.0e6, "J3": 2.2e6}, {"gripper": gripper})
        found = arm.deflection(arm.position(J2=0.5, J3=-0.3), "gripper")
        print(found.displacement[:3] * 1e3)

    Args:
        urdf: The robot, in any form that `[robot] urdf` may have.
        stiffness: By joint: a number is about, or along, the drive's own axis [Nm/rad or N/m]; (6,) or (6, 6) is of
            all axes of its child frame [N/m, Nm/rad]. The other joints are rigid.
        payloads: What it may carry, by name; com in the tip frame [m].
        relative_std: How well the stiffnesses are known, as a share: of all joints, or by joint; 0 says nothing of it.
        tip: Link whose motion is reported; the only end when not given.
        strict: Refuse unknown URDF tags on the chain, and motion with impossible inertias, instead of flagging them.
        robot: Further keys of the [robot] table of an arm.toml: base, gravity [m/s^2], tool, mount, locked ...

    Raises:
        ArmFileError: As `load_arm`, for what an arm.toml could say as well.
        UnknownNameError: `relative_std` names a joint that `stiffness` does not.
        UrdfError: The URDF is no robot that can be computed with, or has several ends.
    """
    shares = relative_std if isinstance(relative_std, Mapping) else dict.fromkeys(stiffness, relative_std)
    for name in shares:
        if name not in stiffness:
            raise UnknownNameError("joint with a stiffness", name, stiffness)
    urdf = Path(urdf).absolute()
    keys = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in robot.items()}
    arguments = keys.get("xacro_arguments")
    tip = tip or load_robot(urdf, strict=strict, xacro_arguments=arguments).tip
    given = {name: np.asarray(values).tolist() for name, values in stiffness.items()}
    flexures = {
        name: {"joint": name, "stiffness" if isinstance(values, list) else "joint_stiffness": values}
        | ({"relative_std": shares[name]} if name in shares else {})
        for name, values in given.items()
    }
    bodies = {
        name: {key: np.asarray(value).tolist() for key, value in vars(payload).items() if value is not None}
        for name, payload in (payloads or {}).items()
    }
    tables = {"robot": {"urdf": str(urdf), "tip": tip, **keys}, "flexure": flexures, "payload": bodies}
    arm = _read(Declaration(tables, (), Source(FROM_PYTHON, "")), None, strict)
    warn(arm.flags)
    import tomlkit  # half of the time that a rigid arm takes to load

    return replace(arm, source=Source(FROM_PYTHON.absolute(), tomlkit.dumps(plain(tables))))


def _read(root: Declaration, preset: str | None, strict: bool) -> Arm:
    check_requires(root.part("requires"))
    robot, ratings, flags = _read_robot(root.sub("robot"), strict)
    bent = []
    for name, table in root.subs("link").items():
        robot, flexure, more = read_link(name, table, robot)
        bent.append(flexure)
        flags = (*flags, *more)
    declared = {kind: tables for kind, tables in robot.urdf.declared.items() if tables}  # of an MJCF
    for kind, more in declared.items():  # what stands in the arm.toml comes first
        loops = kind == "loop"
        root.table[kind] = [*root.table.get(kind, []), *more] if loops else {**more, **root.table.get(kind, {})}
    robot, tied = read_linkage(root, robot, tuple(root.table["robot"].get("locked", {})))
    payloads = {name: _read_payload(name, table) for name, table in root.subs("payload").items()}
    tables = _flexure_tables(root, preset)
    for taken, text in (
        (bent, "[link.{}] is a flexure of this name: choose another one"),
        (tied, "{!r} is a loop or a cylinder, which says itself how it gives"),
    ):
        for name in [flexure.name for flexure in taken if flexure.name in tables]:
            raise tables[name].fail("joint", text.format(name))
    read = [_read_flexure(name, table, robot) for name, table in tables.items()]
    flexures = (*_along(robot, bent, read), *tied)
    springs = tuple(read_spring(name, table, robot) for name, table in root.subs("spring").items())
    measurement, uncertain = _read_measurement(root)
    prior = _read_prior(root.part("prior"))
    flexures = tuple(_freed(flexure, prior.young, robot) for flexure in flexures)
    sensors = read_sensors(root.subs("instrument"), robot)
    effects, calibrated = root.array_of("effect"), root.has("calibration")
    root.finish()
    asked = _questions(flexures, robot, [name for name in tables if "joint_stiffness" in tables[name].table])
    flags = [*robot.flags, *flags, *asked, *_long(robot, springs), *pins_off_root(bent, robot, springs), *uncertain]
    flags += root.source.flags
    arm = Arm(
        robot,
        flexures,
        payloads,
        measurement=measurement,
        prior=prior,
        sensors=sensors,
        flags=tuple(flags),
        payload_rating=ratings[0],
        damping_ratio=ratings[1],
        springs=springs,
    )
    if prior.each:
        _check_each(root.sub("prior"), arm)
    if not calibrated:
        return _with_effects(arm, effects)
    table = root.sub("calibration")
    arm = with_certainty(table, _with_effects(read_calibration(table, arm), effects))
    return replace(arm, flags=(*arm.flags, *doubts(table, arm))).left()


def _flexure_tables(root: Declaration, preset: str | None) -> dict[str, Declaration]:
    """Return the tables of flexures by name, those of a preset in place of others."""
    tables, presets = root.subs("flexure"), root.subs("preset")
    if preset is not None:
        if preset not in presets:
            raise UnknownNameError("preset", preset, presets)
        tables |= presets[preset].subs("flexure")
        presets[preset].finish()
    if len(tables) > MAX_LINKS:
        raise ArmFileError(root.place("flexure"), f"has {len(tables)} flexures, more than the {MAX_LINKS} allowed")
    return tables


def _read_measurement(root: Declaration) -> tuple[Measurement, tuple[Flag, ...]]:
    """Return [measurement], and a flag where gravity is known in a frame that is not."""
    table = root.part("measurement")
    frame = table.choice("frame", ("base", "unknown"), "unknown")
    measurement = Measurement(frame, table.choice("gravity_in", ("base", "measurement"), "base"))
    table.finish()
    if measurement.gravity_in == "base":
        return measurement, ()
    if root.table["robot"].get("mount"):
        text = 'gravity_in = "measurement" has gravity in the instrument\'s frame, [robot] mount in the base'
        raise table.fail("gravity_in", f"{text}: give one of them")
    text = "is known in the instrument's frame, whose place is not: taken in base axes until the arm is calibrated"
    return measurement, () if root.has("calibration") else (Flag("gravity_in", f"gravity {text}"),)


def _along(robot: Robot, bent: Sequence[Flexure], declared: Sequence[Flexure]) -> list[Flexure]:
    """Return flexures as they were declared, and those of links that bend ahead of the first that is farther out."""
    order, flexures = [joint.name for joint in robot.places], list(declared)
    for link in bent:
        place = order.index(link.joint or order[0])
        beyond = (
            i
            for i, flexure in enumerate(flexures)
            if flexure.joint and order.index(flexure.joint) >= place and flexure not in bent
        )
        flexures.insert(next(beyond, len(flexures)), link)
    return flexures


def _with_effects(arm: Arm, tables: list[Declaration]) -> Arm:
    """Return the arm with its [[effect]] tables applied in order, as a fit does: some change the model itself."""
    if not tables:
        return arm
    setup = start = Setup(arm, arm.instrument or Instrument())
    for table in tables:
        effect = read_effect(table, arm)
        masses = masses_with(effect, setup.arm.payloads) if effect.law is PAYLOAD_MASS else {}
        setup = setup.with_effect(effect)
        weighed = [("payload", name, arm.payloads[name].mass, mass) for name, mass in masses.items()]
        for name, extra in setup.arm.corrections.bodies.items():
            inertial = arm.robot.urdf.links[name].inertial
            declared_mass = inertial.mass if inertial else 0.0
            weighed.append(("link", name, declared_mass, declared_mass + float(extra[0])))
        for kind, name, declared_mass, mass in weighed:
            if mass < 0.0:
                text = f"{kind} {name!r} of {declared_mass:g} kg would weigh {mass:g} kg, expected 0 kg or more"
                raise table.fail("parameters", text)
    return setup.arm if setup.instrument is start.instrument else replace(setup.arm, instrument=setup.instrument)


def _argument(table: Declaration, name: str) -> str:
    """Return an argument of a xacro file as that takes it: a text, a number, true or false."""
    value = table.table[name]
    if isinstance(value, str | int | float) and re.fullmatch(r"[A-Za-z_]\w*", name):
        return str(value).lower() if isinstance(value, bool) else str(value)
    raise table.fail(name, f"is {value!r}, expected a text, a number, true or false, by the name of an argument")


def _read_robot(table: Declaration, strict: bool) -> tuple[Robot, tuple[float | None, float | None], tuple[Flag, ...]]:
    by_dh = table.has("dh")
    if by_dh and table.has("urdf"):
        raise table.fail("dh", "stands beside 'urdf', which is the robot already: give one of them")
    urdf = read_dh(table) if by_dh else table.path.parent / table.text("urdf")
    tip, base = table.text("tip", FLANGE if by_dh else None), table.text("base", "-")
    gravity = table.numbers("gravity", (3,)) if table.has("gravity") else None
    tool, mount = (_read_pose(table, key, keys) for key, keys in (("tool", ("xyz", "rpy")), ("mount", ("rpy",))))
    rating = table.number("payload_rating") if table.has("payload_rating") else None
    damping = table.number("damping_ratio") if table.has("damping_ratio") else None
    if damping is not None and not 0.0 < damping < 1.0:
        raise table.fail("damping_ratio", f"is {damping:g}, expected more than 0 and less than 1: 0.01 is one percent")
    held = table.part("locked")
    locked = {name: held.number(name) for name in held.table}
    massless = table.flag("allow_massless")
    given = table.part("xacro_arguments")
    arguments = {name: _argument(given, name) for name in given.table}
    table.finish()
    if by_dh and arguments:
        raise table.fail("xacro_arguments", "are those of a xacro file, and the robot is given by 'dh'")
    if gravity is not None and mount is not None:
        level = mount.rotation.T @ np.array([0.0, 0.0, -np.linalg.norm(gravity)])
        if np.linalg.norm(gravity - level) > LEVEL * np.linalg.norm(gravity):
            text = f"gravity {gravity.tolist()} is not that of a base so mounted, {np.round(level, 4).tolist()}"
            raise table.fail("mount", f"{text}: give one of them")
    how = {"strict": strict, "allow_massless": massless, "locked": locked, "xacro_arguments": arguments}
    how |= {"tool": tool, "mount": None if mount is None else mount.rotation}
    try:
        robot = load_robot(urdf, tip, None if base == "-" else base, gravity, loops=True, **how)
    except UnknownNameError as error:
        raise table.fail({tip: "tip", base: "base"}.get(error.name, "locked"), str(error)) from None
    except UrdfError as error:
        if error.place.line or "cannot be read" not in error.problem:
            raise
        raise UrdfError(table.place("urdf"), f"[robot] urdf: {error}") from None  # the key that names no file
    return robot, (rating, damping), tuple(_robot_questions(table, robot, tool))


def _robot_questions(table: Declaration, robot: Robot, tool: pin.SE3 | None) -> Iterator[Flag]:
    """Yield flags about gravity that nobody gave, a base that moves, and a tool that may be in millimetres."""
    turned, moving = robot.urdf.turned(robot.base)
    if "gravity" not in table.table and "mount" not in table.table:
        text = f"no gravity given, taken as {np.round(robot.gravity, 6).tolist()} m/s^2"
        tilt = float(np.degrees(np.arccos(np.clip(turned[2, 2], -1.0, 1.0))))
        if robot.urdf.gravity is not None and moving is None:
            text += f", which is the <option gravity> of {robot.urdf.path.name}"
        elif moving is None and tilt > np.degrees(LEVEL):
            text += f", but z of base {robot.base!r} is tilted by {tilt:.3g} degrees from that of the URDF's root"
        yield Flag("gravity", f"{table.place()}: {text}")
    if moving is not None:
        text = f"base {robot.base!r} moves with joint {moving.name!r}: gravity is constant in the axes of that base"
        yield Flag("moving_base", f"{table.place('base')}: {text}")
    size = 0.0 if tool is None else float(np.linalg.norm(tool.translation))
    if size > max(rest := robot.reach - size, 1.0):
        text = f"it ends {size:g} m from {table.table.get('tip', FLANGE)!r}, more than the arm's reach: millimetres?"
        if size > MILLIMETRES * max(rest, 1.0):
            raise table.fail("tool", text)
        yield Flag("long", f"{table.place('tool')}: [robot] tool: {text}")


def _read_pose(table: Declaration, key: str, keys: tuple[str, ...]) -> pin.SE3 | None:
    """Return a pose given by `xyz` [m] and `rpy` [rad], as a URDF has them, None where it is not given."""
    if not table.has(key):
        return None
    given = table.sub(key)
    xyz, rpy = (
        given.numbers(part, (3,)) if part in keys and given.has(part) else np.zeros(3) for part in ("xyz", "rpy")
    )
    given.finish()
    if not given.table:
        raise table.fail(key, f"expected {' and '.join(keys)}, 3 numbers each")
    if np.abs(rpy).max() > 2.0 * np.pi:
        raise table.fail(key, f"rpy {given.raw('rpy')} exceeds a full turn: degrees? It is in rad")
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def _read_payload(name: str, table: Declaration) -> Payload:
    if name == "none":
        raise ArmFileError(table.place(), "[payload.none]: 'none' means that nothing is carried, choose another name")
    mass = table.number("mass")
    com = np.zeros(3) if mass == 0.0 and not table.has("com") else table.numbers("com", (3,))
    inertia = table.numbers("inertia", (6,)) if table.has("inertia") else None
    table.finish()
    try:
        return Payload(mass, com, inertia)
    except PayloadError as error:
        raise table.fail("mass" if mass < 0.0 else "inertia", str(error)) from None


def _read_flexure(name: str, table: Declaration, robot: Robot) -> Flexure:
    places = {joint.name: joint for joint in robot.places}
    where = "between base and tip" + " or in a loop" * bool(robot.linkage.closures)
    joint = table.choice("joint", places, problem=f"no joint {{!r}} {where}")
    if table.has("joint_stiffness"):
        table = _by_joint_stiffness(table, places[joint])
    law = read_law(table, joint, _ranges(robot))
    learn = read_learning(table, law_name(table), law, _ranges(robot)) if table.flag("learn") else None
    table.finish()
    return Flexure(name, joint, law, learn=learn)


def _by_joint_stiffness(table: Declaration, joint: Joint) -> Declaration:
    """Return the table of a flexure with the compliance that a stiffness of its joint's drive means."""
    key = "joint_stiffness"
    for other in ("compliance", "stiffness", "file"):
        if table.has(other):
            raise table.fail(key, f"stands beside {other!r}, which says how the joint gives: give one of them")
    if joint.kind not in MOVING:
        text = f"joint {joint.name!r} is {joint.kind} and has no axis of its own: give a stiffness of 6 numbers"
        raise table.fail(key, text)
    value, drive = positive(table, key, "N/m" if joint.kind == "prismatic" else "Nm/rad"), drive_of(joint)
    values = {name: given for name, given in table.table.items() if name != key}
    values["compliance"] = (np.outer(drive, drive) / value).tolist()
    derived = Declaration(values, table.keys, table.source)
    derived.known |= table.known
    return derived


def _ranges(robot: Robot) -> Travel:
    """Return every driven joint's limits, a turn either way of a continuous one, which joints follow, which slide."""
    turn = 2.0 * np.pi
    ranges = {
        joint.name: (max(joint.lower, -turn), min(joint.upper, turn))
        if np.isinf([joint.lower, joint.upper]).any()
        else (joint.lower, joint.upper)
        for joint in robot.moving
    }
    slides = {joint.name: joint.axis for joint in robot.places if joint.kind == "prismatic"}
    return Travel(ranges, robot.linkage.followers, slides)


def _read_prior(table: Declaration) -> Prior:
    values = {field.name: table.std(field.name, 0.0) for field in fields(Prior) if field.name != "each"}
    each = table.part("each")
    table.finish()
    for name, value in values.items():
        if 0.0 < value < SMALLEST_STD:
            raise table.fail(name, f"{value:g} is less than anything can be known to; 0 keeps it fixed")
    labelled: dict[str, tuple[float, float]] = {}
    for label in each.table:
        mean, std = each.numbers(label, (2,)).tolist()
        if std < 0.0 or 0.0 < std < SMALLEST_STD or (std == 0.0 and mean != 0.0):
            raise each.fail(
                label, f"expected [mean, standard deviation], or [0, 0] for what is fixed, got [{mean:g}, {std:g}]"
            )
        labelled[label] = mean, std
    return Prior(**values, each=labelled)


def _check_each(table: Declaration, arm: Arm) -> None:
    """Raise `ArmFileError` where [prior.each] names what is no parameter of the arm, or one that [prior] fixes."""
    parameters = {
        parameter.label: parameter
        for parameter in (
            *of_offsets(arm.robot),
            *of_motions(ParameterKind.GEOMETRY, arm.robot.frames),
            *of_masses(arm.weighing),
            *of_springs(arm.springs),
            *(axis for name in arm.flexure_names for axis in of_compliance(name)),
        )
    }
    each = table.sub("each")
    for label in arm.prior.each:
        if label not in parameters:
            raise each.fail(label, f"the arm has no parameter {label!r}{did_you_mean(label, parameters)}")
        if not replace(arm.prior, each={}).of(parameters[label])[1]:
            raise each.fail(label, f"[prior] does not free its kind: {parameters[label].group.kind}")


def _freed(flexure: Flexure, young: float, robot: Robot) -> Flexure:
    """Return a flexure whose factor of a meshed part `[prior] young` frees."""
    if not young or flexure.meshed is None or flexure.learn is not None:
        return flexure
    law = replace(flexure.meshed, relative_std=flexure.meshed.relative_std or young)
    law = replace(flexure.law, law=law) if isinstance(flexure.law, AtNode) else law
    return replace(flexure, law=law, learn=Learning("linear", 6, _ranges(robot)))


def _long(robot: Robot, springs: Sequence[Spring]) -> Iterator[Flag]:
    """Yield a flag about each point of a loop, a cylinder or a spring that is farther away than the arm reaches."""
    for tie in (*robot.linkage.loops, *robot.linkage.cylinders, *springs):
        for key, link, point in (("at", tie.link, tie.at), ("at_to", tie.to, tie.at_to)):
            if robot.times_reach(apart := float(np.linalg.norm(point))) > 1.0:
                text = f"{tie.name!r}: {key} is {apart:.3g} m from the origin of {link!r}"
                yield Flag("long", f"{text}, and the arm reaches {robot.reach:.3g} m: millimetres? Taken as metres")


def _questions(flexures: tuple[Flexure, ...], robot: Robot, stated: Sequence[str]) -> Iterator[Flag]:
    """Yield flags about how the flexures give, and how well that is known; `stated` are those by a joint_stiffness."""
    row = anywhere(robot)
    for joint in robot.moving:
        at_joint = [flexure for flexure in flexures if flexure.joint == joint.name and not flexure.before]
        drive = drive_of(joint)
        same = np.flatnonzero([drive[:3].any()] * 3 + [drive[3:].any()] * 3)
        given = sum((np.abs(flexure.law.tangent(np.zeros(6), row)) for flexure in at_joint), np.zeros((6, 6)))
        along, others = float(drive @ given @ drive), np.diag(given)[same]
        # A joint that tilts or twists has a drive that does, too; one axis alone is a mistaken one.
        if at_joint and along <= RIGID * others.max() and np.count_nonzero(others > RIGID * others.max()) == 1:
            axis, wanted = TWIST_NAMES[same[int(others.argmax())]], np.round(drive[same], 3).tolist()
            nearest = drive_axis(joint)
            text = f"gives about {axis} alone, but the axis of its joint {joint.name!r} is {nearest} ({wanted})"
            remark = f"meant to be {nearest}? joint_stiffness is about the joint's own axis"
            yield Flag("not_the_drive", f"flexure {at_joint[0].name!r} {text}: {remark}")
    # A joint_stiffness in another unit shows by how far the arm's own weight would turn the joint.
    places = [joint.name for joint in robot.chain]
    for flexure in flexures:
        if flexure.joint not in places or flexure.name not in stated:
            continue
        beyond = robot.chain[places.index(flexure.joint) :]
        drive = drive_of(beyond[0])
        if drive[:3].any():
            continue
        carried = [
            inertial for name in robot.urdf.below(beyond[0].child) if (inertial := robot.urdf.links[name].inertial)
        ]
        arm_length = 0.5 * sum(float(np.linalg.norm(joint.origin)) for joint in beyond[1:])
        moment = sum(inertial.mass for inertial in carried) * float(np.linalg.norm(robot.gravity)) * arm_length
        softest = float(drive @ flexure.law.tangent(np.zeros(6), row) @ drive)
        if (turn := moment * softest) > SAGS or softest > SOFTEST[1]:
            text = f"joint_stiffness {1.0 / softest:.4g} Nm/rad lets it turn by {np.degrees(turn):.3g} degrees under "
            text += "the arm's own weight: was it in kNm/rad (x 1000), Nm/deg (x 57.3) or Nm/arcmin (x 3438)?"
            yield Flag("soft", f"flexure {flexure.name!r}: {text}", flexure.name)
    # All other compliances are held against those that any arm has.
    yield from soft((flexure for flexure in flexures if flexure.name not in stated), row)
    exact = [flexure.name for flexure in flexures if not flexure.law.uncertain and flexure.law.gives(row)]
    if exact and any(flexure.law.uncertain for flexure in flexures):  # the sum would look too sure
        text = f"only some flexures have a relative_std; taken as exactly known: {listing(exact)}"
        meshed = any(isinstance(flexure.law, MeshedLaw) for flexure in flexures if flexure.name in exact)
        text += " (of a part from a mesh: `armflex fem --young-std`)" if meshed else ""
        yield Flag("partly_certain", text)


def write_arm(
    arm: Arm,
    campaign: Campaign,
    path: Path,
    effects: Sequence[tuple[dict[str, Any], str]] = (),
    unfinished: bool = False,
) -> Path:
    """Write the arm.toml that declares an arm, comments and all, with what a fit found and the effects it added.

    Args:
        arm: As fitted; see `calibration_table`.
        campaign: What it was fitted to.
        path: The arm.toml to write; files named in it are named relative to its folder.
        effects: Tables of what was found beyond what was declared, see `effect_table`, each with a remark.
        unfinished: Whether the search for them was ended at once.

    Raises:
        UnsupportedError: No arm.toml declares the arm, or it was changed in Python after it was read.
        FileError: It cannot be written.
    """
    import tomlkit  # only when an arm is written

    if arm.source is None:
        raise UnsupportedError(
            "no arm.toml declares this arm (a preset, or parts put together in Python): it cannot be written. "
            "Load it with load_arm without a preset, or make it with make_arm"
        )
    document, fitted = tomlkit.parse(arm.source.text), calibration_table(arm, campaign, unfinished)
    document.pop("calibration", None)
    _check_declared(arm, arm.source, document, fitted)
    _move_files(document, arm.source.path.parent.resolve(), path.parent.resolve())
    for table, effect in zip(document.get("effect", ()), arm.effects, strict=False):
        if effect.earlier:
            table["earlier"] = True
    if effects and "effect" not in document:
        document.append("effect", tomlkit.aot())
    for effect, remark in effects:
        table = tomlkit.table()
        for key, value in effect.items():
            if isinstance(value, dict):  # a table of its own stands on one line
                line = tomlkit.inline_table()
                line.update(value)
                value = line
            table.append(key, value)
        if remark:
            table["name"].comment(remark)
        document["effect"].append(table)
    for distribution, least in requires_of(document.unwrap()).items():
        document.setdefault("requires", tomlkit.table())[distribution] = least
    with together():
        calibration = with_covariance(fitted, path)
        written = tomlkit.item(calibration)
        for name in REMARKS.keys() & calibration.keys():
            written[name].comment(REMARKS[name])
        document.append("calibration", written)
        return write_whole(path, tomlkit.dumps(document).encode())


def _check_declared(arm: Arm, source: Source, document: Any, fitted: Mapping[str, Any]) -> None:
    """Raise where a declaration with what was fitted is not the arm; [prior] and [measurement] it gets from the arm."""
    certain = certainty_table(arm.certainty).keys() if arm.certainty else ()
    values = {name: value for name, value in fitted.items() if name not in certain}
    declared = _read(Declaration({**document.unwrap(), "calibration": values}, (), source), None, False)
    if declared.prior != arm.prior:
        stds = {field.name: getattr(arm.prior, field.name) for field in fields(Prior)}
        document["prior"] = {name: value for name, value in plain(stds).items() if value}
    if declared.measurement != arm.measurement:
        document["measurement"] = dict(vars(arm.measurement))
    for part, says in DECLARED.items():
        if not _close(says(declared), says(arm)):
            text = f"its {part} are not those that the file says: the arm was changed in Python after it was read"
            raise UnsupportedError(f"{source.path}: the arm cannot be written, {text}")


DECLARED: dict[str, Callable[[Arm], Any]] = {
    "joints": lambda arm: [(joint.name, joint.kind, joint.origin, joint.rotation) for joint in arm.robot.places],
    "ends": lambda arm: (arm.robot.base, arm.robot.tip, arm.robot.gravity),
    "links": lambda arm: [
        (name, link.inertial and (link.inertial.mass, link.inertial.origin))
        for name, link in arm.robot.urdf.links.items()
    ],
    "payloads": lambda arm: [(name, payload.mass, payload.com) for name, payload in arm.payloads.items()],
    "flexures": lambda arm: [
        (flexure.name, flexure.joint, flexure.law.tangent(np.zeros(6), anywhere(arm.robot))) for flexure in arm.flexures
    ],
    "springs, instruments or effects": lambda arm: (
        [spring.name for spring in arm.springs],
        list(arm.sensors),
        [effect.title for effect in arm.effects],
    ),
    "payload_rating and damping_ratio": lambda arm: (arm.payload_rating, arm.damping_ratio),
}
"""What a file must say of an arm as the arm does, by name."""


def _close(value: Any, other: Any) -> bool:
    """Return whether two values are the same but for rounding."""
    if isinstance(value, list | tuple) and isinstance(other, list | tuple):
        return len(value) == len(other) and all(map(_close, value, other))
    if isinstance(value, np.ndarray | float) and isinstance(other, np.ndarray | float):
        size = float(np.abs(value).max(initial=0.0))
        # By which share of its size a number may differ from what its file says: factors are logarithms there
        return np.shape(value) == np.shape(other) and bool(np.allclose(other, value, rtol=0.0, atol=1e-6 * size))
    return value == other


def write_prior(declared: Path, each: Mapping[str, tuple[float, float]], path: Path) -> Path:
    """Write a declared arm.toml with its comments, and with what sister arms say of its parameters as [prior.each].

    Args:
        declared: The arm.toml of one of them.
        each: Mean and standard deviation by label; see `Prior.each`.
        path: The arm.toml to write; files named in it are named relative to its folder.
    """
    import tomlkit  # only when an arm is written

    document = tomlkit.parse(declared.read_text(encoding="utf-8-sig"))
    _move_files(document, declared.parent.resolve(), path.parent.resolve())
    document.pop("calibration", None)
    document["prior"].pop("each", None)
    document["prior"].append("each", tomlkit.item({label: list(pair) for label, pair in each.items()}))
    return write_whole(path, tomlkit.dumps(document).encode())


def _move_files(table: Any, old: Path, new: Path) -> None:
    """Rewrite the relative names under `urdf` and `file`, wherever they are."""
    for key, value in table.items():
        if key in ("urdf", "file") and isinstance(value, str):
            table[key] = Path(os.path.relpath(old / value, new)).as_posix()
        elif isinstance(value, dict):
            _move_files(value, old, new)
        elif isinstance(value, list):
            for item in (item for item in value if isinstance(item, dict)):
                _move_files(item, old, new)
